"""Detect that a vehicle that is commanded down is held up: it stands on something. No I/O."""

from msgspec import Struct, structs

from companion.guidance.controller import Impact
from estimator.contracts.time import MonoNs, seconds_between

ANSWERED_S = 0.7
"""Time within which the slowest vehicle has answered a command, delay and twice the lag, s (configs/responses)
(docs/decisions/contact.md)."""
ANSWERS_S = 0.3
"""Time by which commands lead the deck that they follow: delay and lag of a vehicle, s."""
_HELD_LEAST_M_S = 0.3
"""Least upward excess over the commanded speed, m/s. Ground effect close to a deck makes 0.15 (docs/decisions/contact.md)."""
HELD_S = 0.25
"""Duration of the excess, s (docs/decisions/contact.md)."""


class HeldUp(Struct, frozen=True):
    """Commands over the ground, or to the deck, and what contradicts them."""

    commands: tuple[tuple[MonoNs, float], ...] = ()
    """Commanded vertical speeds with their times, m/s down, oldest first."""
    since: MonoNs | None = None
    """Time since which the vehicle is held up."""
    newest: Impact | None = None

    def commanded(self, at: MonoNs, down_m_s: float | None) -> "HeldUp":
        """Return the memory after a command; None, which is no vertical speed over the ground, forgets those before."""
        if down_m_s is None:
            return HeldUp(newest=self.newest)
        kept = self.commands
        # One that is older than the window stays: it was flown when the window began.
        while len(kept) > 1 and seconds_between(kept[1][0], at) > ANSWERED_S:
            kept = kept[1:]
        return structs.replace(self, commands=(*kept, (at, down_m_s)))

    def to_deck(self, at: MonoNs, deck_down_m_s: float | None) -> float | None:
        """Return the speed towards the deck that the vehicle is to fly now, m/s down: by the command that it answers now.

        Args:
            deck_down_m_s: the deck's velocity over the ground, m/s down; None if it is not known.
        """
        answered = [v for given, v in self.commands if seconds_between(given, at) >= ANSWERS_S]
        return None if deck_down_m_s is None or not answered else answered[-1] - deck_down_m_s

    def measured(self, at: MonoNs, down_m_s: float) -> "HeldUp":
        """Return the memory after the vehicle's vertical speed, m/s down; `newest` is the newest contact."""
        if not self.commands or seconds_between(self.commands[0][0], at) < ANSWERED_S:
            return structs.replace(self, since=None)
        short_m_s = min(v for _, v in self.commands) - down_m_s
        if short_m_s < _HELD_LEAST_M_S:
            return structs.replace(self, since=None)
        since = at if self.since is None else self.since
        if seconds_between(since, at) < HELD_S:
            return structs.replace(self, since=since)
        return structs.replace(self, since=since, newest=Impact(at, "velocity", held_m_s=short_m_s))
