"""The entry point of the estimator: `step(memory, event) -> memory, results`, `step_samples`, and `belief(memory, now)`.

The guard (`estimator.integrity`) runs before any path: an input that is not fresh, not possible or not about the tracked pad
reaches no path and gets a verdict of its own. Several paths can run on the same events; one steers, and the others are for
comparison.
"""

import math
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec

import numpy as np
from msgspec import Struct, field, structs

from estimator import dead_reckoning, ekf, filters, integrity
from estimator.attitude_history import AttitudeHistory
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Details, PathName, RelativeState, Sighting, Verdict
from estimator.contracts.fusion import FusionResult, source_of
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import (
    Attitude,
    Baro,
    BodyVelocity,
    Frame,
    GimbalAttitude,
    Imu,
    Range,
    Sample,
    VehicleStatus,
    VesselReport,
)
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf import Forecast
from estimator.gimbal_history import GimbalHistory, HeldCamera
from estimator.late import Late
from estimator.options import EstimatorOptions
from estimator.paths import DeadReckoningPath, EkfPath, Event, MedianMeanPath, Path

_MOMENT_S = 1.0
"""Longest time since a pad was seen after which a frame without an attitude is looked at for it."""
_ASSUMED_RAD = 0.1
"""Standard deviation of an assumed attitude, about each axis."""


class Memory(Struct, frozen=True):
    """The state of the whole estimator. Immutable."""

    options: EstimatorOptions
    attitudes: AttitudeHistory
    paths: tuple[Path, ...]
    """The paths; the first one steers."""
    guard: integrity.IntegrityGuard = field(default_factory=integrity.IntegrityGuard)
    gimbal: GimbalHistory = GimbalHistory()


def start(options: EstimatorOptions, shadows: Sequence[PathName] = ()) -> Memory:
    """Return an estimator without any input.

    Args:
        shadows: paths that run for comparison and never steer.

    Raises:
        BadInput: a path needs a library that is not installed.
    """
    names = (options.path, *(name for name in shadows if name != options.path))
    paths = tuple(_path(name, options) for name in names)
    return Memory(options, AttitudeHistory(options.history_s), paths, integrity.IntegrityGuard(options.integrity))


def on_frame(memory: Memory, frame: Frame) -> tuple[Memory, Verdict | None]:
    """Check one frame before vision processes it; return REPEATED if it shows nothing new, else None."""
    guard, verdict = integrity.admit_frame(memory.guard, frame)
    return structs.replace(memory, guard=guard), verdict


def step(memory: Memory, event: Event) -> tuple[Memory, tuple[FusionResult, ...]]:
    """Process one event; return the new memory and its results, path by path.

    A sighting gives one result for each path. A sample gives one result for each path that uses it, and one for each path if it
    is refused before the paths.
    """
    if isinstance(event, Sighting):
        return _sighted(memory, event)
    memory, (results,) = step_samples(memory, (event,))
    return memory, results


def step_seen(memory: Memory, tracked: Sighting, elsewhere: Sighting) -> tuple[Memory, tuple[FusionResult, ...]]:
    """Process a frame that shows the tracked pad where the belief expects it, and more clearly a pad in a place that it excludes.

    The guard judges the clearer one first. If that is another pad by the guard, too, the guard remembers it, and the tracked one
    is processed.

    Returns:
        The new memory, and the results of the one that counts, path by path.
    """
    after, results = step(memory, elsewhere)
    if results[0].verdict is not Verdict.ELSEWHERE or _refusal(memory.options, tracked) is not None:
        return after, results
    # The bearing of another pad, which may lie anywhere, says nothing about whether the view is frozen.
    guard = structs.replace(after.guard, view=memory.guard.view)
    return step(structs.replace(after, guard=guard), tracked)


def step_samples(memory: Memory, samples: Sequence[Sample]) -> tuple[Memory, Sequence[tuple[FusionResult, ...]]]:
    """Process the samples of one datagram, or all that wait; return the new memory and each sample's results, path by path.

    Memory and results are those of `step` with one sample after the other.
    """
    guard, admitted = integrity.admit(memory.guard, samples)
    passed = [sample for sample in admitted if not isinstance(sample, Verdict)]
    attitudes = memory.attitudes.add(*[s for s in passed if type(s) is Attitude])
    gimbal = memory.gimbal.add(*[s for s in passed if type(s) is GimbalAttitude])
    paths = memory.paths if guard.restarts == memory.guard.restarts else _begun_again(memory)
    stepped = [path.step_samples(passed) for path in paths]
    by_path = [results for _, results in stepped]
    after = Memory(memory.options, attitudes, tuple([path for path, _ in stepped]), guard, gimbal)
    if len(passed) == len(samples) and len(by_path) == 1:
        return after, Late(len(samples), partial(_alone, by_path[0]))
    names = [path.name for path in memory.paths]
    return after, Late(len(samples), partial(_by_sample, names, samples, admitted, by_path))


def _alone(of_path: Sequence[FusionResult | None]) -> list[tuple[FusionResult, ...]]:
    """Return each sample's results from those of the only path."""
    return [() if r is None else (r,) for r in of_path]


def _by_sample(
    names: list[PathName],
    samples: Sequence[Sample],
    admitted: list[Sample | Verdict],
    by_path: list[Sequence[FusionResult | None]],
) -> list[tuple[FusionResult, ...]]:
    """Return each sample's results, path by path.

    Args:
        names: the names of the paths.
        admitted: what the guard made of each sample.
        by_path: of each path the results of the samples that passed.
    """
    by_sample = zip(*by_path, strict=True)
    return [
        _refused(names, sample, found) if isinstance(found, Verdict) else tuple([r for r in next(by_sample) if r is not None])
        for sample, found in zip(samples, admitted, strict=True)
    ]


def _sighted(memory: Memory, sighting: Sighting) -> tuple[Memory, tuple[FusionResult, ...]]:
    attitude, guard = attitude_at(memory, sighting.stamp), memory.guard
    refusal = _refusal(memory.options, sighting)
    if refusal is None:
        before = memory.paths[0].at(sighting.stamp.measured_at)
        guard, refusal = integrity.admit_sighting(guard, sighting, attitude, before)
    if refusal is not None:
        return structs.replace(memory, guard=guard), _refused([path.name for path in memory.paths], sighting, refusal)
    paths, results = zip(*[path.step(sighting) for path in memory.paths], strict=True)
    judged = integrity.judged(guard, sighting, attitude, results[0].verdict is Verdict.FUSED)
    after = Memory(memory.options, memory.attitudes, paths, judged, memory.gimbal)
    return (after if judged.restarts == guard.restarts else structs.replace(after, paths=_begun_again(after))), results


def _begun_again(memory: Memory) -> tuple[Path, ...]:
    """Return the paths with the filter begun again: its state was made with a faulty sensor."""
    return tuple([_path(path.name, memory.options) if path.name == "ekf" else path for path in memory.paths])


def _refused(names: list[PathName], event: Event, verdict: Verdict) -> tuple[FusionResult, ...]:
    """Return the results of an event that reaches none of the paths of these names."""
    source, stamp = source_of(event), event.stamp
    return tuple([FusionResult(name, source, verdict, stamp.measured_at, stamp.received_at) for name in names])


def steer_by(memory: Memory, name: PathName) -> Memory:
    """Return the memory with another path steering; the previous one continues as a shadow.

    A path that did not run before starts empty and first has to see the pad.

    Raises:
        ValueError: there is no such path.
        BadInput: it needs a library that is not installed.
    """
    chosen = next((path for path in memory.paths if path.name == name), None) or _path(name, memory.options)
    others = tuple(path for path in memory.paths if path.name != name)
    return structs.replace(memory, options=structs.replace(memory.options, path=name), paths=(chosen, *others))


def belief(memory: Memory, now: MonoNs) -> RelativeState | None:
    """Return the steering path's belief, with its track number and its alerts."""
    state = memory.paths[0].at(now)
    return None if state is None else _dressed(state, memory.guard, now)


def beliefs(memory: Memory, now: MonoNs) -> tuple[RelativeState, ...]:
    """Return every path's belief; the steering path's comes first if it has one."""
    return tuple(_dressed(state, memory.guard, now) for path in memory.paths if (state := path.at(now)) is not None)


def motion(memory: Memory, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
    """Return the motion of body and deck by the steering path; None for what it does not estimate or does not know yet."""
    return memory.paths[0].motion(now)


def forecast(memory: Memory, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
    """Return the deck at these times, s, after an instant by the steering path; None if it does not forecast."""
    return memory.paths[0].forecast(now, horizons_s)


def attitude_at(memory: Memory, stamp: Stamp) -> Attitude | None:
    """Return the attitude at the instant a frame was exposed; None if no sample covers it."""
    return memory.attitudes.at(stamp.measured_at, stamp)


def assumed_at(memory: Memory, stamp: Stamp) -> Attitude | None:
    """Return what to assume for a frame that no attitude covers, so that it may show that the pad has not left the picture.

    That is the newest attitude, hardly known. None if the pad was not seen a moment before: it cannot be known again then.
    """
    tracks, samples = memory.guard.tracks, memory.attitudes.samples
    if tracks.last is None or not samples or not 0 < stamp.measured_at - tracks.last.t <= _MOMENT_S * 1e9:
        return None
    newest = tracks.assumed or samples[-1]
    return Attitude(stamp, newest.R_ned_body, _ASSUMED_RAD**2 * np.eye(3))


def place_to_look(memory: Memory, assumed: Attitude) -> RelativeState | None:
    """Return where a frame without an attitude is expected to show the pad: where it was a moment before."""
    at, last = assumed.stamp.measured_at, memory.guard.tracks.last
    believed = memory.paths[0].at(at)
    if believed is None or last is None:
        return None
    away_m = math.hypot(*last.d)
    var = [(0.03 + 0.02 * away_m) ** 2] * 3
    d = Rotation.from_rpy(0.0, 0.0, assumed.R_ned_body.rpy_rad[2]).inv @ np.array(last.d)
    cov = np.diag([*var, 1.0, 1.0, 1.0, 0.1**2])
    return RelativeState(at, believed.path, d, np.zeros(3), believed.yaw_rad, cov, MonoNs(last.t), True)


def follow(memory: Memory, sighting: Sighting, assumed: Attitude, alone_in: F64 | None = None) -> Memory:
    """Take note of a sighting in a frame that no attitude covers. It is not fused: it tells which pad is seen, and not where.

    Args:
        assumed: the attitude that levelled it.
        alone_in: as `Detection.alone_in` has it.
    """
    if _refusal(memory.options, sighting) is not None:
        return memory
    return structs.replace(memory, guard=integrity.follow(memory.guard, sighting, assumed, alone_in))


def asks_alone(memory: Memory, sighting: Sighting, assumed: Attitude) -> bool:
    """Return whether `follow` has to know if a second pad is in the frame: that costs a search."""
    return _refusal(memory.options, sighting) is None and integrity.asks_alone(memory.guard, sighting, assumed)


def held_at(memory: Memory, stamp: Stamp, attitude: Attitude) -> HeldCamera | None:
    """Return how the camera's gimbal held it at the instant of an exposure; None if no report of the gimbal covers it.

    Args:
        attitude: the vehicle's at that instant.
    """
    return memory.gimbal.at(stamp, attitude)


def _dressed(state: RelativeState, guard: integrity.IntegrityGuard, now: MonoNs) -> RelativeState:
    def details() -> tuple[tuple[str, float], ...]:
        agrees = float(guard.heights.confirmed(now))
        return *state.details, ("range_agrees", agrees), ("heading_off_rad", guard.heading.off_rad)

    return state.marked(guard.tracks.number, integrity.alerts(guard, now), guard.lost, Details(details))


def _refusal(options: EstimatorOptions, sighting: Sighting) -> Verdict | None:
    if sighting.stamp.delay_s > options.max_delay_s:
        return Verdict.TOO_OLD
    if sighting.confidence < options.min_confidence:
        return Verdict.LOW_CONFIDENCE
    return None


def _path(name: PathName, options: EstimatorOptions) -> Path:
    match name:
        case "median_mean":
            return MedianMeanPath(filters.MedianMean(options.max_gap_s))
        case "dead_reckoning":
            own = options.dead_reckoning
            reckoning = structs.replace(own, history_s=max(own.history_s, options.max_delay_s))
            return DeadReckoningPath(filters.MedianMean(options.max_gap_s), dead_reckoning.DeadReckoning.start(reckoning))
        case "ekf":
            return EkfPath(ekf.start(options.ekf, limits=None))
        case "constant_velocity":
            require_filterpy(f"the path {name}")
            from estimator.constant_velocity import ConstantVelocityPath

            return ConstantVelocityPath(AttitudeHistory(options.history_s), options.max_gap_s)
        case _:
            raise ValueError(f"no such estimator path: {name}")


def require_filterpy(wanted: str) -> None:
    """Refuse what is wanted where filterpy is not installed.

    Raises:
        BadInput: it is not; the message says how to install it.
    """
    if find_spec("filterpy") is None:
        raise BadInput(
            f"{wanted} needs filterpy, which is not installed: install requirements/compare.txt, or the extra decklander[compare]"
        )


class RelativeEstimator:
    """Fuse sightings of the pad with the vehicle's sensors. Events may come late and in any order.

    Each `on_` method takes one event and returns what became of it: `Verdict.FUSED`, or the reason why it was refused. A refusal
    leaves the estimate as it was. An event that the chosen path has no use for returns None.

    Args:
        options: every number of the estimator; None for the defaults, which suit an AR.Drone 2.0 over a small vessel.
    """

    def __init__(self, options: EstimatorOptions | None = None) -> None:
        self._memory = start(options or EstimatorOptions())
        self._newest: MonoNs | None = None

    def on_imu(self, imu: Imu) -> Verdict | None:
        """Take one IMU sample: rates in rad/s and specific force in m/s^2, in `body`."""
        return self._step(imu)

    def on_attitude(self, attitude: Attitude) -> Verdict | None:
        """Take the vehicle's own attitude. Send one before the first sighting, which is otherwise refused with NO_ATTITUDE."""
        return self._step(attitude)

    def on_velocity(self, velocity: BodyVelocity) -> Verdict | None:
        """Take a velocity over the ground, m/s in `level`."""
        return self._step(velocity)

    def on_range(self, distance: Range) -> Verdict | None:
        """Take a distance along the body's down axis, m."""
        return self._step(distance)

    def on_baro(self, height: Baro) -> Verdict | None:
        """Take a barometric height, m."""
        return self._step(height)

    def on_vessel(self, report: VesselReport) -> Verdict | None:
        """Take what the vessel reports of its own motion."""
        return self._step(report)

    def on_status(self, status: VehicleStatus) -> Verdict | None:
        """Take the vehicle's status. Readings that do not change count as frozen only while the vehicle says that it flies."""
        return self._step(status)

    def on_sighting(self, sighting: Sighting) -> Verdict | None:
        """Take what `PadTracker.track` found; its stamp says when the image was exposed."""
        return self._step(sighting)

    def attitude_at(self, stamp: Stamp) -> Attitude | None:
        """Return the attitude at the instant of an exposure, for `PadTracker.track`; None when no sample covers it."""
        return attitude_at(self._memory, stamp)

    def at(self, instant: MonoNs) -> RelativeState | None:
        """Return the estimate at an instant, carried on from the newest event before it; None while no pad has been seen."""
        return belief(self._memory, instant)

    @property
    def state(self) -> RelativeState | None:
        """The estimate at the newest instant of any event; None while no pad has been seen."""
        return None if self._newest is None else self.at(self._newest)

    def _step(self, event: Event) -> Verdict | None:
        self._memory, outcomes = step(self._memory, event)
        verdict = outcomes[0].verdict if outcomes else None
        if verdict in (Verdict.FUSED, None):
            self._newest = max(self._newest or event.stamp.measured_at, event.stamp.measured_at)
        return verdict
