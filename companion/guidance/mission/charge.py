"""Watch the charge, and widen the limits of a landing that nothing but the battery ends.

The charge that decides is the highest of the last seconds' reports, so that a voltage that dips under load decides nothing.
"""

from functools import lru_cache

from msgspec import Struct, structs

from companion.settings.guidance import GuidanceOptions
from estimator.contracts.keys import grown
from estimator.contracts.time import MonoNs, seconds_between

DWELL_S = 3.0
"""Time for which every report has to be low, s: a climb against a gust or a wave loads a battery for less."""
_LOOSER = 1.5
"""Growth of the limits of place, speed and tilt and of the way down for a battery that ends: what feet bear at the contact."""

_STEP = 0.01  # fall of the charge that counts as a step
_STEPS = 5  # steps that are kept
_STEPS_LEAST = 3  # steps from which the least rate is known
_CHANGED = 0.05  # rise of the charge that shows another battery
_TRIES = 100  # tries of a landing that nothing but the battery ends
_TIME_S = 36000.0  # time of such a landing


class ChargeWatch(Struct, frozen=True):
    """The charge by the vehicle's reports. A single report is never confirmed: only a later one ends the dwell."""

    since: MonoNs | None = None
    """Time of the first report."""
    highest: tuple[tuple[MonoNs, float], ...] = ()
    """Times and charges, 0 to 1, of the newest report and of those before that no later one reached, within the dwell."""

    falls: tuple[tuple[MonoNs, float], ...] = ()
    """Times and charges of the last reports that were lower than all before, each by a step."""

    def reported(self, at: MonoNs, charge: float | None) -> "ChargeWatch":
        """Return the memory after a report; None forgets all."""
        if charge is None:
            return ChargeWatch()
        kept = [(t, c) for t, c in self.highest if c > charge and seconds_between(t, at) <= DWELL_S]
        falls = self.falls if self.falls and charge < self.falls[-1][1] + _CHANGED else ()
        if not falls or charge <= falls[-1][1] - _STEP:
            # The first report lies somewhere within its step.
            inside = len(falls) == 1 and falls[0][0] == self.since
            falls = ((at, charge),) if inside else (*falls[-_STEPS:], (at, charge))
        return ChargeWatch(at if self.since is None else self.since, (*kept, (at, charge)), falls)

    def left_s(self, now: MonoNs) -> float | None:
        """Return the time until the charge is used up at the rate of the last steps, s; None until there are some."""
        if len(self.falls) < _STEPS_LEAST:
            return None
        (first, most), (last, least) = self.falls[0], self.falls[-1]
        return max(0.0, least * seconds_between(first, last) / (most - least) - seconds_between(last, now))

    @property
    def fraction(self) -> float | None:
        """The highest charge that was reported within the dwell; None while that is not over, or nothing is reported."""
        if self.since is None or seconds_between(self.since, self.highest[-1][0]) < DWELL_S:
            return None
        return self.highest[0][1]


def battery_ends(charge: float | None, options: GuidanceOptions) -> bool:
    """Return whether the battery ends: a charge, 0 to 1, with which no landing begins; None if it is not known."""
    return charge is not None and charge < options.limits.battery


@lru_cache(maxsize=2)
def last_landing(options: GuidanceOptions) -> GuidanceOptions:
    """Return the options of a landing whose battery ends: a contact that is less good, or another pad, is better than to fall."""
    o = options
    return structs.replace(
        o,
        limits=grown(o.limits, _LOOSER, ("error_m", "relative_speed_m_s", "deck_tilt_gate_deg", "deck_tilt_commit_deg")),
        cone=grown(o.cone, _LOOSER, ("slope", "descent_rate_m_s")),
        tries=structs.replace(o.tries, go_arounds_max=_TRIES, landing_s=_TIME_S, another_pad="automatic"),
    )
