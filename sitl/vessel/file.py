"""A vessel in a file: its deck and pad, and its motion by main dimensions, by a response table or by a recording.

    ship = load("patrol_boat")         # a shipped one (configs/vessels) or a path

A scenario's table `[vessel]` chooses the ship, its course and its turn.

A recorded motion is a CSV file: it is read, checked, and interpolated so that it can be differentiated twice. It is made from
the log of a boat too: NMEA 0183 sentences with places of an RTK receiver (GGA) and headings (HDT). Such a log holds no roll and
no pitch, and its height is the heave of the antenna, with the receiver's noise of about a centimetre. The log of a ship's motion
sensor (PSXN,23) holds roll, pitch and heave, and no surge and no sway.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta, Struct

from companion.settings.capabilities import ship_logs
from companion.settings.load import read_toml
from companion.settings.overrides import finite
from companion.settings.schema import explain
from drivers.files import Largest, bytes_of
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.geometry import F64
from estimator.contracts.keys import check_order, choice, number, text
from estimator.contracts.text import text_of, utf8_of
from sitl.vessel.seakeeping import HULLS, MODES, Hull, ResponseTable, Superstructure, smooth_step

_EARTH_M = 6_371_000.0  # mean radius of the Earth
_RTK = "4"
"""Quality of a place that is known to centimetres."""
_GAP_S = 2.0  # longest gap between two rows of a record
_DAY_S = 86400.0  # length of a day
ROWS_MAX = 500_000
"""Rows of the largest file."""
GAP_MAX_S = 2.0
"""Largest gap between two rows; a longer one hides motion."""


def read_log(path: Path, smooth_s: float) -> tuple[F64, F64]:
    """Return times (N,) from 0, s, and motion (N, 6): m north, east and down, and roll, pitch (both 0) and heading, rad.

    The longest stretch without a gap of two seconds is taken; places are about its mean. Where there is a motion sensor, the
    heading is about its mean too, as the course is the scenario's.

    Args:
        smooth_s: standard deviation of a Gaussian over time that takes the receiver's noise away; 0 leaves it.

    Raises:
        BadInput: the file cannot be read, or has no such stretch of 10 s.
    """
    ship_motion = ship_logs(f"{path}: a ship's log").ship_motion
    lines = utf8_of(bytes_of(path, Largest.LOG)).decode("ascii", "replace").splitlines()
    places, headings, moved, t_s = [], [], [], math.nan
    for line in lines:
        kind, _, rest = line.partition(",")
        cells = rest.partition("*")[0].split(",")
        try:
            if kind.endswith("GGA"):
                t_s = 3600.0 * int(cells[0][:2]) + 60.0 * int(cells[0][2:4]) + float(cells[0][4:])
            if kind.endswith("PSXN") and math.isfinite(t_s) and (motion := ship_motion(line[line.index("$") :])):
                moved.append((t_s, *motion))
            elif kind.endswith("GGA") and cells[5] == _RTK:
                north, east = _degrees(cells[1], cells[2]), _degrees(cells[3], cells[4])
                places.append((t_s, north, east, float(cells[8]) + float(cells[10] or 0.0)))
            elif kind.endswith("HDT") and math.isfinite(t_s):
                headings.append((t_s, math.radians(float(cells[0]))))
        except (ValueError, IndexError):
            continue  # a torn line
    stretch = _longest(np.array(moved, float) if moved else np.array(places, float).reshape(-1, 4))
    if len(stretch) < 2 or stretch[-1, 0] - stretch[0, 0] < 10.0:
        what = "RTK places (GGA of quality 4) or of a motion sensor (PSXN,23)"
        raise BadInput(f"{path}: no 10 s of {what} without a gap of {_GAP_S:g} s")
    t = stretch[:, 0] - stretch[0, 0]
    eta = np.zeros((len(t), 6))
    if moved:
        eta[:, 2:5] = stretch[:, [4, 1, 2]]
        eta[:, 5] = np.unwrap(stretch[:, 3])
        eta[:, [2, 5]] -= eta[:, [2, 5]].mean(axis=0)
    else:
        lat, lon = np.radians(stretch[:, 1]), np.radians(stretch[:, 2])
        eta[:, 0] = _EARTH_M * (lat - lat.mean())
        eta[:, 1] = _EARTH_M * math.cos(float(lat.mean())) * (lon - lon.mean())
        eta[:, 2] = -(stretch[:, 3] - stretch[:, 3].mean())
        if headings:
            at, heading = np.array(headings).T
            eta[:, 5] = np.interp(stretch[:, 0], at, np.unwrap(heading))
    return (t, eta) if smooth_s == 0.0 else _smoothed(t, eta, smooth_s)


def _degrees(text: str, side: str) -> float:
    point = text.index(".")
    degrees = int(text[: point - 2]) + float(text[point - 2 :]) / 60.0
    return -degrees if side in ("S", "W") else degrees


def _longest(rows: F64) -> F64:
    """Return the longest stretch of ascending times without a gap."""
    if not len(rows):
        return rows
    rows = rows.copy()
    rows[:, 0] += _DAY_S * np.concatenate([[0], np.cumsum(np.diff(rows[:, 0]) < -0.5 * _DAY_S)])
    rows = rows[np.concatenate([[True], np.diff(rows[:, 0]) > 0.0])]
    cuts = np.flatnonzero(~((np.diff(rows[:, 0]) > 0.0) & (np.diff(rows[:, 0]) <= _GAP_S))) + 1
    return max(np.split(rows, cuts), key=len)


def _smoothed(t: F64, eta: F64, smooth_s: float) -> tuple[F64, F64]:
    """Return the motion at even times, averaged by a Gaussian."""
    step_s = float(np.median(np.diff(t)))
    even = np.arange(0.0, t[-1], step_s)
    reach = max(1, math.ceil(4.0 * smooth_s / step_s))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step_s / smooth_s) ** 2)
    kernel /= kernel.sum()
    columns = [np.pad(np.interp(even, t, column), reach, mode="reflect") for column in eta.T]
    return even, np.stack([np.convolve(column, kernel, mode="valid") for column in columns], axis=1)


COLUMNS = ("time_s", "surge_m", "sway_m", "heave_down_m", "roll_deg", "pitch_deg", "yaw_deg")
"""The header; `heave_up_m` may stand in place of `heave_down_m`."""
_FARTHEST = (1e4, 1e4, 50.0, 80.0, 80.0, 1e5)
"""m and degrees: beyond these a column holds something else."""


class RecordedMotion(Struct, frozen=True, eq=False):
    """Natural cubic splines through the samples: positions are C2, velocities C1, accelerations continuous."""

    t_s: F64
    """(N,) from 0, ascending."""
    eta: F64
    """(N, 6) surge forward, sway to starboard, heave down in m; roll, pitch, yaw in rad."""
    bend: F64
    """(N, 6) second derivatives."""
    blend_s: float | None = None
    """Time over which the end is blended into the beginning when it is flown again; None: it is not."""

    @staticmethod
    def read(path: Path, blend_s: float | None = None) -> RecordedMotion:
        """Return the motion in a CSV file.

        Raises:
            BadInput: the file cannot be read, its header is another, a row has another number of cells or one that is no finite
                number, time does not ascend or has a gap, or the motion is too short for the blend. One line with file and row.
        """
        with refused(f"{path}: not readable as a CSV file", ValueError, csv.Error):
            rows = _rows(csv.reader(text_of(bytes_of(path, Largest.TABLE), str(path)).splitlines()), path)
        t, eta = rows[:, 0] - rows[0, 0], rows[:, 1:].copy()
        eta[:, 3:] = np.radians(eta[:, 3:])
        eta[:, 5] = np.unwrap(eta[:, 5])
        if blend_s is not None and t[-1] < 3.0 * blend_s:
            raise BadInput(f"{path}: {t[-1]:.1f} s of motion are too short to blend {blend_s:g} s of them")
        return RecordedMotion.of(t, eta, blend_s)

    @staticmethod
    def of(t_s: F64, eta: F64, blend_s: float | None = None) -> RecordedMotion:
        """Return the motion through samples; arguments as the fields."""
        return RecordedMotion(t_s, eta, _second_derivatives(t_s, eta), blend_s)

    @staticmethod
    @lru_cache(maxsize=32)
    def of_file(path: Path, smooth_s: float) -> RecordedMotion:
        """Return the motion in a CSV file, or in a log of NMEA sentences.

        Args:
            smooth_s: as for `sitl.vessel.file.read_log`, whose logs it is for.

        Raises:
            BadInput: as `read` and `read_log`.
        """
        if path.suffix == ".csv":
            return RecordedMotion.read(path)
        return RecordedMotion.of(*read_log(path, smooth_s))

    @property
    def lasts_s(self) -> float:
        """Duration; infinite when it is flown again and again."""
        return math.inf if self.blend_s is not None else float(self.t_s[-1])

    @property
    def period_s(self) -> float:
        """Time after which it comes again, if it does."""
        return float(self.t_s[-1]) - (self.blend_s or 0.0)

    def at(self, t_s: F64) -> tuple[F64, F64, F64]:
        """Return displacement, rate and acceleration at times (T,), each (T, 6)."""
        if self.blend_s is None:
            return self._spline(t_s)
        t = np.mod(t_s, self.period_s)
        now = self._spline(t)
        ends = t < self.blend_s
        if not ends.any():
            return now
        last = self._spline(np.where(ends, t + self.period_s, t))
        s, s1, s2 = (part[:, None] for part in smooth_step(np.where(ends, t / self.blend_s, 1.0)))
        s1, s2 = s1 / self.blend_s, s2 / self.blend_s**2
        d = tuple(b - a for a, b in zip(last, now, strict=True))
        return (last[0] + s * d[0], last[1] + s * d[1] + s1 * d[0], last[2] + s * d[2] + 2.0 * s1 * d[1] + s2 * d[0])

    def _spline(self, t_s: F64) -> tuple[F64, F64, F64]:
        i = np.clip(np.searchsorted(self.t_s, t_s, side="right") - 1, 0, self.t_s.size - 2)
        h = (self.t_s[i + 1] - self.t_s[i])[:, None]
        b = np.clip((t_s - self.t_s[i])[:, None] / h, 0.0, 1.0)
        a = 1.0 - b
        y0, y1, m0, m1 = self.eta[i], self.eta[i + 1], self.bend[i], self.bend[i + 1]
        return (
            a * y0 + b * y1 + ((a**3 - a) * m0 + (b**3 - b) * m1) * h**2 / 6.0,
            (y1 - y0) / h + ((3.0 * b**2 - 1.0) * m1 - (3.0 * a**2 - 1.0) * m0) * h / 6.0,
            a * m0 + b * m1,
        )


def _rows(lines: Iterator[list[str]], path: Path) -> F64:
    """Return (N, 7) numbers of a checked file, heave down."""
    header = tuple(cell.strip() for cell in next(lines, ()))
    up = header == tuple("heave_up_m" if c == "heave_down_m" else c for c in COLUMNS)
    if header != COLUMNS and not up:
        raise BadInput(f"{path}: the first line must be {','.join(COLUMNS)} (or heave_up_m), found {','.join(header)[:120]!r}")
    rows: list[list[float]] = []
    for n, cells in enumerate(lines, 2):
        if not cells:
            continue
        if len(rows) == ROWS_MAX:
            raise BadInput(f"{path}: more than {ROWS_MAX} rows")
        if len(cells) != len(COLUMNS):
            raise BadInput(f"{path}: line {n} has {len(cells)} cells, not {len(COLUMNS)}")
        row = [finite(cell[:40], f"{path}: line {n}: {name}") for cell, name in zip(cells, header, strict=True)]
        for value, most, name in zip(row[1:], _FARTHEST, header[1:], strict=True):
            if abs(value) > most:
                raise BadInput(f"{path}: line {n}: {name} must lie within {most:g}, found {value:g}")
        if rows and row[0] <= rows[-1][0]:
            raise BadInput(f"{path}: line {n}: time_s must ascend, found {row[0]:g} after {rows[-1][0]:g}")
        if rows and row[0] - rows[-1][0] > GAP_MAX_S:
            raise BadInput(f"{path}: line {n}: a gap of {row[0] - rows[-1][0]:g} s; {GAP_MAX_S:g} s at most can be bridged")
        rows.append(row)
    if len(rows) < 4:
        raise BadInput(f"{path}: {len(rows)} rows of motion; four or more are needed")
    out = np.array(rows)
    if up:
        out[:, 3] = -out[:, 3]
    return out


def _second_derivatives(t: F64, y: F64) -> F64:
    """Return those of the natural cubic spline through (N,) times and (N, 6) values: Thomas' algorithm, all columns at once."""
    h = np.diff(t)
    slope = np.diff(y, axis=0) / h[:, None]
    n = t.size
    c, d = np.zeros(n), np.zeros_like(y)
    for i in range(1, n - 1):
        left, right = h[i - 1], h[i]
        scale = 2.0 * (left + right) - left * c[i - 1]
        c[i] = right / scale
        d[i] = (6.0 * (slope[i] - slope[i - 1]) - left * d[i - 1]) / scale
    m = np.zeros_like(y)
    for i in range(n - 2, 0, -1):
        m[i] = d[i] - c[i] * m[i + 1]
    return m


EXCLUDES: dict[str, tuple[str, ...]] = {"hull": ("file",), "file": ("hull",)}
"""Keys that take the place of those of a base when a scenario that is built on it says them."""
DEFAULT_HULL = "ferry"


class VesselSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The ship."""

    hull: Annotated[str, text(f"one of {', '.join(HULLS)}; {DEFAULT_HULL} by default", 40)] | None = None
    file: Annotated[str, text("a shipped vessel (configs/vessels), or a path relative to the scenario file", 200)] | None = None
    motion: Annotated[
        str, text("recorded motion in place of her own: a log of NMEA sentences, or a CSV file", 300, shortest=0)
    ] = ""
    motion_smooth_s: Annotated[
        float, number("standard deviation in time by which a log's noise is averaged away; 0 flies it raw", "s", 0.0, 5.0)
    ] = 0.0
    heading_deg: Annotated[float, number("heading of the bow, clockwise from north", "deg", -360.0, 360.0)] = 0.0
    speed_m_s: Annotated[float, number("speed along the heading, through the water", "m/s", 0.0, 15.0)] = 0.0
    moored: Annotated[bool, Meta(description="at anchor: wanders slowly in surge, sway and yaw")] = True
    pad_yaw_deg: Annotated[float, number("angle of the pad's arrow from the bow, clockwise from above", "deg", -360.0, 360.0)] = (
        0.0
    )
    turn_rate_deg_s: Annotated[float, number("rate of turn, clockwise from above; 0 keeps the course", "deg/s", -30.0, 30.0)] = (
        0.0
    )
    turn_at_s: Annotated[float, number("time at which the turn begins", "s", 0.0, 36000.0)] = 0.0
    reports_hz: Annotated[
        float, number("rate at which the ship reports her velocity and heading to the service; 0 for never", "Hz", 0.0, 20.0)
    ] = 0.0
    reports_place: Annotated[
        bool, Meta(description="whether they also say where she is; without --config the service then flies to her")
    ] = False
    turn_over_s: Annotated[float, number("time until the turn is steady", "s", 0.5, 300.0, "assumed")] = 10.0
    reports_at_m: Annotated[
        tuple[float, float, float], choice("place of her GNSS antenna from the pad's centre: metres forward, to starboard, down")
    ] = (0.0, 0.0, 0.0)
    turn_hz: Annotated[
        float, number("rate at which her gyrocompass reports rate of turn and heading; 0 for never", "Hz", 0.0, 50.0)
    ] = 0.0
    turn_delay_s: Annotated[
        float, number("time after which a report of it arrives, which its stamp does not say", "s", 0.0, 2.0, "assumed")
    ] = 0.1
    motion_hz: Annotated[
        float, number("rate at which her motion sensor reports roll, pitch and heave; 0 for never", "Hz", 0.0, 100.0)
    ] = 0.0
    motion_at_m: Annotated[
        tuple[float, float, float], choice("place of her motion sensor from the pad's centre: metres forward, to starboard, down")
    ] = (0.0, 0.0, 0.0)
    motion_delay_s: Annotated[
        float, number("time after which a report of it arrives, which its stamp does not say", "s", 0.0, 2.0, "TSS1 at 9600 Bd")
    ] = 0.03
    motion_high_pass_s: Annotated[
        float, number("period of the corner of its heave filter, which leaves out what is slower", "s", 5.0, 600.0, "assumed")
    ] = 60.0
    motion_wander_m: Annotated[
        float, number("amplitude of each of two slow waves in its heave, which no deck makes", "m", 0.0, 10.0, "assumed")
    ] = 0.02
    wind_hz: Annotated[
        float, number("rate at which her anemometer reports the true wind, 1 s late; 0 for never", "Hz", 0.0, 20.0)
    ] = 0.0

    def __post_init__(self) -> None:
        if self.hull is not None and self.file is not None:
            raise ValueError("hull and file both name a ship: give one")
        if self.hull is not None and self.hull not in HULLS:
            raise ValueError(f"hull must be one of {', '.join(HULLS)}, found {self.hull!r}")
        if self.moored and self.speed_m_s > 0:
            raise ValueError("speed_m_s must be 0 while moored is true")
        if self.reports_place and self.reports_hz == 0.0:
            raise ValueError("reports_place needs reports_hz: a ship that reports nothing does not report her place")
        if self.turn_rate_deg_s != 0.0 and self.speed_m_s == 0.0:
            raise ValueError("turn_rate_deg_s needs speed_m_s: a ship that lies still does not turn")
        if self.turn_rate_deg_s == 0.0 and (self.turn_at_s != 0.0 or self.turn_over_s != 10.0):
            raise ValueError("turn_at_s and turn_over_s belong to a turn: turn_rate_deg_s is 0")


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
    superstructure: Superstructure | None = None
    closed_form: ClosedForm | None = None
    table: Table | None = None
    recording: MotionFile | None = None

    def __post_init__(self) -> None:
        output = [name for name in ("closed_form", "table", "recording") if getattr(self, name) is not None]
        if len(output) != 1:
            raise ValueError(f"exactly one of closed_form, table and recording must say how it moves, found {len(output)}")
        width = self.beam_m if self.deck_beam_m is None else self.deck_beam_m
        if abs(self.pad_forward_m) > 0.5 * self.length_m or abs(self.pad_starboard_m) > 0.5 * width:
            raise ValueError("the pad's centre must lie on the deck: pad_forward_m or pad_starboard_m is beyond its edge")
        block = self.superstructure
        if block is not None and block.covers(self.pad_forward_m, self.pad_starboard_m):
            raise ValueError("superstructure stands on the pad: forward_m and length_m reach over its centre")
        check_order(self, "bow_taper_m < length_m")


class Ship(Struct, frozen=True):
    """Ship from a vessel file, ready to move."""

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
    hull = Hull(
        path.stem, f.length_m, f.beam_m, f.draught_m, closed.block, closed.roll_period_s, closed.roll_damping, f.freeboard_m,
        f.bow_taper_m, (f.pad_forward_m, f.pad_starboard_m), f.deck_beam_m, f.gm_m, f.kg_m, table, f.superstructure,
    )  # fmt: skip
    if f.recording is None:
        return Ship(hull)
    return Ship(hull, RecordedMotion.read(path.parent / f.recording.file, f.recording.loop_blend_s), f.recording.random_start)


def _table(table: Table) -> ResponseTable:
    modes: dict[str, Any] = {
        mode: (held.amplitude, held.phase_deg) for mode in MODES if (held := getattr(table, mode)) is not None
    }
    return ResponseTable.of(list(table.encounter_rad_s), list(table.heading_deg), modes)
