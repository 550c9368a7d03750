"""The landing's decisions: the mission, the control law, and what they know beside the estimate."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from msgspec import Struct, field, structs

from companion.base.mission import CONTACT_INTENDED, ENDED, FLOWN, GROUND, ORDERED, Event, Reason, ReasonCause, State, StateChange
from companion.base.observer import ResponseInUse
from companion.guidance import targets
from companion.guidance.controller import HORIZONS_S, AtContact, Controller, FieldOfView, Impact, Knowledge, Target
from companion.guidance.flight_memory import KEPT_WAY_S, FlightMemory, carried_on, memory_of, resumed_by
from companion.guidance.law.controllers import ControllerSetup, make_controller
from companion.guidance.law.flown_course import reported_lean
from companion.guidance.law.margins import expected_error_m
from companion.guidance.law.response_watch import ResponseIdentifier
from companion.guidance.mission import land_here, limits
from companion.guidance.mission.charge import ChargeWatch, battery_ends
from companion.guidance.mission.clearance import SwellWatch, watched_swell
from companion.guidance.mission.contact import ContactWatch, watched
from companion.guidance.mission.gate import gate_of
from companion.guidance.mission.held_course import OFF_M, ClimbWatch
from companion.guidance.mission.held_up import HeldUp
from companion.guidance.mission.hold_blind import keep_up
from companion.guidance.mission.machine import allowed, mission_step, require_mission, take, take_order, take_status
from companion.guidance.mission.out_of_reach import flown_by_others
from companion.guidance.mission.progress import (
    HELD_BY_PERSON,
    GuidanceCycle,
    InputQuality,
    Progress,
    VehicleHold,
    VesselPosition,
    fit_to_steer,
)
from companion.guidance.mission.tipped import tipped
from companion.guidance.mission.vessel_track import VesselTrack
from companion.guidance.mission.waiting import end_of, ends_here
from companion.guidance.mission.wind import ReportedWind, WindOverDrone, WindWatch, trim_level, wind_by_ship, wind_over_drone
from companion.guidance.mission.wind import reported as reported_wind
from companion.guidance.mission.wind import watched as watched_wind
from companion.guidance.operator.command_limits import Unmeasured, without_velocity
from companion.settings.guidance import ClimbResponse, GuidanceOptions, TiltResponse
from companion.settings.load import shipped_response
from companion.settings.operator import LimitOptions, ManualOptions
from companion.settings.vessel import ReportLimits
from drivers.mavlink.options import VELOCITY_MODES
from drivers.vehicle import PHASE_MODES
from estimator.contracts.commands import Command, Lean, Velocity
from estimator.contracts.estimates import FusionResult, IntegrityAlert, PathName, RelativeState, Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.samples import (
    Attitude,
    Baro,
    Baseline,
    BodyVelocity,
    GeoFix,
    GimbalAttitude,
    Imu,
    OfVessel,
    Range,
    Sample,
    VehicleStatus,
    VesselReport,
    VesselWind,
)
from estimator.contracts.time import MonoNs, Stamp, seconds_between
from estimator.ekf import Forecast
from estimator.pipeline import RelativeEstimator
from estimator.ship_motion import ShipMotionOptions
from estimator.vision.detection import PadCheck

_TILT_LEFT_DEG = 2.0
"""Distance that is kept from an autopilot's own limit of the tilt, deg: its loops overshoot."""
_FORECAST_S = 0.2
"""Time between two forecasts of the deck, s: they cost more than the rest of a guidance cycle, and change slowly."""
_NIS_WEIGHT = 0.1  # weight of the newest frame in the mean of the normalized innovation
_IMPOSSIBLE_S = 1.0
"""Time for which an impossible motion of the deck stands against the estimate, s."""
_UNFELT_S = 1.0
"""Time without the accelerometer after which no landing goes on, s: thrust and sightings show the speed late, and the vehicle
swings about the pad by 0.7 m/s. The commit that is under way ends before."""
_RANGE_S = 0.2
"""Age up to which a range counts for a contact, s."""
_BARO_S = 2.5
"""Age up to which a barometer counts against the orders, s: an autopilot sends one reading a second."""
_TAKES_MODE_S = 10.0
"""Time that an autopilot may take to change to our mode after an order, s."""
_FAULTED = frozenset({State.GO_AROUND, State.REFUSED, State.GAVE_UP, State.ANOTHER_PAD})
_IGNORED_S = 60.0
"""Time after the operator's order for which what was seen on the pad is ignored, s: an attempt and the way to it."""
_SAME = {ReasonCause.ON_PAD: 0.2, ReasonCause.NEAR_PAD: 0.5, ReasonCause.GLARE: 0.1}
"""Distance and growth up to which what is seen is the thing that was there, m; growth of the share in glare."""
_PLAIN = frozenset(State) - _FAULTED - ENDED - {State.RENDEZVOUS, State.GATE, State.HOLD_BLIND} | {State.LANDED}
_BY_REPORTS = (State.SEARCH, State.RENDEZVOUS, State.LAND_HERE)
"""States in which the drone flies by the reports of ship and vehicle, where it may."""
_NEAR = (State.GATE, State.COMMIT, State.LAND_HERE)
"""States in which the contact to come is predicted."""
_DELAY_KEEP = 0.98
"""Share of the camera's delay that stays from one sighting to the next when those are later: a late one is jitter."""
_UNPICTURED_S = 0.5
"""Time since the newest sighting by the camera from which a baseline's delay and agreement are those of the sight, s."""
_LATE_VIDEO_S = 0.15
"""Delay of the camera from which the operator sees its cost, s."""
_REPORTS_CHARGE = 0.15  # charge over the last one from which on the operator reads what becomes of the drone
_REPORTS_S = 240.0  # time until none is left from which on the operator reads it
_WAITS = HELD_BY_PERSON | {State.STAY, State.TAKEN}
"""States that last for as long as a person likes."""


class PilotOptions(Struct, frozen=True):
    """Options of a pilot and its landing, beside those of its tracker, its estimator and its guidance."""

    automatic: bool = True
    """True if the approach begins as soon as the vehicle flies; otherwise it waits for `begin`."""
    shadows: Sequence[PathName] = ()
    """Estimator paths that run for comparison only and never steer."""
    law: Callable[[GuidanceOptions], Controller[Any]] = lambda o: make_controller(
        ControllerSetup(o, shipped_response("ardrone2"))
    )
    """Makes the control law from guidance's options."""
    manual: ManualOptions | None = None
    """The options of manual flight."""
    limits: LimitOptions | None = None
    """The limits of every command."""
    over_ground: bool = False
    """True if the vehicle's own hover holds over the ground, and its driver adds the deck's velocity to a velocity."""
    reports: ReportLimits = field(default_factory=ReportLimits)
    """Limits for the positions that ship and vehicle report."""
    motion_sensor: ShipMotionOptions = ShipMotionOptions()
    """The ship's motion sensor."""
    tilt: TiltResponse = field(default_factory=lambda: shipped_response("ardrone2").tilt)
    """Response of the vehicle's tilt, by its file; by default an AR.Drone's."""
    climb: ClimbResponse | None = None
    """Response of its climb, by its file; None where it has none."""
    view: FieldOfView | None = None
    """The field of a camera that leans with the body; None of another."""
    resumes: bool = False
    """True if a landing that a person took over goes on when the driver says that it was given back."""
    rim_m: float = math.inf
    """Distance from the pad's centre up to which all feet are on the pad."""
    gimballed: bool = False
    """True if a gimbal carries the camera, whose file then holds its rotation on the gimbal's last axis."""


class _Bar(Struct, frozen=True):
    """One thing that bars the landing, as it is seen."""

    reason: Reason
    size: float
    """Width or height, m, or share of the pad in glare; 0 of what moves."""
    place_m: tuple[float, float] = (0.0, 0.0)

    def same(self, before: "_Bar") -> bool:
        """Return whether it is the thing of before, no larger and at its place; what moves never is."""
        alike = self.size > 0.0 and self.reason.cause is before.reason.cause
        return alike and max(self.size - before.size, math.dist(self.place_m, before.place_m)) <= _SAME[self.reason.cause]


class _Flight(Struct):
    """Knowledge of one flight; a take-off begins another."""

    law: Any
    """The control law's memory."""
    contact: ContactWatch = field(default_factory=ContactWatch)
    held: HeldUp = field(default_factory=HeldUp)
    held_by_deck: HeldUp = field(default_factory=HeldUp)
    impact: Impact | None = None
    touch: Impact | None = None
    forecast: Forecast | None = None
    climb_watch: ClimbWatch = field(default_factory=ClimbWatch)
    wind: WindWatch = field(default_factory=WindWatch)
    swell: SwellWatch = field(default_factory=SwellWatch)
    on_pad: PadCheck | None = None
    ignored: tuple[_Bar, ...] = ()
    ignored_at: MonoNs = MonoNs(0)


class LandingGuidance:
    """Decides on commands by samples and estimates.

    Raises:
        BadInput: the settings want a mission or a controller that is not installed.
    """

    def __init__(self, guidance: GuidanceOptions, options: PilotOptions) -> None:
        require_mission(guidance)
        self._guidance = guidance
        self.mission = Progress.start(automatic=options.automatic)
        self._make_law = options.law
        self._law = options.law(guidance)
        self._flight = _Flight(self._law.start())
        self.hold = VehicleHold(options.over_ground)
        """The hold that the vehicle has by itself."""
        self._resumes, self._rim_m = options.resumes, options.rim_m
        self._response = ResponseIdentifier(options.tilt, guidance)
        self._changes: list[StateChange] = []
        self._left = False
        """True if a service that came back left the vehicle to the person who took it meanwhile, until an order to begin."""
        self._cycle: GuidanceCycle | None = None
        """The newest guidance cycle; None before the first."""
        self.before: FlightMemory | None = None
        """The flight's state as the service before this one left it, until a vehicle is found in the air."""
        self.ship_way: Callable[[MonoNs], tuple[float, float] | None] = lambda now: None
        """Returns her way over the ground, m/s north and east, as the vehicle's driver measures it, or None."""
        self._way_before: FlightMemory | None = None
        """The flight's state as the service before this one left it, for the ship's way."""
        self.memory: FlightMemory | None = None
        """The flight's state for the service after this one; None before the first guidance cycle."""
        self.vehicle: VehicleStatus | None = None
        """The vehicle's latest status; None before the first."""
        self._charge = ChargeWatch()
        self.by_hand = False
        """True while a person flies the vehicle by our sticks."""
        self._now = MonoNs(0)
        self._attitude: Attitude | None = None
        self._heard: MonoNs | None = None
        """Time of receipt of the vehicle's own newest sample."""
        self._measured: MonoNs | None = None
        """Time at which the vehicle's newest sample was measured."""
        self._range: Range | None = None
        self._impossible: MonoNs | None = None
        """Time when the deck's estimated motion was last impossible."""
        self._trusts_velocity = True
        self._tipped: Reason | None = None
        """Evidence in the newest guidance cycle that the vehicle lies on the deck."""
        self._unfelt_since: MonoNs | None = None
        """Instant since which the estimate does without the accelerometer."""
        self._deck_down_m_s: float | None = None
        """The deck's vertical speed over the ground in the newest guidance cycle; None if it is not known."""
        self._ordered: Command | None = None
        """The command of the newest guidance cycle, before people and limits."""
        self._climbs_m_s: float | None = None
        """Rate of climb of the newest command; None of one without."""
        self._baro: Baro | None = None
        self._tilt, self._climb, self._view = options.tilt, options.climb, options.view
        self._air: WindOverDrone | None = None
        self._quality = InputQuality()
        self._frames: Counter[Verdict] = Counter()
        self._pictured: MonoNs | None = None
        """Instant of the newest sighting by the camera."""
        self._by_baselines = False
        """True if the newest sight of the pad is by baselines."""
        self._thing: Reason | None = None
        self.vessel_track = VesselTrack(options.reports)
        self._ship_wind: ReportedWind | None = None
        self._vessel: VesselPosition | Reason | None = None
        """The ship's place by reports in the newest guidance cycle, or why it is not known; None while it is not flown by."""

    @property
    def state(self) -> State:
        """The state of the mission."""
        return self.mission.state

    @property
    def charge(self) -> str:
        """The end of the charge for a drone that a person left in the air or flies, in words, once it is near; empty before."""
        battery, left_s, o, p = self._charge.fraction, self._charge.left_s(self._now), self._guidance, self.mission
        if battery is None or p.state not in _WAITS:
            return ""
        if battery >= o.last_charge + _REPORTS_CHARGE and (left_s is None or left_s > _REPORTS_S):
            return ""
        here, last = f"at {100.0 * o.limits.battery:.0f} % it lands on a pad in sight", f"at {100.0 * o.last_charge:.0f} %"
        ends = {
            "": "whoever flies it has to land it before",
            "hold": "it holds on until it falls: land it",
            "land": f"{here}, {last} where it is",
            "return": f"{last} it flies back by the autopilot's own return",
        }
        staying = p.state is State.STAY
        end = here if staying else ends[end_of(p, o, over_ground=self.hold.over_ground, by_hand=self.by_hand)]
        left = (
            "" if left_s is None else f", about {left_s / 60.0:.0f} min left" if left_s > 90.0 else f", about {left_s:.0f} s left"
        )
        return Reason(ReasonCause.CHARGE, 100.0 * battery, detail=f"{left}: {end}").text

    @property
    def reason(self) -> str:
        """Reason why the vehicle does not simply descend, and how its charge ends, as text for the operator; else empty."""
        return "; ".join(filter(None, (self._reason, self.charge)))

    @property
    def _reason(self) -> str:
        if self.mission.state is State.LAND_HERE:
            return "; ".join(filter(None, (self.touch().text, self.barred()[0])))
        if self.mission.state is State.GATE:
            waits_for = gate_of(self.mission).waits_for
            return "" if waits_for is None else waits_for.text
        if isinstance(self._vessel, Reason) and self.mission.state in _BY_REPORTS:
            return self._vessel.text
        if isinstance(self._vessel, VesselPosition) and self.mission.state is State.RENDEZVOUS:
            return Reason(ReasonCause.VESSEL_AWAY, self._vessel.distance_m).text
        if self.mission.state is State.INTERCEPT and self._thing is not None:
            return self._thing.text
        ended = self.mission.reason
        if self.mission.state is State.PAUSED and ended is not None and ended.cause in (ReasonCause.STAYED, ReasonCause.SERVICE):
            return ended.text
        if self.mission.state in _PLAIN:
            return "" if (late := self._late_video()) is None or self.mission.state not in FLOWN else late.text
        why = self.mission.fault if self.mission.state in _FAULTED else self.mission.reason
        return "; ".join(each.text for each in (why, self._lands_here()) if each is not None)

    def touch(self) -> land_here.Touch:
        """Return where a landing touches that is made where the vehicle is, or is ordered now."""
        here = self.mission.here if self.mission.lands_here else None
        return land_here.Touch() if self._cycle is None else land_here.touch(self._cycle, self._guidance, here)

    def _lands_here(self) -> Reason | None:
        """Return that a drone that refused will land where it is, once its charge comes near to that."""
        battery, last = self._charge.fraction, self._guidance.last_charge
        if battery is None or battery >= last + _REPORTS_CHARGE or not ends_here(self.mission, self._guidance, self.hold):
            return None
        return Reason(ReasonCause.LANDS_HERE, 100.0 * battery, 100.0 * last)

    def _late_video(self) -> Reason | None:
        """Return that the video is late, with the error that it leaves to expect; None where it is not."""
        late_s = self._quality.delay_s
        if late_s < _LATE_VIDEO_S or self._by_baselines:
            return None
        return Reason(ReasonCause.VIDEO_LATE, late_s, 100.0 * expected_error_m(self._tilt, late_s))

    def order(self, event: Event, at: MonoNs | None = None, why: Reason = ORDERED) -> None:
        """Take an order, given at a time later than the newest sample or cycle, or now."""
        self._now = max(self._now, at or self._now)
        if event in (Event.BEGIN, Event.STAY):
            self.vessel_track = self.vessel_track.restarted()
            self._flight.climb_watch = ClimbWatch()
            # What refused it for late answers flies by no tilt any more, by which its answers could be seen to be in time.
            self._response.begin()
        if event is Event.HOLD and self.before is not None and State.__members__.get(self.before.state) in FLOWN:
            # A hold may come before the vehicle's first report, and what was under way does not go on against it.
            self.before = structs.replace(self.before, state=State.PAUSED.name)
        self.mission, changes = take_order(self.mission, event, self._now, self._guidance, why)
        self._changes += changes

    def retune(self, guidance: GuidanceOptions) -> None:
        """Use other settings from now on; the present approach continues.

        The law keeps its memory: what it knows of wind and trim does not depend on its options.

        Raises:
            BadInput: the settings want a mission or a controller that is not installed; nothing changed.
        """
        require_mission(guidance)
        if guidance != self._guidance:
            before, self._law = self._law, self._make_law(guidance)
            if type(before) is not type(self._law):
                self._flight.law = self._law.start()
            self._response.retune(guidance)
        self._guidance = guidance

    def changed(self) -> tuple[StateChange, ...]:
        """Return the changes of state since the last call."""
        changes, self._changes = tuple(self._changes), []
        return changes

    def _feel(self, imu: Imu) -> None:
        before, felt = self._flight.contact, watched(self._flight.contact, imu)
        self._flight.contact = felt
        # By our own clock: a stamp that lies would put the contact before the commit.
        if felt.newest is not None and felt.newest is not before.newest:
            self._flight.impact = structs.replace(felt.newest, at=imu.stamp.received_at)
        if felt.touch is not None and felt.touch is not before.touch:
            self._flight.touch = structs.replace(felt.touch, at=imu.stamp.received_at)

    def on_samples(self, samples: Sequence[Sample]) -> None:
        """Note what guidance itself needs of samples, beside the estimator."""
        for sample in samples:
            received_at = sample.stamp.received_at
            if received_at > self._now:
                self._now = received_at
            # By the type itself: hundreds of samples a second, and a match checks one class after the other.
            if type(sample) is Imu:
                if self.mission.state not in GROUND:
                    self._feel(sample)
            elif type(sample) is Attitude:
                self._response.on_attitude(sample.stamp, reported_lean(sample.R_ned_body))
                self._attitude = sample
            elif type(sample) is VehicleStatus:
                self._on_status(sample)
            elif type(sample) is Range:
                self._range = sample
            elif type(sample) is Baro:
                self._baro = sample
            elif type(sample) is BodyVelocity:
                if self.hold.over_ground and self._trusts_velocity and self.state not in GROUND:
                    self._feel_held(sample.stamp.measured_at, float(sample.v_level[2]))
            elif type(sample) is GeoFix or type(sample) is VesselReport:
                self.vessel_track = self.vessel_track.on_sample(sample)
                if of_ship(sample):
                    continue
            elif type(sample) is VesselWind:
                self._ship_wind = reported_wind(self._ship_wind, sample)
                continue
            elif isinstance(sample, (GimbalAttitude, OfVessel, Baseline)):
                continue
            self._heard = received_at
            self._measured = max(self._measured or sample.stamp.measured_at, sample.stamp.measured_at)

    def _feel_held(self, at: MonoNs, down_m_s: float) -> None:
        """Note the vehicle's vertical speed over the ground, m/s down, against the commands over the ground and to the deck."""
        ground, deck = self._flight.held, self._flight.held_by_deck
        self._flight.held = ground.measured(at, down_m_s)
        if self._deck_down_m_s is not None:
            self._flight.held_by_deck = deck.measured(at, down_m_s - self._deck_down_m_s)
        for before, after in ((ground, self._flight.held), (deck, self._flight.held_by_deck)):
            if after.newest is not before.newest:
                self._flight.impact = after.newest

    def _on_status(self, status: VehicleStatus) -> None:
        before, self.vehicle = self.vehicle, status
        self._charge = self._charge.reported(status.stamp.received_at, status.battery_fraction)
        if status.flying is False:
            self.before = None
        self._left = self._left and self.state is State.TAKEN
        resumes = self._resumes and not self._left
        self.mission, changes = take_status(self.mission, status, self._guidance, resumes=resumes)
        self._changes += changes
        chosen = status.mode in targets.MODES and (before is None or before.mode != status.mode) and status.taken is None
        if chosen and self._guidance.mission == "targets" and self.state not in GROUND:
            # The pilot's own choice of the landing mode is the order to lead it.
            reason = Reason(ReasonCause.PILOT_LANDS, detail=status.mode)
            self.mission, begun = take(self.mission, Event.BEGIN, reason, status.stamp.received_at, self._guidance)
            self._changes += begun
        if any(change.event is Event.TAKEN_OFF for change in changes):
            self._flight = _Flight(self._law.start())
            self._response.begin()
            self._resume(status)

    def _resume(self, status: VehicleStatus) -> None:
        """Go on where a service before this one was in this flight, as far as that is known and no other has the vehicle."""
        before, self.before, at = self.before, None, status.stamp.received_at
        event = resumed_by(before, at, status.mode)
        if before is None or event is None or status.taken is not None:
            return
        reason = Reason(ReasonCause.RESTARTED, seconds_between(before.at, at), detail=State[before.state].value)
        if event is Event.TAKEN:
            self._left, reason = True, Reason(ReasonCause.TAKEN_OVER, detail=f"while the service was away: mode {status.mode}")
        self.mission, changes = take(self.mission, event, reason, at, self._guidance)
        self.mission, self._way_before = carried_on(self.mission, before, at, taken=event is Event.TAKEN), before
        self._changes += changes

    def reported_way(self, now: MonoNs) -> F64 | None:
        """Return the ship's way by her reports, or as the service before this one knew it: (2,) m/s north and east, or None."""
        if (reported := self.vessel_track.velocity_ned(now)) is not None:
            return reported
        before = self._way_before
        if before is None or before.way_ned is None or seconds_between(before.at, now) > KEPT_WAY_S:
            return None
        return np.array(before.way_ned)

    def doubted(self, now: MonoNs) -> IntegrityAlert | None:
        """Return why an estimate that is consistent by itself may not be landed by; None if it may."""
        if self._impossible is not None and seconds_between(self._impossible, now) <= _IMPOSSIBLE_S:
            return IntegrityAlert.DECK
        unfelt_s = 0.0 if self._unfelt_since is None else seconds_between(self._unfelt_since, now)
        return IntegrityAlert.UNFELT if unfelt_s > _UNFELT_S else None

    def knowledge(self, now: MonoNs, relative: RelativeState | None, estimator: RelativeEstimator) -> Knowledge:
        """Return what guidance knows in this cycle, and judge how the deck is estimated to move and whether the vehicle is felt.

        Args:
            relative: the steering path's estimate.
            estimator: that of the motions, the forecast and the sensors that it does without.
        """
        (body, deck), guard = estimator.motion(now), estimator.guard
        self._trusts_velocity = guard.trusts_velocity
        felt = self._flight.impact, self._flight.touch
        self._tipped = tipped(guard.inertial.parity.bins, felt, math.radians(self._tilt.max_deg))
        if not guard.inertial.accel_lost:
            self._unfelt_since = None
        elif self._unfelt_since is None:
            self._unfelt_since = now
        if limits.impossible_deck(deck):
            self._impossible = now
        objection = self.doubted(now)
        if objection is not None and relative is not None:
            relative = alerted(relative, objection)
        flight = self._flight
        if objection is IntegrityAlert.DECK:
            deck = flight.forecast = None
        elif flight.forecast is None or abs(seconds_between(flight.forecast.at, now)) >= _FORECAST_S:
            flight.forecast = estimator.forecast(now, HORIZONS_S)
        self._deck_down_m_s = None if deck is None else float(deck.v_level[2])
        flight.swell = watched_swell(flight.swell, now, deck)
        climb_m_s, own = self._law.climb_max_m_s, self.vehicle
        tilt_deg = None
        if own is not None and own.tilt_max_deg is not None:
            tilt_deg = min(max(2.0, own.tilt_max_deg - _TILT_LEFT_DEG), self._guidance.follow_deck.tilt_max_deg)
        known = Knowledge(
            now, relative, body, deck, flight.forecast, flight.impact, self._response.in_use, climb_m_s, self._climb,
            jerk_max_m_s3=None if own is None else own.jerk_max_m_s3,
            tilt_max_deg=tilt_deg,
            trusts_velocity=guard.trusts_velocity,
            unfelt=self._unfelt_since is not None,
            # In steps, so that a forecast is carried on once and not in each cycle.
            swell_rad_s=round(flight.swell.rad_s, 1),
            swell_watched_s=flight.swell.known_s,
            outrun_m=0.0 if climb_m_s is None else flight.swell.gained_m(climb_m_s),
            confirmed=estimator.ship_motion.confirmed(now),
            aim_level=(0.0, 0.0) if self._air is None else self._air.aim_level(self._guidance.cone.feet_below_m),
            rim_m=max(self._rim_m, self._guidance.limits.error_m),
        )  # fmt: skip
        return structs.replace(known, at_contact=self._at_contact(known))

    def _at_contact(self, seen: Knowledge) -> AtContact | None:
        """Return what the contact will be like, by the law's memory of the cycle before."""
        estimate = seen.relative
        if estimate is None or self.mission.state not in _NEAR:
            return None
        if self.mission.lands_here:
            x, y = land_here.over(self.mission.here, seen, estimate).tolist()
            seen = structs.replace(seen, aim_level=(x, y))
        left_s = limits.to_contact_s(estimate, seen, self._guidance.cone)
        ahead = self._law.ahead(self._flight.law, seen, left_s)
        if ahead is None:
            return None
        air = self._air
        if air is None:
            return AtContact(*ahead, limits.sigma_m(estimate))
        gusts_m = limits.gusts_m(air.gust_m_s * self._tilt.drag_1_s, left_s)
        gust_most_m_s = math.inf if battery_ends(self._charge.fraction, self._guidance) else air.begins_most_m_s
        return AtContact(*ahead, math.hypot(limits.sigma_m(estimate), gusts_m), air.begins_m_s, gust_most_m_s)

    def in_sight(self, knowledge: Knowledge) -> RelativeState | None:
        """Return the steering estimate while it is fit to steer by; None out of sight."""
        estimate = knowledge.relative
        return estimate if fit_to_steer(estimate, knowledge.at, self._guidance.stale_after_s) else None

    def _wind_over_drone(self, knowledge: Knowledge) -> WindOverDrone | None:
        """Return the wind by the drone's own lean, by the ship's report where it says nothing, or None."""
        body = knowledge.body
        if body is None:
            return None
        tilt = self._tilt if knowledge.tilt_max_deg is None else structs.replace(self._tilt, max_deg=knowledge.tilt_max_deg)
        air = wind_over_drone(self._flight.wind, tilt, body.heading_rad, self._view)
        if air is not None and air.known:
            return air
        way = self.vessel_track.velocity_ned(knowledge.at)
        return wind_by_ship(self._ship_wind, knowledge.at, way, tilt, body.heading_rad, self._view) or air

    def command(self, knowledge: Knowledge, unconfirmed: Reason | None = None) -> Command | None:
        """Run one guidance cycle; return its command, None while guidance leaves the vehicle alone.

        Args:
            unconfirmed: why nothing is flown by the velocity out of sight, once the monitor has waited long enough.
        """
        now = knowledge.at
        self._now = max(self._now, now)
        self._flight.wind = watched_wind(self._flight.wind, knowledge)
        self._air = self._wind_over_drone(knowledge)
        place: VesselPosition | Reason | None = None
        if self._guidance.rendezvous.enabled and self.state in _BY_REPORTS:
            if self._attitude is not None:
                self.vessel_track = self.vessel_track.on_sample(self._attitude)
            place = self.vessel_track.position(now)
        self._vessel = place
        self._thing, unseen = self._lies_there(now)
        silent_s = 0.0 if self._heard is None else max(0.0, seconds_between(self._heard, now))
        near = self._range
        range_m = None if near is None or seconds_between(near.stamp.measured_at, now) > _RANGE_S else near.range_m
        s = GuidanceCycle(
            now, knowledge, self._charge.fraction, self._air, self._quality, self._frames, place, silent_s,
            self._flight.contact.feels and not knowledge.unfelt,
            self._response.late_s, self._flight.touch, range_m, self.hold, self._thing, unseen, self._off_orders(knowledge),
            0.0 if self._measured is None else max(0.0, seconds_between(self._measured, now)),
            "" if self.vehicle is None else self.vehicle.mode, self._tipped, unconfirmed, self.by_hand,
        )  # fmt: skip
        self.mission, aim, changes = mission_step(self.mission, s, self._guidance)
        self._changes += changes
        self.memory, self._cycle = structs.replace(memory_of(self.mission, s), way_ned=self.ship_way(now)), s
        target = aim if isinstance(aim, Target) else None
        self._flight.law, command = self._law.step(self._flight.law, now, knowledge, target)
        if isinstance(aim, Target):
            aim = allowed(command, self.mission, s, self._guidance)
        self._ordered = keep_up(aim, self.mission, s, self._guidance)
        return self._ordered

    def without_velocity(self, command: Command, knowledge: Knowledge, *, guided: bool, unconfirmed: bool = False) -> Command:
        """Return what is flown in place of a velocity while the measured one is refused, as `command_limits` has it.

        Args:
            guided: guidance requests the command, and no person.
            unconfirmed: the monitor refuses it: the estimate out of sight has followed it, so no tilt is flown by that either.
        """
        if knowledge.body is not None:
            trim = trim_level(self._flight.wind, knowledge.body.heading_rad)
        else:
            trim = np.zeros(2) if self._attitude is None else trim_level(self._flight.wind, self._attitude.R_ned_body.rpy_rad[2])
        seen = self.in_sight(knowledge)
        by = Unmeasured(trim, self._tilt.drag_1_s, None if seen is None else -seen.v_pad_level, self.hold.over_ground)
        wanted = Velocity(command.v_level, command.yaw_rate_rad_s) if unconfirmed and isinstance(command, Lean) else command
        flown = without_velocity(wanted, by, guided=guided)
        if command is self._ordered:
            # It climbs as ordered, and so it counts.
            self._ordered = flown
        return flown

    def on_command(self, now: MonoNs, command: Command | None) -> ResponseInUse | None:
        """Take the command that is sent; return the vehicle's response when it is another one than last reported, else None."""
        mode = "" if self.vehicle is None else self.vehicle.mode
        by_mode = not self.hold.over_ground or mode in VELOCITY_MODES
        if command is not self._ordered:
            self.mission = flown_by_others(self.mission)
        elif not by_mode and mode not in PHASE_MODES and self.mission.in_state_s(now) < _TAKES_MODE_S:
            # No climb is flown before the autopilot has taken our mode.
            self.mission = structs.replace(self.mission, climbs_m_s=0.0)
        response = self._response.on_command(now, command, self.state, flown=by_mode)
        # Without sight a way down is a velocity, of which the driver adds the deck's own along the deck alone.
        moving = (Lean, Velocity) if self.mission.lands_here else Lean
        down_m_s = float(command.v_level[2]) if isinstance(command, moving) else None
        self._climbs_m_s = None if down_m_s is None else -down_m_s
        if self.hold.over_ground:
            self._flight.held = self._flight.held.commanded(now, down_m_s)
            to_deck_m_s = self._flight.held.to_deck(now, self._deck_down_m_s)
            self._flight.held_by_deck = self._flight.held_by_deck.commanded(now, to_deck_m_s)
        return response

    def _off_orders(self, knowledge: Knowledge) -> Reason | None:
        """Note the heights of this cycle; return that they are not on the ordered course, None while they are."""
        if self._climb is None or self.state in GROUND or self.state in CONTACT_INTENDED:
            return None
        since_last_s = 0.0 if self.mission.last is None else max(0.0, seconds_between(self.mission.last, knowledge.at))
        seen, baro = self.in_sight(knowledge), self._baro
        if baro is not None and seconds_between(baro.stamp.measured_at, knowledge.at) > _BARO_S:
            baro = None
        seen_m = None if seen is None else seen.height_m
        self._flight.climb_watch = self._flight.climb_watch.flown(self._climbs_m_s, baro, seen_m, self._climb, since_last_s)
        if (off_m := self._flight.climb_watch.off_m) is None:
            return None
        return Reason(ReasonCause.OFF_ORDERS, abs(off_m), OFF_M, "higher" if off_m > 0.0 else "lower")

    def forecast_made(self, now: MonoNs) -> Forecast | None:
        """Return the deck's forecast if it was made in the cycle of this instant."""
        made = self._flight.forecast
        return None if made is None or made.at != now else made

    def on_fused(self, steering: FusionResult, stamp: Stamp) -> None:
        """Note how well a sighting agreed with the steering path's estimate, and how well its time is known."""
        self._pictured, self._by_baselines = stamp.measured_at, False
        self._note_quality(steering, stamp)

    def _note_quality(self, steering: FusionResult, stamp: Stamp) -> None:
        late_s, known_s = stamp.delay_s, self._quality.delay_s
        # The least delay of the newest sightings: it falls at once, and rises while all of them are later.
        delay_s = late_s if late_s < known_s or self._quality.time_sigma_s is None else late_s + _DELAY_KEEP * (known_s - late_s)
        mean = self._quality.normalized_nis
        if math.isfinite(steering.nis):
            now = steering.normalized_nis
            mean = now if mean is None else mean + _NIS_WEIGHT * (now - mean)
        self._quality = InputQuality(mean, stamp.sigma_s, delay_s)

    def on_baseline(self, steering: FusionResult, stamp: Stamp) -> None:
        """Note the same of a baseline, which counts as sight where the camera shows no pad."""
        if self._pictured is None or seconds_between(self._pictured, stamp.measured_at) > _UNPICTURED_S:
            self._by_baselines = True
            self._note_quality(steering, structs.replace(stamp, sigma_s=self._quality.time_sigma_s or 0.0))

    def on_pad(self, check: PadCheck | None) -> None:
        """Take what a frame's detection knows of things on the pad."""
        self._flight.on_pad = check or self._flight.on_pad

    def overrule(self) -> None:
        """Ignore the thing that bars the landing, by the operator's order: this one alone, where it is, and for a time."""
        self._flight.ignored, self._flight.ignored_at = (*self._flight.ignored, *self._bars(self._now)[:1]), self._now

    def barred(self) -> tuple[str, bool]:
        """Return what bars the landing, in words, empty if nothing does; and whether it may be ignored: what moves may not."""
        bars = self._bars(self._now)[:1]
        return "".join(bar.reason.text for bar in bars), any(bar.size > 0.0 for bar in bars)

    @property
    def ignoring(self) -> str:
        """The things that are ignored, in words; empty where none is."""
        things = "; ".join(bar.reason.text for bar in self._flight.ignored)
        return things and f"a thing on the pad is ignored: {things}"

    def _bars(self, now: MonoNs) -> list[_Bar]:
        """Return what bars the landing and is not ignored: a thing on the pad, one about it, and glare over it."""
        check, found = self._flight.on_pad, list[_Bar]()
        if check is None or seconds_between(check.at, now) > self._guidance.limits.on_pad_s:
            return found
        if (thing := check.thing) is not None:
            reason = Reason(ReasonCause.ON_PAD, 100.0 * thing.width_m, detail=f"{100.0 * thing.from_centre_m:.0f} cm")
            found.append(_Bar(reason, thing.width_m, (thing.forward_m, thing.right_m)))
        if (near := check.near) is not None:
            how = f"stands {100.0 * near.height_m:.0f} cm out of the deck" if near.height_m > 0.0 else "moves"
            reason = Reason(ReasonCause.NEAR_PAD, near.from_centre_m, detail=how)
            found.append(_Bar(reason, near.height_m, (near.forward_m, near.right_m)))
        if check.glare > 0.0:
            found.append(_Bar(Reason(ReasonCause.GLARE, 100.0 * check.glare), check.glare))
        return [bar for bar in found if not any(bar.same(known) for known in self._flight.ignored)]

    def _lies_there(self, now: MonoNs) -> tuple[Reason | None, Reason | None]:
        """Return the thing on the pad or about it that bars the landing, and the glare that hides a part of it."""
        given, ends = self._flight.ignored_at, self.state in {State.GO_AROUND, State.PAUSED, *ENDED}
        if (ends and (self.mission.since or now) > given) or seconds_between(given, now) > _IGNORED_S:
            self._flight.ignored = ()
        bars = self._bars(now)
        glare = [bar.reason for bar in bars if bar.reason.cause is ReasonCause.GLARE]
        return next((bar.reason for bar in bars if bar.reason not in glare), None), next(iter(glare), None)

    def on_verdict(self, verdict: Verdict) -> None:
        """Take the verdict on a frame."""
        if verdict is Verdict.FUSED:
            self._frames.clear()
        else:
            self._frames[verdict] += 1


def alerted(belief: RelativeState, alert: IntegrityAlert) -> RelativeState:
    """Return the estimate with an alert, which makes it inconsistent."""
    alerts = (*(other for other in belief.alerts if other is not alert), alert)
    return structs.replace(belief, consistent=False, alerts=alerts)


def of_ship(sample: Sample) -> bool:
    """Return whether a sample is about the ship and not the vehicle."""
    return isinstance(sample, OfVessel) or (type(sample) is GeoFix and sample.whose == "vessel")
