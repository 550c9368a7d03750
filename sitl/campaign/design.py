"""Designs: the points at which a campaign flies each of its seeds, when keys of scenario or settings are varied."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from companion.settings.overrides import Value, finite
from estimator.contracts.errors import BadInput
from sitl.campaign.lab import require_lab
from sitl.campaign.overrides import Overridable
from sitl.campaign.plan import Point

POINTS_MAX = 1_000_000
_DIGITS = 9
"""Significant digits of a value: enough for any key, and short enough to read."""
SAMPLED = ("sobol", "lhs")


@dataclass(frozen=True, slots=True)
class Axis:
    """One varied key: either its values one by one, or a range."""

    key: str
    text: str
    """As the person wrote it."""
    values: tuple[Value, ...] = ()
    low: float = math.nan
    high: float = math.nan
    whole: bool = False
    """Whether the key takes whole numbers only."""

    def at(self, share: float) -> Value:
        """Return the value at a share of the range, 0 for its low and 1 for its high end."""
        value = self.low + share * (self.high - self.low)
        return round(value) if self.whole else rounded(value)


def rounded(value: float) -> float:
    """Return the value with the significant digits that a command line shows."""
    return float(f"{value:.{_DIGITS}g}")


def parse_axis(text: str, given: Overridable, where: str) -> Axis:
    """Return the axis that `KEY=LOW:HIGH:STEP`, `KEY=LOW:HIGH` or `KEY=A,B,C` means.

    Raises:
        BadInput: it has another form, or the key is unknown.
    """
    key, equals, span = text.partition("=")
    if not equals or not span:
        raise BadInput(f"{where} {text!r}: write KEY=LOW:HIGH:STEP or KEY=A,B,C, as in wind.speed_m_s=0:10:2")
    if ":" not in span:
        return Axis(key, text, values=tuple(given.value(key, item, where) for item in span.split(",")))
    parts = span.split(":")
    if len(parts) not in (2, 3):
        raise BadInput(f"{where} {text!r}: a range is LOW:HIGH or LOW:HIGH:STEP")
    present = given.value(key, parts[0], where)
    if isinstance(present, bool | str):
        raise BadInput(f"{where} {text!r}: {key} holds no number; list its values, as in {key}=A,B")
    low, high = (finite(part, f"{where}: {key}") for part in parts[:2])
    whole = given.holds_whole_number(key, where)
    if len(parts) == 2:
        if low == high:
            raise BadInput(f"{where} {text!r}: the range is empty")
        return Axis(key, text, low=low, high=high, whole=whole)
    step = finite(parts[2], f"{where}: {key}")
    if step == 0.0 or (high - low) / step < 0.0:
        raise BadInput(f"{where} {text!r}: steps of {step:g} do not lead from {low:g} to {high:g}")
    count = math.floor((high - low) / step * (1.0 + 1e-9)) + 1
    if count > POINTS_MAX:
        raise BadInput(f"{where} {text!r}: {count} values are more than {POINTS_MAX}")
    steps = [rounded(low + n * step) for n in range(count)]
    return Axis(key, text, tuple(int(v) if whole and v == int(v) else v for v in steps), low, high, whole)


def refuse_repeated(axes: Sequence[Axis], where: str) -> None:
    """Refuse a key that is varied twice.

    Raises:
        BadInput: there is one.
    """
    keys = [axis.key for axis in axes]
    for key in keys:
        if keys.count(key) > 1:
            raise BadInput(f"{where}: {key} is given twice")


def factorial(axes: Sequence[Axis]) -> list[Point]:
    """Return all combinations of the axes' values; a single empty point without axes.

    Raises:
        BadInput: an axis is a range without a step, or there are too many combinations.
    """
    for axis in axes:
        if not axis.values:
            raise BadInput(f"--vary {axis.text!r}: a range needs a step (LOW:HIGH:STEP), or --design sobol or lhs with --points")
    if (count := math.prod(len(axis.values) for axis in axes)) > POINTS_MAX:
        raise BadInput(f"--vary: {count} combinations are more than {POINTS_MAX}")
    return [
        tuple((axis.key, value) for axis, value in zip(axes, values, strict=True))
        for values in itertools.product(*(axis.values for axis in axes))
    ]


def sampled(axes: Sequence[Axis], kind: str, points: int, seed: int) -> list[Point]:
    """Return points that fill the ranges of the axes evenly, by scipy.stats.qmc.

    Args:
        kind: `sobol`, a scrambled Sobol' sequence, or `lhs`, a Latin hypercube.
        seed: of the scrambling.

    Raises:
        BadInput: an axis has no range, there are too many points, or SciPy is missing.
    """
    require_lab(f"--design {kind}", "scipy")
    if not 1 <= points <= POINTS_MAX:
        raise BadInput(f"--points must lie in 1 to {POINTS_MAX}, got {points}")
    for axis in axes:
        if math.isnan(axis.low):
            raise BadInput(f"--vary {axis.text!r}: --design {kind} needs a range, LOW:HIGH")
    from scipy.stats import qmc

    sampler = qmc.Sobol(len(axes), rng=seed) if kind == "sobol" else qmc.LatinHypercube(len(axes), rng=seed)
    # A Sobol' sequence is balanced over powers of two only; more is drawn than flown.
    drawn = sampler.random(1 << (points - 1).bit_length())[:points] if kind == "sobol" else sampler.random(points)
    return [tuple((axis.key, axis.at(float(x))) for axis, x in zip(axes, row, strict=True)) for row in drawn]


def described(kind: str, axes: Sequence[Axis], **more: Any) -> dict[str, Any]:
    """Return a design as plain values, for the manifest."""
    return {"kind": kind, "axes": [axis.text for axis in axes], "keys": [axis.key for axis in axes], **more}
