"""Log of the truth, one JSON object a line, in instants of the simulating host's monotonic clock.

Another process of the same host reads the same clock, so its own stamps compare directly.
"""

from __future__ import annotations

import json
import math
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from msgspec import Struct

from estimator.contracts.errors import BadInput, refused
from estimator.contracts.geometry import Rotation
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Touchdown, Truth


def record(truth: Truth) -> dict[str, Any]:
    """Return the record of one instant.

    Its keys are `at_ns`, `phase`, `d_body_pad_level_m`, `v_pad_level_m_s`, `yaw_rad`, both bodies' `p_*_ned_m`, `v_*_ned_m_s` and
    `quat_ned_*_wxyz`, `contacts` (all so far, with the fields of `sitl.world.truth.Touchdown`), and `touchdown`, the newest of
    them or null.
    """
    return {
        "at_ns": int(truth.at),
        "phase": truth.phase.name.lower(),
        "d_body_pad_level_m": _plain(truth.d_body_pad_level),
        "v_pad_level_m_s": _plain(truth.v_pad_level),
        "yaw_rad": _plain(truth.yaw_rad),
        "p_body_ned_m": _plain(truth.p_body_ned),
        "v_body_ned_m_s": _plain(truth.v_body_ned),
        "quat_ned_body_wxyz": _plain(truth.R_ned_body),
        "p_pad_ned_m": _plain(truth.p_pad_ned),
        "v_pad_ned_m_s": _plain(truth.v_pad_ned),
        "quat_ned_pad_wxyz": _plain(truth.R_ned_pad),
        "touchdown": _contact(truth.touchdown),
        "contacts": [_contact(contact) for contact in truth.contacts],
    }


class TruthLog:
    """Writes records, each at once, so that another process can follow; a context manager that closes the file.

    Raises:
        BadInput: the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        with refused(f"truth log {path}", OSError):
            self._file: IO[str] = path.open("w", encoding="utf-8", buffering=1)

    def write(self, truth: Truth) -> None:
        self._file.write(json.dumps(record(truth), separators=(",", ":")) + "\n")

    def __enter__(self) -> TruthLog:
        return self

    def __exit__(self, kind: type[BaseException] | None, why: BaseException | None, where: TracebackType | None) -> None:
        self._file.close()


def read(path: Path) -> list[dict[str, Any]]:
    """All records of a file, in order; a line cut short by the end of its writer is left out.

    Raises:
        BadInput: no such file, or a line that is no record.
    """
    with refused(f"truth log {path}", OSError):
        lines = path.read_text(encoding="utf-8").split("\n")
    out: list[dict[str, Any]] = []
    for number, line in enumerate(lines[:-1], start=1):
        try:
            value = json.loads(line)
        except json.JSONDecodeError as why:
            raise BadInput(f"truth log {path}, line {number}: {why.msg}") from why
        if not isinstance(value, dict) or "at_ns" not in value:
            raise BadInput(f"truth log {path}, line {number}: not a record of truth")
        out.append(value)
    return out


def contact_of(kept: dict[str, Any]) -> Touchdown:
    """Return a contact from the form in which records hold it."""
    fields = {name: kept[name] for name in Touchdown.__struct_fields__}
    return Touchdown(**fields | {"p_body_pad": np.array(kept["p_body_pad"]), "phase": VehiclePhase[kept["phase"].upper()]})


def _contact(contact: Touchdown | None) -> Any:
    return None if contact is None else {**_plain(contact), "on_pad": contact.on_pad}


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold; a number that is not finite (nan before any contact) becomes null."""
    if isinstance(value, Rotation):
        value = value.quat_wxyz
    if isinstance(value, np.ndarray):
        return [_plain(v) for v in value.tolist()]
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, float | np.floating):
        return round(float(value), 8) if math.isfinite(value) else None
    if isinstance(value, np.integer | np.bool_):
        return value.item()
    if isinstance(value, Struct):
        return {name: _plain(getattr(value, name)) for name in value.__struct_fields__}
    if isinstance(value, tuple | list):
        return [_plain(v) for v in value]
    return value
