"""`decklander replay`: replay a recording through vision, estimator and guidance, or at its own pace over MAVLink."""

import argparse
import asyncio
import math
import sys
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, get_args

from msgspec import to_builtins
from msgspec.structs import asdict

from companion.base import event_loop
from companion.base.health import Health
from companion.base.observer import Decision, NullObserver, Observer
from companion.base.orders import OperatorOrder
from companion.cli.kept_flight import shown
from companion.cli.options import WorkProgress, option, print_result, recording_argument, writing, written
from companion.cli.outputs import RECORDING, REPORT_FOLDER, output
from companion.facts.records import TruthRecord
from companion.guidance.pilot import Pilot
from companion.parts.mavlink.commands import LandingProgress
from companion.parts.mavlink.component import Component, speaking
from companion.parts.mavlink.outputs import Outputs
from companion.parts.recorder.recorder import Recorder
from companion.parts.recorder.setup import about, recorder_to_file
from companion.recording.reading import RecordedFrame, Recording, open_recording
from companion.settings.load import Settings, camera_model, load
from companion.settings.overrides import key_and_text, leaves, plain, warn_of_idle, with_overrides
from companion.tools.replay.engine import OWN, Replay, pilot_of, settings_of, with_files_of
from companion.tools.replay.recorded_log import Beliefs, Difference, differences, log_of, recorded_beliefs
from companion.tools.replay.ship_sensors import SensorJudge
from companion.tools.report.figures import DeckRow, ErrorRow, all_series, deck_rows, error_rows, innovation_series
from companion.tools.report.flight_log import FlightLog
from companion.tools.report.page import PAGE, write_report
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import open_autopilot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import PathName, RelativeState, Verdict
from estimator.contracts.time import MonoNs, seconds_between

_REFUSAL = "this is a replay: it takes no commands"
_LEAD_S = 0.05
"""Time from the beginning of the replay to its first event, s."""


class _Deaf:
    """An operator that refuses every command."""

    def order(self, order: OperatorOrder, given_at: MonoNs | None = None) -> str | None:
        return f"{_REFUSAL}, not even {order.value}"

    def record(self, on: bool) -> str | None:
        return _REFUSAL if on else None

    def progress(self) -> LandingProgress:
        return LandingProgress(None)


class _Newest(NullObserver):
    """An observer that keeps the newest estimate of guidance."""

    belief: RelativeState | None = None

    def on_decision(self, decision: Decision) -> None:
        self.belief = decision.belief

    def at(self, now: MonoNs) -> RelativeState | None:
        """Return the newest estimate, at most one guidance cycle old."""
        return self.belief


def play(args: argparse.Namespace, recording: Recording, settings: Settings) -> int:
    """Replay to the end of the recording; return exit code 0.

    Raises:
        BadInput: a MAVLink address that is none.
    """
    with with_files_of(recording, settings, _own(args)) as used:
        pilot = pilot_of(used, args.path, alone=True)
    return event_loop.run(_play(args, recording, settings, pilot))


async def _play(args: argparse.Namespace, recording: Recording, settings: Settings, pilot: Pilot) -> int:
    clock = SystemClock()
    newest = _Newest()
    observers: list[Observer] = [newest]
    async with AsyncExitStack() as stack:
        if args.mavlink:
            vehicle = _autopilot(args.mavlink)
            outputs = Outputs(settings.landing_target, pilot.pad.disc_radius_m, settings.guidance.stale_after_s)
            component = Component(outputs, _Deaf(), None, believe=newest.at, clock=clock, health=Health(clock))
            autopilot = await stack.enter_async_context(open_autopilot(vehicle, clock))
            await stack.enter_async_context(speaking(component, autopilot, clock))
            observers.append(component)
        observers += stack.enter_context(shown(quiet=args.json))
        late_s = await _paced(args, recording, settings.guidance.rate_hz, pilot, observers, clock)
    sys.stdout.write(f"played to the end; {1e3 * late_s:.0f} ms late at most\n")
    return 0


def _autopilot(urls: list[str]) -> AutopilotOptions:
    try:
        return AutopilotOptions(", ".join(urls))
    except ValueError as why:
        raise BadInput(str(why).replace("links:", "--mavlink:", 1)) from why


async def _paced(
    args: argparse.Namespace, recording: Recording, rate_hz: float, pilot: Pilot, observers: list[Observer], clock: SystemClock
) -> float:
    """Replay at the pace of the recording; return the largest delay, seconds."""
    first = next((at for at, _ in Replay(recording, pilot).steps()), MonoNs(0))
    start = clock.now()
    shift_ns = start - first + round(_LEAD_S * 1e9)
    replay = Replay(recording, pilot, sightings=args.sightings, rate_hz=rate_hz, shift_ns=shift_ns, observers=observers)
    late_s = 0.0
    for at, _ in replay.steps():
        ahead_s = seconds_between(clock.now(), at)
        if ahead_s > 0.001:
            await clock.sleep(ahead_s)
        else:
            late_s = max(late_s, -ahead_s)
            await asyncio.sleep(0)
    return late_s


DESCRIPTION = (
    "Replay a recording through vision, estimator and guidance, on its own clock. The same recording and settings give the same "
    "outputs to the bit. Every estimator path runs. Recordings of simulated flights hold the truth; errors are measured minus it."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    recording_argument(parser)
    option(parser, "--sightings", "use the recorded detections instead of searching the frames again")
    option(parser, "--path", "steer by this estimator path (default: the one of the settings)", choices=get_args(PathName))
    option(parser, "--config FILE", "settings file to replay with (default: the recording's own settings)")
    option(parser, "--set KEY=VALUE", "give a key of these settings another value", default=[], action="append")
    option(parser, "--against SETTINGS", "replay with these settings too, and print the differences")
    option(parser, "--compare OTHER", "compare with the estimates in this recording", type=Path)
    output(parser, "--record FILE", "record the estimates of the replay, for --compare", RECORDING)
    output(parser, "--report DIR", "write a report into this folder (report)", REPORT_FOLDER, nargs="?", const=Path("report"))
    option(parser, "--realtime", "replay at the pace of the recording")
    option(parser, "--mavlink URL", "send the outputs to an autopilot or ground station (needs --realtime)", action="append")
    option(parser, "--json", "print one JSON object")


@dataclass(slots=True)
class Pass:
    """One replay and its results."""

    name: str
    log: FlightLog
    beliefs: Beliefs
    replay: Replay
    wall_s: float
    flown_s: float
    ship: SensorJudge

    def errors(self) -> list[ErrorRow]:
        return error_rows(self.log, all_series(self.log)) if self.log.truth else []

    def decks(self) -> list[DeckRow]:
        return deck_rows(self.log)


def run(args: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    recording = open_recording(args.recording)
    if args.mavlink and not args.realtime:
        raise BadInput("--mavlink plays to something that lives in real time: say --realtime too")
    settings = with_overrides(settings_of(recording, args.config), args.set, "--set")
    other = settings if args.against is None else settings_of(recording, args.against)
    for word, named in (("--config", settings), ("--against", other)):
        _check_camera(recording, named, word, args)
    blind, changed = "a replay that searches no frames", bool(args.set or args.config)
    if changed:
        places = {"a replay": True, "a replay without --mavlink": not args.mavlink, blind: args.sightings}
        warn_of_idle([settings], [*args.set, *_otherwise(recording, args.config)], places)
    if args.realtime:
        return play(args, recording, settings)
    if not args.json:
        recording.watch = WorkProgress(f"replaying {recording.name}", "kB").take
    passes = [replayed(recording, settings, _own(args), args.path, sightings=args.sightings, record=args.record)]
    if args.against is not None:
        passes.append(replayed(recording, other, (), args.path, name=args.against, sightings=args.sightings))
    if recording.metadata.get("flight", {}).get("perception") == "truth":
        sys.stderr.write(f"decklander: {recording.name} was flown with --perception truth: its estimate was drawn, not fused\n")
    searched = passes[0].replay.counts.searched > 0
    warn_of_idle([], args.set, {blind: not searched and not args.sightings})
    if not args.json:
        recording.watch = WorkProgress(f"comparing with the estimates in {recording.name}", "kB").take
    others = {"the recording": recorded_beliefs(recording), **{one.name: one.beliefs for one in passes[1:]}}
    if args.compare is not None:
        others[str(args.compare)] = _beliefs_beside(recording, args.compare)
    compared = {name: differences(passes[0].beliefs, beliefs) for name, beliefs in others.items()}
    report = [] if args.report is None else [_reported(args, recording, passes, compared)]
    lossy = " (frames kept as JPEG or video: expected)" if searched and not changed else ""
    print_result(
        args, _as_json(recording, passes, compared), "\n".join([*_in_words(recording, passes, compared, lossy), *report])
    )
    return 0


def _reported(
    args: argparse.Namespace, recording: Recording, passes: Sequence[Pass], compared: dict[str, list[Difference]]
) -> str:
    """Write a report of each pass, and return the line that says where the first one is."""
    images = {event.record.seq: event.image for event in recording.events() if isinstance(event, RecordedFrame)}
    for i, done in enumerate(passes):
        done.log.add_images(images)
        folder = args.report if i == 0 else args.report / "against"
        with writing(folder / PAGE, quiet=args.json) as watch:
            write_report(_finished(done, compared), folder, watch)
    return written(args.report / PAGE)


def _beliefs_beside(recording: Recording, path: Path) -> Beliefs:
    """Return the estimates of another recording; say so where it is of another flight."""
    beside = open_recording([path])
    of = [one.metadata.get("flight", {}) for one in (recording, beside)]
    if of[0] != of[1] and not any("of" in flight for flight in of):
        sys.stderr.write(f"decklander: {path} is of another flight than {recording.name}\n")
    return recorded_beliefs(beside)


def _check_camera(recording: Recording, settings: Settings, option: str, args: argparse.Namespace) -> None:
    """Refuse the settings of an option whose camera has frames of another size than the recording, where these are searched.

    Raises:
        BadInput: it has.
    """
    file = getattr(args, option.removeprefix("--"))
    if file is None or args.sightings:
        return
    frames = (event.record for event in recording.events() if isinstance(event, RecordedFrame))
    camera, first = camera_model(settings), next(frames, None)
    if first is not None and (first.width, first.height) != (camera.width, camera.height):
        wrong = f"{option} {file}: its camera has {camera.width}x{camera.height} px, and the frames of {recording.name}"
        raise BadInput(f"{wrong} {first.width}x{first.height} px: none of them could be searched")


def _otherwise(recording: Recording, config: str | None) -> list[str]:
    """Return the keys to which a settings file gives another value than the recording's own settings."""
    if config is None:
        return []
    with suppress(BadInput):  # of another version
        if (own := recording.settings()) is not None:
            was = dict(leaves(plain(own)))
            return [key for key, value in leaves(plain(load(config))) if was.get(key) != value]
    return []


def _own(args: argparse.Namespace) -> list[str]:
    """Return which files of the recording are used in place of those that its settings name."""
    chosen = [key_and_text(text, "--set", "pad.file=thesis")[0] for text in args.set]
    return [] if args.config else [name for name in OWN if f"{Path(name).stem}.file" not in chosen]


def replayed(
    recording: Recording,
    settings: Settings,
    own: Sequence[str] = OWN,
    path: PathName | None = None,
    *,
    name: str = "as set",
    sightings: bool = False,
    record: Path | None = None,
) -> Pass:
    """Replay a recording into another one, and return what that holds.

    Args:
        own: files of the recording in place of those that the settings name.
        path: the steering path; None for that of the settings.
        sightings: see `Replay`.
        record: where the replay is kept; None to remove it afterwards.
    """
    with with_files_of(recording, settings, own) as used:
        pilot = pilot_of(used, path)
        described = about(used, {"kind": "replay", "of": recording.name}, named=settings)
    ship = SensorJudge()
    began = time.monotonic()
    with TemporaryDirectory(prefix="decklander-") as folder:
        file = record or Path(folder) / "replay.mcap"
        with recorder_to_file(file, pilot.camera, described, frames="none") as recorder:
            observers: list[Observer] = [recorder, ship]
            replay = Replay(recording, pilot, sightings=sightings, rate_hz=settings.guidance.rate_hz, observers=observers)
            first, last = _feed(replay, recorder)
        wall_s, made = time.monotonic() - began, open_recording([file])
        log = log_of(made, f"Replay of {recording.name}")
        beliefs = recorded_beliefs(made)
    log.started = first
    log.outcome = "unfinished" if replay.outcome is None else replay.outcome.value
    return Pass(name, log, beliefs, replay, wall_s, seconds_between(first, last), ship)


def _feed(replay: Replay, recorder: Recorder) -> tuple[MonoNs, MonoNs]:
    """Run the replay to its end; return the instants of its first and its last event."""
    first = last = MonoNs(0)
    for at, event in replay.steps():
        first, last = first or at, max(last, at)
        if isinstance(event, TruthRecord):
            recorder.on_truth(event)
    return first, last


def _finished(done: Pass, compared: dict[str, list[Difference]]) -> FlightLog:
    log, counts = done.log, done.replay.counts
    log.facts += [("settings", done.name), ("outputs", done.replay.digest[:16])]
    log.facts += [("frames searched again", str(counts.searched)), ("frames as recorded", str(counts.as_recorded))]
    for name, found in compared.items():
        log.facts += [(f"{d.path} against {name}", f"{_mm(d.d_median_m)} median, {_mm(d.d_max_m)} at most") for d in found]
    return log


def _in_words(recording: Recording, passes: Sequence[Pass], compared: dict[str, list[Difference]], lossy: str) -> list[str]:
    out = [f"{path} is cut short or damaged ({why}): replayed without that" for path, why in recording.cut.items()]
    out += [f"{n} messages of {topic} cannot be read by this version and were left out" for topic, n in recording.skipped.items()]
    for done in passes:
        c, pace = done.replay.counts, done.flown_s / max(1e-9, done.wall_s)
        out += [
            f"{done.name}: {done.flown_s:.1f} s in {done.wall_s:.1f} s ({pace:.1f} x real time), {c.samples} samples, {c.frames} "
            f"frames ({c.searched} searched again, {c.as_recorded} as recorded), {c.decisions} guidance cycles",
            *_became_of(done.log),
            f"outputs: sha256 {done.replay.digest}",
        ]
        if rows := done.errors():
            heads = f"{'aside 50 %':>11}{'95 %':>9}{'down 50 %':>11}{'95 %':>9}{'heading':>9}{'95 %':>8}{'NEES':>10}"
            out += [f"{'against truth':<16}{'count':>7}{heads}", *map(_row, rows)]
        if decks := done.decks():
            out += [f"{'deck by truth':<16}{'count':>7}{'tilt':>9}{'95 %':>8}{'NEES':>8}", *map(_deck_row, decks)]
        known = "nothing was estimated" if done.log.truth else "no truth was recorded"
        out += [] if rows else [f"{known}: no errors to show"]
    for name, found in compared.items():
        out += [_difference(name, d, lossy if name == "the recording" else "") for d in found]
    return out + passes[0].ship.in_words()


def _became_of(log: FlightLog) -> list[str]:
    """Return what became of the frames, and of the measurements that were refused, a line each."""

    def counted(verdicts: Counter[Verdict]) -> str:
        return ", ".join(f"{n} {verdict.value.replace('_', ' ')}" for verdict, n in verdicts.most_common())

    out = [f"frames: {counted(log.verdicts)}"] if log.verdicts else []
    for series in innovation_series(log):
        refused = Counter(series.verdicts)
        del refused[Verdict.FUSED]
        out += [f"{series.name} refused: {counted(refused)}"] if refused else []
    return out


def _row(r: ErrorRow) -> str:
    mm = (_mm(x) for x in (r.lateral_median_m, r.lateral_p95_m, r.down_median_m, r.down_p95_m))
    angles = [("-" if math.isnan(a) else f"{math.degrees(a):.2f}") for a in (r.yaw_median_rad, r.yaw_p95_rad)]
    return f"{r.name:<16}{r.count:>7}" + "".join(f"{x:>10}" for x in mm) + f"{angles[0]:>9}{angles[1]:>8}{_ratio(r.nees):>10}"


def _deck_row(r: DeckRow) -> str:
    name = f"{r.ahead_s:g} s ahead" if r.ahead_s else "now"
    tilts = (f"{math.degrees(a):.2f}" for a in (r.tilt_median_rad, r.tilt_p95_rad))
    return f"{name:<16}{r.count:>7}{next(tilts):>9}{next(tilts):>8}{_ratio(r.nees):>8}"


def _ratio(x: float) -> str:
    return "-" if not math.isfinite(x) else f"{x:.2f}" if x < 1e4 else f"{x:.1e}"


def _difference(name: str, d: Difference, why: str) -> str:
    if d.both == 0:
        return f"{d.path} against {name}: no instants in common"
    if d.identical == d.both:
        return f"{d.path} against {name}: all {d.both} states identical to the bit"
    return (
        f"{d.path} against {name}: {d.identical} of {d.both} states identical{why}; "
        f"apart by {_mm(d.d_median_m)} median, {_mm(d.d_p95_m)} at 95 %, {_mm(d.d_max_m)} at most, "
        f"heading by {math.degrees(d.yaw_max_rad):.2f} deg at most"
    )


def _mm(metres: float) -> str:
    if not math.isfinite(metres):
        return "-"
    return f"{1e3 * metres:.1f} mm" if abs(metres) < 1.0 else f"{metres:.2f} m"


def _as_json(recording: Recording, passes: Sequence[Pass], compared: dict[str, list[Difference]]) -> dict[str, Any]:
    return {
        "recording": [str(p) for p in recording.paths],
        "cut": {str(p): why for p, why in recording.cut.items()},
        "passes": [
            {
                "settings": done.name,
                "sha256": done.replay.digest,
                "outcome": None if done.replay.outcome is None else done.replay.outcome.value,
                "flown_s": round(done.flown_s, 3),
                "counts": asdict(done.replay.counts),
                "errors": [_plain(asdict(row)) for row in done.errors()],
                "decks": [_plain(asdict(row)) for row in done.decks()],
            }
            for done in passes
        ],
        "ship_sensors": [_plain(to_builtins(one)) for one in passes[0].ship.verdicts()],
        "ship_differences": [_plain(to_builtins(one)) for one in passes[0].ship.differences()],
        "against": {name: [_plain(asdict(d)) for d in found] for name, found in compared.items()},
    }


def _plain(record: dict[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in record.items()}
