"""Recordings that somebody changed: single values of single messages, or single bytes, with every checksum right again."""

import io
import json
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from companion.recording.reading import SETTINGS
from companion.settings import schema
from companion.settings.load import load

NONSENSE: tuple[Any, ...] = (
    None, True, "", "x" * 5000, -1, 0, 2**31, 2**63, 2**64, 10**30, -(2**63), 10**400, 1.5, -1e308, 1e308, 1e-300, [], {},
    [0.0] * 2, [1e300] * 3, [1e300] * 9, [[[]]], {"measured_at_ns": -1}, "ekf", "fused", "velocity",
)  # fmt: skip


def small(source: Path, messages: int = 150) -> list[Any]:
    """Return the records of the beginning of a recording, chunks taken apart, with settings that this version reads.

    A recording keeps the settings of the version that made it. One that stays for years is refused for a key of then, before
    any of its messages is read.
    """
    settings = schema.toml(load("sim")).encode()
    out: list[Any] = []
    with source.open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Message | Channel | Schema | Metadata | Attachment):
                own = isinstance(record, Attachment) and record.name == SETTINGS
                out.append(replace(record, data=settings) if own else record)
            messages -= isinstance(record, Message)
            if not messages:
                break
    return out


def written(records: list[Any], compression: CompressionType = CompressionType.ZSTD) -> bytes:
    """Return the bytes of a whole file."""
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=compression)
    writer.start(profile="", library="mutated")
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for r in records:
        match r:
            case Attachment():
                writer.add_attachment(r.create_time, r.log_time, r.name, r.media_type, r.data)
            case Metadata():
                writer.add_metadata(r.name, r.metadata)
            case Schema():
                schemas[r.id] = writer.register_schema(r.name, r.encoding, r.data)
            case Channel():
                channels[r.id] = writer.register_channel(r.topic, r.message_encoding, schemas[r.schema_id], r.metadata)
            case Message():
                writer.add_message(channels[r.channel_id], r.log_time, r.data, r.publish_time, r.sequence)
    writer.finish()
    return buffer.getvalue()


def mutate(records: list[Any], rng: random.Random, count: int = 3) -> list[Any]:
    """Return the same records, `count` of their values replaced by nonsense."""
    out = list(records)
    messages = [i for i, r in enumerate(out) if isinstance(r, Message) and r.data[:1] == b"{"]
    for _ in range(count):
        i = messages.pop(rng.randrange(len(messages)))
        data = json.loads(out[i].data)
        _poke(data, rng)
        out[i] = replace(out[i], data=_text(data, rng))
    return out


def _poke(data: Any, rng: random.Random) -> None:
    while True:
        keys = list(data) if isinstance(data, dict) else list(range(len(data)))
        if not keys:
            return
        key = rng.choice(keys)
        inner = data[key]
        if isinstance(inner, dict | list) and inner and rng.random() < 0.7:
            data = inner
            continue
        if rng.random() < 0.1 and isinstance(data, dict):
            del data[key]
        elif isinstance(inner, int | float) and rng.random() < 0.4:
            data[key] = inner * rng.choice([-1, 0, 2, 1e3, 1e9, 1e18, 1e100])
        else:
            data[key] = rng.choice(NONSENSE)
        return


def _text(data: Any, rng: random.Random) -> bytes:
    text = json.dumps(data).encode()
    if rng.random() < 0.05:
        return b'{"a":' * 3000 + b"1" + b"}" * 3000
    return text


def poke_bytes(data: bytes, rng: random.Random, count: int = 4) -> bytes:
    """Return the bytes with `count` places of 1, 4 or 8 bytes overwritten by 0xff, zeros or chance."""
    out = bytearray(data)
    for _ in range(count):
        at, span = rng.randrange(8, len(out)), rng.choice([1, 1, 1, 4, 8])
        out[at : at + span] = rng.choice([b"\xff" * span, bytes(span), rng.randbytes(span)])
    return bytes(out)
