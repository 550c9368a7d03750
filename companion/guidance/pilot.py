"""The pilot: pad tracker, estimator and guidance as one object without clocks, threads or sockets.

The daemon and the simulator run the same pilot, so tests in virtual time cover the code that flies.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from msgspec import structs

from companion.base.mission import FLOWN, GROUND, Event, State, StateChange
from companion.base.observer import Decision, DeckOutlook
from companion.base.reason import Reason, ReasonCause
from companion.guidance import held_up, steer, vessel_track
from companion.guidance.arbiter import OperatorArbiter
from companion.guidance.contact import ContactWatch, watched
from companion.guidance.controller import HORIZONS_S, Controller, Impact, Knowledge, Target
from companion.guidance.controllers import ControllerSetup, make_controller
from companion.guidance.held_up import HeldUp
from companion.guidance.limits import InputQuality
from companion.guidance.mission_step import mission_step, ordered, reported
from companion.guidance.progress import Progress
from companion.guidance.response_course import reported_lean
from companion.guidance.response_identifier import ResponseIdentifier
from companion.guidance.situation import GuidanceCycle, VesselPosition
from companion.guidance.vessel_track import VesselTrack
from companion.settings.guidance import GuidanceOptions
from companion.settings.limits import LimitOptions
from companion.settings.load import shipped_response
from companion.settings.operator import ManualOptions
from companion.settings.rendezvous import ReportLimits
from companion.settings.response import TiltResponse
from estimator import pipeline
from estimator.contracts.commands import Command, Lean
from estimator.contracts.estimates import IntegrityAlert, PathName, RelativeState, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.contracts.samples import (
    Attitude,
    BodyVelocity,
    Frame,
    GeoFix,
    GimbalAttitude,
    Imu,
    Sample,
    VehicleStatus,
    VesselReport,
)
from estimator.contracts.time import MonoNs, Stamp, seconds_between
from estimator.ekf import Forecast
from estimator.gimbal_history import DOWN, HeldCamera
from estimator.options import EstimatorOptions
from estimator.vision.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.pad import Pad
from estimator.vision.tracker_config import TrackerConfig

if TYPE_CHECKING:  # what looks at frames loads OpenCV, and the first guidance cycle does not wait for it
    from estimator.vision.tracker import TrackerMemory


class FlightOutcome(Enum):
    """The outcome of a flight."""

    LANDED = State.LANDED.value
    """The vehicle reports that it is on the ground after our order to land."""
    LANDED_BY_OTHERS = State.LANDED_BY_OTHERS.value
    """The vehicle reports that it is on the ground without our order to land."""
    GAVE_UP = State.GAVE_UP.value
    """The pad was not found again, or the tries are used up; the vehicle is held still."""
    REFUSED = State.REFUSED.value
    """The conditions are beyond the limits; the vehicle is held still."""
    EMERGENCY = State.EMERGENCY.value
    """The vehicle cut its motors."""
    ABORTED = State.ABORTED.value
    """The operator aborted the flight; the vehicle is held still."""


FORECAST_S = 0.2
"""Time between two forecasts of the deck, s: they cost more than the rest of a guidance cycle, and change slowly."""
_LEAN_TIME_S = 3.0
"""Time constant of the mean lean, s: shorter than a gust front, longer than a correction."""
_NIS_WEIGHT = 0.1
_DOWNWARD = 0.5
"""Cosine of the largest angle between the axis of a camera on a gimbal and the vertical: beyond it no pad is looked for."""
_PLAIN = (
    State.WAIT,
    State.STANDBY,
    State.READY,
    State.PAUSED,
    State.SEARCH,
    State.INTERCEPT,
    State.DESCEND,
    State.COMMIT,
    State.PRESS,
    State.DOWN,
    State.LANDED,
)
_BY_REPORTS = (State.SEARCH, State.RENDEZVOUS)
"""States in which the drone flies by the reports of ship and vehicle, where it may."""
_FAULTED = (State.GO_AROUND, State.REFUSED, State.GAVE_UP, State.ANOTHER_PAD)
WAITING_MOST = 256
"""Number of samples, a third of a second of an AR.Drone's, from which on whoever gives them calls `Pilot.fused`, were nobody else
to ask the estimator."""
_NOT_FUSED = frozenset({VehicleStatus, GeoFix})
_OUTCOMES = {State(outcome.value): outcome for outcome in FlightOutcome}
REFUSALS = (FlightOutcome.GAVE_UP, FlightOutcome.REFUSED)
"""Outcomes in which it did not land by its own decision; the operator may begin again in the air."""


def _law_for_ardrone(guidance: GuidanceOptions) -> Controller[Any]:
    return make_controller(ControllerSetup(guidance, shipped_response("ardrone2")))


class Pilot:
    """Takes samples and frames, and decides on commands.

    Args:
        automatic: whether the approach begins as soon as the vehicle flies; otherwise it waits for `begin`.
        shadows: estimator paths that run for comparison only and never steer.
        law: makes the control law from guidance's options; by default it is made for an AR.Drone.
        manual: the options of manual flight.
        limits: the limits of every command.
        over_ground: whether the vehicle's own hover holds over the ground, and its driver adds the deck's velocity to a velocity.
        reports: what is believed of the places that ship and vehicle report.
        tilt: how the vehicle's tilt answers, by its file; by default an AR.Drone's.
        gimballed: whether a gimbal carries the camera, whose file then holds its rotation on the gimbal's last axis.
    """

    def __init__(
        self,
        tracker: TrackerConfig,
        options: EstimatorOptions,
        guidance: GuidanceOptions,
        *,
        automatic: bool = True,
        shadows: Sequence[PathName] = (),
        law: Callable[[GuidanceOptions], Controller[Any]] | None = None,
        manual: ManualOptions | None = None,
        limits: LimitOptions | None = None,
        over_ground: bool = False,
        reports: ReportLimits | None = None,
        tilt: TiltResponse | None = None,
        gimballed: bool = False,
    ) -> None:
        self._tracker = tracker
        self._gimballed = gimballed
        self._camera = tracker.camera.held(DOWN) if gimballed else tracker.camera
        self._tracker_memory: TrackerMemory | None = None
        self._memory = pipeline.start(options, shadows)
        self._waiting: list[Sample] = []
        """Samples that the estimator has not processed yet."""
        self._fused: list[tuple[Sequence[Sample], Sequence[tuple[FusionResult, ...]]]] = []
        """Rows of samples that it has processed, with the results of each, for `processed`."""
        self._fused_n = 0
        """Number of these samples."""
        self._guidance = guidance
        self._mission = Progress.start(automatic=automatic)
        self._make_law = law or _law_for_ardrone
        self._law = self._make_law(guidance)
        self._law_memory = self._law.start()
        self._over_ground = over_ground
        self._response = ResponseIdentifier(tilt or shipped_response("ardrone2").tilt, guidance)
        self._changes: list[StateChange] = []
        self._status: VehicleStatus | None = None
        self._now = MonoNs(0)
        self._attitude: Attitude | None = None
        """The newest attitude."""
        self._heard: MonoNs | None = None
        """When the newest sample of the vehicle itself was received."""
        self.engage: Callable[[], None] = lambda: None
        """Called when the operator begins, so that the driver may take back a vehicle that a person had taken over."""
        self._contact = ContactWatch()
        self._held, self._held_by_deck = HeldUp(), HeldUp()
        self._deck_down_m_s: float | None = None
        """The deck's vertical speed over the ground in the newest guidance cycle; None if it is not known."""
        self._impact: Impact | None = None
        self._forecast: Forecast | None = None
        self._lean: tuple[MonoNs, float, float] | None = None
        """Instant of the newest attitude; mean lean as an acceleration, m/s^2 forward and right."""
        self._quality = InputQuality()
        self._frames: Counter[Verdict] = Counter()
        self._vessel_track = VesselTrack(reports or ReportLimits())
        self._vessel: VesselPosition | Reason | None = None
        """The ship's place by reports in the newest guidance cycle, or why it is not known; None while nobody flies by it."""
        self.operator = OperatorArbiter(self, manual, limits)
        """The arbiter of people's orders, which has the last word."""

    @property
    def camera(self) -> Camera:
        """The camera on the body; one on a gimbal as it is while that points straight down."""
        return self._camera

    @property
    def gimballed(self) -> bool:
        """Whether a gimbal carries the camera."""
        return self._gimballed

    @property
    def pad(self) -> Pad:
        return self._tracker.pad

    @property
    def vehicle(self) -> VehicleStatus | None:
        """The vehicle's latest status; None before the first."""
        return self._status

    @property
    def state(self) -> State:
        """The state of the mission."""
        return self._mission.state

    @property
    def phase(self) -> str:
        """The state of the mission as text."""
        return self._mission.state.value

    @property
    def reason(self) -> str:
        """Why the vehicle is not simply on its way down, as text for the operator; empty while it is."""
        if self._mission.state is State.GATE:
            return "" if self._mission.waits_for is None else self._mission.waits_for.text
        if isinstance(self._vessel, Reason) and self._mission.state in _BY_REPORTS:
            return self._vessel.text
        if isinstance(self._vessel, VesselPosition) and self._mission.state is State.RENDEZVOUS:
            return Reason(ReasonCause.VESSEL_AWAY, self._vessel.distance_m).text
        if self._mission.state in _PLAIN:
            return ""
        why = self._mission.fault if self._mission.state in _FAULTED else self._mission.reason
        return "" if why is None else why.text

    @property
    def outcome(self) -> FlightOutcome | None:
        """The outcome of the flight; None while it goes on."""
        return _OUTCOMES.get(self._mission.state)

    @property
    def paused(self) -> bool:
        """Whether a person paused guidance."""
        return self.state is State.PAUSED

    @property
    def may_try_again(self) -> bool:
        """Whether `begin` resumes the flight although it has an outcome."""
        return self.outcome in REFUSALS

    def begin(self) -> None:
        """Start the approach for the operator, or resume it after a pause.

        After another pad was seen, approach that one; after it gave up or refused, try again.
        """
        self._vessel_track = vessel_track.restarted(self._vessel_track)
        self._order(Event.BEGIN)
        self.engage()

    def pause(self) -> None:
        """Hold still for the operator until `begin` is called."""
        self._order(Event.PAUSE)

    def abort(self) -> None:
        """Hold still for the operator and end the flight. A landing already ordered is no longer repeated."""
        self._order(Event.ABORT)

    def _order(self, event: Event) -> None:
        self._mission, changes = ordered(self._mission, event, self._now, self._guidance)
        self._changes += changes

    def steer_by(self, path: PathName) -> str | None:
        """Steer by another estimator path for the operator; return None on success, otherwise why it is refused.

        A path that does not run yet has no belief to start from, so during an approach it is accepted only while paused.
        """
        runs_along = path in {one.name for one in self._memory.paths}
        if self.state in FLOWN and not runs_along:
            return f"{path} does not run along; pause the approach first"
        self._settle()
        try:
            self._memory = pipeline.steer_by(self._memory, path)
        except ValueError as why:
            return str(why)
        return None

    def retune(self, guidance: GuidanceOptions, *, min_confidence: float, max_delay_s: float) -> None:
        """Use other settings from now on; the present approach continues."""
        if guidance != self._guidance:
            self._law = self._make_law(guidance)
            self._law_memory = self._law.start()
            self._response.retune(guidance)
        self._guidance = guidance
        self._settle()
        options = structs.replace(self._memory.options, min_confidence=min_confidence, max_delay_s=max_delay_s)
        self._memory = structs.replace(self._memory, options=options)

    def belief(self, now: MonoNs) -> RelativeState | None:
        """Return the estimate to steer by; it is marked inconsistent while nobody has agreed to land on the pad it refers to."""
        believed = self.believed(now)
        if believed is None or self.state is not State.ANOTHER_PAD:
            return believed
        alerts = (*(alert for alert in believed.alerts if alert is not IntegrityAlert.ELSEWHERE), IntegrityAlert.ELSEWHERE)
        return structs.replace(believed, consistent=False, alerts=alerts)

    def believed(self, now: MonoNs) -> RelativeState | None:
        """Return the steering path's estimate as the estimator has it; None while there is none."""
        self._settle()
        return pipeline.belief(self._memory, now)

    def all_believed(self, now: MonoNs) -> tuple[RelativeState, ...]:
        """Return every path's estimate; the steering path's comes first if it has one."""
        self._settle()
        return pipeline.beliefs(self._memory, now)

    def _knowledge(self, now: MonoNs, relative: RelativeState | None) -> Knowledge:
        """Return what guidance knows at an instant, with the steering path's estimate there."""
        body, deck = self.motion(now)
        self._deck_down_m_s = None if deck is None else float(deck.v_level[2])
        known = self._forecast
        if known is None or abs(seconds_between(known.at, now)) >= FORECAST_S:
            self._forecast = self.forecast(now, HORIZONS_S)
        return Knowledge(now, relative, body, deck, self._forecast, self._impact, self._response.in_use, self._law.climb_max_m_s)

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the motion of body and deck at an instant by the steering path; None for what it does not know."""
        self._settle()
        return pipeline.motion(self._memory, now)

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        """Return the deck at these times, s, after an instant by the steering path; None if it does not forecast."""
        self._settle()
        return pipeline.forecast(self._memory, now, horizons_s)

    def vessel_counts(self) -> dict[str, float]:
        """Return the number of places of the ship that were taken, and of reports that were refused, by reason."""
        return self._vessel_track.counted()

    def vessel_velocity(self, now: MonoNs) -> F64 | None:
        """Return the velocity that the ship reports, (2,) m/s north and east; None if there is no fresh report of it."""
        return vessel_track.velocity_ned(self._vessel_track, now)

    def on_samples(self, samples: Sequence[Sample]) -> list[tuple[FusionResult, ...]]:
        """Process samples in the order in which they were received. Return the fusion results of each, path by path."""
        self.take_samples(samples)
        results = {id(sample): results for sample, results in self.fused()}
        return [results.get(id(sample), ()) for sample in samples]

    def take_samples(self, samples: Sequence[Sample]) -> int:
        """Take samples in the order in which they were received; return how many wait for `fused`.

        The estimator processes them when somebody next asks it, those of several datagrams together: beliefs and results are the
        same as one by one, and what surrounds each step costs once.
        """
        self.operator.on_samples(samples)
        fused: list[Sample] = []
        for sample in samples:
            received_at = sample.stamp.received_at
            if received_at > self._now:
                self._now = received_at
            if type(sample) not in _NOT_FUSED:
                fused.append(sample)
            # By the type itself: hundreds of samples a second, and a match asks one class after the other.
            if type(sample) is Imu:
                if self._mission.state not in GROUND:
                    before, self._contact = self._contact.newest, watched(self._contact, sample)
                    if self._contact.newest is not before:
                        self._impact = self._contact.newest
            elif type(sample) is Attitude:
                lean = reported_lean(sample.R_ned_body)
                self._lean = _leant(self._lean, sample.stamp.measured_at, lean)
                self._response.on_attitude(sample.stamp, lean)
                self._attitude = sample
            elif type(sample) is VehicleStatus:
                self._on_status(sample)
            elif type(sample) is BodyVelocity and self._over_ground and self.state not in GROUND:
                self._feel_held(sample.stamp.measured_at, float(sample.v_level[2]))
            elif type(sample) is GeoFix or type(sample) is VesselReport:
                self._vessel_track = vessel_track.on_sample(self._vessel_track, sample)
                if of_ship(sample):
                    continue
            elif type(sample) is GimbalAttitude:
                continue
            self._heard = received_at
        self._keep(fused)
        return len(self._waiting) + self._fused_n

    def on_sample(self, sample: Sample) -> tuple[FusionResult, ...]:
        """Process one sample. Return its fusion results, path by path."""
        return self.on_samples((sample,))[0]

    def _feel_held(self, at: MonoNs, down_m_s: float) -> None:
        """Note the vehicle's vertical speed over the ground, m/s down, against the commands over the ground and to the deck."""
        ground, deck = self._held, self._held_by_deck
        self._held = held_up.measured(ground, at, down_m_s)
        if self._deck_down_m_s is not None:
            self._held_by_deck = held_up.measured(deck, at, down_m_s - self._deck_down_m_s)
        for before, after in ((ground, self._held), (deck, self._held_by_deck)):
            if after.newest is not before.newest:
                self._impact = after.newest

    def _on_status(self, status: VehicleStatus) -> None:
        self._status = status
        if self.state not in GROUND and status.flying is False and (self._impact is None or self._impact.by != "vehicle"):
            self._impact = Impact(status.stamp.measured_at, "vehicle")
        self._mission, changes = reported(self._mission, status, self._guidance)
        if any(change.event is Event.TAKEN_OFF for change in changes):
            self._contact, self._impact, self._forecast = ContactWatch(), None, None
            self._held, self._held_by_deck = HeldUp(), HeldUp()
            self._law_memory = self._law.start()
            self._response.on_take_off()
        self._changes += changes

    def fused(self) -> list[tuple[Sample, tuple[FusionResult, ...]]]:
        """Process what waits; return all samples that were processed since the last call, each with its results, path by path."""
        self._settle()
        return self.processed()

    def processed(self) -> list[tuple[Sample, tuple[FusionResult, ...]]]:
        """Return all samples that the estimator has processed since the last call, as `fused`; what waits goes on waiting."""
        rows, self._fused, self._fused_n = self._fused, [], 0
        return [one for samples, results in rows for one in zip(samples, results, strict=True)]

    def _keep(self, samples: Sequence[Sample]) -> None:
        """Keep samples for the estimator."""
        self._waiting += samples

    def _settle(self) -> None:
        """Let the estimator process the samples that wait."""
        if not self._waiting:
            return
        samples, self._waiting = self._waiting, []
        self._memory, results = pipeline.step_samples(self._memory, samples)
        self._fused.append((samples, results))
        self._fused_n += len(samples)

    def attitude_at(self, stamp: Stamp) -> Attitude | None:
        """Return the attitude at the exposure of a frame; None when no sample covers it."""
        self._settle()
        return pipeline.attitude_at(self._memory, stamp)

    def held_at(self, stamp: Stamp, attitude: Attitude) -> HeldCamera | None:
        """Return how the gimbal held the camera at the exposure of a frame.

        None if no report of the gimbal covers it, if it did not point the camera down, and without a gimbal.

        Args:
            attitude: the vehicle's at the exposure.
        """
        if not self._gimballed:
            return None
        self._settle()
        held = pipeline.held_at(self._memory, stamp, attitude)
        if held is None:
            return None
        axis_level = attitude.R_ned_body @ (held.R_body_gimbal @ self._tracker.camera.T_body_cam.R.matrix[:, 2])
        return held if float(axis_level[2]) > _DOWNWARD else None

    def awaits_gimbal(self, stamp: Stamp) -> bool:
        """Return whether the gimbal's report that covers the exposure of a frame may still come."""
        return self._gimballed and self._memory.gimbal.reports(stamp)

    def camera_held(self, held: HeldCamera | None) -> Camera | None:
        """Return the camera on the body while the gimbal holds it so; None without a gimbal's attitude."""
        return None if held is None else self._tracker.camera.held(held.R_body_gimbal)

    def admit(self, frame: Frame) -> Verdict | None:
        """Register a frame before the search; return None if it may be searched, otherwise its verdict."""
        self._settle()
        self._memory, verdict = pipeline.on_frame(self._memory, frame)
        return verdict

    def rehearse(self) -> None:
        """Look at a drawn frame, so that the first real one takes no longer than the others. This may run on another thread."""
        from estimator.vision.rehearsal import rehearse

        rehearse(replace(self._tracker, camera=self._camera))

    def detect(self, frame: Frame, attitude: Attitude, held: HeldCamera | None = None) -> Detection:
        """Search a frame for the pad, beginning where it is expected.

        This may run on another thread, one call at a time: it reads only immutable estimator state and writes only its own.

        Args:
            held: how the gimbal held the camera at the exposure; None of a camera that is fixed on the body.
        """
        from estimator.vision.tracker import TrackerMemory, track

        believed = pipeline.belief(self._memory, frame.stamp.measured_at)
        tracker = self._tracker
        if held is not None:
            tracker = replace(tracker, camera=tracker.camera.held(held.R_body_gimbal))
            attitude = structs.replace(attitude, cov_body=attitude.cov_body + held.cov_body)
        if tracker.camera.readout_s and believed is not None:
            from estimator.camera_motion import camera_motion

            motion = camera_motion(self._memory, frame.stamp, tracker.camera, believed, held)
            tracker = replace(tracker, motion=motion)
        seen, self._tracker_memory = track(tracker, self._tracker_memory or TrackerMemory(), frame, attitude, believed)
        return seen

    def on_detection(self, seen: Detection) -> tuple[Verdict, tuple[FusionResult, ...]]:
        """Process the detection of a frame.

        Returns:
            The frame's verdict, which is the steering path's, and the fusion results, path by path.
        """
        sighting = seen.selected or seen.elsewhere
        if sighting is None:
            return Verdict.NO_PAD, ()
        self._settle()
        if seen.selected is not None and seen.elsewhere is not None:
            self._memory, results = pipeline.step_seen(self._memory, seen.selected, seen.elsewhere)
        else:
            self._memory, results = pipeline.step(self._memory, sighting)
        steering = results[0]
        mean = self._quality.normalized_nis
        if math.isfinite(steering.nis):
            now = steering.normalized_nis
            mean = now if mean is None else mean + _NIS_WEIGHT * (now - mean)
        self._quality = InputQuality(mean, sighting.stamp.sigma_s)
        return steering.verdict, results

    def on_verdict(self, verdict: Verdict) -> None:
        """Take the verdict on a frame, whoever gave it."""
        if verdict is Verdict.FUSED:
            self._frames.clear()
        else:
            self._frames[verdict] += 1

    def decide(self, now: MonoNs) -> Decision:
        """Run one guidance cycle. The command is None while guidance and people leave the vehicle alone."""
        self.operator.tick(now)
        self._now = max(self._now, now)
        believed = self.all_believed(now)
        steering = self._memory.options.path
        belief = next((b for b in believed if b.path == steering), None)
        chosen = self.operator.choose(now, self._command(now, belief), belief)
        response = self._response.on_command(now, chosen.command, self.state)
        if self._over_ground:
            down_m_s = float(chosen.command.v_level[2]) if isinstance(chosen.command, Lean) else None
            self._held = held_up.commanded(self._held, now, down_m_s)
            to_deck_m_s = held_up.to_deck(self._held, now, self._deck_down_m_s)
            self._held_by_deck = held_up.commanded(self._held_by_deck, now, to_deck_m_s)
        shadows = tuple(b for b in believed if b.path != steering)
        changes, self._changes = tuple(self._changes), []
        phase, why = chosen.phase or self.phase, chosen.limit or chosen.reason or self._why(belief)
        made = self._forecast
        ahead = None if made is None or made.at != now else DeckOutlook.of(made)
        return Decision(now, phase, chosen.command, belief, shadows, why, chosen.limit, changes, response, ahead)

    def _why(self, belief: RelativeState | None) -> str:
        """Return the machine's reason and the estimate's alerts as text."""
        alerts = () if belief is None else tuple(alert.value for alert in belief.alerts)
        return "; ".join(dict.fromkeys((self.reason, *alerts) if self.reason else alerts))

    def _command(self, now: MonoNs, belief: RelativeState | None) -> Command | None:
        knowledge = self._knowledge(now, belief)
        lean = None if self._lean is None else math.atan(math.hypot(*self._lean[1:]) / G_M_S2)
        battery = None if self._status is None else self._status.battery_fraction
        place: VesselPosition | Reason | None = None
        if self._guidance.rendezvous.enabled and self.state in _BY_REPORTS:
            if self._attitude is not None:
                self._vessel_track = vessel_track.on_sample(self._vessel_track, self._attitude)
            place = vessel_track.position(self._vessel_track, now)
        self._vessel = place
        silent_s = 0.0 if self._heard is None else max(0.0, seconds_between(self._heard, now))
        s = GuidanceCycle(now, knowledge, battery, lean, self._quality, self._frames, place, silent_s)
        self._mission, aim, changes = mission_step(self._mission, s, self._guidance, over_ground=self._over_ground)
        self._changes += changes
        target = aim if isinstance(aim, Target) else None
        self._law_memory, command = self._law.step(self._law_memory, now, knowledge, target)
        if target is None:
            return None if isinstance(aim, Target) else aim
        return steer.allowed(command, self._mission, s, self._guidance, over_ground=self._over_ground)


def of_ship(sample: Sample) -> bool:
    """Return whether a sample tells of the ship and not of the vehicle."""
    return type(sample) is VesselReport or (type(sample) is GeoFix and sample.whose == "vessel")


def _leant(mean: tuple[MonoNs, float, float] | None, at: MonoNs, lean_m_s2: tuple[float, float]) -> tuple[MonoNs, float, float]:
    """Return the mean lean after one more attitude."""
    ahead, aside = lean_m_s2
    if mean is None:
        return at, ahead, aside
    before, mean_ahead, mean_aside = mean
    weight = 1.0 - math.exp(-max(0.0, seconds_between(before, at)) / _LEAN_TIME_S)
    return at, mean_ahead + weight * (ahead - mean_ahead), mean_aside + weight * (aside - mean_aside)
