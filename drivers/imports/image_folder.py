"""Read a folder of images as frames, at the times that a table in the folder or their names give.

A table is a text file (`.csv`, `.txt`) whose lines pair a time with a file's name, in either order, as data sets of robotics have
them. Without one, the last number of a name is the time. A number of 10, 13, 16 or 19 digits is Unix time in s, ms, us or ns; a
smaller one is seconds, unless the head of its column states a unit.
"""

import math
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from drivers.camera.images import PICTURES, ImageRefused, decode, load
from drivers.imports.stamps import FRAME_DELAY_S, Tell, quiet, stamp, timeline
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame

_UNITS_US = {"s": 10**6, "ms": 10**3, "us": 1, "ns": 10**-3}
_BY_DIGITS = {10: "s", 13: "ms", 16: "us", 19: "ns"}
_UNIT = re.compile(r"[\[(_ ](s|ms|us|ns)[\])]?$")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_TABLE_MOST = 64 << 20
_UNIX_DIGITS = 10
"""A name's number with fewer digits before its point is a counter, and no time."""


def frames(folder: Path, size: tuple[int, int] | None = None, tell: Tell = quiet) -> Iterator[Frame]:
    """Yield the images of a folder in order of time, the first at 0. Damaged ones are left out, and reported.

    Args:
        size: width and height that they must have; None allows any.

    Raises:
        BadInput: the folder cannot be read or holds no image, nothing gives their times, or not one of them can be used.
    """
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURES and path.is_file())
        tables = sorted(path for path in folder.iterdir() if path.suffix.lower() in (".csv", ".txt") and path.is_file())
    except OSError as why:
        raise BadInput(f"{folder}: {why.strerror or why}") from why
    if not paths:
        raise BadInput(f"{folder}: holds no image")
    times = next((found for table in tables if (found := _of_table(table, paths))), None) or _of_names(paths)
    if times is None:
        raise BadInput(
            f"{folder}: neither a table nor the names of its images tell their times: put a table into it, "
            "times.csv with the header time_s,source and a line for each image"
        )
    if unnamed := [path for path in paths if path.name not in times]:
        tell(f"{len(unnamed)} of {len(paths)} images have no time and are left out, {unnamed[0].name} first")
    ordered = sorted((path for path in paths if path.name in times), key=lambda path: (times[path.name], path.name))
    yield from _decoded(folder, ordered, [times[path.name] for path in ordered], size, tell)


def _decoded(
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
            px = decode(load(path), size)
        except (ImageRefused, OSError) as why:
            refused.append(f"{path.name}: {why}")
            continue
        given, before = given + 1, at_us
        yield Frame(stamp(at_ns, FRAME_DELAY_S), number, px)
    if refused:
        if not given:
            raise BadInput(f"{folder}: not one of its images can be used: {refused[0]}")
        tell(f"{len(refused)} of {len(paths)} images cannot be used and are left out: {refused[0]}")


def _of_table(table: Path, paths: Sequence[Path]) -> dict[str, int]:
    """Return the time of each image that a table names, us; nothing if it is no such table."""
    try:
        if table.stat().st_size > _TABLE_MOST:
            return {}
        lines = table.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    names, unit = {path.name for path in paths}, ""
    found: dict[str, str] = {}
    for line in lines:
        cells = [cell.strip().strip('"') for cell in re.split(r"[,;\t]| +(?![\[(])", line.strip().lstrip("#").strip())]
        named = next((name for cell in cells if (name := cell.replace("\\", "/").rpartition("/")[2]) in names), None)
        number = next((cell for cell in cells if _NUMBER.fullmatch(cell)), None)
        if named is not None and number is not None:
            found.setdefault(named, number)
        elif not found:
            unit = next((hit[1] for cell in cells if (hit := _UNIT.search(cell))), unit)
    return _in_us(found, unit)


def _of_names(paths: Sequence[Path]) -> dict[str, int] | None:
    """Return the times in the names, us; None if one name has none, or only a counter."""
    found = {path.name: numbers[-1] for path in paths if (numbers := _NUMBER.findall(path.stem))}
    if len(found) < len(paths) or any(len(text.partition(".")[0]) < _UNIX_DIGITS for text in found.values()):
        return None
    return _in_us(found, "")


def _in_us(texts: dict[str, str], unit: str) -> dict[str, int]:
    out = {}
    for name, text in texts.items():
        whole, _, fraction = text.partition(".")
        scale = _UNITS_US[unit or _BY_DIGITS.get(len(whole.lstrip("0")), "s")]
        # A float would lose the last digits of a Unix time.
        value = int(whole) * scale if scale >= 1 else int(whole) // 1000
        value += round(float(f"0.{fraction}") * scale) if fraction and scale >= 1 else 0
        if math.isfinite(value) and value < 2**62:
            out[name] = int(value)
    return out
