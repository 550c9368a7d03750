"""The guard: it holds the state of all checks, and gives one verdict for each refused input."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct, field, structs

from estimator.contracts.estimates import FusionResult, IntegrityAlert, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import (
    Attitude,
    Baro,
    Baseline,
    BodyVelocity,
    Frame,
    GeoFix,
    GimbalAttitude,
    Imu,
    Range,
    Sample,
    VehicleStatus,
    VesselMotion,
    VesselWind,
)
from estimator.contracts.time import MonoNs
from estimator.integrity import crosschecks, inertial, parity, sensors, tracks
from estimator.integrity.crosschecks import BaselineWatch, HeadingWatch, HeightWatch, ViewWatch
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.sensors import ClockWatch, FrameWatch, SensorWatch
from estimator.integrity.tracks import Arbiter, Place, Tracks

_EVIDENCE_NS = 1_000_000_000
"""Time for which an alert outlives its newest evidence: the silence of a stream is reported by itself."""
_ABOVE_M = 0.3  # Height above the body from which no pad can be: a camera that looks down stands on it at the most
_UNSEEN = SensorWatch()
_UNCHECKED = (GeoFix, GimbalAttitude, VesselMotion, VesselWind, Baseline)
"""Samples whose arrival alone is checked here. Their union, written out, would be made again for each sample."""
_QUICK = (Imu, Attitude, BodyVelocity)  # Samples with a stamp of their own each, many a second
_REPEATS = "the velocity repeats its readings; flying without it"
_SWUNG_SIGMAS = 5.0  # Standard deviations on one axis within which a pad that was swung out of sight is looked for


class IntegrityGuard(Struct, frozen=True):
    """The state of all checks. Immutable."""

    options: IntegrityOptions = field(default_factory=IntegrityOptions)
    clock: ClockWatch = field(default_factory=ClockWatch)
    sensors: Mapping[type, SensorWatch] = field(default_factory=dict)
    frames: FrameWatch = field(default_factory=FrameWatch)
    view: ViewWatch = field(default_factory=ViewWatch)
    tracks: Tracks = field(default_factory=Tracks)
    heights: HeightWatch = field(default_factory=HeightWatch)
    heading: HeadingWatch = field(default_factory=HeadingWatch)
    inertial: inertial.Inertial = field(default_factory=inertial.Inertial)
    arbiter: Arbiter = field(default_factory=Arbiter)
    overruled: int = 0
    """Number of restarts of the filter by the arbiter."""
    trusts_velocity: bool = True
    """False if the newest velocity was refused: no loop is closed on it."""
    flying: bool = True
    """False only after the vehicle reported that it is on the ground."""
    baselines: BaselineWatch = field(default_factory=BaselineWatch)

    @property
    def restarts(self) -> int:
        """Number of restarts of the filter after it had used a faulty sensor."""
        return self.inertial.named + self.overruled

    @property
    def lost(self) -> tuple[str, ...]:
        """The sensors that the estimate does without, in words."""
        seen = self.sensors.get(BodyVelocity)
        repeats = (_REPEATS,) if seen is not None and seen.frozen else ()
        leapt = self.baselines
        off = (f"the RTK baseline is off by {leapt.off_m:.2f} m; flying without it",) if leapt.outvoted else ()
        return *self.inertial.lost, *repeats, *off


def admit(guard: IntegrityGuard, samples: Sequence[Sample]) -> tuple[IntegrityGuard, list[Sample | Verdict]]:
    """Check samples in the order in which they were received.

    Returns:
        The new guard; and for each sample either what may go to the estimator, or the verdict that refuses it. What may go is the
        sample itself, except for an attitude whose heading the gyro contradicts: it has the heading that the gyro holds; and for
        an IMU sample with a lost half: it has a substitute in its place.
    """
    # There are hundreds of samples a second, so what changes is kept in the open until the last of them.
    o, delays, seen = guard.options, dict(guard.clock.delays), dict(guard.sensors)
    watch = ClockWatch(guard.clock.now, guard.clock.rival, delays)
    step_s, settle_s = o.sample_delay_step_max_s, o.sample_delay_settle_s
    turn, against, halves, flying, trusts = guard.heading, guard.heights, guard.inertial, guard.flying, guard.trusts_velocity
    admitted: list[Sample | Verdict] = []
    for sample in samples:
        kind, stamp = type(sample), sample.stamp
        verdict = None
        # One more arrival at the known time changes nothing: the samples of one datagram share theirs.
        name = kind.__name__ if kind is not VesselMotion else f"VesselMotion {sample.sensor}"  # type: ignore[union-attr]
        if stamp.received_at != watch.now or watch.rival is not None:
            watch, verdict = sensors.watch_arrival(watch, name, stamp, o.clock_step_max_s)
            if watch.delays is not delays:  # the time has leapt, and all delays begin again
                delays = dict(watch.delays)
                watch = ClockWatch(watch.now, watch.rival, delays)
        if verdict is None:
            delays[name], verdict = sensors.delay_after(delays.get(name), stamp, step_s, settle_s, quick=kind in _QUICK)
        if verdict is not None:
            trusts = trusts and kind is not BodyVelocity
            admitted.append(verdict)
            continue
        # By the type itself: a match checks one class after the other.
        if isinstance(sample, VehicleStatus):
            flying = sample.flying is not False
        elif not isinstance(sample, _UNCHECKED):
            seen[kind], verdict = sensors.watch_reading(seen.get(kind, _UNSEEN), sample, o, flying)
            if verdict is None:
                if type(sample) is Imu:
                    halves, left = inertial.felt(halves, sample, o, flying)
                    if left is None:
                        verdict = Verdict.FROZEN
                    else:
                        sample = left
                        turn = crosschecks.add_gyro(turn, sample)
                elif type(sample) is Attitude:
                    lying = halves.gyro_fault
                    halves = inertial.levelled(halves, sample, flying)
                    if halves.gyro_fault is not None and lying is None:
                        turn = HeadingWatch()
                    turn, sample = crosschecks.hold_heading(turn, sample, o)
                elif type(sample) is Range:
                    against = crosschecks.add_range(against, sample, o)
                elif type(sample) is Baro:
                    against = crosschecks.add_baro(against, sample, o)
                    halves = structs.replace(halves, parity=parity.weighed(halves.parity, sample))
                elif type(sample) is BodyVelocity:
                    if (moved := parity.moved(halves.parity, sample)) is not halves.parity:
                        halves = structs.replace(halves, parity=moved)
                    verdict = Verdict.IMPOSSIBLE if halves.velocity_fault is not None else None
            if kind is BodyVelocity:
                trusts = verdict is None
        admitted.append(sample if verdict is None else verdict)
    after = IntegrityGuard(
        o, watch, seen, guard.frames, guard.view, guard.tracks, against, turn, halves, guard.arbiter, guard.overruled,
        trusts, flying, guard.baselines,
    )  # fmt: skip
    return after, admitted


def admit_frame(guard: IntegrityGuard, frame: Frame) -> tuple[IntegrityGuard, Verdict | None]:
    """Check one frame before detection; return REPEATED if its pixels were received before."""
    watch, repeated = sensors.watch_frame(guard.frames, frame.px, frame.stamp.received_at)
    return structs.replace(guard, frames=watch), Verdict.REPEATED if repeated else None


def admit_sighting(
    guard: IntegrityGuard, sighting: Sighting, attitude: Attitude | None, belief: RelativeState | None
) -> tuple[IntegrityGuard, Verdict | None]:
    """Check one sighting.

    Args:
        attitude: attitude at its exposure.
        belief: the steering estimate at its exposure, before the sighting.

    Returns:
        The new guard, and IMPOSSIBLE (a pad above, or a view that moves against the body), TOO_OLD or TOO_NEW (its stamp), FROZEN
        (the view), ELSEWHERE (another pad), or None.
    """
    o = guard.options
    if sighting.d_body_pad_level.item(2) < -_ABOVE_M:
        return guard, Verdict.IMPOSSIBLE
    if attitude is not None and guard.tracks.assumed is not None:
        guard = _follow_on(guard, sighting, attitude, guard.tracks.assumed)
    watch, verdict = sensors.watch_arrival(guard.clock, "Sighting", sighting.stamp, o.clock_step_max_s)
    if verdict is None:
        # In flight a slower link cannot be distinguished from stamps that have become wrong.
        keep_s = o.delay_keep_s if guard.flying else math.inf
        watch, verdict = sensors.watch_delay(watch, "Sighting", sighting.stamp, o.delay_step_max_s, o.delay_settle_s, keep_s)
    guard = structs.replace(guard, clock=watch)
    if verdict is not None:
        return guard, verdict
    if attitude is not None and guard.flying:
        guard = structs.replace(guard, view=crosschecks.watch_view(guard.view, sighting, attitude, o))
        if guard.view.frozen or guard.view.reversed:
            return guard, Verdict.FROZEN if guard.view.frozen else Verdict.IMPOSSIBLE
    if attitude is not None and sighting.pose6 is not None and not sighting.yaw_ambiguous:
        guard = structs.replace(guard, inertial=_pictured(guard, sighting, attitude))
    expected = None if belief is None else _place(sighting, attitude, belief)
    place = _place(sighting, attitude)
    if guard.tracks.assumed is not None and guard.tracks.last is not None and guard.tracks.last.t == place.t:
        guard = structs.replace(guard, tracks=guard.tracks._replace(last=place, assumed=None))
    following, explained = tracks.associate(guard.tracks, place, expected, o)
    swung = expected if belief is not None and belief.adrift else None
    if not explained and swung is not None and math.dist(swung.d[:2], place.d[:2]) <= _SWUNG_SIGMAS * swung.sigma_m:
        following, explained = Tracks(following.number, 0, place), True
    # The arbiter's doubt grows while it takes nothing, and would come to reach where the picture leapt to.
    if not explained and (following.leapt or not guard.arbiter.explains(place)):
        return structs.replace(guard, tracks=following), Verdict.ELSEWHERE
    seen = tracks.arbitrate(guard.arbiter, place)
    if belief is not None and expected is not None and seen.t == place.t and not seen.misses:
        v = _fixed(belief.v_pad_level, attitude)
        seen = tracks.compare_estimate(seen, expected.d, v, tuple(belief.cov.diagonal()[:6].tolist()))
    if explained:
        guard = structs.replace(guard, tracks=following)
    return structs.replace(guard, arbiter=seen), None


def follow(guard: IntegrityGuard, sighting: Sighting, assumed: Attitude, alone_in: F64 | None = None) -> IntegrityGuard:
    """Take note of where a frame without an attitude shows the pad: it may show that this is still the tracked one.

    Args:
        assumed: the attitude that levelled the sighting.
        alone_in: corners, (4, 2) m in `level`, of the deck that the frame shows with no second pad, as `tracks.follow`.
    """
    corners = None if alone_in is None else _corners(alone_in, assumed)
    return _following(guard, _place(sighting, assumed), assumed, corners)


def asks_clear(guard: IntegrityGuard, sighting: Sighting, attitude: Attitude) -> bool:
    """Return whether `cleared` has to know if a second pad is in the frame."""
    return tracks.asks_clear(guard.tracks, _place(sighting, attitude))


def cleared(guard: IntegrityGuard, sighting: Sighting, attitude: Attitude, alone_in: F64) -> IntegrityGuard:
    """Take note of whether a frame shows a second pad beside the tracked one, which was fused; arguments as of `follow`."""
    return structs.replace(guard, tracks=tracks.cleared(guard.tracks, _place(sighting, attitude), _corners(alone_in, attitude)))


def _corners(alone_in: F64, attitude: Attitude) -> F64:
    return np.array([_fixed(np.array([x, y, 0.0]), attitude)[:2] for x, y in alone_in.tolist()]).reshape(-1, 2)


def asks_alone(guard: IntegrityGuard, sighting: Sighting, assumed: Attitude) -> bool:
    """Return whether `follow` has to know if a second pad is in the frame."""
    return tracks.asks_alone(guard.tracks, _place(sighting, assumed), guard.options)


def _follow_on(guard: IntegrityGuard, sighting: Sighting, attitude: Attitude, assumed: Attitude) -> IntegrityGuard:
    """Follow the pad into a frame with an attitude, by the one that was assumed before: the true one moves its place at once."""
    d_body = attitude.R_ned_body.without_heading().inv @ sighting.d_body_pad_level
    x, y, z = (assumed.R_ned_body @ d_body).tolist()
    return _following(guard, _place(sighting, attitude)._replace(d=(x, y, z)), assumed)


def _following(guard: IntegrityGuard, place: Place, assumed: Attitude, alone_in: F64 | None = None) -> IntegrityGuard:
    following = tracks.follow(guard.tracks, place, assumed, guard.options, alone_in)
    return guard if following is None else structs.replace(guard, tracks=following)


def excludes(belief: RelativeState, sighting: Sighting, o: IntegrityOptions) -> bool:
    """Return whether a belief at the exposure excludes the place of a sighting: it is not the tracked pad's, maybe another's."""
    # Both are written in the same `level`, so that no heading is needed.
    return tracks.is_apart(_place(sighting, None, belief), _place(sighting, None), o)


def judged(guard: IntegrityGuard, sighting: Sighting, attitude: Attitude | None, is_fused: bool) -> IntegrityGuard:
    """Record whether the steering estimator fused a sighting that had passed."""
    place = _place(sighting, attitude)
    seen = tracks.record_fused(guard.arbiter, place.t, is_fused)
    felt = guard.inertial
    if attitude is not None:
        felt = structs.replace(felt, parity=parity.sighted(felt.parity, place.t, place.d, sighting.yaw_rad))
    guard = structs.replace(guard, arbiter=seen, inertial=felt)
    if seen.overrules:
        followed = guard.tracks._replace(number=guard.tracks.number + seen.leapt)
        guard = structs.replace(guard, overruled=guard.overruled + 1, arbiter=tracks.restarted(seen), tracks=followed)
    if not is_fused:
        return guard
    guard = structs.replace(
        guard, tracks=tracks.add_fused(guard.tracks, place), baselines=structs.replace(guard.baselines, pictured=place.t)
    )
    if attitude is None:
        return guard
    return structs.replace(guard, heights=crosschecks.add_sighting(guard.heights, sighting, attitude.R_ned_body))


def baseline_judged(
    guard: IntegrityGuard, result: FusionResult, sigma_m: float, belief: RelativeState | None, attitude: Attitude | None
) -> IntegrityGuard:
    """Record what the steering estimator made of a baseline; one that it fused keeps the tracked pad the tracked one.

    Args:
        sigma_m: the baseline's largest standard deviation on one axis.
        belief: the steering estimate at its instant, with it.
    """
    guard = structs.replace(guard, baselines=crosschecks.baseline_compared(guard.baselines, result, sigma_m))
    if result.verdict is not Verdict.FUSED or belief is None or attitude is None or belief.sighted != result.measured_at:
        return guard
    place = Place(int(result.measured_at), _fixed(belief.d_body_pad_level, attitude), *_sigmas(belief.cov))
    if guard.tracks.last is None:
        return structs.replace(guard, tracks=tracks.Tracks(1, 0, place))
    if guard.baselines.contradicts:
        return guard
    return structs.replace(guard, tracks=tracks.add_fused(guard.tracks, place))


def alerts(guard: IntegrityGuard, now: MonoNs) -> tuple[IntegrityAlert, ...]:
    """Return the reasons not to descend by the estimate.

    Each stands for a second after its newest evidence: what a witness said that has died since, nothing could take back.
    """
    return tuple([alert for alert, at in _accused(guard) if now - at <= _EVIDENCE_NS])


def _accused(guard: IntegrityGuard) -> list[tuple[IntegrityAlert, int]]:
    """Return what is accused, with the instant of the newest evidence, ns."""
    seen, stamps, heights, disputed_at = guard.view, guard.clock, guard.heights, guard.tracks.disputed_at
    off = [stamps.at(kind) for kind in ("Sighting", "Imu", "Attitude") if stamps.off(kind)]
    each = (
        (guard.frames.frozen, IntegrityAlert.CAMERA_FROZEN, guard.frames.at),
        (seen.frozen, IntegrityAlert.VIEW_FROZEN, seen.at),
        (seen.reversed, IntegrityAlert.VIEW_REVERSED, seen.at),
        (seen.late_s != 0.0, IntegrityAlert.IMU_LATE, seen.at),
        (_is_frozen(guard, Imu), IntegrityAlert.IMU_FROZEN, stamps.at(Imu.__name__)),
        (_is_frozen(guard, Attitude), IntegrityAlert.ATTITUDE_FROZEN, stamps.at(Attitude.__name__)),
        (guard.inertial.attitude_fault is not None, IntegrityAlert.ATTITUDE, stamps.at(Attitude.__name__)),
        (bool(off), IntegrityAlert.STAMPS, max(off, default=0)),
        (guard.arbiter.apart, IntegrityAlert.APART, guard.arbiter.t),
        (disputed_at is not None, IntegrityAlert.ELSEWHERE, disputed_at or 0),
        (guard.baselines.undecided, IntegrityAlert.BASELINE, guard.baselines.t),
        (heights.contradicted, IntegrityAlert.RANGE, heights.ranged_at),
        (heights.baro_contradicted, IntegrityAlert.HEIGHT, heights.weighed_at),
    )
    return [(alert, at) for is_so, alert, at in each if is_so]


def _is_frozen(guard: IntegrityGuard, kind: type[Imu | Attitude]) -> bool:
    watched = guard.sensors.get(kind)
    return watched is not None and watched.frozen


def _pictured(guard: IntegrityGuard, sighting: Sighting, attitude: Attitude) -> inertial.Inertial:
    """Process the pad's rotation, of whatever pad on the deck."""
    state, at = guard.inertial, sighting.stamp.measured_at
    if sighting.pose6 is None:
        return state
    R_ned_level = Rotation.from_rpy(0.0, 0.0, attitude.R_ned_body.rpy_rad[2])
    R_ned_pad = (R_ned_level @ sighting.pose6.R_level_pad).matrix
    off = next((off for since, off in reversed(guard.heading.offs) if since <= at), 0.0)
    seen = parity.pictured(state.parity, at, attitude.R_ned_body.matrix, R_ned_pad, off)
    return structs.replace(state, parity=seen)


def _place(sighting: Sighting, attitude: Attitude | None, belief: RelativeState | None = None) -> Place:
    """Return the place of the pad as the sighting has it, or as the belief has it at the same instant."""
    by = sighting if belief is None else belief
    return Place(sighting.stamp.measured_at, _fixed(by.d_body_pad_level, attitude), *_sigmas(by.cov))


def _sigmas(cov: F64) -> tuple[float, float]:
    """Return the standard deviations of one horizontal component and of the vertical one, m."""
    forward, right, down = cov.diagonal()[:3].tolist()
    return math.sqrt(max(0.0, forward + right) / 2.0), math.sqrt(max(0.0, down))


def _fixed(d_level: F64, attitude: Attitude | None) -> tuple[float, float, float]:
    """Rotate from the level frame to one of fixed heading, as far as a heading is known."""
    x, y, z = d_level.tolist()
    heading_rad = 0.0 if attitude is None else attitude.R_ned_body.rpy_rad[2]
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return (c * x - s * y, s * x + c * y, z)
