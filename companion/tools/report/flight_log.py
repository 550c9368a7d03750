"""The log of a flight for its report."""

import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from msgspec import Struct, field, structs

from companion.base.mission import StateChange
from companion.base.observer import Decision, ThingReport, things_of
from companion.base.orders import HandledOrder
from companion.recording.frame_encoder import VideoImage
from estimator.contracts.commands import Command
from estimator.contracts.estimates import FusionResult, PathName, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import checked_vector
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between
from estimator.vision.camera.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.pad.pad import Pad

HORIZONS_KEPT_S = (0.0, 1.0, 2.0)
"""Horizons at which the deck's forecast is kept, s; 0 is the deck as the filter has it."""
_SAME_S, _SAME_M = 2.0, 0.35
"""Time for which a thing may be out of sight, and distance by which its place may change, and still be the same."""


class TruthSample(Struct, frozen=True, eq=False):
    """The pad's true position, in the terms of an estimate; only a simulator or motion capture knows it."""

    at: MonoNs
    d_body_pad_level: F64
    """The (3,) vector from the body to the pad: forward, right, down, m."""
    v_pad_level: F64
    """The (3,) velocity of the pad minus that of the body, m/s."""
    yaw_rad: float
    """The heading of the body relative to the arrow, positive clockwise from above, in (-pi, pi]."""
    p_pad_ned: F64 | None = None
    """The (3,) place of the pad's centre, m."""
    R_ned_pad: Rotation | None = None
    """The attitude of the pad."""

    def __post_init__(self) -> None:
        structs.force_setattr(self, "d_body_pad_level", checked_vector("TruthSample.d_body_pad_level", self.d_body_pad_level))
        structs.force_setattr(self, "v_pad_level", checked_vector("TruthSample.v_pad_level", self.v_pad_level))
        if not -math.pi <= self.yaw_rad <= math.pi:
            raise ValueError(f"TruthSample.yaw_rad must lie in (-pi, pi], got {self.yaw_rad}")


class CommandRecord(Struct, frozen=True):
    """A command, and the instant at which it was sent to the vehicle."""

    at: MonoNs
    command: Command


class PhaseChange(Struct, frozen=True):
    """The guidance (or the vehicle) entered a phase; it lasts until the next change."""

    at: MonoNs
    phase: str


class FrameRecord(Struct, frozen=True):
    """The outcome of one frame. Its sightings are those of `FlightLog.sightings` with the same `seq`."""

    exposed_at: MonoNs
    seq: int
    verdict: Verdict
    R_level_body: Rotation | None = None
    """The roll and pitch at the exposure, which place the drawn outline; None if not known."""
    d_expected_level: F64 | None = None
    """Vector at which the steering path expected the pad's centre in this frame, (3,) m, levelled by `R_level_body`."""
    R_body_cam: Rotation | None = None
    """The rotation of a camera on the body as its gimbal held it; None of one that is fixed, or if it is not known."""
    image: bytes | Path | VideoImage | None = None
    """The image as bytes or a file, in JPEG or any format that OpenCV reads, or of a video; None if it was not kept."""


class LoggedContact(Struct, frozen=True):
    """A contact with a surface. What is not known is nan."""

    at: MonoNs
    lateral_m: float
    """The horizontal distance of the body's origin from the pad's centre."""
    vertical_speed_m_s: float
    """The closing speed of body and deck, positive downward."""
    lateral_speed_m_s: float
    on_pad: bool
    """True if the vehicle is on the disc, according to the source of the truth."""
    surface: str = ""
    """Touched surface: pad, deck or water."""
    p_pad_m: tuple[float, float] = (math.nan, math.nan)
    """The place on the pad: along the arrow, and to starboard of it."""
    yaw_rad: float = math.nan
    """The heading against the arrow."""
    phase: str | None = None
    """The phase of guidance just before the contact."""


class DeckSample(Struct, frozen=True):
    """The deck by a forecast or by truth."""

    at: MonoNs
    """The instant that it is about."""
    made_at: MonoNs
    """The instant of the decision; `at` for what is not a forecast."""
    height_m: float
    """The height of the pad's centre above its mean level, positive up."""
    sigma_height_m: float
    roll_rad: float
    sigma_roll_rad: float
    pitch_rad: float
    sigma_pitch_rad: float


class StageTime(Struct, frozen=True):
    """Duration of one stage of one frame."""

    at: MonoNs
    """The instant of the exposure."""
    seconds: float


class LoggedThing(Struct):
    """Something on the pad or about it, from the first frame that it was known in to the last one."""

    first: MonoNs
    last: MonoNs
    seen: ThingReport

    def is_same(self, at: MonoNs, seen: ThingReport) -> bool:
        """Return whether a report of this instant may be of the same thing."""
        same = self.seen.width_m is None, (self.seen.height_m or 0.0) > 0.0
        return (
            seconds_between(self.last, at) < _SAME_S
            and same == (seen.width_m is None, (seen.height_m or 0.0) > 0.0)
            and math.hypot(self.seen.x_m - seen.x_m, self.seen.y_m - seen.y_m) < _SAME_M
        )


class FlightLog(Struct, eq=False):
    """The log of one flight. Lists are in order of time; each may be empty, and the page then reports that."""

    title: str
    started: MonoNs
    """The zero of the page's time axes."""
    pad: Pad
    camera: Camera
    outcome: str = "unfinished"
    """One word or two: landed, went around, gave up, unfinished."""
    facts: list[tuple[str, str]] = field(default_factory=list)
    """The named lines at the head of the page: scenario, seed, wall time, version."""
    truth: list[TruthSample] = field(default_factory=list)
    sightings: list[Sighting] = field(default_factory=list)
    """The sightings of every method, and the selected ones under the method name "selected"."""
    estimates: list[RelativeState] = field(default_factory=list)
    """The estimates of one path or several, distinguished by `RelativeState.path`."""
    results: list[FusionResult] = field(default_factory=list)
    """The result of each measurement on each path; `add_result` fills the list."""
    steering: PathName | None = None
    """The steering path, whose pad is drawn into the video; None for the first path in `estimates`."""
    commands: list[CommandRecord] = field(default_factory=list)
    phases: list[PhaseChange] = field(default_factory=list)
    transitions: list[StateChange] = field(default_factory=list)
    """The changes of the mission's state, with their reasons."""
    frames: list[FrameRecord] = field(default_factory=list)
    verdicts: Counter[Verdict] = field(default_factory=Counter)
    """The counts of verdicts on all frames, including those without a `FrameRecord`."""
    stages: dict[str, list[StageTime]] = field(default_factory=dict)
    """The measured durations by stage (decode, look, filter, encode, ...), in the order of display."""
    delays: list[StageTime] = field(default_factory=list)
    """The delays from mid-exposure until the estimate knew the frame, one per frame."""
    contacts: list[LoggedContact] = field(default_factory=list)
    """Every contact; the last is the one that it landed with."""
    decks: list[DeckSample] = field(default_factory=list)
    """The deck as the steering path forecast it, `at` 0 and more after `made_at`."""
    orders: list[HandledOrder] = field(default_factory=list)
    """The orders of people, with their answers."""
    things: list[LoggedThing] = field(default_factory=list)
    """Known things on the pad and about it."""
    settings: str = ""
    """The settings of the flight, as TOML."""

    @property
    def touchdown(self) -> LoggedContact | None:
        """The contact that it landed with; None without one."""
        return self.contacts[-1] if self.contacts else None

    def add_decision(self, decision: Decision) -> None:
        """Keep the estimates, the command, the changes and the forecast of a decision."""
        if not self.phases or self.phases[-1].phase != decision.phase:
            self.phases.append(PhaseChange(decision.at, decision.phase))
        self.transitions += decision.transitions
        if decision.ahead is not None:
            at = decision.ahead.at
            for row in decision.ahead.rows():
                if row[0] in HORIZONS_KEPT_S:
                    self.decks.append(DeckSample(MonoNs(at + round(row[0] * NS_PER_S)), at, *row[1:]))
        self.estimates += [b for b in (decision.belief, *decision.shadows) if b is not None]
        if decision.command is not None:
            self.commands.append(CommandRecord(decision.at, decision.command))
        if self.steering is None and decision.belief is not None:
            self.steering = decision.belief.path

    def add_detection(self, detection: Detection, at: MonoNs) -> None:
        """Keep things, the sighting of every method, the selected one where it is another, and what was surer elsewhere."""
        seen = [sighting for sighting in detection.methods.values() if sighting is not None]
        self.sightings += seen
        selected = detection.selected
        if selected is not None and all(selected.method != sighting.method for sighting in seen):
            self.sightings.append(selected)
        if detection.elsewhere is not None:
            self.sightings.append(detection.elsewhere)
        for thing in things_of(detection):
            known = next((each for each in reversed(self.things) if each.is_same(at, thing)), None)
            if known is None:
                self.things.append(LoggedThing(at, at, thing))
            else:
                known.last, known.seen = at, thing

    def add_images(self, images: Mapping[int, bytes | VideoImage | None]) -> None:
        """Give the frames the images of these numbers, as of the recording that was replayed."""
        self.frames = [structs.replace(frame, image=images.get(frame.seq)) for frame in self.frames]

    def add_result(self, result: FusionResult) -> None:
        """Keep a result. Results of accepted IMU samples are left out: they are compared with nothing."""
        if result.source != "imu" or result.verdict is not Verdict.FUSED:
            self.results.append(result)
