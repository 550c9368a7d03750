"""A vessel in a file: its deck and pad, and its motion by main dimensions, by a response table or by a recording.

ship = load("patrol_boat")         # a shipped one (configs/vessels) or a path
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct

from companion.settings.load import read_toml
from companion.settings.refusal import explain
from estimator.contracts.errors import BadInput
from estimator.contracts.keys import choice, number, text
from sitl.vessel.recorded_motion import RecordedMotion
from sitl.vessel.response_table import MODES, ResponseTable
from sitl.vessel.seakeeping import Hull, Superstructure

_Row = Annotated[tuple[float, ...], Meta(max_length=400)]
_Rows = Annotated[tuple[_Row, ...], Meta(max_length=400)]


class ClosedForm(Struct, frozen=True, forbid_unknown_fields=True):
    """The figures of the closed-form responses beyond the main dimensions."""

    block: Annotated[float, number("displaced volume over length x beam x draught", "1", 0.05, 1.0)]
    roll_period_s: Annotated[float, number("natural period of roll", "s", 0.3, 40.0)]
    roll_damping: Annotated[float, number("damping over critical damping, waves and bilge together", "1", 0.01, 1.0)]


class Mode(Struct, frozen=True, forbid_unknown_fields=True):
    """One motion's response: a row for each heading, a number for each frequency."""

    amplitude: Annotated[_Rows, Meta(description="m/m, or degrees/m of roll, pitch and yaw")]
    phase_deg: Annotated[_Rows, Meta(description="lead of the motion over the crest amidships")]


class Table(Struct, frozen=True, forbid_unknown_fields=True):
    """Amplitude and phase per encounter frequency and heading."""

    encounter_rad_s: Annotated[_Row, Meta(description="ascending")]
    heading_deg: Annotated[_Row, Meta(description="ascending from 0 (following sea) to 180 (head sea), waves from port")]
    heave: Mode
    roll: Mode
    pitch: Mode
    surge: Mode | None = None
    sway: Mode | None = None
    yaw: Mode | None = None


class Block(Struct, frozen=True, forbid_unknown_fields=True):
    """The superstructure, a block that the wind flows around; frames do not show it."""

    forward_m: Annotated[float, number("distance of its centre forward of amidships", "m", -250.0, 250.0)]
    length_m: Annotated[float, number("length along the ship", "m", 0.2, 300.0)]
    width_m: Annotated[float, number("width across the ship", "m", 0.2, 80.0)]
    height_m: Annotated[float, number("height over the deck of the pad", "m", 0.2, 60.0)]
    starboard_m: Annotated[float, number("distance of its centre to starboard of the middle line", "m", -40.0, 40.0)] = 0.0

    def covers(self, forward_m: float, starboard_m: float) -> bool:
        """Whether a place on deck lies under it."""
        along, across = abs(forward_m - self.forward_m), abs(starboard_m - self.starboard_m)
        return along < 0.5 * self.length_m and across < 0.5 * self.width_m


class MotionFile(Struct, frozen=True, forbid_unknown_fields=True):
    """Recorded motion."""

    file: Annotated[str, text("CSV file, relative to the vessel's file", 200)]
    loop_blend_s: (
        Annotated[float, number("repeat the recording, with its end blended into its beginning over this time", "s", 0.5, 60.0)]
        | None
    ) = None
    random_start: Annotated[
        bool, choice("whether the flight begins at a random time of the recording, by the seed, instead of at its beginning")
    ] = False


class VesselFile(Struct, frozen=True, forbid_unknown_fields=True):
    """A vessel."""

    title: Annotated[str, text("one line for people", 120)]
    source: Annotated[str, text("where the figures come from, and which are assumed", 1000)]
    length_m: Annotated[float, number("length between perpendiculars, which is also that of the deck", "m", 0.5, 500.0)]
    beam_m: Annotated[float, number("beam at the waterline", "m", 0.2, 80.0)]
    draught_m: Annotated[float, number("draught of the hull", "m", 0.02, 30.0)]
    freeboard_m: Annotated[float, number("height of the deck over calm water", "m", 0.05, 30.0)]
    bow_taper_m: Annotated[float, number("length over which the deck narrows to the stem; 0 for a barge", "m", 0.0, 200.0)] = 0.0
    deck_beam_m: Annotated[float, number("width of the deck if it differs from the beam", "m", 0.2, 80.0)] | None = None
    pad_forward_m: Annotated[float, number("distance of the pad's centre forward of amidships", "m", -250.0, 250.0)] = 0.0
    pad_starboard_m: Annotated[
        float, number("distance of the pad's centre to starboard of the middle line", "m", -40.0, 40.0)
    ] = 0.0
    gm_m: Annotated[float, number("transverse metacentric height; for the heel in a turn", "m", 0.01, 20.0)] | None = None
    kg_m: (
        Annotated[float, number("height of the centre of gravity over the keel; for the heel in a turn", "m", 0.01, 40.0)] | None
    ) = None
    superstructure: Block | None = None
    closed_form: ClosedForm | None = None
    table: Table | None = None
    recording: MotionFile | None = None

    def __post_init__(self) -> None:
        said = [name for name in ("closed_form", "table", "recording") if getattr(self, name) is not None]
        if len(said) != 1:
            raise ValueError(f"exactly one of closed_form, table and recording must say how it moves, found {len(said)}")
        width = self.beam_m if self.deck_beam_m is None else self.deck_beam_m
        if abs(self.pad_forward_m) > 0.5 * self.length_m or abs(self.pad_starboard_m) > 0.5 * width:
            raise ValueError("the pad's centre must lie on the deck: pad_forward_m or pad_starboard_m is beyond its edge")
        block = self.superstructure
        if block is not None and block.covers(self.pad_forward_m, self.pad_starboard_m):
            raise ValueError("superstructure stands on the pad: forward_m and length_m reach over its centre")
        if self.bow_taper_m >= self.length_m:
            raise ValueError("bow_taper_m must be less than length_m")


@dataclass(frozen=True, slots=True)
class Ship:
    """What a vessel's file holds, ready to move."""

    hull: Hull
    recorded: RecordedMotion | None = None
    random_start: bool = False


def load(path: Path) -> Ship:
    """Return the vessel in a file.

    Raises:
        BadInput: the file or the recording that it names cannot be read, or a key is unknown, missing, wrong or contradicts
            another: one line with file and key.
    """
    data = read_toml(path)
    try:
        f = msgspec.convert(data, VesselFile, strict=True)
        table = None if f.table is None else _table(f.table)
    except msgspec.ValidationError as why:
        raise BadInput(f"{path}: {explain(VesselFile, data, str(why))}") from why
    except ValueError as why:
        raise BadInput(f"{path}: table: {why}") from why
    closed = f.closed_form or ClosedForm(0.6, 8.0, 0.1)  # not used beside a table or a recording
    s = f.superstructure
    hull = Hull(
        path.stem, f.length_m, f.beam_m, f.draught_m, closed.block, closed.roll_period_s, closed.roll_damping, f.freeboard_m,
        f.bow_taper_m, (f.pad_forward_m, f.pad_starboard_m), f.deck_beam_m, f.gm_m, f.kg_m, table,
        None if s is None else Superstructure(s.forward_m, s.starboard_m, s.length_m, s.width_m, s.height_m),
    )  # fmt: skip
    if f.recording is None:
        return Ship(hull)
    return Ship(hull, RecordedMotion.read(path.parent / f.recording.file, f.recording.loop_blend_s), f.recording.random_start)


def _table(table: Table) -> ResponseTable:
    modes: dict[str, Any] = {
        mode: (held.amplitude, held.phase_deg) for mode in MODES if (held := getattr(table, mode)) is not None
    }
    return ResponseTable.of(list(table.encounter_rad_s), list(table.heading_deg), modes)
