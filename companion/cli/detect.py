"""`decklander detect`: find the pad in images, videos and recordings; print one line or one JSON object per frame.

Paths, camera, pad and attitudes are checked before any frame is searched. A file that cannot be decoded is named on stderr, the
others are still searched, and the exit code is 2.
"""

import argparse
import csv
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from glob import escape
from pathlib import Path
from typing import get_args

import cv2
import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from companion.cli.options import named_wait, option, tell_damage
from companion.cli.outputs import Kind, check_output, output
from companion.recording.reading import RecordedFrame, open_recording
from companion.settings.capabilities import ReadOpinion, offered, require_key
from companion.settings.load import find_file, mount_assumed, pad_of_file, read_camera
from companion.tools.calibrate.guide import files_of
from companion.tools.report.overlay import Overlay, annotate
from decklander.place import SHIPPED
from drivers.camera import images
from drivers.camera.videos import frames_of, open_video, predicts_frames, video_of
from drivers.files import Largest, bytes_of, refuse_special
from drivers.pyav import require_pyav
from estimator.contracts.errors import BadInput, DecklanderError, file_errors
from estimator.contracts.estimates import CENTRE, Method, Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.text import text_of
from estimator.contracts.time import MonoNs, Stamp
from estimator.options import EstimatorOptions
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.options import ColourSetName, TrackerMethod, TrackerOptions
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import FRAME_WORK, SecondOpinion, TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track

U8 = NDArray[np.uint8]

RECORDINGS = {".mcap"}
VIDEOS = {".mp4", ".mkv", ".avi", ".mov", ".webm", ".h264", ".264", ".m4v", ".ts"}
METHODS: tuple[Method, ...] = ("ellipse", "arrow", "corners", "registration")

_DRAWINGS = Kind("drawing", tuple(sorted(images.PICTURES)), inside=())
_SURE = 0.5  # confidence from which a frame shows the pad without doubt
_FOUND = EstimatorOptions().min_confidence
"""Confidence from which flight uses it."""
_MIRROR_TRIES = 8
"""Number of frames without a sure pad after which a mirrored one is searched: a camera that mirrors does so in all of them."""
_NAMED = 3  # frames that are named
_STAMP = Stamp(MonoNs(0), MonoNs(0), 0.0, "arrival")


class _Image(Struct, frozen=True, eq=False):
    """One image to search."""

    source: str
    index: int
    """Number of the frame in its video or recording, from 0."""
    px: U8
    """(height, width, 3) BGR."""
    attitude: Attitude | None = None
    """Attitude at the exposure, where a recording holds it."""
    coded: bool = False


class _Model(Struct, frozen=True, eq=False):
    """The camera that took a file's images, and the pad to look for in them."""

    camera: Camera
    camera_source: str
    """Origin of the camera, for messages."""
    pad: Pad


DESCRIPTION = "Find the pad in images, videos or recordings. Exit code 1 if no frame shows it."


def add_arguments(p: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    p.epilog = (
        "Positions are from the body to the pad: forward, right, down, metres, in a frame with the body's heading and no "
        "tilt. Headings are the body's against the pad's arrow, clockwise seen from above, degrees."
    )
    option(p, "paths PATH", "image, video, recording (MCAP), or a folder of them; pad.jpg is a shipped example", nargs="+")
    option(
        p,
        "--camera FILE",
        "camera file, or the name of a shipped one (sim, ardrone2_bottom); a recording needs none (default: its own)",
    )
    option(p, "--pad FILE", "pad file, or the name of a shipped one (default: thesis; for a recording its own)")
    option(
        p,
        "--attitude FILE",
        "read attitudes from a CSV file with the header source,roll_deg,pitch_deg; source is the path or name of an image, "
        "or NAME#INDEX for a frame of a video. A frame without attitude is taken as level, with a wide covariance",
    )
    option(
        p, "--attitude-sigma-deg DEG", "standard deviation of these attitudes (default: %(default)s)", type=_positive, default=0.5
    )
    option(
        p,
        "--method",
        "what forms the sighting: registration, as flown; the thesis' three methods; or all, fused (default: %(default)s)",
        choices=get_args(TrackerMethod),
        default="registration",
    )
    option(
        p,
        "--colours",
        "colour limits of the thesis' methods; auto takes the most confident ones for each frame (default: %(default)s)",
        choices=["auto", *get_args(ColourSetName)],
        default="auto",
    )
    option(
        p,
        "--second-opinion FILE",
        "ask a trained network about each registration, too, and print both opinions; it can only lower the confidence "
        "(default: ask none; without FILE the shipped network)",
        nargs="?",
        const="",
    )
    output(
        p,
        "--draw PATH",
        "draw what was found: into this image file (.png, .jpg) for one image, else each frame as a PNG into this folder",
        _DRAWINGS,
    )
    option(p, "--json", "print JSON Lines, one object per frame")


def run(args: argparse.Namespace) -> int:
    """Search every frame; return 0 if one shows the pad, 1 if none does, 2 if a file cannot be read.

    Raises:
        BadInput: a path, the camera, the pad or the attitudes are wrong.
    """
    files = files_of(list(map(_found, args.paths)), images.PICTURES | VIDEOS | RECORDINGS, "image, video or recording")
    models = {file: _model(args, file) for file in files}
    if args.camera:
        lines = mount_assumed(find_file(args.camera, "cameras", Path(), "--camera"))
        sys.stderr.writelines(f"decklander: {line}\n" for line in lines)
    tilts = _attitudes(_found(args.attitude), files) if args.attitude is not None else {}
    require_key(f"vision.method={args.method}", f"--method {args.method}")
    options = _options(args.method, args.colours)
    opinion: SecondOpinion | None = None
    if args.second_opinion is not None:
        read: ReadOpinion = offered("opinions", "second_opinion", "--second-opinion")
        opinion = read(args.second_opinion, "--second-opinion")
    drawings = {} if args.draw is None else _drawings(args.draw, files, force=args.force)
    counts, unreadable = _Counts(), 0
    if not args.json:
        sys.stdout.write(_HEADER)
    for file in files:
        trackers = [
            TrackerConfig(models[file].camera, models[file].pad, of, second_opinion=opinion, watches=False) for of in options
        ]
        try:
            for image, seen, colours, elapsed_ms in _searched(args, _images(file, models[file]), trackers, tilts, counts):
                record, o = _record(image, seen, colours, elapsed_ms), seen.opinions
                opinions = "" if o is None else f"  verified {o.verified:.2f}, learned {o.learned:.2f}"
                line = f"{_line(image, seen)} {elapsed_ms:6.1f}{opinions}"
                sys.stdout.write((json.dumps(record) if args.json else line) + "\n")
                if file in drawings:
                    _draw(drawings[file], image, seen, models[file])
        except _NoImageError as why:
            unreadable += 1
            sys.stdout.flush()
            sys.stderr.write(f"decklander: {why}\n")
    _conclude(args, counts, attitudes=bool(tilts))
    return 2 if unreadable else int(not counts.found)


class _Counts(Struct):
    """The counts of all frames so far."""

    frames: int = 0
    found: int = 0
    sure: int = 0
    ambiguous: int = 0
    mirrored: int = 0
    untried: int = _MIRROR_TRIES
    """Number of frames without a sure pad that are still searched for a mirrored one."""
    level: list[str] = field(default_factory=list)
    """Frames without an attitude, taken as level."""


def _searched(
    args: argparse.Namespace,
    found: Iterator[_Image],
    trackers: Sequence[TrackerConfig],
    tilts: Mapping[str, Rotation],
    counts: _Counts,
) -> Iterator[tuple[_Image, Detection, str | None, float]]:
    """Search the images of a file in their order, and yield each with what it shows, its colour limits and the time, ms."""
    memories = [TrackerMemory()] * len(trackers)
    for image in found:
        attitude = _attitude(tilts, image, math.radians(args.attitude_sigma_deg)) or image.attitude
        counts.level += [] if attitude else [f"{image.source}#{image.index}"]
        frame = Frame(_STAMP, image.index, image.px, coded=image.coded)
        if not counts.frames:  # The first look sets the pad up, and all code that it runs is cold: neither is a look's time.
            with named_wait(f"setting up the pad {trackers[0].pad.name}"):
                _best(frame, attitude, trackers, memories)
        began = time.perf_counter()
        seen, colours, memories = _best(frame, attitude, trackers, memories)
        elapsed_ms = (time.perf_counter() - began) * 1e3
        counts.frames += 1
        counts.found += _is_sure(seen, _FOUND)
        counts.sure += _is_sure(seen)
        counts.ambiguous += seen.selected is not None and seen.selected.yaw_ambiguous
        if counts.untried and not _is_sure(seen):
            counts.untried -= 1
            turned = TrackerConfig(trackers[0].camera, trackers[0].pad, search_work=FRAME_WORK)
            mirror = Frame(frame.stamp, frame.seq, np.ascontiguousarray(frame.px[:, ::-1]), coded=frame.coded)
            counts.mirrored += _is_sure(track(turned, TrackerMemory(), mirror, None)[0])
        yield image, seen, colours, elapsed_ms


def _conclude(args: argparse.Namespace, counts: _Counts, *, attitudes: bool) -> None:
    """Print in how many frames the pad was found, and what a person should know of the others."""
    if attitudes and counts.level:
        named = f"{', '.join(counts.level[:_NAMED])}{' ...' * (len(counts.level) > _NAMED)}"
        share = f"{len(counts.level)} of {counts.frames} frames"
        sys.stderr.write(f"decklander: {args.attitude} has no row for {share}, taken as level: {named}\n")
    if counts.frames and not args.json:
        doubtful = "? the pad looks alike from several sides: its heading may be another\n" if counts.ambiguous else ""
        sys.stdout.write(f"{doubtful}found in {counts.found} of {counts.frames} frames\n")
    if counts.mirrored > counts.sure:
        sys.stdout.flush()
        sys.stderr.write(
            f"decklander: {counts.mirrored} frames show the pad mirrored, and no drone lands by such: turn off the mirror "
            "(horizontal flip) of the camera, its driver or its pipeline\n"
        )


def _found(text: str) -> Path:
    """Return the file that a path means; from any folder, a shipped example by its name."""
    path, example = Path(text), SHIPPED / "examples" / text.removeprefix("configs/examples/")
    return example if example.is_file() and not path.exists() else path


def _model(args: argparse.Namespace, file: Path) -> _Model:
    recording = open_recording([file]) if file.suffix.lower() in RECORDINGS else None
    camera = None
    camera_source = str(file)
    if args.camera is not None:
        path = find_file(args.camera, "cameras", Path(), "--camera")
        camera, camera_source = read_camera(path), str(path)
    elif recording is not None:
        camera = recording.camera()
    if camera is None:
        raise BadInput(f"{file}: does not say which camera took it: give --camera FILE")
    pad = recording.pad() if args.pad is None and recording is not None else None
    if pad is None:
        path = find_file(args.pad or "thesis", "pads", Path(), "--pad")
        pad = pad_of_file(path)
        pad.check_for_detection(str(path))
    return _Model(camera, camera_source, pad)


class _NoImageError(Exception):
    """A file cannot be decoded; the text names it."""


def _positive(text: str) -> float:
    value = _number(text)
    if not 0.0 < value <= 45.0:
        raise argparse.ArgumentTypeError(f"must be a number of degrees over 0 and up to 45, got {text!r}")
    return value


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _images(file: Path, model: _Model) -> Iterator[_Image]:
    size = model.camera.width, model.camera.height
    if file.suffix.lower() in RECORDINGS:
        yield from _recorded(file, model)
        return
    if file.suffix.lower() not in VIDEOS:
        try:
            data = bytes_of(file, Largest.PICTURE)
            claimed = images.claimed_size(data)
            if claimed is not None and claimed != size:
                raise _wrong_size(str(file), claimed, model)
            yield _Image(str(file), 0, images.decode(data, size))
            return
        except DecklanderError as why:
            raise _NoImageError(str(why)) from why
        except images.ImageRefused as why:
            if file.suffix.lower() in images.PICTURES:
                raise _NoImageError(f"{file}: not an image that can be read ({why})") from why
    index = 0
    require_pyav(f"{file}: a video")
    from av.error import FFmpegError

    try:
        refuse_special(file, Largest.RECORDING)
        with open_video(str(file), size) as container:
            stream = video_of(container, size)
            for number, frame, px in frames_of(container, stream):
                if (frame.width, frame.height) != size:
                    raise _wrong_size(str(file), (frame.width, frame.height), model)
                index = number + 1
                if px is not None:
                    yield _Image(str(file), number, px, coded=predicts_frames(stream))
    except images.ImageRefused as why:
        raise _NoImageError(f"{file}: {why} ({model.camera_source})") from why
    except (FFmpegError, OSError, IndexError) as why:
        raise _NoImageError(f"{file}: neither an image nor a video that can be read (stopped at frame {index})") from why
    if index == 0:
        raise _NoImageError(f"{file}: a video without frames")


def _recorded(file: Path, model: _Model) -> Iterator[_Image]:
    recording, index, kept = open_recording([file]), 0, 0
    for event in recording.events():
        if not isinstance(event, RecordedFrame):
            continue
        size = event.record.width, event.record.height
        if size != (model.camera.width, model.camera.height):
            raise _wrong_size(str(file), size, model)
        if (frame := event.frame(size)) is not None:
            kept += 1
            yield _Image(str(file), index, frame.px, event.attitude, frame.coded)
        index += 1
    tell_damage(recording.cut, "searched")
    if not kept:
        raise _NoImageError(f"{file}: the recording holds {index} frames, but none of their images")


def _wrong_size(source: str, size: tuple[int, int], model: _Model) -> _NoImageError:
    camera = model.camera
    return _NoImageError(
        f"{source}: {size[0]}x{size[1]} px, but {model.camera_source} is of a camera of {camera.width}x{camera.height} px"
    )


def _attitudes(path: Path, files: Sequence[Path]) -> dict[str, Rotation]:
    """Return roll and pitch of an attitude file, by source."""
    try:
        with file_errors(str(path)):
            rows = list(csv.reader(text_of(bytes_of(path, Largest.TABLE), str(path)).splitlines()))
    except csv.Error as why:
        raise BadInput(f"{path}: not a CSV file of text; its first line must be source,roll_deg,pitch_deg") from why
    header = [cell.strip() for cell in rows[0]] if rows else []
    if any(name not in header for name in ("source", "roll_deg", "pitch_deg")):
        raise BadInput(f"{path}: the first line must be source,roll_deg,pitch_deg, got {','.join(header)[:80]!r}")
    at = {name: header.index(name) for name in ("source", "roll_deg", "pitch_deg")}
    tilts: dict[str, Rotation] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        where = f"{path} line {number}"
        if len(row) != len(header):
            raise BadInput(f"{where}: {len(row)} cells, the header has {len(header)}")
        source = row[at["source"]].strip()
        if source in tilts:
            raise BadInput(f"{where}: {source!r} is there twice")
        roll, pitch = (math.radians(_degrees(row[at[name]], name, where)) for name in ("roll_deg", "pitch_deg"))
        tilts[source] = Rotation.from_rpy(roll, pitch, 0.0)
    known = {Path(source.split("#")[0]).name for source in tilts}
    if not any(file.name in known for file in files):
        raise BadInput(f"{path}: no row is of any of the images; the first column is their path or file name")
    return tilts


def _degrees(cell: str, name: str, where: str) -> float:
    value = _number(cell)
    if not abs(value) < 89.0:
        raise BadInput(f"{where}: {name} must be a number of degrees within +-89, got {cell.strip()!r}")
    return value


def _attitude(tilts: Mapping[str, Rotation], image: _Image, sigma_rad: float) -> Attitude | None:
    name = Path(image.source).name
    keys = (f"{image.source}#{image.index}", f"{name}#{image.index}", image.source, name)
    tilt = next((tilts[key] for key in keys if key in tilts), None)
    return None if tilt is None else Attitude(_STAMP, tilt, np.eye(3) * sigma_rad**2)


def _options(method: TrackerMethod, colours: str) -> list[TrackerOptions]:
    """Return the options of each look at a frame: one, or one for each set of colour limits that may turn out the best."""
    if method == "registration":
        return [TrackerOptions()]
    names = get_args(ColourSetName) if colours == "auto" else (colours,)
    return [TrackerOptions(method, name) for name in names]


def _best(
    frame: Frame, attitude: Attitude | None, trackers: Sequence[TrackerConfig], memories: Sequence[TrackerMemory]
) -> tuple[Detection, str | None, list[TrackerMemory]]:
    """Return the surest tracker's detection, the colour limits that it used, and every tracker's memory."""
    looks = [track(tracker, memory, frame, attitude) for tracker, memory in zip(trackers, memories, strict=True)]
    best = max(range(len(looks)), key=lambda i: -1.0 if (s := looks[i][0].selected) is None else s.confidence)
    options = trackers[best].options
    return looks[best][0], None if options.method == "registration" else options.colours, [memory for _, memory in looks]


def _is_sure(seen: Detection, least: float = _SURE) -> bool:
    return seen.selected is not None and seen.selected.confidence >= least


def _record(image: _Image, seen: Detection, colours: str | None, elapsed_ms: float) -> dict[str, object]:
    """Return the JSON object of one frame, with the name of the colour limits that were used."""
    names = list(dict.fromkeys((*METHODS, *seen.methods)))
    return {
        "source": image.source,
        "index": image.index,
        "found": _is_sure(seen, _FOUND),
        **_numbers(seen.selected),
        "outline_px": None if seen.selected is None else _outlines(seen.selected, image),
        "method": seen.chosen,
        "methods": {
            name: None if (s := seen.methods.get(name)) is None else {"found": True, **_numbers(s), "method": name}
            for name in names
        },
        "opinions": None if (o := seen.opinions) is None else {"verified": round(o.verified, 4), "learned": round(o.learned, 4)},
        "colours": colours if seen.selected is not None else None,
        "elapsed_ms": round(elapsed_ms, 3),
    }


def _numbers(s: Sighting | None) -> dict[str, object]:
    if s is None:
        names = "d_body_pad_level_m", "yaw_deg", "yaw_ambiguous", "cov", "centre_px"
        return {"confidence": 0.0, **dict.fromkeys(names)}
    centre = next((feature.uv_px[0] for feature in s.features if feature.label == CENTRE), None)
    return {
        "confidence": round(s.confidence, 4),
        "d_body_pad_level_m": [round(v, 6) for v in s.d_body_pad_level.tolist()],
        "yaw_deg": None if s.yaw_rad is None else round(math.degrees(s.yaw_rad), 5),
        "yaw_ambiguous": s.yaw_ambiguous,
        "cov": s.cov.ravel().tolist(),
        "centre_px": None if centre is None or not np.isfinite(centre).all() else np.round(centre, 2).tolist(),
    }


def _outlines(s: Sighting, image: _Image) -> list[dict[str, object]]:
    """Return the label and the points, as far as the lens projects them, of each part that has one in the frame."""
    parts: list[dict[str, object]] = []
    size = image.px.shape[1::-1]
    for feature in s.features:
        uv = feature.uv_px[np.isfinite(feature.uv_px).all(axis=1)]
        if feature.label != CENTRE and np.any(np.all((uv >= -0.5) & (uv < np.subtract(size, 0.5)), axis=1)):
            parts.append({"label": feature.label, "uv_px": np.round(uv, 2).tolist()})
    return parts


_HEADER = (
    f"{'source':<28} {'method':<12} {'forward':>9} {'right':>9} {'down':>9} m {'+-':>7} {'heading':>9} {'conf':>5} {'ms':>6}\n"
)


def _line(image: _Image, seen: Detection) -> str:
    name = Path(image.source).name
    name = name if image.index == 0 and Path(image.source).suffix.lower() not in VIDEOS | RECORDINGS else f"{name}#{image.index}"
    if seen.selected is None:
        return f"{name:<28} {'nothing':<12} {'':>49} {'':>5}"
    s = seen.selected
    x, y, z = s.d_body_pad_level.tolist()
    sigma = math.sqrt(float(np.trace(s.cov[:3, :3])))
    yaw = "-" if s.yaw_rad is None else f"{math.degrees(s.yaw_rad):.1f}" + ("?" if s.yaw_ambiguous else "")
    place = f"{x:9.3f} {y:9.3f} {z:9.3f}   {sigma:7.3f}"
    return f"{name:<28} {seen.chosen or '':<12} {place} {yaw:>9} {s.confidence:5.2f}"


def _is_image(path: Path) -> bool:
    return path.suffix.lower() in images.PICTURES


def _drawings(path: Path, files: Sequence[Path], *, force: bool) -> dict[Path, Path]:
    """Return what the frames of each file are drawn into: the image, or a folder and the beginning of their names.

    Raises:
        BadInput: several frames would be drawn into one file, or into files of one name, or a file would be overwritten.
    """
    if _is_image(path) and not (len(files) == 1 and _is_image(files[0])):
        raise BadInput(f"--draw {path}: an image file takes one image only: name a folder, each frame is drawn into a file there")
    if path.resolve() in [file.parent.resolve() for file in files]:
        raise BadInput(f"--draw {path}: the images to search are there: name another place, none of them is overwritten")
    stems = Counter(file.stem for file in files)
    names = {file: file.stem if stems[file.stem] == 1 else file.name for file in files}
    if len(set(names.values())) < len(files):
        raise BadInput(f"--draw {path}: two files to search differ in their folder only: draw them in separate runs")
    drawings = _DRAWINGS._replace(inside=tuple(f"{escape(name)}_[0-9]*.png" for name in names.values()))
    check_output(path, drawings, "--draw", list(files), force=force)
    return {file: path if _is_image(path) else path / f"{name}_" for file, name in names.items()}


def _draw(path: Path, image: _Image, seen: Detection, model: _Model) -> None:
    """Write the image at twice its size, with the features of every method drawn in and their figures below.

    Raises:
        BadInput: the file cannot be written.
    """
    camera, sightings = model.camera, [s for s in seen.methods.values() if s is not None]
    drawn = annotate(image.px, Overlay(tuple(sightings)), camera, model.pad, 2.0 if camera.width <= 1000 else 1.0)
    canvas = cv2.copyMakeBorder(drawn, 0, 44, 0, 0, cv2.BORDER_CONSTANT)
    figures = [f"{s.method} {np.round(s.d_body_pad_level, 3).tolist()} {s.confidence:.2f}" for s in sightings]
    for y, text, grey in ((16, _line(image, seen).rstrip(), 255), (36, "   ".join(figures), 200)):
        cv2.putText(canvas, text, (6, len(drawn) + y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (grey,) * 3, 1, cv2.LINE_AA)
    target = path if _is_image(path) else path.with_name(f"{path.name}{image.index:05d}.png")
    with file_errors(f"--draw {target}"):
        target.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(target), canvas):
        raise BadInput(f"--draw: cannot write {target}")
