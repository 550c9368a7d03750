"""Read what a camera's flight left in plain files: the frames of a video and a table of attitudes.

Frames have the video's own time stamps; those of one without any (raw H.264, MJPEG) follow its frame rate.

A table is CSV with the header `time_s,roll_deg,pitch_deg` and, if the heading is known, `yaw_deg`.
"""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.camera.images import ImageRefused
from drivers.camera.videos import has_times, open_video, predicts_frames, video_of
from drivers.imports.stamps import FRAME_DELAY_S, Tell, attitude, quiet, stamp, timeline
from drivers.pyav import require_pyav
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Frame, Sample

HEADER = ("time_s", "roll_deg", "pitch_deg")


_PAUSE_S = 600.0
"""A video that goes on after a longer pause was not paused."""


def attitudes(path: Path, tell: Tell = quiet) -> list[Sample]:
    """Return the attitudes in order of time; one with an absurd time is left out, and reported.

    Raises:
        BadInput: the file cannot be read, a column is missing, or a cell is not a finite number; the text names the line.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as why:
        raise BadInput(f"{path}: {getattr(why, 'strerror', None) or why}") from why
    rows = csv.DictReader(lines, skipinitialspace=True, delimiter=";" if lines and ";" in lines[0] else ",")
    if missing := [name for name in HEADER if name not in (rows.fieldnames or [])]:
        raise BadInput(f"{path}: column {missing[0]!r} is missing; the header must be {','.join(HEADER)} and may have yaw_deg")
    table: list[tuple[float, float, float, float]] = []
    for row in rows:
        try:
            numbers = [float(row[name]) for name in HEADER] + [float(row.get("yaw_deg") or 0.0)]
        except (TypeError, ValueError) as why:
            raise BadInput(f"{path}, line {rows.line_num}: not a number: {why}") from why
        if not all(map(math.isfinite, numbers)):
            raise BadInput(f"{path}, line {rows.line_num}: not a finite number")
        table.append((numbers[0], numbers[1], numbers[2], numbers[3]))
    if not table:
        raise BadInput(f"{path}: holds no attitudes")
    table.sort()
    times = timeline([round(row[0] * 1e6) for row in table], tell)
    return [
        attitude(at_ns, Rotation.from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw)))
        for at_ns, (_, roll, pitch, yaw) in zip(times, table, strict=True)
        if at_ns is not None
    ]


def frames(path: Path, size: tuple[int, int] | None = None) -> Iterator[Frame]:
    """Yield every frame in order, the first at 0; a truncated file ends where it breaks off, and damaged frames are left out.

    Args:
        size: width and height that are expected; frames that are far larger are refused before they are decoded.

    Raises:
        BadInput: the file cannot be read, holds no video, or not one frame of it decodes.
    """
    require_pyav(f"{path}: a video")
    from av.error import FFmpegError

    try:
        container = open_video(str(path), size)
    except (FFmpegError, OSError, ImageRefused) as why:
        raise BadInput(f"{path}: not a readable video: {getattr(why, 'strerror', None) or why}") from why
    with container:
        if len(container.streams.video) == 0:
            raise BadInput(f"{path}: holds no video")
        last_s: float | None = None
        elapsed_s = 0.0
        stream = video_of(container, size)
        number, coded, timed = 0, predicts_frames(stream), has_times(container)
        rate_hz = float(stream.average_rate or 0.0) or 25.0
        try:
            for image in container.decode(stream):
                number += 1
                if image.is_corrupt:
                    continue
                time_s = float(image.time) if timed and image.time is not None else number / rate_hz
                step_s = 0.0 if last_s is None else time_s - last_s
                # The times of cut and joined videos begin again or leap: the next frame comes a frame later.
                elapsed_s += step_s if 0.0 <= step_s <= _PAUSE_S else 1.0 / rate_hz
                last_s = time_s
                px = np.asarray(image.to_ndarray(format="bgr24"), dtype=np.uint8)
                yield Frame(stamp(round(elapsed_s * 1e9), FRAME_DELAY_S), number, px, coded=coded)
        except FFmpegError as why:
            if number == 0:
                raise BadInput(f"{path}: no frame of it decodes: {why}") from why
        if number == 0:
            raise BadInput(f"{path}: no frame of it decodes")
