"""Tables: of a machine's states and events, total and checked where it is made; of names, loaded where they are wanted.

Source: ``_state.py`` of h11 for the form of the first: one table in one file, total.
"""

from collections.abc import Iterator, Mapping
from enum import Enum
from importlib import import_module
from types import MappingProxyType
from typing import Any, TypeVar

S = TypeVar("S", bound=Enum)
E = TypeVar("E", bound=Enum)


def total(rows: Mapping[S, Mapping[E, S]], events: type[E]) -> Mapping[S, Mapping[E, S]]:
    """Return the table with every pair: an event that a row does not name leaves the state as it is.

    Raises:
        ValueError: a state has no row, or a row names an event that leads nowhere else.
    """
    table: dict[S, Mapping[E, S]] = {}
    for state in type(next(iter(rows))):
        if state not in rows:
            raise ValueError(f"{state}: no row says what follows")
        if idle := [event for event, target in rows[state].items() if target is state]:
            raise ValueError(f"{state}: {idle[0]} leads nowhere else, so the row must not name it")
        table[state] = MappingProxyType({event: rows[state].get(event, state) for event in events})
    return MappingProxyType(table)


def next_states(row: Mapping[E, S], usual: Mapping[E, S | None]) -> Iterator[tuple[S, list[E]]]:
    """Yield each state to which events of a row lead otherwise than usual, with these events."""
    ways: dict[S, list[E]] = {}
    for event, target in row.items():
        if target is not usual[event]:
            ways.setdefault(target, []).append(event)
    yield from ways.items()


def imported(name: str) -> Any:
    """Return the object that module:object names, or the module that a name alone does."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute) if attribute else import_module(module)
