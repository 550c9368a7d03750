"""The film of a flight: MP4 (H.264, yuv420p, BT.709, index in front), which any browser plays; and an animated image of it."""

import math
import tempfile
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from companion.recording.frame_encoder import CLOCK_HZ, TimedFrames, VideoImage, prepare
from companion.recording.palette import OUTLINE, THREE, bgr
from companion.settings.load import whole
from companion.tools.report.figures import body_over_pad
from companion.tools.report.flight_log import FlightLog, FrameRecord
from companion.tools.report.overlay import Overlay, annotate, annotated_size
from companion.tools.report.plots import steering_states, times
from drivers.camera import images
from drivers.pyav import has_pyav, require_pyav
from estimator.contracts.errors import BadInput, Recoverable, refused
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between

U8 = NDArray[np.uint8]

FILM_BYTES = 6_000_000
"""About the most that a film takes: base64 makes it a third longer, and many mailboxes take 10 MB."""
_LEAST_BIT_S = 150_000
_RATE_HZ = 30
"""The usual rate; only the encoder's rate control goes by it."""


Watch = Callable[[int, int], None]
"""Receives the number of frames that are encoded, at first 0, and of all."""


def unwatched(_done: int, _of: int) -> None:
    """Show nothing."""


class FilmFile(Struct, frozen=True):
    """A whole video file, or one frame as JPEG in its place."""

    data: bytes
    began: MonoNs
    """The instant of its first frame."""
    frames: int
    """Number of its frames; 0 for a JPEG."""


def still_of(log: FlightLog) -> FilmFile | None:
    """Draw the middle one of the kept frames; None if none was kept or it cannot be decoded."""
    kept = [frame for frame in log.frames if frame.image is not None]
    for image, at in drawn_frames(structs.replace(log, frames=kept[len(kept) // 2 :][:1])):
        return FilmFile(cv2.imencode(".jpg", image)[1].tobytes(), at, 0)
    return None


def drawn_frames(log: FlightLog, scale: float = 1.0, apart_s: float = 0.0) -> Iterator[tuple[U8, MonoNs]]:
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
        camera = log.camera if frame.R_body_cam is None else log.camera.turned(frame.R_body_cam)
        yield annotate(image, overlay, camera, log.pad, scale), frame.exposed_at


def film_of(log: FlightLog, watch: Watch = unwatched) -> FilmFile | None:
    """Draw every kept frame of the log into a film; None if none was kept or can be decoded, or PyAV is not installed.

    Frames keep their own times, so a lost frame is a pause and not a jump; one that is not later than the last is left out.

    Raises:
        Recoverable: the disk refuses the film.
    """
    exposures = [frame.exposed_at for frame in log.frames if frame.image is not None]
    if not exposures or not has_pyav():
        return None
    import av

    duration_s = max(1.0, seconds_between(min(exposures), max(exposures)))
    most_bit_s = max(_LEAST_BIT_S, round(8 * FILM_BYTES / duration_s))
    size = annotated_size(log.camera.width, log.camera.height)
    timed, drawn = TimedFrames(size), list[MonoNs]()
    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        path = Path(folder) / "flight.mp4"
        with (
            refused(f"{path}: cannot write the video", OSError, by=Recoverable),
            av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container,
        ):
            stream = container.add_stream("libx264", rate=_RATE_HZ)
            prepare(stream.codec_context, size)
            stream.codec_context.time_base = Fraction(1, CLOCK_HZ)
            # A key frame each second: a cursor that moves seeks often.
            options = {"preset": "veryfast", "crf": "27", "g": str(_RATE_HZ)}
            stream.codec_context.options = options | {"maxrate": str(most_bit_s), "bufsize": str(2 * most_bit_s)}
            container.start_encoding()
            for done, (image, at) in enumerate(drawn_frames(log)):
                watch(done, len(exposures))
                if (frame := timed.frame(image, at)) is not None:
                    container.mux(stream.encode(frame))
                    drawn.append(at)
            if drawn:
                container.mux(stream.encode())
                watch(len(exposures), len(exposures))
        return FilmFile(path.read_bytes(), drawn[0], len(drawn)) if drawn else None


def _nearest(states: list[RelativeState], instants: NDArray[np.int64], at: MonoNs) -> RelativeState | None:
    """Return the state nearest in time, or None if none is within 0.1 s."""
    if not states:
        return None
    i = int(np.argmin(np.abs(instants - at)))
    return states[i] if abs(instants[i] - at) <= 100_000_000 else None


def _decode(frame: FrameRecord) -> U8 | None:
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


# A short animated image (GIF) of a landing: the deck camera with its overlay, the track from above and the height.

GIF_HZ = 8
SPEED = 2.0
"""Seconds of flight in a second of the image."""
_FILM_WIDTH_PX = 440
_SIDE_PX = 200
_STRIP_PX = 96
_STILL_S = 3.0
"""Duration of the last image before the animation begins again, s."""
_COLOURS = 96
_INK, _PALE, _PAPER = (230, 230, 230), (110, 110, 110), (32, 26, 22)
_ABOVE_M = 1.0
"""Half the side of the map: the pad's neighbourhood, in which the landing is decided."""


def write_animation(log: FlightLog, path: Path) -> int:
    """Write the flight of a log as an animated GIF and return its size in bytes.

    Raises:
        BadInput: no frame was kept, nothing was estimated, or the file cannot be written.
    """
    require_pyav(f"{path}: an animation")
    states = steering_states(log)
    if not states:
        raise BadInput(f"{path}: the recording holds no estimate to draw")
    at_s = times(log, states)
    yaw_rad = np.array([math.nan if state.yaw_rad is None else state.yaw_rad for state in states])
    over_pad = body_over_pad(np.array([state.d_body_pad_level for state in states]), yaw_rad)
    scale = _FILM_WIDTH_PX / log.camera.width
    frames = drawn_frames(log, scale, SPEED / GIF_HZ)
    images = [_sheet(log, image, seconds_between(log.started, at), at_s, over_pad) for image, at in frames]
    if not images:
        raise BadInput(f"{path}: the recording holds no frames to draw; record with --record-frames jpeg or h264")
    with refused(f"{path}: cannot write the animation", OSError), whole(path) as beside:
        _encode(beside, images + images[-1:] * round(_STILL_S * GIF_HZ))
    return path.stat().st_size


def _sheet(log: FlightLog, film: U8, now_s: float, at_s: F64, over_pad: F64) -> U8:
    """Return one image: the film, right of it the map, below both the height over time."""
    height, width = film.shape[:2]
    sheet = np.full((height + _STRIP_PX, width + _SIDE_PX, 3), _PAPER, np.uint8)
    # A median takes the sensor's noise away, which a palette of few colours would only spread.
    sheet[:height, :width] = cv2.medianBlur(film, 3)
    past = at_s <= now_s
    _draw_map(sheet[:height, width:], log.pad.disc_radius_m, over_pad[past])
    _draw_height(sheet[height:], at_s, over_pad[:, 2], now_s)
    phase = next((change.phase for change in reversed(log.phases) if seconds_between(log.started, change.at) <= now_s), "")
    if past.any():
        x, y, up_m = over_pad[past][-1]
        _write(sheet, f"{now_s:.1f} s  {phase}", (8, 18))
        _write(sheet, f"height {max(up_m, 0.0):.2f} m  sideways {math.hypot(x, y):.2f} m", (8, height - 8))
    return sheet


def _draw_map(panel: U8, radius_m: float, track: F64) -> None:
    """Draw the pad from above, its arrow up, and the track of the drone over it."""
    height, width = panel.shape[:2]
    px_m = min(height, width) / (2.0 * _ABOVE_M)
    centre = (width // 2, height // 2)
    cv2.circle(panel, centre, round(radius_m * px_m), bgr(OUTLINE), 1, cv2.LINE_AA)
    cv2.drawMarker(panel, centre, _PALE, cv2.MARKER_CROSS, 10, 1)
    if len(track):
        along, starboard = track[:, 0], track[:, 1]
        points = np.round(np.stack([centre[0] + starboard * px_m, centre[1] - along * px_m], axis=1))
        points = points[np.isfinite(points).all(axis=1)].astype(np.int32)
        cv2.polylines(panel, [points], False, bgr(THREE[0]), 1, cv2.LINE_AA)
        if len(points):
            cv2.circle(panel, (int(points[-1][0]), int(points[-1][1])), 4, bgr(THREE[1]), -1, cv2.LINE_AA)
    _write(panel, "from above, 2 m", (8, 18))


def _draw_height(strip: U8, at_s: F64, height_m: F64, now_s: float) -> None:
    """Draw the height above the pad over the whole flight, the past bright."""
    rows, width = strip.shape[:2]
    margin = 8
    highest = max(float(np.nanmax(height_m)), 0.1)
    span_s = max(float(at_s[-1] - at_s[0]), 0.1)
    x = margin + (at_s - at_s[0]) / span_s * (width - 2 * margin)
    y = rows - margin - np.clip(height_m / highest, 0.0, 1.0) * (rows - 2 * margin)
    line = np.round(np.stack([x, y], axis=1)).astype(np.int32)
    cv2.polylines(strip, [line], False, _PALE, 1, cv2.LINE_AA)
    cv2.polylines(strip, [line[at_s <= now_s]], False, bgr(THREE[1]), 2, cv2.LINE_AA)
    _write(strip, f"height above the deck, {highest:.1f} m to 0 in {span_s:.0f} s", (width - 340, 18))


def _write(image: U8, text: str, at: tuple[int, int]) -> None:
    for thickness, ink in ((3, (0, 0, 0)), (1, _INK)):
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, ink, thickness, cv2.LINE_AA)


def _encode(path: Path, images: list[U8]) -> None:
    """Encode BGR images of one size with one palette for all of them."""
    import av
    import av.filter

    height, width = images[0].shape[:2]
    graph = av.filter.Graph()
    source = graph.add_buffer(width=width, height=height, format=av.VideoFormat("bgr24"), time_base=Fraction(1, GIF_HZ))
    split = graph.add("split")
    palette = graph.add("palettegen", f"max_colors={_COLOURS}:stats_mode=full")
    use = graph.add("paletteuse", "dither=none:diff_mode=rectangle")
    sink = graph.add("buffersink")
    source.link_to(split)
    split.link_to(palette, 0, 0)
    split.link_to(use, 1, 0)
    palette.link_to(use, 0, 1)
    use.link_to(sink)
    graph.configure()
    with av.open(str(path), "w", format="gif") as container:
        stream = container.add_stream("gif", rate=GIF_HZ)
        stream.width, stream.height, stream.pix_fmt = width, height, "pal8"
        for index, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
            frame.pts, frame.time_base = index, Fraction(1, GIF_HZ)
            source.push(frame)
        source.push(None)
        while True:
            try:
                indexed = sink.pull()
            except (av.EOFError, av.BlockingIOError):
                break
            assert isinstance(indexed, av.VideoFrame)
            container.mux(stream.encode(indexed))
        container.mux(stream.encode(None))
