"""Structures of the native core in memory of ours: written from nested values, once for what stays, and read by offset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64
from estimator.core.interface import STRUCTS, places_of, size_of


def record(name: str, values: Mapping[str, Any]) -> F64:
    """Return the words of a structure.

    Args:
        name: of the structure in `estimator.core.interface`.
        values: its members by name: a number, an array, a mapping for a structure, or a sequence of mappings; those that are left
            out are zero, as are the elements after those given.

    Raises:
        KeyError: the structure has no such member.
        ValueError: a member has more elements than the structure.
    """
    words = np.zeros(size_of(name))
    _write(words, name, values)
    return words


def _write(words: F64, name: str, values: Mapping[str, Any]) -> None:
    places, members = places_of(name), {member.name: member for member in STRUCTS[name]}
    for key, value in values.items():
        place, member = words[places[key]], members[key]
        if member.type in STRUCTS:
            each: Sequence[Mapping[str, Any]] = [value] if isinstance(value, Mapping) else value
            size = size_of(member.type)
            if len(each) > member.length:
                raise ValueError(f"{name}.{key} holds {member.length} of {member.type}, not {len(each)}")
            for i, one in enumerate(each):
                _write(place[i * size : (i + 1) * size], member.type, one)
            continue
        numbers = np.ravel(value)
        if len(numbers) > member.length:
            raise ValueError(f"{name}.{key} holds {member.length} numbers, not {len(numbers)}")
        (place.view(np.int64) if member.type == "int64_t" else place)[: len(numbers)] = numbers
