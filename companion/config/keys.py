"""How a key of the settings is declared: its meaning, unit, range and the source of its default, in one line."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from msgspec import Meta, Struct, structs

CREDENTIAL = "credential:"
"""Before the name of a systemd credential, where a path might stand."""
_Table = TypeVar("_Table", bound=Struct)


def number(meaning: str, unit: str, low: float, high: float, source: str = "") -> Meta:
    """A key that holds a number in `unit` ("1" for a ratio), from `low` to `high`, both included."""
    return Meta(ge=low, le=high, description=meaning, extra_json_schema=_notes(unit, source))


def text(meaning: str, longest: int, source: str = "", shortest: int = 1) -> Meta:
    """A key that holds text of `shortest` to `longest` characters."""
    return Meta(min_length=shortest, max_length=longest, description=meaning, extra_json_schema=_notes("", source))


def name(meaning: str, longest: int, source: str = "") -> Meta:
    """A key that holds one word of letters, digits, - and _."""
    return Meta(
        pattern=rf"^[A-Za-z0-9_-]{{1,{longest}}}(?!\n)$",
        min_length=1,
        max_length=longest,
        description=meaning,
        extra_json_schema=_notes("", source),
    )


def choice(meaning: str, source: str = "") -> Meta:
    """A key that holds one of the words of its Literal."""
    return Meta(description=meaning, extra_json_schema=_notes("", source))


def anchored(table: _Table, base: Path, keys: Iterable[str]) -> _Table:
    """The same table with the relative paths in `keys` made to hold from the working directory; `base` is the settings file's."""
    given = {key: str(getattr(table, key)) for key in keys}
    return structs.replace(
        table, **{key: str(base / path) for key, path in given.items() if path and not path.startswith(CREDENTIAL)}
    )


def on_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`. A name other than localhost may mean any address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _notes(unit: str, source: str) -> dict[str, str] | None:
    return {name: note for name, note in (("x-unit", unit), ("x-source", source)) if note} or None
