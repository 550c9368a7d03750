"""Meters that make the history of an autopilot's flight log from its readings, in order of time."""

from drivers.log_history import VIBRATION_LIMIT_M_S2, Excess, LoggedLanding, LoggedMoment, LogHistory

RATIO_LIMIT = 1.0
"""The test ratio of an innovation above which both estimators refuse a measurement."""
AGAIN_S = 10.0
"""A landing that is detected again within this time is the same landing, seconds."""


class ExcessMeter:
    """Measures an `Excess` from readings in order of time; a gap of more than half a second counts as half a second.

    Args:
        limit: the value above which time is counted.
    """

    def __init__(self, limit: float) -> None:
        self._limit = limit
        self._worst, self._worst_at_s, self._over_s = -1.0, 0.0, 0.0
        self._before_s: float | None = None

    def add(self, value: float, at_s: float) -> None:
        """Take one reading; values that are not numbers are left out."""
        if not value >= 0.0:
            return
        if value > self._limit and self._before_s is not None:
            self._over_s += min(max(at_s - self._before_s, 0.0), 0.5)
        self._before_s = at_s
        if value > self._worst:
            self._worst, self._worst_at_s = value, at_s

    @property
    def excess(self) -> Excess | None:
        """The measured excess; None without a reading."""
        return None if self._worst < 0.0 else Excess(round(self._worst, 3), round(self._worst_at_s, 2), round(self._over_s, 2))


class LandingMeter:
    """Finds the landings in what the detector and the motors reported, in order of time."""

    def __init__(self) -> None:
        self._flown = False
        self._detected_s: list[float] = []
        self._lost = 0
        self._armed_since_s: float | None = None
        self._lost_at_s: float | None = None
        self._landings: list[LoggedLanding] = []

    def flying(self, at_s: float) -> None:
        """Note that the land detector reports a flying vehicle."""
        self._flown = True
        if self._armed_since_s is not None:
            self._lost += 1
            self._lost_at_s, self._armed_since_s = at_s, None

    def landed(self, at_s: float) -> None:
        """Note that the detector takes the vehicle to stand."""
        if not self._flown or self._armed_since_s is not None:
            return
        if self._lost_at_s is not None and at_s - self._lost_at_s > AGAIN_S:
            self._end(self._lost_at_s, go_around=True)
        self._detected_s.append(at_s)
        self._armed_since_s, self._lost_at_s = at_s, None

    def disarmed(self, at_s: float) -> None:
        """Note that the motors are off."""
        self._end(at_s)
        self._flown = False

    def landings(self, end_s: float) -> tuple[LoggedLanding, ...]:
        """Return all landings of a log that ended at this time."""
        self._end(end_s)
        return tuple(self._landings)

    def _end(self, at_s: float, *, go_around: bool = False) -> None:
        if self._detected_s:
            armed_s = 0.0 if self._armed_since_s is None else max(at_s - self._armed_since_s, 0.0)
            # A take-off after a stand on deck ends a landing, and is no doubt about it.
            lost = self._lost - 1 if go_around or self._armed_since_s is None else self._lost
            self._landings.append(LoggedLanding(round(self._detected_s[0], 2), lost, round(armed_s, 2)))
        self._detected_s, self._lost, self._armed_since_s, self._lost_at_s = [], 0, None, None


class HistoryMeter:
    """Makes the history of a log from its events and readings in order of time; readings of an unarmed vehicle are left out.

    Args:
        stack: the autopilot, a key of `VIBRATION_LIMIT_M_S2`.
    """

    def __init__(self, stack: str) -> None:
        self.now_s = 0.0
        """Time of the next event since the log began, seconds."""
        self.armed: bool | None = None
        """None while the log does not report it, which counts as armed."""
        self.failsafes: list[LoggedMoment] = []
        self.landings = LandingMeter()
        self.clipped = self.targets_lost = 0
        self._ratios: dict[str, ExcessMeter] = {}
        self._vibration = ExcessMeter(VIBRATION_LIMIT_M_S2[stack])
        self._clips: dict[str, float] = {}

    def ratio(self, of: str, value: float) -> None:
        """Take a test ratio of the estimator."""
        if self.armed is not False:
            self._ratios.setdefault(of, ExcessMeter(RATIO_LIMIT)).add(value, self.now_s)

    def vibration(self, value_m_s2: float) -> None:
        """Take a reading of the vibration."""
        if self.armed is not False:
            self._vibration.add(value_m_s2, self.now_s)

    def clips(self, counter: str, count: float) -> None:
        """Take a counter of clipped accelerometer readings, by its name."""
        if self.armed is not False:
            self.clipped += max(0, round(count - self._clips.get(counter, count)))
        self._clips[counter] = count

    def history(self, end_s: float, dropouts_s: float = 0.0) -> LogHistory:
        """Return the history of a log that ended at this time, and lost so much."""
        ratios = {of: excess for of, meter in self._ratios.items() if (excess := meter.excess) is not None}
        return LogHistory(
            round(end_s, 2), tuple(self.failsafes), ratios, self._vibration.excess, self.clipped,
            self.landings.landings(end_s), self.targets_lost, round(dropouts_s, 2),
        )  # fmt: skip
