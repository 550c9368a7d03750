"""Read recordings, whole, truncated or damaged: everything but the chunks in which a byte is missing or wrong.

A file is not trusted: every announced length is bounded before memory is allocated for it. An MCAP record announces its own
length and those of its parts, and a chunk announces its unpacked size. The library trusts both, so it reads from a stream that
knows where the file ends, and chunks are unpacked here.
"""

import os
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import IO, Any, cast

import lz4.frame
import msgspec
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk
from msgspec import Struct, field

from companion.base.observer import Decision, FrameTimes
from companion.facts import encode
from companion.facts import records as rec
from companion.recording import channels, decode
from companion.recording import foxglove as fox
from companion.recording.frame_encoder import FrameSequence, VideoImage
from companion.settings.load import Settings, from_file
from drivers.camera import images
from drivers.files import Largest, opened
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame, Sample
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.pad.pad import Pad

MAGIC = b"\x89MCAP0\r\n"
MOST_RECORD_BYTES = 128 << 20
MOST_CHUNK_BYTES = 64 << 20
"""The largest size of an unpacked chunk: sixteen times the size of ours."""


def records(stream: IO[bytes], path: Path, cut: dict[Path, str]) -> Iterator[McapRecord]:
    """Yield all records in order; if the file ends early or is damaged, put the reason into `cut`.

    Behind a damaged place it goes on with the next whole chunk.

    Args:
        stream: the file, open at its beginning.

    Raises:
        BadInput: the file does not even begin like an MCAP file.
    """
    if stream.read(len(MAGIC)) != MAGIC:
        raise BadInput(f"{path}: not an MCAP file")
    stream.seek(0)
    found, whole, damaged = _reader(stream), 0, 0
    while True:
        try:
            record = next(found, None)
            inner = breakup_chunk(_unpacked(record), validate_crc=True) if isinstance(record, Chunk) else [record]
            whole = stream.tell()
        # The bytes may come from anywhere, and the library raises whatever its parsing stumbles over.
        except Exception as why:
            damaged += 1
            cut[path] = str(why) or type(why).__name__
            behind = _next_chunk(stream, whole + 1)
            if behind is None:
                return
            cut[path] += f"; damaged in {damaged} place{'s' * (damaged > 1)}, and what lies behind is read"
            whole = behind
            stream.seek(behind)
            found = _reader(stream, skip_magic=True)
            continue
        for one in inner:
            if one is None:
                return
            yield one


def _reader(stream: IO[bytes], *, skip_magic: bool = False) -> Iterator[McapRecord]:
    ending = cast(IO[bytes], _Ending(stream))
    reader = StreamReader(
        ending, skip_magic=skip_magic, emit_chunks=True, validate_crcs=True, record_size_limit=MOST_RECORD_BYTES
    )
    return iter(reader.records)


_PACKED = re.compile(rb"\x04\0\0\0zstd|\x03\0\0\0lz4")
"""The name of a chunk's compression, with its length."""
_BEFORE_PACKED = 1 + 8 + 8 + 8 + 8 + 4
"""Bytes of a chunk before that name: opcode, length, two times, size, checksum (MCAP specification, Chunk)."""


def _next_chunk(stream: IO[bytes], start: int) -> int | None:
    """Return where the next chunk begins from a place on whose announced lengths agree with each other; None if there is none."""
    with mmap(stream.fileno(), 0, access=ACCESS_READ) as data:
        for name in _PACKED.finditer(data, start):
            at = name.start() - _BEFORE_PACKED
            length, held = (int.from_bytes(data[i : i + 8], "little") for i in (at + 1, name.end()))
            around = name.end() + 8 - (at + 9)
            if at >= start and data[at] == Opcode.CHUNK and length == around + held and at + 9 + length <= len(data):
                return at
    return None


def _summary(path: Path) -> tuple[dict[int, str], int]:
    """Return the topics by the numbers of their channels and the last message's time, ns, as the end of a whole file has them."""
    with suppress(Exception), opened(path, Largest.RECORDING) as stream:  # of the library: any of a damaged file
        if (found := make_reader(stream).get_summary()) is not None:
            topics = {number: channel.topic for number, channel in found.channels.items()}
            return topics, 0 if found.statistics is None else found.statistics.message_end_time
    return {}, 0


def _unpacked(chunk: Chunk) -> Chunk:
    """Return the chunk without compression.

    Raises:
        McapError: it is larger than `MOST_CHUNK_BYTES`, or not of the size that it announces.
    """
    announced = chunk.uncompressed_size
    if announced > MOST_CHUNK_BYTES:
        raise McapError(f"a chunk announces {announced} bytes, at most {MOST_CHUNK_BYTES} are read")
    match chunk.compression:
        case "zstd":
            # Unpack one byte more than announced, so that a chunk that holds more is detected.
            unpacked = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(announced + 1)
        case "lz4":
            unpacked = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=announced + 1)
        case "":
            unpacked = chunk.data
        case other:
            raise McapError(f"chunks are packed with {other[:20]!r}, which is not read")
    if len(unpacked) != announced:
        raise McapError(f"a chunk announces {announced} bytes and does not hold them")
    return replace(chunk, compression="", data=unpacked)


class _Ending:
    """A file that knows where it ends: a read beyond the end allocates no memory for the missing bytes."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self._left = os.fstat(stream.fileno()).st_size - stream.tell()

    def read(self, size: int = -1) -> bytes:
        data = self._stream.read(self._left if size < 0 else min(size, self._left))
        self._left -= len(data)
        return data


NOT_UNDERSTOOD = (msgspec.MsgspecError, ValueError, TypeError, ArithmeticError, RecursionError)
"""Errors that mean that this version does not understand a message."""
_APART_NS = 24 * 3600 * NS_PER_S
"""The longest time between two consecutive events, ns: a single event that is further away has a damaged instant."""
_OVERLAP_NS = NS_PER_S
"""The longest time by which a part may begin before the last message of the one before: messages are not quite in order."""


class RecordedFrame(Struct, frozen=True, eq=False):
    """One frame as it was recorded."""

    record: rec.DetectionRecord
    image: bytes | VideoImage | None
    """The bytes of the image file (JPEG, PNG), or the frame of a video; None if it was not kept."""

    @property
    def stamp(self) -> Stamp:
        return decode.stamp(self.record.stamp)

    @property
    def done(self) -> MonoNs:
        """The instant at which vision finished the frame."""
        return MonoNs(self.record.done_ns)

    @property
    def attitude(self) -> Attitude | None:
        """The attitude at the exposure, as the service then knew it."""
        return None if self.record.attitude is None else decode.attitude(self.record.attitude)

    def check(self) -> None:
        """Check the frame and its detection. Raises ValueError if numbers are not valid."""
        _ = self.stamp, self.attitude, self.detection(), self.R_body_cam

    def detection(self) -> Detection | None:
        """Return the recorded detection without the features in pixels, or None if vision did not run."""
        return decode.detection(self.record)

    @property
    def R_body_cam(self) -> Rotation | None:
        """The rotation of the camera on the body as its gimbal held it; None of one that is fixed, or if it is not known."""
        return encode.held_rotation(self.record)

    @property
    def times(self) -> FrameTimes | None:
        """Durations of the frame's stages; None if the recording has none."""
        return decode.frame_times(self.record)

    def frame(self, size: tuple[int, int]) -> Frame | None:
        """Decode the image again.

        Args:
            size: width and height of the camera, px.

        Returns:
            The frame, or None if the image was not kept, is damaged, or claims another size.
        """
        px = None
        if isinstance(self.image, VideoImage):
            px = self.image.px()
        elif self.image is not None:
            with suppress(images.ImageRefused):
                px = images.decode(self.image, size)
        if px is None or px.shape[:2] != (size[1], size[0]):
            return None
        r, coded = self.record, self.record.coded or isinstance(self.image, VideoImage)
        return Frame(self.stamp, r.seq, px, r.exposure_s, r.gain, coded)


Event = (
    Sample | RecordedFrame | Decision | rec.FusionRecord | rec.TruthRecord | rec.LinkRecord | rec.HealthRecord | rec.OrderRecord
)


def instant(event: Event) -> MonoNs:
    """Return the instant at which the service processed the event."""
    match event:
        case RecordedFrame():
            return event.done
        case Decision():
            return event.at
        case rec.FusionRecord() | rec.TruthRecord() | rec.LinkRecord() | rec.HealthRecord() | rec.OrderRecord():
            return MonoNs(event.at_ns)
        case _:
            return event.stamp.received_at


class _Instants:
    """Distinguishes a damaged instant from a recording that resumes after days: the latter has more than one event."""

    def __init__(self) -> None:
        self._last: MonoNs | None = None
        self._suspect: MonoNs | None = None

    def plausible(self, at: MonoNs) -> bool:
        near = [known for known in (self._last, self._suspect) if known is not None and abs(at - known) <= _APART_NS]
        if self._last is not None and not near:
            self._suspect = at
            return False
        self._last, self._suspect = at, None
        return True


class Recording(Struct, eq=False):
    """One recording, in one file or in the several files that a long one was split into."""

    paths: tuple[Path, ...]
    metadata: dict[str, dict[str, str]]
    attachments: dict[str, bytes]
    counts: Counter[str] = field(default_factory=Counter)
    """The number of messages in the newest pass through `events`, by topic."""
    skipped: Counter[str] = field(default_factory=Counter)
    """The number of messages in that pass that this version does not understand, by topic."""
    cut: dict[Path, str] = field(default_factory=dict)
    """The files that are truncated or damaged, and the reason for each."""
    watch: Callable[[int, int], None] = lambda _read, _of: None
    """Shows how many kB of the files the newest pass has read, and how many there are."""

    @property
    def name(self) -> str:
        return self.paths[0].name

    def events(self) -> Iterator[Event]:
        """Yield every event in the order of recording; a frame is decoded when it is requested."""
        self.counts, self.skipped, self.cut = Counter(), Counter(), {}
        read, size = 0, sum(path.stat().st_size for path in self.paths)
        for path in self.paths:
            with opened(path, Largest.RECORDING) as stream:
                for event in self._events(path, stream):
                    self.watch((read + stream.tell()) // 1000 + 1, size // 1000 + 2)
                    yield event
            read += path.stat().st_size
        self.watch(size // 1000 + 2, size // 1000 + 2)

    def _events(self, path: Path, stream: IO[bytes]) -> Iterator[Event]:
        assembled = EventAssembly()
        instants = _Instants()
        for topic, data in self.messages(path, stream):
            self.counts[topic] += 1
            try:
                event = assembled.event(topic, data)
                if event is not None and not instants.plausible(instant(event)):
                    raise ValueError("its instant is days away from those around it")
            except NOT_UNDERSTOOD:
                self.skipped[topic] += 1
                continue
            if event is not None:
                yield event

    def messages(self, path: Path, stream: IO[bytes]) -> Iterator[tuple[str, bytes]]:
        """Yield the topic and the bytes of each message of one of the files."""
        topics: dict[int, str] = {}
        for record in records(stream, path, self.cut):
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                if record.channel_id not in topics and path in self.cut:
                    topics = _summary(path)[0] | topics  # the chunk that names them is damaged
                yield topics.setdefault(record.channel_id, ""), record.data

    def offset_ns(self) -> int:
        """Return the offset from the recording's instants to the time axis of its file, ns.

        Raises:
            BadInput: it is no number.
        """
        text = self.metadata.get("clock", {}).get("monotonic_to_epoch_ns", "0")
        if not re.fullmatch(r"-?\d{1,19}", text):
            raise BadInput(f"{self.name}: its clock's offset is no number of nanoseconds: {text[:40]!r}")
        return int(text)

    def settings(self) -> Settings | None:
        """Return the settings that the recording was made with, or None if it holds none.

        Raises:
            BadInput: this version does not understand them.
        """
        data = self._toml(channels.SETTINGS)
        return None if data is None else from_file(data, f"{self.name}: {channels.SETTINGS}")

    def camera(self) -> Camera | None:
        """Return the camera that the recording was made with, or None; raises as `settings`."""
        data = self._toml(channels.CAMERA)
        return None if data is None else Camera.from_mapping(data, f"{self.name}: {channels.CAMERA}")

    def pad(self) -> Pad | None:
        """Return the pad that the recording was made with, or None; raises as `settings`."""
        data = self._toml(channels.PAD)
        return None if data is None else Pad.from_mapping(data, f"{self.name}: {channels.PAD}")

    def _toml(self, name: str) -> dict[str, Any] | None:
        if name not in self.attachments:
            return None
        with refused(f"{self.name}: {name}", UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError):
            return tomllib.loads(self.attachments[name].decode("utf-8"))


def open_recording(paths: Sequence[Path]) -> Recording:
    """Open the recording in these files, in the order of their times, and read the head of each.

    Raises:
        BadInput: a file cannot be read, is no MCAP file, or holds nothing of ours; or the files are not of one recording.
    """
    if not paths:
        raise BadInput("no recording named")
    heads = sorted(map(_head, paths), key=lambda head: head[0])
    for (begun_ns, ended_ns, one), (begins_ns, _, other) in pairwise(heads):
        about = [{**part.metadata, **part.attachments} for part in (one, other)]
        differs = [name for name in about[0].keys() & about[1].keys() if about[0][name] != about[1][name]]
        if differs or begins_ns <= max(begun_ns, ended_ns - _OVERLAP_NS):
            why = f"they differ in {', '.join(sorted(differs))}" if differs else "their times overlap"
            raise BadInput(
                f"{one.paths[0]} and {other.paths[0]} are two recordings ({why}): give the files of one; "
                "`decklander report A B` compares two"
            )
    return Recording(tuple(part.paths[0] for _, _, part in heads), heads[0][2].metadata, heads[0][2].attachments)


def _head(path: Path) -> tuple[int, int, Recording]:
    """Return the times of a file's first and last message as far as they are known, ns, and its head; see `open_recording`."""
    part, begins_ns, ours, topics = Recording((path,), {}, {}), 0, False, dict[int, str]()
    with opened(path, Largest.RECORDING) as stream:
        for record in records(stream, path, {}):
            if isinstance(record, Metadata):
                part.metadata.setdefault(record.name, dict(record.metadata))
            elif isinstance(record, Attachment):
                part.attachments.setdefault(record.name, record.data)
            elif isinstance(record, Channel):
                ours = ours or record.topic in channels.TOPICS
                topics[record.id] = record.topic
            elif isinstance(record, Message) and topics.get(record.channel_id) not in channels.FOR_VIEWERS:
                begins_ns = record.log_time
                break
    at_the_end, ends_ns = _summary(path)
    if not ours and channels.TOPICS.keys().isdisjoint(at_the_end.values()):
        raise BadInput(f"{path}: holds no recording of decklander, or is cut before its first message")
    return begins_ns, ends_ns, part


class EventAssembly:
    """Assembles events that were written as several messages: a frame and its detection, beliefs and their decision."""

    def __init__(self) -> None:
        self._decoders = {topic: msgspec.json.Decoder(kind) for topic, kind in channels.TOPICS.items()}
        self._image: bytes | VideoImage | None = None
        self._video = FrameSequence()
        self._beliefs: list[RelativeState] = []

    def event(self, topic: str, data: bytes) -> Event | None:
        """Return the event that a message completes, or None if it is only for viewers or a part of a later event.

        Raises:
            Exception: one of `NOT_UNDERSTOOD`, for a message that is damaged or of another version.
        """
        if topic in channels.FOR_VIEWERS or topic not in self._decoders:
            return None
        message = self._decoders[topic].decode(data)
        match message:
            case fox.CompressedImage():
                self._image = message.data
                return None
            case fox.CompressedVideo():
                self._image = self._video.add(message.data)
                return None
            case rec.DetectionRecord():
                image, self._image = self._image, None
                frame = RecordedFrame(message, image)
                frame.check()
                return frame
            case rec.BeliefRecord():
                self._beliefs.append(decode.belief(message))
                return None
            case rec.DecisionRecord():
                return self._decision(message)
            case rec.TruthRecord():
                decode.truth(message)
                return message
            case rec.FusionRecord():
                decode.fusion(message)
                return message
            case rec.OrderRecord() | rec.LinkRecord() | rec.HealthRecord():
                return message
            case _:
                return decode.sample(message)

    def _decision(self, message: rec.DecisionRecord) -> Decision:
        beliefs, self._beliefs = [b for b in self._beliefs if b.at == message.at_ns], []
        steering = next((b for b in beliefs if b.path == message.steering), None)
        shadows = tuple(b for b in beliefs if b is not steering)
        return Decision(
            MonoNs(message.at_ns),
            message.phase,
            decode.command(message),
            steering,
            shadows,
            message.reason,
            transitions=tuple(decode.transition(change) for change in message.transitions),
            response=decode.response(message.response),
            ahead=decode.deck(message.deck, MonoNs(message.at_ns)),
        )
