"""Read a table of attitudes: CSV with the header `time_s,roll_deg,pitch_deg` and, if the heading is known, `yaw_deg`."""

import csv
import math
from pathlib import Path

from drivers.imports.stamps import attitude
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Sample

HEADER = ("time_s", "roll_deg", "pitch_deg")


def read(path: Path) -> list[Sample]:
    """Return the attitudes in order of time.

    Raises:
        BadInput: the file cannot be read, a column is missing, or a cell is not a finite number; the text names the line.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as why:
        raise BadInput(f"{path}: {getattr(why, 'strerror', None) or why}") from why
    rows = csv.DictReader(lines)
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
    first_s = table[0][0]
    return [
        attitude(round((t - first_s) * 1e9), Rotation.from_rpy(math.radians(roll), math.radians(pitch), math.radians(yaw)))
        for t, roll, pitch, yaw in table
    ]
