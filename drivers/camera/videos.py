"""Open video files and streams with a bound on their frame size, which the decoder obeys before it allocates memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.camera.images import MOST_PIXELS, U8, ImageRefused
from drivers.pyav import require_pyav

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import Container, InputContainer
    from av.video.stream import VideoStream

MOST_PACKET_BYTES = 32 << 20
"""Largest size of an encoded frame, bytes: that of an uncompressed one of 10 million pixels."""
_NO_TIMES = 0x80
"""FFmpeg's flag AVFMT_NOTIMESTAMPS."""
_PARSED_IN = frozenset({"mpegts", "rtp", "rtsp", "sdp"})
_PARSED = frozenset({"h264", "hevc", "mpeg4", "mpeg2video", "mpeg1video", "h263", "mjpeg"})
_PID_LEAST = 16
"""A stream within a transport stream has its PID as number, and that is no lower."""
_MARGIN = 4
"""Frames may have this many times the expected pixels: one of a wrong size is better named where the camera is known."""

_INTERLACED_LEAST = 5  # interlaced frames after which their share is checked
_INTERLACED_SHARE = 0.2
"""Share of interlaced frames from which a video is interlaced: of film on television two of five are. A torn header
claims it of one frame."""


def most_pixels(size: tuple[int, int] | None) -> int:
    """Return the pixels of the largest frame that is decoded where (width, height) are expected, None where anything is."""
    return MOST_PIXELS if size is None else min(MOST_PIXELS, _MARGIN * size[0] * size[1])


def has_times(container: Container) -> bool:
    """Return whether the container holds times; FFmpeg makes up those of others (raw H.264, MJPEG)."""
    return not container.format.flags & _NO_TIMES


def video_of(container: InputContainer, size: tuple[int, int] | None = None) -> VideoStream:
    """Return the video that has the expected size, else the largest one: a preview or a cover may stand before it.

    Raises:
        IndexError: there is no video.
    """
    from av.stream import Disposition

    videos = [one for one in container.streams.video if not one.disposition & Disposition.attached_pic]
    videos = videos or [container.streams.video[0]]
    sizes = [(one.codec_context.width, one.codec_context.height) for one in videos]
    if size in sizes:
        return videos[sizes.index(size)]
    return max(videos, key=lambda one: one.codec_context.width * one.codec_context.height)


def packets_held(stream: VideoStream) -> int:
    """Return how many frames of a live stream arrive, or begin to, before FFmpeg gives one out.

    Its parsers end a frame where the next one begins, in streams whose packets are no frames; MPEG-TS ends a packet so as well.
    """
    container = stream.container
    parsed = not has_times(container) or container.format.name in _PARSED_IN
    in_transport_stream = container.format.name == "mpegts" or (container.format.name == "rtp" and stream.id >= _PID_LEAST)
    return int(parsed and stream.codec_context.name in _PARSED) + in_transport_stream


def predicts_frames(stream: VideoStream) -> bool:
    """Return whether the video's codec predicts frames from one another."""
    return not stream.codec_context.codec.intra_only


class WholeFrames:
    """Tells the frames that are measured from those that are not: damaged ones, and interlaced ones, of two instants each."""

    def __init__(self) -> None:
        self._interlaced = self._seen = 0

    def px(self, frame: VideoFrame) -> U8 | None:
        """Return a decoded frame's pixels, (H, W, 3) BGR; None where it is damaged or interlaced.

        Raises:
            ImageRefused: so many frames are interlaced that the video is.
        """
        self._seen += 1
        if frame.interlaced_frame:
            self._interlaced += 1
            if self._interlaced >= _INTERLACED_LEAST:
                self.end()
            return None
        if frame.is_corrupt:  # the hidden part is image, not measurement
            return None
        return np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)

    def end(self) -> None:
        """Refuse a video that had many interlaced frames. Raises ImageRefused."""
        if self._interlaced and self._interlaced >= _INTERLACED_SHARE * self._seen:
            raise ImageRefused(
                "its frames are interlaced, and the lines of each are of two instants: set the camera, or what encodes it, to "
                "progressive"
            )


def frames_of(container: InputContainer, stream: VideoStream) -> Iterator[tuple[int, VideoFrame, U8 | None]]:
    """Yield the number of each frame of a file, the frame and its pixels, which are None where it is damaged or interlaced.

    Raises:
        FFmpegError: the file is damaged.
        ImageRefused: it is interlaced.
    """
    frames = WholeFrames()
    for number, frame in enumerate(container.decode(stream)):
        yield number, frame, frames.px(frame)
    frames.end()


def open_video(
    source: Any,
    size: tuple[int, int] | None = None,
    *,
    options: Mapping[str, str] | None = None,
    codec_options: Mapping[str, str] | None = None,
    timeout: tuple[float, float] | None = None,
) -> InputContainer:
    """Open a file, an address or an object with `read`; a frame above the bound then fails to decode.

    Args:
        source: the path, the address, or the object.
        size: width and height that are expected; None where they are not known.
        options: options of the container.
        codec_options: options of the decoders.
        timeout: limits for opening and for each read, seconds.

    Raises:
        FFmpegError, OSError: raised as by `av.open`.
        ImageRefused: the frames are larger than the bound, or a text was drawn as a picture; the text gives the reason.
        BadInput: PyAV is not installed.
    """
    require_pyav("a video")
    import av

    bound = {"max_pixels": str(most_pixels(size))}
    container: InputContainer = av.open(source, "r", options={**(options or {}), **bound}, timeout=timeout)
    if container.format.name == "tty":
        container.close()
        raise ImageRefused("it is text")
    for stream in container.streams.video:
        codec = stream.codec_context
        codec.options = {**(codec_options or {}), **bound}
        if codec.width * codec.height > most_pixels(size):
            container.close()
            expected = f"at most {MOST_PIXELS / 1e6:.0f} million pixels" if size is None else f"{size[0]}x{size[1]} px"
            raise ImageRefused(f"frames of {codec.width}x{codec.height} px, expected {expected}")
    return container
