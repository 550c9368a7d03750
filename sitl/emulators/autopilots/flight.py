"""Fly a real autopilot program: the simulated sea, deck, vehicle and camera are its physics, and the daemon runs beside it.

Four parties share one time. The autopilot program requests a step of the physics and waits for the answer; the daemon's clock,
the camera and the operator at the ground station advance with the steps. As in a real vehicle, the program is connected to the
daemon and the ground station by MAVLink over UDP.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

import cv2
from msgspec import Struct

from companion.base import event_loop
from companion.base.health import Health
from companion.base.observer import Observer
from companion.settings.model import Settings
from drivers.camera.exposure import ExposureSetting
from drivers.endpoint import parse_endpoint
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.links import LinkOptions, Links, open_links
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.estimates import PathName
from estimator.contracts.time import MonoNs, seconds_between
from sitl.camera.film import SimulatedExposure
from sitl.emulators.autopilots.beside import FlightDaemon, KillableService, beside_autopilot
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.conduct import COM_WATCHDOG_S, STATION_S, Conduct, FlightEnd, Name, begun_in_air, take_off_m
from sitl.emulators.autopilots.follow import OwnBody, OwnVehicle
from sitl.emulators.autopilots.lock_step import FaultyRelay, LockStepCamera, LockStepClock
from sitl.emulators.autopilots.programs import arducopter, px4
from sitl.emulators.autopilots.programs.arducopter import CURVE, STEP_S, JsonBackend, serve_json
from sitl.emulators.autopilots.programs.program import Program, reserved_port, running
from sitl.emulators.autopilots.programs.px4 import HilBackend, serve_hil
from sitl.emulators.autopilots.station import STATION, Task
from sitl.emulators.autopilots.telemetry import FaultyTelemetry, in_datagrams
from sitl.emulators.autopilots.watch import FlightWatch
from sitl.faults.carried import refuse_others
from sitl.faults.faulty_streams import FlightFaults
from sitl.flight.afterwards import Afterwards, cpu_s
from sitl.flight.vessel_reports import VesselReporter
from sitl.perception.port import Perception
from sitl.scenario.scenario import Scenario, refuse_gimbal, vehicle_model
from sitl.world.truth import Truth

HOST = "127.0.0.1"
COMPANION_PORT = 14540
"""The companion's port in the settings that a recording keeps."""
_TRUTH_S = 0.02 - 1e-6
"""Time between two true states that are handed on, a little less than whole steps."""
_PACE = 10.0
"""Largest speed of the program in multiples of real time; the lock step limits it to what the machine can do."""
_SILENT_S = 60.0
"""Wall time without a step of the physics after which the program counts as hung."""


class AutopilotProgram(Struct, frozen=True):
    """The autopilot program that is flown, and its settings."""

    name: Name
    binary: Path
    parameters: tuple[tuple[str, float], ...] = ()
    """Parameters of the program, in addition to those with which it is always started."""
    own: bool = False
    """True if it simulates its vehicle by itself, until the contact with our deck."""
    unaided: bool = False
    """True for the control flight: it lands by its own landing mode, and nothing of the daemon's reaches it."""


@dataclass(slots=True)
class AutopilotFlight:
    """One flight of an autopilot program; `fly` runs it."""

    scenario: Scenario
    seed: int
    settings: Settings
    """Settings of the daemon, of an autopilot in a simulated world (`rig_for` with `by_autopilot`)."""
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
    faults: FlightFaults = field(init=False)
    watch: FlightWatch = field(init=False)
    conduct: Conduct = field(init=False)
    link: FaultyRelay = field(init=False)
    _camera: LockStepCamera | None = None
    _own: OwnVehicle | None = None
    _reporter: VesselReporter = field(init=False)
    _service: KillableService | None = None
    _stepped_at: float = 0.0
    _told: MonoNs | None = None
    """Instant of the newest truth that `on_truth` got."""
    _told_exposures: int = 0

    def __post_init__(self) -> None:
        refuse_gimbal(self.scenario)
        if vehicle_model(self.scenario).airframe().layout != "quad_x":
            raise BadInput("--binary flies four rotors in an X; the scenario's vehicle has another layout")
        refuse_others(self.scenario.title, self.scenario.faults, "own physics" if self.autopilot.own else "program")
        watchdog_s = COM_WATCHDOG_S[self.autopilot.name]
        unaided = self.autopilot.unaided
        self.scenario = begun_in_air(self.scenario, self.seed)
        self.faults = FlightFaults(self.scenario.faults, self.seed)
        self.watch = FlightWatch(self.settings, self.clock, watchdog_s, unaided=unaided)
        self.conduct = Conduct(
            self.autopilot.name, self.scenario, self.settings, self.faults, self.watch, own=self.autopilot.own, unaided=unaided
        )
        told = FaultyTelemetry(self.faults, self.seed, self.clock)
        self.link = FaultyRelay(
            self.faults.streams, self.clock, self.watch.on_sent, self.watch.on_arrived,
            in_datagrams(told.reported), in_datagrams(told.ordered),
        )  # fmt: skip

    def service_settings(self, port: int = COMPANION_PORT) -> Settings:
        """Return the settings that the daemon flies with, which receives the autopilot at a UDP port of this machine."""
        response = "px4" if self.autopilot.name == "px4" else None
        return beside_autopilot(self.settings, f"udpin://{HOST}:{port}", response=response)

    def fly(self) -> FlightEnd:
        """Run the flight on an event loop of its own; see `flown`."""
        return event_loop.run(self.flown())

    async def flown(self) -> FlightEnd:
        """Run the flight from the program's start to the landing or another end.

        Raises:
            BadInput: the program cannot be run.
            Recoverable: the program ended by itself or hangs.
        """
        fixed = self.autopilot.name == "px4"
        with reserved_port() as first, reserved_port() as second, reserved_port() as third:
            from_program, to_station = px4.MAVLINK_PORTS if fixed else (first, second)
            return await self._fly(from_program, to_station, third)

    async def _fly(self, from_program: int, to_station: int, to_daemon: int) -> FlightEnd:
        cv2.setNumThreads(1)
        settings = self.service_settings(to_daemon)
        service = self._service = KillableService(lambda: self._serving(settings))
        # The world begins before the program does: at the level `truth` the pilot reads it from its first cycle on.
        copter = self.autopilot.name != "px4"
        self._make(STEP_S if copter else px4.STEP_S, CURVE if copter else 0.0)
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
                self.conduct.send = links.send
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
                        if self._own is not None:
                            others.append(group.create_task(self._own.run(program, links.send)))
                        service.start(group)
                        end = await self._conducted(links, service, group)
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

    async def _conducted(self, links: Links, service: KillableService, group: asyncio.TaskGroup) -> FlightEnd:
        conduct, began_s = self.conduct, cpu_s()
        while self.body is None or not conduct.over(self.body, service):
            if conduct.station.task is Task.FAILED:
                break
            await self._act(links, service, group)
        assert self.body is not None
        ending = conduct.result(self.body, service)
        if (grader := self.watch.grader) is not None:
            # A program that simulates its vehicle by itself does not know that it stands on our deck.
            later, touched = Afterwards(grader, ending), conduct.touched(self.body)
            while not touched and self.clock.now() < later.ends:
                await self._act(links, service, group)
                later.step()
            ending = later.ending(cpu_s() - began_s, stands=not touched)
        return conduct.end(ending, self.body, service)

    async def _act(self, links: Links, service: KillableService, group: asyncio.TaskGroup) -> None:
        """Let some time pass, and act as the people do, and whoever starts a killed service again."""
        conduct, camera = self.conduct, self._camera
        assert camera is not None
        await self.clock.sleep(STATION_S)
        if self.body is None:
            return
        camera.on = not conduct.meets
        conduct.period(self.body)
        self.link.muted |= conduct.mutes
        if service.gone and not conduct.kills:
            await service.restart(group)
            self._expose_by(service.now, camera)
            self.link.cut = False
            conduct.back(self.body)
        conduct.act(service, self.clock.now())

    async def _listen(self, links: Links) -> None:
        async for received in links.received:
            self.conduct.station.on_message(received.message, received.received_at)
            if self._own is not None:
                for message in self._own.on_message(received.message, self.conduct.station.stack):
                    links.send(message)

    async def _watch(self, program: Program) -> None:
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
            self.conduct.station = self.conduct.new_station(-float(body.pad_motion().p_ned[2]))
            around = arducopter.around if self.autopilot.name != "px4" else lambda body: []
            self._own = OwnVehicle(body, self._stepped, self._settle, around)
            self.link.ahead_s = self._own.ahead_s
        else:
            self.body = Body(self.scenario, self.seed, step_s, curve, start, self.faults, stands=True)
        self.watch.body, self._reporter = self.body, VesselReporter(self.body)
        self.perception.begin(self.body)
        return self.body

    def _stepped(self, body: Body) -> None:
        if isinstance(body, OwnBody):
            body.begun = not self.conduct.meets and self.conduct.station.task is not Task.TAKE_OFF
        self._stepped_at = time.monotonic()
        self.clock.advance(body.step_s)
        if self._service is not None:
            self.conduct.on_step(body)
            if self.conduct.kills and not self._service.gone:
                self._service.kill()
                self.link.cut = True
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

    async def _settle(self) -> None:
        assert self._camera is not None
        await self.clock.settle()
        await self._camera.settle()

    @asynccontextmanager
    async def _program(self, ports: tuple[int, int]) -> AsyncIterator[Program]:
        """Serve the physics and run the program on it until the context ends."""
        chosen = self.autopilot
        if isinstance(self.body, OwnBody):
            given = dict(chosen.parameters)
            if chosen.name == "px4":
                argv, environment = px4.start(
                    chosen.binary, height_m=take_off_m(self.scenario), parameters=given, own=self.body.home
                )
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
            argv, environment = px4.start(chosen.binary, height_m=take_off_m(self.scenario), parameters=dict(chosen.parameters))
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


def _first(group: BaseExceptionGroup[Recoverable]) -> Recoverable:
    error: BaseException = group
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    assert isinstance(error, Recoverable)
    return error
