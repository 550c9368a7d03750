"""An autopilot program over a pad in calm air, flown by the arbiter of people's orders and the driver together, in lock step.

It is used as `Flown` of the toy autopilot is; without a program the stand-in of its stack is flown. A person holds the remote
control: its sticks are centred, and what he switches goes out from the ground station.
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import AsyncExitStack, ExitStack, asynccontextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self, TypeVar

import numpy as np
from msgspec.structs import replace

from companion.base.orders import HandledOrder
from companion.guidance.operator.arbiter import OperatorArbiter
from drivers.endpoint import parse_endpoint
from drivers.mavlink.access import NamedSenders
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.codec import Codec
from drivers.mavlink.custody import Hand
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import LinkOptions, Links, open_links
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.requests import request_message
from drivers.mavlink.setpoint import velocity_setpoint
from drivers.mavlink.setpoint_streamer import FORCE
from drivers.mavlink.vehicle import LAND_MODE, Stack, mode_name, set_mode
from estimator.contracts.commands import Land, Velocity
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between
from sitl.emulators.autopilots.body import Body, view_of
from sitl.emulators.autopilots.lock_step import LockStepClock
from sitl.emulators.autopilots.programs import arducopter, px4
from sitl.emulators.autopilots.programs.arducopter import CURVE, JsonBackend, serve_json
from sitl.emulators.autopilots.programs.arducopter import STEP_S as COPTER_STEP_S
from sitl.emulators.autopilots.programs.program import reserved_port, running
from sitl.emulators.autopilots.programs.px4 import HilBackend, serve_hil
from sitl.emulators.autopilots.stand_in import base as in_process
from sitl.emulators.autopilots.stand_in.arducopter import CopterStandIn
from sitl.emulators.autopilots.stand_in.px4 import Px4StandIn
from sitl.emulators.autopilots.station import STATION, GroundStation, Task
from sitl.scenario.scenario import load
from tests.support.toy_autopilot import PERSONS_MODE, STEP_S, STILL, Guidance, OrderedFlight

HOST = "127.0.0.1"
AUTOPILOT = (1, 1)
HEIGHT_M = 6.0
_WALL_S = 120.0
"""Time of the wall for a step of the program: longer is a program that hangs."""
_READY_S = 45.0
"""Time after which a program that was started would arm."""
_STICKS_S, _CENTRED, _LOW = 0.2, 1500, 1000
_PARAMETERS = {
    Stack.ARDUPILOT: {},
    # A joystick's sticks count, and their loss does nothing
    Stack.PX4: {"COM_RC_IN_MODE": 1.0, "COM_RCL_EXCEPT": 7.0},
}
_T = TypeVar("_T")


class Vehicle:
    """The autopilot as the person sees it, and what our messages asked it for (see `Toy`)."""

    refuses_modes = refuses_disarm = others_stream = False

    def __init__(self, stack: Stack, body: Body, station: Callable[[Message], None], now_s: Callable[[], float]) -> None:
        self.stack, self._body, self._station, self._now_s = stack, body, station, now_s
        self.mode, self.armed = "", False
        self.denied = False
        """True if the autopilot denied a mode that the person chose."""
        self.log: list[tuple[float, str]] = []
        self.setpoints: list[tuple[float, float]] = []
        self._codec = Codec(*AUTOPILOT)

    @property
    def height_m(self) -> float:
        return float(self._body.pad_motion().p_ned[2] - self._body.state().p_ned[2])

    @property
    def flying(self) -> bool:
        return self._body.flying and self.height_m > 0.15

    def switch(self, mode: str) -> None:
        """Choose a mode, as a person does at his remote control."""
        self._station(set_mode(self.stack, AUTOPILOT, mode))

    def disarm(self) -> None:
        """Stop the motors by the person's switch, also in the air."""
        number = mav.MAV_CMD_COMPONENT_ARM_DISARM
        self._station(mav.MAVLink_command_long_message(*AUTOPILOT, number, 0, 0.0, FORCE, 0, 0, 0, 0, 0))

    def tap(self, at: MonoNs, endpoint: str, way: str, data: bytes, name: str) -> None:
        """Note what a message of ours asks for."""
        if way != "out" or name not in ("SET_POSITION_TARGET_LOCAL_NED", "COMMAND_INT", "COMMAND_LONG"):
            return
        for message in self._codec.feed(data):
            if name == "SET_POSITION_TARGET_LOCAL_NED":
                self.setpoints.append((self._now_s(), message.vz if self.flying else 0.0))
            elif (what := self._asked(message)) is not None:
                self.log.append((self._now_s(), what))

    def _asked(self, m: Message) -> str | None:
        if m.command == mav.MAV_CMD_DO_REPOSITION:
            return "reposition"
        if m.command == mav.MAV_CMD_DO_SET_MODE:
            number = int(m.param2) if self.stack is Stack.ARDUPILOT else int(m.param2) << 16 | int(m.param3) << 24
            return f"mode {mode_name(self.stack, number)}"
        if m.command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            return "arm" if m.param1 else "disarm forced" if m.param2 == FORCE else "disarm"
        return "take off" if m.command == mav.MAV_CMD_NAV_TAKEOFF else None


class ProgramFlown(OrderedFlight):
    """A program, the driver and the arbiter, 25 steps a second. `begin` before each run.

    Args:
        binary: the program; None for the stand-in of the stack.
    """

    patience_s, begins_after_s = 40.0, 0.0

    def __init__(self, stack: Stack, binary: Path | None, seed: int = 0) -> None:
        self._loop = asyncio.new_event_loop()
        self._program, self._driver, self._ports = AsyncExitStack(), AsyncExitStack(), ExitStack()
        self._stack, self._binary, self.seed = stack, binary, seed
        scenario = load("calm")
        start = replace(scenario.start, where="pad", height_m=HEIGHT_M, pad_forward_m=0.0, pad_right_m=0.0)
        self._scenario = replace(scenario, start=start, wrong_model=scenario.wrong_model.drawn(seed))
        self.starts = 0
        """Number of starts of the program: a vehicle that turned over is not flown on."""
        self._links: Links | None = None
        self._autopilot: Autopilot | None = None
        self._sticks_s = 0.0
        self._ended: asyncio.Task[None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._run(self._close())
        self._loop.close()
        self._ports.close()

    @property
    def hand(self) -> Hand:
        """The holder of the vehicle by the driver."""
        return Hand.NOBODY if self._autopilot.streamer is None else self._autopilot.streamer.hand

    @property
    def now(self) -> MonoNs:
        return self.clock.now()

    @property
    def now_s(self) -> float:
        return self.clock.now() * 1e-9

    def begin(self, *, on_deck: bool = False) -> None:
        """Bring the vehicle over the pad in a person's mode, or onto it, and meet it with a driver that knows nothing of it."""
        for _ in range(3):
            if not self.starts or not self.body.upright:
                self._run(self._start())
            if self._placed(on_deck=on_deck):
                self._run(self._meet())
                return
            self._run(self._start())
        raise TimeoutError(f"{self.station.failure}: {self.toy.mode}, {self.toy.height_m:.1f} m")

    def step(self) -> None:
        """Run one cycle."""
        self._run(self._step())

    def reach_deck(self) -> None:
        """Descend onto the deck by the vehicle's own landing."""
        self.guidance.command = Velocity(np.array([0.0, 0.0, 1.0]), 0.0)
        self.until(lambda: self.toy.height_m < 1.0)
        self.guidance.command, began_s = Land(), self.body.t_s
        self.until(lambda: (contact := self.body.landing) is not None and contact.at > 1e9 * began_s)

    # The world

    def _run(self, what: Coroutine[Any, Any, _T]) -> _T:
        async def bounded() -> _T:
            async with asyncio.timeout(_WALL_S):
                return await what

        return self._loop.run_until_complete(bounded())

    async def _close(self) -> None:
        await self._driver.aclose()
        await self._program.aclose()

    async def _start(self) -> None:
        """Start the program anew, on the pad."""
        await self._close()
        self._ports.close()
        ports = [self._ports.enter_context(reserved_port()) for _ in range(2)]
        fixed = self._stack is Stack.PX4 and self._binary is not None
        self._port, to_station = px4.MAVLINK_PORTS if fixed else (ports[0], ports[1])
        self.starts += 1
        self.clock = LockStepClock()
        copter = self._stack is Stack.ARDUPILOT
        step_s = in_process.STEP_S if self._binary is None else COPTER_STEP_S if copter else px4.STEP_S
        self.body = Body(self._scenario, self.seed + self.starts, step_s, CURVE if copter else 0.0)
        link = LinkOptions(parse_endpoint(f"udpin://{HOST}:{to_station}"))
        enter = self._program.enter_async_context
        self._links = await enter(open_links((link,), self.clock, STATION, access=NamedSenders(everybody=True)))
        self.toy: Vehicle = Vehicle(self._stack, self.body, self._say, lambda: self.now_s)
        self._autopilot = None
        folder = Path(self._program.enter_context(TemporaryDirectory(prefix="decklander-hands-")))
        await self._fly(folder, (self._port, to_station))
        self._sticks_s = self.now_s

    async def _fly(self, folder: Path, ports: tuple[int, int]) -> None:
        enter, body, given = self._program.enter_async_context, self.body, _PARAMETERS[self._stack]
        if self._binary is None:
            own: in_process.StandIn = Px4StandIn(self.clock, {"MIS_TAKEOFF_ALT": HEIGHT_M})
            if self._stack is Stack.ARDUPILOT:
                own = CopterStandIn(self.clock, {}, in_process.STEP_S)
            urls = tuple(f"udpout://{HOST}:{port}" for port in ports)
            await enter(_flying(own, body, self.clock, (urls[0], urls[1]), self._stepped, self.clock.settle))
        elif self._stack is Stack.PX4:
            hil = HilBackend(body, seed=self.seed, stepped=self._stepped)
            words, environment = px4.start(self._binary, height_m=HEIGHT_M, parameters=given)
            await enter(serve_hil(hil, HOST, px4.PHYSICS_PORT, settle=self.clock.settle))
            await enter(running(words, folder, environment))
        else:
            backend = JsonBackend(lambda step_s: body, self._stepped, body)
            port = await enter(serve_json(backend, HOST, 0, settle=self.clock.settle))
            words = arducopter.argv(self._binary, folder, physics=port, mavlink_ports=ports, speedup=20.0, parameters=given)
            await enter(running(words, folder))

    def _stepped(self, body: Body) -> None:
        self.clock.advance(body.step_s)

    def _say(self, message: Message) -> None:
        self._links.send(message)

    async def _person(self) -> None:
        """Pass a cycle's time, read what the autopilot reports to the station, and keep the sticks centred."""
        await self.clock.sleep(STEP_S)
        while len(self._links.received):
            message = (await self._links.received.get()).message
            self.station.on_message(message, self.now)
            if message.get_type() == "COMMAND_ACK" and message.command == mav.MAV_CMD_DO_SET_MODE:
                self.toy.denied |= message.result != mav.MAV_RESULT_ACCEPTED and message.target_system in (0, STATION[0])
            if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == AUTOPILOT[1]:
                self.toy.mode, self.toy.armed = self.station.mode, self.station.armed
        if self.now_s < self._sticks_s:
            return
        self._sticks_s = self.now_s + _STICKS_S
        self._say(mav.MAVLink_heartbeat_message(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3))
        self._say(request_message(AUTOPILOT, int(mav.MAVLINK_MSG_ID_HEARTBEAT)))
        if self._stack is Stack.PX4:
            self._say(mav.MAVLink_manual_control_message(AUTOPILOT[0], 0, 0, 500, 0, 0))
        else:
            throttle = _CENTRED if self.toy.armed else _LOW  # else ArduCopter does not arm
            self._say(mav.MAVLink_rc_channels_override_message(*AUTOPILOT, _CENTRED, _CENTRED, throttle, _CENTRED, 0, 0, 0, 0))
        if self.toy.others_stream:
            yaw = self.body.state().R_ned_body.rpy_rad[2]
            self._say(velocity_setpoint(self.now // 1_000_000, AUTOPILOT, STILL, yaw))

    def _placed(self, *, on_deck: bool) -> bool:
        """Bring it over the pad, or onto it; return whether it is there."""
        self.toy.others_stream = False
        armed, self.station = self.toy.armed, GroundStation(self._stack, height_m=HEIGHT_M)
        if armed:
            self.station.mode, self.station.armed = self.toy.mode, True
            self.station.again(self.now, self.toy.height_m)
        if on_deck and not armed and self.toy.height_m < 0.05:
            return self._known()
        while self.station.task not in (Task.ORDER, Task.FAILED):
            self._run(self._by_station())
            if not self.body.upright:
                return False
        if self.station.task is Task.FAILED:
            return False
        mode = (LAND_MODE if on_deck else PERSONS_MODE)[self._stack]
        self.toy.switch(mode)
        for _ in range(round(60.0 / STEP_S)):
            self._run(self._person())
            if self.toy.mode == mode and not (on_deck and self.toy.armed):
                return self.body.upright
        return False

    def _known(self) -> bool:
        """Wait until the autopilot would arm."""
        while seconds_between(self.clock.started, self.now) < _READY_S:
            self._run(self._person())
        return self.toy.mode != ""

    async def _by_station(self) -> None:
        await self._person()
        for message in self.station.period(self.now, view_of(self.body)):
            self._say(message)

    async def _meet(self) -> None:
        """Open a driver, and wait until it knows the autopilot."""
        await self._driver.aclose()
        options = AutopilotOptions(f"udpin://{HOST}:{self._port}")
        self._autopilot = autopilot = await self._driver.enter_async_context(open_autopilot(options, self.clock))
        self.guidance = Guidance(engage=autopilot.engage, resumed=STILL)
        self.arbiter = OperatorArbiter(self.guidance)
        self.answers: list[HandledOrder] = []
        self.arbiter.on_order = self.answers.append
        self.toy.log.clear()
        self.toy.setpoints.clear()
        self.toy.denied = False
        autopilot.links.tap = self.toy.tap
        settled = 0
        while settled < round(1.0 / STEP_S):
            await self._step()
            known = autopilot.streamer is not None and autopilot.condition.flying is not None and autopilot.attitude is not None
            settled = settled + 1 if known and self.guidance.vehicle is not None else 0

    async def _step(self) -> None:
        await self._person()
        autopilot = self._autopilot
        while len(autopilot.samples):
            sample = await autopilot.samples.get()
            if isinstance(sample, VehicleStatus):
                self.guidance.vehicle = sample
        self.arbiter.tick(self.now)
        command = self.arbiter.choose(self.now, self.guidance.command).command
        if command is not None:
            with suppress(Recoverable):
                autopilot.command(command)


class _StandInProgram:
    """A stand-in in the place of a running program: it never ends by itself."""

    last_line = "it is a stand-in and prints nothing"

    @staticmethod
    async def ended() -> None:
        """Wait for ever."""
        await asyncio.Event().wait()


@asynccontextmanager
async def _flying(
    stand_in: in_process.StandIn,
    body: Body,
    clock: LockStepClock,
    urls: tuple[str, str],
    stepped: Callable[[Body], None],
    settle: Callable[[], Awaitable[None]],
) -> AsyncIterator[_StandInProgram]:
    """Step body and stand-in while the context is open.

    Args:
        urls: the links of its two MAVLink ports.
        stepped: called after each step.
        settle: awaited after each step.
    """

    async def step() -> None:
        while True:
            body.step(stand_in.step(body.state()))
            stepped(body)
            await settle()

    options = [LinkOptions(parse_endpoint(url)) for url in urls]
    async with open_links(options, clock, (stand_in.system, 1)) as links, asyncio.TaskGroup() as group:
        stand_in.links = links
        tasks = [group.create_task(stand_in._live()), group.create_task(stand_in._read(links)), group.create_task(step())]
        try:
            yield _StandInProgram()
        finally:
            for task in tasks:
                task.cancel()
