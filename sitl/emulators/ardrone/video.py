"""Encode frames to H.264 as an AR.Drone 2.0 does: baseline, one slice a frame, an IDR every half second, no delay."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import av
import numpy as np
from numpy.typing import NDArray

IDR_EVERY = 15
"""Number of frames from one IDR to the next, as in captures of the real drone."""

_NAL_IDR, _NAL_SEI, _NAL_SPS, _NAL_PPS = 5, 6, 7, 8


@dataclass(frozen=True, slots=True)
class AccessUnit:
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

        Raises:
            ValueError: a dimension is odd or absurd, or a rate is not positive.
        """
        if width <= 0 or height <= 0 or width % 2 or height % 2 or not fps > 0 or not max_bitrate_kbps > 0:
            raise ValueError(f"cannot encode {width}x{height} at {fps} frames/s and {max_bitrate_kbps} kbit/s")
        self.width, self.height, self.fps, self.max_bitrate_kbps = width, height, fps, max_bitrate_kbps
        self._frames = 0
        context = av.CodecContext.create("libx264", "w")
        if not isinstance(context, av.VideoCodecContext):
            raise TypeError("libx264 is not a video encoder in this PyAV")
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
        """Encode one (height, width, 3) BGR frame.

        Raises:
            ValueError: the frame has another shape or type.
        """
        if px.shape != (self.height, self.width, 3) or px.dtype != np.uint8:
            raise ValueError(f"the encoder wants ({self.height}, {self.width}, 3) uint8, got {px.shape} {px.dtype}")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(px), format="bgr24")
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
