"""The one door to the estimator: daemon, simulator, replay, ROS and users of the library call the same `RelativeEstimator`.

The guard (`estimator.integrity`) runs before any path: an input that is not fresh, not possible or not about the tracked pad
reaches no path and gets a verdict of its own. Several paths can run on the same events; one steers, and the others are for
comparison.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
from msgspec import structs

from estimator.attitude_history import AttitudeHistory, GimbalHistory, HeldCamera
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Details, FusionResult, PathName, RelativeState, Sighting, Verdict, uncompared
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import (
    Attitude,
    Baro,
    Baseline,
    BodyVelocity,
    Frame,
    GimbalAttitude,
    Imu,
    Range,
    Sample,
    VehicleStatus,
    VesselMotion,
    VesselReport,
)
from estimator.contracts.tables import imported
from estimator.contracts.time import MonoNs, Stamp, after
from estimator.ekf import Forecast
from estimator.integrity import guard as integrity
from estimator.lens_watch import LensWatch
from estimator.options import EstimatorOptions
from estimator.paths import EkfPath, Event, Path
from estimator.ship_motion import ShipMotion, ShipMotionOptions

if TYPE_CHECKING:
    from estimator.vision.camera.camera import Camera
    from estimator.vision.camera.rolling import CameraMotion

_MOMENT_S = 1.0  # Longest time since a pad was seen after which a frame without an attitude is looked at for it
_ASSUMED_RAD = 0.1  # Standard deviation of an assumed attitude, about each axis
_READOUT_LEAST_S = 0.01
"""Least time to either side of an exposure over which a rotation is taken, s: over a shorter one it is noise."""
_COMPARED: Mapping[PathName, str] = {
    "median_mean": "estimator.median_mean:MedianMeanPath",
    "dead_reckoning": "estimator.dead_reckoning:DeadReckoningPath",
    "constant_velocity": "estimator.constant_velocity:ConstantVelocityPath",
}
"""The paths beside the filter, each by a function of the options, loaded where settings want it."""


class RelativeEstimator:
    """Fuse sightings of the pad with the vehicle's sensors. Events may come late and in any order.

    `put` takes events and returns what became of each; `on_imu`, `on_attitude` and so on take one. A refusal leaves the estimate
    as it was. One thread at a time may use an estimator: whoever works on another thread gets an answer that was taken before.

    Args:
        options: every number of the estimator; None for the defaults, which suit an AR.Drone 2.0 over a small vessel.
        shadows: paths that run for comparison and never steer.
        motion_sensor: the ship's motion sensor; None for one at the pad.

    Attributes:
        ship_motion: what the ship's motion sensors report, and what they are worth.
        guard: what checks events before they reach any path. It is immutable: each event makes another one.

    Raises:
        BadInput: a path, or a library that it needs, is not installed.
    """

    def __init__(
        self,
        options: EstimatorOptions | None = None,
        shadows: Sequence[PathName] = (),
        motion_sensor: ShipMotionOptions | None = None,
    ) -> None:
        self._options, self._motion_sensor = options or EstimatorOptions(), motion_sensor
        names = (self._options.path, *(name for name in shadows if name != self._options.path))
        self._paths = [_path(name, self._options) for name in names]
        self._lens = LensWatch(self._options)
        self._attitudes = AttitudeHistory(self._options.history_s)
        self._gimbal = GimbalHistory()
        self._exposed: Attitude | None = None
        self._newest: MonoNs | None = None
        self.guard: integrity.IntegrityGuard = integrity.IntegrityGuard(self._options.integrity)
        self.ship_motion: ShipMotion = ShipMotion(motion_sensor or ShipMotionOptions(), self._options.ekf.pad_yaw_in_vessel_rad)

    @property
    def path(self) -> PathName:
        """The path to steer by."""
        return self._paths[0].name

    @property
    def paths(self) -> list[PathName]:
        """The paths that run, the steering one first."""
        return [path.name for path in self._paths]

    @property
    def lost(self) -> tuple[str, ...]:
        """The sensors that the estimate does without, in words."""
        return (*self.guard.lost, *self.ship_motion.lost) if self.ship_motion.reports else self.guard.lost

    def on_imu(self, imu: Imu) -> Verdict | None:
        """Take one IMU sample: rates in rad/s and specific force in m/s^2, in `body`."""
        return self._verdict_of(imu)

    def on_attitude(self, attitude: Attitude) -> Verdict | None:
        """Take the vehicle's own attitude. Send one before the first sighting, which is otherwise refused with NO_ATTITUDE."""
        return self._verdict_of(attitude)

    def on_velocity(self, velocity: BodyVelocity) -> Verdict | None:
        """Take a velocity over the ground, m/s in `level`."""
        return self._verdict_of(velocity)

    def on_range(self, distance: Range) -> Verdict | None:
        """Take a distance along the body's down axis, m."""
        return self._verdict_of(distance)

    def on_baro(self, height: Baro) -> Verdict | None:
        """Take a barometric height, m."""
        return self._verdict_of(height)

    def on_vessel(self, report: VesselReport) -> Verdict | None:
        """Take what the vessel reports of its own motion."""
        return self._verdict_of(report)

    def on_status(self, status: VehicleStatus) -> Verdict | None:
        """Take the vehicle's status. Readings that do not change count as frozen only while the vehicle says that it flies."""
        return self._verdict_of(status)

    def on_sighting(self, sighting: Sighting) -> Verdict | None:
        """Take what `PadTracker.track` found; its stamp says when the image was exposed."""
        return self._verdict_of(sighting)

    def put(self, events: Sequence[Event], *, wanted: bool = True) -> list[tuple[FusionResult, ...]]:
        """Process samples and sightings in the order in which they were received; return the results of each, path by path.

        A sighting has one result for each path. A sample has one for each path that uses it, and one for each path if it is
        refused before the paths. They are those of one event after the other; of samples none is made unless `wanted`.
        """
        results: list[tuple[FusionResult, ...]] = []
        samples: list[Sample] = []
        for event in events:
            if not isinstance(event, (Sighting, Baseline)):
                samples.append(event)
                continue
            results += self._put_samples(samples, wanted)
            made = self._sight(event) if isinstance(event, Sighting) else self._put_baseline(event)
            if wanted or isinstance(event, Sighting):
                results.append(made)
            samples = []
        return results + self._put_samples(samples, wanted)

    def put_seen(
        self, tracked: Sighting | None, elsewhere: Sighting | None, alone_in: F64 | None = None
    ) -> tuple[FusionResult, ...]:
        """Process what one frame shows: the tracked pad, or more clearly a pad in a place that the estimate excludes, or both.

        The guard judges the clearer one first. If that is another pad by the guard, too, the guard remembers it, and the tracked
        one is processed.

        Args:
            alone_in: as `Detection.alone_in` has it.

        Returns:
            The results of the one that counts, path by path; empty if no pad was seen.
        """
        sighting = tracked or elsewhere
        if sighting is None:
            return ()
        if tracked is None or elsewhere is None:
            results = self._sight(sighting)
            attitude = self.attitude_at(sighting.stamp)
            if alone_in is not None and attitude is not None and results[0].verdict is Verdict.FUSED:
                self.guard = integrity.cleared(self.guard, sighting, attitude, alone_in)
            return results
        view = self.guard.view
        results = self._sight(elsewhere)
        if results[0].verdict is not Verdict.ELSEWHERE or _refusal(self._options, tracked) is not None:
            return results
        # The bearing of another pad, which may lie anywhere, says nothing about whether the view is frozen.
        self.guard = structs.replace(self.guard, view=view)
        return self._sight(tracked)

    def admit(self, frame: Frame) -> Verdict | None:
        """Check one frame before vision processes it; return REPEATED if it shows nothing new, else None."""
        self.guard, verdict = integrity.admit_frame(self.guard, frame)
        return verdict

    def restarted(self) -> RelativeEstimator:
        """Return an estimator of the same options and paths that has received nothing."""
        return RelativeEstimator(self._options, self.paths, self._motion_sensor)

    def retune(self, *, min_confidence: float, max_delay_s: float) -> None:
        """Use other settings from now on."""
        self._options = structs.replace(self._options, min_confidence=min_confidence, max_delay_s=max_delay_s)

    def at(self, instant: MonoNs) -> RelativeState | None:
        """Return the steering path's estimate at an instant, with its track number and its alerts.

        It is carried on from the newest event before the instant; None while no pad has been seen.
        """
        state = self._paths[0].at(instant)
        return None if state is None else self._dressed(state, instant)

    def all_at(self, instant: MonoNs) -> tuple[RelativeState, ...]:
        """Return every path's estimate; the steering path's comes first if it has one."""
        return tuple(self._dressed(state, instant) for path in self._paths if (state := path.at(instant)) is not None)

    @property
    def state(self) -> RelativeState | None:
        """The estimate at the newest instant of any event; None while no pad has been seen."""
        return None if self._newest is None else self.at(self._newest)

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the motion of body and deck by the steering path; None for what it does not estimate or does not know yet."""
        return self._paths[0].motion(now)

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        """Return the deck at these times, s, after an instant by the steering path; None if it does not forecast."""
        return self._paths[0].forecast(now, horizons_s)

    def attitude_at(self, stamp: Stamp) -> Attitude | None:
        """Return the attitude at the instant of an exposure, for `PadTracker.track`; None when no sample covers it."""
        kept, samples, at = self._exposed, self._attitudes.samples, stamp.measured_at
        if kept is not None and kept.stamp == stamp and samples[0].stamp.measured_at <= at:
            return kept
        found = self._attitudes.at(at, stamp)
        # Between two samples no later one changes it: vision and fusion ask for the same exposure.
        self._exposed = found if samples and at <= samples[-1].stamp.measured_at else None
        return found

    def held_at(self, stamp: Stamp, attitude: Attitude) -> HeldCamera | None:
        """Return how the camera's gimbal held it at the instant of an exposure; None if no report of the gimbal covers it.

        Args:
            attitude: the vehicle's at that instant.
        """
        return self._gimbal.at(stamp, attitude)

    def camera_motion(
        self, stamp: Stamp, camera: Camera, estimate: RelativeState, held: HeldCamera | None = None
    ) -> CameraMotion | None:
        """Return the camera's motion against the pad while a frame is read out; None if attitude or gimbal do not cover it.

        The rate is the gyro's without its bias where the steering path has one; two attitudes within the readout say it to 0.1
        rad/s.

        Args:
            camera: as it was held at the exposure.
            estimate: the pad's at the exposure.
            held: how a gimbal held the camera then; None of one that is fixed on the body.
        """
        from estimator.vision.camera.rolling import CameraMotion

        aside_s = max(0.5 * abs(camera.readout_s), _READOUT_LEAST_S)
        earlier, later = _beside(stamp, -aside_s), _beside(stamp, aside_s)
        begins, ends = self.attitude_at(earlier), self.attitude_at(later)
        if begins is None or ends is None:
            return None
        moves, _ = self.motion(stamp.measured_at)
        w_body = (begins.R_ned_body.inv @ ends.R_ned_body).rotvec_rad / (2.0 * aside_s) if moves is None else moves.w_body
        R_body_cam = camera.T_body_cam.R
        w_cam = R_body_cam.inv @ w_body
        if held is not None:
            first, last = self.held_at(earlier, begins), self.held_at(later, ends)
            if first is None or last is None:
                return None
            turned = (begins.R_ned_body @ first.R_body_gimbal).inv @ (ends.R_ned_body @ last.R_body_gimbal)
            R_gimbal_cam = held.R_body_gimbal.inv @ R_body_cam
            w_cam = R_gimbal_cam.inv @ (turned.rotvec_rad / (2.0 * aside_s))
        R_level_body = begins.R_ned_body.without_heading()
        v_level = estimate.v_pad_level - R_level_body @ np.cross(w_body, camera.T_body_cam.t)
        return CameraMotion(w_cam, R_body_cam.inv @ (R_level_body.inv @ v_level))

    def awaits_gimbal(self, stamp: Stamp) -> bool:
        """Return whether the gimbal's report that covers the exposure of a frame may still come."""
        return self._gimbal.reports(stamp)

    def assumed_at(self, stamp: Stamp) -> Attitude | None:
        """Return what to assume for a frame that no attitude covers, so that it may show that the pad has not left the picture.

        That is the newest attitude, hardly known. None if the pad was not seen a moment before: it cannot be known again then.
        """
        tracks, samples = self.guard.tracks, self._attitudes.samples
        if tracks.last is None or not samples or not 0 < stamp.measured_at - tracks.last.t <= _MOMENT_S * 1e9:
            return None
        newest = tracks.assumed or samples[-1]
        return Attitude(stamp, newest.R_ned_body, _ASSUMED_RAD**2 * np.eye(3))

    def place_to_look(self, assumed: Attitude) -> RelativeState | None:
        """Return where a frame without an attitude is expected to show the pad: where it was a moment before."""
        at, last = assumed.stamp.measured_at, self.guard.tracks.last
        believed = self._paths[0].at(at)
        if believed is None or last is None:
            return None
        away_m = math.hypot(*last.d)
        var = [(0.03 + 0.02 * away_m) ** 2] * 3
        d = Rotation.from_rpy(0.0, 0.0, assumed.R_ned_body.rpy_rad[2]).inv @ np.array(last.d)
        cov = np.diag([*var, 1.0, 1.0, 1.0, 0.1**2])
        return RelativeState(at, believed.path, d, np.zeros(3), believed.yaw_rad, cov, MonoNs(last.t), True)

    def asks_alone(self, assumed: Attitude) -> Callable[[Sighting], bool]:
        """Return what tells whether `follow` has to know if a second pad is in the frame of a sighting: that costs a search.

        Any thread may call it: it depends on what the estimator knows now.
        """
        guard, options = self.guard, self._options
        return lambda sighting: _refusal(options, sighting) is None and integrity.asks_alone(guard, sighting, assumed)

    def asks_clear(self, attitude: Attitude) -> Callable[[Sighting], bool]:
        """Return what tells the same of `put_seen` for a frame with an attitude; any thread may call it."""
        guard, options = self.guard, self._options
        return lambda sighting: _refusal(options, sighting) is None and integrity.asks_clear(guard, sighting, attitude)

    def follow(self, sighting: Sighting, assumed: Attitude, alone_in: F64 | None = None) -> None:
        """Take note of a sighting in a frame that no attitude covers. It is not fused: it tells which pad is seen, and not where.

        Args:
            assumed: the attitude that levelled it.
            alone_in: as `Detection.alone_in` has it.
        """
        if _refusal(self._options, sighting) is None:
            self.guard = integrity.follow(self.guard, sighting, assumed, alone_in)

    def _verdict_of(self, event: Event) -> Verdict | None:
        (results,) = self.put((event,))
        verdict = results[0].verdict if results else None
        if verdict in (Verdict.FUSED, None):
            self._newest = max(self._newest or event.stamp.measured_at, event.stamp.measured_at)
        return verdict

    def _put_samples(self, samples: Sequence[Sample], wanted: bool) -> list[tuple[FusionResult, ...]]:
        if not samples:
            return []
        before = self.guard
        admitted: list[Sample | Verdict | None]
        self.guard, admitted = integrity.admit(before, samples)  # type: ignore[assignment]
        restarts = self.guard.restarts != before.restarts
        if restarts and len(stamps := dict.fromkeys([sample.stamp for sample in samples])) > 1:
            # What came before the one that shows a sensor's fault belongs to the filter before.
            self.guard = before
            return [r for stamp in stamps for r in self._put_samples([s for s in samples if s.stamp == stamp], wanted)]
        passed = [sample for sample in admitted if sample is not None and not isinstance(sample, Verdict)]
        self._attitudes = self._attitudes.add(*[s for s in passed if type(s) is Attitude])
        self._gimbal = self._gimbal.add(*[s for s in passed if type(s) is GimbalAttitude])
        if restarts:
            self._begin_again()
        for sample in passed:
            if isinstance(sample, VesselMotion | VesselReport):
                self.ship_motion.feel(sample)
        if VesselMotion in {type(sample) for sample in passed}:
            admitted = [self.ship_motion.reported(s) if type(s) is VesselMotion else s for s in admitted]
            passed = [sample for sample in admitted if sample is not None and not isinstance(sample, Verdict)]
        self._lens.put(passed)
        made = [path.put(passed, wanted=wanted) for path in self._paths]
        if not wanted:
            return []
        by_sample = zip(*made, strict=True)
        return [
            self._refused(sample, found)
            if isinstance(found, Verdict)
            else tuple([r for r in (() if found is None else next(by_sample)) if r is not None])
            for sample, found in zip(samples, admitted, strict=True)
        ]

    def _sight(self, sighting: Sighting) -> tuple[FusionResult, ...]:
        attitude, refusal = self.attitude_at(sighting.stamp), _refusal(self._options, sighting)
        if refusal is None:
            before = self._paths[0].at(sighting.stamp.measured_at)
            self.guard, refusal = integrity.admit_sighting(self.guard, sighting, attitude, before)
        if refusal is not None:
            return self._refused(sighting, refusal)
        self._lens.sight(sighting)
        results = tuple([path.sight(sighting) for path in self._paths])
        restarts = self.guard.restarts
        self.guard = integrity.judged(self.guard, sighting, attitude, results[0].verdict is Verdict.FUSED)
        if self.guard.restarts != restarts:
            self._begin_again()
        elif self.ship_motion.reports and results[0].verdict is Verdict.FUSED and isinstance(self._paths[0], EkfPath):
            self.ship_motion.sighted(sighting, self._paths[0].carried_down_m(sighting.stamp.measured_at))
        return results

    def _put_baseline(self, baseline: Baseline) -> tuple[FusionResult, ...]:
        self.guard, (admitted,) = integrity.admit(self.guard, (baseline,))
        if isinstance(admitted, Verdict):
            return self._refused(baseline, admitted)
        self._lens.put((baseline,))
        steering, *others = (path.put((baseline,))[0] for path in self._paths)
        if steering is not None:
            at, attitude = baseline.stamp.measured_at, self.attitude_at(baseline.stamp)
            sigma_m = math.sqrt(max(baseline.cov_ned.diagonal().tolist()))
            self.guard = integrity.baseline_judged(self.guard, steering, sigma_m, self._paths[0].at(at), attitude)
        return tuple([result for result in (steering, *others) if result is not None])

    def _begin_again(self) -> None:
        """Begin the filter again: its state was made with a faulty sensor."""
        self._paths = [_path(path.name, self._options) if path.name == "ekf" else path for path in self._paths]
        self._lens = LensWatch(self._options)
        self.ship_motion.begin_window()

    def _refused(self, event: Event, verdict: Verdict) -> tuple[FusionResult, ...]:
        """Return the results of an event that reaches none of the paths."""
        return tuple([uncompared(path.name, event, verdict) for path in self._paths])

    def _dressed(self, state: RelativeState, now: MonoNs) -> RelativeState:
        guard, lens = self.guard, self._lens
        (ahead_m, right_m), sigma_m = lens.off_m, lens.sigma_m

        def details() -> tuple[tuple[str, float], ...]:
            agrees = float(guard.heights.confirmed(now))
            sensors = [(f"{s.sensor} delay_s", s.delay_s) for s in self.ship_motion.standings()]
            of_lens = ("lens_ahead_m", ahead_m), ("lens_right_m", right_m), ("sigma_lens_m", sigma_m)
            return *state.details, ("range_agrees", agrees), ("heading_off_rad", guard.heading.off_rad), *of_lens, *sensors

        track, lost, jolted = guard.tracks.number, (*state.lost, *self.lost), self.ship_motion.jolted(now)
        fields = {"track": track, "lost": lost, "details": Details(details), "jolted": jolted, "lens_off_m": lens.misplaced_m}
        return state.marked(integrity.alerts(guard, now), **fields)


def _beside(stamp: Stamp, seconds: float) -> Stamp:
    measured_at = after(stamp.measured_at, seconds)
    return structs.replace(stamp, measured_at=measured_at, received_at=max(measured_at, stamp.received_at))


def _refusal(options: EstimatorOptions, sighting: Sighting) -> Verdict | None:
    if sighting.stamp.delay_s > options.max_delay_s:
        return Verdict.TOO_OLD
    if sighting.confidence < options.min_confidence:
        return Verdict.LOW_CONFIDENCE
    return None


def _path(name: PathName, options: EstimatorOptions) -> Path:
    if name == "ekf":
        return EkfPath(options.ekf)
    if name not in _COMPARED:
        raise ValueError(f"no such estimator path: {name}")
    if missing := lacks(name):
        raise BadInput(
            f"the path {name} needs {missing}, which is not installed: install requirements/compare.txt, or the extra "
            "decklander[compare]"
        )
    made: Path = imported(_COMPARED[name])(options)
    return made


def lacks(name: PathName) -> str:
    """Return the module that a path needs and that is not installed; empty if it can run."""
    own = _COMPARED.get(name, "estimator.paths").partition(":")[0]
    needed = ("filterpy", own) if name == "constant_velocity" else (own,)
    return next((module for module in needed if find_spec(module) is None), "")
