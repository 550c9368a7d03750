"""`decklander record`: inspect, cut, repair, export and import recordings."""

from __future__ import annotations

import argparse
import heapq
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msgspec import structs

from companion.base.observer import ProcessedFrame
from companion.cli.options import option, print_result
from companion.parts.recorder.setup import about, recorder_to_file
from companion.parts.recorder.upload import storage, upload
from companion.recording.reading import RecordedFrame, Recording, instant, open_recording
from companion.recording.rewriting import Cut, export, rewrite
from companion.settings.load import Settings, camera_model, load, shipped
from companion.tools.ros2 import bag, bag_import
from drivers.imports import ardrone_capture, dataflash, pictures, px4_ulog, tlog
from drivers.imports.kinds import FileKind, kind_of
from drivers.imports.stamps import Tell
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Frame, Sample
from estimator.contracts.time import MonoNs, Stamp

DESCRIPTION = (
    "Inspect, cut, repair, export, import and upload recordings. The service makes recordings if [recorder] is "
    "enabled; simulate and demo make them with --record."
)


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
    option(mend, "--output FILE", "recording to write", required=True, type=Path)
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
    option(tables, "--output DIR", "folder of the tables, or the new bag", required=True, type=Path)
    option(tables, "--format", "what to write (default: csv)", choices=("csv", "ros2"), default="csv")
    foreign = actions.add_parser(
        "import",
        help="import videos, tables and logs of other tools",
        description="Import files of other tools into one recording: videos, folders of images with times, attitude tables (CSV: "
        "time_s,roll_deg,pitch_deg[,yaw_deg]); PX4 ulogs, ArduPilot dataflash logs (binary or text), telemetry logs (.tlog); "
        "bags of ROS 1 and 2, AR.Drone captures (PaVE video, navdata). The kind is found by the content. Each source begins at "
        "0 of its own clock; SOURCE@SECONDS shifts it by that much.",
    )
    option(foreign, "sources SOURCE[@SECONDS]", "file to import", nargs="+")
    option(foreign, "--config FILE", f"settings file with the camera and pad ({', '.join(shipped())})", required=True)
    option(foreign, "--output FILE", "recording to write", required=True, type=Path)
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
    if args.action == "info":
        return _info(args)
    if args.action == "cut":
        return _cut(args)
    if args.action == "export":
        return _export(args)
    if args.action == "upload":
        return _upload(args)
    return _import(args)


def _info(args: argparse.Namespace) -> int:
    recording = open_recording(args.files)
    first: int | None = None
    last = 0
    images = 0
    verdicts: Counter[str] = Counter()
    for event in recording.events():
        at = instant(event)
        first, last = (at if first is None else min(first, at)), max(last, at)
        if isinstance(event, RecordedFrame):
            images += event.image is not None
            verdicts[event.record.verdict] += 1
    seconds = 0.0 if first is None else (last - first) * 1e-9
    out: dict[str, Any] = {"seconds": round(seconds, 3), "messages": dict(recording.counts), "frames": images}
    out |= {"verdicts": dict(verdicts), "cut": {str(p): why for p, why in recording.cut.items()}, **recording.metadata}
    print_result(args, out, "\n".join(_described(recording, seconds, images, verdicts)))
    return 0


def _described(recording: Recording, seconds: float, images: int, verdicts: Counter[str]) -> list[str]:
    out = [f"{path} is cut short ({why})" for path, why in recording.cut.items()]
    out += [f"{name}: " + ", ".join(f"{k} {v}" for k, v in data.items()) for name, data in recording.metadata.items()]
    out.append(f"holds {', '.join(recording.attachments) or 'no settings'}")
    out.append(f"{seconds:.1f} s, {images} frames; frames: " + (", ".join(f"{k} {n}" for k, n in verdicts.items()) or "none"))
    out += [f"{n:8d}  {topic}" for topic, n in sorted(recording.counts.items())]
    out += [f"{n:8d}  {topic} that this version cannot read" for topic, n in sorted(recording.skipped.items())]
    return out


def _export(args: argparse.Namespace) -> int:
    if args.format == "ros2":
        counts = bag.export(open_recording(args.files), args.output)
        sys.stdout.writelines(f"{n:8d}  {topic}\n" for topic, n in sorted(counts.items()))
        sys.stdout.write(f"{args.output}: {sum(counts.values())} messages; ros2 bag play {args.output}\n")
        return 0
    written = export(open_recording(args.files), args.output)
    sys.stdout.writelines(f"{args.output / name}: {n} rows\n" for name, n in sorted(written.items()))
    return 0


def _upload(args: argparse.Namespace) -> int:
    if args.each is not None and not 1.0 <= args.each <= 86_400.0:
        raise BadInput("--each must be 1 to 86400 seconds")
    to = storage(args.to)
    while True:
        missing = 0
        for done in upload(args.folder, to):
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
    if any(path.resolve() == args.output.resolve() for path in args.files):
        raise BadInput(f"--output {args.output} is one of the files that are read")
    recording = open_recording(args.files)
    what = Cut(args.from_s, args.to_s, args.inputs, args.samples_each, args.frames_each, not args.no_frames)
    n = _written(args.output, lambda: rewrite(recording, args.output, what))
    sys.stdout.write(f"{args.output}: {n} events, {args.output.stat().st_size / 1e6:.2f} MB\n")
    return 0


@dataclass(frozen=True, slots=True)
class _Source:
    path: Path
    offset_ns: int

    def data(self, size: tuple[int, int]) -> Iterator[Sample | Frame]:
        """Yield the data of the source in order, on the common clock; `size` is the camera's (width, height), px."""
        for datum in self._own(size):
            s = datum.stamp
            moved = Stamp(MonoNs(s.measured_at + self.offset_ns), MonoNs(s.received_at + self.offset_ns), s.sigma_s, s.source)
            yield structs.replace(datum, stamp=moved)

    def _own(self, size: tuple[int, int]) -> Iterator[Sample | Frame]:
        path, kind = self.path, kind_of(self.path)
        reader = _READERS.get(kind)
        if reader is not None:
            return iter(reader(path, self._tell))
        if kind is FileKind.ROS_BAG:
            return bag_import.read(path, self._tell)
        if kind is FileKind.IMAGES:
            return pictures.folder_frames(path, size, self._tell)
        if kind is FileKind.TABLE:
            return iter(pictures.attitudes(path, self._tell))
        if kind is FileKind.PAVE or path.suffix.lower() == ".pave":
            return ardrone_capture.frames(path)
        if kind is FileKind.OTHER:
            return pictures.video_frames(path, size)
        raise BadInput(f"{path}: {kind.value}, and no video: {_INSTEAD.get(kind, 'it is not imported')}")

    def _tell(self, text: str) -> None:
        sys.stderr.write(f"decklander: {self.path}: {text}\n")


_READERS: dict[FileKind, Callable[[Path, Tell], Iterable[Sample]]] = {
    FileKind.ULOG: px4_ulog.read, FileKind.DATAFLASH: dataflash.read, FileKind.TLOG: tlog.read,
    FileKind.NAVDATA: ardrone_capture.samples,
}  # fmt: skip
_INSTEAD = {
    FileKind.SENTENCES: "give it as a vessel source: send its lines to vessel.nmea while the service runs",
    FileKind.PARAMETERS: "give it to `decklander doctor`",
    FileKind.RECORDING: "it is imported already",
    FileKind.MCAP: "of MCAP files, bags of ROS 2 are imported",
    FileKind.MAVLINK: "give the ground station's .tlog, which has each message's time, or the autopilot's own log",
    FileKind.TEXT: "of text, tables with the header time_s,roll_deg,pitch_deg are imported",
}


def _source(text: str) -> _Source:
    path, at, offset = text.rpartition("@")
    if not at or Path(text).exists():
        return _Source(Path(text), 0)
    try:
        return _Source(Path(path), round(float(offset) * 1e9))
    except (ValueError, OverflowError) as why:
        raise BadInput(f"{text}: after @ comes a number of seconds") from why


def _import(args: argparse.Namespace) -> int:
    sources = [_source(text) for text in args.sources]
    # Instants before the common clock's zero would be negative: all are moved by the same amount.
    lead = max(0, -min(s.offset_ns for s in sources))
    sources = [replace(s, offset_ns=s.offset_ns + lead) for s in sources]
    settings = load(args.config)
    n = _written(args.output, lambda: _import_into(args.output, sources, settings))
    sys.stdout.write(f"{args.output}: {n['samples']} samples, {n['frames']} frames\n")
    return 0


def _import_into(output: Path, sources: Sequence[_Source], settings: Settings) -> Counter[str]:
    camera = camera_model(settings)
    described = about(settings, {"kind": "import", "sources": ", ".join(s.path.name for s in sources)})
    counts: Counter[str] = Counter()
    with recorder_to_file(output, camera, described) as recorder:
        for datum in heapq.merge(*(s.data((camera.width, camera.height)) for s in sources), key=lambda d: d.stamp.received_at):
            if isinstance(datum, Frame):
                height, width = datum.px.shape[:2]
                if (width, height) != (camera.width, camera.height):
                    raise BadInput(
                        f"frames are {width}x{height} px, the camera file {settings.camera.file} describes "
                        f"{camera.width}x{camera.height} px"
                    )
                # Nobody looked at it yet: hence the verdict REPLACED.
                recorder.on_frame(
                    ProcessedFrame(datum, None, None, Verdict.REPLACED, datum.stamp.received_at, datum.stamp.received_at)
                )
                counts["frames"] += 1
            else:
                recorder.on_sample(datum)
                counts["samples"] += 1
    if recorder.why:
        raise BadInput(f"{output}: {recorder.why}")
    return counts


def _written(output: Path, handler: Callable[[], Any]) -> Any:
    try:
        output.open("ab").close()
        return handler()
    except OSError as why:
        raise BadInput(f"{output}: {why.strerror or why}") from why
    except BadInput:
        output.unlink(missing_ok=True)
        raise
