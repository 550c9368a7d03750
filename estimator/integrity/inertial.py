"""Judge gyro, accelerometer, attitude and velocity apart, name the one that lies, and let the estimator fly on without it.

A half that repeats itself is lost at once and back at once. One that moves and lies is found by parity (`parity.py`) and has to
agree for two seconds before it counts again. Estimates made with it are worthless: the estimator starts again.
"""

import math
from itertools import pairwise
from operator import eq
from typing import Literal, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Imu
from estimator.integrity import parity
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.parity import Bin, Half, Parity, Slope, Steady, TurnByAttitude, Vec3

_PERSISTS = 3  # Number of bins in a row that accuse, before a sensor is named
_PERSISTS_ALONE = 12  # The same of a sole witness, which stands on the moving deck
_WELL = 20  # Bins in a row in which a sensor agrees again before it counts: two seconds
_AXIS = 2.0  # Factor on the time limit for one axis alone, which repeats itself more often than three
_ALL_ALIVE = 0b111111  # Bits of the axes of gyro and accelerometer, none of which repeats itself
_SHOWN_RAD_S = math.radians(2.0)
"""Difference up to which the attitude's turn confirms an axis of the gyro: its own noise between two messages."""
_STILL_AIR_M_S2 = 0.2
"""Specific force across the thrust up to which an axis of coarse steps may repeat itself: what little speed drags by."""
_IMUS = 127  # Samples of the IMU that are kept
_GYRO_RAD_S = math.radians(3.0)
"""Least steady difference of gyro and attitude: more than any gyro's bias, and than attitudes err by within the window."""
_GYRO_YAW_RAD_S = math.radians(4.0)  # The same about the down axis
_GYRO_WELL_RAD_S = math.radians(2.5)  # Difference below which the gyro agrees again
_GYRO_WINDOWS = ((10, 1.4), (14, 1.2), (20, 1.0))
"""Number of bins, and by how much the least difference grows where the window is short."""
_STEADY = 0.8  # Share of a window's bins whose difference has its sense
_REVERSED_BINS = 4  # Bins in which a reversed axis is looked for
_SWING_BINS = 6  # Bins in which swings are compared
_SWINGS_RAD_S = math.radians(8.0)
"""Difference of gyro and attitude about one axis, a root mean square, that is larger than noise.

It is 3.4 deg/s in roll and pitch, 6.6 in yaw at most in clean flights.
"""
_SHOWS_RAD_S = math.radians(3.0)  # Turn in roll and pitch that shows whether they agree again
_SWINGS_SHARE = 0.15  # Least of that difference, of the sum of both turns
_AGREES_SHARE = 0.3  # Share below which they agree again
_DECIDED = 0.2  # Distance from one half of the share by which pictures take a side
_STILL_RIGHT_S = 10.0
"""Time after the last sight for which the velocity stays right that sightings took the side of: the attitude errs as long."""
_PICTURES_OLD_S = 0.5  # Age of the newest picture beyond which there are none
_PICTURES_LATE = 3  # Number of bins by which pictures are late
_TURNED_RAD_S = math.radians(8.0)  # Least turn, a root mean square, at which a wrong sense is detected
_SHOWN_LEAST_RAD_S = math.radians(1.0)  # Least turn that shows a unit or an axis, a root mean square
_UNIT_TIMES = 15.0  # Times as much that is another unit
_ALIKE = 0.85  # Least correlation with another axis or unit
_THRUST_MIN_M_S2 = 2.0  # Least thrust of a multirotor in the air along its own vertical axis
_SIDE_MAX_M_S2 = 8.0
"""Largest specific force of it across that axis.

That is the air's drag: 5.7 m/s^2 where a tilt of 30 degrees holds against the wind, and its gusts.
"""
_PERSISTS_GROSS = 2  # Bins in a row that name a sensor whose error is gross
_FALLS = ((10, 5.0), (20, 3.0))
"""Number of bins over which the attitude has the body accelerate downward so much, m/s^2, while its whole thrust is felt.

No pilot leans by 50 degrees for a second, or by 45 for two: it would fall at 5 or 6 m/s.
"""
_FELT_LEAST = 0.85 * G_M_S2  # Least specific force of a body whose whole thrust is felt
_FELT_MOST = 1.5 * G_M_S2  # Most of it
_ACCEL_M_S2 = 1.5
"""Least difference of the accelerometer downward: a filter takes less for its bias."""
_ACCEL_ALONE_M_S2 = 2.4  # The same by sightings alone: a deck in a high sea accelerates by 2 m/s^2
_ACCEL_SIDE_M_S2 = 1.8  # The same aside
_USUAL_MIN = 15  # Bins from which a usual difference is known
_BIN_SHARE = 0.01  # Weight of one bin in the long-run mean: it takes ten seconds to change
_SIGMAS = 5.0  # Standard deviations beyond which a difference is none of noise
_GROUND_SIGMA_M_S2 = 0.25  # Error of a barometer in gusts, which the residuals of a window do not show
_VELOCITY_SIGMA_M_S2 = 0.2  # Error of a velocity that lags, which they do not show either
_INFLATED = 2.0  # Residuals of neighbouring bins are alike
_SHARE = 0.4  # Share of a difference with which another witness sides
_PLACE_S = 2.0  # Window in which places show an acceleration
_VELOCITY_S = 1.2  # Window in which velocities do
_PLACES = 14  # Fewest places in it
_VELOCITIES = 8  # Fewest velocities in it


class LyingHalf(Struct, frozen=True):
    """A sensor that the estimator does without."""

    sensor: Literal["accelerometer", "gyro", "attitude", "velocity"]
    what: str
    """Description of the fault, in words."""
    well: int = 0
    """Number of bins in a row in which it agreed again."""

    @property
    def text(self) -> str:
        """Return the sentence for the operator."""
        return f"the {self.sensor} {self.what}; flying without it"


class Differences(NamedTuple):
    """True less measured acceleration, m/s^2, as others have it."""

    ground: Slope | None
    """Downward, by a witness on the ground: barometer or velocity."""
    deck: Slope | None
    """Downward, by the pad's sightings, which stand on the moving deck."""
    side: tuple[float, float] | None
    """Ahead and aside as far as velocity and sightings agree."""

    def agrees_with(self, usual: "Usual") -> bool:
        """Return whether some evidence confirms the accelerometer and none contradicts it."""
        down = self.ground or self.deck
        if down is None or abs(down.value - usual.down) > (0.6 if self.ground else 0.8) * _ACCEL_M_S2:
            return False
        return self.side is None or math.hypot(self.side[0] - usual.ahead, self.side[1] - usual.aside) < 0.6 * _ACCEL_SIDE_M_S2


class Usual(NamedTuple):
    """The differences that have been there from the start: biases, which the filter estimates itself."""

    n: int = 0
    """Number of bins in which there was a downward difference."""
    down: float = 0.0
    sides: int = 0
    """Number of bins in which there was one aside: a pad out of sight shows none for seconds."""
    ahead: float = 0.0
    aside: float = 0.0

    def after(self, off: Differences) -> "Usual":
        """Return them after one bin more."""
        usual, down = self, off.ground or off.deck
        if down is not None:
            usual = usual._replace(n=self.n + 1, down=self.down + _weight(self.n) * (down.value - self.down))
        if off.side is not None:
            (x, y), k = off.side, _weight(self.sides)
            ahead, aside = self.ahead + k * (x - self.ahead), self.aside + k * (y - self.aside)
            usual = usual._replace(sides=self.sides + 1, ahead=ahead, aside=aside)
        return usual


def _weight(bins: int) -> float:
    """Return the weight of one bin more in a mean of so many."""
    return max(1.0 / (bins + 1), _BIN_SHARE)


class Inertial(Struct, frozen=True):
    """The state of both halves of the IMU."""

    imus: tuple[Imu, ...] = ()
    """The newest samples, those since the newest bin and the one before them."""
    gyro: Half = Half()
    accel: Half = Half()
    repeats: tuple[Half, ...] = (Half(),) * 8
    """Repetition of the gyro, the accelerometer, and each of their axes."""
    repeating: bool = False
    """True if one of them repeats itself now."""
    alive: int = 0
    """A bit for each axis that has changed in flight: one that a sensor does not have never does."""
    turn: TurnByAttitude = TurnByAttitude()
    parity: Parity = Parity()
    gyro_fault: LyingHalf | None = None
    """Gyro fault by parity."""
    attitude_fault: LyingHalf | None = None
    """Attitude fault by parity. Nothing can replace the attitude, so there is no descent with it."""
    accel_fault: LyingHalf | None = None
    velocity_fault: LyingHalf | None = None
    """Velocity fault by accelerometer and sightings."""
    velocity_against: int = 0
    """Number of bins in a row in which the velocity contradicted the accelerometer."""
    velocity_right: int | None = None
    """Instant, ns, of the newest bin in which the sightings took its side against the accelerometer; None if there was none."""
    velocity_steady: Steady = Steady()
    """Difference of velocity and accelerometer that is no lie."""
    suspected: str | None = None
    """The sensor that the newest bin accused, of gyro and attitude."""
    usual: Usual = Usual()
    accel_against: int = 0
    """Number of bins in a row that accused the accelerometer."""
    named: int = 0
    """Number of times that parity has named a sensor."""

    @property
    def accel_lost(self) -> bool:
        """True if the estimator does without the accelerometer."""
        return self.accel.frozen or self.accel_fault is not None

    @property
    def lost(self) -> tuple[str, ...]:
        """The sensors that the estimator does without, in words."""
        found = []
        for name, half, fault in (("accelerometer", self.accel, self.accel_fault), ("gyro", self.gyro, self.gyro_fault)):
            if half.frozen:
                found.append(f"the {name} repeats its readings; flying without it")
            elif fault is not None:
                found.append(fault.text)
        if self.attitude_fault is not None:
            found.append(f"the attitude {self.attitude_fault.what}")
        if self.velocity_fault is not None:
            found.append(self.velocity_fault.text)
        return tuple(found)


def felt(state: Inertial, imu: Imu, o: IntegrityOptions, flying: bool) -> tuple[Inertial, Imu | None]:
    """Process an IMU sample.

    Returns:
        The next state, and the sample without its lost halves; None if nothing is left of it.
    """
    t, last = imu.stamp.measured_at, state.imus[-1] if state.imus else None
    before = t if last is None else last.stamp.measured_at
    was, now = _six(last), _six(imu)
    # Hundreds of samples a second, and hardly one repeats a value.
    if last is not None and (state.repeating or state.alive != _ALL_ALIVE or any(map(eq, was, now))):
        same = [a == b for a, b in zip(was, now, strict=True)]
        state = _repeated(state, same, _shown(state, now, t), (before, t), o.imu_frozen_s, flying)
    before_gyro, before_accel = state.gyro, state.accel
    gyro, accel = (_frozen_of(state, half) for half in range(2)) if state.repeating else (state.repeats[0], state.repeats[1])
    lies, bad = state.gyro_fault, state.accel_fault
    frozen = gyro.frozen or accel.frozen
    checked, imus = (state.parity, (*state.imus[-_IMUS:], imu)) if flying and not frozen else (Parity(), (imu,))
    after = replace(state, imus=imus, gyro=gyro, accel=accel, parity=checked)
    if not frozen and lies is None and bad is None:
        return after, imu
    gyro_s = _lost_s(before_gyro, gyro, lies is not None, (before, t))
    accel_s = _lost_s(before_accel, accel, bad is not None, (before, t))
    return after, parity.replace_halves(imu, gyro_s, accel_s, state.turn)


def _six(imu: Imu | None) -> list[float]:
    return [math.nan] * 6 if imu is None else imu.w_body.tolist() + imu.f_body.tolist()


def _shown(state: Inertial, now: list[float], t: int) -> list[bool]:
    """Return of each axis whether there is reason for what it reads.

    Of a gyro's axis it is the turn of the attitude; of an accelerometer's across the thrust still air, which does not drag.
    """
    turn = state.turn.rate(t)
    turns = [False] * 3 if turn is None else [abs(a - b) < _SHOWN_RAD_S for a, b in zip(turn.tolist(), now[:3], strict=True)]
    return [*turns, *(abs(f) < _STILL_AIR_M_S2 for f in now[3:5]), False]


def _repeated(
    state: Inertial, same: list[bool], shown: list[bool], span: tuple[int, int], frozen_s: float, flying: bool
) -> Inertial:
    """Return the state with the repetitions after a sample.

    Args:
        same: whether each axis is the same as before, to the bit.
        shown: whether another witness shows the same: an axis of coarse steps repeats itself while nothing turns.
        span: instants of the sample before and of the newest, ns.
    """
    before, t = span
    alive = state.alive | sum(1 << i for i, repeated in enumerate(same) if flying and not repeated)
    whole = ((all(same[:3]), frozen_s), (all(same[3:]), frozen_s))
    alone = [s and (h.frozen or not seen) for s, h, seen in zip(same, state.repeats[2:], shown, strict=True)]
    each = (*whole, *((repeated, _AXIS * frozen_s) for repeated in alone))
    repeats = tuple(
        [
            parity.read_half(h, before if s else None, t, after_s, flying)
            for h, (s, after_s) in zip(state.repeats, each, strict=True)
        ]
    )
    return replace(state, repeats=repeats, alive=alive, repeating=any(h.since >= 0 for h in repeats))


def _frozen_of(state: Inertial, half: int) -> Half:
    """Return the repetition of a half, 0 of the gyro and 1 of the accelerometer, or that of its first frozen axis."""
    if not state.repeats[half].frozen:
        for i in range(3 * half, 3 * half + 3):
            if state.repeats[2 + i].frozen and state.alive >> i & 1:
                return state.repeats[2 + i]
    return state.repeats[half]


def levelled(state: Inertial, attitude: Attitude, flying: bool) -> Inertial:
    """Process an attitude as the vehicle reports it."""
    turn = state.turn.after(attitude)
    if turn is state.turn:
        return state
    checked, ended = parity.levelled(state.parity, attitude, state.imus)
    if not ended:
        return replace(state, turn=turn, parity=checked)
    after = replace(state, turn=turn, parity=checked, imus=state.imus[-1:])
    return _judged_velocity(_judged_accel(_judged_gyro(after))) if flying else after


def _lost_s(was: Half, now: Half, lies: bool, span: tuple[int, int]) -> float:
    """Return the time up to the newest sample in which a half measured nothing, s; 0 if it measures.

    Args:
        span: instants of the sample before and of the newest, ns.
    """
    if now.frozen:
        # What was used until it was found was wrong as well.
        return (span[1] - (span[0] if was.frozen else now.since)) * 1e-9
    return max(1e-6, min(0.05, (span[1] - span[0]) * 1e-9)) if lies else 0.0


def _judged_gyro(state: Inertial) -> Inertial:
    bins = state.parity.bins
    for name in ("gyro_fault", "attitude_fault"):
        fault: LyingHalf | None = getattr(state, name)
        if fault is not None:
            agrees = not _falls(bins) and _agree(bins[-_GYRO_WINDOWS[0][0] :])
            well = fault.well if agrees is None else fault.well + 1 if agrees else 0
            if well < _WELL:
                return replace(state, **{name: replace(fault, well=well)})
            # The attitude entered all estimates, the gyro's fault did not.
            return replace(state, **{name: None}, named=state.named + (name == "attitude_fault"))
    if state.accel_fault is None and _falls(bins):
        what = "leans so far that the body would fall, and the accelerometer feels that it flies: it may be in degrees"
        return replace(state, attitude_fault=LyingHalf("attitude", what), named=state.named + 1)
    found = _swings_apart(state.parity)
    if found is not None and found.sensor != state.suspected:
        # The bin in which a difference begins holds a part of it alone, so the next one has to say the same.
        return replace(state, suspected=found.sensor)
    found = found or _steadily_apart(state.parity)
    if found is None:
        return state if state.suspected is None else replace(state, suspected=None)
    return replace(state, **{f"{found.sensor}_fault": found}, named=state.named + 1)


def _falls(bins: tuple[Bin, ...]) -> bool:
    """Return whether the attitude has the body fall for a second or two in which the accelerometer feels its thrust."""
    for n, least_m_s2 in _FALLS:
        newest = bins[-n:]
        felt_all = len(newest) == n and all(
            _FELT_LEAST < math.hypot(*b.f) < _FELT_MOST and math.hypot(*b.f[:2]) < -0.5 * b.f[2] for b in newest
        )
        if felt_all and math.fsum(b.dv[2] for b in newest) > least_m_s2 * math.fsum(b.span_s for b in newest):
            return True
    return False


def _agree(bins: tuple[Bin, ...]) -> bool | None:
    """Return whether gyro and attitude turn alike; None where the body hardly turns, so that nothing shows it."""
    n = max(1, len(bins))
    if not bins or math.hypot(*(math.fsum(b.off[i] for b in bins) / n for i in range(3))) >= _GYRO_WELL_RAD_S:
        return False
    apart = math.fsum(b.off[i] ** 2 for b in bins for i in range(2))
    both = math.fsum(b.w[i] ** 2 + (b.w[i] - b.off[i]) ** 2 for b in bins for i in range(2))
    if both < 2.0 * n * _SHOWS_RAD_S**2:
        return None
    return apart < _AGREES_SHARE * both


def _steadily_apart(p: Parity) -> LyingHalf | None:
    for n, by in _GYRO_WINDOWS:
        bins = p.bins[-n:]
        what = _unit_or_axes(bins) or _gyro_lies(p, bins, by) if len(p.bins) >= n else ""
        if what:
            return LyingHalf("gyro", what)
    return None


def _swings_apart(p: Parity) -> LyingHalf | None:
    """Return which of gyro and attitude lies where one turns back and forth without the other; None if neither does.

    The pad's own rotation in the pictures says which. Without pictures a gyro that turns against the attitude is the one.
    """
    bins = p.bins[-_SWING_BINS:]
    end = p.bins[-1].t if p.bins else 0
    since = p.bins[-_SWING_BINS - _PICTURES_LATE :][0].t if p.bins else 0
    in_sight = bool(p.pad) and end - p.pad[-1].until < _PICTURES_OLD_S * 1e9
    for i, axis in enumerate(("roll", "pitch", "yaw")):
        if in_sight and len(bins) == _SWING_BINS:
            apart = math.fsum(b.off[i] ** 2 for b in bins)
            both = math.fsum(b.w[i] ** 2 + (b.w[i] - b.off[i]) ** 2 for b in bins)
            if apart < _SWINGS_RAD_S**2 * len(bins) or apart < _SWINGS_SHARE * both:
                continue
            share = parity.attitude_share(p, i, since, swings=True)
            if share is not None and share > 0.5 and axis == "yaw":
                # A heading that the gyro contradicts is held by the gyro.
                continue
            if share is not None and abs(share - 0.5) > _DECIDED:
                sensor: Literal["gyro", "attitude"] = "attitude" if share > 0.5 else "gyro"
                other = "gyro" if share > 0.5 else "attitude"
                return LyingHalf(sensor, f"turns otherwise than {other} and camera in {axis}")
    reversed_in = "" if in_sight else _reversed_axis(bins[-_REVERSED_BINS:])
    return LyingHalf("gyro", f"turns the wrong way in {reversed_in}") if reversed_in else None


def _unit_or_axes(bins: tuple[Bin, ...]) -> str:
    """Return that a gyro turns as the attitude does, but in another unit or about exchanged axes; empty if it does not."""
    rates = [([b.w[i] for b in bins], [b.w[i] - b.off[i] for b in bins]) for i in range(3)]
    squares = [(_dot(w, w), _dot(a, a)) for w, a in rates]
    shown = [min(both) > len(bins) * _SHOWN_LEAST_RAD_S**2 for both in squares]

    def alike(i: int, j: int) -> float:
        return _dot(rates[i][0], rates[j][1]) / math.sqrt(squares[i][0] * squares[j][1])

    for i in range(3):
        times = math.sqrt(squares[i][0] / squares[i][1]) if shown[i] else 1.0
        if times > _UNIT_TIMES and abs(alike(i, i)) > _ALIKE:
            return f"turns {times:.0f} times as much as the attitude: it may be in degrees"
    if shown[0] and shown[1] and min(abs(alike(0, 1)), abs(alike(1, 0))) > _ALIKE > 2.0 * max(abs(alike(0, 0)), abs(alike(1, 1))):
        return "turns about forward as the attitude does about right: its axes have to be forward, right, down"
    return ""


def _dot(a: list[float], b: list[float]) -> float:
    return math.fsum(x * y for x, y in zip(a, b, strict=True))


def _reversed_axis(bins: tuple[Bin, ...]) -> str:
    """Return the axis about which the gyro turns against the attitude; empty if about none."""
    if len(bins) < _REVERSED_BINS:
        return ""
    for i, axis in enumerate(("roll", "pitch", "yaw")):
        turned = [b.w[i] - b.off[i] for b in bins]
        square = math.fsum(a * a for a in turned)
        along = math.fsum(b.w[i] * a for b, a in zip(bins, turned, strict=True))
        if square > _TURNED_RAD_S**2 * len(bins) and along < -0.5 * square:
            return axis
    return ""


def _gyro_lies(p: Parity, bins: tuple[Bin, ...], by: float) -> str:
    """Return what the gyro does where it and not the attitude lies about a steady turn; empty if neither does, or it is open.

    Args:
        by: how many times the least difference it has to be.
    """
    n, span_s = len(bins), math.fsum(b.span_s for b in bins)
    off = [math.fsum(b.off[i] for b in bins) / n for i in range(3)]
    steady = [sum(b.off[i] * off[i] > off[i] * off[i] / 3.0 for b in bins) >= _STEADY * n for i in range(3)]
    x, y = (off[i] if steady[i] else 0.0 for i in range(2))
    if math.hypot(x, y) > by * _GYRO_RAD_S:
        # The one that says that the body tilts more and more lies: it would fly away.
        along, aside, _ = bins[-1].up
        by_gyro, by_attitude = math.hypot(along - y * span_s, aside + x * span_s), math.hypot(along, aside)
        # A vessel turns as slowly: the pictures clear the gyro, and do not accuse it.
        share = parity.attitude_share(p, 0 if abs(x) > abs(y) else 1, bins[0].t, swings=False)
        if by_gyro > by_attitude + 0.5 * span_s * math.hypot(x, y) and not (share is not None and share > 0.5 + _DECIDED):
            axis, value = ("roll", x) if abs(x) > abs(y) else ("pitch", y)
            return f"turns about {abs(math.degrees(value)):.0f} deg/s too {'much' if value > 0 else 'little'} in {axis}"
    if steady[2] and abs(off[2]) > by * _GYRO_YAW_RAD_S:
        seen = _turn_seen(p, bins[0].t)
        gyro = math.fsum(b.w[2] for b in bins) / n
        if seen is not None and abs(seen - gyro) > 0.6 * abs(off[2]) and abs(seen - gyro + off[2]) < _SHARE * abs(off[2]):
            return f"turns about {abs(math.degrees(off[2])):.0f} deg/s too {'much' if off[2] > 0 else 'little'} in yaw"
    return ""


def _turn_seen(p: Parity, since: int) -> float | None:
    """Return the rate of turn against the pad since an instant, rad/s; None where too little was seen."""
    taken = [(t, yaw) for t, yaw in p.yaw if t >= since]
    span_s = (taken[-1][0] - taken[0][0]) * 1e-9 if taken else 0.0
    if span_s < 0.5:
        return None
    return math.fsum(math.remainder(b[1] - a[1], math.tau) for a, b in pairwise(taken)) / span_s


def _judged_accel(state: Inertial) -> Inertial:
    p, fault, usual = state.parity, state.accel_fault, state.usual
    if not p.bins or state.gyro_fault is not None or state.attitude_fault is not None:
        return replace(state, accel_against=0) if state.accel_against else state
    off = _differences(p)
    if fault is not None:
        well = fault.well + 1 if off.agrees_with(usual) else 0
        return replace(state, accel_fault=None if well >= _WELL else replace(fault, well=well))
    x, y, z = p.bins[-1].f
    what, needed = _accel_lies(off, usual, p.bins[-1])
    if z > -_THRUST_MIN_M_S2 or math.hypot(x, y) > _SIDE_MAX_M_S2:
        what, needed = _misread((x, y, z)), _PERSISTS_GROSS
    if not what:
        return replace(state, accel_against=0, usual=usual.after(off))
    against = state.accel_against + 1
    if against < needed:
        return replace(state, accel_against=against)
    return replace(state, accel_against=0, accel_fault=LyingHalf("accelerometer", what), named=state.named + 1)


def _misread(f: Vec3) -> str:
    """Return what a specific force is that no multirotor in the air feels: one of other units or axes, or none at all."""
    whole, least = math.hypot(*f), 0.5 * G_M_S2
    if 0.7 < whole < 1.4:
        return f"reads {whole:.1f} in all where 9.8 m/s^2 are felt: it may be in g"
    if f[2] > least:
        return "reads the thrust downward: its axes have to be forward, right, down"
    return "feels no thrust where it has to" + (", but aside: its axes may be exchanged" if whole > least else "")


def _judged_velocity(state: Inertial) -> Inertial:
    fault, against = state.velocity_fault, state.velocity_against
    if state.gyro_fault or state.attitude_fault or state.accel_fault:
        return replace(state, velocity_against=0) if against else state
    found = parity.compared(state.parity, state.velocity_steady)
    if found is None:
        return state
    if fault is not None or not found.contradicts:
        steady = state.velocity_steady.after(found.rate, state.parity.bins[-1].heading)
        state = replace(state, velocity_steady=steady)
    in_sight = bool(state.parity.sight) and state.parity.bins[-1].t - state.parity.sight[-1][0] < _PICTURES_OLD_S * 1e9
    if fault is not None:
        # Out of sight a velocity that is wrong by a constant changes as a right one does.
        well = fault.well + 1 if found.agrees and in_sight else 0 if found.contradicts else fault.well
        return replace(state, velocity_fault=None if well >= _WELL else replace(fault, well=well))
    if not found.contradicts:
        return replace(state, velocity_against=0) if against else state
    now, since = state.parity.bins[-1].t, state.velocity_right
    still = since is not None and now - since < _STILL_RIGHT_S * 1e9
    right = parity.seen_right(state.parity) if in_sight else still and not found.far
    if right is not False:
        return replace(state, velocity_right=now) if right and in_sight else state
    if against + 1 < _PERSISTS:
        return replace(state, velocity_against=against + 1)
    what = "moves otherwise than accelerometer and camera" if in_sight else "contradicts the accelerometer"
    # In sight the sightings hold the estimate; out of sight it has followed the velocity.
    return replace(state, velocity_against=0, velocity_fault=LyingHalf("velocity", what), named=state.named + (not in_sight))


def _differences(p: Parity) -> Differences:
    end = p.bins[-1].t + round(p.bins[-1].span_s * 1e9)
    places, velocities = end - round(_PLACE_S * 1e9), end - round(_VELOCITY_S * 1e9)
    (height,) = parity.accelerations(p.baro, (2,), places, _PLACES, 2)
    *flow, down = parity.accelerations(p.flow, (0, 1, 2), velocities, _VELOCITIES, 1)
    *seen, deck = parity.accelerations(p.sight, (0, 1, 2), places, _PLACES, 2)
    baro, climb = _widened(height, _GROUND_SIGMA_M_S2), _widened(down, _VELOCITY_SIGMA_M_S2)
    ground = baro if climb is None or (baro is not None and baro.var < climb.var) else climb
    side = None
    if None not in flow and None not in seen:
        (c, s), off = p.bins[-1].heading, [0.0, 0.0]
        for axis, (a, b) in enumerate(zip(flow, seen, strict=True)):
            if a and b and a.value * b.value > 0.0 and abs(a.value - b.value) < 0.6 * max(abs(a.value), abs(b.value)):
                off[axis] = 0.5 * (a.value + b.value)
        side = (c * off[0] + s * off[1], c * off[1] - s * off[0])
    return Differences(ground, deck, side)


def _widened(found: Slope | None, sigma: float) -> Slope | None:
    return None if found is None else Slope(found.value, _INFLATED * found.var + sigma * sigma)


def _accel_lies(off: Differences, usual: Usual, newest: Bin) -> tuple[str, int]:
    """Return what the accelerometer does, empty if it is not accused; and how many bins in a row have to say so."""
    ground, deck = off.ground, off.deck
    if usual.n < _USUAL_MIN:
        return "", 1
    if ground is not None:
        a = ground.value - usual.down
        agrees = deck is None or ((deck.value - usual.down) * a > 0.0 and abs(deck.value - usual.down) > _SHARE * abs(a))
        if abs(a) > _ACCEL_M_S2 and a * a > _SIGMAS**2 * ground.var and agrees:
            return _along_down(newest, a), _PERSISTS
    elif deck is not None and abs(deck.value - usual.down) > _ACCEL_ALONE_M_S2:
        return _along_down(newest, deck.value - usual.down), _PERSISTS_ALONE
    if off.side is None or usual.sides < _USUAL_MIN:
        return "", 1
    x, y = off.side[0] - usual.ahead, off.side[1] - usual.aside
    size = math.hypot(x, y)
    # A multirotor is pushed along its vertical axis alone: one that lies feels what is missing, with the opposite sign. Flow and
    # sightings may stand on one deck, and what that does to both is not felt.
    lies = size > _ACCEL_SIDE_M_S2 and -(x * newest.f[0] + y * newest.f[1]) > 0.6 * size * size
    return (f"is off by about {size:.1f} m/s^2 across the vertical" if lies else ""), _PERSISTS


def _along_down(newest: Bin, off: float) -> str:
    """Return how far the accelerometer is off along the body's down axis; `off` is true less measured downward, m/s^2."""
    measured = newest.f[2]
    true = measured + off / max(0.5, newest.up[2])
    if abs(true) < 0.5 * G_M_S2:
        return f"is off by about {abs(off):.1f} m/s^2 along the vertical"
    percent = 100.0 * (measured / true - 1.0)
    return f"reads about {abs(percent):.0f} % too {'much' if percent > 0 else 'little'}"
