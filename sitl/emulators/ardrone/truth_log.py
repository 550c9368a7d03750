"""Log of the truth: on each line the fields of `sitl.world.truth.Truth` as JSON, in instants of the host's monotonic clock.

Another process of the same host reads the same clock, so its own stamps compare directly.
"""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from msgspec import MsgspecError, json

from estimator.contracts.errors import refused
from estimator.contracts.geometry import Rotation
from sitl.world.truth import Truth


class TruthLog:
    """Writes the truth, each at once, so that another process can follow; a context manager that closes the file.

    Raises:
        BadInput: the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        with refused(f"truth log {path}", OSError):
            self._file = path.open("wb", buffering=0)

    def write(self, truth: Truth) -> None:
        self._file.write(json.encode(truth, enc_hook=_plain) + b"\n")

    def __enter__(self) -> TruthLog:
        return self

    def __exit__(self, kind: type[BaseException] | None, why: BaseException | None, where: TracebackType | None) -> None:
        self._file.close()


def read(path: Path) -> list[Truth]:
    """Return the truth of each line, in order; a line cut short by the end of its writer is left out.

    Raises:
        BadInput: no such file, or a line that is no truth.
    """
    with refused(f"truth log {path}", OSError):
        lines = path.read_bytes().split(b"\n")
    out: list[Truth] = []
    for number, line in enumerate(lines[:-1], start=1):
        with refused(f"truth log {path}, line {number}", MsgspecError):
            out.append(LINE.decode(line))
    return out


def _plain(value: Any) -> Any:
    return value.matrix.tolist() if isinstance(value, Rotation) else value.tolist()


def _array(kind: type, value: Any) -> Any:
    return Rotation(np.array(value)) if kind is Rotation else np.array(value, float)


LINE = json.Decoder(Truth, dec_hook=_array)  # decodes a line
