"""The log of a recorded flight as it was decided then, without running anything again."""

from __future__ import annotations

from companion.base.mission import ENDED, State
from companion.base.observer import Decision
from companion.recording import decode
from companion.recording.reading import SETTINGS, RecordedFrame, Recording, instant
from companion.recording.records import FusionRecord, TruthRecord
from companion.tools.replay.truth_log import add_truth
from companion.tools.report.expected_place import less_innovation
from companion.tools.report.flight_log import CommandRecord, FlightLog, FrameRecord, PhaseChange, StageTime
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.fusion import FusionResult
from estimator.contracts.geometry import F64
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between


def log_of(recording: Recording, title: str, *, images: bool = True) -> FlightLog:
    """Read the whole recording into a log.

    Args:
        images: keep the frames' images, for a video.

    Raises:
        BadInput: the recording does not hold its camera and its pad, or has no event.
    """
    camera, pad = recording.camera(), recording.pad()
    if camera is None or pad is None:
        raise BadInput(f"{recording.name}: does not hold its camera and its pad; `decklander replay` takes them from --config")
    log = FlightLog(title, MonoNs(0), pad, camera)
    log.settings = recording.attachments.get(SETTINGS, b"").decode("utf-8", "replace")
    log.facts = [(name, value) for name, value in recording.metadata.get("flight", {}).items()]
    log.facts.append(("decklander", recording.metadata.get("versions", {}).get("decklander", "unknown")))
    frames: list[RecordedFrame] = []
    compared: dict[tuple[str, MonoNs], FusionResult] = {}
    flying: bool | None = None
    for event in recording.events():
        if not log.started:
            log.started = instant(event)
        match event:
            case RecordedFrame():
                frames.append(event if images else RecordedFrame(event.record, None))
            case FusionRecord():
                result = decode.fusion(event)
                log.add_result(result)
                if result.source == "sighting":
                    compared[result.path, result.measured_at] = result
            case Decision():
                _decided(log, event)
            case TruthRecord():
                add_truth(log, event)
            case VehicleStatus():
                flying = flying if event.flying is None else event.flying
            case _:
                pass
    if not log.started:
        raise BadInput(f"{recording.name}: holds no event")
    for frame in frames:
        _framed(log, frame, compared)
    log.outcome = _outcome(log, flying)
    return log


def _outcome(log: FlightLog, flying: bool | None) -> str:
    """Return how the flight ended; a vehicle that stands after the order to stop its motors has landed."""
    if not log.transitions:
        return "unfinished"
    last = log.transitions[-1].target
    if last is State.DOWN and flying is False:
        last = State.LANDED
    return last.value if last in ENDED else f"unfinished: {last.value}"


def _decided(log: FlightLog, decision: Decision) -> None:
    if not log.phases or log.phases[-1].phase != decision.phase:
        log.phases.append(PhaseChange(decision.at, decision.phase))
    log.transitions += decision.transitions
    log.estimates += [b for b in (decision.belief, *decision.shadows) if b is not None]
    if log.steering is None and decision.belief is not None:
        log.steering = decision.belief.path
    if decision.command is not None:
        log.commands.append(CommandRecord(decision.at, decision.command))
    if decision.ahead is not None:
        log.add_forecast(decision.ahead)


def _framed(log: FlightLog, frame: RecordedFrame, compared: dict[tuple[str, MonoNs], FusionResult]) -> None:
    verdict, at = Verdict(frame.record.verdict), frame.stamp.measured_at
    attitude, detection = frame.attitude, frame.detection()
    level = None if attitude is None else attitude.R_ned_body.without_heading()
    place: F64 | None = None
    result = compared.get((log.steering or "", at))
    seen = None if detection is None else detection.selected
    if level is not None and seen is not None and result is not None and result.innovation is not None:
        place = level @ less_innovation(level, seen.d_body_pad_level, result.innovation)
    log.frames.append(FrameRecord(at, frame.record.seq, verdict, level, place, frame.R_body_cam, frame.image))
    log.verdicts[verdict] += 1
    if detection is not None:
        log.add_detection(detection)
    stages = [("camera and link", frame.stamp.delay_s)]
    if frame.times is not None:
        stages += frame.times.by_stage()
    for name, seconds in stages:
        log.stages.setdefault(name, []).append(StageTime(at, seconds))
    log.delays.append(StageTime(at, seconds_between(at, frame.done)))
