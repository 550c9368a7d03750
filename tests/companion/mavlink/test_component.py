"""The component beside an autopilot, over real sockets: what it sends, what ends its heartbeat, and bytes that end nothing."""

import asyncio
import logging
import math
import random
from collections import Counter
from collections.abc import Iterator
from contextlib import AsyncExitStack
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from companion.base.health import Health
from companion.base.mission import ReasonCause, State
from companion.base.observer import Decision, ResponseInUse, ResponseState, TiltShape
from companion.parts.mavlink.component import Component, StatusTexts
from companion.parts.mavlink.outputs import Lead, Outputs
from companion.settings.links import OutputOptions
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import ComponentInformationBasic, Message, mav
from drivers.mavlink.links import Containment, ReceivedMessage
from drivers.mavlink.vehicle import Stack
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import IntegrityAlert, Verdict
from estimator.contracts.time import MonoNs
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.mavlink.receivers import ArduPilotReceiver, Px4Receiver
from tests.companion.mavlink.stage import AUTOPILOT, PAD_NED, US, Border, bordered, messages, staged, wire_frame
from tests.support.clocks import SteppedClock
from tests.support.fake_operator import FakeOperator
from tests.support.waiting import until


async def test_an_ardupilot_gets_the_place_of_the_pad() -> None:
    tilt = (math.radians(8.0), math.radians(-5.0), math.radians(130.0))
    fake = MiniatureAutopilot(parameters={"PLND_LAG": 0.02})
    fake.rpy = lambda t: tilt
    async with staged(fake) as stage:
        await until(lambda: len(fake.of("LANDING_TARGET")) > 20)
        receiver = ArduPilotReceiver()
        receiver.loop(tilt)
        for m in fake.of("LANDING_TARGET")[-5:]:
            assert (m.frame, m.position_valid, m.type) == (12, 1, 3)
            assert receiver.on_message(m) == pytest.approx(PAD_NED - fake.p_ned, abs=0.01)
        assert stage.component.outputs.sends_ranges is not None


async def test_a_px4_gets_the_pad_in_its_own_local_frame() -> None:
    fake = MiniatureAutopilot(Stack.PX4, mode="auto.loiter", p_ned=np.array([0.2, -1.9, -6.0]), v_ned=np.array([0.8, 0.3, 0.0]))
    fake.rpy = lambda t: (0.1, -0.15, 2.0)
    async with staged(fake, outputs={"vision_target_estimator": True}):
        await until(lambda: len(fake.of("LANDING_TARGET")) > 10)
        receiver = Px4Receiver()
        for m in fake.of("LANDING_TARGET")[-5:]:
            reported = receiver.on_message(m)
            assert reported[0] == "absolute"
            # It flies at 0.9 m/s: the place on the ground stands still only if both parts are of one instant
            assert reported[1] == pytest.approx(PAD_NED, abs=0.03)
        stamps = [m.time_usec for m in fake.of("LANDING_TARGET")]
        assert stamps == sorted(set(stamps)), "never the same instant twice"
        assert len(fake.of("TARGET_RELATIVE")) > 5
        assert receiver.events == []


async def test_a_pad_out_of_sight_or_in_doubt_and_a_vehicle_on_the_ground_are_not_reported() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake) as stage:

        def targets() -> int:
            return len(fake.of("LANDING_TARGET"))

        async def withheld(why: str) -> None:
            before = stage.component.outputs.withheld[why]
            await until(lambda: stage.component.outputs.withheld[why] > before + 3)
            await asyncio.sleep(0.1)
            silent = targets()
            await asyncio.sleep(0.3)
            assert targets() == silent

        await until(lambda: targets() > 5)
        stage.seen = False
        await withheld("not seen")
        stage.seen, stage.alerts = True, (IntegrityAlert.ELSEWHERE,)
        await withheld("not seen")
        stage.alerts, fake.landed_state = (), 3
        await withheld("taking off")
        fake.landed_state, climbed = 2, targets()
        await until(lambda: targets() > climbed)
        fake.landed_state, fake.armed = 1, False
        await withheld("on ground")


async def test_distances_where_the_autopilots_rangefinder_is_us() -> None:
    fake = MiniatureAutopilot(parameters={"RNGFND1_TYPE": 10.0, "PLND_LAG": 0.02}, landed_state=1, armed=False)
    fake.rpy = lambda t: (0.2, 0.0, 0.0)
    async with staged(fake) as stage:
        await until(lambda: len(fake.of("DISTANCE_SENSOR")) > 5)
        assert fake.of("DISTANCE_SENSOR")[-1].current_distance == 10, "already on the ground, or arming is refused"
        fake.landed_state, fake.armed = 2, True
        await until(lambda: fake.of("DISTANCE_SENSOR")[-1].current_distance > 400)
        m = fake.of("DISTANCE_SENSOR")[-1]
        assert m.orientation == 25
        assert m.current_distance == pytest.approx(100 * 5.0 / math.cos(0.2), abs=2)
        stage.seen = False
        await until(lambda: fake.of("DISTANCE_SENSOR")[-1].signal_quality == 1)


async def test_our_own_distances_come_back_as_no_measurement() -> None:
    fake = MiniatureAutopilot(parameters={"RNGFND1_TYPE": 10.0, "PLND_LAG": 0.02}, distance_cm=480)
    async with staged(fake) as stage:
        await until(lambda: len(fake.of("DISTANCE_SENSOR")) > 5)
        before, received_at = stage.ranges, stage.autopilot.counts["DISTANCE_SENSOR"]
        await until(lambda: stage.autopilot.counts["DISTANCE_SENSOR"] > received_at + 5)
        assert stage.ranges == before
        fake.parameters["RNGFND1_TYPE"] = 20.0
        stage.autopilot.parameters.request(["RNGFND1_TYPE"])
        await until(lambda: stage.ranges > before + 3)


async def test_the_heartbeat_stops_with_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.parts.mavlink.component._HEARTBEAT_S", 0.05)
    monkeypatch.setattr("companion.parts.mavlink.component._GUIDANCE_SILENCE_S", 0.2)
    fake = MiniatureAutopilot()
    async with staged(fake) as stage:
        stage.health.vital("vision")
        stage.health.up("vision")
        await until(lambda: len(fake.of("HEARTBEAT")) > 5)
        beat = fake.of("HEARTBEAT")[-1]
        assert (beat.get_srcSystem(), beat.get_srcComponent(), beat.type, beat.autopilot) == (7, 191, 18, 8)
        for fault in ("sick", "hung"):
            if fault == "sick":
                stage.health.down("vision", Recoverable("gone"))
            else:
                stage.health.up("vision")
                stage.deciding = False
                await asyncio.sleep(0.3)
            await asyncio.sleep(0.1)
            silent = len(fake.of("HEARTBEAT"))
            await asyncio.sleep(0.3)
            assert len(fake.of("HEARTBEAT")) == silent, fault
        stage.deciding = True
        await until(lambda: len(fake.of("HEARTBEAT")) > silent)
        texts = [m.text for m in fake.of("STATUSTEXT")]
        assert "Decklander: vision is down: gone" in texts
        assert "Decklander: guidance stands still" in texts


async def test_what_a_pilot_must_know() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake) as stage:
        stage.phase = "gave up"
        await until(lambda: len(fake.of("STATUSTEXT")) >= 2)
        reported = {m.text: m.severity for m in fake.of("STATUSTEXT")}
        assert reported == {"Decklander: approach": 6, "Decklander: gave up": 2}
        await until(lambda: len([m for m in fake.of("NAMED_VALUE_FLOAT") if m.name == "dl_sigma"]) == 2)
        values = {m.name: m.value for m in fake.of("NAMED_VALUE_FLOAT")}
        assert values["dl_seen"] == 1.0
        assert (values["dl_height"], values["dl_lateral"]) == pytest.approx((5.0, 1.7), abs=0.01)
        assert values["dl_sigma"] == pytest.approx(0.01, abs=1e-3)
        stage.lost = ("the gyro repeats its readings",)
        await until(lambda: any("the gyro repeats" in text.text for text in fake.of("STATUSTEXT")))
        await asyncio.sleep(0.3)
        assert sum("the gyro repeats" in text.text for text in fake.of("STATUSTEXT")) == 1


async def test_commands_from_the_wire() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake) as stage:
        fake.send(mav.MAVLink_command_long_message(7, 191, 193, 0, 0, 0, 0, 0, 0, 0, 0))
        fake.send(mav.MAVLink_command_long_message(7, 191, 512, 0, ComponentInformationBasic.id, 0, 0, 0, 0, 0, 0))
        await until(lambda: bool(fake.of("COMPONENT_INFORMATION_BASIC")))
        assert stage.tower.done == ["hold"]
        assert {(m.command, m.result) for m in fake.of("COMMAND_ACK")} == {(193, 0), (512, 0)}
        assert fake.of("COMPONENT_INFORMATION_BASIC")[0].vendor_name == "Decklander"
        stage.tower.cannot = "no recorder is set up"
        fake.send(mav.MAVLink_command_long_message(7, 191, 2510, 0, 0, 0, 0, 0, 0, 0, 0))
        await until(lambda: any("no recorder" in m.text for m in fake.of("STATUSTEXT")))
        await until(lambda: len(fake.of("ONBOARD_COMPUTER_STATUS")) > 0)


async def test_a_frame_that_was_fused_is_reported_without_waiting_for_the_next_turn() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake, outputs={"rate_hz": 1.0}) as stage:
        await until(lambda: len(fake.of("LANDING_TARGET")) >= 1)
        before = len(fake.of("LANDING_TARGET"))
        for _ in range(10):
            stage.component.on_frame(SimpleNamespace(verdict=Verdict.FUSED))  # type: ignore[arg-type]
            await asyncio.sleep(0.02)
        assert len(fake.of("LANDING_TARGET")) - before >= 9


FLOWN_S = 10


class Said:
    """Messages that go out over the links."""

    def __init__(self, clock: SteppedClock) -> None:
        self.contained = Containment(clock)
        self.kinds: Counter[str] = Counter()
        self.texts: list[str] = []
        self.identity = (1, 191)

    def send(self, message: Message, to: int | None = None) -> bool:
        self.kinds[message.get_type()] += 1
        if message.get_type() == "STATUSTEXT":
            self.texts.append(str(message.text))
        return True


def component_of(health: Health, clock: SteppedClock) -> Component:
    outputs = Outputs(OutputOptions(), 0.39, 0.5)
    return Component(outputs, FakeOperator(), None, believe=lambda now: None, clock=clock, health=health)


def ticked(health: Health, clock: SteppedClock, broken: str | None = None, error: BaseException | None = None) -> Said:
    """Ten seconds of ticks with guidance deciding, one thing that it says broken."""
    component = component_of(health, clock)
    output = Said(clock)
    autopilot: Any = SimpleNamespace(links=output, add_listener=lambda listener: None, connected=False)
    component.attach(autopilot)

    def fail(*_: object) -> None:
        assert error is not None
        raise error

    if broken is not None:
        owner, _, name = broken.rpartition(".")
        setattr(getattr(component, owner) if owner else component, name, fail)
    for n in range(100 * FLOWN_S):
        clock.advance(0.01)
        if n % 2 == 0:
            component.on_decision(Decision(clock.t, "approach", None, None))
        component.tick(clock.t)
    return output


@pytest.fixture
def health() -> Health:
    health = Health(SteppedClock(MonoNs(0)))
    for part in ("vehicle", "guidance"):
        health.vital(part)
        health.up(part)
    return health


def test_a_part_beside_the_flight_that_is_down_costs_no_heartbeat_a_vital_one_ends_it(health) -> None:
    health.down("broker", Recoverable("gone"))
    health.too_slow = "this computer manages 7 of 30 frames a second: choose 320x180"
    output = ticked(health, SteppedClock(MonoNs(0)))
    assert output.kinds["HEARTBEAT"] == FLOWN_S
    texts = ["Decklander: broker is down: gone", f"Decklander: {health.too_slow}"[:50]]
    assert [text for text in output.texts if "broker" in text or "frames" in text] == texts
    health.down("guidance", Recoverable("gone"))
    assert ticked(health, SteppedClock(MonoNs(0))).kinds["HEARTBEAT"] == 0


@pytest.mark.parametrize("broken", ["_computer.read", "_figure", "texts.due", "_commands.due", "_check_health"])
@pytest.mark.parametrize("error", [OSError(24, "too many open files"), ValueError("bad"), MemoryError(), RecursionError()])
def test_whatever_else_it_says_may_fail_and_the_heartbeat_goes_on(health: Health, broken: str, error: BaseException) -> None:
    output = ticked(health, SteppedClock(MonoNs(0)), broken, error)
    assert output.kinds["HEARTBEAT"] == FLOWN_S
    assert sum(health.contained.values()) + output.contained.total > 0


def test_the_ground_station_learns_of_a_response_only_if_it_contradicts_its_file(health: Health) -> None:
    component = component_of(health, SteppedClock())
    known, later = ResponseInUse(ResponseState.KNOWN, 0.05, 0.02), ResponseInUse(ResponseState.IDENTIFIED, 0.15, 0.012, 0.1)
    slower = ResponseInUse(ResponseState.KNOWN, 0.05, 0.02, shape=TiltShape(0.75, 0.9, 2.0, 0.05))
    quicker = ResponseInUse(ResponseState.KNOWN, 0.05, 0.02, shape=TiltShape(1.35, 0.9, 1.0, 0.03))
    for response in (known, quicker, later, slower):
        component.on_decision(Decision(MonoNs(7), "descend", None, None, response=response))
    texts = [text for _, text in component.texts._waiting if "answers" in text]
    assert texts == [f"Decklander: {later.text}", f"Decklander: {slower.text}"]
    assert "this vehicle answers 25 % slower than its file (sigma 5 %), damped 10 % less; the vehicle's" in texts[1]


def test_a_pilot_who_is_to_choose_the_landing_mode_is_asked_for_it_on_the_ground_station(health: Health) -> None:
    component, words = component_of(health, SteppedClock()), ReasonCause.AWAITS_PILOT.value
    for lead, asked in ((None, 0), (Lead(lambda now: None, 1.5), 2)):
        component.outputs.lead, component.texts = lead, StatusTexts()
        for at in (1, 6, 12):
            component.on_decision(Decision(MonoNs(at * 10**9), State.GATE.value, None, None, reason=words))
        assert [text for _, text in component.texts._waiting].count(f"Decklander: {words}") == asked
        assert lead is None or lead.wanted


@pytest.fixture(scope="module")
def border() -> Iterator[tuple[asyncio.AbstractEventLoop, Border]]:
    loop = asyncio.new_event_loop()
    stack = AsyncExitStack()
    yield loop, loop.run_until_complete(stack.enter_async_context(bordered()))
    loop.run_until_complete(stack.aclose())
    loop.close()


async def test_the_two_datagrams_that_ended_the_service() -> None:
    async with bordered() as border:
        await border.send(mav.MAVLink_command_long_message(*US, 511, 0, 0, 1e38, 0, 0, 0, 0, 0))
        await border.send(mav.MAVLink_command_long_message(*US, 510, 0, 0, 0, 0, 0, 0, 0, 0))
        acks = {m.command: m.result for m in border.answers() if m.get_type() == "COMMAND_ACK"}
        assert acks[511] == mav.MAV_RESULT_DENIED, "an interval that no answer can carry"
        assert acks[510] == mav.MAV_RESULT_ACCEPTED
        await border.alive()


def test_every_message_of_the_dialect_with_random_bytes_as_its_fields(border: tuple[asyncio.AbstractEventLoop, Border]) -> None:
    loop, service = border
    chance = random.Random(11)
    for cls in mav.mavlink_map.values():
        size = cls.unpacker.size
        payloads = [b"\xff" * size, b"\x00", *(chance.randbytes(size) for _ in range(3))]
        for source in (AUTOPILOT, (255, 190), (0, 0)):
            loop.run_until_complete(service.throw(*(wire_frame(cls, payload, source) for payload in payloads)))
        assert dict(service.links.contained.faults) == {}, cls.msgname
    loop.run_until_complete(service.alive())


@settings(max_examples=400, derandomize=True, suppress_health_check=list(HealthCheck))
@given(data=messages() | messages(mav.MAVLink_command_long_message))
def test_any_fields_with_the_right_checksum(border: tuple[asyncio.AbstractEventLoop, Border], data: bytes) -> None:
    loop, service = border
    loop.run_until_complete(service.throw(data))
    assert dict(service.links.contained.faults) == {}
    assert dict(service.links.unfit) == {}


def test_and_the_service_goes_on_answering(border: tuple[asyncio.AbstractEventLoop, Border]) -> None:
    loop, service = border
    service.clock.leap(30.0)  # what other autopilots with its id seem to have said counts for seconds
    loop.run_until_complete(service.alive())
    loop.run_until_complete(service.told_of_the_pad())


async def test_a_bug_in_a_handler_is_counted_and_logged_once_and_ends_nothing(caplog: pytest.LogCaptureFixture) -> None:
    def broken(received: ReceivedMessage) -> None:
        raise ZeroDivisionError("a bug of ours")

    async with bordered() as border:
        border.autopilot._listeners.insert(0, broken)
        with caplog.at_level(logging.ERROR):
            await border.send(*(mav.MAVLink_statustext_message(4, b"any") for _ in range(20)))
        assert border.links.contained.faults["the handling of STATUSTEXT"] == 20
        logged = [r for r in caplog.records if "STATUSTEXT" in r.getMessage()]
        assert len(logged) == 1
        assert logged[0].exc_info, "with its traceback"
        assert "system 7, component 1" in logged[0].getMessage()
        border.autopilot._listeners.remove(broken)
        border.links.contained.faults.clear()
        await border.alive()


async def test_a_message_of_ours_that_does_not_fit_the_wire_is_a_counted_refusal(caplog: pytest.LogCaptureFixture) -> None:
    async with bordered() as border:
        for _ in range(3):
            assert not border.links.send(mav.MAVLink_message_interval_message(0, 10**20))
        assert border.links.unfit == {"MESSAGE_INTERVAL.interval_us": 3}
        assert len([r for r in caplog.records if "MESSAGE_INTERVAL.interval_us" in r.getMessage()]) == 1
        border.links.unfit.clear()
        await border.alive()


def test_a_key_in_clear_reaches_no_recording() -> None:
    async def ticked() -> list[str]:
        names: list[str] = []
        async with bordered() as border:
            border.links.tap = lambda at, link, way, data, name: names.append(name)
            await border.throw(Codec(*AUTOPILOT).pack(mav.MAVLink_setup_signing_message(*US, list(range(32)), 1)))
            await border.alive()
        return names

    names = asyncio.run(ticked())
    assert "COMMAND_LONG" in names
    assert "SETUP_SIGNING" not in names
