"""An H.264 link that loses packets: frames as a drone's video stream delivers them.

Each packet of the link holds one slice of a picture. A lost slice is concealed by the decoder from the picture before, and what
moves there smears until the next picture that needs no other; where all slices are lost the picture stands still.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import av
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput

U8 = NDArray[np.uint8]

_PACKET_BYTES = 1400
_FPS = 30
_SLICES = (1, 5)
"""NAL unit types of coded slices (ITU-T H.264, table 7-1)."""


@dataclass(frozen=True, slots=True)
class VideoLinkOptions:
    """The encoder's rate and the packets that the link loses, in bursts (Gilbert, Bell System Technical Journal 39, 1960)."""

    bitrate_kbit_s: float = 1000.0
    loss: float = 0.0
    burst_packets: float = 4.0
    keyframe_s: float = 1.0

    def __post_init__(self) -> None:
        if not (self.bitrate_kbit_s > 0 and 0.0 <= self.loss < 1.0 and self.burst_packets >= 1.0 and self.keyframe_s > 0):
            raise BadInput("video: bitrate_kbit_s and keyframe_s positive, loss 0 to below 1, burst_packets 1 or more")


class VideoLink:
    """Sends the frames of one camera, in order. The same frames and seed give the same pictures."""

    def __init__(self, options: VideoLinkOptions, width: int, height: int, seed: int) -> None:
        self._options = options
        self._rng = np.random.default_rng([seed, 0x264])
        self._lost = False
        self._shown: U8 = np.full((height, width, 3), 16, np.uint8)
        encoder = av.CodecContext.create("libx264", "w")
        decoder = av.CodecContext.create("h264", "r")
        assert isinstance(encoder, av.VideoCodecContext)
        assert isinstance(decoder, av.VideoCodecContext)
        encoder.width, encoder.height, encoder.pix_fmt = width, height, "yuv420p"
        encoder.time_base, encoder.framerate = Fraction(1, _FPS), Fraction(_FPS)
        encoder.bit_rate = round(1000 * options.bitrate_kbit_s)
        encoder.thread_count = decoder.thread_count = 1
        every, rate = max(1, round(options.keyframe_s * _FPS)), round(options.bitrate_kbit_s)
        encoder.options = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "profile": "baseline",
            "x264-params": f"annexb=1:repeat-headers=1:scenecut=0:keyint={every}:min-keyint={every}:sliced-threads=0"
            f":slice-max-size={_PACKET_BYTES}:vbv-maxrate={rate}:vbv-bufsize={max(1, rate // 5)}",
        }
        decoder.flags |= av.codec.context.Flags.output_corrupt | av.codec.context.Flags.low_delay
        self._encoder, self._decoder = encoder, decoder
        self._sent = 0

    def send(self, px: U8) -> U8:
        """Return the picture that the receiver shows after this frame (H, W, 3) BGR was sent: the last one if nothing arrived."""
        frame = av.VideoFrame.from_ndarray(px, format="bgr24")
        frame.pts = self._sent
        self._sent += 1
        coded = b"".join(bytes(packet) for packet in self._encoder.encode(frame))
        arrived = b"".join(unit for unit in _units(coded) if unit[4] & 31 not in _SLICES or not self._next_is_lost())
        if any(unit[4] & 31 in _SLICES for unit in _units(arrived)):
            try:
                shown = self._decoder.decode(av.Packet(arrived))
            except av.error.InvalidDataError:
                shown = []
            if shown:
                self._shown = np.asarray(shown[-1].to_ndarray(format="bgr24"), dtype=np.uint8)
        return self._shown.copy()

    def _next_is_lost(self) -> bool:
        """Return whether the link loses its next packet."""
        o = self._options
        if o.loss == 0:
            return False
        leave, enter = 1.0 / o.burst_packets, min(1.0, o.loss / (o.burst_packets * (1.0 - o.loss)))
        chance = float(self._rng.random())
        self._lost = chance >= leave if self._lost else chance < enter
        return self._lost


def _units(stream: bytes) -> list[bytes]:
    """Return the NAL units of an Annex B byte stream, each with a start code of four bytes."""
    parts = stream.replace(b"\x00\x00\x00\x01", b"\x00\x00\x01").split(b"\x00\x00\x01")
    return [b"\x00\x00\x00\x01" + part for part in parts if part]
