"""Read the log of a recorded flight for figures and report, and compare the estimates of two recordings."""

import math
from contextlib import suppress
from pathlib import Path

import numpy as np
from msgspec import MsgspecError, Struct, convert, json, structs

from companion.base.loop_lag import in_words
from companion.base.mission import ENDED, State
from companion.base.observer import Decision
from companion.facts import encode
from companion.facts.records import ContactRecord, FusionRecord, HealthRecord, OrderRecord, TruthRecord
from companion.recording import decode
from companion.recording import foxglove as fox
from companion.recording.channels import ANNOTATIONS, SETTINGS
from companion.recording.reading import RecordedFrame, Recording, instant, open_recording
from companion.tools.report.figures import body_over_pad
from companion.tools.report.flight_log import FlightLog, FrameRecord, LoggedContact, StageTime, TruthSample
from companion.tools.report.overlay import less_innovation
from companion.tools.report.page import Report
from drivers.files import Largest, opened
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Feature, FeatureKind, FusionResult, PathName, RelativeState
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between


def _add_truth(log: FlightLog, truth: TruthRecord) -> None:
    """Append the truth of one instant, and its newest contact if that is another one than before."""
    d, v = np.array(truth.d_body_pad_level), np.array(truth.v_pad_level)
    p = None if truth.p_pad_ned is None else np.array(truth.p_pad_ned)
    R = None if truth.R_ned_pad is None else Rotation(np.array(truth.R_ned_pad).reshape(3, 3))
    log.truth.append(TruthSample(MonoNs(truth.at_ns), d, v, truth.yaw_rad, p, R))
    if truth.touchdown is not None and all(contact.at != truth.touchdown.at_ns for contact in log.contacts):
        log.contacts.append(_contact(truth.touchdown, truth))


def _contact(of: ContactRecord, truth: TruthRecord) -> LoggedContact:
    """Return a contact; its place is that of the first truth which names it."""
    lateral_m, yaw_rad, down_m_s, aside_m_s = (
        math.nan if x is None else x for x in (of.lateral_m, of.yaw_rad, of.vertical_speed_m_s, of.lateral_speed_m_s)
    )
    along, starboard, _ = body_over_pad(np.array([truth.d_body_pad_level]), np.array([truth.yaw_rad]))[0].tolist()
    where = (along, starboard)
    return LoggedContact(MonoNs(of.at_ns), lateral_m, down_m_s, aside_m_s, of.on_pad, of.surface, where, yaw_rad)


def report_of(path: str | Path) -> Report:
    """Return the report of a recorded flight for a notebook.

    Raises:
        BadInput: as `log_of`, or the file is no recording.
    """
    return Report(log_of(open_recording([Path(path)]), Path(path).stem))


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
    late: dict[str, float] = {}
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
                log.add_decision(event)
            case TruthRecord():
                _add_truth(log, event)
            case OrderRecord():
                log.orders.append(encode.handled(event))
            case VehicleStatus():
                flying = flying if event.flying is None else event.flying
            case HealthRecord():
                late = {count.name: count.value for count in event.counters if count.part == "loop"}
    if not log.started:
        raise BadInput(f"{recording.name}: holds no event")
    if late.keys() >= {"lag_worst_s", "lag_p999_s", "held"}:
        log.facts.append(("event loop", in_words(late)))
    features = _features(recording) if images else {}
    for frame in frames:
        _add_frame(log, frame, compared, features.get(frame.stamp.measured_at, {}))
    log.outcome = _outcome(log, flying)
    return log


def _features(recording: Recording) -> dict[MonoNs, dict[str, tuple[Feature, ...]]]:
    """Return the features that each method found in a frame, by the frame's exposure, as `fox.image_annotations` keeps them."""
    found: dict[MonoNs, dict[str, tuple[Feature, ...]]] = {}
    decoder, offset_ns = json.Decoder(fox.ImageAnnotations), recording.offset_ns()
    for path in recording.paths:
        with opened(path, Largest.RECORDING) as stream:
            for topic, data in recording.messages(path, stream):
                if topic == ANNOTATIONS:
                    with suppress(MsgspecError):
                        drawn = decoder.decode(data)
                        at = MonoNs(drawn.timestamp.sec * NS_PER_S + drawn.timestamp.nsec - offset_ns)
                        for points in drawn.points:
                            method, feature = _feature(points)
                            by_method = found.setdefault(at, {})
                            by_method[method] = (*by_method.get(method, ()), feature)
    return found


def _feature(drawn: fox.PointsAnnotation) -> tuple[str, Feature]:
    """Return a feature and the method that found it. Raises ValidationError for an unknown kind."""
    notes = {note.key: note.value for note in drawn.metadata}
    uv_px = np.array([(point.x, point.y) for point in drawn.points]).reshape(-1, 2) - 0.5
    return notes.get("method", ""), Feature(convert(notes.get("kind"), FeatureKind), notes.get("label", ""), uv_px)


def _outcome(log: FlightLog, flying: bool | None) -> str:
    """Return how the flight ended; a vehicle that stands after the order to stop its motors has landed."""
    if not log.transitions:
        return "unfinished"
    before, last = log.transitions[-1].source, log.transitions[-1].target
    if last is State.TAKEN and before in ENDED:
        last = before
    if last is State.DOWN and flying is False:
        last = State.LANDED
    return last.value if last in ENDED else f"unfinished: {last.value}"


def _add_frame(
    log: FlightLog,
    frame: RecordedFrame,
    compared: dict[tuple[str, MonoNs], FusionResult],
    features: dict[str, tuple[Feature, ...]],
) -> None:
    verdict, at = frame.record.verdict, frame.stamp.measured_at
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
        sightings = detection.methods.items()
        methods = {name: one and structs.replace(one, features=features.get(name, ())) for name, one in sightings}
        log.add_detection(structs.replace(detection, methods=methods), at)
    stages = [("camera and link", frame.stamp.delay_s)]
    if frame.times is not None:
        stages += frame.times.by_stage()
    elif detection is not None:
        stages.append(("vision", seconds_between(MonoNs(frame.record.began_ns), frame.done)))
    for name, seconds in stages:
        log.stages.setdefault(name, []).append(StageTime(at, seconds))
    log.delays.append(StageTime(at, seconds_between(at, frame.done)))


Beliefs = dict[tuple[PathName, MonoNs], RelativeState]


class Difference(Struct, frozen=True):
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
    return {key: one for event in recording.events() if isinstance(event, Decision) for key, one in _beliefs(event).items()}


def _beliefs(decision: Decision) -> Beliefs:
    return {(belief.path, belief.at): belief for belief in (decision.belief, *decision.shadows) if belief is not None}


def differences(ours: Beliefs, theirs: Beliefs) -> list[Difference]:
    """Return the difference for each path that both have; its numbers are nan if no instants coincide."""
    out = []
    for path in sorted({p for p, _ in ours} & {p for p, _ in theirs}):
        a = {at: b for (p, at), b in ours.items() if p == path}
        b = {at: c for (p, at), c in theirs.items() if p == path}
        common = sorted(a.keys() & b.keys())
        d = np.array([float(np.linalg.norm(a[t].d_body_pad_level - b[t].d_body_pad_level)) for t in common])
        pairs = ((a[t].yaw_rad, b[t].yaw_rad) for t in common)
        yaw = [abs(wrap_pi(x - y)) for x, y in pairs if x is not None and y is not None]
        same = sum(_same(a[t], b[t]) for t in common)
        q50, q95, largest = (float(np.quantile(d, q)) if len(d) else math.nan for q in (0.5, 0.95, 1.0))
        out.append(Difference(path, len(common), len(a.keys() ^ b.keys()), same, q50, q95, largest, max(yaw, default=math.nan)))
    return out


def _same(a: RelativeState, b: RelativeState) -> bool:
    return (
        np.array_equal(a.d_body_pad_level, b.d_body_pad_level)
        and np.array_equal(a.v_pad_level, b.v_pad_level)
        and np.array_equal(a.cov, b.cov)
        and a.yaw_rad == b.yaw_rad
    )
