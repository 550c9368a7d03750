"""The door to the library of the simulator. A service that flies does not load it."""

from typing import Any, TypeVar, overload

from estimator.core.library import Door
from sitl.core import abi

FILE = f"{__file__.rpartition('/')[0]}/libdecklander_sim.so.1"
"""Path of the library that `python -m supply.core` builds."""

SIM = Door(abi, FILE)
"""The library that simulates."""


_T = TypeVar("_T", bound="Member")


class Member:
    """A member of a structure.

    Args:
        owner: name of the object's attribute with the structure.
        name: of the member.
    """

    def __init__(self, owner: str, name: str) -> None:
        self._owner, self._name = owner, name

    def _read(self, owner: object) -> Any:
        return getattr(getattr(owner, self._owner), self._name)

    def __set__(self, owner: object, value: object) -> None:
        setattr(getattr(owner, self._owner), self._name, value)


class Number(Member):
    """A single number of the structure."""

    @overload
    def __get__(self: _T, owner: None, of: type) -> _T: ...
    @overload
    def __get__(self, owner: object, of: type) -> float: ...
    def __get__(self, owner: object | None, of: type) -> object:
        return self if owner is None else self._read(owner)


class Numbers(Member):
    """Several numbers of the structure."""

    @overload
    def __get__(self: _T, owner: None, of: type) -> _T: ...
    @overload
    def __get__(self, owner: object, of: type) -> tuple[float, ...]: ...
    def __get__(self, owner: object | None, of: type) -> object:
        return self if owner is None else tuple(self._read(owner))
