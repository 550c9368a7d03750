"""Numbers as a TOML file may hold them: of any size, and of any other type."""

from __future__ import annotations

import math

_LONGEST = 80


def finite(value: object) -> float | None:
    """The value as a float; None for what is no number, not finite, or an integer too large for a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def shown(value: object) -> str:
    """The value for an error's text, in one line of bounded length."""
    try:
        text = repr(value)
    except ValueError:  # Python writes out no integer of more than 4300 digits
        return "a number of thousands of digits"
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."
