"""Tables of a campaign's outcomes.

One has a line for each scenario of a set, one a line for each value of a varied key, for a terminal and as plain values. A
Parquet file has a row for each flight, for pandas, polars, DuckDB and the like.
"""

import io
import itertools
import json
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from sitl.campaign.figures import Effect, VariedPoint, effect_of
from sitl.campaign.summary import cause_of
from sitl.campaign.task import Flight


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


@dataclass(slots=True)
class ScenarioTally:
    """The outcomes of one scenario of a set."""

    name: str
    expect: str
    perception: str
    runs: int = 0
    on_pad: int = 0
    refused: int = 0
    failed: int = 0
    contacts_outside_commit: int = 0
    in_water: int = 0
    unsafe: int = 0
    """Number of flights in which something was unsafe."""
    why: Counter[str] = field(default_factory=Counter)
    """Causes of the failures."""

    def take(self, flight: Flight) -> None:
        """Count a flight."""
        self.runs += 1
        self.on_pad += flight["grade"] == "on pad"
        self.refused += flight["grade"] == "refused rightly"
        self.contacts_outside_commit += flight["contacts_outside_commit"]
        self.in_water += flight["in_water"]
        self.unsafe += bool(flight["unsafe"])
        if flight["grade"] == "failed":
            self.failed += 1
            self.why[cause_of(flight)] += 1

    @property
    def causes(self) -> str:
        """The causes of the failures, the most frequent first; empty where none failed."""
        return "; ".join(f"{n} {cause}" if n > 1 else cause for cause, n in self.why.most_common())

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return {
            "scenario": self.name,
            "expect": self.expect,
            "perception": self.perception,
            "runs": self.runs,
            "on_pad": self.on_pad,
            "refused": self.refused,
            "failed": self.failed,
            "contacts_outside_commit": self.contacts_outside_commit,
            "in_water": self.in_water,
            "unsafe": self.unsafe,
            "causes": dict(self.why),
        }


HEADINGS = ("scenario", "expected", "by", "flights", "on pad", "refused", "failed", "outside commit", "water", "unsafe", "why")


def by_scenario(members: Mapping[str, Any], flights: Iterable[Flight]) -> list[ScenarioTally]:
    """Return the outcomes of each scenario of a set, in the order of the set.

    Args:
        members: of the campaign's manifest: the scenario and the perception of each, by name.
    """
    out = {name: ScenarioTally(name, m["scenario"].get("expect", "land"), m["perception"]) for name, m in members.items()}
    for flight in flights:
        out[flight["scenario"]].take(flight)
    return list(out.values())


def row(t: ScenarioTally) -> tuple[str, ...]:
    """Return the cells of a scenario's line, as `HEADINGS`."""
    counts = (t.runs, t.on_pad, t.refused, t.failed, t.contacts_outside_commit, t.in_water, t.unsafe)
    return (t.name, t.expect.replace("_", " "), t.perception, *map(str, counts), t.causes)


def in_columns(tallies: Iterable[ScenarioTally]) -> str:
    """Return a table for a terminal, a line for each scenario."""
    return columns([HEADINGS, *map(row, tallies)], texts=(0, 1, 2, len(HEADINGS) - 1))


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


PARQUET = "flights.parquet"
_ROWS = 20_000
_TOUCH = ("surface", "on_pad", "lateral_m", "yaw_deg", "vertical_speed_m_s", "lateral_speed_m_s")


def parquet_bytes(flights: Iterable[Flight], varied: dict[str, Any]) -> bytes:
    """Return a Parquet file with a row for each flight.

    Args:
        varied: a value of each varied key, which says of what type its column is.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    kinds = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
    number, text, yes = pa.float64(), pa.string(), pa.bool_()
    columns = {
        "seed": pa.int64(),
        "scenario": text,
        "perception": text,
        "grade": text,
        "outcome": text,
        "because": text,
        "refused": text,
        "landed_on_pad": yes,
        "in_water": yes,
        "contacts_outside_commit": pa.int64(),
        "duration_s": number,
        "lowest_blind_m": number,
        "cpu_s": number,
        "hash": text,
        **{f"touchdown_{name}": text if name == "surface" else yes if name == "on_pad" else number for name in _TOUCH},
        "touchdown_forward_m": number,
        "touchdown_starboard_m": number,
        "standing_lateral_m": number,
        "standing_slid_m": number,
        "afterwards": text,
        "contacts": text,
        "frames": text,
        **{f"varied_{key}": kinds[type(value)] for key, value in varied.items()},
    }
    schema = pa.schema(list(columns.items()))
    out = io.BytesIO()
    with pq.ParquetWriter(out, schema, compression="zstd") as writer:
        rows = iter(map(_row, flights))
        while batch := list(itertools.islice(rows, _ROWS)):
            writer.write_table(pa.Table.from_pylist(batch, schema=schema))
    return out.getvalue()


def _row(flight: Flight) -> dict[str, Any]:
    touch, stands = flight["touchdown"] or {}, flight.get("standing") or {}
    forward, starboard = touch.get("p_pad_m") or (None, None)
    return {
        **{key: value for key, value in flight.items() if key not in ("touchdown", "standing", "contacts", "frames", "varied")},
        **{f"touchdown_{name}": touch.get(name) for name in _TOUCH},
        "touchdown_forward_m": forward,
        "touchdown_starboard_m": starboard,
        "standing_lateral_m": stands.get("lateral_m"),
        "standing_slid_m": stands.get("slid_m"),
        "afterwards": None if (later := flight.get("afterwards")) is None else json.dumps(later),
        "contacts": json.dumps(flight["contacts"]),
        "frames": json.dumps(flight["frames"]),
        **{f"varied_{key}": value for key, value in flight.get("varied", {}).items()},
    }
