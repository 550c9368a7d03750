"""Fly a real autopilot program: the simulated sea, deck, vehicle and camera are its physics, and the daemon runs beside it.

Four parties share one time. The autopilot program requests a step of the physics and waits for the answer; the daemon's clock,
the camera and the operator at the ground station advance with the steps. As in a real vehicle, the program is connected to the
daemon and the ground station by MAVLink over UDP.
"""

import asyncio
import math
import time
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import cv2
import msgspec
from msgspec import Struct

from companion.base import event_loop
from companion.base.health import Health
from companion.base.mission import REFUSALS, FlightOutcome
from companion.base.observer import Observer
from companion.settings.model import Settings
from drivers.camera.exposure import ExposureSetting
from drivers.endpoint import parse_endpoint
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.dialect import mav
from drivers.mavlink.joined_texts import ARMING_REFUSAL
from drivers.mavlink.links import LinkOptions, Links, open_links
from drivers.mavlink.vehicle import LAND_MODE, TARGET_MODE, Stack
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.estimates import PathName
from estimator.contracts.geometry import ned_between
from estimator.contracts.time import MonoNs, seconds_between
from sitl.camera.film import SimulatedExposure
from sitl.emulators.autopilots import arducopter, px4
from sitl.emulators.autopilots.arducopter import CURVE, STEP_S, JsonBackend, serve_json
from sitl.emulators.autopilots.beside import FlightDaemon, KillableService, beside_autopilot
from sitl.emulators.autopilots.body import Body, Silence, view_of
from sitl.emulators.autopilots.follow import OwnBody, OwnVehicle
from sitl.emulators.autopilots.lock_step import FaultyLink, LockStepCamera, LockStepClock
from sitl.emulators.autopilots.program import Program, reserved_port, running
from sitl.emulators.autopilots.px4 import HilBackend, serve_hil
from sitl.emulators.autopilots.stand_in import base as in_process
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.base import GimbalLink, StandIn
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from sitl.emulators.autopilots.station import STATION, GroundStation, Task
from sitl.emulators.autopilots.telemetry import CorruptedTelemetry
from sitl.emulators.autopilots.watch import FlightWatch
from sitl.faults.carried import refuse_others
from sitl.faults.faulty_streams import FlightFaults
from sitl.flight.afterwards import Afterwards, cpu_s
from sitl.flight.ending import Ending
from sitl.flight.person import SimulatedPerson
from sitl.flight.vessel_reports import VesselReporter
from sitl.perception.levels import perceive
from sitl.perception.port import Level, Perception
from sitl.scenario.scenario import Scenario
from sitl.scenario.with_fault import with_random_faults
from sitl.sensors.sensors import ORIGIN
from sitl.world.truth import Truth

Name = Literal["arducopter", "arduplane", "px4"]
HOST = "127.0.0.1"
COM_WATCHDOG_S: dict[Name, float] = {
    "arducopter": arducopter.PARAMETERS["GUID_TIMEOUT"],
    "arduplane": 0.5,
    "px4": px4.PARAMETERS["COM_OF_LOSS_T"],
}
"""Time for which each program flies on with the last setpoint."""
_STATION_S = 0.05
_TRUTH_S = 0.02 - 1e-6
_PACE = 10.0
"""Largest speed of the program in multiples of real time; the lock step limits it to what the machine can do."""
_SILENT_S = 60.0
"""Wall time without a step of the physics after which the program counts as hung."""


class AutopilotProgram(Struct, frozen=True):
    """The autopilot program that is flown, and its settings."""

    name: Name
    binary: Path | None
    """The program; None flies the stand-in for it (`sitl.emulators.autopilots.stand_in`)."""
    parameters: tuple[tuple[str, float], ...] = ()
    """Parameters of the program, in addition to those with which it is always started."""
    own: bool = False
    """True if it simulates its vehicle by itself, until the contact with our deck."""
    unaided: bool = False
    """True for the control flight: it lands by its own landing mode, and nothing of the daemon's reaches it."""


class FlightEnd(Struct, frozen=True):
    """The result of the flight."""

    ending: Ending
    """The end of the flight, judged from the order to land on."""
    health: Health
    texts: tuple[tuple[float, int, str], ...]
    """Status texts of autopilot and companion: s since the program's start, component, text."""
    failure: str = ""
    """The reason why no landing took place."""
    armed_after_contact_s: float | None = None
    """Time for which the motors turned after the newest contact; None if they never stopped, or there was none."""
    silences: tuple[Silence, ...] = ()
    """Flight of the vehicle while the service was killed."""
    tracking_m: float | None = None
    """Distance from the pad on the way down (`FlightWatch.tracking_m`); None for a flight that did not come so far."""
    elsewhere_m: float | None = None
    """Horizontal distance in which a refused vehicle ended from the place at which it was to land; None for another end."""

    def as_json(self) -> dict[str, object]:
        """Return plain values: the ending's, and what there is of an autopilot's flight alone."""
        return {
            **self.ending.as_json(),
            "failure": self.failure or None,
            "armed_after_contact_s": None if self.armed_after_contact_s is None else round(self.armed_after_contact_s, 2),
            "failsafes": list(self.failsafes),
            "tracking_m": None if self.tracking_m is None else round(self.tracking_m, 3),
            "elsewhere_m": None if self.elsewhere_m is None else round(self.elsewhere_m, 2),
            "silences": [silence.as_json() for silence in self.silences],
        }

    @property
    def failsafes(self) -> tuple[str, ...]:
        """Texts of the autopilot about failsafes, each once. A refusal to arm for one is repeated until it arms, and is none."""
        own = int(mav.MAV_COMP_ID_AUTOPILOT1)
        said = dict.fromkeys(text for _, component, text in self.texts if component == own and "failsafe" in text.lower())
        return tuple(text for text in said if ARMING_REFUSAL.match(text) is None)


@dataclass(slots=True)
class AutopilotFlight:
    """One flight of an autopilot program; `fly` runs it."""

    scenario: Scenario
    seed: int
    settings: Settings
    """Settings of the daemon, read for an autopilot (`settings_for` with `by_autopilot`), which becomes its vehicle."""
    autopilot: AutopilotProgram
    folder: Path
    """The program's working directory."""
    observers: Sequence[Observer] = ()
    perception: Perception = field(default_factory=Perception)
    shadows: Sequence[PathName] = ()
    """Estimator paths that run beside the steering one; they do not change the flight."""
    on_start: Callable[[Health], None] | None = None
    """Receives the counters of the service's health before it runs."""
    on_truth: Callable[[Truth], None] | None = None
    """Receives the true state after the first step of the physics, every 20 ms and at every exposure of a frame."""
    clock: LockStepClock = field(default_factory=LockStepClock)
    body: Body | None = None
    stand_in: StandIn | None = None
    """The stand-in that is flown; None while a program is."""
    station: GroundStation = field(init=False)
    faults: FlightFaults = field(init=False)
    watch: FlightWatch = field(init=False)
    link: FaultyLink = field(init=False)
    _camera: LockStepCamera | None = None
    _own: OwnVehicle | None = None
    _reporter: VesselReporter = field(init=False)
    _service: KillableService | None = None
    _silences: list[Silence] = field(default_factory=list)
    _stepped_at: float = 0.0
    _stopped: MonoNs | None = None
    """Instant when the motors stopped."""
    _told: MonoNs | None = None
    """Instant of the newest truth that `on_truth` got."""
    _told_exposures: int = 0

    def __post_init__(self) -> None:
        if self.scenario.gimbal.given and (self.autopilot.binary is not None or self.perception.level != "pixels"):
            raise BadInput("gimbal: only the stand-in (--binary stand-in) with rendered frames (--perception pixels) has one")
        if self.autopilot.own and self.autopilot.binary is None:
            raise BadInput("--physics own: the stand-in simulates no vehicle by itself; name a program with --binary PATH")
        if self.autopilot.name == "arduplane" and self.autopilot.binary is None:
            raise BadInput("--autopilot arduplane: there is no stand-in for it; name the program with --binary PATH")
        self.station = self._station()
        watchdog_s = COM_WATCHDOG_S[self.autopilot.name]
        unaided = self.autopilot.unaided
        # The order to land comes in the air, wherever the scenario's vehicle starts.
        start, wrong = msgspec.structs.replace(self.scenario.start, where="air"), self.scenario.wrong_model.drawn(self.seed)
        self.scenario = msgspec.structs.replace(self.scenario, start=start, wrong_model=wrong)
        self.faults = FlightFaults(self.scenario.faults, self.seed)
        self.watch = FlightWatch(self.settings, self.clock, watchdog_s, unaided=unaided)
        told = CorruptedTelemetry(self.faults.corruptions, self.clock)
        self.link = FaultyLink(self.faults.streams, self.clock, self.watch.on_sent, self.watch.on_arrived, told)

    def _station(self, ground_m: float = 0.0) -> GroundStation:
        stack = {"arducopter": Stack.ARDUPILOT, "arduplane": Stack.PLANE, "px4": Stack.PX4}[self.autopilot.name]
        guidance, lands_by = self.settings.guidance, LAND_MODE[stack] if self.autopilot.unaided else None
        led = guidance.mission == "targets"
        if led and not guidance.mode_changes and lands_by is None:
            lands_by = TARGET_MODE[stack]
        return GroundStation(stack, height_m=self.height_m + ground_m, lands_by=lands_by, steers_on=led)

    def service_settings(self, port: int) -> Settings:
        """Return the settings that the daemon flies with, which receives the autopilot at a UDP port of this machine."""
        response = "px4" if self.autopilot.name == "px4" else None
        return beside_autopilot(self.settings, f"udpin://{HOST}:{port}", response=response)

    @property
    def height_m(self) -> float:
        """Height of the take-off."""
        return max(self.scenario.start.height_m, 2.0)

    async def fly(self) -> FlightEnd:
        """Run the flight from the program's start to the landing or another end.

        Raises:
            BadInput: the program cannot be run.
            Recoverable: the program ended by itself or hangs.
        """
        fixed = self.autopilot.name == "px4" and self.autopilot.binary is not None
        with reserved_port() as first, reserved_port() as second, reserved_port() as third:
            from_program, to_station = px4.MAVLINK_PORTS if fixed else (first, second)
            return await self._fly(from_program, to_station, third)

    async def _fly(self, from_program: int, to_station: int, to_daemon: int) -> FlightEnd:
        cv2.setNumThreads(1)
        settings = self.service_settings(to_daemon)
        service = self._service = KillableService(lambda: self._serving(settings))
        # The world begins before the program does: at the level `truth` the pilot reads it from its first cycle on.
        copter = self.autopilot.name != "px4"
        step_s = in_process.STEP_S if self.autopilot.binary is None else STEP_S if copter else px4.STEP_S
        self._make(step_s, CURVE if copter else 0.0)
        link = LinkOptions(parse_endpoint(f"udpin://{HOST}:{to_station}"))
        failed: Recoverable | None = None
        with ThreadPoolExecutor(1, thread_name_prefix="camera") as pool:
            frames = self.faults.streams.frames
            camera = self._camera = LockStepCamera(
                self.clock, service.offer, service.concluded, service.looking, pool, frames, expose=self.perception.expose
            )
            camera.shown = self.watch.on_shown
            self._expose_by(service.now, camera)
            async with AsyncExitStack() as stack:
                links = await stack.enter_async_context(
                    open_links((link,), self.clock, STATION, access=NamedSenders(everybody=True))
                )
                await stack.enter_async_context(self.link.relaying(HOST, from_program, to_daemon))
                program = await stack.enter_async_context(self._program((from_program, to_station)))
                self._stepped_at = time.monotonic()
                try:
                    async with asyncio.TaskGroup() as group:
                        others = [
                            group.create_task(program.ended()),
                            group.create_task(self._watch(program)),
                            group.create_task(self._listen(links)),
                        ]
                        if self._own is not None and isinstance(program, Program):
                            others.append(group.create_task(self._own.run(program, links.send)))
                        service.start(group)
                        end = await self._conduct(links, service, group)
                        await service.stop()
                        for task in others:
                            task.cancel()
                except* Recoverable as why:
                    failed = _first(why)
        if failed is not None:
            raise failed
        return end

    def _serving(self, settings: Settings) -> FlightDaemon:
        """Return a daemon that knows nothing yet."""
        pilot = self.perception.pilot(settings, self.shadows)
        side = FlightDaemon(settings, pilot, self.clock, (*self.observers, self.watch), once=False)
        if self.on_start is not None:
            self.on_start(side.daemon.health)
        return side

    def _expose_by(self, side: FlightDaemon, camera: LockStepCamera) -> None:
        """Let a daemon drive the camera's exposure, where its settings say so."""
        if side.exposure is None or self.body is None or self.perception.level != "pixels":
            return
        start = ExposureSetting(self.scenario.camera.exposure_s, 1.0)
        white_k = self.settings.camera.exposure.white_balance_k
        self.body.exposure = SimulatedExposure(side.exposure, start, camera.period_s, white_k, lambda: camera.frames)

    async def _conduct(self, links: Links, service: KillableService, group: asyncio.TaskGroup) -> FlightEnd:
        station, began_s = self.station, cpu_s()
        person = SimulatedPerson(self.faults, by_remote=lambda act: self._by_remote(act, links))
        while station.task is not Task.FAILED:
            await self._act(links, service, group, person)
            if self.body is None:
                continue
            lost = not self.body.upright
            if station.began is not None:
                flown_s = seconds_between(station.began, self.clock.now())
                done = self._flown(service) and not person.gives_back
                if done or self._touched or flown_s > self.scenario.duration_limit_s or lost:
                    break
            elif lost or service.ended(ordered=False):
                station.failure = "it turned over or fell into the water before the landing was ordered"
                break
        health = service.now.daemon.health
        assert self.body is not None
        ending = self.watch.ending(self.body, self._outcome(service), service.now.pilot, health)
        if (grader := self.watch.grader) is not None:
            # A program that simulates its vehicle by itself does not know that it stands on our deck.
            later = Afterwards(grader, ending)
            while not self._touched and self.clock.now() < later.ends:
                await self._act(links, service, group, person)
                later.step()
            ending = later.ending(cpu_s() - began_s, stands=not self._touched)
        landing = None if station.began is None else self.body.landing
        stopped = None if landing is None or self._stopped is None else max(seconds_between(landing.at, self._stopped), 0.0)
        return FlightEnd(
            ending,
            health,
            tuple((seconds_between(self.clock.started, at), component, text) for at, component, text in station.texts),
            station.failure,
            stopped,
            tuple(self._silences),
            self.watch.tracking_m,
            self._from_elsewhere_m(service),
        )

    async def _act(self, links: Links, service: KillableService, group: asyncio.TaskGroup, person: SimulatedPerson) -> None:
        """Let some time pass, and act as the ground station, the person and whoever starts a killed service again."""
        station, camera = self.station, self._camera
        assert camera is not None
        await self.clock.sleep(_STATION_S)
        if self.body is None:
            return
        camera.on = station.task not in (Task.MEET, Task.ARM)
        for message in station.period(self.clock.now(), view_of(self.body)):
            links.send(message)
        if self.autopilot.unaided and station.task is Task.ORDER:
            self.link.muted = True
        if service.gone and not self.faults.active("service_killed"):
            await service.restart(group)
            self._expose_by(service.now, camera)
            self.link.cut = False
            if station.began is None:  # else the new service goes on with the landing that was ordered
                station.again(self.clock.now(), self.body.over_deck_m)
        if station.began is not None and not service.gone:
            person.act(service.now.pilot.operator, self.clock.now())

    def _outcome(self, service: KillableService) -> FlightOutcome | None:
        """Return the pilot's outcome, and of a program that nobody tells of our deck or of the pad its landing."""
        if self._touched:
            return FlightOutcome.LANDED
        if self.autopilot.unaided:
            stands = self.body is not None and self.body.upright and not self.body.flying and self.body.landing is not None
            return FlightOutcome.LANDED if stands else None
        return service.now.pilot.outcome

    def _by_remote(self, act: str, links: Links) -> None:
        """Act as a pilot with a remote control does: choose the autopilot's mode that holds, or stop the motors."""
        links.send(self.station.holds() if act == "mode" else self.station.disarms())
        self.watch.on_remote(act)

    @property
    def _touched(self) -> bool:
        """True if a vehicle that the program simulates by itself has touched our deck, which the program does not know."""
        return self.autopilot.own and self.body is not None and self.body.landing is not None

    def _flown(self, service: KillableService) -> bool:
        """Return whether the landing that was ordered has ended by itself."""
        if self.autopilot.unaided:
            return self.body is not None and not self.body.flying
        if self._refused(service):
            return self.body is not None and not self.body.flying
        return service.ended(self.station.task is Task.WATCH)

    def _refused(self, service: KillableService) -> bool:
        """Return whether the service has refused and the vehicle leaves the pad."""
        return self.settings.guidance.refused != "hold" and service.now.pilot.outcome in REFUSALS

    def _from_elsewhere_m(self, service: KillableService) -> float | None:
        of = self.settings.guidance
        if of.refused != "land elsewhere" or self.body is None or not self._refused(service):
            return None
        there = ned_between(ORIGIN, of.elsewhere.landing_place.place)
        return math.hypot(*(self.body.state().p_ned - there)[:2])

    async def _listen(self, links: Links) -> None:
        async for received in links.received:
            self.station.on_message(received.message, received.received_at)
            if self._own is not None:
                for message in self._own.on_message(received.message, self.station.stack):
                    links.send(message)

    async def _watch(self, program: Program | in_process.StandInProgram) -> None:
        """Raise an error if the program stops stepping the physics."""
        while True:
            await asyncio.sleep(1.0)
            if time.monotonic() - self._stepped_at > _SILENT_S:
                raise Recoverable(
                    f"the autopilot program requested no step in {_SILENT_S:.0f} s; its last line: {program.last_line}"
                )

    def _make(self, step_s: float, curve: float) -> Body:
        start = self.clock.now()
        if self.autopilot.own:
            body = self.body = OwnBody(self.scenario, self.seed, start, self.faults)
            self.station = self._station(-float(body.pad_motion().p_ned[2]))
            around = arducopter.around if self.autopilot.name != "px4" else lambda body: []
            self._own = OwnVehicle(body, self._stepped, self._settle, around)
            self.link.ahead_s = self._own.ahead_s
        else:
            self.body = Body(self.scenario, self.seed, step_s, curve, start, self.faults, stands=True)
        self.watch.body, self._reporter = self.body, VesselReporter(self.body)
        self.body.on_failsafe = self._on_failsafe
        self.perception.begin(self.body)
        return self.body

    def _stepped(self, body: Body) -> None:
        if isinstance(body, OwnBody):
            body.begun = self.station.task not in (Task.MEET, Task.ARM, Task.TAKE_OFF)
        self._stepped_at = time.monotonic()
        self.clock.advance(body.step_s)
        if body.flying:
            self._stopped = None
        elif self._stopped is None:
            self._stopped = body.at
        self._leave_alone(body)
        if self.station.began is not None:
            self.watch.stepped(body)
        self._report()
        self.link.deliver()
        assert self._camera is not None
        self._camera.stepped(body)
        if self.on_truth is not None:
            exposed = self._camera.exposures
            if exposed > self._told_exposures or self._told is None or seconds_between(self._told, self.clock.now()) >= _TRUTH_S:
                self._told, self._told_exposures = self.clock.now(), exposed
                self.on_truth(body.truth())

    def _report(self) -> None:
        """Give the service what the ship reports."""
        if self._service is not None:
            for report in self._reporter.reports(self.clock.now()):
                self._service.report(report)
            if (located := self._reporter.located) is not None:
                self.watch.on_located(located)

    def _leave_alone(self, body: Body) -> None:
        """Kill the service when its time has come, and note what the vehicle does without one."""
        if self._service is None or not self.faults.active("service_killed"):
            return
        now_s, height_m = seconds_between(body.started, body.at), body.over_deck_m
        if not self._service.gone:
            self._service.kill()
            self.link.cut = True
            self._silences.append(Silence(now_s, body.guidance_phase, height_m))
        silence = self._silences[-1]
        silence.step(now_s - silence.at_s, body.state(), height_m, self.station.mode, len(body.contacts))

    def _on_failsafe(self, takes: Literal["land", "hold"]) -> None:
        """Let a failsafe of the stand-in act."""
        if self.stand_in is not None:
            self.stand_in.acts_by_failsafe(takes)

    async def _settle(self) -> None:
        assert self._camera is not None
        await self.clock.settle()
        await self._camera.settle()

    @asynccontextmanager
    async def _program(self, ports: tuple[int, int]) -> AsyncIterator[Program | in_process.StandInProgram]:
        """Serve the physics and run the program on it until the context ends."""
        chosen = self.autopilot
        if chosen.binary is None:
            self.stand_in, body, urls = self._stand_in(), self.body, tuple(f"udpout://{HOST}:{port}" for port in ports)
            assert body is not None
            if body.gimbal is not None:
                self.stand_in.gimbal = GimbalLink(body.gimbal, self.stand_in.system)
            async with in_process.flying(
                self.stand_in, body, self.clock, (urls[0], urls[1]), self._stepped, self._settle
            ) as program:
                yield program
            return
        if isinstance(self.body, OwnBody):
            given = dict(chosen.parameters)
            if chosen.name == "px4":
                argv, environment = px4.start(chosen.binary, height_m=self.height_m, parameters=given, own=self.body.home)
            else:
                argv = arducopter.argv(
                    chosen.binary, self.folder, plane=chosen.name == "arduplane", physics=self.body, mavlink_ports=ports,
                    parameters=given, speedup=_PACE,
                )  # fmt: skip
                environment = {}
            async with running(argv, self.folder, environment) as program:
                yield program
            return
        if chosen.name == "px4":
            assert self.body is not None
            hil = HilBackend(self.body, seed=self.seed, stepped=self._stepped)
            argv, environment = px4.start(chosen.binary, height_m=self.height_m, parameters=dict(chosen.parameters))
            async with (
                serve_hil(hil, HOST, px4.PHYSICS_PORT, settle=self._settle),
                running(argv, self.folder, environment) as program,
            ):
                yield program
            return
        backend = JsonBackend(lambda step_s: self._make(step_s, CURVE), self._stepped, self.body)
        async with serve_json(backend, HOST, 0, settle=self._settle) as port:
            argv = arducopter.argv(
                chosen.binary, self.folder, plane=chosen.name == "arduplane", physics=port, mavlink_ports=ports, speedup=_PACE,
                parameters=dict(chosen.parameters),
            )  # fmt: skip
            async with running(argv, self.folder) as program:
                yield program

    def _stand_in(self) -> StandIn:
        given = dict(self.autopilot.parameters)
        if self.autopilot.name == "px4":
            return Px4StandIn(self.clock, {"MIS_TAKEOFF_ALT": self.height_m, **given})
        return CopterStandIn(self.clock, given, in_process.STEP_S)


def fly_stand_in(
    autopilot: Name,
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
        BadInput: as of `AutopilotFlight`, or a fault cannot act there.
        Recoverable: no landing began.
    """
    if drawn:
        scenario = with_random_faults(scenario, seed, perception, autopilot=True)
    refuse_others(name, scenario.faults, stand_in=True)
    program, seen_by = AutopilotProgram(autopilot, None), perceive(perception, perception_model)
    with TemporaryDirectory(prefix="decklander-") as folder:
        end = event_loop.run(AutopilotFlight(scenario, seed, settings, program, Path(folder), perception=seen_by).fly())
    if end.failure:
        raise Recoverable(end.failure)
    return {**end.as_json(), "scenario": name, "autopilot": autopilot}


def _first(group: BaseExceptionGroup[Recoverable]) -> Recoverable:
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, Recoverable)
    return error
