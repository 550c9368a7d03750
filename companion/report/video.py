"""An H.264 file that any browser plays, fed one frame at a time."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from companion.report.flight_log import FlightLog, FrameRecord
from companion.report.overlay import Overlay, annotate, annotated_size
from drivers.camera import images
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.time import MonoNs, seconds_between

_CLOCK_HZ = 90_000
_BT709 = 1
_LIMITED_RANGE = 1


class FlightVideo:
    """Writes BGR frames as MP4 (H.264, yuv420p, BT.709, index in front). May be fed in flight or after it.

    Frames keep their own times, so a lost frame is a pause and not a jump. Nothing is left behind where no frame came.

    Args:
        path: the file to write; what is there is replaced.
        size: (width, height) px, even numbers.
        fps: the usual rate; only the encoder's rate control goes by it.

    Raises:
        BadInput: an odd size, a rate that is not positive, or a file that cannot be written.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        width, height = size
        if width <= 0 or height <= 0 or width % 2 or height % 2:
            raise BadInput(f"{path}: a video needs an even width and height, got {width}x{height} px")
        if not fps > 0.0:
            raise BadInput(f"{path}: fps must be positive, got {fps}")
        self.path = path
        self.frame_images = 0
        self._size = size
        self._first: MonoNs | None = None
        self._pts = -1
        self._closed = False
        container = av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"})
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.codec_context.time_base = Fraction(1, _CLOCK_HZ)
        stream.codec_context.options = {"preset": "veryfast", "crf": "27"}
        stream.codec_context.colorspace = _BT709
        stream.codec_context.color_primaries = _BT709
        stream.codec_context.color_trc = _BT709
        stream.codec_context.color_range = _LIMITED_RANGE
        try:
            container.start_encoding()
        except (OSError, av.FFmpegError) as why:
            raise BadInput(f"{path}: cannot write a video there: {why}") from why
        self._container, self._stream = container, stream

    def add(self, image: NDArray[np.uint8], at: MonoNs) -> bool:
        """Append a (H, W, 3) BGR frame of the instant `at`; False for one that is not later than the last.

        Raises:
            ValueError: a frame of another size.
            Recoverable: the disk refuses it.
        """
        if image.shape != (self._size[1], self._size[0], 3) or image.dtype != np.uint8:
            raise ValueError(f"want {self._size[1], self._size[0], 3} uint8 BGR, got {image.shape} {image.dtype}")
        if self._first is None:
            self._first = at
        pts = round(seconds_between(self._first, at) * _CLOCK_HZ)
        if pts <= self._pts:
            return False
        self._pts = pts
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
        frame = frame.reformat(format="yuv420p", dst_colorspace=_BT709, dst_color_range=_LIMITED_RANGE)
        frame.pts, frame.time_base = pts, Fraction(1, _CLOCK_HZ)
        self._write(frame)
        self.frame_images += 1
        return True

    def _write(self, frame: av.VideoFrame | None) -> None:
        try:
            self._container.mux(self._stream.encode(frame))
        except OSError as why:
            raise Recoverable(f"{self.path}: cannot write the video: {why}") from why

    def close(self) -> None:
        """Write what is left and the index."""
        if self._closed:
            return
        self._closed = True
        try:
            if self.frame_images:
                self._write(None)
        finally:
            self._container.close()
            if not self.frame_images:
                self.path.unlink(missing_ok=True)

    def __enter__(self) -> FlightVideo:
        return self

    def __exit__(self, kind: type[BaseException] | None, why: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def video_from_log(log: FlightLog, path: Path, fps: float = 30.0, scale: float = 1.0) -> int:
    """Draw every kept frame of the log into a video; returns how many there were (none, no file).

    Raises:
        BadInput: the file cannot be written.
    """
    kept = [f for f in sorted(log.frames, key=lambda f: f.exposed_at) if f.image is not None]
    if not kept:
        return 0
    by_seq: dict[int, list[Sighting]] = {}
    for sighting in log.sightings:
        by_seq.setdefault(sighting.seq, []).append(sighting)
    steered = log.steering or (log.estimates[0].path if log.estimates else None)
    states = sorted((e for e in log.estimates if e.path == steered), key=lambda e: e.at)
    instants = np.array([e.at for e in states], dtype=np.int64)
    changes = sorted(log.phases, key=lambda p: p.at)
    with FlightVideo(path, annotated_size(log.camera.width, log.camera.height, scale), fps) as video:
        for frame in kept:
            image = _decode(frame)
            if image is None:
                continue
            overlay = Overlay(
                t_s=seconds_between(log.started, frame.exposed_at),
                verdict=frame.verdict,
                phase=next((p.phase for p in reversed(changes) if p.at <= frame.exposed_at), ""),
                sightings=tuple(by_seq.get(frame.seq, ())),
                estimate=_nearest(states, instants, frame.exposed_at),
                R_level_body=frame.R_level_body,
                d_expected_level=frame.d_expected_level,
            )
            video.add(annotate(image, overlay, log.camera, log.pad, scale), frame.exposed_at)
        return video.frame_images


def _nearest(states: list[RelativeState], instants: NDArray[np.int64], at: MonoNs) -> RelativeState | None:
    """Return the state nearest in time, or None if none is within 0.1 s."""
    if not states:
        return None
    i = int(np.argmin(np.abs(instants - at)))
    return states[i] if abs(instants[i] - at) <= 100_000_000 else None


def _decode(frame: FrameRecord) -> NDArray[np.uint8] | None:
    """Return the image of a frame, or None if its bytes are no image or its file is gone."""
    if isinstance(frame.image, Path):
        if not frame.image.is_file():
            return None
        return np.asarray(p, np.uint8) if (p := cv2.imread(str(frame.image), cv2.IMREAD_COLOR)) is not None else None
    if not frame.image:
        return None
    try:
        return images.decode(frame.image)
    except images.ImageRefused:
        return None
