"""`decklander record`: inspect, cut, repair, export and import recordings."""

from __future__ import annotations

import argparse
import hashlib
import heapq
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import IO, Any, NamedTuple

from msgspec import Struct, structs

from companion.base import signals
from companion.base.observer import ProcessedFrame
from companion.cli.options import WorkProgress, named_wait, option, print_result, reading, tell_damage
from companion.cli.outputs import RECORDING, Kind, output
from companion.parts.recorder.folder import digest_file, recordings
from companion.parts.recorder.setup import about, recorder_to_file
from companion.recording.reading import MAGIC, RecordedFrame, Recording, instant, open_recording
from companion.recording.rewriting import TABLE_OF, Cut, export, rewrite
from companion.settings.capabilities import importer_of, names_offered, offered, ship_logs
from companion.settings.load import Settings, camera_model, load, shipped, whole
from companion.settings.remarks import sources as sources_of_ship
from drivers.file_kinds import DECRYPT, FileKind, kind_of
from drivers.importer import ForeignFile, Importer, Read
from estimator.contracts.address import guarded
from estimator.contracts.errors import BadInput, Recoverable, in_words, refused
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Attitude, Frame, Sample
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp

DESCRIPTION = (
    "Show what is in recordings (info); cut, repair, export, import and upload them. The service makes recordings if "
    "[recorder] is enabled; simulate and demo make them with --record."
)

TABLES = Kind("table", inside=tuple(TABLE_OF.values()))
_DAY_S = 86_400.0  # sources of a network whose begins are further apart have different clocks
_ATTITUDE_NS = NS_PER_S
"""Age of the newest attitude from which on a frame has none."""
_BLOCK_BYTES = 1 << 20  # bytes that are read at once
_ABANDONED_S = 60.0
"""A recording without an end that did not grow for so long was cut short by a crash, and is uploaded as it is."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    info = actions.add_parser("info", help="show the contents of a recording", description="Show the contents of a recording.")
    option(info, "files FILE", "recording, or the files of one in order", nargs="+", type=Path)
    option(info, "--json", "print one JSON object")
    mend = actions.add_parser(
        "cut",
        help="write a part of a recording, or repair one",
        description="Write a part of a recording, or all that can be read of a damaged one, complete and indexed.",
    )
    option(mend, "files FILE", "recording, or the files of one in order", nargs="+", type=Path)
    output(mend, "--output FILE", "recording to write", RECORDING, required=True)
    option(mend, "--from S", "start this many seconds after the beginning", dest="from_s", default=0.0)
    option(mend, "--to S", "stop this many seconds after the beginning", dest="to_s", type=float)
    option(mend, "--inputs", "keep samples, frames and truth, drop everything computed from them")
    option(mend, "--samples-each N", "keep every n-th sample of each kind", default=1)
    option(mend, "--frames-each N", "keep every n-th frame", default=1)
    option(mend, "--no-frames", "drop the images, keep the detections")
    tables = actions.add_parser(
        "export",
        help="write a recording as CSV tables or as a ROS 2 bag",
        description="Write a recording as CSV tables, one for each topic, with time stamps in microseconds; or as a ROS 2 bag "
        "of standard messages in the axes of REP-103, for which the extra decklander[ros2] is needed.",
    )
    option(tables, "files FILE", "recording, or the files of one in order", nargs="+", type=Path)
    output(tables, "--output DIR", "folder of the tables, or the new bag", TABLES, required=True)
    option(tables, "--format", "what to write (default: csv)", choices=("csv", "ros2"), default="csv")
    foreign = actions.add_parser(
        "import",
        help="import videos, tables and logs of other tools",
        description="Import files of other tools into one recording: videos, folders of images with times, attitude tables (CSV: "
        "time_s,roll_deg,pitch_deg[,yaw_deg]); PX4 ulogs, ArduPilot dataflash logs (binary or text), telemetry logs (.tlog); "
        "bags of ROS 1 and 2, AR.Drone captures (PaVE video, navdata); logs of a ship's sentences (NMEA 0183), with a logger's "
        "time before each or their own, and of her NMEA 2000. The kind is found by the content. Each source begins at 0 of its "
        "own clock, logs of one ship at the first of them; SOURCE@SECONDS shifts it by that much.",
    )
    option(foreign, "sources SOURCE[@SECONDS]", "file to import", nargs="+")
    option(foreign, "--config FILE", f"settings file with the camera and pad ({', '.join(shipped())})", required=True)
    output(foreign, "--output FILE", "recording to write", RECORDING, required=True)
    option(foreign, "--topic TOPIC", "camera of a bag to read (default: that of the raw images)", default="")
    sent = actions.add_parser(
        "upload",
        help="upload the service's finished recordings to object storage",
        description="Upload the service's finished recordings to object storage by fsspec (the extra decklander[fleet]), and "
        "read them back. One that arrived whole has its digest beside it, NAME.sha256, in both places. With "
        'expert.recorder.delete = "uploaded" the service deletes no other. Exit code 1 if a recording could not be uploaded.',
    )
    option(sent, "folder FOLDER", "folder of recordings (recorder.folder)", type=Path)
    option(sent, "--to URL", "s3://BUCKET/DRONE, with access as the AWS tools take it, or a folder", required=True)
    option(sent, "--each S", "go on, and look for new recordings each S seconds", type=float)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    return {"info": _info, "cut": _cut, "export": _export, "upload": _upload, "import": _import}[args.action](args)


def _opened(args: argparse.Namespace) -> Recording:
    recording = open_recording(args.files)
    recording.watch = reading(recording.name, quiet=vars(args).get("json", False))
    return recording


def _info(args: argparse.Namespace) -> int:
    recording = _opened(args)
    first: int | None = None
    last = images = 0
    verdicts: Counter[str] = Counter()
    for event in recording.events():
        at = instant(event)
        first, last = (at if first is None else min(first, at)), max(last, at)
        if isinstance(event, RecordedFrame):
            images += event.image is not None
            verdicts[event.record.verdict.value] += 1
    seconds = 0.0 if first is None else (last - first) * 1e-9
    out: dict[str, Any] = {"seconds": round(seconds, 3), "messages": dict(recording.counts), "frames": images}
    out |= {"verdicts": dict(verdicts), "cut": {str(p): why for p, why in recording.cut.items()}, **recording.metadata}
    print_result(args, out, "\n".join(_described(recording, seconds, images, verdicts)))
    return 0


def _described(recording: Recording, seconds: float, images: int, verdicts: Counter[str]) -> list[str]:
    out = [f"{path} is cut short or damaged ({why}); record cut keeps what is whole" for path, why in recording.cut.items()]
    out += [f"{name}: " + ", ".join(f"{k} {v}" for k, v in data.items()) for name, data in recording.metadata.items()]
    out.append(f"holds {', '.join(recording.attachments) or 'no settings'}")
    out.append(f"{seconds:.1f} s, {images} frames; frames: " + (", ".join(f"{k} {n}" for k, n in verdicts.items()) or "none"))
    out += [f"{n:8d}  {topic}" for topic, n in sorted(recording.counts.items())]
    out += [f"{n:8d}  {topic} that this version cannot read" for topic, n in sorted(recording.skipped.items())]
    return out


def _export(args: argparse.Namespace) -> int:
    recording = _opened(args)
    if args.format == "ros2":
        counts = offered("exporters", "ros2", "--format ros2")(recording, args.output)
        tell_damage(recording.cut, "exported")
        sys.stdout.writelines(f"{n:8d}  {topic}\n" for topic, n in sorted(counts.items()))
        sys.stdout.write(f"{args.output}: {sum(counts.values())} messages; ros2 bag play {args.output}\n")
        return 0
    written = export(recording, args.output)
    tell_damage(recording.cut, "exported")
    sys.stdout.writelines(f"{args.output / name}: {n} rows\n" for name, n in sorted(written.items()))
    return 0


def _upload(args: argparse.Namespace) -> int:
    if args.each is not None and not 1.0 <= args.each <= 86_400.0:
        raise BadInput("--each must be 1 to 86400 seconds")
    sent = set[Path]()
    while True:
        missing = 0
        for done in upload(args.folder, storage(args.to), sent):  # access is read each time: keys are renewed
            missing += done.why is not None
            what = f"uploaded, {done.size / 1e6:.1f} MB" if done.why is None else f"not uploaded: {done.why}"
            print(f"{done.path.name}: {what}", file=sys.stdout if done.why is None else sys.stderr, flush=True)
        if args.each is None:
            return int(missing > 0)
        time.sleep(args.each)


def _cut(args: argparse.Namespace) -> int:
    if args.samples_each < 1 or args.frames_each < 1:
        raise BadInput("--samples-each and --frames-each must be 1 or more")
    if args.to_s is not None and args.to_s <= args.from_s:
        raise BadInput(f"--to {args.to_s:g} must be later than --from {args.from_s:g}")
    recording = _opened(args)
    what = Cut(args.from_s, args.to_s, args.inputs, args.samples_each, args.frames_each, not args.no_frames)
    n = _written(args.output, lambda part: rewrite(recording, part, what))
    tell_damage(recording.cut, "written")
    sys.stdout.write(f"{args.output}: {n} events, {args.output.stat().st_size / 1e6:.2f} MB\n")
    return 0


class _Source(Struct, frozen=True):
    path: Path
    offset_ns: int
    kind: FileKind
    importer: Importer | None
    """Another package's reader of it."""
    topic: str = ""
    """Topic of a bag's camera that is read; empty for the best."""

    def data(self, size: tuple[int, int]) -> Iterator[Sample | Frame]:
        """Yield the data of the source in order, on the common clock; `size` is the camera's (width, height), px."""
        for datum in self._own(size):
            s = datum.stamp
            moved = Stamp(MonoNs(s.measured_at + self.offset_ns), MonoNs(s.received_at + self.offset_ns), s.sigma_s, s.source)
            yield structs.replace(datum, stamp=moved)

    def _own(self, size: tuple[int, int]) -> Iterator[Sample | Frame]:
        path, kind = self.path, self.kind
        file = ForeignFile(path, size, self.note, self.topic)
        if self.importer is not None:
            return iter(self.importer.read(file))
        if kind.name not in names_offered("importers"):
            raise BadInput(f"{path}: {kind.value}, and no video: {_INSTEAD.get(kind, 'it is not imported')}")
        read: Read = offered("importers", kind.name, f"{path}: {kind.value}")
        return iter(read(file))

    def note(self, text: str) -> None:
        """Print a note on the file."""
        sys.stderr.write(f"decklander: {self.path}: {text}\n")


_INSTEAD = {
    FileKind.PARAMETERS: "give it to `decklander doctor`",
    FileKind.ENCRYPTED: DECRYPT,
    FileKind.RECORDING: "it is imported already",
    FileKind.MCAP: "of MCAP files, bags of ROS 2 are imported",
    FileKind.MAVLINK: "give the ground station's .tlog, which has each message's time, or the autopilot's own log",
    FileKind.TEXT: "of text, tables with the header time_s,roll_deg,pitch_deg are imported",
}


def _source(text: str) -> _Source:
    path, at, offset = text.rpartition("@")
    offset_ns, file = 0, Path(text)
    if at and not file.exists():
        try:
            offset_ns, file = round(float(offset) * 1e9), Path(path)
        except (ValueError, OverflowError) as why:
            raise BadInput(f"{text}: after @ comes a number of seconds") from why
    importer = importer_of(file)
    return _Source(file, offset_ns, FileKind.OTHER if importer else kind_of(file), importer)


def _import(args: argparse.Namespace) -> int:
    sources = [_source(text) for text in args.sources]
    # Instants before the common clock's zero would be negative: all are moved by the same amount.
    lead = max(0, -min(s.offset_ns for s in sources))
    sources = [structs.replace(s, offset_ns=s.offset_ns + lead, topic=args.topic) for s in sources]
    settings = load(args.config)
    n = _written(args.output, lambda part: _import_into(part, sources, settings))
    sys.stdout.write(f"{args.output}: {n['samples']} samples, {n['frames']} frames\n")
    return 0


def _streams(sources: Sequence[_Source], settings: Settings, size: tuple[int, int]) -> list[Iterator[Sample | Frame]]:
    """Return the data of each source in order; the logs of a ship's sentences are one.

    Raises:
        BadInput: a ship's log is among them, and the settings know no ship.
    """
    kinds = {s.path: s.kind for s in sources}
    of_ship = [(path, kind) for path, kind in kinds.items() if kind in (FileKind.SENTENCES, FileKind.NETWORK)]
    if not of_ship:
        return [s.data(size) for s in sources]
    path, kind = of_ship[0]
    reader = ship_logs(f"{path}: {kind.value}")
    if settings.vessel == type(settings.vessel)() and not sources_of_ship(settings):
        raise BadInput(f"{path}: {kind.value}: text, and no video or flight; give settings whose table [vessel] knows the ship")
    logs = [s for s in sources if kinds[s.path] is FileKind.SENTENCES]
    began_s = {path: reader.began_s(path) for path, kind in of_ship if kind is FileKind.NETWORK}
    zero_s = min(began_s.values(), default=0.0)
    if max(began_s.values(), default=0.0) - zero_s < _DAY_S:
        later = {path: round(1e9 * (at_s - zero_s)) for path, at_s in began_s.items()}
        sources = [structs.replace(s, offset_ns=s.offset_ns + later.get(s.path, 0)) for s in sources]
    streams = [s.data(size) for s in sources if s not in logs]
    if logs:
        streams.append(reader.read_sentences([(s.path, s.offset_ns) for s in logs], logs[0].note, settings))
    return streams


def _import_into(output: Path, sources: Sequence[_Source], settings: Settings) -> Counter[str]:
    camera = camera_model(settings)
    described = about(settings, {"kind": "import", "sources": ", ".join(s.path.name for s in sources)})
    counts, progress = Counter[str](), WorkProgress("importing", "samples and frames").take
    tilted_ns, untilted = -_ATTITUDE_NS, 0
    with recorder_to_file(output, camera, described) as recorder, named_wait("reading the sources") as begun:
        for datum in heapq.merge(*_streams(sources, settings, (camera.width, camera.height)), key=lambda d: d.stamp.received_at):
            if isinstance(datum, Frame):
                width, height = datum.px.shape[1::-1]
                if (width, height) != (camera.width, camera.height):
                    of_camera = f"the camera file {settings.camera.file} describes {camera.width}x{camera.height} px"
                    raise BadInput(f"frames are {width}x{height} px, {of_camera}")
                # It was not looked at yet: hence the verdict REPLACED.
                at = datum.stamp.received_at
                recorder.on_frame(ProcessedFrame(datum, None, None, Verdict.REPLACED, at, at))
                counts["frames"] += 1
                untilted += datum.stamp.measured_at - tilted_ns >= _ATTITUDE_NS
            else:
                recorder.on_sample(datum)
                tilted_ns = datum.stamp.measured_at if isinstance(datum, Attitude) else tilted_ns
                counts["samples"] += 1
            begun()
            progress(counts.total(), None)
        progress(counts.total(), counts.total())
    if recorder.why:
        raise BadInput(f"{output}: {recorder.why}")
    if untilted and tilted_ns >= 0:
        what = f"{untilted} of {counts['frames']} frames have no attitude in the second before them"
        sys.stderr.write(f"decklander: {what}: do the times of both begin at one instant, in seconds?\n")
    return counts


def _written(output: Path, write: Callable[[Path], Any]) -> Any:
    """Write a file under another name, and give it its own once it is whole: what is there stays until then."""
    with refused(str(output), OSError), whole(output) as part:
        return write(part)


# Upload finished recordings to object storage: a folder, S3 or whatever else fsspec has a file system for.
#
# A recording counts as uploaded when the storage has given back its very bytes. Then its digest lies beside it in both places, as
# `NAME.sha256` in the form of `sha256sum`. Nothing here writes to a recording or takes one away.


class Storage(NamedTuple):
    """A place in object storage: the file system of fsspec, and the path in it."""

    system: Any
    root: str

    def at(self, name: str) -> str:
        """Return the path of a file."""
        return f"{self.root.rstrip('/')}/{name}"


def storage(url: str) -> Storage:
    """Return the storage that a URL names, as `s3://bucket/drone_1` or `/mnt/ship/drone_1`.

    Raises:
        BadInput: fsspec or its file system for this URL is not installed, or the URL names none.
    """
    if find_spec("fsspec") is None:
        raise BadInput("record upload needs fsspec, which is not installed: install the extra decklander[fleet]")
    import fsspec

    with refused(f"--to {guarded(url)}", ImportError, ValueError):
        system, root = fsspec.core.url_to_fs(url, use_listings_cache=False, skip_instance_cache=True)
    return Storage(system, root)


class Uploaded(NamedTuple):
    """A recording that was tried: the reason why the storage does not have it, or None, and its size in bytes."""

    path: Path
    why: str | None
    size: int


def upload(folder: Path, to: Storage, sent: set[Path] | None = None) -> Iterator[Uploaded]:
    """Upload the finished recordings of a folder, the oldest first, and yield each result.

    What the storage has is left out. A broken link costs one file, and the next call sends that file again. A right that is
    refused ends the call: it would be refused for each file, after that one was sent.

    Args:
        sent: the recordings that went out whole and could not be read back, over several calls; they go out once.

    Raises:
        BadInput: the folder cannot be read.
    """
    with refused(str(folder), OSError):
        waiting = [path for path in recordings(folder) if not digest_file(path).exists()]
    for path in waiting:
        try:
            if not finished(path):
                continue
            size = path.stat().st_size
            with named_wait(f"uploading {path.name}"):
                refusal = _sent(path, to, set() if sent is None else sent)
            yield Uploaded(path, refusal, size)
        except Recoverable as why:
            yield Uploaded(path, in_words(why), 0)
            return
        except Exception as why:  # each file system of fsspec has errors of its own
            yield Uploaded(path, f"{type(why).__name__}: {why}", 0)


def finished(path: Path) -> bool:
    """Return whether this recording is written no more. Raises OSError."""
    with path.open("rb") as stream:
        stream.seek(0, 2)
        if stream.tell() >= 2 * len(MAGIC):
            stream.seek(-len(MAGIC), 2)
            if stream.read() == MAGIC:
                return True
    return time.time() - path.stat().st_mtime > _ABANDONED_S


def _sent(path: Path, to: Storage, sent: set[Path]) -> str | None:
    """Send a recording and compare what arrived; return why it is not there, else None.

    Raises:
        Recoverable: writing or reading back is refused; it names the right.
    """
    there = to.at(path.name)
    if path not in sent and not _has(to, there, path.stat().st_size):
        with _right("write (s3:PutObject)"):
            try:
                to.system.put_file(str(path), there)
            except FileNotFoundError:  # no such folder or bucket: only then the right to make one is needed
                to.system.makedirs(to.root, exist_ok=True)
                to.system.put_file(str(path), there)
    sent.add(path)
    digest = _digest(path.open("rb"))
    with _right("read back (s3:GetObject), so that it is not known whether it arrived whole"):
        arrived = _digest(to.system.open(there, "rb"))
    sent.discard(path)
    if arrived != digest:
        with suppress(PermissionError):  # the next one takes its place
            to.system.rm_file(there)
        return "what the storage gives back differs; it is sent again"
    line = f"{digest}  {path.name}\n"
    with _right("write (s3:PutObject)"):
        to.system.pipe_file(to.at(digest_file(path).name), line.encode())
    digest_file(path).write_text(line)
    return None


def _has(to: Storage, there: str, size: int) -> bool:
    """Return whether the storage has a file of this size; False if it may not be known: a missing one without s3:ListBucket."""
    try:
        return bool(to.system.exists(there) and to.system.size(there) == size)
    except PermissionError:
        return False


@contextmanager
def _right(what: str) -> Iterator[None]:
    try:
        yield
    except PermissionError as why:
        raise Recoverable(f"this user or key may not {what}: {why}") from why


def _digest(stream: IO[bytes]) -> str:
    found = hashlib.sha256()
    with stream:
        while block := stream.read(_BLOCK_BYTES):
            signals.check()
            found.update(block)
    return found.hexdigest()
