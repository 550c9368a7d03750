"""Output of `decklander pad check`: how often clutter is taken for a pad, and the calibration that is written into the file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from companion.cli.progress import WorkProgress
from companion.settings.load import SHIPPED, pad_of_file, shipped
from companion.tools.pads.clutter import VIEWS
from companion.tools.pads.price import Price, price
from estimator.contracts.errors import BadInput
from estimator.vision.drawing import EdgeKind, edges_of
from estimator.vision.pad import RARE, Calibration, Pad
from estimator.vision.srgb import LUMA, linear_light


def priced(pad: Pad, file: Path, views: int) -> tuple[Pad, Price]:
    """Search clutter for a pad, write its calibration into its file unless that ships, and return both.

    Raises:
        BadInput: the file cannot be written.
    """
    others = {name: pad_of_file(SHIPPED / "pads" / f"{name}.toml") for name in shipped("pads")}
    found = price(pad, others, views, WorkProgress("searching clutter", "views").take)
    if SHIPPED not in file.resolve().parents:
        _write(file, found.calibration)
    return replace(pad, calibration=found.calibration), found


def _write(file: Path, found: Calibration) -> None:
    table = (
        "[calibration]\n# By decklander pad check, for this drawing alone.\n"
        f"least_support = {found.least_support}\nchance = {found.chance}\n"
        f'least_px = {found.least_px}\ndrawing = "{found.drawing}"\n'
    )
    try:
        text = file.read_text(encoding="utf-8")
        bare = re.sub(r"\n*^\[calibration\]\n(?:(?!\[).*\n?)*", "\n", text, flags=re.MULTILINE).rstrip("\n")
        file.write_text(f"{bare}\n\n{table}", encoding="utf-8")
    except OSError as why:
        raise BadInput(f"{file}: {why.strerror or why}") from why


def price_lines(pad: Pad, found: Price | None) -> Iterator[str]:
    """Yield what is printed of a pad's price; without one, what its file says."""
    known = pad.calibration
    assert known is not None
    if found is not None:
        half, nine = found.per_1000
        chance = f"{half:.3g} false pads in 1,000 frames of a search at confidence .5, {nine:.3g} at .9"
        yield f"by {found.views} generated views without it: {chance}"
        yield "found where it is planted: " + ", ".join(f"{100 * share:.0f} % at {r:g} px" for r, share in found.found.items())
        if found.taken_for:
            yield f"it is seen in {', '.join(found.taken_for)}, too"
    else:
        yield f"by its file: {1000.0 * known.chance:.3g} false pads in 1,000 frames of a search at confidence .5"
    yield (
        f"found from a radius of {known.least_px:g} px on"
        if known.least_px
        else "not found at all sizes: it hardly shows on some decks"
    )
    yield "what decides: " + ", ".join(f"{name} {100 * share:.0f} %" for name, share in deciding(pad).items())


def price_warnings(pad: Pad) -> list[str]:
    """Return what a user should know about a calibrated pad."""
    known = pad.calibration
    if known is None or known.chance <= RARE:
        return []
    fate = (
        "its file accepts that"
        if pad.accept_false_pads
        else "it is refused for flight unless its file has accept_false_pads = true"
    )
    return [f"clutter is taken for it in {1000.0 * known.chance:.3g} of 1,000 frames, at most {1000.0 * RARE:g} is good: {fate}"]


def price_record(found: Price | None, pad: Pad) -> dict[str, Any]:
    """Return a pad's price as JSON."""
    known = pad.calibration
    assert known is not None
    out: dict[str, Any] = {
        "chance": known.chance,
        "least_support": known.least_support,
        "least_px": known.least_px,
        "decided_by": deciding(pad),
    }
    if found is not None:
        shares = {f"{radius:g}": share for radius, share in found.found.items()}
        out |= {"views": found.views, "false_per_1000": list(found.per_1000), "found": shares, "taken_for": list(found.taken_for)}
    return out


def deciding(pad: Pad) -> dict[str, float]:
    """Return by kind of edge the share of the drawing's support: length times squared contrast, the largest first."""
    edges = edges_of(pad)
    grey = linear_light(dict(pad.paints)[pad.ground] if pad.ground else (128, 128, 128)) @ LUMA
    contrast = np.where(edges.bare, linear_light(edges.inside_rgb) @ LUMA - grey, edges.contrast)
    names = {
        EdgeKind.DISC: "disc",
        EdgeKind.RING: "ring",
        EdgeKind.ARROW: "arrowhead",
        EdgeKind.H: "lettering",
        EdgeKind.UPPER: "upper lettering",
    }
    each = {name: float((edges.spacing_m * contrast**2)[edges.kind == kind].sum()) for kind, name in names.items()}
    total = sum(each.values()) or 1.0
    return {name: round(value / total, 3) for name, value in sorted(each.items(), key=lambda of: -of[1]) if value > 0.0}


__all__ = ["VIEWS", "deciding", "price_lines", "price_record", "price_warnings", "priced"]
