"""Fly an autopilot in miniature in virtual time: no socket, no thread, and nothing waits.

One loop steps physics, stand-in, ground station and service. The service is what flies a real vehicle (the autopilot's driver
with all that is ours at its link, and the cycle), and messages cross a link in memory with the faults of the scenario, so that
a scenario and a seed give the same result to the bit. A scenario that starts in the air begins where a pilot has brought the
vehicle; one that starts on the pad is armed and taken off.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import cv2
from msgspec import Struct

from companion.base.health import Health
from companion.base.observer import Observer
from companion.cycle.ports import Assembly
from companion.guidance.pilot import Pilot
from companion.parts.mavlink.make import AutopilotPart
from companion.settings.model import Settings
from drivers.camera.exposure import ExposureSetting
from drivers.clock import SetClock
from drivers.endpoint import parse_endpoint
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.dialect import Message
from drivers.mavlink.links import LinkOptions, Links
from drivers.mavlink.options import SIMULATED_LINK
from estimator.contracts.commands import Command
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.estimates import PathName
from estimator.contracts.samples import Frame
from estimator.contracts.time import Clock, MonoNs, Stamp, after, seconds_between
from sitl.camera.film import SimulatedExposure
from sitl.emulators.autopilots.beside import autopilot_in, beside_autopilot, exposure_beside
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.conduct import COM_WATCHDOG_S, STATION_S, Conduct, FlightEnd, begun_in_air, take_off_m
from sitl.emulators.autopilots.lock_step import STAMP_SIGMA_S, START, CameraTiming, FaultyLink
from sitl.emulators.autopilots.programs.arducopter import CURVE
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.base import STEP_S, GimbalLink, StandIn
from sitl.emulators.autopilots.stand_in.memory_link import MemoryLink
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from sitl.emulators.autopilots.station import READS, STATION
from sitl.emulators.autopilots.telemetry import FaultyTelemetry
from sitl.emulators.autopilots.watch import FlightWatch
from sitl.faults.carried import refuse_others
from sitl.faults.faulty_streams import FlightFaults, InTransit
from sitl.flight.afterwards import Afterwards, cpu_s
from sitl.flight.service import SimulatedService
from sitl.flight.vessel_reports import VesselReporter
from sitl.perception.levels import perceive
from sitl.perception.port import Level, Perception
from sitl.scenario.scenario import Scenario, vehicle_model
from sitl.scenario.with_fault import with_random_faults
from sitl.world.truth import RenderedFrame, Truth

StackName = Literal["arducopter", "px4"]
_TRUTH_S = 0.02 - 1e-6
"""Time between two true states that are handed on, a little less than five steps."""
_NONE: Mapping[str, float] = MappingProxyType({})
_ACTS_EACH = round(STATION_S / STEP_S)
"""Steps between two looks of the people."""


class _Due(Struct):
    """Work that is repeated, and when it is due next."""

    step: Callable[[], float]
    at: MonoNs


class ServiceProcess:
    """One process of the service beside an autopilot: its cycle, and the autopilot's driver with all that is ours at its link.

    Args:
        settings: as `beside_autopilot` returns them.
        watched: whether anybody reads what the health says of samples.
    """

    def __init__(
        self, settings: Settings, pilot: Pilot, clock: SetClock, observers: Sequence[Observer], *, watched: bool
    ) -> None:
        self.health = Health(clock)
        part = AutopilotPart(Assembly(settings, pilot, self.health, clock), autopilot_in(settings))
        self.autopilot, work = part.joined(MemoryLink)
        self.exposure, exposing = exposure_beside(settings, pilot, self.health)
        observers = (part.component, *observers, *exposing)
        self.service = SimulatedService(settings, pilot, self.health, observers, clock)
        self.service.watched, self.service.fetch = watched, self.autopilot.samples.waiting
        self._work = [_Due(one.step, after(clock.now(), one.first_s)) for one in work]

    @property
    def link(self) -> MemoryLink:
        """Its link to the autopilot."""
        (link,) = self.autopilot.links.all
        assert isinstance(link, MemoryLink)
        return link

    def step(self, now: MonoNs, act: Callable[[MonoNs], None]) -> None:
        """Do what is due; `act` lets a person act before a guidance cycle."""
        for one in self._work:
            if now >= one.at:
                one.at = after(now, one.step())
        self.service.step(now, act, self._command)

    def _command(self, command: Command) -> None:
        self.autopilot.command(command)


@dataclass(slots=True)
class StandInFlight:
    """One flight of a stand-in; `fly` runs it.

    Raises:
        BadInput: the scenario has a gimbal, and no frames are rendered.
    """

    scenario: Scenario
    seed: int
    settings: Settings
    """Settings of the service, of an autopilot in a simulated world (`rig_for` with `by_autopilot`)."""
    autopilot: StackName
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Parameters of the stand-in, in addition to those with which it is always started."""
    observers: Sequence[Observer] = ()
    perception: Perception = field(default_factory=Perception)
    shadows: Sequence[PathName] = ()
    """Estimator paths that run beside the steering one; they do not change the flight."""
    unaided: bool = False
    """True for the control flight: the stand-in lands by its own landing mode, and nothing of the service's reaches it."""
    on_start: Callable[[Health], None] | None = None
    """Receives the counters of the service's health before it runs."""
    on_truth: Callable[[Truth], None] | None = None
    """Receives the true state every 20 ms and at every exposure of a frame."""
    clock: SetClock = field(default_factory=lambda: SetClock(START))
    gone: bool = False
    """True while the service was killed and no new one runs."""
    body: Body = field(init=False)
    stand_in: StandIn = field(init=False)
    faults: FlightFaults = field(init=False)
    watch: FlightWatch = field(init=False)
    conduct: Conduct = field(init=False)
    link: FaultyLink[Message] = field(init=False)
    _process: ServiceProcess = field(init=False)
    _reporter: VesselReporter = field(init=False)
    _camera: CameraTiming = field(default_factory=CameraTiming)
    _under_way: InTransit[Callable[[], RenderedFrame]] = field(init=False)
    _due_frame: MonoNs = START
    _frames: int = 0
    _operator: Links = field(init=False)
    """The ground station's links."""
    _over: bool = False
    """True when nothing is left for the service to do."""
    _told: MonoNs | None = None
    """Instant of the newest truth that `on_truth` got."""

    def __post_init__(self) -> None:
        if self.scenario.gimbal.given and self.perception.level != "pixels":
            raise BadInput("gimbal: only a flight with rendered frames (--perception pixels) has one")
        refuse_others(self.scenario.title, self.scenario.faults, "stand-in")
        cv2.setNumThreads(1)
        watchdog_s = COM_WATCHDOG_S[self.autopilot]
        stands = self.scenario.start.where == "pad"
        scenario = self.scenario = begun_in_air(self.scenario, self.seed)
        self.faults = FlightFaults(scenario.faults, self.seed)
        curve = CURVE if self.autopilot == "arducopter" else 0.0
        self.body = Body(scenario, self.seed, STEP_S, curve, self.clock.now(), self.faults, stands=stands)
        self.perception.begin(self.body)
        self._reporter = VesselReporter(self.body)
        watch = self.watch = FlightWatch(self.settings, self.clock, watchdog_s, unaided=self.unaided)
        watch.body = self.body
        self.conduct = Conduct(self.autopilot, scenario, self.settings, self.faults, watch, unaided=self.unaided)
        told = FaultyTelemetry(self.faults, self.seed, self.clock)
        self.link = FaultyLink(self.faults.streams, self.clock, watch.on_sent, watch.on_arrived, told.reported, told.ordered)
        self._under_way = InTransit(self.faults.streams.frames)
        self.stand_in = make_stand_in(self.autopilot, self.clock, scenario, self.parameters)
        self.body.on_failsafe = self.stand_in.acts_by_failsafe
        if not stands:
            self.stand_in.begin_in_air(self.body.state())

    def service_settings(self) -> Settings:
        """Return the settings that the service flies with."""
        return beside_autopilot(self.settings, SIMULATED_LINK, response="px4" if self.autopilot == "px4" else None)

    @property
    def pilot(self) -> Pilot:
        """The pilot of the newest process of the service."""
        return self._process.service.pilot

    @property
    def health(self) -> Health:
        """The health of the newest process of the service."""
        return self._process.health

    def ended(self, ordered: bool) -> bool:
        """Return whether the service ended the flight by itself: it has an outcome, and was ordered to land."""
        return not self.gone and ordered and self.pilot.outcome is not None

    def fly(self) -> FlightEnd:
        """Run the flight to the landing or another end."""
        began_s = cpu_s()
        self._begin()
        self._go_on()
        while not self.conduct.over(self.body, self):
            self._go_on()
        ending = self.conduct.result(self.body, self)
        if (grader := self.watch.grader) is not None:
            later = Afterwards(grader, ending)
            while self.clock.t < later.ends:
                # A vehicle on the deck whose motors are off is left to feet and friction.
                self._over = not (later.flies or self.body.flying or self.gone)
                self._go_on()
                later.step()
            ending = later.ending(cpu_s() - began_s)
        return self.conduct.end(ending, self.body, self)

    def _begin(self) -> None:
        """Join the links of the parties, and start the service."""
        if self.body.gimbal is not None:
            self.stand_in.gimbal = GimbalLink(self.body.gimbal, self.stand_in.system)
        program = _links(self.clock, (self.stand_in.system, 1), 2)
        operator = _links(self.clock, STATION, 1)
        self.stand_in.links = program
        to_service, to_station = _ends(program)
        (from_station,) = _ends(operator)
        to_service.carry, self.link.to_program = self.link.from_program, to_service.receive
        from_station.carry = to_station.receive
        to_station.carry = lambda message: from_station.receive(message) if message.get_type() in READS else None
        self.conduct.send, self._operator = operator.send, operator
        self._serve(None)

    def _serve(self, before: Pilot | None) -> None:
        """Start a process of the service; it knows of the pilot before it what a service keeps in its file."""
        settings = self.service_settings()
        pilot = self.perception.pilot(settings, self.shadows)
        if before is not None:
            pilot.landing.before = before.landing.memory
        observers = (*self.observers, self.watch)
        process = ServiceProcess(settings, pilot, self.clock, observers, watched=self.on_start is not None)
        process.service.arrived = self._arrived
        process.link.carry, self.link.to_daemon = self.link.from_daemon, process.link.receive
        if process.exposure is not None and self.perception.level == "pixels":
            start = ExposureSetting(self.scenario.camera.exposure_s, 1.0)
            white_k = self.settings.camera.exposure.white_balance_k
            self.body.exposure = SimulatedExposure(process.exposure, start, self._camera.period_s, white_k, lambda: self._frames)
        if self.on_start is not None:
            self.on_start(process.health)
        self._process, self.gone = process, False
        self._under_way.clear()

    def _go_on(self) -> None:
        """Let some time pass, and act as the people do, and whoever starts a killed service again."""
        for _ in range(_ACTS_EACH):
            self._step()
            if not self._over:
                self._serve_step()
        self.conduct.period(self.body)
        self.link.muted |= self.conduct.mutes
        if self.gone and not self.conduct.kills:
            self._serve(self.pilot)
            self.link.cut = False
            self.conduct.back(self.body)

    def _step(self) -> None:
        """Advance by one step of the physics: what the autopilot measured before it is on its way before the world moves."""
        program, body = self.stand_in, self.body
        program.read()
        motors = program.step(body.state())
        program.report()
        body.step(motors)
        now = self.clock.t = after(self.clock.t, STEP_S)
        self.conduct.on_step(body)
        if self.conduct.kills and not self.gone:
            self.gone = self.link.cut = True
        self.link.deliver()
        for received in self._operator.received.waiting():
            self.conduct.station.on_message(received.message, received.received_at)
        exposes = not self._over and not self.conduct.meets and now >= self._due_frame
        if exposes:
            self._expose(now)
        if self.on_truth is not None and (exposes or self._told is None or seconds_between(self._told, now) >= _TRUTH_S):
            self._told = now
            self.on_truth(body.truth())

    def _serve_step(self) -> None:
        """Give the service what the ship reports, and let it do what is due."""
        now = self.clock.t
        reports = self._reporter.reports(now)
        if (located := self._reporter.located) is not None:
            self.watch.on_located(located)
        if not self.gone:
            if reports:
                self._process.service.take(reports)
            self._process.step(now, self._act)

    def _act(self, now: MonoNs) -> None:
        self.conduct.act(self, now)

    def _expose(self, now: MonoNs) -> None:
        self._due_frame = after(max(self._due_frame, after(now, -STEP_S)), self._camera.period_s)
        self._under_way.send(lambda: self.perception.expose(self.body), now, self._camera.delay_s)

    def _arrived(self, now: MonoNs) -> Iterator[Frame]:
        """Give the frames that have arrived, oldest first."""
        while (packet := self._under_way.arrived(now)) is not None:
            received_at, made = packet
            image = made()
            self._frames += 1
            self.watch.on_shown(self._frames, image)
            claimed_at = after(image.exposed_at, image.stamp_error_s)
            stamp = Stamp(claimed_at, max(claimed_at, received_at), STAMP_SIGMA_S, "sim")
            yield Frame(stamp, self._frames, image.px, image.exposure_s, image.gain)


def make_stand_in(autopilot: StackName, clock: Clock, scenario: Scenario, parameters: Mapping[str, float] = _NONE) -> StandIn:
    """Return an autopilot in miniature that is set up for the scenario's vehicle, with these parameters besides."""
    airframe = vehicle_model(scenario).airframe()
    if autopilot == "px4":
        return Px4StandIn(clock, {"MIS_TAKEOFF_ALT": take_off_m(scenario), **parameters}, airframe)
    return CopterStandIn(clock, parameters, STEP_S, airframe)


def _links(clock: SetClock, identity: tuple[int, int], count: int) -> Links:
    """Return links in memory at which everybody may command, as to a simulated program or a ground station."""
    options = [LinkOptions(parse_endpoint("udpout://127.0.0.1:14540"))] * count
    return Links(options, clock, identity, NamedSenders(everybody=True), waits=True, made_of=MemoryLink)


def _ends(links: Links) -> list[MemoryLink]:
    """Return the links as those in memory that they are."""
    return [link for link in links.all if isinstance(link, MemoryLink)]


def fly_stand_in(
    autopilot: StackName,
    drawn: bool,
    name: str,
    scenario: Scenario,
    seed: int,
    settings: Settings,
    perception: Level,
    perception_model: str | None,
) -> dict[str, object]:
    """Fly a scenario once with the stand-in of an autopilot, and return the result as a campaign keeps it.

    Args:
        drawn: whether the seed draws further faults.

    Raises:
        BadInput: as of `StandInFlight`, or a fault cannot act there.
        Recoverable: no landing began.
    """
    if drawn:
        scenario = with_random_faults(scenario, seed, perception, autopilot=True)
    seen_by = perceive(perception, perception_model)
    end = StandInFlight(scenario, seed, settings, autopilot, perception=seen_by).fly()
    if end.failure:
        raise Recoverable(end.failure)
    return {**end.as_json(), "scenario": name, "autopilot": autopilot}
