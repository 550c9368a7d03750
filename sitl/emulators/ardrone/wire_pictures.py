"""What the drone films and sends: the view of the channel that a client chose, as H.264 in PaVE or as UVLC."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.ardrone import pave
from estimator.contracts.geometry import Rotation
from sitl.ardrone import uvlc_encoder
from sitl.ardrone.generations import P264
from sitl.emulators.ardrone.front_view import front_view
from sitl.emulators.ardrone.video import Encoder

U8 = NDArray[np.uint8]
FRONT_OF_THE_FIRST = 320, 240
_STREAM_ID = 5
"""As in one of the captured streams of real drones. With the other one seen, 1, the header holds bytes that ffmpeg, which clients
read the stream with as plain H.264, takes for a start code."""
_BOTTOM_INSET = 88, 72
_FRONT_INSET = 56, 42


@dataclass(frozen=True, slots=True)
class Shot:
    """One picture to be sent."""

    px: U8
    """The view of the bottom camera, (H, W, 3) BGR."""
    R_ned_body: Rotation
    """The attitude, for the front camera."""
    number: int
    timestamp_ms: int
    """The time of the drone's clock at mid-exposure."""
    fps: float
    keys: Mapping[str, str]
    """The values of the keys that the generation of the drone films by (`Generation.film_keys`)."""


@dataclass(frozen=True, slots=True)
class WirePicture:
    """One picture as it is sent."""

    data: bytes
    payload_bytes: int
    bitrate_kbps: int


class WirePictures(Protocol):
    """Makes wire pictures of shots, in order."""

    def make(self, shot: Shot) -> WirePicture:
        """Return the picture of a shot; it is called from one thread."""
        ...


class PavePictures:
    """The 2.0's: H.264 behind PaVE headers. It has no insets: channels 0 and 2 are the front camera, 1 and 3 the bottom."""

    def __init__(self, header_size: int, crf: float) -> None:
        self._header_size = header_size
        self._crf = crf
        self._encoder: Encoder | None = None
        self._position = 0

    def make(self, shot: Shot) -> WirePicture:
        """Encode the chosen view."""
        height, width = shot.px.shape[:2]
        px = shot.px if shot.keys["video:video_channel"] in "13" else front_view(shot.R_ned_body, width, height, shot.number)
        wanted = (width, height, shot.fps, float(shot.keys["video:max_bitrate"]))
        encoder = self._encoder
        if encoder is None or (encoder.width, encoder.height, encoder.fps, encoder.max_bitrate_kbps) != wanted:
            encoder = self._encoder = Encoder(*wanted, crf=self._crf)
        unit = encoder.encode(px)
        encoded_width, encoded_height = encoder.coded_size
        header = pave.PaveHeader(
            payload_size=len(unit.data),
            frame_number=shot.number % 2**32,
            timestamp_ms=shot.timestamp_ms,
            frame_type=pave.FrameType.IDR if unit.idr else pave.FrameType.P,
            version=3 if self._header_size > 68 else 2,
            header_size=self._header_size,
            encoded_width=encoded_width,
            encoded_height=encoded_height,
            display_width=width,
            display_height=height,
            stream_position=self._position,
            stream_id=_STREAM_ID,
            sps_size=unit.sps_size,
            pps_size=unit.pps_size,
        )
        self._position += len(unit.data) - unit.sps_size - unit.pps_size
        return WirePicture(header.pack() + unit.data, len(unit.data), round(encoder.max_bitrate_kbps))


class UvlcPictures:
    """The 1.0's: UVLC pictures of 176x144 px of the bottom camera or 320x240 of the front one, with the other one inset or not.

    There is no encoder of P264 here: a client that asks for it gets the headers of its pictures alone.
    """

    def make(self, shot: Shot) -> WirePicture:
        """Encode the chosen view."""
        if shot.keys["video:video_codec"] == P264:
            data = _P264_HEADER + bytes(8)
        else:
            data = uvlc_encoder.encode(_view_of_the_first(shot), shot.number)
        return WirePicture(data, len(data), round(8e-3 * len(data) * shot.fps))


_P264_HEADER = (0b0000000000000000100000_10_010_001_11).to_bytes(4, "little")
"""The first word of a picture that builds on the one before it: start code, 320x240 px, INTER."""


def _view_of_the_first(shot: Shot) -> U8:
    channel = shot.keys["video:video_channel"]
    if channel == "1":
        return shot.px
    front = front_view(shot.R_ned_body, *FRONT_OF_THE_FIRST, shot.number)
    if channel == "0":
        return front
    into, other, size = (front, shot.px, _BOTTOM_INSET) if channel == "2" else (shot.px.copy(), front, _FRONT_INSET)
    into[: size[1], : size[0]] = cv2.resize(other, size, interpolation=cv2.INTER_AREA)
    return into
