"""Frames to H.264 as an AR.Drone 2.0 sends it: baseline, one slice a frame, an IDR every half second, no delay."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import av
import numpy as np
from numpy.typing import NDArray

IDR_EVERY = 15
"""Frames from one IDR to the next, as in the captures of the real drone."""

_NAL_IDR, _NAL_SEI, _NAL_SPS, _NAL_PPS = 5, 6, 7, 8


@dataclass(frozen=True, slots=True)
class AccessUnit:
    """One encoded frame in Annex-B."""

    data: bytes
    idr: bool
    sps_size: int
    """Bytes of the sequence parameter set with its start code; 0 where there is none."""
    pps_size: int


class Encoder:
    """libx264, one frame in, one access unit out.

    Width and height may be any even numbers: what lies beyond the frame in its last macroblocks is cropped by the SPS.
    """

    def __init__(self, width: int, height: int, fps: float, max_bitrate_kbps: float, crf: float = 23.0) -> None:
        """Constant quality `crf` (x264's scale, 0 best to 51) as long as a second of it stays within `max_bitrate_kbps`.

        Raises:
            ValueError: odd or absurd dimensions, or a rate that is not positive.
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
        """(width, height) rounded up to whole macroblocks, which is what is in the stream."""
        return -(-self.width // 16) * 16, -(-self.height // 16) * 16

    def encode(self, px: NDArray[np.uint8]) -> AccessUnit:
        """Encode one (height, width, 3) BGR frame.

        Raises:
            ValueError: another shape or type.
        """
        if px.shape != (self.height, self.width, 3) or px.dtype != np.uint8:
            raise ValueError(f"the encoder wants ({self.height}, {self.width}, 3) uint8, got {px.shape} {px.dtype}")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(px), format="bgr24")
        frame.pts = round(self._frames * 1000 / self.fps)
        self._frames += 1
        data = b"".join(bytes(packet) for packet in self._context.encode(frame))
        units = split_annex_b(data)
        # x264 signs its first frame with an SEI of its settings; a drone's encoder does not.
        kept = [(kind, unit) for kind, unit in units if kind != _NAL_SEI]
        return AccessUnit(
            b"".join(unit for _, unit in kept),
            any(kind == _NAL_IDR for kind, _ in kept),
            sum(len(unit) for kind, unit in kept if kind == _NAL_SPS),
            sum(len(unit) for kind, unit in kept if kind == _NAL_PPS),
        )


def split_annex_b(data: bytes) -> list[tuple[int, bytes]]:
    """(type, bytes with the start code) of each NAL unit of an Annex-B stream.

    Source: ITU-T H.264, 7.3.1 (NAL unit) and Annex B. Bytes before the first start code are dropped.
    """
    starts: list[tuple[int, int]] = []
    at = data.find(b"\0\0\1")
    while at >= 0:
        begin = at - 1 if at > 0 and data[at - 1] == 0 else at
        starts.append((begin, at + 3))
        at = data.find(b"\0\0\1", at + 3)
    ends = [begin for begin, _ in starts[1:]] + [len(data)]
    return [(data[payload] & 0x1F, data[begin:end]) for (begin, payload), end in zip(starts, ends, strict=False) if payload < end]
