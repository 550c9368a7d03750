"""Send pictures as H.264 by RTP over UDP (RFC 6184), as ground stations expect it.

Parameter sets go with every key frame, one a second, so that a station that begins to listen sees a picture within a second.
"""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction

import av
import numpy as np
from av.error import FFmpegError
from numpy.typing import NDArray

from companion.recording.timed_frames import CLOCK_HZ, TimedFrames, prepare
from companion.settings.video import VideoStreamOptions
from estimator.contracts.errors import Recoverable
from estimator.contracts.time import MonoNs

_PACKET_BYTES = 1200
"""Below the MTU of tunnels and radios, so that no packet is torn."""


class RtpStream:
    """One stream of pictures of one size; for one thread.

    Args:
        size: (width, height) px, even numbers.

    Raises:
        Recoverable: the address cannot be resolved or reached.
    """

    def __init__(self, options: VideoStreamOptions, size: tuple[int, int]) -> None:
        self.size = size
        self._to = options.to
        self._frames = TimedFrames(size)
        rate = Fraction(options.rate_hz).limit_denominator(1001)
        key_frames = max(1, round(options.rate_hz))
        kbit = options.bitrate_kbit_s
        self._container = av.open(f"rtp://{options.to}?pkt_size={_PACKET_BYTES}", "w", format="rtp")
        stream = self._container.add_stream("libx264", rate=rate)
        prepare(stream.codec_context, size)
        stream.codec_context.time_base = Fraction(1, CLOCK_HZ)
        stream.codec_context.thread_count = 1
        stream.codec_context.options = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "profile": "baseline",
            "x264-params": f"repeat-headers=1:scenecut=0:keyint={key_frames}:min-keyint={key_frames}:sliced-threads=0"
            f":bitrate={kbit}:vbv-maxrate={kbit}:vbv-bufsize={kbit}",
        }
        self._stream = stream
        try:
            self._container.start_encoding()
        except (OSError, FFmpegError) as why:
            raise Recoverable(f"video_stream.to: {options.to}: {why}") from why

    def send(self, image: NDArray[np.uint8], at: MonoNs) -> bool:
        """Send an (H, W, 3) BGR picture of the instant `at`; return False for one that is not later than the last.

        Raises:
            ValueError: a picture of another size.
            Recoverable: the network refuses it.
        """
        frame = self._frames.frame(image, at)
        if frame is None:
            return False
        try:
            self._container.mux(self._stream.encode(frame))
        except (OSError, FFmpegError) as why:
            raise Recoverable(f"video_stream.to: {self._to}: {why}") from why
        return True

    def close(self) -> None:
        """Close the socket; what the network does not take any more is lost."""
        with suppress(OSError, FFmpegError):
            self._container.close()
