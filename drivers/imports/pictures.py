"""Read frames of plain files, a folder of images or a video, and a table of attitudes.

A folder's times are those of a table in it, or of its images' names. A table is a text file (`.csv`, `.txt`) whose lines pair a
time with a file's name, as data sets of robotics have them. Of several columns of numbers the one counts whose head says time,
else the one of Unix times beside the name. Without a table, a date and time of day in a name is the time, else its last number.
A number of 10, 13, 16 or 19 digits is Unix time in s, ms, us or ns; a smaller one is seconds, unless the head of its column
states a unit. Frames of a video have its own time stamps; those of one without any (raw H.264, MJPEG) follow its frame rate.

A table of attitudes is CSV with the header `time_s,roll_deg,pitch_deg` and, if the heading is known, `yaw_deg`.
"""

import csv
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from decimal import ROUND_HALF_EVEN, Decimal, InvalidOperation
from itertools import pairwise
from pathlib import Path

from drivers.camera.images import PICTURES, ImageRefused, decode
from drivers.camera.videos import frames_of, has_times, open_video, predicts_frames, video_of
from drivers.files import Largest, bytes_of, refuse_special, seen_in
from drivers.log_stamps import FRAME_DELAY_S, Tell, attitude, quiet, stamp, timeline
from drivers.pyav import require_pyav
from estimator.contracts.errors import BadInput, DecklanderError, refused
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.text import text_of

_UNITS_US = {"s": Decimal(10**6), "ms": Decimal(1000), "us": Decimal(1), "ns": Decimal("0.001")}
_BY_DIGITS = {10: "s", 13: "ms", 16: "us", 19: "ns"}
_UNIT = re.compile(r"(?:^|[\[(_ ])(m|u|n)?s(?:ec|ecs|econds)?[\])]?$")
_TIME = re.compile(r"time|stamp|^t\b|^(?:[mun]?s|[mun]?secs?|seconds)$")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_UNIX_DIGITS = 10  # digits of a Unix time in seconds
_DATE = re.compile(
    r"(?<!\d)(?:19|20)\d\d[-_.]?\d\d[-_.]?\d\d[-_.T ]?\d\d[-_.:h]?\d\d[-_.:m]?\d\d(?:[.,]\d+|\d{3}|\d{6,9})?(?!\d)"
)
_PAUSE_S = 600.0
"""A video that goes on after a longer pause was not paused."""


def folder_frames(folder: Path, size: tuple[int, int] | None = None, tell: Tell = quiet) -> Iterator[Frame]:
    """Yield the images of a folder in order of time, the first at 0. Damaged ones are left out, and reported.

    Args:
        size: width and height that they must have; None allows any.

    Raises:
        BadInput: the folder cannot be read or holds no image, nothing gives their times, or not one of them can be used.
    """
    paths, tables = _images_and_tables(folder)
    times = next((found for table in tables if (found := _of_table(table, paths, tell))), None) or _of_names(paths)
    if times is None:
        raise BadInput(
            f"{folder}: neither a table nor the names of its images tell their times: put a table into it, "
            "times.csv with the header time_s,source and a line for each image"
        )
    if unnamed := [path for path in paths if path.name not in times]:
        tell(f"{len(unnamed)} of {len(paths)} images have no time and are left out, {unnamed[0].name} first")
    ordered = sorted((path for path in paths if path.name in times), key=lambda path: (times[path.name], path.name))
    yield from _decode(folder, ordered, [times[path.name] for path in ordered], size, tell)


def _images_and_tables(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the images and the tables of a folder.

    Raises:
        BadInput: it cannot be read or holds no image.
    """

    def images(within: Iterable[Path]) -> list[Path]:
        return [path for path in within if path.suffix.lower() in PICTURES]

    with refused(str(folder), OSError):
        inside = seen_in(folder)
        below = [each for each in folder.iterdir() if each.is_dir() and images(seen_in(each))]
    if not (paths := images(inside)):
        raise BadInput(f"{folder}: holds no image" + (f", {min(below)} does: give that folder" if below else ""))
    return paths, [path for path in inside if path.suffix.lower() in (".csv", ".txt")]


def _decode(
    folder: Path, paths: Sequence[Path], times_us: list[int], size: tuple[int, int] | None, tell: Tell
) -> Iterator[Frame]:
    if twice := sum(a == b for a, b in pairwise(times_us)):
        tell(f"{twice} of {len(paths)} images have the time of the one before and are left out")
    refused: list[str] = []
    given, before = 0, None
    for number, (path, at_us, at_ns) in enumerate(zip(paths, times_us, timeline(times_us, tell), strict=True)):
        if at_ns is None or at_us == before:
            continue
        try:
            px = decode(bytes_of(path, Largest.PICTURE, path.name), size)
        except (ImageRefused, DecklanderError) as why:
            refused.append(f"{path.name}: {why}" if isinstance(why, ImageRefused) else str(why))
            continue
        given, before = given + 1, at_us
        yield Frame(stamp(at_ns, FRAME_DELAY_S), number, px)
    if refused:
        if not given:
            raise BadInput(f"{folder}: not one of its images can be used: {refused[0]}")
        tell(f"{len(refused)} of {len(paths)} images cannot be used and are left out: {refused[0]}")


def _of_table(table: Path, paths: Sequence[Path], tell: Tell) -> dict[str, int]:
    """Return the time of each image that a table names, us; nothing if it is no such table. Lines without use are reported.

    Raises:
        BadInput: it names the images, and which of its columns is the time is not clear.
    """
    try:
        lines = text_of(bytes_of(table, Largest.TABLE), str(table)).splitlines()
    except DecklanderError:
        return {}
    names = {path.name for path in paths}
    head, rows = _rows_of(lines, names, table.name, tell)
    if not rows:
        return {}
    width = len(next(iter(rows.values())))
    rows = {name: cells for name, cells in rows.items() if len(cells) == width}
    head = head if len(head) == width else [""] * width
    numbers = [k for k in range(width) if 2 * sum(_value(cells[k]) is not None for cells in rows.values()) > len(rows)]
    if not numbers:
        return {}
    column = _column_of_time(table, numbers, head, next(iter(rows.values())), names)
    unit = f"{found[1] or ''}s" if (found := _UNIT.search(head[column])) else ""
    values = {name: _value(cells[column]) for name, cells in rows.items()}
    return {name: at_us for name, value in values.items() if value is not None and (at_us := _in_us(value, unit)) is not None}


def _rows_of(lines: Sequence[str], names: set[str], table: str, tell: Tell) -> tuple[list[str], dict[str, list[str]]]:
    """Return the head of a table's columns, and the cells of each image's line."""
    head, rows, absent, twice = list[str](), dict[str, list[str]](), list[str](), list[str]()
    for line in lines:
        cells = _cells(line)
        files = [cell.replace("\\", "/").rpartition("/")[2] for cell in cells if cell.lower().endswith(tuple(PICTURES))]
        named = next((name for name in files if name in names), None)
        if named is not None:
            twice += [named] if named in rows else []
            rows.setdefault(named, cells)
        elif files:
            absent.append(files[0])
        elif not rows:
            head = [cell.lower() for cell in cells]
    for left, why in ((absent, "is not in the folder"), (twice, "has a line above, which counts")):
        if left and rows:
            tell(f"{len(left)} of {len(lines)} lines of {table} are left out: {left[0]} {why}")
    return head, rows


def _cells(line: str) -> list[str]:
    text = line.strip().lstrip("#").strip()
    parts = next((text.split(mark) for mark in (";", "\t", ",") if mark in text), None) or re.split(r" +(?![\[(])", text)
    return [cell.strip().strip('"') for cell in parts]


def _value(cell: str) -> Decimal | datetime | None:
    """Return a cell's number, with a point or a comma for decimals, or its date and time; None if it is neither."""
    with suppress(InvalidOperation):
        number = Decimal(cell.replace(",", "."))
        return number if number.is_finite() and abs(number) < 2**62 else None
    with suppress(ValueError):
        return datetime.fromisoformat(cell)
    return None


def _column_of_time(table: Path, numbers: list[int], head: list[str], row: list[str], names: set[str]) -> int:
    named_times = [k for k in numbers if _TIME.search(head[k])]
    named = next(k for k, cell in enumerate(row) if cell.replace("\\", "/").rpartition("/")[2] in names)
    dated = [
        k for k in numbers if isinstance(at := _value(row[k]), datetime) or (at is not None and at >= 10 ** (_UNIX_DIGITS - 1))
    ]
    for columns in (named_times, numbers, dated, [k for k in named_times or dated if abs(k - named) == 1][:1]):
        if len(columns) == 1:
            return columns[0]
    raise BadInput(
        f"{table}: {len(numbers)} columns of numbers beside the images' names, and no head says which is their time: write "
        "time_s above it"
    )


def _of_names(paths: Sequence[Path]) -> dict[str, int] | None:
    """Return the times in the names, us; None if one name has none, or only a counter."""
    out = {}
    for path in paths:
        text = (_NUMBER.findall(path.stem) or [""])[-1]
        whole = text.partition(".")[0]
        at_us = None
        if date := _DATE.search(path.stem):
            digits = re.sub(r"\D", "", date[0])
            with suppress(ValueError):  # no such day
                at_us = _in_us(datetime.strptime(f"{digits[:14]}.{digits[14:20] or 0}", "%Y%m%d%H%M%S.%f"), "")
        elif len(whole) in _BY_DIGITS and not whole.startswith("0"):
            at_us = _in_us(Decimal(text), "")
        if at_us is None:
            return None
        out[path.name] = at_us
    return out


def _in_us(value: Decimal | datetime, unit: str) -> int | None:
    """Return a time in us; None if it is out of range."""
    if isinstance(value, datetime):
        value, unit = Decimal(repr(value.replace(tzinfo=value.tzinfo or UTC).timestamp())), "s"
    # A float would lose the last digits of a Unix time.
    scaled = value * _UNITS_US[unit or _BY_DIGITS.get(len(str(abs(int(value)))), "s")]
    return int(scaled.to_integral_value(ROUND_HALF_EVEN)) if abs(scaled) < 2**62 else None


HEADER = ("time_s", "roll_deg", "pitch_deg")


def _numbers_of(row: Mapping[str, str], where: str) -> list[float]:
    """Return a row's time, s, and its roll, pitch and yaw, degrees. Raises BadInput."""
    with refused(f"{where}: not a number", TypeError, ValueError):
        numbers = [float(row[name]) for name in HEADER] + [float(row.get("yaw_deg") or 0.0)]
    if not all(map(math.isfinite, numbers)):
        raise BadInput(f"{where}: not a finite number")
    if any(abs(angle_deg) > 360.0 for angle_deg in numbers[1:]):
        raise BadInput(f"{where}: an angle beyond 360 degrees: the table has other units")
    return numbers


def attitudes(path: Path, tell: Tell = quiet) -> list[Sample]:
    """Return the attitudes in order of time; one with an absurd time is left out, and reported.

    Raises:
        BadInput: the file cannot be read, a column is missing, or a cell is no number or angle; the text names the line.
    """
    lines = text_of(bytes_of(path, Largest.TABLE), str(path)).splitlines()
    rows = csv.DictReader(lines, skipinitialspace=True, delimiter=";" if lines and ";" in lines[0] else ",")
    if missing := [name for name in HEADER if name not in (rows.fieldnames or [])]:
        raise BadInput(f"{path}: column {missing[0]!r} is missing; the header must be {','.join(HEADER)} and may have yaw_deg")
    table, twice = dict[float, list[float]](), 0
    for row in rows:
        numbers = _numbers_of(row, f"{path}, line {rows.line_num}")
        twice += numbers[0] in table
        table.setdefault(numbers[0], numbers)
    if not table:
        raise BadInput(f"{path}: holds no attitudes")
    if twice:
        tell(f"{twice} of {twice + len(table)} lines have the time of one above and are left out")
    times = timeline([round(time_s * 1e6) for time_s in sorted(table)], tell)
    return [
        attitude(at_ns, Rotation.from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw)))
        for at_ns, (_, roll, pitch, yaw) in zip(times, sorted(table.values()), strict=True)
        if at_ns is not None
    ]


def video_frames(path: Path, size: tuple[int, int] | None = None) -> Iterator[Frame]:
    """Yield every frame in order, the first at 0; a truncated file ends where it breaks off, and damaged frames are left out.

    Args:
        size: width and height that are expected; frames that are far larger are refused before they are decoded.

    Raises:
        BadInput: the file cannot be read, holds no video, or not one frame of it decodes.
    """
    require_pyav(f"{path}: a video")
    from av.error import FFmpegError

    with refused(f"{path}: not a readable video", FFmpegError, OSError, ImageRefused):
        refuse_special(path, Largest.RECORDING)
        container = open_video(str(path), size)
    with container:
        if len(container.streams.video) == 0:
            raise BadInput(f"{path}: holds no video")
        last_s: float | None = None
        stream = video_of(container, size)
        elapsed_s, coded, timed = 0.0, predicts_frames(stream), has_times(container)
        number = 0
        rate_hz = float(stream.average_rate or 0.0) or 25.0
        try:
            for before, image, px in frames_of(container, stream):
                number = before + 1
                if px is None:
                    continue
                time_s = float(image.time) if timed and image.time is not None else number / rate_hz
                step_s = 0.0 if last_s is None else time_s - last_s
                # The times of cut and joined videos begin again or leap: the next frame comes a frame later.
                elapsed_s += step_s if 0.0 <= step_s <= _PAUSE_S else 1.0 / rate_hz
                last_s = time_s
                yield Frame(stamp(round(elapsed_s * 1e9), FRAME_DELAY_S), number, px, coded=coded)
        except ImageRefused as why:
            raise BadInput(f"{path}: {why}") from why
        except FFmpegError as why:
            if number == 0:
                raise BadInput(f"{path}: no frame of it decodes: {why}") from why
        if number == 0:
            raise BadInput(f"{path}: no frame of it decodes")
