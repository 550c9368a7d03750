"""Lines of cells, aligned for a terminal."""

from __future__ import annotations

from collections.abc import Collection, Sequence


def columns(lines: Sequence[Sequence[str]], texts: Collection[int]) -> str:
    """Return lines of as many cells each, aligned.

    Args:
        lines: the cells; the first line has the headings.
        texts: numbers of the columns that are aligned on the left; the others are on the right.
    """
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            cell.ljust(w) if i in texts else cell.rjust(w) for i, (cell, w) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )
