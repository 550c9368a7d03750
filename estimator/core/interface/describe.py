"""Describe members of structures and functions of the native core."""

from __future__ import annotations

from typing import NamedTuple


class Field(NamedTuple):
    """A member of a structure: an integer, a double, another structure, or an array of one of them."""

    name: str
    type: str
    length: int = 1


def doubles(**lengths: int) -> tuple[Field, ...]:
    """Return members that are doubles, by their lengths."""
    return tuple(Field(name, "double", length) for name, length in lengths.items())


def integers(*names: str) -> tuple[Field, ...]:
    """Return members that are one integer each."""
    return tuple(Field(name, "int64_t") for name in names)


class Function(NamedTuple):
    """One function of the library."""

    name: str
    result: str
    """Its C type."""
    parameters: str
    """Its C parameters, as in a prototype."""
    source: str
    """The file that defines it."""
