"""Finding out against an autopilot in miniature, and the command itself."""

import asyncio
import functools
import json
import operator
import re
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import companion.settings.load as settings_of
from companion.base.health import Health
from companion.base.http_server import HttpServer
from companion.cli import doctor
from companion.parts.metrics.endpoint import MetricsEndpoint
from companion.settings.links import HttpSettings
from companion.settings.load import Settings
from companion.tools.doctor import gather, rules_values
from companion.tools.doctor.diagnose import PARAMETERS, diagnose
from companion.tools.doctor.firmware_parameters import names_in
from companion.tools.doctor.gather_outside import examine_service
from companion.tools.doctor.snapshot import UNREADABLE, ShipSource, Snapshot, encode
from drivers.clock import SystemClock
from drivers.mavlink.dialect import Event, mav
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.doctor.test_rules import ARDUPILOT, BROKEN, GOOD, defaults, run_doctor
from tests.support.image_files import film
from tests.support.waiting import answering, free_port, listening, until

HOST = "127.0.0.1"


async def examined(fake: MiniatureAutopilot, seconds: float = 1.0, system: int = 0) -> Snapshot:
    async with fake.talking_to(f"udpin://{HOST}:0"):
        await until(lambda: fake.links is not None and fake.links.all[0].local is not None)
        host, port = fake.links.all[0].local or ("", 0)
        options = AutopilotOptions(f"udpout://{host}:{port}", system_id=system, silence_s=1.0, command_period_s=0.01)
        return await gather.examine(options, SystemClock(), seconds)


async def test_a_broken_ardupilot_is_found_out_over_the_wire() -> None:
    good = {r.parameter: r.good for r in rules_values.RULES if r.stack == "ArduPilot"}
    parameters = defaults("ArduPilot", (4, 5, 7))
    parameters |= {n: ARDUPILOT.parameters.get(n, good.get(n, 0.0)) for n in PARAMETERS["ArduPilot"]}
    parameters |= {"PLND_TYPE": 2.0, "EK3_SRC1_POSXY": 6.0, "INS_GYR_CAL": 1.0}
    parameters |= {"SCR_ENABLE": 1.0, "SCR_HEAP_SIZE": 204800.0, "DKL_ENABLE": 1.0}
    fake = MiniatureAutopilot(parameters=parameters)
    talking = asyncio.create_task(examined(fake, 1.5))
    await until(lambda: fake.commands[512] > 0)
    fake.send(mav.MAVLink_autopilot_version_message(0, 0x040507FF, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0))
    fake.text(6, "Plnd: Frame not supported")
    snapshot = await talking
    assert {f.rule for f in diagnose(snapshot)} == {"plnd-type", "ekf-external", "gyro-calibration", "frame-not-supported"}
    a = snapshot.autopilot
    assert a.firmware == (4, 5, 7)
    assert set(a.parameters) == {*names_in(PARAMETERS["ArduPilot"], a.firmware), *defaults("ArduPilot", a.firmware)}
    assert 30 < a.rates_hz["ATTITUDE_QUATERNION"] < 130
    assert snapshot.sync.locked


async def test_a_later_firmware_is_queried_by_its_own_names() -> None:
    fake = MiniatureAutopilot(parameters=dict.fromkeys(names_in(PARAMETERS["ArduPilot"], (4, 7, 0)), 1.0))
    talking = asyncio.create_task(examined(fake, 0.3))
    await until(lambda: fake.commands[512] > 0)
    fake.send(mav.MAVLink_autopilot_version_message(0, 0x040700FF, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0))
    await until(lambda: any(m.param_id == "LAND_SPD_MS" for m in fake.of("PARAM_REQUEST_READ")))
    talking.cancel()
    assert not any(m.param_id == "LAND_SPEED" for m in fake.of("PARAM_REQUEST_READ"))


async def test_only_a_disarmed_vehicle_is_queried_why_it_does_not_arm(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gather, "_VERSION_S", 0.0)
    names = defaults("ArduPilot") | dict.fromkeys(PARAMETERS["ArduPilot"], 0.0)
    fake = MiniatureAutopilot(armed=False, parameters=names)
    talking = asyncio.create_task(examined(fake, 0.5))
    await until(lambda: fake.commands[mav.MAV_CMD_RUN_PREARM_CHECKS] > 0)
    fake.text(2, "PreArm: Compass not healthy")
    assert "it refuses to arm: Compass not healthy" in {f.what for f in diagnose(await talking)}
    armed = MiniatureAutopilot(armed=True, parameters=names)
    await examined(armed, 0.3)
    assert armed.commands[511] > 0, "it was examined"
    assert armed.commands[mav.MAV_CMD_RUN_PREARM_CHECKS] == 0


async def test_a_px4_without_the_module_and_with_an_event() -> None:
    good = {r.parameter: r.good for r in rules_values.RULES if r.stack == "PX4"}
    asked = defaults("PX4") | {n: good.get(n, 1.0) for n in PARAMETERS["PX4"] if n != "PLD_HACC_RAD"}
    parameters = asked | {"EKF2_EV_CTRL": 0, "COM_OBL_RC_ACT": 0, "COM_RC_IN_MODE": 4, "GPS_UBX_MODE": 0}
    fake = MiniatureAutopilot(Stack.PX4, mode="auto.loiter", parameters=parameters)
    talking = asyncio.create_task(examined(fake))
    await until(lambda: fake.commands[512] > 0)
    fake.send(Event(0, 0, 0x1000000 | 0x123456, 5, 1, 0, [0] * 40))
    snapshot = await talking
    assert snapshot.autopilot.events == (0x1123456,)
    assert {f.rule for f in diagnose(snapshot)} == {"px4-precland-missing"}


async def test_the_systems_that_are_received_when_the_wished_one_is_not() -> None:
    snapshot = await examined(MiniatureAutopilot(Stack.PX4, 3, "auto.loiter"), system=5)
    (found,) = diagnose(snapshot)
    assert found.what == "system 5 is silent; found: system 3 (PX4 quadrotor)"
    assert found.fix.startswith("give --system 3, and vehicle.system_id = 3 in the settings")


async def test_an_autopilot_that_does_not_hear_us_is_one_finding_and_not_four(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gather, "_FIRST_ANSWER_S", 1.0)
    deaf = MiniatureAutopilot(deaf=True)
    (found,) = diagnose(await examined(deaf, 0.5))
    assert found.rule == "link-one-way"
    assert found.what.startswith("system 7 sends, but answers nothing")


async def test_nobody_there() -> None:
    snapshot = await gather.examine(AutopilotOptions("serial:///dev/no-such-port:57600"), SystemClock(), 0.3)
    assert [f.rule for f in diagnose(snapshot)] == ["link-down"]


async def test_the_service_s_own_files_broker_and_drone() -> None:
    with socket.socket() as sock:
        sock.bind((HOST, 0))
        closed = sock.getsockname()[1]
    snapshot = await examine_service(settings_of.load("sim"), f"{HOST}:{closed}", SystemClock(), timeout_s=0.5)
    assert snapshot.camera_fault is None
    assert snapshot.broker_fault
    assert snapshot.drone is not None
    async with answering(lambda r, w: w.close()) as port:
        assert (await examine_service(None, f"{HOST}:{port}", SystemClock())).broker_fault is None


def rig_file(video: Path, **more: dict[str, Any]) -> Settings:
    camera = {"file": "sim", "source": "stream", "device": str(video)}
    vehicle = {"kind": "mavlink", "links": f"udpin://{HOST}:0"}
    return settings_of.from_mapping({"vehicle": vehicle, "camera": camera, "pad": {"file": "thesis"}, **more}, "test")


async def test_a_camera_of_another_size_that_is_slow(tmp_path: Path) -> None:
    video = film(tmp_path / "slow.mp4", 60 * [np.full((180, 320, 3), 99, np.uint8)], "mpeg4", 8)
    service = await examine_service(rig_file(video), None, SystemClock(), seconds=1.0)
    assert service.frame_size == (320, 180)
    assert service.frame_rate_hz == pytest.approx(8.0, abs=2.0)
    assert {f.rule for f in diagnose(Snapshot(0.0, service=service))} >= {"camera-size", "camera-slow"}
    gone = await examine_service(rig_file(tmp_path / "none.mp4"), None, SystemClock(), seconds=0.1)
    assert "none.mp4" in str(gone.device_fault)
    assert str(gone.files_fault).endswith("none.mp4: No such file or directory")


async def test_a_service_that_runs_is_queried() -> None:
    health = Health(SystemClock())
    for _ in range(5):
        health.beat("Frame")
        health.delay("exposure_to_belief", 0.08)
    health.counters("mavlink", lambda: {"targets_sent": 0.0, "sends_ranges": 1.0, "withheld_not_seen": 12.0})
    health.counters("sentences", lambda: {"taken_HDT": 3.0, "refused_checksum": 7.0, "refused_other_sentence": 90.0})
    health.counters(
        "bus", lambda: {"used 127257 of 27": 40.0, "rate_hz 127257 of 27": 10.0, "unused 127257 of 27 impossible": 2.0}
    )
    health.counters("mqtt", lambda: {"ship_reports_other_run": 2.0, "ship_reports_taken": 1.0, "commands_expired": 5.0})
    health.counters("ship_place", lambda: {"taken": 0.0, "vessel_stale": 1.0})
    server = HttpServer(HttpSettings("http", HOST, 0, page=False), health)
    MetricsEndpoint(server, health)
    async with listening(server) as port:
        http = {"endpoint": "http", "host": HOST, "port": port, "page": False}
        flies_there = {"rendezvous": {"enabled": True}}
        rig = rig_file(Path("no camera is opened"), http=http, guidance=flies_there, vessel={"nmea": "127.0.0.1:10110"})
        service = await examine_service(rig, None, SystemClock())
        stays = await examine_service(rig_file(Path("no camera is opened"), http=http), None, SystemClock())
    assert service.camera_fault is None
    assert stays.places_taken is None, "nobody flies to her place"
    assert service.exposure_to_belief_s == 0.08
    assert service.frame_rate_hz
    assert (service.targets_sent, service.sends_ranges, service.withheld) == (0, True, {"not seen": 12})
    assert (service.places_taken, service.places_refused) == (0, {"checksum": 7, "other run": 2, "vessel stale": 1})
    assert service.ship_sources == (
        ShipSource("127257 of 27", 40, 10.0, {"impossible": 2}), ShipSource(UNREADABLE, 0, 0.0, {"checksum": 7}),
    )  # fmt: skip


async def test_a_ship_that_sends_is_listened_to_and_what_is_not_used_has_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    def line(body: str) -> bytes:
        return f"${body}*{functools.reduce(operator.xor, body.encode()):02X}\r\n".encode()

    port = free_port()
    settings = rig_file(Path("no camera"), vessel={"nmea": f"{HOST}:{port}"})
    silent = await examine_service(settings, None, SystemClock(), seconds=0.1)
    assert "nothing of the ship arrives" in str(silent.ship_fault)

    async def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ship:
            while True:
                for body in ("HEHDT,90.0,T", "GPHDT,91.0,T", "TIROT,,V", "GPGSV,1"):
                    ship.sendto(line(body), (HOST, port))
                ship.sendto(b"$HEHDT,90.0,T*00", (HOST, port))
                await asyncio.sleep(0.05)

    sending = asyncio.create_task(send())
    service = await examine_service(settings, None, SystemClock(), seconds=0.4)
    sending.cancel()
    assert service.ship_fault is None
    found = {one.name: one for one in service.ship_sources}
    assert set(found) == {"HEHDT", "GPHDT", "TIROT", "GPGSV", UNREADABLE}
    assert found["HEHDT"].used > 5
    assert found["HEHDT"].rate_hz == pytest.approx(20.0, rel=0.5)
    assert [set(found[name].unused) for name in ("GPHDT", "TIROT", UNREADABLE)] == [
        {"other_receiver"},
        {"not_valid"},
        {"checksum"},
    ]
    snapshot = Snapshot(0.0, service=service)
    (finding,) = [f for f in diagnose(snapshot) if f.rule.startswith("ship-s")]
    assert (finding.rule, "TIROT" in finding.what, "GPHDT" in finding.what) == ("ship-sentences", True, False)
    page = doctor._page(snapshot, diagnose(snapshot))
    assert re.search(r"HEHDT +\d+\.\d Hz +\d+ used\n", page)
    assert re.search(r"GPHDT +\d+\.\d Hz +\d+ not used: another of her receivers is used\n", page)


def test_the_command_on_a_saved_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "frame.json"
    path.write_bytes(encode(BROKEN["set but not rebooted"][1]))
    code, out = run_doctor(capsys, "--snapshot", str(path))
    assert code == 1
    assert "error: PLND_ENABLED and PLND_TYPE are set" in out
    assert "fix: reboot the autopilot" in out
    assert "ArduPilot 4.5.7, system 1" in out
    code, out = run_doctor(capsys, "--snapshot", str(path), "--json")
    assert json.loads(out)["rule"] == "plnd-not-rebooted"
    path.write_bytes(encode(GOOD))
    code, out = run_doctor(capsys, "--snapshot", str(path), "--save", str(tmp_path / "again.json"))
    assert code == 0
    assert "none of" in out
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()
    path.write_bytes(encode(BROKEN["gyros calibrated at sea"][1]))
    assert run_doctor(capsys, "--snapshot", str(path), "--still-pad")[0] == 0
