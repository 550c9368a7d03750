"""How far a live calibration is, as lines that a terminal shows again and again in the same place."""

from __future__ import annotations

import shutil
import sys

from companion.tools.calibrate.guide import GuideState

_LACKS = 6


def block(state: GuideState) -> list[str]:
    """Return the parts of the image that hold a corner (`#`), with what is known and missing beside them."""
    error = "" if state.rms_px is None else f", error {state.rms_px:.2f} px, {state.grade}"
    told = [
        f"{state.images} images, {state.views} views{error}" + ("" if state.board_seen else "; the board is not in sight"),
        "nothing is missing" if not state.lacks else "show:",
        *(f"- {lack}" for lack in state.lacks[:_LACKS]),
    ]
    told += [""] * (2 + _LACKS - len(told))
    grid = ["".join("#" if count else "." for count in row) for row in state.cells]
    grid += [" " * len(state.cells[0])] * (len(told) - len(grid))
    return [f"  {cells}   {line}" for cells, line in zip(grid, told, strict=True)]


class ProgressBlock:
    """Draws the block over the one before. Draws nothing where standard error is no terminal."""

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet or not sys.stderr.isatty()
        self._drawn = 0

    def show(self, state: GuideState) -> None:
        if self._quiet:
            return
        width = shutil.get_terminal_size().columns - 1
        lines = [line[:width] for line in block(state)]
        up = f"\x1b[{self._drawn}A" if self._drawn else ""
        sys.stderr.write(up + "".join(f"\r{line}\x1b[K\n" for line in lines))
        sys.stderr.flush()
        self._drawn = len(lines)
