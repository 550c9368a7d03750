"""An H.264 file that any browser plays, fed one frame at a time."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from companion.recording.frame_encoder import CLOCK_HZ, TimedFrames, prepare
from companion.recording.frame_video import VideoImage
from companion.tools.report.flight_log import FlightLog, FrameRecord
from companion.tools.report.overlay import Overlay, annotate, annotated_size
from companion.tools.report.plots import steering_states
from drivers.camera import images
from drivers.pyav import has_pyav, require_pyav
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between
from estimator.vision.camera import Camera

if TYPE_CHECKING:
    import av

FILM_BYTES = 6_000_000
"""About the most that a film takes: base64 makes it a third longer, and many mailboxes take 10 MB."""
_LEAST_BIT_S = 150_000


@dataclass(frozen=True, slots=True)
class FilmFile:
    """A whole video file."""

    data: bytes
    began: MonoNs
    """The instant of its first frame."""
    frames: int


class FlightVideo:
    """Writes BGR frames as MP4 (H.264, yuv420p, BT.709, index in front). May be fed in flight or after it.

    Frames keep their own times, so a lost frame is a pause and not a jump. Nothing is left behind where no frame came.

    Args:
        path: the file to write; what is there is replaced.
        size: (width, height) px, even numbers.
        fps: the usual rate; only the encoder's rate control goes by it.
        most_bit_s: the most bits of a second, so that a long flight can be mailed; None for as many as the quality takes.

    Raises:
        BadInput: an odd size, a rate that is not positive, or a file that cannot be written.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: float, most_bit_s: int | None = None) -> None:
        width, height = size
        if width <= 0 or height <= 0 or width % 2 or height % 2:
            raise BadInput(f"{path}: a video needs an even width and height, got {width}x{height} px")
        if not fps > 0.0:
            raise BadInput(f"{path}: fps must be positive, got {fps}")
        require_pyav(f"{path}: a video")
        import av

        self.path = path
        self.frame_images = 0
        self._frames = TimedFrames(size)
        self._closed = False
        container = av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"})
        stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        prepare(stream.codec_context, size)
        stream.codec_context.time_base = Fraction(1, CLOCK_HZ)
        # A key frame each second: a cursor that moves seeks often.
        options = {"preset": "veryfast", "crf": "27", "g": str(max(1, round(fps)))}
        if most_bit_s is not None:
            options |= {"maxrate": str(most_bit_s), "bufsize": str(2 * most_bit_s)}
        stream.codec_context.options = options
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
        frame = self._frames.frame(image, at)
        if frame is None:
            return False
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


def drawn_frames(log: FlightLog, scale: float = 1.0, apart_s: float = 0.0) -> Iterator[tuple[NDArray[np.uint8], MonoNs]]:
    """Yield the kept frames that can be decoded, with their overlays, and their exposures; sizes are those of `annotated_size`.

    Args:
        apart_s: least time between two of them.
    """
    by_seq: dict[int, list[Sighting]] = {}
    for sighting in log.sightings:
        by_seq.setdefault(sighting.seq, []).append(sighting)
    states = steering_states(log)
    instants = np.array([e.at for e in states], dtype=np.int64)
    due: MonoNs | None = None
    for frame in sorted(log.frames, key=lambda f: f.exposed_at):
        if (due is not None and frame.exposed_at < due) or (image := _decode(frame)) is None:
            continue
        due = MonoNs(frame.exposed_at + round(apart_s * NS_PER_S))
        overlay = Overlay(
            sightings=tuple(by_seq.get(frame.seq, ())),
            estimate=_nearest(states, instants, frame.exposed_at),
            R_level_body=frame.R_level_body,
            d_expected_level=frame.d_expected_level,
        )
        yield annotate(image, overlay, _camera(log, frame), log.pad, scale), frame.exposed_at


def film_of(log: FlightLog, fps: float = 30.0, scale: float = 1.0) -> FilmFile | None:
    """Draw every kept frame of the log into a film; None if none was kept or can be decoded, or PyAV is not installed."""
    exposures = [frame.exposed_at for frame in log.frames if frame.image is not None]
    if not exposures or not has_pyav():
        return None
    duration_s = max(1.0, seconds_between(min(exposures), max(exposures)))
    most_bit_s = max(_LEAST_BIT_S, round(8 * FILM_BYTES / duration_s))
    began: MonoNs | None = None
    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        path = Path(folder) / "flight.mp4"
        with FlightVideo(path, annotated_size(log.camera.width, log.camera.height, scale), fps, most_bit_s) as video:
            for image, at in drawn_frames(log, scale):
                if video.add(image, at) and began is None:
                    began = at
        return None if began is None else FilmFile(path.read_bytes(), began, video.frame_images)


def _camera(log: FlightLog, frame: FrameRecord) -> Camera:
    """Return the camera as a gimbal held it at a frame's exposure, or the log's."""
    return log.camera if frame.R_body_cam is None else log.camera.turned(frame.R_body_cam)


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
    if isinstance(frame.image, VideoImage):
        return frame.image.px()
    if not frame.image:
        return None
    try:
        return images.decode(frame.image)
    except images.ImageRefused:
        return None
