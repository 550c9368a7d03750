"""Contact with a deck that is met softly: something holds the vehicle up against every velocity that was commanded lately.

A vehicle that tilts against the wind meets the deck with one foot. It turns about that foot, its middle is slowed down over some
tenths of a second, and no step of the accelerometer shows it. A real PX4 stood on a deck like this for two seconds, with its
thrust falling and its tilt growing. What it does then no flight does: it goes up faster than any of the newest commands requests,
and goes on doing so. Commands are remembered for longer than a vehicle takes to answer them, and the least of them counts, so
that neither a delay nor a step of the commands is a contact. It is for velocities over the ground, an autopilot's, and for the
same ones to the deck (`to_deck`): a deck that falls faster and faster carries a vehicle down past the least one over the ground.
"""

from msgspec import Struct
from msgspec.structs import replace

from companion.guidance.controller import Impact
from estimator.contracts.time import MonoNs, seconds_between

ANSWERED_S = 0.7
"""Time within which the slowest vehicle has answered a command, delay and twice the lag, s (configs/responses)."""
ANSWERS_S = 0.3
"""Time by which commands lead the deck that they follow: delay and lag of a vehicle, s."""
LEAST_M_S = 0.3
"""Least upward excess over the commanded speed, m/s. Ground effect close to a deck makes 0.15."""
HELD_S = 0.25
"""Duration of the excess, s."""


class HeldUp(Struct, frozen=True):
    """The detector's memory."""

    commands: tuple[tuple[MonoNs, float], ...] = ()
    """Commanded vertical speeds with their times, m/s down, oldest first."""
    since: MonoNs | None = None
    """Time since which the vehicle is held up."""
    newest: Impact | None = None


def commanded(held: HeldUp, at: MonoNs, down_m_s: float | None) -> HeldUp:
    """Return the memory after a command; None for one that is no vertical speed over the ground, which forgets those before."""
    if down_m_s is None:
        return HeldUp(newest=held.newest)
    kept = held.commands
    # One that is older than the window stays: it was flown when the window began.
    while len(kept) > 1 and seconds_between(kept[1][0], at) > ANSWERED_S:
        kept = kept[1:]
    return replace(held, commands=(*kept, (at, down_m_s)))


def to_deck(held: HeldUp, at: MonoNs, deck_down_m_s: float | None) -> float | None:
    """Return the speed towards the deck that the vehicle is to fly now, m/s down: by the command that it answers now.

    Args:
        held: the commands over the ground.
        deck_down_m_s: the deck's velocity over the ground, m/s down; None if it is not known.
    """
    answered = [v for given, v in held.commands if seconds_between(given, at) >= ANSWERS_S]
    return None if deck_down_m_s is None or not answered else answered[-1] - deck_down_m_s


def measured(held: HeldUp, at: MonoNs, down_m_s: float) -> HeldUp:
    """Return the memory after the vehicle's vertical speed, m/s down; `newest` is the newest contact."""
    if not held.commands or seconds_between(held.commands[0][0], at) < ANSWERED_S:
        return replace(held, since=None)
    short_m_s = min(v for _, v in held.commands) - down_m_s
    if short_m_s < LEAST_M_S:
        return replace(held, since=None)
    since = at if held.since is None else held.since
    if seconds_between(since, at) < HELD_S:
        return replace(held, since=since)
    return replace(held, since=since, newest=Impact(at, "velocity", held_m_s=short_m_s))
