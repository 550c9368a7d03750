"""Encode the service's state as the messages that it publishes. No I/O."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.base.health import FusionState, HealthSnapshot
from companion.base.observer import Decision, ProcessedFrame
from companion.parts.mqtt.messages import (
    BeliefReport,
    CommandReport,
    FlowReport,
    FusionMessage,
    HealthReport,
    MethodReport,
    PartReport,
    SightingMessage,
    SourceReport,
    StageReport,
    StateMessage,
    Vector3,
    VehicleState,
)
from estimator.contracts.commands import Command, CutMotors, Hover, Land, Lean, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, seconds_between


def state(session: str, decision: Decision, vehicle: VehicleStatus | None) -> StateMessage:
    """Return the message for one guidance cycle and the vehicle's newest status."""
    at = decision.at
    return StateMessage(
        session=session,
        at_ns=at,
        phase=decision.phase,
        belief=None if decision.belief is None else belief(decision.belief, decision),
        shadows=tuple(belief(shadow, decision) for shadow in decision.shadows),
        order=order(decision.command),
        vehicle=None
        if vehicle is None
        else VehicleState(
            mode=vehicle.mode,
            flying=vehicle.flying,
            battery_fraction=vehicle.battery_fraction,
            emergency=vehicle.emergency,
            link_ok=vehicle.link_ok,
            age_s=seconds_between(vehicle.stamp.received_at, at),
        ),
    )


def belief(of: RelativeState, decision: Decision) -> BeliefReport:
    """Return the report of a belief; its sigmas are the square roots of the covariance's diagonal."""
    sigmas = np.sqrt(np.diag(of.cov))
    return BeliefReport(
        path=of.path,
        d_body_pad_level_m=_vector(of.d_body_pad_level),
        v_pad_level_m_s=_vector(of.v_pad_level),
        yaw_rad=of.yaw_rad,
        sigma_d_m=_vector(sigmas[0:3]),
        sigma_v_m_s=_vector(sigmas[3:6]),
        sigma_yaw_rad=float(sigmas[6]),
        sighted_age_s=of.age_s(decision.at),
        consistent=of.consistent,
    )


def order(command: Command | None) -> CommandReport | None:
    """Return the report of the command that guidance sent to the vehicle."""
    match command:
        case Velocity():
            return CommandReport(kind="velocity", v_level_m_s=_vector(command.v_level), yaw_rate_rad_s=command.yaw_rate_rad_s)
        case Lean():
            forward, right = (command.a_level + command.trim_level).tolist()
            v = _vector(command.v_level)
            return CommandReport(
                kind="lean", v_level_m_s=v, yaw_rate_rad_s=command.yaw_rate_rad_s, lean_level_m_s2=(forward, right)
            )
        case Hover():
            return CommandReport(kind="hover")
        case TakeOff():
            return CommandReport(kind="takeoff")
        case Land():
            return CommandReport(kind="land")
        case CutMotors():
            return CommandReport(kind="cut_motors")
        case LeaveEmergency():
            return CommandReport(kind="leave_emergency")
        case None:
            return None


def sighting(session: str, processed: ProcessedFrame) -> SightingMessage:
    """Return the message for a frame and what each method detected in it."""
    detection = processed.detection
    return SightingMessage(
        session=session,
        at_ns=processed.done,
        measured_at_ns=processed.frame.stamp.measured_at,
        sequence=processed.frame.seq,
        verdict=processed.verdict.value,
        chosen=None if detection is None else detection.chosen,
        selected=None if detection is None else _found(detection.selected),
        methods={} if detection is None else {name: _found(one) for name, one in detection.methods.items()},
    )


def _found(of: Sighting | None) -> MethodReport | None:
    if of is None:
        return None
    return MethodReport(
        d_body_pad_level_m=_vector(of.d_body_pad_level),
        yaw_rad=of.yaw_rad,
        yaw_ambiguous=of.yaw_ambiguous,
        cov=tuple(float(c) for c in of.cov.flat),
        confidence=of.confidence,
    )


def fusion(session: str, at: MonoNs, states: Sequence[FusionState]) -> FusionMessage:
    """Return the message with the newest result of each source on each path."""
    paths: dict[str, dict[str, SourceReport]] = {}
    for state in states:
        paths.setdefault(state.path, {})[state.source] = _source(state)
    return FusionMessage(session=session, at_ns=at, paths=paths)


def _source(of: FusionState) -> SourceReport:
    newest = of.newest
    return SourceReport(
        measured_at_ns=newest.measured_at,
        verdict=newest.verdict.value,
        components=newest.components,
        innovation=_finite(newest.innovation),
        innovation_var=None if newest.innovation_cov is None else _finite(np.diag(newest.innovation_cov)),
        nis=newest.nis if math.isfinite(newest.nis) else None,
        test_ratio=newest.test_ratio if math.isfinite(newest.test_ratio) else None,
        nis_mean=of.nis_mean,
        verdicts=dict(of.verdicts),
    )


def _finite(of: F64 | None) -> tuple[float, ...] | None:
    """Return the numbers, or None if there are none or one of them is not finite."""
    return None if of is None or not np.all(np.isfinite(of)) else tuple(of.tolist())


def health(session: str, of: HealthSnapshot) -> HealthReport:
    """Return the report of a whole health snapshot."""
    return HealthReport(
        session=session,
        at_ns=of.at,
        all_up=of.all_up,
        flight_up=of.flight_up,
        parts={
            name: PartReport(up=p.up, age_s=p.age_s, restarts=p.restarts, last_error=p.last_error) for name, p in of.parts.items()
        },
        flows={name: FlowReport(count=f.count, age_s=f.age_s, rate_hz=f.rate_hz) for name, f in of.flows.items()},
        frames=dict(of.frames),
        inputs={kind: dict(tally) for kind, tally in of.inputs.items()},
        stages={name: StageReport(count=s.count, p50_s=s.p50_s, p99_s=s.p99_s) for name, s in of.stages.items()},
        counters={part: {k: v for k, v in counts.items() if math.isfinite(v)} for part, counts in of.counters.items()},
    )


def _vector(of: F64) -> Vector3:
    x, y, z = of.tolist()
    return x, y, z
