"""The camera as a ground station sees it: who is answered, and that the answers are those of the camera and the settings."""

import math
from typing import Any

import pytest

from companion.parts.mavlink.camera_component import COMPONENT, CameraComponent
from companion.settings.links import VideoStreamOptions
from companion.settings.load import camera_model, load
from drivers.mavlink.access import AccessLevel, Source
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from estimator.contracts.time import MonoNs

S = 1_000_000_000
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
