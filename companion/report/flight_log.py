"""What a flight leaves behind for its report. Plain records; whoever flies fills them in, nothing here computes."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from estimator.contracts.commands import Command
from estimator.contracts.estimates import PathName, RelativeState, Sighting, Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import _vector
from estimator.contracts.time import MonoNs
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad


@dataclass(frozen=True, slots=True, eq=False)
class TruthSample:
    """Where the pad really was, in the terms of an estimate; only a simulator or motion capture knows."""

    at: MonoNs
    d_body_pad_level: F64
    """(3,) m forward, right, down."""
    v_pad_level: F64
    """(3,) m/s, velocity of the pad less that of the body."""
    yaw_rad: float
    """Heading of the body against the arrow, clockwise from above positive, (-pi, pi]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "d_body_pad_level", _vector("TruthSample.d_body_pad_level", self.d_body_pad_level, (3,)))
        object.__setattr__(self, "v_pad_level", _vector("TruthSample.v_pad_level", self.v_pad_level, (3,)))
        if not -math.pi <= self.yaw_rad <= math.pi:
            raise ValueError(f"TruthSample.yaw_rad must lie in (-pi, pi], got {self.yaw_rad}")


@dataclass(frozen=True, slots=True)
class CommandRecord:
    """A command at the instant it was handed to the vehicle."""

    at: MonoNs
    command: Command


@dataclass(frozen=True, slots=True)
class PhaseChange:
    """The guidance (or the vehicle) entered a phase; it lasts until the next change."""

    at: MonoNs
    phase: str


@dataclass(frozen=True, slots=True)
class FrameRecord:
    """What became of one frame. Its sightings are those of `FlightLog.sightings` with the same `seq`."""

    exposed_at: MonoNs
    seq: int
    verdict: Verdict
    R_level_body: Rotation | None = None
    """Roll and pitch at the exposure, where known: places the drawn outline."""
    image: bytes | Path | None = None
    """JPEG (or any format OpenCV reads) as bytes or file; None where it was not kept."""


@dataclass(frozen=True, slots=True)
class LoggedTouchdown:
    """The instant of contact."""

    at: MonoNs
    lateral_m: float
    """Horizontal distance of the body's origin from the pad's centre."""
    vertical_speed_m_s: float
    """Closing speed of body and deck, positive downward."""
    lateral_speed_m_s: float
    on_pad: bool
    """Whether it stands on the disc, by the judgement of whoever knows."""


@dataclass(slots=True, eq=False)
class FlightLog:
    """One flight. Lists are in order of time; every one of them may be empty, and the page then says so."""

    title: str
    started: MonoNs
    """Zero of the page's time axes."""
    pad: Pad
    camera: Camera
    outcome: str = "unfinished"
    """One word or two: landed, went around, gave up, unfinished."""
    facts: list[tuple[str, str]] = field(default_factory=list)
    """Named lines for the head of the page: scenario, seed, wall time, version."""
    truth: list[TruthSample] = field(default_factory=list)
    sightings: list[Sighting] = field(default_factory=list)
    """Every method's, and the selected one under its own method name "selected"."""
    estimates: list[RelativeState] = field(default_factory=list)
    """Of one path or several; `RelativeState.path` tells them apart."""
    results: list[FusionResult] = field(default_factory=list)
    """What each path made of each measurement; filled by `add_result`."""
    steering: PathName | None = None
    """The path that was steered by and whose pad is drawn into the video; None for the first one in `estimates`."""
    commands: list[CommandRecord] = field(default_factory=list)
    phases: list[PhaseChange] = field(default_factory=list)
    frames: list[FrameRecord] = field(default_factory=list)
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    """Of all frames, those without a `FrameRecord` included."""
    stage_s: dict[str, list[float]] = field(default_factory=dict)
    """Measured durations by stage (decode, look, filter, encode, ...), in the order they are to be shown."""
    delay_s: list[float] = field(default_factory=list)
    """From mid-exposure to the command that used the frame, one a frame."""
    touchdown: LoggedTouchdown | None = None

    def add_result(self, result: FusionResult) -> None:
        """Keep a result. Those of IMU samples that were taken are left out: they are compared with nothing."""
        if result.source != "imu" or result.verdict is not Verdict.FUSED:
            self.results.append(result)
