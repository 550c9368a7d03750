"""PyAV, FFmpeg's libraries for H.264, video files and streams, which are installed with the extra `video`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.extras import is_installed, require

if TYPE_CHECKING:
    from av import VideoFrame


def has_pyav() -> bool:
    """Return whether PyAV is installed."""
    return is_installed("av")


def require_pyav(wanted: str) -> None:
    """Refuse what is wanted where PyAV is not installed.

    Raises:
        BadInput: it is not; the message says how to install it.
    """
    require(wanted, "video", "av")


class AccessUnitDecoder:
    """Decodes single access units of H.264 in order, beginning with an IDR.

    The first one of a process loads FFmpeg's libraries, which takes longer than any other part of the start.

    Args:
        wanted: what needs it, for the error.
        pixels_most: a unit that claims larger frames gets no memory for them.
        options: further ones of FFmpeg's decoder.

    Raises:
        BadInput: PyAV is not installed.
    """

    def __init__(self, wanted: str, pixels_most: int, **options: str) -> None:
        require_pyav(wanted)
        from av.video.codeccontext import VideoCodecContext

        self._codec = VideoCodecContext.create("h264", "r")
        self._codec.thread_type = "NONE"
        self._codec.options = {"max_pixels": str(pixels_most), **options}

    def decode(self, unit: bytes) -> list[VideoFrame]:
        """Return the unit's frames; none if the decoder refuses the unit."""
        from av import Packet
        from av.error import FFmpegError

        try:
            return self._codec.decode(Packet(unit))
        except FFmpegError:
            return []


def whole(images: list[VideoFrame], size: tuple[int, int]) -> VideoFrame | None:
    """Return the frame of a unit; None if these are not one undamaged frame of (width, height) and of one instant."""
    if len(images) != 1 or images[0].is_corrupt or images[0].interlaced_frame:
        return None
    return images[0] if (images[0].width, images[0].height) == size else None
