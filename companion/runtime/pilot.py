"""The pilot: pad tracker, estimator and guidance as one object without clocks, threads or sockets.

The daemon and the simulator run the same pilot, so tests in virtual time cover the code that flies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from typing import Any

from msgspec import structs

from companion.config.settings import shipped_response
from companion.guidance.contact import ContactWatch, watched
from companion.guidance.controller import HORIZONS_S, Controller, Impact, Knowledge, Target
from companion.guidance.controllers import ControllerSetup, make_controller
from companion.guidance.lease import NO_LANDING
from companion.guidance.options import GuidanceOptions
from companion.guidance.pid import SetPoint
from companion.guidance.plan import Plan
from companion.guidance.planner import Phase, Planner, planner_step
from companion.operator.arbiter import OperatorArbiter
from companion.operator.limit_options import LimitOptions
from companion.operator.options import ManualOptions
from companion.runtime.observer import Decision
from estimator import pipeline
from estimator.contracts.commands import Command, Hover, Land
from estimator.contracts.estimates import IntegrityAlert, PathName, RelativeState, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.samples import Attitude, Frame, Imu, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp, seconds_between
from estimator.ekf import Forecast
from estimator.options import EstimatorOptions
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.thesis.detection import Detection
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track


class FlightOutcome(Enum):
    """The outcome of a flight."""

    LANDED = "landed"
    """The vehicle reports that it is on the ground after our order to land."""
    LANDED_BY_OTHERS = "landed by others"
    """The vehicle reports that it is on the ground without our order to land."""
    GAVE_UP = "gave up"
    """The pad was not found again; the vehicle hovers."""
    LAND_TIMEOUT = "no landing reported"
    """The vehicle did not report in time, on the last try, that it had landed; it hovers."""
    EMERGENCY = "emergency"
    """The vehicle cut its motors."""
    ABORTED = "aborted"
    """The operator aborted the flight; the vehicle hovers."""


FORECAST_S = 0.2
"""Time between two forecasts of the deck, s: they cost more than the rest of a guidance cycle, and change slowly."""
_TRIED = (FlightOutcome.GAVE_UP, FlightOutcome.LAND_TIMEOUT)
"""Outcomes after which the vehicle hovers and the operator may begin again."""
_PLAIN = (Phase.WAITING, Phase.APPROACH, Phase.DESCEND, Phase.LAND)


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
    ) -> None:
        self._tracker = tracker
        self._tracker_memory = TrackerMemory()
        self._memory = pipeline.start(options, shadows)
        self._plan = Plan.over_the_pad(guidance)
        self._make_law = law or _law_for_ardrone
        self._law = self._make_law(guidance)
        self._automatic = automatic
        self._status: VehicleStatus | None = None
        self.engage: Callable[[], None] = lambda: None
        """Called when the operator begins, so that the driver may take back a vehicle that a person had taken over."""
        self._new_flight()
        self.operator = OperatorArbiter(self, manual, limits)
        """The arbiter of people's orders, which has the last word."""

    def _new_flight(self) -> None:
        self._begun = self._automatic
        self._paused = False
        self._planner = Planner.start()
        self._law_memory = self._law.start()
        self._landing_commanded = False
        self._flew = False
        self._stood = False
        self.phase = "waiting for the vehicle"
        self.reason = ""
        """Why the vehicle is not simply descending, as text for the operator."""
        self.outcome: FlightOutcome | None = None
        self._contact = ContactWatch()
        self._impact: Impact | None = None
        self._forecast: Forecast | None = None

    @property
    def camera(self) -> Camera:
        return self._tracker.camera

    @property
    def pad(self) -> Pad:
        return self._tracker.pad

    @property
    def vehicle(self) -> VehicleStatus | None:
        """The vehicle's latest status; None before the first."""
        return self._status

    @property
    def paused(self) -> bool:
        """Whether a person paused guidance."""
        return self._paused

    @property
    def may_try_again(self) -> bool:
        """Whether `begin` resumes the flight although it has an outcome."""
        return self.outcome in _TRIED

    def begin(self) -> None:
        """Start the approach for the operator, or resume it after a pause.

        After another pad was seen, approach that one; after the planner gave up, try again.
        """
        if self.outcome in _TRIED or self._planner.question is not None:
            self.outcome, self._planner = None, Planner.start()
        self._begun, self._paused = True, False
        self.engage()

    def pause(self) -> None:
        """Hover in place for the operator until `begin` is called."""
        if not self._paused:
            self._paused, self._planner = True, Planner.start()

    def abort(self) -> None:
        """Hover for the operator and end the flight. A landing already ordered is no longer repeated."""
        self.outcome = self.outcome or FlightOutcome.ABORTED

    def steer_by(self, path: PathName) -> str | None:
        """Steer by another estimator path for the operator; return None on success, otherwise why it is refused.

        A path that does not run yet has no belief to start from, so during an approach it is accepted only while paused.
        """
        runs_along = path in {one.name for one in self._memory.paths}
        approaching = self._begun and not self._paused and self._flew and self.outcome is None
        if approaching and not runs_along:
            return f"{path} does not run along; pause the approach first"
        try:
            self._memory = pipeline.steer_by(self._memory, path)
        except ValueError as why:
            return str(why)
        return None

    def retune(self, guidance: GuidanceOptions, *, min_confidence: float, max_delay_s: float) -> None:
        """Use other settings from now on; the present approach continues."""
        before = self._plan.guidance
        self._plan = Plan.over_the_pad(guidance)
        if guidance != before:
            self._law, self._law_memory = self._make_law(guidance), self._law.start()
        options = structs.replace(self._memory.options, min_confidence=min_confidence, max_delay_s=max_delay_s)
        self._memory = replace(self._memory, options=options)

    def belief(self, now: MonoNs) -> RelativeState | None:
        """Return the estimate to steer by; it is marked inconsistent while nobody has agreed to land on the pad it refers to."""
        believed = self.believed(now)
        if believed is None or self._planner.question is None:
            return believed
        alerts = (*(alert for alert in believed.alerts if alert is not IntegrityAlert.ELSEWHERE), IntegrityAlert.ELSEWHERE)
        return replace(believed, consistent=False, alerts=alerts)

    def believed(self, now: MonoNs) -> RelativeState | None:
        """Return the steering path's estimate as the estimator has it; None while there is none."""
        return pipeline.belief(self._memory, now)

    def all_believed(self, now: MonoNs) -> tuple[RelativeState, ...]:
        """Return every path's estimate; the steering path's comes first if it has one."""
        return pipeline.beliefs(self._memory, now)

    def knowledge(self, now: MonoNs) -> Knowledge:
        """Return what guidance knows at an instant."""
        body, deck = self.motion(now)
        known = self._forecast
        if known is None or abs(seconds_between(known.at, now)) >= FORECAST_S:
            self._forecast = self.forecast(now, HORIZONS_S)
        return Knowledge(now, self.belief(now), body, deck, self._forecast, self._impact)

    def motion(self, now: MonoNs) -> tuple[BodyMotion | None, DeckMotion | None]:
        """Return the motion of body and deck at an instant by the steering path; None for what it does not know."""
        return pipeline.motion(self._memory, now)

    def forecast(self, now: MonoNs, horizons_s: Sequence[float]) -> Forecast | None:
        """Return the deck at these times, s, after an instant by the steering path; None if it does not forecast."""
        return pipeline.forecast(self._memory, now, horizons_s)

    def on_sample(self, sample: Sample) -> tuple[FusionResult, ...]:
        """Process a sample. Return its fusion results, path by path."""
        self.operator.on_sample(sample)
        if isinstance(sample, VehicleStatus):
            self._on_status(sample)
            return ()
        if isinstance(sample, Imu) and self._flew:
            self._contact = watched(self._contact, sample)
            self._impact = self._contact.newest or self._impact
        return self._fuse(sample)

    def _on_status(self, status: VehicleStatus) -> None:
        self._status = status
        self._stood = self._stood or (self.outcome is not None and status.flying is False)
        if status.flying and self._stood:
            self._new_flight()
        if self._flew and status.flying is False and (self._impact is None or self._impact.by != "vehicle"):
            self._impact = Impact(status.stamp.measured_at, "vehicle")
        self._flew = self._flew or status.flying is True

    def _fuse(self, sample: Sample) -> tuple[FusionResult, ...]:
        self._memory, results = pipeline.step(self._memory, sample)
        return results

    def attitude_at(self, stamp: Stamp) -> Attitude | None:
        """Return the attitude at the exposure of a frame; None when no sample covers it."""
        return pipeline.attitude_at(self._memory, stamp)

    def admit(self, frame: Frame) -> Verdict | None:
        """Register a frame before the search; return None if it may be searched, otherwise its verdict."""
        self._memory, verdict = pipeline.on_frame(self._memory, frame)
        return verdict

    def detect(self, frame: Frame, attitude: Attitude) -> Detection:
        """Search a frame for the pad, beginning where it is expected.

        This may run on another thread, one call at a time: it reads only immutable estimator state and writes only its own.
        """
        believed = pipeline.belief(self._memory, frame.stamp.measured_at)
        seen, self._tracker_memory = track(self._tracker, self._tracker_memory, frame, attitude, believed)
        return seen

    def on_detection(self, seen: Detection) -> tuple[Verdict, tuple[FusionResult, ...]]:
        """Process the detection of a frame.

        Returns:
            The frame's verdict, which is the steering path's, and the fusion results, path by path.
        """
        if seen.selected is None:
            return Verdict.NO_PAD, ()
        self._memory, results = pipeline.step(self._memory, seen.selected)
        return results[0].verdict, results

    def decide(self, now: MonoNs) -> Decision:
        """Run one guidance cycle. The command is None while guidance and people leave the vehicle alone."""
        self.operator.tick(now)
        believed = self.all_believed(now)
        steering = self._memory.options.path
        belief = next((b for b in believed if b.path == steering), None)
        chosen = self.operator.choose(now, self._command(now), belief)
        shadows = tuple(b for b in believed if b.path != steering)
        phase, why = chosen.phase or self.phase, chosen.limit or chosen.reason or self._why(belief)
        return Decision(now, phase, chosen.command, belief, shadows, why, limit=chosen.limit)

    def _why(self, belief: RelativeState | None) -> str:
        """Return the planner's reason and the estimate's alerts as text."""
        alerts = () if belief is None else tuple(alert.value for alert in belief.alerts)
        return "; ".join((self.reason, *alerts) if self.reason else alerts)

    def _command(self, now: MonoNs) -> Command | None:
        status = self._status
        if self.outcome is not None:
            self.phase = self.outcome.value
            return Hover() if self.outcome is FlightOutcome.ABORTED or self.outcome in _TRIED else None
        if status is None or not self._flew:
            self.phase = "waiting for the vehicle"
            return None
        if status.emergency:
            self._end(FlightOutcome.EMERGENCY)
            return None
        if status.flying is False:
            self._end(FlightOutcome.LANDED if self._landing_commanded else FlightOutcome.LANDED_BY_OTHERS)
            return None
        if not self._begun or self._paused:
            self.phase = "paused" if self._paused else "waiting for the start"
            return Hover()
        return self._guided(now)

    def _guided(self, now: MonoNs) -> Command | None:
        belief = self.believed(now)
        self._planner, aim, phase = planner_step(self._planner, self._plan, now, belief)
        self.phase = phase.value
        self.reason = "" if phase in _PLAIN else self._planner.reason
        if phase is Phase.GAVE_UP:
            self._end(FlightOutcome.LAND_TIMEOUT if NO_LANDING in self._planner.reason else FlightOutcome.GAVE_UP)
        target = None
        if isinstance(aim, SetPoint):
            target = Target(aim.d_body_pad_level, yaw_rad=aim.yaw_rad, v_body_level=aim.v_body_level)
        self._law_memory, command = self._law.step(self._law_memory, now, self.knowledge(now), target)
        if not isinstance(aim, SetPoint):
            return self._finished(aim)
        return command

    def _finished(self, aim: Command) -> Command:
        self._landing_commanded = self._landing_commanded or isinstance(aim, Land)
        return aim

    def _end(self, outcome: FlightOutcome) -> None:
        self.outcome = outcome
        self._stood = outcome in (FlightOutcome.LANDED, FlightOutcome.LANDED_BY_OTHERS)
        self.phase = outcome.value
