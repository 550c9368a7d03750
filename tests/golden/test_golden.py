"""Accuracy on the golden recordings: each figure within its tolerance of the one that was written down, in both directions."""

import math

import pytest

from tests.golden import figures

TOLERANCE = {
    "count": (3.0, 0.02), "lateral_median_m": (0.002, 0.1), "lateral_p95_m": (0.004, 0.1), "down_median_m": (0.002, 0.1),
    "down_p95_m": (0.004, 0.1), "yaw_median_rad": (0.0005, 0.15), "yaw_p95_rad": (0.001, 0.15),
}  # fmt: skip
"""Tolerance by field: a part of its own unit, and a share of the figure; the larger counts."""
HOW = 'if that is as it should be: python -m tests.golden.figures "why"'


def outside(field: str, was: float, now: float) -> bool:
    absolute, share = TOLERANCE[field]
    if math.isnan(was) or math.isnan(now):
        return math.isnan(was) != math.isnan(now)
    return abs(now - was) > max(absolute, share * abs(was))


@pytest.mark.parametrize("name", figures.RECORDINGS)
def test_accuracy_is_what_it_was(name: str) -> None:
    now, was = figures.measured(name), figures.kept()[name]
    assert now.keys() == was.keys(), HOW
    changed = [
        f"{series}.{field}: {was[series][field]:g} was written down, {now[series][field]:g} is measured"
        for series in was
        for field in figures.FIELDS
        if outside(field, was[series][field], now[series][field])
    ]
    assert changed == [], HOW


def test_every_change_has_a_written_reason() -> None:
    lines = [line for line in figures.REASONS.read_text().splitlines() if line.startswith("- `")]
    assert lines[-1].startswith(f"- `{figures.fingerprint()}` "), HOW
    assert all(len(line.split()) >= 5 for line in lines), "a reason says something"


def test_the_recordings_stay_small() -> None:
    assert sum((figures.HERE / f"{name}.mcap").stat().st_size for name in figures.RECORDINGS) < 1_000_000
