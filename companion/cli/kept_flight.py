"""Show the progress of a flight, and record it for `--record` and `--report`.

Progress is a line that is redrawn on a terminal, else a line now and then. Report and recorder are loaded where one is wanted.
"""

from __future__ import annotations

import argparse
import logging
import math
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, get_args

from companion.base.health import Health
from companion.base.mission import State
from companion.base.observer import Decision, NullObserver, Observer, ProcessedFrame, Relay
from companion.cli.options import ERASED, option, print_line, writing, written
from companion.cli.outputs import RECORDING, output
from companion.facts.records import ContactRecord, TruthRecord
from companion.settings.load import body_camera
from companion.settings.model import Settings
from companion.settings.service import FrameForm
from estimator.contracts.estimates import PathName
from estimator.contracts.time import MonoNs, seconds_between
from estimator.pipeline import lacks

if TYPE_CHECKING:
    from companion.parts.recorder.recorder import Recorder
    from sitl.flight.ending import Ending
    from sitl.perception.port import Level
    from sitl.world.truth import Touchdown, Truth

_WIDE = 100
"""Columns that the whole line takes; below it has time, phase and place alone."""


class HeldBack(Relay):
    """An observer that passes everything on, in order, from `begin` on.

    Args:
        observer: gets what is passed on.
    """

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._waiting: list[Callable[[], None]] | None = []

    def begin(self) -> None:
        """Pass on what came until now; do nothing when called again."""
        waiting, self._waiting = self._waiting, None
        for tell in waiting or ():
            tell()

    def hand_on(self, method: str, *what: object) -> None:
        tell = partial(getattr(self._observer, method), *what)
        if self._waiting is None:
            tell()
        else:
            self._waiting.append(tell)


def compared_paths() -> tuple[PathName, ...]:
    """Return the estimator paths that run beside the steering one, for the comparison in the report."""
    compared: tuple[PathName, ...] = ("median_mean", "constant_velocity")
    return tuple(path for path in compared if not lacks(path))


@dataclass(slots=True)
class KeptFlight:
    """Kept records of one flight, while it is flown."""

    args: argparse.Namespace
    title: str
    recorder: Recorder | None
    path: Path
    """The recording's file, which a report is read from; of a report alone it is removed afterwards."""
    observers: tuple[Observer, ...]
    """Observers of the service that receive the flight."""
    held_back: tuple[HeldBack, ...] = ()
    """The observers among them that start with the first truth."""
    shadows: tuple[PathName, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.shadows = () if self.recorder is None else compared_paths()

    @property
    def incomplete(self) -> str:
        """Reason why the recording is incomplete; empty if it is whole, or none is kept."""
        recorder = self.recorder
        if recorder is None or not (recorder.why or recorder.faults):
            return ""
        return recorder.why or "a fault of the recorder"

    @property
    def on_start(self) -> Callable[[Health], None] | None:
        """Takes the counters of the flight's health before it begins; None if they are not wanted."""
        return None if self.recorder is None else self.recorder.watch

    @property
    def on_truth(self) -> Callable[[Truth], None] | None:
        """Takes the true states; None if they are not wanted."""
        return None if self.recorder is None else self._keep

    def end(self, ending: Ending, wall_s: float, time: str) -> str:
        """End the recording, write the report of it if one is wanted, and return the lines that say where both are.

        Args:
            time: the time in which it was flown, in words.
        """
        if self.recorder is None:
            return ""
        self.recorder.close()
        lacks = f", incomplete: {self.incomplete}" if self.incomplete else ""
        recorded = "" if self.args.record is None else f"recording: {self.args.record}{lacks}\n"
        if self.args.report is None or not self.recorder.files:
            return recorded
        from companion.recording.reading import open_recording
        from companion.tools.replay.recorded_log import log_of
        from companion.tools.report.page import PAGE, write_report

        log = log_of(open_recording([self.path]), self.title)
        ending.write_into(log)
        log.facts = [*ending.facts(), ("flown in", f"{wall_s:.1f} s, {time}"), *log.facts]
        with writing(self.args.report / PAGE, quiet=self.args.json) as watch:
            return recorded + written(write_report(log, self.args.report, watch))

    def _keep(self, truth: Truth) -> None:
        for observer in self.held_back:
            observer.begin()
        self.keep(truth)

    def keep(self, truth: Truth) -> None:
        """Keep the true state of one instant."""
        if self.recorder is not None:
            self.recorder.on_truth(_truth_record(truth))


@contextmanager
def keeping(
    args: argparse.Namespace,
    settings: Settings,
    title: str,
    perception: Level,
    facts: Mapping[str, str],
    *,
    from_truth: bool = False,
    live: bool = False,
) -> Iterator[KeptFlight]:
    """Record the flight where `--report` or `--record` requests it.

    The file begins with the first record: a flight that is refused leaves none, and an older file of that name as it is.

    Args:
        settings: those that the service flies with.
        facts: facts of the flight for the recording.
        from_truth: the flight begins with its first truth; of one that is over before, nothing is kept.
        live: place it in wall time, and never wait for the disk.

    Raises:
        BadInput: the recording's file cannot be made.
    """
    if args.record is None and args.report is None:
        yield KeptFlight(args, title, None, Path(), ())
        return
    from companion.parts.recorder.setup import about, recorder_to_file
    from drivers.clock import SystemClock, wall_offset_ns

    frames: FrameForm = args.record_frames if perception == "pixels" else "none"
    facts = {**facts, "scenario": args.scenario, "seed": str(args.seed), "perception": perception}
    described = about(settings, facts, wall_offset_ns(SystemClock()) if live else 0)
    with ExitStack() as stack:
        path = args.record or Path(stack.enter_context(TemporaryDirectory(prefix="decklander-"))) / "flight.mcap"
        recorder = stack.enter_context(recorder_to_file(path, body_camera(settings), described, frames=frames, live=live))
        held_back = (HeldBack(recorder),) if from_truth else ()
        yield KeptFlight(args, title, recorder, path, held_back or (recorder,), held_back)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that records its flight."""
    output(parser, "--record FILE", "record the flight into this file (MCAP; see docs/recordings.md)", RECORDING)
    option(
        parser, "--record-frames", "encode recorded frames like this (default: jpeg)", choices=get_args(FrameForm), default="jpeg"
    )


def _truth_record(truth: Truth) -> TruthRecord:
    """Return the record of the simulator's truth."""
    touchdown = None if truth.touchdown is None else _contact(truth.touchdown)
    d, v = truth.d_body_pad_level.tolist(), truth.v_pad_level.tolist()
    body, pad = (R.matrix.ravel().tolist() for R in (truth.R_ned_body, truth.R_ned_pad))
    return TruthRecord(
        int(truth.at), d, v, truth.yaw_rad, truth.phase.name.lower(), touchdown, body, pad, truth.p_pad_ned.tolist()
    )


def _contact(t: Touchdown) -> ContactRecord:
    numbers = (float(x) for x in (t.lateral_m, t.yaw_rad, t.vertical_speed_m_s, t.lateral_speed_m_s))
    return ContactRecord(int(t.at), t.surface, t.on_pad, *(x if math.isfinite(x) else None for x in numbers))


_DOWN = frozenset((State.LANDED.value, State.LANDED_BY_OTHERS.value))
"""Phases on the deck: the estimate is no longer corrected there, and its height drifts."""


class ProgressObserver(NullObserver):
    """An observer that shows the service's estimate of height and lateral distance, its phase, frame rate and delay.

    Where the vehicle is not on its way down, the reason stands in place of rate and delay.
    """

    def __init__(self) -> None:
        self._out = sys.stderr
        self._live = self._out.isatty()
        self._period_s = 0.1 if self._live else 1.0
        self._began: MonoNs | None = None
        self._said: MonoNs | None = None
        self._phase = ""
        self._frames: deque[MonoNs] = deque(maxlen=31)
        self._delay_s: float | None = None
        self._verdict = ""

    def on_frame(self, processed: ProcessedFrame) -> None:
        self._frames.append(processed.frame.stamp.measured_at)
        self._delay_s = seconds_between(processed.frame.stamp.measured_at, processed.done)
        self._verdict = processed.verdict.value.replace("_", " ")

    def on_decision(self, decision: Decision) -> None:
        self._began = decision.at if self._began is None else self._began
        new_phase = decision.phase != self._phase
        if self._said is not None and not new_phase and seconds_between(self._said, decision.at) < self._period_s:
            return
        if new_phase and self._phase:
            self.close()
        self._said, self._phase = decision.at, decision.phase
        columns = self._columns()
        line = self._line(decision) if columns >= _WIDE else self._short_line(decision)
        line = line[: columns - 1] if self._live else line
        self._out.write(f"{ERASED}{line}" if self._live else f"{line}\n")
        self._out.flush()

    def close(self) -> None:
        """End the current line of the terminal."""
        if self._live:
            self._out.write("\n")
            self._out.flush()

    def _columns(self) -> int:
        """Return the width of the terminal; a line that is longer would leave its beginning behind at each redrawing."""
        try:
            return (os.get_terminal_size(self._out.fileno()).columns or 80) if self._live else _WIDE
        except (OSError, ValueError):
            return 80

    def _short_line(self, decision: Decision) -> str:
        assert self._began is not None
        belief, time_s = decision.belief, seconds_between(self._began, decision.at)
        if decision.phase in _DOWN:
            return f"{time_s:5.1f} s {decision.phase}"
        where = (
            "no pad yet" if belief is None or not belief.placed else f"{belief.height_m:4.1f} up {belief.lateral_m:4.1f} m off"
        )
        return f"{time_s:5.1f} s {decision.phase} {where}"

    def _line(self, decision: Decision) -> str:
        assert self._began is not None
        belief = decision.belief
        where = "pad not seen yet"
        if belief is not None:
            seen_s = belief.age_s(decision.at)
            place = f"height {belief.height_m:5.2f} m   sideways {belief.lateral_m:5.2f} m" if belief.placed else "place unknown"
            where = f"{place}   seen {seen_s:4.1f} s ago"
        time_s = seconds_between(self._began, decision.at)
        if decision.phase in _DOWN:
            return f"{time_s:5.1f} s  {decision.phase:<22}  {decision.reason}".rstrip()
        if decision.reason:
            return f"{time_s:5.1f} s  {decision.phase:<22}  {where}   {decision.reason}"
        rate = "--"
        if len(self._frames) > 1:
            rate = f"{(len(self._frames) - 1) / max(1e-9, seconds_between(self._frames[0], self._frames[-1])):.0f}"
        delay = "--" if self._delay_s is None else f"{1e3 * self._delay_s:.0f}"
        return f"{time_s:5.1f} s  {decision.phase:<22}  {where}   {rate:>2} frames/s  {delay:>3} ms  {self._verdict}"


@contextmanager
def shown(*, quiet: bool) -> Iterator[list[Observer]]:
    """Yield the observer that shows the progress of a flight; none if nothing but the result is printed."""
    if quiet:
        yield []
        return
    progress, lines = ProgressObserver(), _LogLines(logging.WARNING)
    logging.getLogger().addHandler(lines)
    try:
        yield [progress]
    finally:
        logging.getLogger().removeHandler(lines)
    progress.close()


class _LogLines(logging.Handler):
    """Writes what is logged in the place of the line of progress, not behind it."""

    def emit(self, record: logging.LogRecord) -> None:
        print_line(self.format(record))
