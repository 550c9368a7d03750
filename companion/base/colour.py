"""Colour where a terminal has it: none for a pipe, a dumb terminal or NO_COLOR (no-color.org)."""

import os
import sys
from typing import TextIO

BOLD, RED, CYAN = "1", "1;31", "36"


def coloured(out: TextIO) -> bool:
    """Return whether the stream is a terminal with colours that nobody has switched off."""
    return out.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM", "dumb") != "dumb"


def style(text: str, code: str, out: TextIO | None = None) -> str:
    """Return the text in a style of ANSI (ECMA-48, SGR), or as it is where the stream has no colours."""
    return f"\x1b[{code}m{text}\x1b[0m" if coloured(out or sys.stdout) else text
