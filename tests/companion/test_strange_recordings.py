"""Recordings that somebody changed or made to do harm: one line and exit code 2, or read as far as they go; no traceback."""

import io
import json
import resource
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from companion.cli.main import main
from companion.recording.channels import SETTINGS
from companion.recording.reading import MOST_CHUNK_BYTES, open_recording
from companion.settings import schema
from companion.settings.load import load

# What the filter says of numbers that no vehicle has is its own matter.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

GOLDEN = Path(__file__).parents[1] / "golden"


def small(source: Path, messages: int = 150) -> list[Any]:
    """Return the records of the beginning of a recording, chunks taken apart, with settings that this version reads."""
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


def written(records: list[Any], compression: CompressionType = CompressionType.ZSTD, chunk_size: int = 1 << 20) -> bytes:
    """Return the bytes of a whole file."""
    buffer = io.BytesIO()
    writer = Writer(buffer, compression=compression, chunk_size=chunk_size)
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


@pytest.fixture(scope="module")
def records() -> list[Any]:
    return small(GOLDEN / "approach.mcap")


def ran(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    """Exit code and what stands on stderr, which is at most one line."""
    code = main([str(word) for word in words])
    err = capsys.readouterr().err.strip()
    assert len(err.splitlines()) <= 1
    assert bool(err) == (code == 2)
    return code, err


def changed(records: list[Any], key: str, value: Any, which: int = 0) -> list[Any]:
    """Return the records with another value under this top-level key, in the `which`-th message that has it."""
    out = list(records)
    there = [i for i, r in enumerate(out) if isinstance(r, Message) and key in json.loads(r.data)]
    data = json.loads(out[there[which]].data)
    out[there[which]] = replace(out[there[which]], data=json.dumps({**data, key: value}).encode())
    return out


@pytest.mark.parametrize(("key", "value"), [("at_ns", 10**30), ("done_ns", 2**63), ("seq", -(2**64)), ("width", 2**63)])
def test_an_integer_out_of_range_costs_its_message(tmp_path, capsys, key, value):
    costs_one(tmp_path / "x.mcap", changed(small(GOLDEN / "frames.mcap", 60), key, value, which=-1), capsys)


def costs_one(path, records, capsys):
    """Replay records of which one is left out."""
    path.write_bytes(written(records))
    assert ran(capsys, "replay", path, "--sightings", "--json")[0] == 0
    recording = open_recording([path])
    list(recording.events())
    assert sum(recording.skipped.values()) == 1


def test_an_instant_of_another_day_is_left_out_and_does_not_fly_for_a_year(records, tmp_path, capsys):
    """A recording without guidance cycles of its own is flown at 50 Hz, so a jump would take for ever."""
    inputs = [r for r in records if not (isinstance(r, Message) and "phase" in json.loads(r.data))]
    stamp = {"measured_at_ns": 2**61, "received_at_ns": 2**61, "sigma_s": 0.0, "source": "sim"}
    costs_one(tmp_path / "x.mcap", changed(inputs, "stamp", stamp, which=4), capsys)


def chunk(data: bytes, announced: int, compression: bytes) -> bytes:
    """Return a file with one chunk record."""
    body = struct.pack("<QQQI", 0, 0, announced, 0)
    body += struct.pack("<I", len(compression)) + compression + struct.pack("<Q", len(data)) + data
    head = struct.pack("<I", 0) * 2
    magic = b"\x89MCAP0\r\n"
    return (
        magic + struct.pack("<BQ", Opcode.HEADER, len(head)) + head + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body + magic
    )


@pytest.mark.parametrize("place", ["the header of a chunk", "within a chunk", "the first chunk"])
@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_what_lies_behind_a_damaged_sector_is_still_there(records, tmp_path, capsys, place, compression):
    whole = bytearray(written(records, compression, chunk_size=4096))
    chunks, at = list[int](), 8
    while at < len(whole) - 8:
        chunks += [at] * (whole[at] == Opcode.CHUNK)
        at += 9 + struct.unpack_from("<Q", whole, at + 1)[0]
    path = tmp_path / "x.mcap"
    path.write_bytes(whole)
    counts = [len(list(open_recording([path]).events()))]
    hit = chunks[0] if place == "the first chunk" else chunks[len(chunks) // 2] + (200 if place == "within a chunk" else 0)
    whole[hit : hit + 512] = bytes(512)
    path.write_bytes(whole)
    recording = open_recording([path])
    counts.append(len(list(recording.events())))
    assert len(chunks) > 5
    assert counts[0] * (1 - 3 / len(chunks)) < counts[1] <= counts[0]
    assert "what lies behind is read" in recording.cut[path]
    assert main(["record", "info", str(path)]) == 0
    assert "damaged in 1 place" in capsys.readouterr().out
    for words in (
        ["cut", str(path), "--output", str(tmp_path / "y.mcap")],
        ["export", str(path), "--output", str(tmp_path / "t")],
    ):
        assert main(["record", *words]) == 0
        assert "x.mcap is cut short or damaged" in capsys.readouterr().err


@pytest.mark.parametrize("announced", [1 << 30, 1000, MOST_CHUNK_BYTES, 2**63])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_unpacks_to_a_gigabyte(tmp_path, capsys, announced, compression):
    zeros = bytes(1 << 28)
    data = zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    path = tmp_path / "bomb.mcap"
    path.write_bytes(chunk(data, announced, compression.encode()))
    del zeros
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    code, err = ran(capsys, "record", "info", path)
    assert (code, "bomb.mcap: holds no recording" in err) == (2, True)
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024 < 100


def test_settings_of_another_version_are_refused_in_one_sentence_and_others_may_be_named(records, tmp_path, capsys):
    stranger = b"[guidance.crystal_ball]\nclarity = 1.0\n"
    path = tmp_path / "x.mcap"
    path.write_bytes(
        written([replace(r, data=stranger) if isinstance(r, Attachment) and r.name == SETTINGS else r for r in records])
    )
    code, err = ran(capsys, "replay", path, "--sightings", "--json")
    assert code == 2
    assert "x.mcap: settings.toml: guidance.crystal_ball is not a known key" in err
    assert "made by another version? name settings with --config" in err
    assert ran(capsys, "replay", path, "--sightings", "--json", "--config", "sim")[0] == 0


@pytest.mark.parametrize("compression", list(CompressionType))
def test_recordings_packed_by_others_are_read(records: list[Any], tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(written(records, compression))
    recording = open_recording([path])
    assert len(list(recording.events())) > 50
    assert (recording.cut, recording.skipped) == ({}, {})


def test_json_nested_without_end(records: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    deep = b'{"a":' * 100_000 + b"1" + b"}" * 100_000
    out = list(records)
    i = next(i for i, r in enumerate(out) if isinstance(r, Message) and b"w_body" in r.data)
    out[i] = replace(out[i], data=deep)
    path = tmp_path / "deep.mcap"
    path.write_bytes(written(out))
    assert ran(capsys, "replay", path, "--sightings", "--json")[0] == 0
