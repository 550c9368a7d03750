"""The door to the built library: the only place of the estimator that loads a file.

The library lies beside this module. It has no state and allocates nothing, so any thread may call it. ctypes releases the
interpreter's lock for the time of a call.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.errors import SetupImpossible
from estimator.contracts.geometry import F64
from estimator.core.interface import FUNCTIONS, digest
from estimator.core.interface.describe import Function

FILE = f"{__file__.rpartition('/')[0]}/libdecklander.so.1"
"""Where `python -m supply.core` puts the library. Python would take a name that ends with ".so" for an extension module."""
_CURE = "build it: `make core` in a checkout, or install decklander again"
_TYPES = {
    "double": ctypes.c_double,
    "float": ctypes.c_float,
    "uint8_t": ctypes.c_uint8,
    "int32_t": ctypes.c_int32,
    "uint32_t": ctypes.c_uint32,
    "int64_t": ctypes.c_int64,
    "uint64_t": ctypes.c_uint64,
}


class Core:
    """The functions of one loaded library, by name."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library

    def function(self, name: str) -> Any:
        """Return a function with its types declared; pointers are given as addresses.

        Raises:
            KeyError: the interface has no such function.
        """
        found = next((function for function in FUNCTIONS if function.name == name), None)
        if found is None:
            raise KeyError(f"the core's interface has no function {name!r}")
        call = getattr(self._library, name)
        call.restype = _TYPES[found.result] if found.result != "void" else None
        call.argtypes = _parameter_types(found)
        return call


def _parameter_types(function: Function) -> list[Any]:
    if function.parameters == "void":
        return []
    return [
        ctypes.c_void_p if "*" in parameter else _TYPES[parameter.strip().partition(" ")[0]]
        for parameter in function.parameters.split(",")
    ]


def load(file: str = FILE) -> Core:
    """Load the library and hold it to the interface.

    Raises:
        SetupImpossible: it is missing, no library for this machine, or built for another interface.
    """
    try:
        library = ctypes.CDLL(file)
    except OSError as why:
        raise SetupImpossible(f"the native core {file} cannot be loaded ({why}); {_CURE}") from why
    try:
        library.core_digest.restype = ctypes.c_uint32
        found = int(library.core_digest())
    except AttributeError as why:
        raise SetupImpossible(f"{file} is not the native core; {_CURE}") from why
    if found != digest():
        raise SetupImpossible(
            f"the native core {file} was built for interface {found:08x}, this code needs {digest():08x}; {_CURE}"
        )
    return Core(library)


def address(array: F64) -> int:
    """Return the address of an array's first number, for a parameter of C type `double *`.

    Raises:
        TypeError: its numbers are not doubles in rows, one after the other.
    """
    if array.dtype != np.float64 or not array.flags.c_contiguous:
        raise TypeError(f"the core takes contiguous float64, not {array.dtype} of strides {array.strides}")
    return int(array.ctypes.data)


def start_of(block: NDArray[Any]) -> int:
    """Return the address of an array that was just made for the core to write to. It takes a fifth of the time of `address`."""
    return ctypes.addressof(ctypes.c_double.from_buffer(block.data))


CORE = load()
"""The library that flies."""
