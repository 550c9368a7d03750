"""A body that an autopilot program flies as the grader of flights sees a world, with the faults of the streams around it."""

import numpy as np
from msgspec.structs import replace

from companion.base.health import Health
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import CENTRED, HandledOrder
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between
from sitl.emulators.autopilots.body import Body
from sitl.faults.corrupted import Corruptions
from sitl.faults.faulty_streams import VehicleStreams
from sitl.faults.kinds import OperatorActs
from sitl.faults.timer import FaultTimer
from sitl.flight.ending import Ending
from sitl.flight.grader import FlightGrader
from sitl.flight.hands import STOPS, MavlinkWires
from sitl.flight.referee import ON_DECK_M
from sitl.scenario.scenario import Scenario
from sitl.world.truth import RenderedFrame, Touchdown, Truth

_WATCH_EACH_S = 0.05
_NO_PIXELS = np.empty((0, 0, 3), np.uint8)


class GradedBody(NullObserver):
    """The faults of one flight with an autopilot program; they begin by the time since the order to land.

    As an observer of the daemon it learns guidance's phase, in which faults may begin, and what became of each frame.

    Args:
        settings: the daemon's.
        com_watchdog_s: time for which the program flies on with its last setpoint.
    """

    def __init__(self, scenario: Scenario, seed: int, settings: Settings, clock: Clock, com_watchdog_s: float) -> None:
        self.scenario, self.seed = scenario, seed
        self.faults = FaultTimer(scenario.faults, seed)
        self.streams = VehicleStreams(self.faults, seed)
        self.corruptions = Corruptions(self.faults, seed)
        self.guidance_phase: str | None = None
        """Phase of guidance; None before its first decision."""
        self.height_m = 0.0
        """Height over the deck's plane at the newest step, where faults are watched."""
        self._settings, self._com_watchdog_s = settings, com_watchdog_s
        self._grader: FlightGrader | None = None
        self._wires = MavlinkWires()
        self._clock = clock
        self.started = clock.now()
        """Instant of the order to land."""
        self._body: Body | None = None
        self._contacts: list[Touchdown] = []
        self._newest: Touchdown | None = None
        self._watched: MonoNs | None = None

    @property
    def now(self) -> MonoNs:
        """The flight's time."""
        return self._clock.now()

    at = now

    @property
    def contacts(self) -> tuple[Touchdown, ...]:
        """Every contact since the order to land."""
        return tuple(self._contacts)

    @property
    def reached(self) -> bool:
        """True if a service's commands reach the vehicle."""
        return not (self.streams.commands.silent or self.active("service_killed"))

    def active(self, kind: str) -> bool:
        """Return whether a fault of this kind is active."""
        return self.faults.active(kind)

    def stepped(self, body: Body, began: MonoNs | None) -> None:
        """Note a step of the physics.

        Args:
            began: instant of the order to land; nothing is wrong, graded or counted as a contact before it.
        """
        self._body = body
        if began is None:
            return
        self.started, now, landing = began, self._clock.now(), body.landing()
        if self.active("service_killed"):
            self.guidance_phase = None
        if landing is not None and (self._newest is None or landing.at != self._newest.at):
            self._newest = landing
            self._contacts.append(body.touchdown(now, self.guidance_phase))
        if not self.faults:
            return
        if self._grader is None:
            self._grader = FlightGrader(self, self._settings, self._com_watchdog_s)
        self.height_m = float(body.R_ned_pad.matrix[:, 2] @ (body.p_pad_ned - body.state().p_ned))
        self.faults.update(seconds_between(began, now), self.height_m, self.guidance_phase)
        if self._watched is None or seconds_between(self._watched, now) >= _WATCH_EACH_S:
            self._watched = now
            self._grader.step()

    def on_sent(self, data: bytes) -> None:
        """Note a datagram that the service sent."""
        for packet in self._wires.to_vehicle(data, self.now):
            if self._grader is not None:
                self._grader.referee.hands.sent(packet)

    def on_arrived(self, data: bytes) -> None:
        """Note a datagram that reached the service: an act that shows before commands reach the vehicle is its failsafe's."""
        act = self._wires.from_vehicle(data, self.now)
        if self._grader is None or act is None or not self.reached:
            return
        if act == "mode" or self.height_m - self._grader.feet.below_m > ON_DECK_M:
            self._grader.referee.hands.acts(act, self.now)

    def on_order(self, handled: HandledOrder) -> None:
        if self._grader is not None:
            acting = self.faults.on(OperatorActs)
            self._grader.on_act(handled, acting[-1][0].sticks if acting else CENTRED)

    def on_remote(self, act: str) -> None:
        """Note an act of the remote control that the vehicle obeys at once, before it reports it."""
        if self._grader is not None and act in STOPS:
            self._grader.referee.hands.acts(act, self.now)

    def result(self, pilot: Pilot, health: Health) -> Ending | None:
        """Return the graded result; None without faults or without an order to land."""
        if self._grader is None:
            return None
        return self._grader.result(pilot.outcome, pilot.operator.situation(self._clock.now()), health)

    def truth(self) -> Truth:
        """Return the true state at the newest step; call it after one."""
        assert self._body is not None
        contacts, newest = self.contacts, self._contacts[-1] if self._contacts else None
        return replace(self._body.truth(), at=self._clock.now(), touchdown=newest, contacts=contacts)

    def on_frame(self, processed: ProcessedFrame) -> None:
        stamp = processed.frame.stamp
        if self._grader is not None:
            self._grader.on_verdict(RenderedFrame(_NO_PIXELS, stamp.measured_at, processed.frame.exposure_s), processed.verdict)

    def on_decision(self, decision: Decision) -> None:
        if self._grader is not None:
            self._grader.on_decision(decision)
        self.guidance_phase = decision.phase
