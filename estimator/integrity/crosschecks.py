"""Check one witness by another: heights by range and barometer, heading by gyro, view by the body's turns, baselines by camera.

Compare other heights with the camera's: a range sensor over the pad, and the change of the barometric height.

A range counts if the sighting puts the deck around the pad below the body; beyond the edge there is water, and a longer range
means nothing. A shorter one counts there too, near the pad: nothing stands above the deck, so the camera sees it too far away (a
smaller pad, a wrong focal length).

Hold the heading by the gyro while the vehicle reports one that turns otherwise: a compass beside steel, or one that drifts.

Relative to a pad only the turns of the body count, not where north is. The reported heading less what the gyro has turned is
followed at no more than a gyro's bias may amount to. Where the report is further from that than the tolerance, it is replaced;
in between it passes unchanged. A report that goes on from another heading is so taken over slowly, and no frame sees a jump.

Detect a frozen view and a mirrored one: the pad does not move in the image as the body's rotation moves it.

A rotation moves everything in the image by the same angle, at any distance. So the pad's bearing in the body is compared with the
effect of the rotation alone, as computed from the vehicle's own attitude. A pad that keeps its place in the image while the body
turns is not below, whatever noise is added. One that moves the other way is seen by a camera that mirrors, or that is mounted the
other way round (estimator/core/integrity/view.c).

Follow a baseline between two GNSS antennas against the estimate. A wrong whole number of wavelengths puts one off by decimetres
at once, and its receiver does not know. It is found by what else agrees. With a recent picture, which the gyro's motion confirms,
a baseline that agreed before and leaps is wrong: it is left out and named. A belief that has become too uncertain to find one
wavelength confirms nothing: what comes after such a gap has to last. Without a picture nobody knows which of the two solutions
was wrong, and a baseline that has never agreed with the camera may as well show an antenna that is not where the settings say:
then nobody descends.
"""

import math
from typing import Any, NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.estimates import FusionResult, Sighting, Verdict
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Baro, Imu, Range
from estimator.core.library import CORE
from estimator.integrity.options import IntegrityOptions

_PICTURE_S = 0.5  # Age of the newest fused picture up to which it decides
_SIGMAS = 5.0  # Own standard deviations from the estimate beyond which a baseline contradicts it
_LEAST_M = 0.06  # Distance beside that
_MISSES = 2  # Contradictions in a row after which baselines are not believed
_BELIEVED_S = 1.0  # Time for which baselines have to agree with the estimate until they are believed again, with a picture
_BELIEVED_ALONE_S = 10.0  # The same without one
_CHECKS_M = 0.06  # Standard deviation of the innovation up to which a wrong wavelength, 0.19 m, shows in it
_FLOAT_M = 0.1  # Standard deviation of a baseline from which on it is too coarse to be judged
_PROVEN = 10  # Number of baselines in agreement with pictures after which a leap is theirs
_FRESH_S = 0.3  # Age of a sighting up to which it is compared with a height
_NEAREST_M = 0.35  # Smallest height for the comparison: an ultrasonic sensor measures nothing nearer than 0.2 m
_UPRIGHT = 0.85  # Least cosine of the tilt at which a range is compared
_EDGE_M = 0.1  # Distance from the deck's edge within which a range may be of either
_FASTEST = 3.0  # A difference of several times what is allowed counts this many times as fast
_CLEAR = 0.35  # Radius around the pad, as a part of the height, without anything above the deck: the vehicle descends there
_PAUSE_S = 0.3  # Longest time between two ranges that counts
_SPAN_S = 12.0  # Time over which barometer and camera are compared: a swell of 12 s has brought a deck to where it is now
_BACK_S = 6.0  # The newest time that is not compared: a deck that rises for so long is no deck on waves
_SHORT_S = 4.0
"""The least of the compared time that shows a wave's crest and trough; of a shorter one twice the difference is allowed."""
_AGREES_S = 2.0  # Time for which an agreement counts
_BARO_LAG = 0.1  # Weight of a new difference in the mean: a barometer's noise is half a metre
_GAP_S = 0.1  # Time without an accepted gyro sample after which nothing says how the body turned, s
_CHANGED_RAD = math.radians(1.0)  # Least change of a correction that is kept
_CHANGES = 8  # Number of changes that are kept
_APART = 0.25
"""Share of the slip with which a report beyond the tolerance is followed: it is not the gyro's bias that took it there."""


class BaselineWatch(Struct, frozen=True):
    """Agreement of the baselines with the estimate so far."""

    pictured: int | None = None
    """Instant of the newest fused sighting by the camera, ns."""
    t: int = 0
    """Instant of the newest baseline, ns."""
    proven: int = 0
    """Number of baselines that agreed with the estimate while the camera saw the pad."""
    misses: int = 0
    missed_at: int | None = None
    """Instant of the newest baseline that contradicted the estimate, ns; None while they are believed."""
    off_m: float = 0.0
    """Distance from the estimate when they began to contradict it."""

    @property
    def contradicts(self) -> bool:
        """True while baselines contradict the estimate, or did so a moment before."""
        return self.misses >= _MISSES

    @property
    def outvoted(self) -> bool:
        """True if the camera decides that the baselines are wrong."""
        return self.contradicts and self.proven >= _PROVEN and self.sees

    @property
    def undecided(self) -> bool:
        """True if nothing decides which is wrong."""
        return self.contradicts and not self.outvoted

    @property
    def sees(self) -> bool:
        """True if the camera has shown the pad a moment before."""
        return self.pictured is not None and self.t - self.pictured <= _PICTURE_S * 1e9


def baseline_compared(state: BaselineWatch, result: FusionResult, sigma_m: float) -> BaselineWatch:
    """Process a baseline that the filter has compared with the estimate.

    Args:
        sigma_m: its largest standard deviation on one axis.
    """
    state = replace(state, t=max(state.t, int(result.measured_at)))
    if result.innovation is None or result.innovation_cov is None or sigma_m > _FLOAT_M:
        return state
    if not state.sees and math.sqrt(float(result.innovation_cov.diagonal().max())) > _CHECKS_M:
        return replace(state, misses=_MISSES, missed_at=state.t, off_m=math.inf)
    off_m = math.hypot(*result.innovation.tolist())
    if result.verdict is Verdict.GATED or off_m > _SIGMAS * sigma_m + _LEAST_M:
        held_m = off_m if state.misses < _MISSES else state.off_m
        return replace(state, misses=state.misses + 1, missed_at=state.t, off_m=held_m)
    if state.missed_at is None:
        return replace(state, misses=0, proven=state.proven + state.sees)
    agreed_s = (state.t - state.missed_at) * 1e-9
    if state.contradicts and agreed_s < (_BELIEVED_S if state.sees else _BELIEVED_ALONE_S):
        return state
    return replace(state, misses=0, missed_at=None)


class HeightWatch(Struct, frozen=True):
    """The comparison of the other heights with the camera's so far."""

    seen_at: int = 0
    """Instant of the newest sighting, ns; 0 if none."""
    d_level: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the pad in that sighting, m."""
    down_level: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """The body's down axis at that instant."""
    range_at: int = 0
    ranged_at: int = 0
    """Instant of the newest range that was compared with the camera, ns."""
    against_s: float = 0.0
    """Time for which ranges have contradicted the camera, s; agreement reduces it."""
    contradicted: bool = False
    agreed_at: int = -1
    """Instant when a range last agreed, ns; -1 if never."""
    rise: tuple[tuple[int, float], ...] = ()
    """Instants (ns) and smoothed barometric height minus camera height, m; one entry per second."""
    rise_now: float = math.nan
    seen_height: tuple[tuple[int, float], ...] = ()
    weighed_at: int = 0
    """Instant of the newest barometric height that was compared with the camera, ns."""
    baro_contradicted: bool = False

    def confirmed(self, now: int) -> bool:
        """Return whether a range has agreed lately."""
        return self.agreed_at >= 0 and 0 <= now - self.agreed_at <= _AGREES_S * 1e9


def add_sighting(state: HeightWatch, sighting: Sighting, R_ned_body: Rotation) -> HeightWatch:
    """Record a sighting that the estimator fused."""
    x, y, z = sighting.d_body_pad_level.tolist()
    cx, cy, cz = R_ned_body.without_heading().matrix[:, 2].tolist()
    return replace(state, seen_at=sighting.stamp.measured_at, d_level=(x, y, z), down_level=(cx, cy, cz))


def add_range(state: HeightWatch, event: Range, o: IntegrityOptions) -> HeightWatch:
    """Compare a range with the newest sighting if that is fresh and has the pad below."""
    t = event.stamp.measured_at
    if state.seen_at == 0 or abs(t - state.seen_at) > _FRESH_S * 1e9:
        return replace(state, range_at=t)
    x, y, z = state.d_level
    cx, cy, cz = state.down_level
    if cz < _UPRIGHT or z < _NEAREST_M or event.range_m < 0.5 * _NEAREST_M:
        return replace(state, range_at=t)
    along = z / cz
    foot = math.hypot(x - cx * along, y - cy * along)
    tolerance = o.range_tolerance_m + o.range_tolerance_fraction * z
    # A cone measures the nearest surface, which lies between the axis and the perpendicular.
    beyond, short, allowed = event.range_m - along, z - event.range_m, tolerance + 2.0 * event.sigma_m
    if foot > o.deck_radius_m - _EDGE_M and (foot > _CLEAR * z or short <= allowed):
        # The beam is not certainly over the deck, so the previous result holds until it is.
        return replace(state, range_at=t)
    off = max(beyond, short, 0.0)
    dt = min(max(0.0, (t - state.range_at) * 1e-9), _PAUSE_S)
    agrees = off <= allowed
    step = -dt if agrees else dt * min(off / allowed, _FASTEST)
    against = min(max(0.0, state.against_s + step), 1.5 * o.range_disagree_s)
    contradicted = against >= o.range_disagree_s or (state.contradicted and against > 0.0)
    agreed_at = t if agrees else state.agreed_at
    return replace(state, range_at=t, ranged_at=t, against_s=against, contradicted=contradicted, agreed_at=agreed_at)


def add_baro(state: HeightWatch, event: Baro, o: IntegrityOptions) -> HeightWatch:
    """Compare a barometric height with the camera's: the difference must not drift while the pad is visible.

    A deck on waves takes the difference up and down with it, by metres. So it may be wherever it has been `_BACK_S` to `_SPAN_S`
    ago; what drifts on is beyond that.
    """
    t = event.stamp.measured_at
    if state.seen_at == 0 or abs(t - state.seen_at) > _FRESH_S * 1e9:
        return state
    height = state.d_level[2]
    off = event.height_m - height
    now = off if math.isnan(state.rise_now) else state.rise_now + _BARO_LAG * (off - state.rise_now)
    rise, seen = state.rise, state.seen_height
    if not rise or t - rise[-1][0] >= 1e9:
        rise = (*(r for r in rise if t - r[0] <= _SPAN_S * 1e9), (t, now))
        seen = (*(s for s in seen if t - s[0] <= _SPAN_S * 1e9), (t, height))
    allowed_m = o.height_tolerance_m + _farthest(height, seen) / 3.0
    if t - rise[0][0] < (_BACK_S + _SHORT_S) * 1e9:
        allowed_m *= 2.0
    past = [each for at, each in rise if t - at >= _BACK_S * 1e9]
    against = bool(past) and max(now - max(past), min(past) - now) > allowed_m
    return replace(state, rise=rise, rise_now=now, seen_height=seen, weighed_at=t, baro_contradicted=against)


def _farthest(value: float, course: tuple[tuple[int, float], ...]) -> float:
    """Return the largest difference of a value from those of a course; 0 from an empty one."""
    if not course:
        return 0.0
    values = [each for _, each in course]
    return max(abs(value - min(values)), abs(value - max(values)))


class HeadingWatch(Struct, frozen=True):
    """The body's turn by the gyro, and the reported heading's offset from it."""

    turned_rad: float = 0.0
    """Turn about the vertical since the watch began."""
    turned_at: int = -1
    """Instant of the newest gyro sample, ns; -1 before the first."""
    rate_rad_s: float = 0.0
    down: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """The vertical in body axes, by the newest attitude."""
    held_rad: float | None = None
    """Reported heading less the turn, followed slowly; None while it is not known."""
    held_at: int = -1
    off_rad: float = 0.0
    """Correction of the newest reported heading, rad."""
    offs: tuple[tuple[int, float], ...] = ()
    """Instants, ns, from which corrections held, and these, rad: one for each change."""

    def _changed(self, t: int, off_rad: float) -> tuple[tuple[int, float], ...]:
        """Return the corrections with a newest one."""
        newest = self.offs[-1][1] if self.offs else 0.0
        return self.offs if abs(off_rad - newest) <= _CHANGED_RAD else (*self.offs[1 - _CHANGES :], (t, off_rad))


def add_gyro(watch: HeadingWatch, imu: Imu) -> HeadingWatch:
    """Add one gyro sample."""
    t, (p, q, r), (x, y, z) = imu.stamp.measured_at, imu.w_body.tolist(), watch.down
    rate = x * p + y * q + z * r
    dt = (t - watch.turned_at) * 1e-9
    if watch.turned_at < 0 or dt > _GAP_S:
        return replace(watch, turned_at=t, rate_rad_s=rate, held_rad=None)
    if dt <= 0.0:
        return watch
    turn = watch.turned_rad + 0.5 * (rate + watch.rate_rad_s) * dt
    return HeadingWatch(turn, t, rate, watch.down, watch.held_rad, watch.held_at, watch.off_rad, watch.offs)


def hold_heading(watch: HeadingWatch, event: Attitude, o: IntegrityOptions) -> tuple[HeadingWatch, Attitude]:
    """Return the attitude with the heading that the gyro holds, where the reported one is further off than the tolerance."""
    t, m = event.stamp.measured_at, event.R_ned_body.matrix
    (c, _, _), (s, _, _), (x, y, z) = m.tolist()
    since_s = (t - watch.turned_at) * 1e-9
    if watch.turned_at < 0 or abs(since_s) > _GAP_S:
        return replace(watch, down=(x, y, z), held_rad=None, off_rad=0.0), event
    offset = math.atan2(s, c) - watch.turned_rad - watch.rate_rad_s * since_s
    if watch.held_rad is None:
        return replace(watch, down=(x, y, z), held_rad=wrap_pi(offset), held_at=t, off_rad=0.0), event
    off, tolerance = wrap_pi(offset - watch.held_rad), math.radians(o.heading_tolerance_deg)
    slip = 1.0 if abs(off) <= tolerance else _APART
    most = slip * math.radians(o.heading_slip_deg_s) * max(0.0, (t - watch.held_at) * 1e-9)
    step = min(most, max(-most, off))
    off -= step
    held = wrap_pi(watch.held_rad + step)
    if abs(off) <= tolerance:
        offs = watch._changed(t, 0.0)
        return HeadingWatch(watch.turned_rad, watch.turned_at, watch.rate_rad_s, (x, y, z), held, t, 0.0, offs), event
    # Turning about the vertical leaves roll and pitch, and the last row, as they are.
    R = Rotation.from_rpy(0.0, 0.0, -off) @ event.R_ned_body
    offs = watch._changed(t, off)
    return replace(watch, down=(x, y, z), held_rad=held, held_at=t, off_rad=off, offs=offs), replace(event, R_ned_body=R)


class ViewWatch(NamedTuple):
    """Bearings of the last half second, and the moments of the fast rotations before, as the core keeps them."""

    core: Any = CORE.new("dl_view", aside_at=-1)
    """The core's `dl_view`; nobody changes one that another watch was made of."""

    @property
    def at(self) -> int:
        """Instant of the newest bearing, ns; 0 before the first."""
        return int(self.core.bearings[max(0, self.core.n - 1)].t)

    @property
    def frozen(self) -> bool:
        """True if the pad stands still in the image while the body turns."""
        return bool(self.core.frozen)

    @property
    def reversed(self) -> bool:
        """True if the pad moves in the image against the rotation of the body, along some axis."""
        return bool(self.core.reversed)

    @property
    def late_s(self) -> float:
        """Delay of the attitude against the image, s; 0 while nothing shows that it is."""
        return float(self.core.late_s)


def watch_view(state: ViewWatch, sighting: Sighting, attitude: Attitude, o: IntegrityOptions) -> ViewWatch:
    """Process one sighting and the attitude at its exposure."""
    made, d_level = CORE.ffi.new("dl_view *", state.core[0]), CORE.array("double", sighting.d_body_pad_level, 3)
    roll, pitch, _ = attitude.R_ned_body.rpy_rad
    t, turned, still = sighting.stamp.measured_at, o.view_turned_min_rad, o.view_still_ratio
    CORE.lib.dl_view_watch(made, t, d_level, roll, pitch, turned, still)
    return ViewWatch(made)
