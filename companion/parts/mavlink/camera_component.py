"""The camera as a MAVLink component: answers that a ground station needs before it shows the picture (camera protocol v2).

    camera = CameraComponent(links.send, model, options, flows)    # `on_message` takes what the links receive, `tick` the time

It sends as component 100 of the vehicle's system. The picture itself goes by RTP (`companion.parts.video`), never over MAVLink.

Source: mavlink.io, "Camera Protocol v2"; VIDEO_STREAM_INFORMATION.uri is the port for RTP over UDP.
"""

from __future__ import annotations

import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Protocol, TypeAlias

from companion.base.version import version
from companion.cycle.ports import Assembly
from companion.parts.mavlink.commands import ACCEPTED, UNSUPPORTED, Offered
from companion.settings.links import VideoStreamOptions
from drivers.mavlink.access import AccessLevel, Source
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import Message, mav, ms_since_boot
from drivers.mavlink.links import ReceivedMessage
from drivers.reconnect import running_beside
from estimator.contracts.time import Clock, MonoNs
from estimator.vision.camera.camera import Camera

COMPONENT = int(mav.MAV_COMP_ID_CAMERA)
_NAME = "Decklander"
_STREAM = 1  # number of the one stream
_TICK_S = 0.1  # interval at which messages that are due are sent
_H264 = 1
"""VIDEO_STREAM_ENCODING_H264."""
_BY_NAME = {
    int(mav.MAV_CMD_REQUEST_CAMERA_INFORMATION): int(mav.MAVLINK_MSG_ID_CAMERA_INFORMATION),
    int(mav.MAV_CMD_REQUEST_VIDEO_STREAM_INFORMATION): int(mav.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION),
    int(mav.MAV_CMD_REQUEST_VIDEO_STREAM_STATUS): int(mav.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS),
}
"""Requests from before REQUEST_MESSAGE, which ground stations still send."""


ShowCamera: TypeAlias = "Callable[[Send], CameraComponent]"
"""Makes the component on links that have just been opened."""


class Send(Protocol):
    """The signature of `Links.send`."""

    def __call__(self, message: Message, to: int | Source | None = None, *, component: int | None = None) -> bool: ...


class CameraComponent:
    """The component; see the module's docstring.

    Every receiver of telemetry may send requests. Nothing can be commanded: the stream flows as long as the settings name where
    to.

    Args:
        size: (width, height) of the streamed picture, px.
        flows: returns whether pictures are being sent.
    """

    def __init__(
        self, send: Send, camera: Camera, options: VideoStreamOptions, size: tuple[int, int], flows: Callable[[], bool]
    ) -> None:
        self._send = send
        self._camera = camera
        self._o = options
        self._size = size
        self._flows = flows
        self._offered = Offered(
            {
                mav.MAVLINK_MSG_ID_HEARTBEAT: (self._heartbeat, 1.0),
                mav.MAVLINK_MSG_ID_CAMERA_INFORMATION: (self._information, 0.0),
                mav.MAVLINK_MSG_ID_CAMERA_SETTINGS: (self._settings, 0.0),
                mav.MAVLINK_MSG_ID_VIDEO_STREAM_INFORMATION: (self._stream_information, 0.0),
                mav.MAVLINK_MSG_ID_VIDEO_STREAM_STATUS: (self._stream_status, 0.0),
            }
        )

    def tick(self, now: MonoNs) -> None:
        """Send the messages that are due."""
        for message in self._offered.due(now):
            self._send(message, component=COMPONENT)

    def on_message(self, received: ReceivedMessage, system: int, now: MonoNs) -> None:
        """Answer a request to component 100 of our system; ignore every other message."""
        m, kind = received.message, received.message.get_type()
        if received.access_level < AccessLevel.PEER or kind not in ("COMMAND_LONG", "COMMAND_INT"):
            return
        if (m.target_system, m.target_component) != (system, COMPONENT):
            return
        answer = None
        if m.command in _BY_NAME:
            answer = self._offered.make(_BY_NAME[m.command], now)
        elif m.command == mav.MAV_CMD_REQUEST_MESSAGE and math.isfinite(m.param1):
            answer = self._offered.make(int(m.param1), now)
        result = UNSUPPORTED if answer is None else ACCEPTED
        ack = mav.MAVLink_command_ack_message(m.command, result, 0, 0, received.system, received.component)
        for message in (ack, answer):
            if message is not None:
                self._send(message, received.source, component=COMPONENT)

    def _heartbeat(self, now: MonoNs) -> Message:
        state = mav.MAV_STATE_ACTIVE if self._flows() else mav.MAV_STATE_STANDBY
        return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_CAMERA, mav.MAV_AUTOPILOT_INVALID, 0, 0, int(state), 3)

    def _information(self, now: MonoNs) -> Message:
        c = self._camera
        return mav.MAVLink_camera_information_message(
            ms_since_boot(now), _bytes(_NAME), _bytes("downward camera"), _version(), math.nan, math.nan, math.nan, c.width,
            c.height, 0, int(mav.CAMERA_CAP_FLAGS_HAS_VIDEO_STREAM), 0, b"",
        )  # fmt: skip

    def _settings(self, now: MonoNs) -> Message:
        return mav.MAVLink_camera_settings_message(ms_since_boot(now), int(mav.CAMERA_MODE_VIDEO))

    def _stream_information(self, now: MonoNs) -> Message:
        width, height = self._size
        return mav.MAVLink_video_stream_information_message(
            _STREAM, 1, int(mav.VIDEO_STREAM_TYPE_RTPUDP), self._flags(), self._o.rate_hz, width, height,
            self._o.bitrate_kbit_s * 1000, 0, self._field_deg(), _NAME.encode(), str(self._o.port).encode(), _H264,
        )  # fmt: skip

    def _stream_status(self, now: MonoNs) -> Message:
        width, height = self._size
        return mav.MAVLink_video_stream_status_message(
            _STREAM, self._flags(), self._o.rate_hz, width, height, self._o.bitrate_kbit_s * 1000, 0, self._field_deg()
        )

    def _flags(self) -> int:
        return int(mav.VIDEO_STREAM_STATUS_FLAGS_RUNNING) if self._flows() else 0

    def _field_deg(self) -> int:
        return round(2.0 * math.degrees(math.atan(0.5 * self._camera.width / self._camera.fx)))


def _bytes(name: str) -> list[int]:
    return list(name.encode()[:32].ljust(32, b"\0"))


def _version() -> int:
    """Return the program's version as the message packs it: patch, minor and major from the third byte down."""
    try:
        major, minor, patch = (int(part) for part in version().split(".")[:3])
    except ValueError:
        return 0
    return (patch & 0xFF) << 16 | (minor & 0xFF) << 8 | (major & 0xFF)


@asynccontextmanager
async def showing(show: ShowCamera | None, autopilot: Autopilot, clock: Clock) -> AsyncIterator[None]:
    """Run the camera's component on the links of an autopilot; without one do nothing."""
    if show is None:
        yield
        return
    links = autopilot.links
    camera = show(links.send)

    async def tick() -> None:
        while True:
            links.contained.run("the camera's tick", "us", partial(camera.tick, clock.now()))
            await clock.sleep(_TICK_S)

    autopilot.add_listener(lambda received: camera.on_message(received, links.identity[0], clock.now()))
    async with running_beside([("mavlink-camera", tick())]):
        yield


def shown_camera(service: Assembly) -> ShowCamera | None:
    """Return what makes the component of a picture that is streamed; None if none is."""
    if (video := service.video) is None:
        return None
    camera, options = service.pilot.camera, service.settings.video_stream
    return lambda send: CameraComponent(send, camera, options, video.size, lambda: video.flows)
