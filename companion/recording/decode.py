"""Decode the messages of a recording to the service's inputs: the inverse of `companion.facts.encode`."""

import math
from types import MappingProxyType
from typing import Any

import numpy as np
from msgspec import Struct

from companion.base.mission import Event, Reason, ReasonCause, State, StateChange
from companion.base.observer import DeckOutlook, FrameTimes, ResponseInUse, TiltShape
from companion.facts import records as rec
from companion.facts.encode import COMMANDS
from estimator.contracts.commands import Command, CutMotors, Hover, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.estimates import FusionResult, IntegrityAlert, Pose6, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import F64, GeoPoint, Rotation
from estimator.contracts.samples import Attitude, GeoFix, Sample
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.detection import Detection, NearThing, PadCheck, PadThing

_SAMPLES = {record: kind for kind, record in rec.SAMPLES.items()}


def sample(of: Struct) -> Sample:
    """Return the sample of a record. Raises ValueError if the sample does not accept its numbers."""
    if isinstance(of, rec.AttitudeRecord):
        return attitude(of)
    if isinstance(of, rec.FixRecord):
        place = GeoPoint.of_degrees(of.latitude_deg, of.longitude_deg, of.height_m)
        return GeoFix(stamp(of.stamp), of.whose, place, of.sigma_m, None if of.v_ned is None else np.array(of.v_ned))
    return _SAMPLES[type(of)](**{name: _value(name, getattr(of, name)) for name in of.__struct_fields__})


def _value(name: str, value: Any) -> Any:
    """Return the value of a fact's field of this name: the inverse of how `companion.facts.encode` makes lists of arrays."""
    if isinstance(value, rec.StampRecord):
        return stamp(value)
    if not isinstance(value, list):
        return value
    if name.startswith("R_"):
        return Rotation(_matrix(value, 3))
    return _matrix(value, 3) if name.startswith("cov_") else np.array(value)


def stamp(of: rec.StampRecord) -> Stamp:
    """Return the stamp of a record."""
    return Stamp(MonoNs(of.measured_at_ns), MonoNs(of.received_at_ns), of.sigma_s, of.source)


def attitude(of: rec.AttitudeRecord) -> Attitude:
    """Return the attitude of a record."""
    return Attitude(stamp(of.stamp), Rotation(_matrix(of.R_ned_body, 3)), _matrix(of.cov_body, 3))


def detection(of: rec.DetectionRecord) -> Detection | None:
    """Return the detection of a record, or None if vision did not run. It has no features: those are annotations."""
    if of.tried is None:
        return None
    t = stamp(of.stamp)

    def seen(name: str) -> Sighting | None:
        found: rec.SightingRecord | None = getattr(of, name)
        return None if found is None else sighting(found, t, of.seq)

    on_pad = None if of.on_pad is None else _pad_check(of.on_pad)
    methods = MappingProxyType({name: seen(name) for name in of.tried})
    return Detection(seen("selected"), of.chosen, methods, elsewhere=seen("elsewhere"), on_pad=on_pad, unfinished=of.unfinished)


def _pad_check(of: rec.PadCheckRecord) -> PadCheck:
    thing, near = (None if of.thing is None else PadThing(*of.thing)), (None if of.near is None else NearThing(*of.near))
    return PadCheck(MonoNs(of.at_ns), of.seen, thing, near, of.glare)


def frame_times(of: rec.DetectionRecord) -> FrameTimes | None:
    """Return how long the stages of a recorded frame took; None if the record does not say."""
    t = of.times
    return None if t is None else FrameTimes(t.decode_s, t.wait_s, t.look_s, t.filter_s)


def sighting(of: rec.SightingRecord, t: Stamp, seq: int) -> Sighting:
    """Return the sighting of a record, at the stamp and with the number of its frame.

    Raises:
        ValueError: a matrix has a wrong number of elements.
    """
    pose6 = None
    if of.pose6 is not None:
        p = of.pose6
        pose6 = Pose6(np.array(p.d_body_pad_level), Rotation(_matrix(p.R_level_pad, 3)), _matrix(p.cov, 6))
    d, cov = np.array(of.d_body_pad_level), _matrix(of.cov, 4)
    return Sighting(t, seq, of.method, d, of.yaw_rad, of.yaw_ambiguous, cov, of.confidence, pose6)


def belief(of: rec.BeliefRecord) -> RelativeState:
    """Return the estimate of a record. Raises ValueError if an alert is unknown."""
    return RelativeState(
        MonoNs(of.at_ns),
        of.path,
        np.array(of.d_body_pad_level),
        np.array(of.v_pad_level),
        of.yaw_rad,
        _matrix(of.cov, 7),
        MonoNs(of.sighted_ns),
        of.consistent,
        tuple((d.name, d.value) for d in of.details),
        of.track,
        tuple(_alert_named(name) for name in of.alerts),
        tuple(of.lost),
    )


def fusion(of: rec.FusionRecord) -> FusionResult:
    """Return the result of a record. Raises ValueError if it has not a number for each component."""
    m = len(of.components)
    if of.innovation is not None and len(of.innovation) != m:
        raise ValueError(f"an innovation of {m} components has {m} numbers, got {len(of.innovation)}")
    return FusionResult(
        of.path,
        of.source,
        of.verdict,
        MonoNs(of.measured_at_ns),
        MonoNs(of.received_at_ns),
        None if of.innovation is None else np.array(of.innovation, dtype=float),
        None if of.innovation_cov is None else _matrix(of.innovation_cov, m),
        tuple(of.components),
        math.nan if of.nis is None else of.nis,
        math.nan if of.test_ratio is None else of.test_ratio,
    )


def _alert_named(name: str) -> IntegrityAlert:
    try:
        return IntegrityAlert[name.upper()]
    except KeyError as why:
        raise ValueError(f"no such alert: {name!r}") from why


def command(of: rec.DecisionRecord) -> Command | None:
    """Return the command of a recorded decision; None if none was given."""
    if of.command is None:
        return None
    kind = {name: kind for kind, name in COMMANDS.items()}.get(of.command)
    if kind is Velocity and of.v_level is not None and of.yaw_rate_rad_s is not None:
        return Velocity(np.array(of.v_level), of.yaw_rate_rad_s)
    if kind is Lean and None not in (of.a_level, of.trim_level, of.v_level, of.yaw_rate_rad_s):
        return Lean(np.array(of.a_level), np.array(of.trim_level), np.array(of.v_level), float(of.yaw_rate_rad_s or 0.0))
    for simple in (Hover, TakeOff, Land, CutMotors, LeaveEmergency):
        if kind is simple:
            return simple()
    raise ValueError(f"no such command: {of.command!r}")


def response(of: rec.ResponseRecord | None) -> ResponseInUse | None:
    """Return a recorded response of the vehicle."""
    if of is None:
        return None
    shape = TiltShape(of.frequency, of.damping, of.softer, of.sigma)
    return ResponseInUse(of.state, of.delay_s, of.sigma_s, of.longer_s, shape)


def deck(of: rec.DeckRecord | None, at: MonoNs) -> DeckOutlook | None:
    """Return a recorded forecast of the deck, made at an instant. Raises ValueError if its columns differ in length."""
    if of is None:
        return None
    columns = [getattr(of, name) for name in of.__struct_fields__]
    if len({len(column) for column in columns}) != 1:
        raise ValueError("a forecast of the deck has columns of different lengths")
    return DeckOutlook(at, *map(tuple, columns))


def transition(of: rec.TransitionRecord) -> StateChange:
    """Return a recorded change of the mission's state. Raises ValueError if a name is not known."""
    try:
        detail: IntegrityAlert | Verdict | str | None = None
        if of.cause == ReasonCause.TAKEN_OVER.name:
            detail = of.detail
        elif of.detail is not None:
            detail = Verdict[of.detail] if of.detail in Verdict.__members__ else IntegrityAlert[of.detail]
        reason = Reason(ReasonCause[of.cause], of.measured, of.limit, detail)
        return StateChange(MonoNs(of.at_ns), State[of.source], Event[of.event], State[of.target], reason)
    except KeyError as why:
        raise ValueError(f"no such state, event, cause, verdict or alert: {why.args[0]!r}") from why


def truth(of: rec.TruthRecord) -> None:
    """Check a record of truth. Raises ValueError if its numbers are not valid."""
    for rows in (of.R_ned_body, of.R_ned_pad):
        if rows is not None:
            Rotation(_matrix(rows, 3))
    if not -math.pi < of.yaw_rad <= math.pi:
        raise ValueError(f"the true heading must lie in (-pi, pi], got {of.yaw_rad}")


def _matrix(numbers: list[float], n: int) -> F64:
    return np.array(numbers, dtype=float).reshape(n, n)
