"""Fuzz the recordings given to `replay` and `report`: MCAP files of any bytes, and well-formed ones with any messages."""

import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

from companion.guidance.pilot import make_pilot
from companion.recording import channels
from companion.recording.reading import RecordedFrame, open_recording
from companion.settings.load import load
from companion.settings.model import Settings
from companion.tools.replay.engine import Replay
from estimator.contracts.errors import BadInput
from fuzz.target import SHARED_MEMORY, Choices, Target, block

TOPICS = tuple(channels.TOPICS)
GOLDEN = Path(__file__).parents[1] / "tests/golden/approach.mcap"
_SHORT = 1500
_SIZE = (640, 360)
"""Width and height of the frames that `GOLDEN` holds, px."""


def run_bytes(data: bytes) -> None:
    """Read a file of any content: refused in one line, or read up to its first damage."""
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        path = Path(folder) / "fuzz.mcap"
        path.write_bytes(data)
        _read(path)


def run_messages(data: bytes) -> None:
    """Read a whole file of messages of any content: each decoded or counted as skipped, and replayed to the end."""
    choices = Choices(data)
    attachments: dict[str, bytes] = {}
    how = choices.number(1)
    for bit, name in enumerate((channels.SETTINGS, channels.CAMERA, channels.PAD)):
        if how >> bit & 1:
            attachments[name] = choices.block()
    rows: list[tuple[str, bytes]] = []
    while choices:
        rows.append((TOPICS[choices.number(1) % len(TOPICS)], choices.block()))
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        path = Path(folder) / "fuzz.mcap"
        write(path, rows, attachments)
        _read(path)


def write(path: Path, rows: list[tuple[str, bytes]], attachments: dict[str, bytes]) -> None:
    """Write a small file: no compression, no index, one channel for each topic."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.NONE, index_types=IndexType.NONE, use_statistics=False)
        writer.start(profile="", library="decklander")
        for name, data in attachments.items():
            writer.add_attachment(0, 0, name, "application/toml", data)
        known = {topic: writer.register_channel(topic, "json", 0) for topic in {TOPICS[0], *(topic for topic, _ in rows)}}
        for number, (topic, data) in enumerate(rows):
            writer.add_message(known[topic], number, data, number, number)
        writer.finish()  # type: ignore[no-untyped-call]


def _read(path: Path) -> None:
    try:
        recording = open_recording([path])
    except BadInput:
        return
    for ask in (recording.settings, recording.camera, recording.pad):
        with suppress(BadInput):
            ask()
    read = 0
    for event in recording.events():
        read += 1
        if isinstance(event, RecordedFrame):
            event.frame(_SIZE)
    assert sum(recording.counts.values()) >= read
    with suppress(BadInput):
        Replay(recording, make_pilot(_settings()), sightings=True).run()


@cache
def _settings() -> Settings:
    return load("sim")


@cache
def _rows() -> tuple[tuple[str, bytes], ...]:
    """Return the first short message of each topic of a recording that the repository keeps."""
    found: dict[str, bytes] = {}
    for _, channel, message in make_reader(GOLDEN.open("rb")).iter_messages():
        if channel.topic in TOPICS and len(message.data) < _SHORT:
            found.setdefault(channel.topic, message.data)
    return tuple(found.items())


def bytes_seeds() -> Iterator[bytes]:
    """Yield whole small files, with and without checksums and compression."""
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        path = Path(folder) / "seed.mcap"
        write(path, list(_rows()), {})
        yield path.read_bytes()
        for compression in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4):
            with path.open("wb") as file:
                writer = Writer(file, compression=compression, enable_crcs=False, enable_data_crcs=False)
                writer.start(profile="", library="decklander")
                topic, data = _rows()[0]
                writer.add_message(writer.register_channel(topic, "json", 0), 1, data, 1, 1)
                writer.finish()  # type: ignore[no-untyped-call]
            yield path.read_bytes()


def messages_seeds() -> Iterator[bytes]:
    """Yield every sample, a detection, and the shipped settings, with camera and pad attached."""
    rows = b"".join(bytes([TOPICS.index(topic)]) + block(data) for topic, data in _rows())
    camera = b"width = 640\nheight = 360\nfx = 374.67\nfy = 374.67\ncx = 319.5\ncy = 179.5\n"
    yield b"\0" + rows
    yield b"\3" + block(b'[vehicle]\nkind = "ardrone"\n') + block(camera) + rows
    for topic, data in _rows():
        yield b"\0" + bytes([TOPICS.index(topic)]) + block(data)


TARGETS = {
    "mcap_bytes": Target(run_bytes, bytes_seeds),
    "mcap_messages": Target(run_messages, messages_seeds),
}
