"""The component beside an autopilot, over real sockets."""

import asyncio
import math
import time
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.mavlink.dialect import ComponentInformationBasic, mav
from drivers.mavlink.vehicle import Stack
from estimator.contracts.estimates import IntegrityAlert, Verdict
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.mavlink.receivers import ArduPilotReceiver, Px4Receiver
from tests.companion.mavlink.stage import PAD_NED, staged
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
            assert reported is not None
            assert reported[0] == "absolute"
            # It flies at 0.9 m/s: the place on the ground stands still only if both parts are of one instant
            assert reported[1] == pytest.approx(PAD_NED, abs=0.03)
        stamps = [m.time_usec for m in fake.of("LANDING_TARGET")]
        assert stamps == sorted(set(stamps)), "never the same instant twice"
        assert len(fake.of("TARGET_RELATIVE")) > 5
        assert receiver.events == []


async def test_rates_are_what_was_requested() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake, outputs={"rate_hz": 20.0}):
        await until(lambda: len(fake.of("LANDING_TARGET")) > 2)
        before, began = len(fake.of("LANDING_TARGET")), time.monotonic()
        await until(lambda: len(fake.of("LANDING_TARGET")) >= before + 15)
        # A busy machine may be late, never early: what was late itself may make the first few seem so.
        assert len(fake.of("LANDING_TARGET")) - before <= 20.0 * (time.monotonic() - began) + 8


async def test_a_pad_out_of_sight_and_a_vehicle_on_the_ground_are_not_reported() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake) as stage:
        await until(lambda: len(fake.of("LANDING_TARGET")) > 5)
        stage.seen = False
        await until(lambda: stage.component.outputs.withheld["not seen"] > 3)
        await asyncio.sleep(0.1)
        silent = len(fake.of("LANDING_TARGET"))
        await asyncio.sleep(0.3)
        assert len(fake.of("LANDING_TARGET")) == silent
        assert stage.component.outputs.withheld["not seen"] > 3
        stage.seen = True
        await until(lambda: len(fake.of("LANDING_TARGET")) > silent)
        fake.landed_state = 3
        await until(lambda: stage.component.outputs.withheld["taking off"] > 3)
        fake.landed_state = 2
        climbed = len(fake.of("LANDING_TARGET"))
        await until(lambda: len(fake.of("LANDING_TARGET")) > climbed)
        fake.landed_state, fake.armed = 1, False
        await until(lambda: stage.component.outputs.withheld["on ground"] > 3)
        silent = len(fake.of("LANDING_TARGET"))
        await asyncio.sleep(0.3)
        assert len(fake.of("LANDING_TARGET")) == silent


async def test_an_autopilot_does_not_get_an_inconsistent_pad() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake) as stage:
        await until(lambda: len(fake.of("LANDING_TARGET")) > 5)
        stage.alerts = (IntegrityAlert.ELSEWHERE,)
        await until(lambda: stage.component.outputs.withheld["not seen"] > 3)
        await asyncio.sleep(0.1)
        silent = len(fake.of("LANDING_TARGET"))
        await asyncio.sleep(0.3)
        assert len(fake.of("LANDING_TARGET")) == silent


async def test_a_sensor_that_is_flown_without_is_reported_once() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake) as stage:
        await until(lambda: len(fake.of("LANDING_TARGET")) > 5)
        stage.lost = ("the gyro repeats its readings",)
        await until(lambda: any("the gyro repeats" in text.text for text in fake.of("STATUSTEXT")))
        await asyncio.sleep(0.3)
        assert sum("the gyro repeats" in text.text for text in fake.of("STATUSTEXT")) == 1


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
        assert stage.autopilot.parameters is not None
        stage.autopilot.parameters.request(["RNGFND1_TYPE"])
        await until(lambda: stage.ranges > before + 3)


async def test_no_distances_where_there_is_a_lidar() -> None:
    fake = MiniatureAutopilot(parameters={"RNGFND1_TYPE": 20.0, "PLND_LAG": 0.02})
    async with staged(fake) as stage:
        await until(lambda: bool(stage.autopilot.parameters and "RNGFND1_TYPE" in stage.autopilot.parameters.values))
        await asyncio.sleep(0.3)
        assert fake.of("DISTANCE_SENSOR") == []


async def test_the_heartbeat_stops_with_the_service() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake, heartbeat_s=0.05, guidance_silence_s=0.2) as stage:
        await until(lambda: len(fake.of("HEARTBEAT")) > 5)
        beat = fake.of("HEARTBEAT")[-1]
        assert (beat.get_srcSystem(), beat.get_srcComponent(), beat.type, beat.autopilot) == (7, 191, 18, 8)
        for fault in ("sick", "hung"):
            if fault == "sick":
                stage.sick = "vision is down"
            else:
                stage.sick, stage.deciding = None, False
                await asyncio.sleep(0.3)
            await asyncio.sleep(0.1)
            silent = len(fake.of("HEARTBEAT"))
            await asyncio.sleep(0.3)
            assert len(fake.of("HEARTBEAT")) == silent, fault
        stage.deciding = True
        await until(lambda: len(fake.of("HEARTBEAT")) > silent)
        texts = [m.text for m in fake.of("STATUSTEXT")]
        assert "Decklander: vision is down" in texts
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
        assert values["dl_height"] == pytest.approx(5.0, abs=0.01)
        assert values["dl_lateral"] == pytest.approx(1.7, abs=0.01)
        assert values["dl_sigma"] == pytest.approx(0.01, abs=1e-3)


async def test_commands_from_the_wire() -> None:
    fake = MiniatureAutopilot()
    async with staged(fake) as stage:
        fake.send(mav.MAVLink_command_long_message(7, 191, 193, 0, 0, 0, 0, 0, 0, 0, 0))
        fake.send(mav.MAVLink_command_long_message(7, 191, 512, 0, ComponentInformationBasic.id, 0, 0, 0, 0, 0, 0))
        await until(lambda: bool(fake.of("COMPONENT_INFORMATION_BASIC")))
        assert stage.tower.handlers == ["pause"]
        assert {(m.command, m.result) for m in fake.of("COMMAND_ACK")} == {(193, 0), (512, 0)}
        assert fake.of("COMPONENT_INFORMATION_BASIC")[0].vendor_name == "Decklander"
        stage.tower.refusal = "no recorder is set up"
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
