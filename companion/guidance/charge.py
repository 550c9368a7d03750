"""The charge that decides: the highest of the last seconds' reports, so that a voltage that dips under load decides nothing."""

from msgspec import Struct

from estimator.contracts.time import MonoNs, seconds_between

DWELL_S = 3.0
"""Time for which every report has to be low, s: a climb against a gust or a wave loads a battery for less."""


class ChargeWatch(Struct, frozen=True):
    """The charge by the vehicle's reports. A single report is never confirmed: only a later one ends the dwell."""

    since: MonoNs | None = None
    """Time of the first report."""
    highest: tuple[tuple[MonoNs, float], ...] = ()
    """Times and charges, 0 to 1, of the newest report and of those before that no later one reached, within the dwell."""

    def reported(self, at: MonoNs, charge: float | None) -> "ChargeWatch":
        """Return the memory after a report; None forgets all."""
        if charge is None:
            return ChargeWatch()
        kept = [(t, c) for t, c in self.highest if c > charge and seconds_between(t, at) <= DWELL_S]
        return ChargeWatch(at if self.since is None else self.since, (*kept, (at, charge)))

    @property
    def fraction(self) -> float | None:
        """The highest charge that was reported within the dwell; None while that is not over, or nothing is reported."""
        if self.since is None or seconds_between(self.since, self.highest[-1][0]) < DWELL_S:
            return None
        return self.highest[0][1]
