"""The frames that the drone films and sends: the view of the channel that a client chose, as H.264 in PaVE or as UVLC.

An AR.Drone 2.0 encodes H.264 baseline, one slice a frame, an IDR every half second, no delay. The forward camera sees sky,
horizon and water at sea, and never a pad.
"""

from collections.abc import Mapping
from fractions import Fraction

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.ardrone import pave
from drivers.pyav import require_pyav
from estimator.contracts.geometry import F64, Rotation
from sitl.ardrone import uvlc as uvlc_encoder
from sitl.ardrone.state import P264

IDR_EVERY = 15
"""Number of frames from one IDR to the next, as in captures of the real drone."""

_NAL_IDR, _NAL_SEI, _NAL_SPS, _NAL_PPS = 5, 6, 7, 8
"""Kinds of units of the coded stream. Source: ITU-T H.264, table 7-1."""


class AccessUnit(Struct, frozen=True):
    """One encoded frame as an Annex-B byte stream."""

    data: bytes
    idr: bool
    sps_size: int
    """Length of the sequence parameter set with its start code, bytes; 0 if the frame has none."""
    pps_size: int


class Encoder:
    """The encoder libx264; each frame gives one access unit.

    Width and height may be any even numbers: the SPS crops the part of the last macroblocks that exceeds the frame.
    """

    def __init__(self, width: int, height: int, fps: float, max_bitrate_kbps: float, crf: float = 23.0) -> None:
        """Open the encoder.

        Args:
            width: width of a frame, px.
            height: height of a frame, px.
            fps: frame rate, Hz.
            max_bitrate_kbps: upper limit of the bit rate over one second.
            crf: constant quality below that limit, on x264's scale from 0 (best) to 51.
        """
        self.width, self.height, self.fps, self.max_bitrate_kbps = width, height, fps, max_bitrate_kbps
        self._frames = 0
        require_pyav("the video of a simulated AR.Drone 2.0")
        import av

        context = av.CodecContext.create("libx264", "w")
        assert isinstance(context, av.VideoCodecContext)
        context.width, context.height, context.pix_fmt = width, height, "yuv420p"
        context.time_base = Fraction(1, 1000)
        context.framerate = Fraction(round(fps * 1000), 1000)
        context.thread_count = 1
        context.options = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "profile": "baseline",
            "crf": str(crf),
            "x264-params": f"annexb=1:repeat-headers=1:scenecut=0:keyint={IDR_EVERY}:min-keyint={IDR_EVERY}:sliced-threads=0"
            f":vbv-maxrate={round(max_bitrate_kbps)}:vbv-bufsize={round(max_bitrate_kbps)}",
        }
        self._context = context

    @property
    def coded_size(self) -> tuple[int, int]:
        """Width and height of the stream, px: those of the frame rounded up to whole macroblocks."""
        return -(-self.width // 16) * 16, -(-self.height // 16) * 16

    def encode(self, px: NDArray[np.uint8]) -> AccessUnit:
        """Encode one (height, width, 3) BGR frame."""
        from av import VideoFrame

        frame = VideoFrame.from_ndarray(np.ascontiguousarray(px), format="bgr24")
        frame.pts = round(self._frames * 1000 / self.fps)
        self._frames += 1
        data = b"".join(bytes(packet) for packet in self._context.encode(frame))
        units = split_annex_b(data)
        # x264 adds an SEI with its settings to the first frame; the drone's encoder does not.
        kept = [(kind, unit) for kind, unit in units if kind != _NAL_SEI]
        return AccessUnit(
            b"".join(unit for _, unit in kept),
            any(kind == _NAL_IDR for kind, _ in kept),
            sum(len(unit) for kind, unit in kept if kind == _NAL_SPS),
            sum(len(unit) for kind, unit in kept if kind == _NAL_PPS),
        )


def split_annex_b(data: bytes) -> list[tuple[int, bytes]]:
    """Return (type, bytes with the start code) of each NAL unit of an Annex-B stream.

    Bytes before the first start code are dropped.

    Source: ITU-T H.264, 7.3.1 (NAL unit) and Annex B.
    """
    starts: list[tuple[int, int]] = []
    at = data.find(b"\0\0\1")
    while at >= 0:
        begin = at - 1 if at > 0 and data[at - 1] == 0 else at
        starts.append((begin, at + 3))
        at = data.find(b"\0\0\1", at + 3)
    ends = [begin for begin, _ in starts[1:]] + [len(data)]
    return [(data[payload] & 0x1F, data[begin:end]) for (begin, payload), end in zip(starts, ends, strict=False) if payload < end]


HALF_WIDTH_TAN = 0.81
"""Tangent of half the horizontal field of view of the 92 degree (diagonal) lens."""

_SKY_HIGH, _SKY_LOW = np.array([205.0, 160.0, 110.0]), np.array([235.0, 222.0, 205.0])
_SEA_NEAR, _SEA_FAR = np.array([80.0, 60.0, 30.0]), np.array([130.0, 112.0, 85.0])


_GRAIN = np.random.default_rng(0).normal(0.0, 3.0, (1024, 1024, 1)).astype(np.float32)
_STEP = 331, 197
"""Shift of the grain from one frame to the next, px."""


def front_view(R_ned_body: Rotation, width: int = 640, height: int = 360, number: int = 0) -> NDArray[np.uint8]:
    """(height, width, 3) BGR: the horizon where roll and pitch put it, colours shaded by the angle from it.

    Args:
        number: of the frame. Each has its own noise, which gives its code the length of a real one's.
    """
    scale = 2.0 * HALF_WIDTH_TAN / width
    y = (np.arange(width) - (width - 1) / 2) * scale
    z = (np.arange(height) - (height - 1) / 2) * scale
    down = R_ned_body.matrix[2]
    below: F64 = (down[0] + down[1] * y[None, :] + down[2] * z[:, None]) / np.sqrt(1 + y[None, :] ** 2 + z[:, None] ** 2)
    shade = np.clip(np.abs(below) * 3.0, 0.0, 1.0)[..., None]
    sky = _SKY_LOW + (_SKY_HIGH - _SKY_LOW) * shade
    sea = _SEA_FAR + (_SEA_NEAR - _SEA_FAR) * shade
    top, left = number * _STEP[0] % (1024 - height), number * _STEP[1] % (1024 - width)
    noisy = np.where(below[..., None] > 0.0, sea, sky) + _GRAIN[top : top + height, left : left + width]
    return np.asarray(noisy.clip(0.0, 255.0), dtype=np.uint8)


U8 = NDArray[np.uint8]
FRONT_OF_THE_FIRST = 320, 240
_STREAM_ID = 5
"""Stream id of one of the captured streams of real drones.

With the other one, 1, the header holds bytes that ffmpeg, which clients read the stream with as plain H.264, takes for a start
code.
"""
_BOTTOM_INSET = 88, 72
_FRONT_INSET = 56, 42


class Shot(Struct, frozen=True):
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


class WirePicture(Struct, frozen=True):
    """One picture as it is sent."""

    data: bytes
    payload_bytes: int
    bitrate_kbps: int


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

    There is no encoder of P264 here: a client that requests it gets the headers of its pictures alone.
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
