"""Functions inside of the native core that are no entries of the library, called by themselves."""

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from cffi import FFI

from estimator.core.library import CORE, Door
from supply.core import FLYING

_HEADERS = (
    "base/kalman.h", "filter/belief.h", "filter/propagate.h", "filter/sighting.h", "filter/bank.h",
    "filter/bank_ahead.h", "filter/filter.h",
)  # fmt: skip
PARTS = FFI()
"""The types of the header and of the parts' own headers."""
for _header in (FLYING.header, *(FLYING.header.parent / name for name in _HEADERS)):
    PARTS.cdef(re.sub(r"^#.*$", "", _header.read_text(), flags=re.MULTILINE))


def part(name: str) -> Callable[..., Any]:
    """Return a function; arrays that it is given are passed as pointers to their first element."""

    def call(*values: Any) -> Any:
        entry = getattr(_opened(CORE.file), name)
        kinds = PARTS.typeof(entry).args
        return entry(*(_passed(kind, value) for kind, value in zip(kinds, values, strict=True)))

    return call


@cache
def _opened(file: Any) -> Any:
    return PARTS.dlopen(file)


def _passed(kind: Any, value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    assert value.flags.c_contiguous
    return PARTS.cast(kind, value.ctypes.data)


class _Parts:
    ffi, DIGEST = PARTS, CORE._digest


PARTS_DOOR = Door(_Parts, CORE.file)  # type: ignore[arg-type]
"""A door to the library with the structures of the parts' own headers."""
