"""Results as one Parquet file, for pandas, polars, DuckDB and the like."""

from __future__ import annotations

import io
import itertools
import json
from collections.abc import Iterable
from typing import Any

from sitl.campaign.task import Flight

TABLE = "flights.parquet"
_ROWS = 20_000
_TOUCH = ("surface", "on_pad", "lateral_m", "yaw_deg", "vertical_speed_m_s", "lateral_speed_m_s")


def table_bytes(flights: Iterable[Flight], varied: dict[str, Any]) -> bytes:
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
    touch = flight["touchdown"] or {}
    forward, starboard = touch.get("p_pad_m") or (None, None)
    return {
        **{key: value for key, value in flight.items() if key not in ("touchdown", "contacts", "frames", "varied")},
        **{f"touchdown_{name}": touch.get(name) for name in _TOUCH},
        "touchdown_forward_m": forward,
        "touchdown_starboard_m": starboard,
        "contacts": json.dumps(flight["contacts"]),
        "frames": json.dumps(flight["frames"]),
        **{f"varied_{key}": value for key, value in flight.get("varied", {}).items()},
    }
