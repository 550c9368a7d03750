"""Dead reckoning: sightings give the pad's position, and the drone's own velocity and heading propagate it between them.

Source: Sundvoll, A Camera-Based Perception System for Autonomous Quadcopter Landing on a Marine Vessel, 2020, sec. 4.3, with
these corrections: the step of eq. 4.16 is t_n - t_{n-1} and uses the velocity and acceleration at its start; the position vector
itself is rotated when the drone turns (eq. 4.18, 4.19), not its increment; time advances on sightings too; a heading of exactly
zero is a valid heading.

Method: the relative motion since the start is summed in axes of fixed heading (an odometer), and a sighting is anchored to the
odometer at its own instant. Propagating a late sighting to the present and rotating the position vector are then one subtraction
and one rotation. The pad is assumed stationary; the covariance includes its possible motion.

Vertical: if the vehicle measures no vertical velocity (AR.Drone), it comes from an alpha-beta filter. The position comes from the
sightings, and the velocity is corrected towards their rate within `vertical_tau_s`. In between the accelerometer drives it, and
without sightings it decays to zero within `vertical_leak_s`. The accelerometer's mean over `vertical_mean_s` is taken for its
bias: nothing accelerates one way for long, and biases of 0.6 m/s^2 are usual. The thesis' section 4.3 takes the means at rest
for the biases, which its code leaves out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from estimator.contracts.estimates import (
    UNKNOWN_YAW_VAR,
    Details,
    FusionResult,
    PathName,
    RelativeState,
    Sighting,
    Verdict,
    uncompared,
)
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Sample
from estimator.contracts.time import MonoNs, seconds_between
from estimator.median_mean import MedianMean
from estimator.options import DeadReckoningOptions, EstimatorOptions
from estimator.paths import Path

_NIS_MAX = 16.27  # Chi-square with 3 degrees of freedom, 99.9 %
_KNOT_S = 0.004  # Least time between two knots of the integrated motion
_VERTICAL_HOLD_S = 0.5  # Time for which a vertical velocity is held
_NOT_MEASURED_VAR = 1e3  # Variance, (m/s)^2, above which a velocity axis counts as not measured


class ArrowHeading(Struct, frozen=True):
    """The heading of the arrow against the same north as the vehicle's own attitude."""

    heading_rad: float
    var: float
    at: MonoNs
    """Measurement instant of the newest sighting with a heading."""
    ambiguous: bool
    """True while no sighting resolved which end of the arrow is its tip."""

    def var_at(self, now: MonoNs, sigma_rate_rad_s: float) -> float:
        """Return the variance, rad^2, at an instant, with the drift of the vehicle's heading since the sighting."""
        drift_s = max(0.0, seconds_between(self.at, now))
        return self.var + (sigma_rate_rad_s * drift_s) ** 2


def heading_after(arrow: ArrowHeading | None, heading_rad: float, sighting: Sighting) -> ArrowHeading | None:
    """Return the arrow after a sighting; as it was if that has no heading.

    Args:
        heading_rad: the vehicle's own heading at the sighting's instant.
    """
    if sighting.yaw_rad is None:
        return arrow
    seen = wrap_pi(heading_rad - sighting.yaw_rad)
    if sighting.yaw_ambiguous and arrow is not None and abs(wrap_pi(seen - arrow.heading_rad)) > math.pi / 2:
        seen = wrap_pi(seen + math.pi)
    ambiguous = sighting.yaw_ambiguous and (arrow is None or arrow.ambiguous)
    return ArrowHeading(seen, float(sighting.cov[3, 3]), sighting.stamp.measured_at, ambiguous)


_NEVER = MonoNs(0)


class _Anchor(Struct, frozen=True, eq=False):
    """The newest sighting, anchored to the odometer at its own instant."""

    t: MonoNs
    d_fixed: F64
    """`d_body_pad_level` rotated to the axes of fixed heading, (3,) m."""
    odo: F64
    heading_rad: float
    cov: F64
    """Covariance of the sighting in its own level axes, (4, 4)."""
    blind_s: float
    """The state's `blind_s` at that instant."""


class DeadReckoning(Struct, frozen=True, eq=False):
    """The belief of dead reckoning. Immutable: `step` returns the next one."""

    options: DeadReckoningOptions
    t: MonoNs | None = None
    """Instant of the odometer."""
    R_ned_body: Rotation | None = None
    heading_rad: float = 0.0
    """Heading of the vehicle's own attitude, unwrapped."""
    v_rel: F64 = field(default_factory=lambda: np.zeros(3))
    """Velocity of the pad minus that of the body, (3,) m/s in level axes."""
    a_rel: F64 = field(default_factory=lambda: np.zeros(3))
    v_t: MonoNs | None = None
    """Instant when the body's velocity was last measured."""
    a_t: MonoNs | None = None
    a_vertical_mean: float = 0.0
    """Slow mean of the accelerometer, m/s^2 downward."""
    a_samples: int = 0
    cov_v: F64 = field(default_factory=lambda: np.zeros((3, 3)))
    vertical_measured: bool = False
    vertical_t: MonoNs | None = None
    """Instant when a pair of sightings last corrected the vertical velocity."""
    odo: F64 = field(default_factory=lambda: np.zeros(3))
    """Sum of the relative motion in axes of fixed heading, (3,) m."""
    blind_s: float = 0.0
    """Total time in which no velocity was known."""
    track: F64 = field(default_factory=lambda: np.zeros((0, 5)))
    """The odometer's recent past, (n, 5): [s since `epoch`, odo (3), heading]."""
    epoch: MonoNs = _NEVER
    anchor: _Anchor | None = None
    arrow: ArrowHeading | None = None
    agreed: tuple[bool, ...] = ()
    """True for each of the last innovations that lay inside the claimed covariance."""

    @staticmethod
    def start(options: DeadReckoningOptions | None = None) -> DeadReckoning:
        """Return a state without any knowledge."""
        return DeadReckoning(options or DeadReckoningOptions())


def step(state: DeadReckoning, event: Sample | Sighting) -> tuple[DeadReckoning, Verdict | None]:
    """Process one sample or one (filtered) sighting.

    A sighting replaces the position, and the heading if it has one; it is propagated from its own instant to the odometer's.
    Kinds of sample without use here are ignored.

    Returns:
        The new state, and for a sighting its verdict: FUSED, TOO_OLD (older than the history or than the last one) or NO_ATTITUDE
        (no attitude to level it with yet); None for samples.
    """
    match event:
        case Sighting():
            return sighted(state, event)
        case Attitude():
            return _attitude(state, event), None
        case BodyVelocity():
            return _velocity(state, event), None
        case Imu():
            return _imu(state, event), None
        case _:
            return state, None


def at(state: DeadReckoning, now: MonoNs) -> RelativeState | None:
    """Return the belief at an instant, past (within the history) or future; None until a first sighting.

    The covariance grows from the sighting's own. Velocity noise, velocity scale, the pad's unknown motion and the heading's drift
    spread the position as if constant since then (an upper bound), so an old sighting has a wide covariance.
    """
    anchor = state.anchor
    if anchor is None or state.t is None:
        return None
    o = state.options
    if now > state.t:
        state = _propagated(state, now, state.t)
        odo, heading = state.odo, state.heading_rad
    else:
        odo, heading = _past(state, now)
    moved = _turned(odo - anchor.odo, -heading)
    d = _turned(anchor.d_fixed, -heading) + moved
    v = _current_v(state, now)
    elapsed_s = max(0.0, seconds_between(anchor.t, now))

    cov = np.zeros((7, 7))
    c, n = math.cos(anchor.heading_rad - heading), math.sin(anchor.heading_rad - heading)
    turn = np.array([[c, -n, 0.0], [n, c, 0.0], [0.0, 0.0, 1.0]])
    cov[:3, :3] = turn.dot(anchor.cov[:3, :3]).dot(turn.T)
    yaw, arrow = None, state.arrow
    if arrow is None:
        cov[6, 6] = UNKNOWN_YAW_VAR
    else:
        yaw = wrap_pi(heading - arrow.heading_rad)
        cov[6, 6] = arrow.var_at(now, o.sigma_heading_rate_rad_s)
        if arrow.at == anchor.t:
            cov[6, :3] = cov[:3, 6] = turn.dot(anchor.cov[:3, 3])

    _spread(cov, _cov_v(state, now), elapsed_s, 1.0)
    blind_s = max(0.0, state.blind_s - anchor.blind_s)
    if blind_s > 0.0 or not _v_is_known(state, now):
        blind = np.diag([1.0, 1.0, float(state.vertical_measured)]) * o.sigma_unknown_v_m_s**2
        _spread(cov, blind, blind_s, 0.0 if _v_is_known(state, now) else 1.0)
    (mx, my, mz), (vx, vy, vz) = moved.tolist(), v.tolist()
    if not state.vertical_measured:
        mz = vz = 0.0
    scale = o.sigma_velocity_scale * np.array([mx, my, mz, vx, vy, vz])
    swing = o.sigma_heading_rate_rad_s * elapsed_s * np.array([d[1], -d[0]])
    cov[:6, :6] += np.multiply.outer(scale, scale)
    cov[:2, :2] += np.multiply.outer(swing, swing)

    return RelativeState(
        at=now,
        path="dead_reckoning",
        d_body_pad_level=d,
        v_pad_level=v,
        yaw_rad=yaw,
        cov=0.5 * (cov + cov.T),
        sighted=anchor.t,
        consistent=2 * sum(state.agreed) >= len(state.agreed),
        details=Details(lambda: _figures(state)),
    )


def _figures(state: DeadReckoning) -> tuple[tuple[str, float], ...]:
    """Return the figures for the records."""
    return (
        ("yaw_ambiguous", float(state.arrow is not None and state.arrow.ambiguous)),
        ("a_vertical_mean_m_s2", state.a_vertical_mean),
    )


def _attitude(state: DeadReckoning, sample: Attitude) -> DeadReckoning:
    heading = sample.R_ned_body.rpy_rad[2]
    if state.R_ned_body is None:
        # The motion summed so far had no heading, and nothing is anchored to it yet.
        fresh = replace(state, t=sample.stamp.measured_at, epoch=sample.stamp.measured_at, track=np.zeros((0, 5)))
        return _knot(replace(fresh, R_ned_body=sample.R_ned_body, heading_rad=heading))
    state = _advance(state, sample.stamp.measured_at)
    turned = wrap_pi(heading - state.heading_rad)
    # Level axes turn with the body, so vectors held in them turn the other way.
    v, a = _turned(state.v_rel, -turned), _turned(state.a_rel, -turned)
    return _knot(replace(state, R_ned_body=sample.R_ned_body, heading_rad=state.heading_rad + turned, v_rel=v, a_rel=a))


def _velocity(state: DeadReckoning, sample: BodyVelocity) -> DeadReckoning:
    if state.v_t is not None and sample.stamp.measured_at < state.v_t:
        return state
    o = state.options
    state = _advance(state, sample.stamp.measured_at)
    v = o.velocity_scale * sample.v_level
    v[np.abs(v) < o.velocity_dead_band_m_s] = 0.0
    measured = np.diag(sample.cov_level) < _NOT_MEASURED_VAR
    cov_v = o.velocity_scale**2 * sample.cov_level
    cov_v[~measured, :] = cov_v[:, ~measured] = 0.0
    return replace(
        state,
        v_rel=np.where(measured, -v, state.v_rel),
        v_t=sample.stamp.measured_at,
        cov_v=cov_v,
        vertical_measured=bool(measured[2]),
    )


def _imu(state: DeadReckoning, sample: Imu) -> DeadReckoning:
    if state.R_ned_body is None or (state.a_t is not None and sample.stamp.measured_at < state.a_t):
        return state
    R_level_body = state.R_ned_body.without_heading()
    state = _advance(state, sample.stamp.measured_at)
    a_body = sample.f_body + R_level_body.inv @ np.array([0.0, 0.0, G_M_S2])
    a = R_level_body @ a_body
    mean, n = state.a_vertical_mean, state.a_samples + 1
    step_s = 0.0 if state.a_t is None else min(seconds_between(state.a_t, sample.stamp.measured_at), state.options.hold_s)
    mean += (a[2] - mean) * max(1.0 / n, 1.0 - math.exp(-step_s / state.options.vertical_mean_s))
    small = np.abs(a) < state.options.acceleration_dead_band_m_s2
    # On the vertical axis the mean is subtracted instead: a dead-band would hide the end of a descent.
    a = np.array([0.0 if small[0] else a[0], 0.0 if small[1] else a[1], a[2] - mean])
    return replace(state, a_rel=-a, a_t=sample.stamp.measured_at, a_vertical_mean=float(mean), a_samples=n)


def sighted(state: DeadReckoning, sighting: Sighting) -> tuple[DeadReckoning, Verdict]:
    """Process one (filtered) sighting, as `step` does."""
    measured_at = sighting.stamp.measured_at
    last = state.anchor
    if state.R_ned_body is None:
        return state, Verdict.NO_ATTITUDE
    if seconds_between(state.epoch, measured_at) < state.track[0, 0] or (last is not None and measured_at <= last.t):
        return state, Verdict.TOO_OLD
    state = _advance(state, measured_at)
    z = sighting.d_body_pad_level
    if last is not None and (before := at(state, measured_at)) is not None:
        innov = z - before.d_body_pad_level
        S = before.cov[:3, :3] + sighting.cov[:3, :3] + 1e-9 * np.eye(3)
        agrees = float(innov @ np.linalg.solve(S, innov)) <= _NIS_MAX
        state = replace(state, agreed=(*state.agreed, agrees)[-5:])
        state = _correct_vertical(state, measured_at, float(innov[2]), seconds_between(last.t, measured_at))
    odo, heading = _past(state, measured_at)
    anchor = _Anchor(
        t=measured_at, d_fixed=_turned(z, heading), odo=odo, heading_rad=heading, cov=sighting.cov, blind_s=state.blind_s
    )
    return replace(state, anchor=anchor, arrow=heading_after(state.arrow, heading, sighting)), Verdict.FUSED


def _correct_vertical(state: DeadReckoning, measured_at: MonoNs, innov_m: float, since_last_s: float) -> DeadReckoning:
    """Correct the vertical velocity towards the sightings' rate, and the odometer's vertical motion since `measured_at`."""
    o = state.options
    if state.vertical_measured or state.t is None:
        return state
    dv = innov_m * (1.0 - math.exp(-since_last_s / o.vertical_tau_s)) / max(since_last_s, o.vertical_tau_s / 10.0)
    dv = max(-2.0, min(2.0, dv))
    track = state.track.copy()
    track[:, 3] += dv * np.maximum(0.0, track[:, 0] - seconds_between(state.epoch, measured_at))
    late_s = max(0.0, seconds_between(measured_at, state.t))
    return replace(
        state,
        v_rel=state.v_rel + np.array([0.0, 0.0, dv]),
        odo=state.odo + np.array([0.0, 0.0, dv * late_s]),
        track=track,
        vertical_t=measured_at,
    )


def _advance(state: DeadReckoning, to: MonoNs) -> DeadReckoning:
    """Propagate the odometer with the held velocity; never backwards."""
    if state.t is None:
        return _knot(replace(state, t=to, epoch=to))
    return _knot(_propagated(state, to, state.t)) if to > state.t else state


def _propagated(state: DeadReckoning, to: MonoNs, since: MonoNs) -> DeadReckoning:
    """Return the state at a later instant than the odometer's, `since`, which the track does not hold."""
    dt = seconds_between(since, to)
    o = state.options
    known_s = _overlap_s(state.v_t, since, to, o.hold_s)
    accelerated_s = min(_overlap_s(state.a_t, since, to, o.hold_s), dt)
    a = state.a_rel
    horizontal = state.v_rel * known_s + 0.5 * a * min(known_s, accelerated_s) ** 2
    delta = np.array([horizontal[0], horizontal[1], 0.0])
    v = state.v_rel + a * min(known_s, accelerated_s)
    if state.vertical_measured:
        delta[2] = horizontal[2]
    else:
        leak_s = dt - _overlap_s(state.vertical_t, since, to, _VERTICAL_HOLD_S)
        keep = math.exp(-leak_s / o.vertical_leak_s)
        vertical_dv = float(np.clip(a[2], -3.0, 3.0)) * accelerated_s
        delta[2] = state.v_rel[2] * (dt - leak_s + o.vertical_leak_s * (1.0 - keep)) + 0.5 * vertical_dv * accelerated_s
        v[2] = (state.v_rel[2] + vertical_dv) * keep
    odo = state.odo + _turned(delta, state.heading_rad)
    return replace(state, t=to, v_rel=v, odo=odo, blind_s=state.blind_s + dt - known_s)


def _overlap_s(measured: MonoNs | None, begin: MonoNs, end: MonoNs, hold_s: float) -> float:
    """Return the seconds of [begin, end] in which a sample of instant `measured` still holds."""
    if measured is None:
        return 0.0
    return max(0.0, min(seconds_between(begin, end), hold_s - seconds_between(measured, begin)))


def _knot(state: DeadReckoning) -> DeadReckoning:
    """Write the odometer to its track, as a new row or over the newest one if that is only slightly older."""
    if state.t is None:
        return state
    now_s = seconds_between(state.epoch, state.t)
    row = np.array([[now_s, *state.odo, state.heading_rad]])
    track = state.track
    if len(track) and (track[-1, 0] == now_s or (len(track) >= 2 and track[-1, 0] - track[-2, 0] < _KNOT_S)):
        track = track[:-1]
    first = int(np.searchsorted(track[:, 0], now_s - state.options.history_s))
    return replace(state, track=np.concatenate([track[first:], row]))


def _past(state: DeadReckoning, when: MonoNs) -> tuple[F64, float]:
    """Return odometer and heading at an instant of the track, clamped to its ends."""
    s, track = seconds_between(state.epoch, when), state.track
    after = int(np.searchsorted(track[:, 0], s, side="right"))
    row = track[min(max(after - 1, 0), len(track) - 1)]
    if 0 < after < len(track):
        later = track[after]
        row = row + (later - row) / (later[0] - row[0]) * (s - row[0])
    return row[1:4], float(row[4])


def _v_is_known(state: DeadReckoning, now: MonoNs) -> bool:
    return state.v_t is not None and seconds_between(state.v_t, now) <= state.options.hold_s


def _current_v(state: DeadReckoning, now: MonoNs) -> F64:
    v = state.v_rel.copy()
    if not _v_is_known(state, now):
        v[:2] = 0.0
        if state.vertical_measured:
            v[2] = 0.0
    return v


def _cov_v(state: DeadReckoning, now: MonoNs) -> F64:
    """Return the (3, 3) covariance, (m/s)^2, of `v_pad_level` from the samples, without the scale error."""
    o = state.options
    cov = state.cov_v + o.sigma_pad_v_m_s**2 * np.diag([1.0, 1.0, float(state.vertical_measured)])
    if not state.vertical_measured:
        # Just corrected, it has the sightings' noise over the time constant; later it grows to that of a drone hovering over a
        # heaving deck.
        correction_age_s = math.inf if state.vertical_t is None else max(0.0, seconds_between(state.vertical_t, now))
        noise = 2.0 * float(state.anchor.cov[2, 2]) / o.vertical_tau_s**2 if state.anchor is not None else 0.0
        cov[2, 2] = noise + o.sigma_vertical_v_m_s**2 * (1.0 - 0.75 * math.exp(-2.0 * correction_age_s / o.vertical_leak_s))
    return np.asarray(cov)


def _spread(cov: F64, cov_v: F64, elapsed_s: float, now: float) -> None:
    """Add the effect of a velocity error over `elapsed_s` on position and (times `now`) on velocity to (7, 7) `cov`.

    The position is as uncertain as by a constant error, an upper bound; half of the velocity's own variance is newer, so that the
    two together are not surer than either.
    """
    cov[:3, :3] += elapsed_s * elapsed_s * cov_v
    if now > 0.0:
        across = 0.5 * elapsed_s * now * cov_v
        cov[:3, 3:6] += across
        cov[3:6, :3] += across
        cov[3:6, 3:6] += now * now * cov_v


def _turned(v: F64, angle_rad: float) -> F64:
    """Rotate a (3,) vector about the down axis."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]])


class DeadReckoningPath(Path):
    """Sightings through the median and mean, then propagated with the drone's own velocity and heading."""

    name: PathName = "dead_reckoning"

    def __init__(self, options: EstimatorOptions) -> None:
        own = options.dead_reckoning
        self._filter = MedianMean()
        self._state = DeadReckoning.start(replace(own, history_s=max(own.history_s, options.max_delay_s)))

    def put(self, samples: Sequence[Sample], *, wanted: bool = True) -> Sequence[FusionResult | None]:
        for sample in samples:
            self._state, _ = step(self._state, sample)
        return super().put(samples)

    def sight(self, sighting: Sighting) -> FusionResult:
        memory, smooth = self._filter.smooth(sighting)
        if smooth is None:
            return uncompared(self.name, sighting, Verdict.TOO_OLD)
        self._filter = memory
        self._state, verdict = sighted(self._state, smooth)
        return uncompared(self.name, sighting, verdict)

    def at(self, now: MonoNs) -> RelativeState | None:
        return at(self._state, now)
