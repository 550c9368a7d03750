"""Make a pilot for a recording and replay every sample, frame and guidance cycle through it, in the order of the service.

Nothing here reads a clock: instants are the recording's. The same recording through the same pilot gives bit-identical outputs,
and a hash over them proves it.
"""

import hashlib
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

import msgspec
import numpy as np
from msgspec import Struct, structs

from companion.base.containment import Audience
from companion.base.health import Health
from companion.base.mission import FLOWN, FlightOutcome, State
from companion.base.observer import Decision, Observer
from companion.base.orders import HandledOrder, OperatorOrder
from companion.cycle.cycle import Cycle
from companion.cycle.pace import FramePace
from companion.facts import encode
from companion.facts.records import FusionRecord, HealthRecord, LinkRecord, OrderRecord, TruthRecord
from companion.guidance.pilot import Pilot, make_pilot
from companion.recording.channels import CAMERA, PAD
from companion.recording.reading import Event, RecordedFrame, Recording, instant
from companion.settings.load import Settings, load
from drivers.clock import SetClock
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import PathName, Sighting
from estimator.contracts.samples import Frame, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between
from estimator.pipeline import lacks
from estimator.vision.detection import Detection

OWN = CAMERA, PAD
"""The files of a recording that its settings name."""
_GAP_S = 10.0
"""The longest gap in the recording that is replayed through guidance, s."""
_FLOWN = tuple(state.value for state in State if state in FLOWN - {State.ANOTHER_PAD, State.LAND_HERE})
"""The phases of a flight that an operator has begun."""


class Counts(Struct):
    """The numbers of replayed events."""

    samples: int = 0
    frames: int = 0
    searched: int = 0
    """The number of frames whose image went through vision again."""
    as_recorded: int = 0
    """The number of frames whose recorded sightings were used."""
    decisions: int = 0


class Replay:
    """One pass of a recording through a pilot.

    Args:
        sightings: use the recorded sightings instead of running vision again; frames without an image always use them.
        rate_hz: the rate of guidance cycles if the recording holds none.
        shift_ns: the time that is added to every instant, to replay the flight as if it happened now.
        observers: receive the events that the service would send them; frames whose image was not kept are black.
    """

    def __init__(
        self,
        recording: Recording,
        pilot: Pilot,
        *,
        sightings: bool = False,
        rate_hz: float = 50.0,
        shift_ns: int = 0,
        observers: Sequence[Observer] = (),
    ) -> None:
        self._recording = recording
        self._pilot = pilot
        self._sightings = sightings
        self._period_s = 1.0 / rate_hz
        self._shift_ns = shift_ns
        self._clock = SetClock(MonoNs(0))
        health = Health(self._clock)
        pace = FramePace(1.0, pilot.camera, health)
        self._cycle = Cycle(pilot, health, Audience(observers, health, guarded=False), pace)
        self._hash = hashlib.sha256()
        self._encoder = msgspec.json.Encoder()
        self._guided = False
        self._due: MonoNs | None = None
        self._phase = ""
        self.counts = Counts()

    @property
    def digest(self) -> str:
        """Return the SHA-256 over every verdict, sighting, belief and command so far."""
        return self._hash.hexdigest()

    @property
    def outcome(self) -> FlightOutcome | None:
        """Return how the flight ended according to the pilot."""
        return self._pilot.outcome

    def run(self) -> None:
        """Replay the recording to its end."""
        for _ in self.steps():
            pass

    def steps(self) -> Iterator[tuple[MonoNs, Event]]:
        """Yield each event just before it is processed, with the instant of the service's processing plus `shift_ns`.

        Raises:
            BadInput: the recording holds numbers that the estimator cannot take.
        """
        self._guided = any(isinstance(event, Decision) for event in self._recording.events())
        for event in self._recording.events():
            at = self._clock.t = MonoNs(instant(event) + self._shift_ns)
            yield at, event
            try:
                self._take(at, event)
            # A vehicle's numbers are bounded at their input; a file may hold any.
            except (ArithmeticError, ValueError) as why:
                name, kind = self._recording.name, type(event).__name__
                raise BadInput(f"{name}: {kind} at {instant(event)} ns: not what the estimator can take: {why}") from why

    def _take(self, at: MonoNs, event: Event) -> None:
        if not self._guided:
            self._guide_until(at)
        match event:
            case RecordedFrame():
                self._frame(event)
            case Decision():
                self._follow_operator(event.phase)
                self._decide(MonoNs(event.at + self._shift_ns))
            case OrderRecord():
                self._order(encode.handled(structs.replace(event, at_ns=int(at))))
            case FusionRecord() | TruthRecord() | LinkRecord() | HealthRecord():
                pass
            case _:
                self._sample(event)

    def _moved(self, stamp: Stamp) -> Stamp:
        if not self._shift_ns:
            return stamp
        return structs.replace(
            stamp, measured_at=MonoNs(stamp.measured_at + self._shift_ns), received_at=MonoNs(stamp.received_at + self._shift_ns)
        )

    def _sample(self, recorded: Sample) -> None:
        sample = structs.replace(recorded, stamp=self._moved(recorded.stamp))
        if isinstance(sample, VehicleStatus) and sample.others_at is not None:
            sample = structs.replace(sample, others_at=MonoNs(sample.others_at + self._shift_ns))
        self.counts.samples += 1
        for result in self._cycle.samples((sample,), sample.stamp.received_at)[0]:
            self._hash.update(f"{result.path} {type(sample).__name__} {result.verdict.value}".encode())

    def _frame(self, recorded: RecordedFrame) -> None:
        size = self._pilot.camera.width, self._pilot.camera.height
        kept = None if self._sightings else recorded.frame(size)
        began, done = (MonoNs(t + self._shift_ns) for t in (recorded.record.began_ns, recorded.record.done_ns))
        frame = structs.replace(kept or _black(recorded), stamp=self._moved(recorded.stamp))
        attitude = recorded.attitude
        attitude = None if attitude is None else structs.replace(attitude, stamp=self._moved(attitude.stamp))
        self.counts.frames += 1
        # An image that was not kept cannot be looked at again; one of another size is not one of this camera.
        if kept is None and (self._sightings or (recorded.record.width, recorded.record.height) == size):
            self.counts.as_recorded += 1
            seen = self._recorded_detection(recorded)
            begun = self._cycle.known(frame, began, recorded.record.verdict, attitude)
        else:
            begun = self._cycle.begin(frame, began, attitude)
            self.counts.searched += begun.look is not None and begun.follows is None
            seen = None if begun.look is None else self._pilot.detect(begun.look)
        processed = structs.replace(self._cycle.conclude(begun, seen), done=done, times=recorded.times)
        self._hash.update(self._encoder.encode(encode.detection(processed)))
        self._cycle.report(processed)
        if begun.look is not None and processed.detection is not None and self._cycle.reads_deck:
            self._cycle.on_deck(self._pilot.search.read_deck(processed.detection))

    def _recorded_detection(self, recorded: RecordedFrame) -> Detection | None:
        detection = recorded.detection()
        if detection is None or not self._shift_ns:
            return detection
        selected, elsewhere = self._shifted(detection.selected), self._shifted(detection.elsewhere)
        methods = {name: self._shifted(seen) for name, seen in detection.methods.items()}
        check = detection.on_pad
        on_pad = None if check is None else structs.replace(check, at=MonoNs(check.at + self._shift_ns))
        return structs.replace(detection, selected=selected, methods=methods, elsewhere=elsewhere, on_pad=on_pad)

    def _shifted(self, seen: Sighting | None) -> Sighting | None:
        return None if seen is None else structs.replace(seen, stamp=self._moved(seen.stamp))

    def _order(self, handled: HandledOrder) -> None:
        """Hand an order on; carry out the one that shows in no phase."""
        if handled.accepted and handled.order is OperatorOrder.CLEAR:
            self._pilot.overrule()
        elif handled.accepted and handled.order is OperatorOrder.LAND:
            self._pilot.land()
        elif handled.accepted and handled.order is OperatorOrder.STAY:
            self._pilot.stay()
        elif handled.accepted and handled.order is OperatorOrder.BEGIN and self._pilot.landing.mission.stays:
            self._pilot.begin()
        self._cycle.audience.on_order(handled)

    def _follow_operator(self, phase: str) -> None:
        """Follow the operator's commands as they show in the phases: old recordings hold no orders."""
        if phase == "paused":
            self._pilot.hold()
        elif phase == FlightOutcome.ABORTED.value:
            self._pilot.abort()
        elif phase in _FLOWN and self._phase not in _FLOWN:
            self._pilot.begin()
        self._phase = phase

    def _guide_until(self, now: MonoNs) -> None:
        if self._due is None:
            self._due = now
            self._pilot.landing.mission = structs.replace(self._pilot.landing.mission, state=State.WAIT)
        if seconds_between(self._due, now) > _GAP_S:
            self._due = now
        while self._due <= now:
            self._decide(self._due)
            self._due = after(self._due, self._period_s)

    def _decide(self, at: MonoNs) -> None:
        decision = self._cycle.decide(at)
        self.counts.decisions += 1
        # Without the path that needs a library: the hash must not depend on other packages.
        shadows = (shadow for shadow in decision.shadows if shadow.path != "constant_velocity")
        for belief in (decision.belief, *shadows):
            if belief is not None:
                self._hash.update(self._encoder.encode(encode.belief(belief)))
        self._hash.update(self._encoder.encode(encode.decision(decision)))
        self._cycle.carry_out(decision, lambda _: None)


def _black(recorded: RecordedFrame) -> Frame:
    """Return a black frame of the right size that takes no memory."""
    px = np.broadcast_to(np.zeros(1, np.uint8), (recorded.record.height, recorded.record.width, 3))
    return Frame(recorded.stamp, recorded.record.seq, px, recorded.record.exposure_s, recorded.record.gain, recorded.record.coded)


def available_paths() -> tuple[PathName, ...]:
    """Return the paths that the estimator can run: all but those that are not installed, or lack a library."""
    return tuple(path for path in get_args(PathName) if not lacks(path))


def settings_of(recording: Recording, config: str | None) -> Settings:
    """Return the settings in `config` if it is given, else those that the recording was made with.

    Raises:
        BadInput: neither is available.
    """
    if config is not None:
        return load(config)
    try:
        settings = recording.settings()
    except BadInput as why:
        raise BadInput(f"{why} (made by another version? name settings with --config)") from why
    if settings is None:
        raise BadInput(f"{recording.name}: holds no settings; name some with --config")
    return settings


@contextmanager
def with_files_of(recording: Recording, settings: Settings, names: Iterable[str] = OWN) -> Iterator[Settings]:
    """Provide settings that name the recording's own files of these names, which exist as long as this lasts."""
    with tempfile.TemporaryDirectory(prefix="decklander-") as folder:
        for path in (Path(folder) / name for name in names if name in recording.attachments):
            path.write_bytes(recording.attachments[path.name])
            settings = structs.replace(settings, **{path.stem: structs.replace(getattr(settings, path.stem), file=str(path))})
        yield settings


def pilot_of(settings: Settings, path: PathName | None, *, alone: bool = False) -> Pilot:
    """Return a pilot that runs every path (or one `alone`) and steers by `path` (else by the settings' own).

    Raises:
        BadInput: a camera or pad file is missing or has a fault, or the path needs a library that is not installed.
    """
    steering = path or settings.estimator.path
    shadows = [] if alone else [p for p in available_paths() if p != steering]
    return make_pilot(structs.replace(settings, estimator=structs.replace(settings.estimator, path=steering)), shadows=shadows)
