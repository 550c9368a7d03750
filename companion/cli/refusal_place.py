"""Place of a fault in a refused settings file: its line with a caret, and the page that helps."""

import re
from pathlib import Path

from companion.settings.plain_file import LARGEST_BYTES

_SYNTAX = re.compile(r"\(at line (\d+), column (\d+)\)")
_KEY = re.compile(r'([\w-]+(?:\.(?:[\w-]+|"[^"]*"))*)[ :]')
_PAGE = "docs/configuration.md, or: decklander config reference"


def pointed(message: str) -> str:
    """Return some lines with the place in the TOML file that the message names; empty if it names none.

    Args:
        message: "FILE: KEY ..." as settings are refused.
    """
    found = re.match(r"(?P<file>[^:]+\.toml): (?P<what>.*)", message)
    path = Path(found["file"]) if found else None
    if found is None or path is None or not path.is_file() or path.stat().st_size > LARGEST_BYTES:
        return ""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    if syntax := _SYNTAX.search(found["what"]):
        row, column, width = int(syntax[1]), int(syntax[2]), 1
    else:
        key = _KEY.match(found["what"])
        place = _of_key(key[1], lines) if key else None
        if place is None:
            return ""
        row, column, width = place
    if not 1 <= row <= len(lines):
        return ""
    margin = len(str(row))
    return (
        f"  --> {path}:{row}:{column}\n"
        f"  {row} | {lines[row - 1]}\n"
        f"  {'':{margin}} | {' ' * (column - 1)}{'^' * width}\n"
        f"  {'':{margin}} = page: {_PAGE}\n"
    )


def _of_key(key: str, lines: list[str]) -> tuple[int, int, int] | None:
    """Return the row, column and width of a dotted key, or of its table's header where the key is missing; None without both."""
    table = ""
    best: tuple[int, int, int] | None = None
    for number, line in enumerate(lines, 1):
        if header := re.match(r"\s*\[\s*([^\[\]]+?)\s*\]", line):
            table = header[1]
            if key == table or (best is None and key.startswith(f"{table}.")):
                best = (number, header.start(1) + 1, len(header[1]))
            continue
        assigned = re.match(r"\s*([\w.\"-]+)\s*=", line)
        if assigned and ".".join(filter(None, (table, assigned[1]))) == key:
            return number, assigned.start(1) + 1, len(assigned[1])
    return best
