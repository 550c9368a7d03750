"""Encode what the service passes to its observers as records, and decode the two that it encodes again."""

import math
from typing import TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.base.health import HealthSnapshot
from companion.base.mission import StateChange
from companion.base.observer import Decision, DeckOutlook, ProcessedFrame, ResponseInUse
from companion.base.orders import HandledOrder, OrderSender
from companion.facts import records as rec
from estimator.contracts.commands import Command, CutMotors, Hover, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.estimates import FusionResult, Pose6, RelativeState, Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, GeoFix, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.detection import Detection, PadCheck

R = TypeVar("R", bound=Struct)

COMMANDS: dict[type[Command], str] = {
    Velocity: "velocity", Lean: "lean", Hover: "hover", TakeOff: "take_off", Land: "land",
    CutMotors: "cut_motors", LeaveEmergency: "leave_emergency",
}  # fmt: skip


def sample(of: Sample) -> Struct:
    """Return the record of a sample of any kind."""
    if isinstance(of, Attitude):
        return attitude(of)
    if isinstance(of, GeoFix):
        latitude_deg, longitude_deg = math.degrees(of.place.latitude_rad), math.degrees(of.place.longitude_rad)
        v_ned = None if of.v_ned is None else of.v_ned.tolist()
        return rec.FixRecord(stamp(of.stamp), of.whose, latitude_deg, longitude_deg, of.sigma_m, of.place.height_m, v_ned)
    return _as(rec.SAMPLES[type(of)], of)


def _as(kind: type[R], of: object) -> R:
    """Return the record of a fact whose fields have the same names; arrays and rotations become lists of numbers."""
    return kind(*(_plain(getattr(of, name)) for name in kind.__struct_fields__))


def _plain(value: object) -> object:
    match value:
        case np.ndarray():
            return _flat(value)
        case Rotation():
            return _flat(value.matrix)
        case Stamp():
            return stamp(value)
        case Pose6():
            return _as(rec.Pose6Record, value)
    return value


def status(of: VehicleStatus) -> rec.StatusRecord:
    """Return the record of a vehicle's status."""
    return _as(rec.StatusRecord, of)


def stamp(of: Stamp) -> rec.StampRecord:
    """Return the record of a stamp."""
    return rec.StampRecord(int(of.measured_at), int(of.received_at), float(of.sigma_s), of.source)


def attitude(of: Attitude) -> rec.AttitudeRecord:
    """Return the record of an attitude, with roll, pitch and yaw in degrees for the viewer."""
    roll, pitch, yaw = (math.degrees(a) for a in of.R_ned_body.rpy_rad)
    return rec.AttitudeRecord(stamp(of.stamp), _flat(of.R_ned_body.matrix), _flat(of.cov_body), roll, pitch, yaw)


def detection(of: ProcessedFrame) -> rec.DetectionRecord:
    """Return the record of a processed frame, with the sighting of every method that was tried."""
    height, width = of.frame.px.shape[:2]
    processed = of.detection
    return rec.DetectionRecord(
        stamp(of.frame.stamp),
        of.frame.seq,
        of.frame.exposure_s,
        width,
        height,
        of.verdict,
        int(of.began),
        int(of.done),
        None if of.attitude is None else attitude(of.attitude),
        None if processed is None else list(processed.methods),
        None if processed is None else processed.chosen,
        times=None if of.times is None else rec.FrameTimesRecord(*(seconds for _, seconds in of.times.by_stage())),
        R_body_cam=None if of.camera is None else _flat(of.camera.T_body_cam.R.matrix),
        gain=of.frame.gain,
        coded=of.frame.coded,
        on_pad=None if processed is None or processed.on_pad is None else _pad_check(processed.on_pad),
        unfinished=processed is not None and processed.unfinished,
        **({} if processed is None else _methods(processed)),
    )


def _pad_check(of: PadCheck) -> rec.PadCheckRecord:
    thing = None if of.thing is None else [of.thing.width_m, of.thing.forward_m, of.thing.right_m]
    near = None if of.near is None else [of.near.forward_m, of.near.right_m, of.near.height_m]
    return rec.PadCheckRecord(int(of.at), of.seen, thing, near, of.glare)


def _methods(processed: Detection) -> dict[str, rec.SightingRecord]:
    found: dict[str, rec.SightingRecord] = {name: sighting(s) for name, s in processed.methods.items() if s is not None}
    if processed.selected is not None:
        found["selected"] = sighting(processed.selected)
    if processed.elsewhere is not None:
        found["elsewhere"] = sighting(processed.elsewhere)
    return found


def sighting(of: Sighting) -> rec.SightingRecord:
    """Return the record of a sighting, without its stamp."""
    return _as(rec.SightingRecord, of)


def belief(of: RelativeState) -> rec.BeliefRecord:
    """Return the record of an estimate. Details that are not finite are left out."""
    return rec.BeliefRecord(
        int(of.at),
        of.path,
        of.d_body_pad_level.tolist(),
        of.v_pad_level.tolist(),
        _flat(of.cov),
        int(of.sighted),
        of.consistent,
        of.height_m,
        of.lateral_m,
        [rec.NamedNumber(name, float(value)) for name, value in of.details if math.isfinite(value)],
        of.yaw_rad,
        of.track,
        [alert.name.lower() for alert in of.alerts],
        list(of.lost),
    )


def fusion(at: MonoNs, of: FusionResult) -> rec.FusionRecord:
    """Return the record of a result that the service processed at `at`. Numbers that are not finite are left out."""
    return rec.FusionRecord(
        int(at),
        of.path,
        of.source,
        of.verdict,
        int(of.measured_at),
        int(of.received_at),
        list(of.components),
        _finite(of.innovation),
        _finite(of.innovation_cov),
        of.nis if math.isfinite(of.nis) else None,
        of.test_ratio if math.isfinite(of.test_ratio) else None,
    )


def decision(of: Decision) -> rec.DecisionRecord:
    """Return the record of a decision."""
    command, v, turn, a, trim = of.command, None, None, None, None
    if isinstance(command, Velocity | Lean):
        v, turn = command.v_level.tolist(), command.yaw_rate_rad_s
    if isinstance(command, Lean):
        a, trim = command.a_level.tolist(), command.trim_level.tolist()
    return rec.DecisionRecord(
        int(of.at),
        of.phase,
        None if of.belief is None else of.belief.path,
        None if command is None else COMMANDS[type(command)],
        v,
        turn,
        of.reason,
        a,
        trim,
        [transition(change) for change in of.transitions],
        response(of.response),
        deck(of.ahead),
    )


def deck(of: DeckOutlook | None) -> rec.DeckRecord | None:
    """Return the record of a forecast of the deck."""
    return None if of is None else rec.DeckRecord(*(list(getattr(of, name)) for name in rec.DeckRecord.__struct_fields__))


def response(of: ResponseInUse | None) -> rec.ResponseRecord | None:
    """Return the record of a vehicle's response."""
    if of is None:
        return None
    return rec.ResponseRecord(of.state, of.delay_s, of.sigma_s, of.longer_s, **of.shape._asdict())


def transition(of: StateChange) -> rec.TransitionRecord:
    """Return the record of a change of the mission's state."""
    why = of.reason
    detail = why.detail if why.detail is None or isinstance(why.detail, str) else why.detail.name
    measured, limit = (x if x is None or math.isfinite(x) else None for x in (why.measured, why.limit))
    return rec.TransitionRecord(
        int(of.at), of.source.name, of.event.name, of.target.name, why.cause.name, measured, limit, detail, why.text
    )


def order(of: HandledOrder) -> rec.OrderRecord:
    """Return the record of a person's order and its answer."""
    sender = of.sender
    return rec.OrderRecord(int(of.at), sender.source, sender.name, of.order, of.accepted, of.refusal, of.detail)


def health(at: MonoNs, of: HealthSnapshot) -> rec.HealthRecord:
    """Return the record of the service's health at `at`."""
    tallies = [rec.TallyRecord("Frame", verdict, n) for verdict, n in of.frames.items()]
    tallies += [rec.TallyRecord(kind, verdict, n) for kind, counts in of.inputs.items() for verdict, n in counts.items()]
    return rec.HealthRecord(
        int(at),
        list(of.parts.values()),
        list(of.flows.values()),
        tallies,
        [rec.StageRecord(name, s.count, s.p50_s, s.p99_s) for name, s in of.stages.items()],
        [
            rec.CounterRecord(part, name, float(n))
            for part, counts in of.counters.items()
            for name, n in counts.items()
            if math.isfinite(n)
        ],
        of.all_up,
        of.flight_up,
        of.too_slow or "",
    )


def _finite(a: NDArray[np.float64] | None) -> list[float] | None:
    """Return the numbers row by row, or None if there are none or one of them is not finite."""
    if a is None:
        return None
    flat = _flat(a)
    return flat if all(map(math.isfinite, flat)) else None


def _flat(a: NDArray[np.float64]) -> list[float]:
    out: list[float] = a.ravel().tolist()
    return out


def held_rotation(of: rec.DetectionRecord) -> Rotation | None:
    """Return the rotation of a camera on the body as its gimbal held it; None of one that is fixed, or if it is not known."""
    return None if of.R_body_cam is None else Rotation(np.array(of.R_body_cam, dtype=float).reshape(3, 3))


def handled(of: rec.OrderRecord) -> HandledOrder:
    """Return the order of a record, with its answer."""
    refusal = None if of.accepted else of.refusal or ""
    return HandledOrder(MonoNs(of.at_ns), OrderSender(of.source, of.sender), of.order, refusal, of.detail)
