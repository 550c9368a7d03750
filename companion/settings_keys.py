"""How a key of the settings is declared: its meaning, unit, range and the source of its default, in one line."""

from __future__ import annotations

from msgspec import Meta


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


def _notes(unit: str, source: str) -> dict[str, str] | None:
    return {name: note for name, note in (("x-unit", unit), ("x-source", source)) if note} or None
