"""Rewrite a recording: repair it, shorten it, thin it, reduce it to its inputs, or export it as tables."""

import csv
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import msgspec
from mcap.records import Channel, Message

from companion.base.observer import Decision
from companion.facts import encode
from companion.facts.records import DetectionRecord, FusionRecord, HealthRecord, LinkRecord, OrderRecord, TruthRecord
from companion.recording import channels
from companion.recording import foxglove as fox
from companion.recording.frame_encoder import RECORDED, FrameEncoder, VideoImage
from companion.recording.mcap_file import About, Attachment, McapFile
from companion.recording.message_encoder import MessageEncoder
from companion.recording.reading import Event, RecordedFrame, Recording, instant, records
from estimator.contracts.errors import BadInput, refused
from estimator.contracts.estimates import Method
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between

_COLUMNS_MAX = 1000
"""More columns than any record of ours has: a file with such a one is damaged."""
_TABLED = channels.TOPICS.keys() - channels.FOR_VIEWERS - {channels.IMAGE, channels.VIDEO}
TABLE_OF = {topic: f"{topic.strip('/').replace('/', '_')}.csv" for topic in sorted(_TABLED)}
"""The name of each topic's table."""
Row = dict[str, float | int | str | bool]


def export(recording: Recording, folder: Path) -> dict[str, int]:
    """Write a table of each topic of ours into the folder, remove those of another recording, and return each file's rows.

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
    with refused(f"{folder}: cannot write tables there", OSError):
        folder.mkdir(parents=True, exist_ok=True)
        for name in TABLE_OF.values():
            (folder / name).unlink(missing_ok=True)
        with ExitStack() as opened:
            tables: dict[str, tuple[str, csv.DictWriter[str]]] = {}
            for topic, known in columns.items():
                name = TABLE_OF[topic]
                stream = opened.enter_context((folder / name).open("w", newline="", encoding="utf-8"))
                tables[topic] = name, csv.DictWriter(stream, ["timestamp", *known], restval="")
                tables[topic][1].writeheader()
            for topic, at_ns, row in _rows(recording):
                name, table = tables[topic]
                table.writerow({**row, "timestamp": at_ns // 1000})
                written[name] += 1
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
                    if topic in TABLE_OF:
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


@dataclass(frozen=True, slots=True)
class Cut:
    """The part of a recording that is kept."""

    from_s: float = 0.0
    to_s: float | None = None
    """The end of the part; start and end are times after the recording's first event, s."""
    inputs: bool = False
    """True if only samples, frames and truth are kept; of each detection only the selected sighting is kept."""
    samples_each: int = 1
    """The step n that keeps each n-th sample of a kind; the vehicle's status is always kept."""
    frames_each: int = 1
    images: bool = True


def rewrite(recording: Recording, output: Path, cut: Cut) -> int:
    """Write the part into `output`, which is replaced; return the number of its events.

    Raises:
        BadInput: the recording does not name its camera, its metadata cannot be read, or no event lies in the part.
        OSError: the file cannot be written.
    """
    camera = recording.camera()
    if camera is None:
        raise BadInput(f"{recording.name}: does not hold its camera")
    metadata = {name: data for name, data in recording.metadata.items() if name != "clock"}
    offset_ns = recording.offset_ns()
    attachments = [Attachment(name, "application/toml", data) for name, data in recording.attachments.items()]
    message_encoder = MessageEncoder(camera, offset_ns, "none", 90, recording.pad())
    output.unlink(missing_ok=True)
    file = McapFile(output, About(metadata, attachments, offset_ns))
    try:
        n = _copy(recording, file, message_encoder, cut, offset_ns)
        if n == 0:
            raise BadInput(f"{recording.name}: no event lies in that part")
    except BaseException:
        file.abandon()
        raise
    file.close()
    return n


def _copy(recording: Recording, file: McapFile, message_encoder: MessageEncoder, cut: Cut, offset_ns: int) -> int:
    first: MonoNs | None = None
    met: Counter[str] = Counter()
    n = 0
    video = FrameEncoder(RECORDED)
    for event in recording.events():
        at = instant(event)
        if first is None:
            first = at
            for topic, t, message in message_encoder.preamble(at):
                file.add(topic, t, message)
        since_s = seconds_between(first, at)
        if (cut.from_s > 0 and since_s < cut.from_s) or (cut.to_s is not None and since_s > cut.to_s):
            continue
        if not _kept(event, cut, met):
            continue
        n += 1
        t = max(0, at + offset_ns)
        if isinstance(event, RecordedFrame):
            exposed_at = event.record.stamp.measured_at_ns + offset_ns
            image = event.image if cut.images else None
            if isinstance(image, VideoImage):
                # A part of a video may not begin where a key frame stands, so that it is encoded again.
                px = image.px()
                if px is not None:
                    file.add(channels.VIDEO, t, fox.CompressedVideo(fox.time_of(exposed_at), "cam", video.encoded(px), "h264"))
            elif image is not None:
                form = "png" if image.startswith(b"\x89PNG") else "jpeg"
                file.add(channels.IMAGE, t, fox.compressed_image(exposed_at, image, form))
            file.add(channels.DETECTION, t, _without_methods(event.record) if cut.inputs else event.record)
        elif cut.inputs and not isinstance(
            event, TruthRecord | FusionRecord | LinkRecord | HealthRecord | OrderRecord | Decision
        ):
            file.add(channels.SAMPLES[type(event)], t, encode.sample(event))
        elif cut.inputs and isinstance(event, TruthRecord):
            file.add(channels.TRUTH, t, event)
        else:
            for topic, moment, message in message_encoder.messages(at, event):
                file.add(topic, moment, message)
        if file.pending_bytes > 1 << 22:
            file.flush()
    return n


def _without_methods(record: DetectionRecord) -> DetectionRecord:
    tried = None if record.tried is None else list[str]()
    return msgspec.structs.replace(record, tried=tried, **dict.fromkeys(get_args(Method), None) | {"selected": record.selected})


def _kept(event: Event, cut: Cut, met: Counter[str]) -> bool:
    match event:
        case Decision() | FusionRecord() | LinkRecord() | HealthRecord() | OrderRecord():
            return not cut.inputs
        case TruthRecord() | VehicleStatus():
            return True
        case RecordedFrame():
            kind, each = "frame", cut.frames_each
        case _:
            kind, each = type(event).__name__, cut.samples_each
    met[kind] += 1
    return (met[kind] - 1) % each == 0
