"""The outcomes at the values of each varied key: a table for a terminal, and plain values."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from sitl.campaign.columns import columns
from sitl.campaign.figures import Effect, VariedPoint, effect_of


def by_value(points: list[VariedPoint]) -> list[Effect]:
    """Return how success depends on each varied key, over all values of the others."""
    return [effect_of(points, key) for key in points[0][0]] if points else []


def as_json(effect: Effect) -> list[dict[str, Any]]:
    """Return plain values, an object for each value of the key: shares of good flights are 0 to 1, errors in m."""
    rows = zip(effect.values, effect.counts, effect.shares, effect.low, effect.high, effect.lateral_m, strict=True)
    return [
        {
            "value": value,
            "runs": runs,
            "good": round(float(share), 6),
            "good_interval": [round(float(low), 6), round(float(high), 6)],
            "lateral_median_m": None if math.isnan(error_m) else round(float(error_m), 4),
        }
        for value, runs, share, low, high, error_m in rows
    ]


def in_rows(effects: Iterable[Effect]) -> str:
    """Return a table for each key, a line for each value."""
    return "\n".join(
        columns([(effect.key, "flights", "good", "95 % interval", "error, median"), *_rows(effect)], ()) for effect in effects
    )


def _rows(effect: Effect) -> list[tuple[str, ...]]:
    return [
        (
            f"{row['value']:g}" if isinstance(row["value"], float) else str(row["value"]),
            str(row["runs"]),
            f"{100 * row['good']:.0f} %",
            "{:.0f} to {:.0f} %".format(*(100 * share for share in row["good_interval"])),
            "-" if row["lateral_median_m"] is None else f"{100 * row['lateral_median_m']:.1f} cm",
        )
        for row in as_json(effect)
    ]
