"""Write a recording as tables: one CSV file for each topic, with the columns that `ulog2csv` of PX4 would give."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
from mcap.records import Channel, Message

from companion.recording import channels
from companion.recording.container import records
from companion.recording.reading import Recording
from estimator.contracts.errors import BadInput, fault_of

_COLUMNS_MAX = 1000
"""More columns than any record of ours has: a file with such a one is damaged."""
_EXPORTED = frozenset(topic for topic, kind in channels.TOPICS.items() if channels.schema_name(kind).startswith("decklander."))
Row = dict[str, float | int | str | bool]


def export(recording: Recording, folder: Path) -> dict[str, int]:
    """Write a table of each topic of ours into the folder, and return the number of rows of each file.

    The first column is `timestamp`, microseconds on the recording's time axis. Lists are `name[0]`, `name[1]`, named numbers are
    `details.name`; what a message leaves out is empty. Images and drawings for viewers are left out.

    Raises:
        BadInput: the folder cannot be written, or a message has more columns than any of ours.
    """
    columns: dict[str, dict[str, None]] = {}
    for topic, _, row in _rows(recording):
        known = columns.setdefault(topic, {})
        known.update(dict.fromkeys(row))
        if len(known) > _COLUMNS_MAX:
            raise BadInput(f"{recording.name}: {topic} has more than {_COLUMNS_MAX} columns; the file is damaged")
    written: Counter[str] = Counter()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as opened:
            tables: dict[str, tuple[str, csv.DictWriter[str]]] = {}
            for topic, known in columns.items():
                name = f"{topic.strip('/').replace('/', '_')}.csv"
                stream = opened.enter_context((folder / name).open("w", newline="", encoding="utf-8"))
                tables[topic] = name, csv.DictWriter(stream, ["timestamp", *known], restval="")
                tables[topic][1].writeheader()
            for topic, at_ns, row in _rows(recording):
                name, table = tables[topic]
                table.writerow({**row, "timestamp": at_ns // 1000})
                written[name] += 1
    except OSError as why:
        raise BadInput(f"{folder}: cannot write tables there: {fault_of(why)}") from why
    return dict(written)


def _rows(recording: Recording) -> Iterator[tuple[str, int, Row]]:
    """Yield topic, time and columns of every message of ours; what cannot be read is left out."""
    for path in recording.paths:
        with path.open("rb") as stream:
            topics: dict[int, str] = {}
            for record in records(stream, path, recording.cut):
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    topic = topics.get(record.channel_id, "")
                    if topic in _EXPORTED:
                        try:
                            row = dict(_flat(msgspec.json.decode(record.data), ""))
                        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                            continue
                        yield topic, record.log_time, row


def _flat(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the columns of a value by their names."""
    match value:
        case {"name": str(own), "value": int() | float() as number, **rest} if not rest:
            yield f"{name.rpartition('[')[0]}.{own}", number
        case dict():
            for key, inner in value.items():
                yield from _flat(inner, f"{name}.{key}" if name else str(key))
        case list():
            for k, inner in enumerate(value):
                yield from _flat(inner, f"{name}[{k}]")
        case None:
            return
        case _:
            yield name or "value", value
