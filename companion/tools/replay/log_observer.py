"""Keep a replay's log for figures and report, and compare its beliefs with others of the same flight."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from companion.base.observer import Decision, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.recording.frame_video import VideoImage
from companion.recording.reading import Recording
from companion.recording.records import TruthRecord
from companion.tools.replay.truth_log import add_truth
from companion.tools.report.expected_place import expected_in_body, held_rotation
from companion.tools.report.flight_log import CommandRecord, FlightLog, FrameRecord, PhaseChange
from estimator.contracts.estimates import PathName, RelativeState
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs

Beliefs = dict[tuple[PathName, MonoNs], RelativeState]


@dataclass(slots=True)
class BeliefLogObserver:
    """An observer that fills a log and keeps every belief by path and instant."""

    log: FlightLog
    beliefs: Beliefs = field(default_factory=dict)

    def on_sample(self, sample: Sample) -> None:
        return None

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        self.log.add_result(result)

    def on_frame(self, processed: ProcessedFrame) -> None:
        log = self.log
        R_level_body = None if processed.attitude is None else processed.attitude.R_ned_body.without_heading()
        expected = expected_in_body(processed, log.steering)
        place = None if R_level_body is None or expected is None else R_level_body @ expected
        exposed_at = processed.frame.stamp.measured_at
        held, verdict = held_rotation(processed), processed.verdict
        log.frames.append(FrameRecord(exposed_at, processed.frame.seq, verdict, R_level_body, place, held))
        log.verdicts[processed.verdict] += 1
        if processed.detection is not None:
            log.add_detection(processed.detection)
        log.add_times(processed)

    def on_decision(self, decision: Decision) -> None:
        log = self.log
        if not log.phases or log.phases[-1].phase != decision.phase:
            log.phases.append(PhaseChange(decision.at, decision.phase))
        log.transitions += decision.transitions
        if decision.ahead is not None:
            log.add_forecast(decision.ahead)
        for belief in (decision.belief, *decision.shadows):
            if belief is not None:
                log.estimates.append(belief)
                self.beliefs[belief.path, belief.at] = belief
        if decision.command is not None:
            log.commands.append(CommandRecord(decision.at, decision.command))

    def on_order(self, handled: HandledOrder) -> None:
        self.log.orders.append(handled)

    def on_truth(self, truth: TruthRecord) -> None:
        """Keep the truth from a simulator or motion capture."""
        add_truth(self.log, truth)

    def attach_image(self, image: bytes | VideoImage | None) -> None:
        """Attach the recorded image to the newest frame."""
        if image is not None and self.log.frames:
            self.log.frames[-1] = replace(self.log.frames[-1], image=image)


@dataclass(frozen=True, slots=True)
class Difference:
    """The difference between two sets of beliefs of one path, at the instants that both have."""

    path: PathName
    both: int
    only_one: int
    """The number of instants at which one of the two has no belief."""
    identical: int
    """The number of beliefs with bit-identical position, velocity, heading and covariance."""
    d_median_m: float
    d_p95_m: float
    d_max_m: float
    yaw_max_rad: float


def recorded_beliefs(recording: Recording) -> Beliefs:
    """Return the beliefs that were recorded."""
    out: Beliefs = {}
    for event in recording.events():
        if isinstance(event, Decision):
            for belief in (event.belief, *event.shadows):
                if belief is not None:
                    out[belief.path, belief.at] = belief
    return out


def differences(ours: Beliefs, theirs: Beliefs) -> list[Difference]:
    """Return the difference for each path that both have; its numbers are nan if no instants coincide."""
    out = []
    for path in sorted({p for p, _ in ours} & {p for p, _ in theirs}):
        a = {at: b for (p, at), b in ours.items() if p == path}
        b = {at: c for (p, at), c in theirs.items() if p == path}
        common = sorted(a.keys() & b.keys())
        d = np.array([float(np.linalg.norm(a[t].d_body_pad_level - b[t].d_body_pad_level)) for t in common])
        yaw = _yaw_differences(a, b, common)
        same = sum(_same(a[t], b[t]) for t in common)
        q50, q95, largest = (float(np.quantile(d, q)) if len(d) else math.nan for q in (0.5, 0.95, 1.0))
        out.append(Difference(path, len(common), len(a.keys() ^ b.keys()), same, q50, q95, largest, max(yaw, default=math.nan)))
    return out


def _yaw_differences(
    a: Mapping[MonoNs, RelativeState], b: Mapping[MonoNs, RelativeState], common: Iterable[MonoNs]
) -> list[float]:
    pairs = ((a[t].yaw_rad, b[t].yaw_rad) for t in common)
    return [abs(wrap_pi(x - y)) for x, y in pairs if x is not None and y is not None]


def _same(a: RelativeState, b: RelativeState) -> bool:
    return (
        np.array_equal(a.d_body_pad_level, b.d_body_pad_level)
        and np.array_equal(a.v_pad_level, b.v_pad_level)
        and np.array_equal(a.cov, b.cov)
        and a.yaw_rad == b.yaw_rad
    )
