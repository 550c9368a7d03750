"""Check and show numbers from a TOML file, which may be of any size or of another type altogether."""

import math

_LONGEST = 80


def finite(value: object) -> float | None:
    """Return the value as a float; None if it is not a number, not finite, or an integer too large for a float."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def shown(value: object) -> str:
    """Return the value as one line of bounded length for an error's text."""
    try:
        text = repr(value)
    except ValueError:  # Python refuses to write out an integer of more than 4300 digits.
        return "a number of thousands of digits"
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."
