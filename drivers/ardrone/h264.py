"""Decode single H.264 access units with FFmpeg.

Importing this module loads FFmpeg's libraries, which takes longer than any other part of the start. Nothing needs them before the
first frame, so `VideoDecoder` imports it when a video begins, on its own thread.
"""

import av
from av.error import FFmpegError
from av.video.codeccontext import VideoCodecContext

MAX_PIXELS = 1920 * 1088


class AccessUnitDecoder:
    """Decodes access units in order, beginning with an IDR."""

    def __init__(self) -> None:
        self._codec = VideoCodecContext.create("h264", "r")
        self._codec.thread_type = "NONE"
        self._codec.options = {"err_detect": "explode", "max_pixels": str(MAX_PIXELS)}

    def decode(self, payload: bytes) -> list[av.VideoFrame]:
        """Return the unit's frames; none if the decoder refuses the unit."""
        try:
            return self._codec.decode(av.Packet(payload))
        except FFmpegError:
            return []
