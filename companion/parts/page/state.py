"""What the page shows of the flight: the place of drone and deck, and the causes of what is wrong. Values in, values out."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from companion.base.health import HealthSnapshot
from companion.base.liveness import stuck
from companion.base.missing_inputs import missing_inputs
from companion.base.observer import Decision
from companion.parts.page.messages import HealthCause, Level, PageHealth, PlaceReport
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.time import MonoNs
from estimator.ekf import Forecast

HORIZONS_S = tuple(0.25 * k for k in range(13))
"""Instants at which the deck's height is shown ahead, s."""
_FLOWS = (("Frame", "camera"), ("Attitude", "attitude"), ("VehicleStatus", "status"))
_STAGES = (("look", "vision"), ("exposure_to_command", "exposure to command"), ("guidance_late", "guidance late"))


def place(belief: RelativeState, ahead: Forecast | None, now: MonoNs) -> PlaceReport:
    """Return the drone's place against the pad, in the pad's axes with z up."""
    yaw_rad = belief.yaw_rad or 0.0
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    turn = np.array([[c, -s], [s, c]])  # level to pad: the body's forward points to (cos yaw, sin yaw)
    x, y = (-(turn @ belief.d_body_pad_level[:2])).tolist()
    vx, vy = (-(turn @ belief.v_pad_level[:2])).tolist()
    cov = turn @ belief.cov[:2, :2] @ turn.T
    deck: tuple[tuple[float, float, float], ...] = ()
    if ahead is not None:
        rises = ahead.deck_height_m - ahead.deck_height_m[0]
        deck = tuple(zip(ahead.horizons_s.tolist(), _rounded(rises), _rounded(ahead.sigma_deck_height_m), strict=True))
    return PlaceReport(
        x_m=round(x, 4),
        y_m=round(y, 4),
        z_m=round(belief.height_m, 4),
        v_m_s=(round(vx, 3), round(vy, 3), round(float(belief.v_pad_level[2]), 3)),
        heading_known=belief.yaw_rad is not None,
        heading_rad=round(yaw_rad, 4),
        cov_m2=(float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])),
        sigma_z_m=round(math.sqrt(max(0.0, float(belief.cov[2, 2]))), 4),
        age_s=round(belief.age_s(now), 2),
        consistent=belief.consistent,
        deck_roll_rad=None if ahead is None else round(float(ahead.roll_rad[0]), 4),
        deck_pitch_rad=None if ahead is None else round(float(ahead.pitch_rad[0]), 4),
        deck_m=deck,
    )


def _rounded(values: np.ndarray) -> list[float]:
    return [round(value, 3) for value in values.tolist()]


def page_health(health: HealthSnapshot, decision: Decision | None, *, flying: bool) -> PageHealth:
    """Return what is wrong, the worst first, and the figures of the service."""
    rank: dict[Level, int] = {"fault": 0, "warning": 1, "info": 2}
    causes = sorted(_causes(health, decision, flying=flying), key=lambda cause: rank[cause.level])
    return PageHealth(causes=tuple(causes), figures=tuple(_figures(health)))


def _causes(health: HealthSnapshot, decision: Decision | None, *, flying: bool) -> Iterator[HealthCause]:
    why = stuck(health, flying)
    if why is not None:
        yield HealthCause(level="fault", text=why)
    for name, part in health.parts.items():
        if not part.up:
            level: Level = "fault" if part.vital else "warning"
            yield HealthCause(level=level, text=f"{name} is down: {part.last_error or 'not begun'}")
    for text in missing_inputs(health):
        yield HealthCause(level="fault" if flying else "warning", text=text)
    belief = None if decision is None else decision.belief
    for alert in () if belief is None else belief.alerts:
        yield HealthCause(level="warning", text=alert.value)
    if belief is not None and not belief.consistent and not belief.alerts:
        yield HealthCause(level="warning", text="the estimate of the pad contradicts itself")
    if decision is not None and decision.limit:
        yield HealthCause(level="warning", text=decision.limit)
    for name, count in health.counters.get("contained", {}).items():
        yield HealthCause(level="info", text=f"{name} failed {count:.0f} times; the flight goes on")


def _figures(health: HealthSnapshot) -> Iterator[tuple[str, str]]:
    for flow, name in _FLOWS:
        found = health.flows.get(flow)
        rate = None if found is None else found.rate_hz
        yield name, "none" if rate is None else f"{rate:.0f} Hz"
    for stage, name in _STAGES:
        times = health.stages.get(stage)
        if times is not None and times.p50_s is not None and times.p99_s is not None:
            yield name, f"{1000 * times.p50_s:.0f} ms, worst {1000 * times.p99_s:.0f}"
    frames = sum(health.frames.values())
    if frames:
        yield "frames used", f"{100 * health.frames.get(Verdict.FUSED.value, 0) / frames:.0f} % of {frames}"
