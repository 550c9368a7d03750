"""Fly one flight in virtual time: the daemon's pilot and the driver's logic against the simulated drone, without sockets.

Everything between the two is the code of a real flight: AT commands as bytes, navdata, samples, vision, estimator, guidance.
Sockets, the video codec and threads are left out, so that a scenario and a seed give the same result to the bit.

A simulated person stands beside it and gives the orders of the scenario's `operator` faults to the service's arbiter.
"""

import math
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

import cv2
import numpy as np
from msgspec import structs

from companion.base.health import Health
from companion.base.observer import Decision, Observer
from companion.guidance.pilot import Pilot
from companion.settings.model import Settings
from drivers.ardrone import at
from drivers.ardrone.arbiter import CommandArbiter
from drivers.ardrone.custody import CommandStreamer
from drivers.ardrone.navdata import Navdata
from drivers.ardrone.navdata_channel import NavdataOrder, NavdataSampler, SequencePlace
from drivers.ardrone.options import ardrone_options
from drivers.ardrone.setup import configuration_commands
from drivers.clock import SetClock
from estimator.contracts.errors import BadInput, DecklanderError, SetupImpossible
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Frame
from estimator.contracts.time import NS_PER_S, MonoNs, after, seconds_between
from sitl.ardrone.drone import TICK_S, Drone, DroneClock
from sitl.ardrone.state import GENERATIONS, refusal
from sitl.ardrone.uvlc import ArrivingFrames, synced
from sitl.camera.render_worker import RenderWorker
from sitl.faults.carried import refuse_others
from sitl.faults.faulty_streams import InTransit
from sitl.faults.kinds import ServiceKilled
from sitl.flight.afterwards import Afterwards
from sitl.flight.ending import Ending
from sitl.flight.grader import FlightGrader
from sitl.flight.hands import SentPacket, WireRequest
from sitl.flight.person import SimulatedPerson
from sitl.flight.service import SimulatedService
from sitl.flight.stepped import Timing
from sitl.flight.vessel_reports import VesselReporter
from sitl.perception.port import Perception
from sitl.scenario.scenario import Scenario, camera_model
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.stage import flight_seeds
from sitl.world.truth import RenderedFrame
from sitl.world.world import World

NAVDATA_DELAY_S = 0.004
"""Delay of navdata to the service: one tick on a link that is not loaded."""
_TICK_NS, _NAVDATA_DELAY_NS = round(TICK_S * NS_PER_S), round(NAVDATA_DELAY_S * NS_PER_S)
_NO_PIXELS = np.empty((0, 0, 3), np.uint8)
_WATCH_EACH = 10
"""Number of ticks between two checks of the truth for the grade: 50 ms."""


def of_at(commands: Iterable[at.AtCommand], now: MonoNs) -> SentPacket | None:
    """Return what a datagram of AT commands requests; None where it steers nothing."""
    words = [command for command in commands if isinstance(command, at.Ref)]
    sticks = [command for command in commands if isinstance(command, at.Pcmd)]
    if any(word.emergency for word in words):
        return SentPacket(now, WireRequest.STOP)
    if words and not words[-1].take_off:
        return SentPacket(now, WireRequest.LAND)
    if not sticks:
        return None
    if sticks[-1].flags & at.PCMD_PROGRESSIVE:
        return SentPacket(now, WireRequest.MOVE)
    return SentPacket(now, WireRequest.HOVER if words else WireRequest.CENTRED)


class Flight:
    """A flight that is stepped from outside.

    Args:
        observers: objects that receive what the daemon's observers would receive.
        renew: makes the pilot of a service that restarts after it was killed.
        perception: the way in which the pilot, which must be its own, perceives the pad; rendered frames if None.

    Raises:
        BadInput: the scenario kills the service for a while and there is no `renew`.
            Or the scenario has a fault that the perception, or an AR.Drone, cannot represent.
        SetupImpossible: the simulated drone refuses a key of the configuration.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        settings: Settings,
        pilot: Pilot,
        *,
        observers: Sequence[Observer] = (),
        timing: Timing | None = None,
        renew: Callable[[], Pilot] | None = None,
        perception: Perception | None = None,
    ) -> None:
        cv2.setNumThreads(1)
        self.world = World(scenario, seed)
        self._perception = perception or Perception()
        self._perception.begin(self.world)
        self.worker: RenderWorker | None = None
        """Makes the frames, where one is set before the first step; else they are made in place. The same bits either way."""
        if renew is None and any(isinstance(f, ServiceKilled) and f.for_s is not None for f in scenario.faults):
            raise BadInput("service_killed comes back after for_s, and this flight cannot make the service again")
        refuse_others(scenario.title, scenario.faults, "ardrone")
        self._renew = renew or (lambda: pilot)
        self.contained = False
        """True if a bug of the service ends the flight and is part of the result, instead of being raised."""
        self._grader = FlightGrader(self.world, settings, ardrone_options(settings.vehicle).com_watchdog_s)
        self._person = SimulatedPerson(self.world.faults, self._grader.on_act)
        self._reporter = VesselReporter(self.world)
        self._views: dict[int, RenderedFrame] = {}
        self._observers = tuple(observers)
        self._settings, self._timing = settings, timing or Timing()
        self._limit_s = scenario.duration_limit_s
        self._options = ardrone_options(settings.vehicle)
        self._arbiter = CommandArbiter(self._options.hold_s, self._options.vz_max_m_s)
        self._generation = GENERATIONS[scenario.vehicle.generation]
        self._generation.check_model(self._options.model)
        self._generation.check_camera(camera_model(scenario))
        link = flight_seeds(self.world.seed).link
        self._arriving = ArrivingFrames(self._generation, self._options, link, rendered=self._perception.level == "pixels")
        self._link_rng, self._link_wander = np.random.default_rng([self.world.seed, 0x11A7]), 0.0
        self._sequence = self._ticks = 0
        start = self.world.now
        self._clock = SetClock(start)
        streams = self.world.streams
        self._frames_under_way: InTransit[Callable[[], RenderedFrame]] = InTransit(streams.frames)
        self._navdata_under_way: InTransit[tuple[Navdata, MonoNs]] = InTransit(streams.navdata)
        self._commands_under_way: InTransit[bytes] = InTransit(streams.commands)
        self._due_frame = self._due_command = start
        self._gone, self._phase = False, self.world.phase
        self.health = Health(self._clock)
        self.watched = True
        self._begin_service(pilot)
        self._drone = Drone(self.world, DroneClock(start), generation=self._generation)
        for key, commands in configuration_commands(self._options):
            for command in [*commands, at.Ctrl(at.CTRL_ACK)]:
                self._drone.take(self._encoded(command), start)
            if refused := refusal(self._drone.state.counters):
                raise SetupImpossible(f"the simulated drone refused the configuration key {key}: {refused}")
        self._frames = 0
        self.exposures = 0
        """Number of frames exposed so far, whether they arrive or not."""

    @property
    def pilot(self) -> Pilot:
        """The service's."""
        return self._service.pilot

    def unwatched(self) -> None:
        """Leave the results of samples out of health: without observers either, none are made."""
        self.watched = self._service.watched = False

    def step(self) -> bool:
        """Run one tick of 5 ms; return False when the flight is over."""
        now = self._tick()
        if now is None:
            return False
        ended = self.pilot.outcome is not None
        if self._gone:
            ended = self.world.phase in (VehiclePhase.LANDED, VehiclePhase.EMERGENCY)
        return not ended and seconds_between(self.world.started, now) < self._limit_s

    def afterwards(self) -> Afterwards:
        """Go on after the outcome, and return what came of it.

        The service of a vehicle in the air goes on as a daemon does. A vehicle on the deck is left to feet and friction. What
        observers received is that of the outcome.
        """
        world, later, going = self.world, Afterwards(self._grader, self.result()), True
        self._observers = ()
        self._service.unobserved()
        while going and seconds_between(world.at, later.ends) >= TICK_S:
            if later.flies:
                going = self._tick() is not None
            else:
                world.advance(min(after(world.at, _WATCH_EACH * TICK_S), later.ends))
                self._grader.step()
            if not later.flies or self._ticks % _WATCH_EACH == 0:
                later.step()
        return later

    def _tick(self) -> MonoNs | None:
        """Run one tick; return its instant, None where the service died in it."""
        now = MonoNs(self._clock.t + _TICK_NS)
        self._clock.t = now
        self._deliver_commands(now)
        self._drone.tick(now)
        self._ticks += 1
        if self._ticks % _WATCH_EACH == 0 or self.world.phase is not self._phase:
            self._phase = self.world.phase
            self._grader.step()
        if self._killed():
            self.world.guidance_phase = None
            self._hold(now)
            return now
        try:
            self._serve(now)
        except DecklanderError:
            raise
        except Exception as why:
            if not self.contained:
                raise
            place = traceback.extract_tb(why.__traceback__)[-1]
            self._grader.referee.died(f"{type(why).__name__}: {why} ({place.filename.rpartition('/')[2]}:{place.lineno})")
            return None
        return now

    def _serve(self, now: MonoNs) -> None:
        """Run the service for one tick."""
        for navdata, measured_at in self._navdata(now):
            received_at = MonoNs(now + _NAVDATA_DELAY_NS)
            self._streamer.on_navdata(navdata, received_at)
            samples = self._sampler.samples(navdata, synced(measured_at, received_at))
            for sample in samples:
                self._streamer.on_sample(sample)
            self._service.take(samples)
        if reports := self._reporter.reports(now):
            self._service.take(reports)
            if (located := self._reporter.located) is not None:
                self._grader.referee.sight.located(located)
        self._film(now)
        self._service.step(now, self._act, lambda command: self._streamer.take(command, now))
        if now >= self._due_command:
            self._due_command = after(self._due_command, self._options.command_period_s)
            self._arbiter.take(self._streamer.command(now))
            self._send(self._arbiter.commands(now))

    def _killed(self) -> bool:
        """Return whether the service's process is gone; after a restart it is a new process."""
        if self.world.faults.service_gone:
            self._service.catch_up()
            if not self._gone:
                # What the sender sends from here on is no answer of the service to an order.
                self.world.guidance_phase = None
                self._grader.step()
                self._arbiter.lost(self._clock.t)
                self._send(self._options.timeouts(self._options.hold_com_watchdog_s))
            self._gone = True
            return True
        if self._gone:
            self._gone = False
            self._send(self._options.timeouts(self._options.com_watchdog_s))
            before, after_it = self.pilot.landing.memory, self._renew()
            after_it.landing.before = before
            self._begin_service(after_it)
        return False

    def _hold(self, now: MonoNs) -> None:
        """Act as the sender, which outlives the service."""
        for navdata, _ in self._navdata(now):
            self._arbiter.on_report(navdata, MonoNs(now + _NAVDATA_DELAY_NS))
        if now >= self._due_command:
            self._due_command = after(self._due_command, self._options.command_period_s)
            self._send(self._arbiter.commands(now))

    def _begin_service(self, pilot: Pilot) -> None:
        """Reset the state of the service's process to that of a new process."""
        self._service = SimulatedService(self._settings, pilot, self.health, self._observers, self._clock, self._timing.vision_s)
        self._service.watched = self.watched
        self._service.arrived, self._service.judged, self._service.decided = self._arrived, self._judge, self._decided
        self._streamer = CommandStreamer(self._options)
        self._sampler = NavdataSampler(self._options)
        self._due_frame = self._due_command = self._clock.t
        self._navdata_order = NavdataOrder()
        self._frames_under_way.clear()

    def _encoded(self, command: at.AtCommand) -> bytes:
        self._sequence += 1
        return at.encode(self._sequence, command)

    def _send(self, commands: Sequence[at.AtCommand]) -> None:
        if (wire := of_at(commands, self._clock.t)) is not None:
            self._grader.referee.hands.sent(wire)
        for command in commands:
            self._commands_under_way.send(partial(bytes, self._encoded(command)), self._clock.t)
        self._deliver_commands(self._clock.t)

    def _deliver_commands(self, now: MonoNs) -> None:
        while (packet := self._commands_under_way.arrived(now)) is not None:
            self._drone.take(packet[1], now)

    def _navdata(self, now: MonoNs) -> Iterator[tuple[Navdata, MonoNs]]:
        """Send the drone's next datagram; give those that have arrived, in order, each with the instant of measuring."""
        for _, (navdata, measured_at) in self._navdata_under_way.through(self._datagram, now):
            if self._navdata_order.place(navdata.sequence) is not SequencePlace.OLD:
                yield navdata, measured_at

    def _datagram(self) -> tuple[Navdata, MonoNs]:
        return self._drone.navdata(), self._drone.measured_at

    def _film(self, now: MonoNs) -> None:
        if now < self._due_frame:
            return
        own = self._timing.frame_period_s
        self._due_frame = after(self._due_frame, own or 1.0 / self._drone.state.config.number(self._generation.frame_rate))
        self._frames_under_way.send(self._expose, self.world.at, self._frame_delay_s())

    def _frame_delay_s(self) -> float:
        """Return the delay of the frame that is exposed now: evenly spread in its range, and much like the one before."""
        effects, wrong, usual_s = self.world.scenario.effects, self.world.scenario.wrong_model, self._timing.frame_delay_s
        if effects.video_most_s > 0.0:
            self._link_wander = 0.9 * self._link_wander + 0.436 * self._link_rng.standard_normal()
            share = 0.5 + 0.5 * math.erf(self._link_wander / math.sqrt(2.0))
            usual_s = effects.video_least_s + share * (effects.video_most_s - effects.video_least_s)
        if wrong.video_jitter_s > 0.0:
            usual_s += self._link_rng.uniform(0.0, wrong.video_jitter_s)
        return max(0.0, usual_s + wrong.video_delay_s)

    def _expose(self) -> Callable[[], RenderedFrame]:
        self.exposures += 1
        return self._perception.expose(self.world, self.worker)

    def _arrived(self, now: MonoNs) -> Iterator[Frame]:
        """Give the frames that have arrived, oldest first."""
        while (packet := self._frames_under_way.arrived(now)) is not None:
            received_at, exposed = packet
            image = exposed()
            self._frames += 1
            self._views[self._frames] = structs.replace(image, px=_NO_PIXELS)
            yield self._arriving.frame(self._frames, image, received_at)

    def _judge(self, seq: int, verdict: Verdict) -> None:
        self._grader.on_verdict(self._views.pop(seq), verdict)

    def _act(self, now: MonoNs) -> None:
        self._person.act(self.pilot.operator, now)

    def _decided(self, decision: Decision) -> None:
        self._grader.on_decision(decision)
        self.world.guidance_phase = decision.phase

    def result(self) -> Ending:
        """Return the result of the flight: final if it has ended, else the result so far."""
        return self._grader.result(self.pilot.outcome, self.pilot.operator.situation(self._clock.t), self.health)
