"""The golden figures: how far each path and method is from truth on recordings that never change.

    python -m tests.golden.figures "why they changed"

writes them again and adds the reason to REASONS.md; the tests hold to them. How the recordings were made: CONTRIBUTING.md.
"""

import hashlib
import sys
import tomllib
from pathlib import Path

import msgspec

from companion.cli.replay import replayed
from companion.recording.reading import open_recording
from companion.settings.load import load
from companion.tools.report.figures import all_series, error_rows

HERE = Path(__file__).parent
FIGURES, REASONS = HERE / "figures.toml", HERE / "REASONS.md"
RECORDINGS = ("approach", "frames")
Figures = dict[str, dict[str, float]]
"""Figures by path or method: count, lateral_median_m, lateral_p95_m, down_median_m, down_p95_m, yaw_median_rad, yaw_p95_rad."""
FIELDS = ("count", "lateral_median_m", "lateral_p95_m", "down_median_m", "down_p95_m", "yaw_median_rad", "yaw_p95_rad")


def measured(name: str) -> Figures:
    """Return the figures of one golden recording by the shipped settings `sim` and all methods, with its own camera and pad."""
    recording = open_recording([HERE / f"{name}.mcap"])
    settings = load("sim")
    settings = msgspec.structs.replace(settings, vision=msgspec.structs.replace(settings.vision, method="fused"))
    log = replayed(recording, settings).log
    assert recording.cut == {}
    assert recording.skipped == {}, f"{name}.mcap is no longer understood: {dict(recording.skipped)}"
    # A handful of frames says what vision sees in each; what a path makes of five of them says nothing.
    rows = [row for row in error_rows(log, all_series(log)) if not (name == "frames" and row.is_path)]
    return {row.name: {field: round(float(getattr(row, field)), 5) for field in FIELDS} for row in rows}


def kept() -> dict[str, Figures]:
    """Return the figures in figures.toml."""
    read: dict[str, Figures] = tomllib.loads(FIGURES.read_text())
    return read


def fingerprint() -> str:
    """Return the fingerprint of figures.toml: REASONS.md names it beside the reason for its newest change."""
    return hashlib.sha256(FIGURES.read_bytes()).hexdigest()[:12]


def write(reason: str) -> None:
    """Measure all, write them, and add the reason."""
    lines = []
    for name in RECORDINGS:
        for series, figures in sorted(measured(name).items()):
            lines += [f"[{name}.{series}]", *(f"{field} = {figures[field]}" for field in FIELDS), ""]
    FIGURES.write_text("\n".join(lines))
    with REASONS.open("a") as out:
        out.write(f"- `{fingerprint()}` {' '.join(reason.split())}\n")


if __name__ == "__main__":
    if len(sys.argv) != 2 or len(sys.argv[1].split()) < 3:
        sys.exit('say why they change, in words: python -m tests.golden.figures "..."')
    write(sys.argv[1])
