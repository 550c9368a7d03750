"""The configuration text of TCP port 5559: lines `section:key = value`, ended by a NUL byte. No I/O.

Values are text as the drone writes it: `TRUE` and `FALSE`, numbers, vectors `{ a b c }`.
"""

import math
import re
from collections.abc import Mapping

END = b"\x00"
"""The byte after the last line."""
_LINE = re.compile(r"\s*([A-Za-z0-9_]+:[A-Za-z0-9_]+)\s*=[ \t]*(.*?)\s*")


def parse(text: str | bytes) -> dict[str, str]:
    """Return the keys and values of every readable line before the NUL byte; other lines are left out. Never raises."""
    if isinstance(text, bytes):
        text = text.decode("utf-8", "replace")
    pairs = (_LINE.fullmatch(line) for line in text.split("\x00", 1)[0].split("\n"))
    return {pair[1]: pair[2] for pair in pairs if pair is not None}


def render(configuration: Mapping[str, str]) -> bytes:
    """Return the text as the drone sends it, with the NUL byte that ends it."""
    return "".join(f"{key} = {value}\n" for key, value in configuration.items()).encode() + END


def number(value: str) -> float | None:
    """Return a finite number; None for anything else."""
    try:
        parsed = float(value)
    except ValueError:
        return None
    return parsed if math.isfinite(parsed) else None
