"""The pilot: pad tracker, estimator and guidance as one object without clocks, threads or sockets, and how the settings make it.

The daemon and the simulator run the same pilot, so tests in virtual time cover the code that flies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from msgspec import Struct, structs

from companion.base.mission import CONTACT_INTENDED, GROUND, ORDERED, Event, FlightOutcome, Reason, ReasonCause, State
from companion.base.observer import Decision, DeckOutlook
from companion.guidance import monitor
from companion.guidance.controller import Controller, FieldOfView, Knowledge
from companion.guidance.landing import LandingGuidance, PilotOptions, alerted
from companion.guidance.law.controllers import ControllerSetup, make_controller
from companion.guidance.monitor import Monitor, Witnesses
from companion.guidance.operator.arbiter import Chosen, OperatorArbiter
from companion.settings.capabilities import ReadOpinion, offered
from companion.settings.guidance import GuidanceOptions, Response, TiltResponse
from companion.settings.load import body_camera, camera_model, pad_model, response_model
from companion.settings.model import Settings
from companion.settings.sound import rim_m
from estimator.attitude_history import DOWN, HeldCamera
from estimator.contracts.commands import Lean
from estimator.contracts.errors import in_words
from estimator.contracts.estimates import FusionResult, IntegrityAlert, PathName, RelativeState, Sighting, Verdict
from estimator.contracts.samples import Attitude, Baseline, Frame, GeoFix, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp, seconds_between
from estimator.integrity.parity import leaps
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.track.config import FRAME_WORK, SecondOpinion, TrackerConfig

if TYPE_CHECKING:
    from estimator.vision.track.memory import TrackerMemory

_SECOND_PAD_S = 1.0
"""Time between two searches for a second pad beside the tracked one, s: each takes some times as long as a look."""
_DOWNWARD = 0.5
"""Cosine of the largest angle between the axis of a camera on a gimbal and the vertical: beyond it no pad is looked for."""
_MOUNT_LEAST_RAD = math.radians(0.1)
"""The least standard deviation of a calibrated mount: it bends by as much from flight to flight."""


class Look(Struct, frozen=True):
    """A frame and what the search of it begins with. The estimate was taken before, so that another thread may search."""

    frame: Frame
    attitude: Attitude
    tracker: TrackerConfig
    """The tracker as it is for this frame: with the camera as it was held, and its motion."""
    expected: RelativeState | None
    """The estimate at the exposure; None for a search of the whole frame."""
    reads_deck: bool = True
    """Read the deck in the frame, too; else `PadSearch.read_deck` is for that, after the sighting was reported."""
    asks_alone: Callable[[Sighting], bool] | None = None
    """Tells whether to search for a second pad beside a sighting."""


class PadSearch:
    """Searches frames for the pad.

    Args:
        gimballed: whether a gimbal carries the camera, whose file then holds its rotation on the gimbal's last axis.
    """

    def __init__(self, tracker: TrackerConfig, gimballed: bool) -> None:
        self._tracker = tracker
        self._memory: TrackerMemory | None = None
        self._looked: MonoNs | None = None
        """Instant of the newest search for a second pad."""
        self.gimballed = gimballed
        self.pad = tracker.pad
        self.camera = tracker.camera.held(DOWN) if gimballed else tracker.camera
        """The camera on the body; one on a gimbal as it is while that points straight down."""

    def pointed_down(self, held: HeldCamera | None, attitude: Attitude) -> HeldCamera | None:
        """Return how the gimbal holds the camera; None if that is not known, or not downward.

        Args:
            attitude: the vehicle's at the same instant.
        """
        if held is None:
            return None
        axis_level = attitude.R_ned_body @ (held.R_body_gimbal @ self._tracker.camera.T_body_cam.R.matrix[:, 2])
        return held if float(axis_level[2]) > _DOWNWARD else None

    def camera_held(self, held: HeldCamera | None) -> Camera | None:
        """Return the camera on the body while the gimbal holds it so; None without a gimbal's attitude."""
        return None if held is None else self._tracker.camera.held(held.R_body_gimbal)

    def rehearse(self) -> None:
        """Look at a drawn frame, so that the first real one takes no longer than the others. This may run on another thread."""
        from estimator.vision.track.rehearsal import rehearse

        rehearse(replace(self._tracker, camera=self.camera))

    def anywhere(self, frame: Frame, attitude: Attitude) -> Look:
        """Return what a search that expects the pad nowhere begins with."""
        return Look(frame, attitude, self._tracker, None)

    def begin(
        self, known: RelativeEstimator, frame: Frame, attitude: Attitude, held: HeldCamera | None = None, *, watches: bool = True
    ) -> Look:
        """Return what the search of a frame begins with.

        Args:
            known: the estimator, which says where the pad is expected.
            held: how the gimbal held the camera at the exposure; None of a camera that is fixed on the body.
            watches: whether to look for things on the pad and about it too; else what was seen of them is forgotten.
        """
        estimated = known.at(frame.stamp.measured_at)
        tracker = replace(self._tracker, watches=watches)
        if held is not None:
            tracker = replace(tracker, camera=tracker.camera.held(held.R_body_gimbal))
            attitude = structs.replace(attitude, cov_body=attitude.cov_body + held.cov_body)
        if tracker.camera.readout_s and estimated is not None:
            tracker = replace(tracker, motion=known.camera_motion(frame.stamp, tracker.camera, estimated, held))
        at = frame.stamp.measured_at
        looks = self._looked is None or seconds_between(self._looked, at) >= _SECOND_PAD_S
        return Look(frame, attitude, tracker, estimated, asks_alone=known.asks_clear(attitude) if looks else None)

    def begin_following(self, known: RelativeEstimator, frame: Frame, assumed: Attitude, *, watches: bool = True) -> Look:
        """Return what the search of a frame that no attitude covers begins with: the place where the pad was."""
        tracker = replace(self._tracker, watches=watches)
        return Look(frame, assumed, tracker, known.place_to_look(assumed), asks_alone=known.asks_alone(assumed))

    def detect(self, look: Look) -> Detection:
        """Search a frame for the pad. This may run on another thread, one call at a time: it writes only its own memory."""
        from estimator.vision.track.memory import TrackerMemory
        from estimator.vision.track.second_pad import alone_in
        from estimator.vision.track.tracker import sight

        before = self._memory or TrackerMemory()
        seen, self._memory = sight(look.tracker, before, look.frame, look.attitude, look.expected)
        if look.reads_deck:
            seen = self.read_deck(seen)
        sighting = seen.selected or seen.elsewhere
        if look.asks_alone is None or sighting is None or not look.asks_alone(sighting):
            return seen
        self._looked = look.frame.stamp.measured_at
        return structs.replace(seen, alone_in=alone_in(look.tracker, self._memory, look.frame, look.attitude, sighting))

    @property
    def has_unread(self) -> bool:
        """True if `read_deck` has something to read in the newest frame."""
        return self._memory is not None and self._memory.unread is not None

    def read_deck(self, seen: Detection) -> Detection:
        """Return the newest detection with what its frame shows on the pad and about it; threads as for `detect`."""
        from estimator.vision.track.read_deck import read_deck

        if self._memory is not None:
            seen, self._memory = read_deck(seen, self._memory)
        return seen


_NOT_FUSED = frozenset({VehicleStatus, GeoFix})
_OUTCOMES = {State(outcome.value): outcome for outcome in FlightOutcome}


class Pilot:
    """Takes samples and frames, and decides on commands: a step over search, estimation and landing."""

    def __init__(
        self, tracker: TrackerConfig, estimator: EstimatorOptions, guidance: GuidanceOptions, options: PilotOptions | None = None
    ) -> None:
        given = options or PilotOptions()
        self.search = PadSearch(tracker, given.gimballed)
        self.camera, self.pad = self.search.camera, self.search.pad
        """The camera on the body, one on a gimbal as it is while that points straight down; and the pad."""
        self.estimator = RelativeEstimator(estimator, given.shadows, given.motion_sensor)
        """The estimate: where the pad is, how body and deck move, and what was made of each sample."""
        self.landing = LandingGuidance(guidance, given)
        self.overrule, self.barred = self.landing.overrule, self.landing.barred
        self.engage: Callable[[], None] = lambda: None
        """Called when a person orders to begin or to land: the driver may take back a vehicle that a person had taken over."""
        self.operator = OperatorArbiter(self, given.manual, given.limits)
        """The arbiter of people's orders, which has the first word and the last."""
        self.failure: Exception | None = None
        """Fault of guidance in the newest cycle, in which a person's order was obeyed without it; None without a fault."""
        self.monitor = Monitor()
        self._leaps_until = 0
        """Instant of the newest velocity that was searched for leaps, ns."""

    @property
    def vehicle(self) -> VehicleStatus | None:
        """The vehicle's latest status; None before the first."""
        return self.landing.vehicle

    @property
    def state(self) -> State:
        """The state of the mission."""
        return self.landing.state

    @property
    def outcome(self) -> FlightOutcome | None:
        """The outcome of the flight, which a pilot's hand does not change once it has ended; None while it goes on."""
        mission = self.landing.mission
        refused = mission.here.after if mission.here is not None and mission.state is State.LANDED else None
        return _OUTCOMES.get(refused or mission.taken_from or mission.state) or _OUTCOMES.get(mission.state)

    @property
    def paused(self) -> bool:
        """True if a person holds the vehicle."""
        return self.state is State.PAUSED

    @property
    def may_begin(self) -> bool:
        """True if a flight is known that `begin` or `stay` would fly to the pad."""
        return self.state not in GROUND

    def begin(self, at: MonoNs | None = None) -> None:
        """Start the approach by an order of this time, or resume it; after another pad was seen, approach that one."""
        self.landing.order(Event.BEGIN, at)
        self.engage()

    @property
    def velocity_refused(self) -> bool:
        """True while the vehicle's velocity is known to be wrong, and with it whatever was measured by it."""
        return self.monitor.fault is not None or not self.estimator.guard.trusts_velocity

    @property
    def lands_here(self) -> bool:
        """True while the vehicle lands where it is, which nothing of ours calls off."""
        return self.landing.mission.lands_here

    def land(self, at: MonoNs | None = None) -> None:
        """Land where the vehicle is, by an order of this time."""
        self.landing.order(Event.LAND, at)
        self.engage()

    def stay(self, at: MonoNs | None = None) -> None:
        """Fly over the pad for the operator and wait there; `begin` lands."""
        self.landing.order(Event.STAY, at)
        self.engage()

    def hold(self, why: Reason = ORDERED) -> None:
        """Hold still until `begin` is called."""
        self.landing.order(Event.HOLD, None, why)

    def abort(self) -> None:
        """Hold still for the operator and end the flight. A landing already ordered is no longer repeated."""
        self.landing.order(Event.ABORT)

    def retune(self, guidance: GuidanceOptions, *, min_confidence: float, max_delay_s: float) -> None:
        """Use other settings from now on; the present approach continues."""
        self.landing.retune(guidance)
        self.estimator.retune(min_confidence=min_confidence, max_delay_s=max_delay_s)

    def belief(self, now: MonoNs) -> RelativeState | None:
        """Return the estimate to steer by, marked inconsistent where it must not be.

        That is while its pad is not the one that is to be landed on, and while the deck's estimated motion is impossible.
        """
        believed = self.estimator.at(now)
        if believed is None:
            return None
        if self.state is State.ANOTHER_PAD:
            believed = alerted(believed, IntegrityAlert.ELSEWHERE)
        objection = self.landing.doubted(now)
        return believed if objection is None else alerted(believed, objection)

    def on_samples(self, samples: Sequence[Sample], *, wanted: bool = True) -> list[tuple[FusionResult, ...]]:
        """Process samples in the order in which they were received. Return the results of each, path by path, if `wanted`."""
        was_cut = self.vehicle is not None and self.vehicle.emergency
        self.operator.on_samples(samples)
        self.landing.on_samples(samples)
        if was_cut and self.vehicle is not None and not self.vehicle.emergency:
            # After a fall, and however long it lay there, neither the estimate nor what it knows of the sensors holds.
            self.estimator = self.estimator.restarted()
        fused = [sample for sample in samples if type(sample) not in _NOT_FUSED]
        by_antennas = any(type(sample) is Baseline for sample in fused)
        results = self.estimator.put(fused, wanted=wanted or by_antennas)
        if by_antennas:
            for sample, result in zip(fused, results, strict=True):
                if type(sample) is Baseline and result:
                    self.landing.on_baseline(result[0], sample.stamp)
        if len(fused) == len(samples) or not wanted:
            return results
        of_fused = iter(results)
        return [() if type(sample) in _NOT_FUSED else next(of_fused) for sample in samples]

    def on_sample(self, sample: Sample) -> tuple[FusionResult, ...]:
        """Process one sample. Return its fusion results, path by path."""
        return self.on_samples((sample,))[0]

    def held_at(self, stamp: Stamp, attitude: Attitude) -> HeldCamera | None:
        """Return how the gimbal held the camera at the exposure of a frame.

        None if no report of the gimbal covers it, if it did not point the camera down, and without a gimbal.

        Args:
            attitude: the vehicle's at the exposure.
        """
        if not self.search.gimballed:
            return None
        return self.search.pointed_down(self.estimator.held_at(stamp, attitude), attitude)

    def awaits_gimbal(self, stamp: Stamp) -> bool:
        """Return whether the gimbal's report that covers the exposure of a frame may still come."""
        return self.search.gimballed and self.estimator.awaits_gimbal(stamp)

    def look_at(self, frame: Frame, attitude: Attitude, held: HeldCamera | None = None) -> Look:
        """Return what the search of a frame begins with, for `detect`.

        Args:
            held: how the gimbal held the camera at the exposure; None of a camera that is fixed on the body.
        """
        return self.search.begin(self.estimator, frame, attitude, held, watches=self.state not in GROUND)

    def assumed_at(self, stamp: Stamp) -> Attitude | None:
        """Return what to assume for a frame that no attitude covers; None if the pad cannot be followed in it."""
        return None if self.search.gimballed else self.estimator.assumed_at(stamp)

    def look_after(self, frame: Frame, assumed: Attitude) -> Look:
        """Return what the search of a frame that no attitude covers begins with, for `detect`."""
        return self.search.begin_following(self.estimator, frame, assumed, watches=self.state not in GROUND)

    def detect(self, look: Look) -> Detection:
        """Search a frame for the pad. This may run on another thread, one call at a time: it reads no state of the pilot's."""
        return self.search.detect(look)

    def on_followed(self, seen: Detection, assumed: Attitude) -> None:
        """Take note of whether the pad has left the picture. Nothing is fused."""
        sighting = seen.selected or seen.elsewhere
        if sighting is not None:
            self.estimator.follow(sighting, assumed, seen.alone_in)

    def on_detection(self, seen: Detection) -> tuple[Verdict, tuple[FusionResult, ...]]:
        """Process the detection of a frame.

        Returns:
            The frame's verdict, which is the steering path's, and the fusion results, path by path.
        """
        self.landing.on_pad(seen.on_pad)
        results = self.estimator.put_seen(seen.selected, seen.elsewhere, seen.alone_in)
        sighting = seen.selected or seen.elsewhere
        if sighting is None:
            return Verdict.NO_PAD, ()
        self.landing.on_fused(results[0], sighting.stamp)
        return results[0].verdict, results

    def decide(self, now: MonoNs) -> Decision:
        """Run one guidance cycle. The command is None while guidance and people leave the vehicle alone.

        A person's order comes before estimator and law: a cut asks neither, and where one of them raises while an order decides,
        the order is obeyed without it, and `failure` has the exception.

        Raises:
            Whatever estimator or law raise while guidance flies alone.
        """
        self.failure = None
        self.operator.tick(now)
        if self.operator.cuts:
            return self._ordered(now)
        try:
            return self._guided(now)
        except Exception as why:
            if not self.operator.commands:
                raise
            self.failure = why
            return self._ordered(now)

    def _ordered(self, now: MonoNs) -> Decision:
        """Return a person's command alone."""
        chosen = self.operator.without_guidance(now)
        failed = "" if self.failure is None else f"guidance failed, and the order is obeyed without it: {in_words(self.failure)}"
        why, changes = "; ".join(filter(None, (chosen.reason, failed))), self.landing.changed()
        return Decision(now, chosen.phase or self.state.value, chosen.command, None, reason=why, transitions=changes)

    def _guided(self, now: MonoNs) -> Decision:
        believed = self.estimator.all_at(now)
        steering = self.estimator.path
        knowledge = self.landing.knowledge(now, next((b for b in believed if b.path == steering), None), self.estimator)
        belief = knowledge.relative
        # What stands may be set up anew, and the next flight earns its own trust.
        stands = self.vehicle is not None and self.vehicle.flying is False
        self.monitor = Monitor() if stands else monitor.watched(self.monitor, self._witnesses(knowledge))
        by_hand = self.landing.by_hand = self.operator.hand is not None
        refusal = None if self.state in CONTACT_INTENDED else self.monitor.refusal(by_hand=by_hand)
        guided, trusts = self.landing.command(knowledge, self.monitor.refuses), knowledge.trusts_velocity and refusal is None
        watch = self.monitor
        chosen = self.operator.choose(
            now, guided, belief, trusts_velocity=trusts, error_m_s=watch.place_m_s, unseen_m=watch.way_m
        )
        if refusal is not None and refusal.cause is ReasonCause.UNCHECKED and isinstance(chosen.command, Lean):
            # A hold by the estimate is worth the whole way: see `monitor`.
            refusal, trusts = None, knowledge.trusts_velocity
        unconfirmed = refusal is not None and not by_hand
        if chosen.command is not None and not trusts:
            by_us = not by_hand and not self.lands_here
            replaced = self.landing.without_velocity(chosen.command, knowledge, guided=by_us, unconfirmed=unconfirmed)
            chosen = structs.replace(chosen, command=replaced)
        self.monitor = monitor.commanded(self.monitor, chosen.command, by_hand=by_hand, trusted=trusts)
        response = self.landing.on_command(now, chosen.command)
        shadows = tuple(b for b in believed if b.path != steering)
        changes = self.landing.changed()
        phase, charge = chosen.phase or self.state.value, self.landing.charge
        limit, why = self._texts(chosen, belief, refusal)
        made = self.landing.forecast_made(now)
        ahead = None if made is None else DeckOutlook.of(made)
        return Decision(now, phase, chosen.command, belief, shadows, why, limit, changes, response, ahead, charge)

    def _texts(self, chosen: Chosen, belief: RelativeState | None, refusal: Reason | None) -> tuple[str, str]:
        """Return the limit that changed the command, and the reason for what is flown, as the operator reads them."""
        why = chosen.limit or chosen.reason or self._why(belief)
        for further in ("" if refusal is None or self.state in GROUND else refusal.text, self.landing.charge):
            if further not in why:
                why = f"{why}; {further}" if why else further
        ignoring = self.landing.ignoring
        return "; ".join(filter(None, (chosen.limit, ignoring))), "; ".join(filter(None, (why, ignoring)))

    def _witnesses(self, known: Knowledge) -> Witnesses:
        """Return what the monitor knows in this cycle."""
        place, now, since = self.operator.place(), known.at, self._leaps_until
        v, seen, own = place.velocity_at(now), self.landing.in_sight(known), self.estimator.guard.inertial.parity
        # A velocity enters the parity with its bin, later than it was measured.
        self._leaps_until = own.flow[-1][0] if own.flow else since
        return Witnesses(
            now,
            None if v is None else v.v_level[:2],
            None if seen is None else seen.v_pad_level[:2],
            leaps(own, since),
            place.fix_at(now),
            self.landing.hold.over_ground,
        )

    def _why(self, belief: RelativeState | None) -> str:
        """Return the machine's reason, the estimate's alerts and the sensors that it does without, as text."""
        of_belief = () if belief is None else (*(alert.value for alert in belief.alerts), *belief.lost)
        alerts = (*of_belief, *self.estimator.lost)
        return "; ".join(dict.fromkeys(filter(None, (self.landing.reason, *alerts))))


def make_pilot(settings: Settings, shadows: Sequence[PathName] = (), kind: Callable[..., Pilot] = Pilot) -> Pilot:
    """Return the pilot that the settings describe.

    Args:
        shadows: estimator paths that run beside it to be compared.
        kind: makes the pilot in place of the class itself, from the same arguments.

    Raises:
        BadInput: the camera or pad file is missing or has a fault.
    """
    detector = tracker(settings)
    return kind(
        detector,
        with_mount(estimator_options(settings), detector.camera),
        settings.guidance,
        PilotOptions(
            automatic=settings.guidance.start == "automatic",
            shadows=shadows,
            law=law_of(settings),
            manual=settings.operator.manual,
            limits=settings.limits,
            over_ground=settings.vehicle.over_ground,
            resumes=settings.vehicle.mode_is_order,
            reports=settings.vessel,
            motion_sensor=settings.vessel.motion_sensor,
            tilt=_flyable_tilt(settings),
            climb=_within_driver(response_model(settings), settings).climb,
            view=None if settings.camera.gimbal.given else field_of_view(body_camera(settings)),
            rim_m=rim_m(settings),
            gimballed=settings.camera.gimbal.given,
        ),
    )


def law_of(settings: Settings) -> Callable[[GuidanceOptions], Controller[Any]]:
    """Return what makes the control law from guidance's options, which may be tuned in flight, and all else that it needs.

    Raises:
        BadInput: the response or camera file has a fault, or there is no such controller.
    """
    response, view = _within_driver(response_model(settings), settings), field_of_view(body_camera(settings))

    def make(guidance: GuidanceOptions) -> Controller[Any]:
        return make_controller(ControllerSetup(guidance, response, view, settings.vehicle.over_ground))

    make(settings.guidance)
    return make


def _within_driver(response: Response, settings: Settings) -> Response:
    """Return the response with no more than the driver lets through: the law has to know the tilt that is truly flown."""
    tilt, climb, vehicle = response.tilt, response.climb, settings.vehicle
    return Response(
        structs.replace(tilt, max_deg=max(2.0, min(tilt.max_deg, vehicle.tilt_max_deg))),
        structs.replace(climb, max_m_s=min(climb.max_m_s, vehicle.climb_max_m_s)),
    )


def _flyable_tilt(settings: Settings) -> TiltResponse:
    """Return the tilt's response with the least of the limits of file, driver and controller."""
    tilt = _within_driver(response_model(settings), settings).tilt
    return structs.replace(tilt, max_deg=min(tilt.max_deg, settings.guidance.follow_deck.tilt_max_deg))


def field_of_view(camera: Camera) -> FieldOfView | None:
    """Return the field of a camera that looks down, in the body's axes; None of one that looks elsewhere.

    Half a field is that from the optical axis to the nearer edge.
    """
    mount = camera.T_body_cam
    down = mount.R.matrix[:, 2]
    if float(down[2]) < math.cos(math.radians(10.0)):
        return None
    half_u = math.atan(min(camera.cx, camera.width - 1 - camera.cx) / camera.fx)
    half_v = math.atan(min(camera.cy, camera.height - 1 - camera.cy) / camera.fy)
    across = abs(float(mount.R.matrix[1, 0])) > math.sqrt(0.5)
    half_forward, half_right = (half_v, half_u) if across else (half_u, half_v)
    return FieldOfView(float(mount.t[0]), float(mount.t[1]), half_forward, half_right)


def tracker(settings: Settings) -> TrackerConfig:
    """Return the configuration of the pad tracker.

    Raises:
        BadInput: the camera or pad file, or the network for a second opinion, is missing or has a fault.
    """
    vision = settings.vision
    opinion: SecondOpinion | None = None
    if vision.learned != "off":
        read: ReadOpinion = offered("opinions", vision.learned, f'vision.learned = "{vision.learned}"')
        opinion = read(vision.learned_file, "vision.learned_file")
    limits = settings.estimator.integrity
    return TrackerConfig(
        camera_model(settings), pad_model(settings), vision, FRAME_WORK, second_opinion=opinion, integrity=limits
    )


def estimator_options(settings: Settings) -> EstimatorOptions:
    """Return the estimator's options, with those that depend on the vehicle and on the ship's receiver.

    An AR.Drone's optical flow is relative to the surface that it sees, deck or water; an autopilot's velocity is over the ground.
    """
    options, ship = settings.estimator, settings.vessel
    at_pad = structs.replace(options.ekf, pad_forward_m=ship.pad_forward_m, pad_right_m=ship.pad_right_m)
    options = structs.replace(options, ekf=at_pad)
    if options.ekf.velocity_is_over != "auto":
        return options
    over: Literal["ground", "either"] = "ground" if settings.vehicle.over_ground else "either"
    return structs.replace(options, ekf=structs.replace(options.ekf, velocity_is_over=over))


def with_mount(options: EstimatorOptions, camera: Camera) -> EstimatorOptions:
    """Return the options with the mount as well known as the camera's file says, where that is better than the settings'."""
    if camera.cov_mount is None:
        return options
    sigma_rad = max(_MOUNT_LEAST_RAD, math.sqrt(float(camera.cov_mount.trace()) / 3.0))
    return structs.replace(options, ekf=structs.replace(options.ekf, sigma_mount_rad=min(sigma_rad, options.ekf.sigma_mount_rad)))
