"""The person at the ground station, and the lock step of clock, camera and links that a flight is made in."""

import asyncio
import math
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.vehicle import ARMED, Stack, custom_mode
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import Frame
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between
from sitl.emulators.autopilots.body import Body
from sitl.emulators.autopilots.lock_step import CameraTiming, LockStepCamera, LockStepClock
from sitl.emulators.autopilots.programs.program import reserved_port, running
from sitl.emulators.autopilots.station import GroundStation, OperatorView, Task
from sitl.faults.fault import FaultTimer
from sitl.faults.faulty_streams import VehicleStreams
from sitl.scenario.scenario import load
from tests.support.processes import alive
from tests.support.waiting import until

FAR = OperatorView(np.array([3.0, 4.0, 0.0]), np.array([1.5, 0.0, 0.0]), np.array([1.5, 0.0, 0.0]), 0.3, 0.5, 0.05)


def spoken(message: Message, component: int = 1, system: int = 1) -> Message:
    """Return a message as received from that component."""
    sender = mav.MAVLink(None, srcSystem=system, srcComponent=component)
    return mav.MAVLink(None).decode(bytearray(message.pack(sender)))


def beat(mode: str, armed: bool) -> Message:
    base = ARMED if armed else 0
    return spoken(mav.MAVLink_heartbeat_message(2, 3, base, custom_mode(Stack.ARDUPILOT, mode), 4, 3))


def ack(command: int, result: int, component: int = 1) -> Message:
    return spoken(mav.MAVLink_command_ack_message(command, result), component)


class CommandHandler:
    """The station and its clock."""

    def __init__(self, stack: Stack = Stack.ARDUPILOT, *, lands_by: str | None = None) -> None:
        self.station = GroundStation(stack, height_m=4.0, lands_by=lands_by)
        self.t_s = 10.0
        self.view = FAR

    def wait(self, seconds: float) -> list[Message]:
        out = []
        for _ in range(round(10 * seconds)):
            self.t_s += 0.1
            out += self.station.period(self.now, self.view)
        return out

    def arm(self) -> None:
        """Send the armed state as the autopilot does."""
        for mode, armed in (("stabilize", False), ("guided", False), ("guided", True)):
            self.on_message(beat(mode, armed))
            self.wait(1.0)

    @property
    def now(self) -> MonoNs:
        return MonoNs(round(self.t_s * NS_PER_S))

    def on_message(self, message: Message) -> None:
        self.station.on_message(message, self.now)


def station_commands(messages: list[Message]) -> list[tuple[int, int]]:
    return [(m.command, m.target_component) for m in messages if m.get_type() == "COMMAND_LONG"]


def test_from_the_first_heartbeat_to_the_order() -> None:
    command_handler = CommandHandler()
    assert {m.get_type() for m in command_handler.wait(2.0)} == {"HEARTBEAT"}
    command_handler.on_message(beat("stabilize", False))
    assert set(station_commands(command_handler.wait(2.0))) == {(mav.MAV_CMD_DO_SET_MODE, 1)}
    command_handler.on_message(beat("guided", False))
    assert set(station_commands(command_handler.wait(2.0))) == {(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)}
    command_handler.on_message(beat("guided", True))
    climbing = [m for m in command_handler.wait(1.0) if m.get_type() == "COMMAND_LONG"]
    assert [(m.command, m.param7) for m in climbing] == [(mav.MAV_CMD_NAV_TAKEOFF, 4.0)]
    command_handler.view = replace(FAR, height_m=2.0)
    assert station_commands(command_handler.wait(2.0)) == [], "it climbs: nothing to repeat"
    command_handler.view = replace(FAR, height_m=3.9)
    flying = [m for m in command_handler.wait(1.0) if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    # 5 m away: 1.5 m/s towards it on top of the ship's 1.5 m/s ahead, in ned by a heading of 0.3 rad
    c, s = math.cos(0.3), math.sin(0.3)
    ahead, right = 1.5 + 1.5 * 0.6, 1.5 * 0.8
    assert (flying[-1].vx, flying[-1].vy) == pytest.approx((c * ahead - s * right, s * ahead + c * right), abs=1e-5)
    assert flying[-1].yaw_rate == pytest.approx(0.4)
    # A pad that heaves takes the start up and down with it
    there = replace(FAR, height_m=4.0, to_start_level=np.array([0.3, 0.2, 1.2]), v_rel_level=np.array([0.1, 0.1, -0.9]))
    command_handler.view = there
    assert station_commands(command_handler.wait(3.0)) == [], "not on the heading yet"
    command_handler.view = replace(there, turn_rad=0.05)
    assert (mav.MAV_CMD_NAV_LAND, 191) in station_commands(command_handler.wait(1.6))
    command_handler.on_message(ack(mav.MAV_CMD_NAV_LAND, mav.MAV_RESULT_IN_PROGRESS, 191))
    assert command_handler.station.task is Task.WATCH
    assert command_handler.station.began == command_handler.now
    assert {m.get_type() for m in command_handler.wait(2.0)} == {"HEARTBEAT"}, "the companion has it"


def test_where_the_landing_begins_at_rest_the_start_comes_up_to_a_vehicle_that_stopped_ahead_of_it() -> None:
    """WHY: `start.with_vessel = false` was not obeyed, and each landing began with the ship's velocity."""
    command_handler = CommandHandler()
    command_handler.arm()
    start, body, v_ship = np.zeros(2), np.array([-9.0, 2.0]), np.array([1.5, 0.0])
    v, ordered = np.zeros(2), False
    for _ in range(600):
        d, v_rel = np.array([*(start - body), 0.0]), np.array([*(v_ship - v), 0.0])
        command_handler.view = OperatorView(d, np.array([*v_ship, 0.0]), v_rel, 0.0, 0.0, 4.0, rests=True)
        output = command_handler.wait(0.1)
        v = next((np.array([m.vx, m.vy]) for m in output if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"), v)
        if ordered := (mav.MAV_CMD_NAV_LAND, 191) in station_commands(output):
            break
        start, body = start + 0.1 * v_ship, body + 0.1 * v
    assert ordered
    assert v.tolist() == [0.0, 0.0]
    assert math.hypot(*(start - body)) < 0.7


def test_px4_is_armed_and_climbs_in_offboard_with_the_decks_velocity() -> None:
    """Its own take-off holds over the ground, and a place of zeros is a place to it."""
    command_handler = CommandHandler(Stack.PX4)
    command_handler.view = replace(FAR, yaw_rad=0.0, v_deck_level=np.array([1.5, 0.2, 0.4]))

    def beat_px4(mode: str, armed: bool) -> None:
        base = ARMED if armed else 0
        number = custom_mode(Stack.PX4, mode)
        command_handler.on_message(spoken(mav.MAVLink_heartbeat_message(2, 12, base, number, 4, 3)))

    def flown(seconds: float) -> tuple[set[tuple[int, int]], set[tuple[float, ...]]]:
        out = command_handler.wait(seconds)
        steered = [m for m in out if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
        return set(station_commands(out)), {(round(m.vx, 3), round(m.vy, 3), round(m.vz, 3)) for m in steered}

    beat_px4("auto.loiter", False)
    assert flown(2.0) == ({(mav.MAV_CMD_DO_SET_MODE, 1)}, {(1.5, 0.2, 0.0)})
    beat_px4("offboard", False)
    assert flown(2.0) == ({(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)}, {(1.5, 0.2, 0.0)})
    beat_px4("offboard", True)
    assert flown(2.0) == (set(), {(1.5, 0.2, -1.0)})
    command_handler.view = replace(command_handler.view, height_m=3.9)
    command_handler.wait(0.3)
    assert command_handler.station.task is Task.GO


@pytest.mark.parametrize(
    ("received_at", "waited_s", "said"),
    [
        ([], 61.0, "no heartbeat"),
        ([beat("guided", False), spoken(mav.MAVLink_statustext_message(2, b"PreArm: Compass"))], 91.0, "arm: PreArm: Compass"),
        ([beat("guided", False)], 91.0, "it printed nothing"),
        ([beat("guided", False), beat("guided", True)], 31.0, "did not take off"),
    ],
)
def test_what_does_not_come_about_is_given_up_with_the_autopilots_words(received_at, waited_s, said):
    command_handler = CommandHandler()
    for message in received_at:
        command_handler.on_message(message)
    command_handler.wait(waited_s)
    assert command_handler.station.task is Task.FAILED
    assert said in command_handler.station.failure


def ready_to_order() -> CommandHandler:
    command_handler = CommandHandler()
    command_handler.on_message(beat("guided", False))
    command_handler.on_message(beat("guided", True))
    nothing = np.zeros(3)
    command_handler.view = replace(FAR, height_m=3.9, to_start_level=nothing, v_rel_level=nothing, turn_rad=0.0)
    command_handler.wait(1.6)
    assert command_handler.station.task is Task.ORDER
    return command_handler


def test_a_companion_that_refuses_or_is_silent_ends_it() -> None:
    command_handler = ready_to_order()
    command_handler.on_message(ack(mav.MAV_CMD_NAV_LAND, mav.MAV_RESULT_DENIED, 1))
    assert command_handler.station.task is Task.ORDER, "that was the autopilot's answer"
    command_handler.on_message(ack(mav.MAV_CMD_NAV_LAND, mav.MAV_RESULT_DENIED, 191))
    assert "refused" in command_handler.station.failure
    command_handler = ready_to_order()
    command_handler.wait(11.0)
    assert "did not answer" in command_handler.station.failure


@pytest.mark.parametrize("stands", [True, False])
def test_brought_back_from_the_deck_it_leaves_by_a_take_off_or_where_that_is_refused_by_setpoints(stands: bool) -> None:
    command_handler = CommandHandler()
    command_handler.arm()
    command_handler.on_message(ack(mav.MAV_CMD_NAV_TAKEOFF, mav.MAV_RESULT_FAILED))
    assert command_handler.station.task is Task.TAKE_OFF, "on the first time it is asked again"
    command_handler.station.again(command_handler.now, 0.05)
    assert (mav.MAV_CMD_NAV_TAKEOFF, 1) in station_commands(command_handler.wait(1.0))
    result = mav.MAV_RESULT_ACCEPTED if stands else mav.MAV_RESULT_FAILED
    command_handler.on_message(ack(mav.MAV_CMD_NAV_TAKEOFF, result))
    assert command_handler.station.task is (Task.TAKE_OFF if stands else Task.GO)
    sent = {m.get_type() for m in command_handler.wait(0.5)}
    assert ("SET_POSITION_TARGET_LOCAL_NED" in sent) is not stands


STEP_S = 0.005


async def test_sleepers_wake_in_the_order_of_their_time_and_not_before_it() -> None:
    clock = LockStepClock()
    woke: list[tuple[str, float]] = []

    async def sleeper(name: str, seconds: float) -> None:
        await clock.sleep(seconds)
        woke.append((name, seconds_between(clock.started, clock.now())))

    async with asyncio.TaskGroup() as group:
        for name, seconds in (("late", 0.03), ("early", 0.01), ("at once", 0.0)):
            group.create_task(sleeper(name, seconds))
        await clock.settle()
        assert not woke, "time stands still"
        for _ in range(4):
            clock.advance(0.01)
            await clock.settle()
    assert woke == [("at once", pytest.approx(0.01)), ("early", pytest.approx(0.01)), ("late", pytest.approx(0.03))]


async def filmed(timing: CameraTiming, eyes_s: float | None, seconds: float) -> tuple[LockStepCamera, list[Frame], LockStepClock]:
    """Return a camera over the deck; eyes that take so long of wall time for each frame, or wait for the time to go on."""
    clock, frames, done = LockStepClock(), [], [0]
    scenario = load("calm")
    body = Body(replace(scenario, start=replace(scenario.start, height_m=1.0)), 1, STEP_S, start=clock.now())
    loop = asyncio.get_running_loop()

    def offer(frame: Frame) -> None:
        frames.append(frame)
        if eyes_s is not None:
            loop.call_later(eyes_s, lambda: done.__setitem__(0, done[0] + 1))

    def looking() -> bool:
        return eyes_s is not None and done[0] < len(frames)

    with ThreadPoolExecutor(1) as pool:
        camera = LockStepCamera(clock, offer, lambda: done[0], looking, pool, VehicleStreams(FaultTimer(()), 1).frames, timing)
        camera.on = True
        for _ in range(round(seconds / STEP_S)):
            body.step((0.4, 0.4, 0.4, 0.4))
            clock.advance(STEP_S)
            camera.stepped(body)
            await camera.settle()
    return camera, frames, clock


@pytest.mark.parametrize("eyes_s", [0.03, 0.4])
async def test_images_arrive_late_by_their_delay_and_at_their_rate_however_slow_the_eyes(eyes_s: float) -> None:
    camera, frames, clock = await filmed(CameraTiming(period_s=0.05, delay_s=0.04, vision_s=0.02), eyes_s, 0.4)
    assert camera.waited_out == 0
    assert [f.stamp.delay_s for f in frames] == pytest.approx([0.04] * len(frames))
    exposed = [seconds_between(clock.started, f.stamp.measured_at) for f in frames]
    assert exposed == pytest.approx([0.005 + 0.05 * n for n in range(8)])
    assert [f.seq for f in frames] == list(range(1, 9))
    assert frames[0].px.shape == (360, 640, 3)


async def test_the_world_goes_on_when_the_service_waits_for_the_time() -> None:
    camera, frames, _ = await filmed(CameraTiming(period_s=0.05, delay_s=0.01, vision_s=0.01), None, 0.07)
    assert len(frames) >= 1
    assert camera.waited_out > 0


def script(folder: Path, body: str) -> Path:
    path = folder / "program"
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


async def test_a_stubborn_program_and_its_children_are_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.emulators.autopilots.programs.program._END_S", 0.2)
    binary = script(tmp_path, "trap '' TERM\nsleep 60 &\necho $$ $! > ids\nwhile :; do sleep 1; done")
    async with asyncio.timeout(60), running([str(binary)], tmp_path):
        await until(lambda: (tmp_path / "ids").exists() and (tmp_path / "ids").read_text().endswith("\n"))
    numbers = [int(word) for word in (tmp_path / "ids").read_text().split()]
    assert len(numbers) == 2
    await until(lambda: not any(map(alive, numbers)))


async def test_a_program_that_ends_is_reported_with_its_reason(tmp_path: Path) -> None:
    binary = script(tmp_path, "echo first; echo no such model >&2; exit 3")
    async with running([str(binary)], tmp_path) as program:
        with pytest.raises(Recoverable, match=r"code 3.*no such model"):
            await program.ended()


def test_a_reserved_port_is_nobody_elses_until_it_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    with reserved_port() as port:
        assert port < int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0]), "or the system hands it out"
        monkeypatch.setattr("sitl.emulators.autopilots.programs.program._PORTS", range(port, port + 1))
        with pytest.raises(Recoverable, match=f"each port from {port} to {port}"), reserved_port():
            pass
    with reserved_port() as again:
        assert again == port
