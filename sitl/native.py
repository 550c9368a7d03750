"""The simulator's functions of the native core, and how arrays are given to them."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import DTypeLike, NDArray

from estimator.contracts.geometry import F64
from estimator.core.library import start_of
from sitl.core.library import SIM, places_of, size_of

render_average = SIM.function("render_average")
render_blur = SIM.function("render_blur")
render_bounds = SIM.function("render_bounds")
render_deck = SIM.function("render_deck")
render_expose = SIM.function("render_expose")
render_fill = SIM.function("render_fill")
render_frame = SIM.function("render_frame")
render_image = SIM.function("render_image")
render_meet = SIM.function("render_meet")
render_mix = SIM.function("render_mix")
render_pad_kinds = SIM.function("render_pad_kinds")
render_pad_lens = SIM.function("render_pad_lens")
render_pad_shares = SIM.function("render_pad_shares")
render_sea = SIM.function("render_sea")
render_shadow = SIM.function("render_shadow")
render_smear = SIM.function("render_smear")
render_swell = SIM.function("render_swell")
render_water = SIM.function("render_water")
sensors_read = SIM.function("sensors_read")
sim_run = SIM.function("sim_run")
vehicle_carry = SIM.function("vehicle_carry")
vehicle_step = SIM.function("vehicle_step")
vessel_mounted = SIM.function("vessel_mounted")
vessel_moved = SIM.function("vessel_moved")


_first_byte: Callable[[Any], Any] = ctypes.c_char.from_buffer


def address(array: NDArray[Any] | None, dtype: DTypeLike, shape: tuple[int, ...] | None = None) -> int:
    """Return the address of an array's first number, 0 for None.

    Raises:
        TypeError: its numbers are of another type or not in rows, one after the other, or its shape is another.
    """
    if array is None:
        return 0
    if array.dtype != dtype or not array.flags.c_contiguous or (shape is not None and array.shape != shape):
        raise TypeError(f"the core takes contiguous {np.dtype(dtype)} of shape {shape}, not {array.dtype} of shape {array.shape}")
    try:
        return ctypes.addressof(_first_byte(array))
    except (TypeError, ValueError):
        # The slow way, for arrays that are empty or not to be written to: most are neither.
        return int(array.__array_interface__["data"][0])


class Packed:
    """One structure of the core, in memory of our own.

    Args:
        name: of the structure in `decklander_sim.h`.
        values: its members by name; those that are left out are zero.

    Raises:
        KeyError: the structure has no such member.
        ValueError: a member has another length.
    """

    def __init__(self, name: str, **values: Any) -> None:
        self.words: F64 = np.zeros(size_of(name))
        self.buffer: memoryview = self.words.data
        self.address = start_of(self.words)
        write(self.words, name, **values)


def write(words: F64, name: str, **values: Any) -> None:
    """Write members of a structure whose words these are; errors as `Packed`."""
    places, integers = places_of(name), words.view(np.int64)
    for member, value in values.items():
        (integers if SIM.dtype(name)[member].base == np.int64 else words)[places[member]] = value


_T = TypeVar("_T", bound="Member")


class Member:
    """A member of a structure as an attribute of an object that holds the structure.

    Args:
        owner: name of the object's attribute with the `Packed` structure.
        name: of the structure and of its member, with a dot between.
    """

    def __init__(self, owner: str, name: str) -> None:
        of, _, member = name.partition(".")
        place = places_of(of)[member]
        kind = SIM.dtype(of)[member].base
        self._owner, self._at = owner, 8 * place.start
        self._layout = struct.Struct(f"{place.stop - place.start}{'q' if kind == np.int64 else 'd'}")

    def _read(self, owner: object) -> tuple[Any, ...]:
        return self._layout.unpack_from(getattr(owner, self._owner).buffer, self._at)

    def _write(self, owner: object, *values: float) -> None:
        self._layout.pack_into(getattr(owner, self._owner).buffer, self._at, *values)


class Number(Member):
    """A single number of the structure."""

    @overload
    def __get__(self: _T, owner: None, of: type) -> _T: ...
    @overload
    def __get__(self, owner: object, of: type) -> float: ...
    def __get__(self, owner: object | None, of: type) -> object:
        return self if owner is None else self._read(owner)[0]

    def __set__(self, owner: object, value: float) -> None:
        self._write(owner, value)


class Numbers(Member):
    """Several numbers of the structure."""

    @overload
    def __get__(self: _T, owner: None, of: type) -> _T: ...
    @overload
    def __get__(self, owner: object, of: type) -> tuple[float, ...]: ...
    def __get__(self, owner: object | None, of: type) -> object:
        return self if owner is None else self._read(owner)

    def __set__(self, owner: object, value: tuple[float, ...]) -> None:
        self._write(owner, *value)
