"""Files of a simulated flight that `--report` and `--record` keep. Report and recorder are loaded only where one is wanted."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, get_args

from companion.base.health import Health
from companion.base.observer import Observer, Relay
from companion.base.version import version
from companion.cli.options import option, video_progress, written
from companion.cli.outputs import RECORDING, output, prepare_folder
from companion.facts.records import ContactRecord, TruthRecord
from companion.settings.load import body_camera, camera_model, pad_model
from companion.settings.model import Settings
from companion.settings.service import FrameForm
from estimator.contracts.estimates import PathName
from estimator.contracts.geometry import Rotation
from estimator.contracts.time import MonoNs
from sitl.flight.ending import Ending
from sitl.perception.port import Level
from sitl.world.truth import Touchdown, Truth

if TYPE_CHECKING:
    from companion.parts.recorder.recorder import Recorder
    from companion.tools.report.flight_log import FlightLog


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
    return ("median_mean", "constant_velocity") if find_spec("filterpy") else ("median_mean",)


@dataclass(slots=True)
class KeptFlight:
    """Kept records of one flight, while it is flown."""

    args: argparse.Namespace
    recorder: Recorder | None
    log: FlightLog | None
    observers: tuple[Observer, ...]
    """Observers of the service that receive the flight."""
    held_back: tuple[HeldBack, ...] = ()
    """The observers among them that start with the first truth."""
    shadows: tuple[PathName, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.shadows = () if self.log is None and self.recorder is None else compared_paths()

    @property
    def on_start(self) -> Callable[[Health], None] | None:
        """Takes the counters of the flight's health before it begins; None if nobody wants them."""
        return None if self.recorder is None else self.recorder.watch

    @property
    def on_truth(self) -> Callable[[Truth], None] | None:
        """Takes the true states; None if nobody wants them."""
        return None if self.log is None and self.recorder is None else self._keep

    def write_report(self, ending: Ending, wall_s: float, time: str) -> str:
        """Write the report if one is wanted, and return the lines that say where it and the recording are.

        Args:
            time: the time in which it was flown, in words.
        """
        recorded = "" if self.recorder is None else f"recording: {self.args.record}\n"
        if self.log is None:
            return recorded
        from companion.tools.report.page import PAGE, write_report

        ending.write_into(self.log)
        self.log.facts += [("scenario", self.args.scenario), ("seed", str(self.args.seed)), ("decklander", version())]
        self.log.facts += [("flown in", f"{wall_s:.1f} s, {time}"), *ending.facts()]
        page = self.args.report / PAGE
        return recorded + written(write_report(self.log, self.args.report, video_progress(page, quiet=self.args.json)))

    def _keep(self, truth: Truth) -> None:
        for observer in self.held_back:
            observer.begin()
        self.keep(truth_record(truth))

    def keep(self, record: TruthRecord) -> None:
        """Keep the true state of one instant."""
        if self.recorder is not None:
            self.recorder.on_truth(record)
        if self.log is not None:
            from companion.tools.replay.recorded_log import add_truth

            add_truth(self.log, record)


@contextmanager
def keeping(
    args: argparse.Namespace,
    settings: Settings,
    title: str,
    perception: Level,
    facts: Mapping[str, str],
    started: MonoNs,
    *,
    from_truth: bool = False,
    live: bool = False,
) -> Iterator[KeptFlight]:
    """Keep what `--report` and `--record` request.

    Args:
        settings: those that the service flies with.
        facts: facts of the flight for the recording.
        started: the zero of the report's time axes.
        from_truth: the flight begins with its first truth; of one that is over before, nothing is kept.
        live: see `recording`.

    Raises:
        BadInput: the report's folder or the recording's file cannot be made.
    """
    prepare_folder(args.report)
    if perception != "pixels":
        args.record_frames = "none"
    log, reported = None, list[Observer]()
    if args.report is not None:
        from companion.settings import schema
        from companion.tools.report.flight_log import FlightLog, LogObserver

        log = FlightLog(
            title, started=started, pad=pad_model(settings), camera=camera_model(settings), steering=settings.estimator.path,
            settings=schema.toml(settings),
        )  # fmt: skip
        reported.append(LogObserver(log, keep_images=perception == "pixels"))
    facts = {**facts, "scenario": args.scenario, "seed": str(args.seed), "perception": perception}
    with recording(args, settings, facts, live=live) as recorder:
        if recorder is not None:
            reported.append(recorder)
        held_back = tuple(HeldBack(observer) for observer in reported) if from_truth else ()
        yield KeptFlight(args, recorder, log, held_back or tuple(reported), held_back)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of a command that records its flight."""
    output(parser, "--record FILE", "record the flight into this file (MCAP; see docs/recordings.md)", RECORDING)
    option(
        parser, "--record-frames", "encode recorded frames like this (default: jpeg)", choices=get_args(FrameForm), default="jpeg"
    )


@contextmanager
def recording(
    args: argparse.Namespace, settings: Settings, flight: Mapping[str, str], *, live: bool
) -> Iterator[Recorder | None]:
    """Open the recorder, or yield None without `--record`. A `live` flight is placed in wall time and never waits for the disk.

    The file begins with the first record: a flight that is refused leaves none, and an older file of that name as it is.

    Raises:
        BadInput: the file cannot be made.
    """
    if args.record is None:
        yield None
        return
    from companion.parts.recorder.setup import about, recorder_to_file, wall_offset_ns
    from drivers.clock import SystemClock

    offset_ns = wall_offset_ns(SystemClock()) if live else 0
    described = about(settings, flight, offset_ns)
    with recorder_to_file(args.record, body_camera(settings), described, frames=args.record_frames, live=live) as recorder:
        yield recorder
    if recorder.why or recorder.faults:
        sys.stderr.write(f"the recording is incomplete: {recorder.why or 'a fault of the recorder'}\n")


def truth_record(truth: Truth) -> TruthRecord:
    """Return the record of the simulator's truth."""
    touchdown = None if truth.touchdown is None else _contact(truth.touchdown)
    d, v = truth.d_body_pad_level.tolist(), truth.v_pad_level.tolist()
    body, pad = (R.matrix.ravel().tolist() for R in (truth.R_ned_body, truth.R_ned_pad))
    return TruthRecord(
        int(truth.at), d, v, truth.yaw_rad, truth.phase.name.lower(), touchdown, body, pad, truth.p_pad_ned.tolist()
    )


def truth_from_log(record: Mapping[str, Any]) -> TruthRecord:
    """Return the record of one line of the simulated drone's truth log (`sitl.emulators.ardrone.truth_log`)."""
    touched = record["touchdown"]
    touchdown = None if touched is None else ContactRecord(touched["at"], *(touched[n] for n in _CONTACT))
    yaw = math.remainder(record["yaw_rad"], math.tau)
    d, v = ([float(x) for x in record[name]] for name in ("d_body_pad_level_m", "v_pad_level_m_s"))
    body, pad = (Rotation.from_quat(record[f"quat_ned_{name}_wxyz"]).matrix.ravel().tolist() for name in ("body", "pad"))
    return TruthRecord(record["at_ns"], d, v, yaw, record["phase"], touchdown, body, pad, record["p_pad_ned_m"])


_CONTACT = ("surface", "on_pad", "lateral_m", "yaw_rad", "vertical_speed_m_s", "lateral_speed_m_s")


def _contact(t: Touchdown) -> ContactRecord:
    numbers = (float(x) for x in (t.lateral_m, t.yaw_rad, t.vertical_speed_m_s, t.lateral_speed_m_s))
    return ContactRecord(int(t.at), t.surface, t.on_pad, *(x if math.isfinite(x) else None for x in numbers))
