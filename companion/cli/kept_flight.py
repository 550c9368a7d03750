"""What `--report` and `--record` keep of a simulated flight."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from companion.base.health import Health
from companion.base.held_back import HeldBack
from companion.base.observer import Observer
from companion.cli import record_option, report_option
from companion.parts.recorder.recorder import Recorder
from companion.settings import whole_file
from companion.settings.load import camera_model, pad_model
from companion.settings.model import Settings
from companion.tools.report.flight_log import FlightLog, TruthSample
from companion.tools.report.log_observer import LogObserver
from companion.tools.report.page import PAGE, write_report
from estimator.contracts.estimates import PathName
from estimator.contracts.time import MonoNs
from sitl.flight.ending import Ending
from sitl.perception.port import Level
from sitl.world.truth import Truth

SHADOWS: tuple[PathName, ...] = ("median_mean",)
"""Estimator paths that run beside the steering one, for the comparison in the report."""


@dataclass(slots=True)
class KeptFlight:
    """What is kept of one flight while it is flown."""

    args: argparse.Namespace
    recorder: Recorder | None
    log: FlightLog | None
    observers: tuple[Observer, ...]
    """Observers of the service, to be told of the flight."""
    held_back: tuple[HeldBack, ...] = ()
    """Those of them that hear nothing before the first truth."""
    shadows: tuple[PathName, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.shadows = () if self.log is None and self.recorder is None else SHADOWS

    @property
    def on_start(self) -> Callable[[Health], None] | None:
        """Takes the counters of the flight's health before it begins; None if nobody wants them."""
        return None if self.recorder is None else self.recorder.watch

    @property
    def on_truth(self) -> Callable[[Truth], None] | None:
        """Takes the true states; None if nobody wants them."""
        return None if self.log is None and self.recorder is None else self._keep

    def write_report(self, ending: Ending, wall_s: float, time: str) -> str:
        """Write the report if one is wanted, and return the line that says where it is.

        Args:
            time: the time in which it was flown, in words.
        """
        if self.log is None:
            return ""
        ending.write_into(self.log)
        self.log.facts += [("scenario", self.args.scenario), ("seed", str(self.args.seed))]
        self.log.facts += [("flown in", f"{wall_s:.1f} s, {time}"), *ending.facts()]
        write_report(self.log, self.args.report)
        return report_option.written(self.args.report / PAGE)

    def _keep(self, truth: Truth) -> None:
        for observer in self.held_back:
            observer.begin()
        if self.recorder is not None:
            self.recorder.on_truth(record_option.truth_record(truth))
        if self.log is not None:
            self.log.truth.append(
                TruthSample(truth.at, truth.d_body_pad_level, truth.v_pad_level, truth.yaw_rad, truth.p_pad_ned, truth.R_ned_pad)
            )


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
) -> Iterator[KeptFlight]:
    """Keep what `--report` and `--record` ask for.

    Args:
        settings: those that the service flies with.
        facts: facts of the flight for the recording.
        started: the zero of the report's time axes.
        from_truth: the flight begins with its first truth; of one that is over before, nothing is kept.

    Raises:
        BadInput: the report's folder or the recording's file cannot be made.
    """
    report_option.prepare_folder(args.report)
    if perception != "pixels":
        args.record_frames = "none"
    log = None if args.report is None else _log(settings, title, started)
    told: list[Observer] = [] if log is None else [LogObserver(log, keep_images=perception == "pixels")]
    facts = {**facts, "scenario": args.scenario, "seed": str(args.seed), "perception": perception}
    with record_option.recording(args, settings, facts, live=False) as recorder:
        if recorder is not None:
            told.append(recorder)
        held_back = tuple(HeldBack(observer) for observer in told) if from_truth else ()
        yield KeptFlight(args, recorder, log, held_back or tuple(told), held_back)


def _log(settings: Settings, title: str, started: MonoNs) -> FlightLog:
    return FlightLog(
        title, started=started, pad=pad_model(settings), camera=camera_model(settings), steering=settings.estimator.path,
        settings=whole_file.toml(settings),
    )  # fmt: skip
