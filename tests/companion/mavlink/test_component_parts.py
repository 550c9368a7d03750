"""Texts, parameters, commands, the computer's state and the camera's answers, each without I/O."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import companion.settings.load as settings_of
from companion.parts.mavlink.camera_component import COMPONENT, CameraComponent
from companion.parts.mavlink.commands import (
    ACCEPTED,
    CANCELLED,
    DENIED,
    FAILED,
    IN_PROGRESS,
    UNSUPPORTED,
    CommandServer,
    LandingProgress,
    Offered,
)
from companion.parts.mavlink.component import BURST, WAITING, Computer, ComputerReader, MavSeverity, StatusTexts, computer_status
from companion.parts.mavlink.parameters import NAMES, ParameterServer, Tunables
from companion.settings.links import VideoStreamOptions
from companion.settings.load import camera_model, load
from companion.settings.model import Settings
from drivers.mavlink.access import AccessLevel, Source
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from estimator.contracts.errors import BadInput
from estimator.contracts.time import MonoNs
from tests.support.fake_operator import FakeOperator
from tests.support.processes import no_descriptors

S = 1_000_000_000
US, STATION = (7, 191), (255, 190)


def instant(seconds: float) -> MonoNs:
    return MonoNs(round(seconds * S) + 50 * S)


def long(command: int, *params: float, confirmation: int = 0, target: tuple[int, int] = US) -> Message:
    padded = [*params, 0, 0, 0, 0, 0, 0, 0][:7]
    return mav.MAVLink_command_long_message(*target, command, confirmation, *padded)


def server(tower: FakeOperator) -> CommandServer:
    offered = Offered({1: (lambda now: None, 0.0), 2: (lambda now: mav.MAVLink_heartbeat_message(1, 2, 3, 4, 5, 3), 1.0)})
    return CommandServer(tower, offered)


def acks(messages: list[Message]) -> list[tuple[int, int, int]]:
    return [(m.command, m.result, m.progress) for m in messages if m.get_type() == "COMMAND_ACK"]


# Commands


@pytest.mark.parametrize(
    ("command", "params", "result", "done"),
    [
        (193, (0,), ACCEPTED, ["hold"]), (193, (1,), ACCEPTED, ["begin"]), (17, (0, 0, 0, math.nan), ACCEPTED, ["stay"]),
        (191, (), ACCEPTED, ["abort"]), (2510, (), ACCEPTED, ["record True"]), (2511, (), ACCEPTED, ["record False"]),
        (193, (7,), DENIED, []), (193, (math.nan,), DENIED, []), (400, (1,), UNSUPPORTED, []),
        (512, (math.nan,), UNSUPPORTED, []), (512, (1,), FAILED, []), (511, (2, -5), DENIED, []), (510, (-1,), DENIED, []),
    ],
)  # fmt: skip
@pytest.mark.parametrize("kind", ["long", "int"])
def test_a_command_is_done_once_or_refused_and_answered_to_who_gave_it(command, params, result, done, kind):
    tower = FakeOperator()
    message = long(command, *params)
    if kind == "int":
        first = [*params, 0.0, 0.0, 0.0, 0.0][:4]
        message = mav.MAVLink_command_int_message(*US, 0, command, 0, 0, *first, 0, 0, 0.0)
    (ack,) = server(tower).on_message(message, STATION, US, instant(0))
    assert (ack.command, ack.result, ack.target_system, ack.target_component) == (command, result, *STATION)
    assert tower.done == done


@settings(max_examples=100)
@given(st.integers(0, 65535), st.lists(st.floats(width=32), min_size=7, max_size=7))
def test_every_command_is_answered_exactly_once(command: int, params: list[float]) -> None:
    assert len(acks(server(FakeOperator()).on_message(long(command, *params), STATION, US, instant(0)))) == 1


def test_a_repeat_is_answered_and_not_done_again() -> None:
    tower = FakeOperator()
    commands = server(tower)
    commands.on_message(long(193, 1), STATION, US, instant(0))
    assert acks(commands.on_message(long(193, 1, confirmation=1), STATION, US, instant(0.5))) == [(193, ACCEPTED, 0)]
    assert tower.done == ["begin"]
    commands.on_message(long(193, 0, confirmation=1), STATION, US, instant(1.0))
    commands.on_message(long(193, 1), STATION, US, instant(1.5))
    assert tower.done == ["begin", "hold", "begin"], "another parameter, or given anew, is another command"


@pytest.mark.parametrize(("command", "done"), [(193, "hold"), (191, "abort")])
def test_a_stop_is_carried_out_each_time_it_comes(command: int, done: str) -> None:
    tower = FakeOperator()
    commands = server(tower)
    for n in range(3):
        assert acks(commands.on_message(long(command, 0, confirmation=n), STATION, US, instant(0.3 * n))) == [
            (command, ACCEPTED, 0)
        ]
    assert tower.done == [done] * 3


def test_a_sender_that_repeats_without_counting_is_understood() -> None:
    tower = FakeOperator()
    commands = server(tower)
    for n in range(3):
        assert acks(commands.on_message(long(2510), STATION, US, instant(0.3 * n))) == [(2510, ACCEPTED, 0)]
    assert tower.done == ["record True"]
    commands.on_message(long(2510), STATION, US, instant(3.0))
    commands.on_message(long(2510), (254, 190), US, instant(3.1))
    assert tower.done == ["record True"] * 3, "later, or from another, it is a command of its own"
    for n in range(3):
        assert len(commands.on_message(long(512, 2), STATION, US, instant(4 + 0.1 * n))) == 2, (
            "a message is sent as often as asked for"
        )


def test_a_landing_reports_until_it_ends() -> None:
    tower = FakeOperator()
    commands = server(tower)
    tower.state = LandingProgress(0)
    assert acks(commands.on_message(long(21), STATION, US, instant(0))) == [(21, IN_PROGRESS, 0)]
    assert commands.due(instant(0.5)) == []
    tower.state = LandingProgress(40)
    assert acks(commands.due(instant(1.1))) == [(21, IN_PROGRESS, 40)]
    assert acks(commands.on_message(long(21, confirmation=1), STATION, US, instant(1.2))) == [(21, IN_PROGRESS, 40)]
    tower.state = LandingProgress(None)
    assert acks(commands.due(instant(2.2))) == [(21, IN_PROGRESS, 255)]
    tower.state = LandingProgress(100, landed=True)
    assert acks(commands.due(instant(2.3))) == [(21, ACCEPTED, 0)]
    assert commands.due(instant(9)) == []
    assert tower.done == ["begin"]


@pytest.mark.parametrize(
    ("end", "result"), [(LandingProgress(None, landed=False), FAILED), (LandingProgress(None, called_off=True), CANCELLED)]
)
def test_a_landing_that_did_not_come_about(end: LandingProgress, result: int) -> None:
    tower = FakeOperator()
    commands = server(tower)
    commands.on_message(long(21), STATION, US, instant(0))
    tower.state = end
    assert acks(commands.due(instant(1))) == [(21, result, 0)]
    tower.cannot = "no recorder"
    (ack,) = commands.on_message(long(2510), STATION, US, instant(2))
    assert (ack.result, commands.refusal) == (mav.MAV_RESULT_TEMPORARILY_REJECTED, "no recorder")


def test_messages_on_request_and_at_intervals() -> None:
    commands = server(FakeOperator())
    offered = commands._offered
    ack, beat = commands.on_message(long(512, 2), STATION, US, instant(0))
    assert (ack.result, beat.get_type()) == (ACCEPTED, "HEARTBEAT")
    assert sum(len(offered.due(instant(0.1 * n))) for n in range(50)) == 5
    commands.on_message(long(511, 2, 200_000), STATION, US, instant(5))
    _, interval = commands.on_message(long(510, 2), STATION, US, instant(5))
    assert (interval.message_id, interval.interval_us) == (2, 200_000)
    assert sum(len(offered.due(instant(5 + 0.1 * n))) for n in range(50)) == 25
    commands.on_message(long(511, 2, -1), STATION, US, instant(10))
    assert offered.due(instant(11)) == []
    assert offered.interval_us(2) == -1
    commands.on_message(long(511, 2, 0), STATION, US, instant(12))
    assert offered.interval_us(2) == 1_000_000
    assert offered.interval_us(77) == 0


# Parameters


def values(messages: list[Message]) -> list[float]:
    return [m.param_value for m in messages]


def wired(message: Message) -> Message:
    (got,) = Codec(1, 1).feed(Codec(255, 190).pack(message))
    return got


def test_every_tunable_is_a_number_of_the_settings_under_a_name_that_fits() -> None:
    tuned = Tunables(settings_of.load("sim"), lambda s: None)
    params = ParameterServer(tuned)
    for name in NAMES:
        assert len(name) <= 16
        tuned.set(name, tuned.get(name))
        (one,) = params.on_message(wired(mav.MAVLink_param_request_read_message(*US, name.encode(), -1)), US)
        assert one.param_value == pytest.approx(tuned.get(name))
        (same,) = params.on_message(wired(mav.MAVLink_param_request_read_message(*US, b"", one.param_index)), US)
        assert same.param_id == one.param_id
    assert len(set(NAMES.values())) == len(NAMES)
    for unknown, index in ((b"NO_SUCH", -1), (b"", 999)):
        assert params.on_message(wired(mav.MAVLink_param_request_read_message(*US, unknown, index)), US) == []


def test_a_value_in_range_is_put_into_force_and_reported_and_any_other_changes_nothing() -> None:
    applied: list[Settings] = []
    tuned = Tunables(settings_of.load("sim"), applied.append)
    params = ParameterServer(tuned)

    def put(name: bytes, value: float, kind: int = 9, target: tuple[int, int] = US) -> list[Message]:
        return params.on_message(wired(mav.MAVLink_param_set_message(*target, name, value, kind)), US)

    assert values(put(b"PID_H_KP", 0.3)) == pytest.approx([0.3])
    assert applied[-1].guidance.pid.horizontal.kp == 0.3, "not 0.30000001192"
    assert applied[-1].guidance.pid.vertical.kp == tuned.settings.guidance.pid.vertical.kp
    for bad in (99.0, -1.0, math.nan, math.inf):
        assert values(put(b"PID_H_KP", bad)) == pytest.approx([0.3])
        assert params.refused
    assert values(put(b"PID_H_KP", 1.0, kind=6)) == pytest.approx([0.3])
    with pytest.raises(BadInput, match="too short"):
        tuned.set("COMMIT_RATE", 0.12)
    assert put(b"NO_SUCH", 1.0) == []
    assert put(b"PID_H_KP", 1.0, target=(7, 1)) == []
    assert put(b"PID_H_KP", 1.0, target=(7, 0)) == [], "setting is never for everyone"
    assert len(applied) == 1


# Texts


def test_texts_are_few_and_the_severe_ones_go_first() -> None:
    texts = StatusTexts()
    for n in range(WAITING + 2):
        texts.say(MavSeverity.INFO, f"news {n}", instant(0))
    texts.say(MavSeverity.CRITICAL, "gave up", instant(0))
    first = [(m.severity, wired(m).text) for m in texts.due(instant(0))]
    assert first[0] == (2, "gave up")
    assert len(first) == BURST
    assert texts.dropped == 3
    assert texts.due(instant(0.5)) == []
    assert len(texts.due(instant(1.6))) == 1


@pytest.mark.parametrize("length", [1, 49, 50, 51, 100, 101])
def test_long_texts_come_in_chunks_that_join(length: int) -> None:
    texts = StatusTexts()
    text = "".join(chr(ord("a") + n % 26) for n in range(length))
    texts.say(MavSeverity.INFO, text, instant(0))
    chunks = [wired(m) for m in texts.due(instant(0))]
    assert "".join(c.text for c in chunks) == text
    assert [c.chunk_seq for c in chunks] == list(range(len(chunks)))
    assert (chunks[0].id != 0) == (length > 50)
    assert len(chunks[-1].text) < 50 or length == 50


# This host


def host(root: Path, busy: int, idle: int) -> Path:
    for path, text in {
        "proc/stat": f"cpu 0 0 0 0 0\ncpu0 {busy} 0 0 {idle} 0 0\ncpu1 0 0 {busy // 2} {idle} 0 0\nintr 5\n",
        "proc/meminfo": "MemTotal:  2048000 kB\nMemFree: 1 kB\nMemAvailable: 1024000 kB\n",
        "proc/uptime": "345.67 1.0\n",
        "sys/class/thermal/thermal_zone0/temp": "48123\n",
        "sys/class/thermal/thermal_zone1/temp": "51900\n",
    }.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    return root


def test_the_computer_is_read_as_linux_reports(tmp_path: Path) -> None:
    reader = ComputerReader(host(tmp_path, 100, 100))
    assert reader.read().cores_percent == (), "a load needs two readings"
    host(tmp_path, 200, 200)
    assert reader.read() == Computer((50, 33), 1000, 2000, 52, 345.67)
    m = wired(computer_status(Computer((50, 33), 1000, 2000, 52, 345.67), instant(0)))
    assert (m.cpu_cores[:3], m.cpu_combined[0], m.ram_usage, m.ram_total) == ([50, 33, 255], 42, 1000, 2000)
    assert (m.temperature_board, m.uptime) == (52, 345670)


def test_a_host_without_descriptors_or_with_nonsense_is_read_all_the_same(tmp_path: Path) -> None:
    reader = ComputerReader()
    with no_descriptors():
        assert reader.read() == Computer((), None, None, None, None)
    assert reader.read().memory_total_mib is not None
    host(tmp_path, 100, 100)
    for path, nonsense in (
        ("proc/stat", "\ncpu0 1 2 3 4 x\n"),
        ("proc/meminfo", "MemTotal:\n\nMemAvailable: much kB\n"),
        ("proc/uptime", "nan soon\n"),
        ("sys/class/thermal/thermal_zone0/temp", "--5\n"),
        ("sys/class/thermal/thermal_zone1/temp", "\n"),
    ):
        (tmp_path / path).write_text(nonsense)
    assert ComputerReader(tmp_path).read() == Computer((), None, None, None, None)
    (tmp_path / "sys/class/thermal/thermal_zone1/temp").write_text("51900\n")
    assert ComputerReader(tmp_path).read().temperature_c == 52, "one sensor that does not answer costs only itself"
    m = wired(computer_status(Computer((), -5, 1 << 40, None, None), instant(0)))
    assert (m.ram_usage, m.ram_total) == (0, 0xFFFFFFFE)


INFORMATION, STREAM, STATUS = 259, 269, 270


class Station:
    """A ground station next to the component."""

    def __init__(self) -> None:
        self.flows = True
        self.sent: list[Message] = []
        camera = camera_model(load("sim"))
        options = VideoStreamOptions(to="192.168.1.20:5601", rate_hz=12.0, bitrate_kbit_s=800)
        self.camera = CameraComponent(self.send, camera, options, (640, 418), lambda: self.flows)

    def send(self, message: Message, to: int | Source | None = None, *, component: int | None = None) -> bool:
        assert component == COMPONENT
        message.pack(mav.MAVLink(None, 7, COMPONENT))
        self.sent.append(message)
        return True

    def ask(
        self, command: int, *params: float, level: AccessLevel = AccessLevel.PEER, target: tuple[int, int] = (7, 100)
    ) -> list[Any]:
        padded = [*params, 0, 0, 0, 0, 0, 0, 0][:7]
        message = mav.MAVLink_command_long_message(*target, command, 0, *padded)
        self.sent.clear()
        self.camera.on_message(ReceivedMessage(message, 0, MonoNs(S), 255, 190, access_level=level), 7, MonoNs(S))
        return list(self.sent)


@pytest.mark.parametrize(("command", "params"), [(512, (INFORMATION,)), (521, (1,))])
def test_the_camera_is_described(command: int, params: tuple[float, ...]) -> None:
    ack, info = Station().ask(command, *params)
    assert (ack.result, ack.target_system, ack.target_component) == (0, 255, 190)
    assert bytes(info.vendor_name).rstrip(b"\0") == b"Decklander"
    assert (info.resolution_h, info.resolution_v, info.flags) == (640, 360, mav.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM)


@pytest.mark.parametrize(("command", "params"), [(512, (STREAM,)), (2504, (1,))])
def test_the_stream_is_described_by_the_port_that_a_station_listens_on(command: int, params: tuple[float, ...]) -> None:
    station = Station()
    _, info = station.ask(command, *params)
    assert (info.stream_id, info.count, info.type, info.encoding) == (1, 1, mav.VIDEO_STREAM_TYPE_RTPUDP, 1)
    assert info.uri == "5601"
    assert (info.framerate, info.resolution_h, info.resolution_v, info.bitrate) == (12.0, 640, 418, 800_000)
    assert info.hfov == 81
    assert info.flags == mav.VIDEO_STREAM_STATUS_FLAGS_RUNNING
    station.flows = False
    _, status = station.ask(512, STATUS)
    assert status.flags == 0


def test_others_are_not_answered_and_what_is_not_offered_is_unsupported() -> None:
    station = Station()
    assert station.ask(512, INFORMATION, level=AccessLevel.UNKNOWN) == []
    assert station.ask(512, INFORMATION, target=(7, 191)) == []
    assert station.ask(512, INFORMATION, target=(8, 100)) == []
    for command, param in ((512, 12.0), (512, math.nan), (512, math.inf), (512, -1e30), (2500, 0.0), (31010, 0.0)):
        (ack,) = station.ask(command, param)
        assert ack.result == 3, (command, param)


def test_a_heartbeat_a_second_says_whether_pictures_flow() -> None:
    station = Station()
    for k in range(30):
        station.camera.tick(MonoNs(S + k * S // 10))
    beats = [m for m in station.sent if m.get_type() == "HEARTBEAT"]
    assert [(m.type, m.autopilot, m.system_status) for m in beats] == [(30, 8, 4)] * 3
    station.flows = False
    station.camera.tick(MonoNs(6 * S))
    assert station.sent[-1].system_status == 3


def test_the_messages_cross_the_wire() -> None:
    station = Station()
    codec, far = Codec(7, 191), Codec(255, 190)
    for wanted in (INFORMATION, STREAM, STATUS, 260):
        _, message = station.ask(512, wanted)
        (received,) = far.feed(codec.pack(message, COMPONENT))
        assert received.get_type() == message.get_type()
