"""The sequential planner: fly the set point from where the drone is over the way points, then land.

Source: Sundvoll 2020, sec. 4.6 (0.4 m/s, slower within 1 m, (0, 0, 2) then (0, 0, 0.3), then land). Unlike there the next way
point is chosen when the drone is there, not the set point; and a pad that is lost from sight stops the descent.

What it does without sight: for `blind_s` fly level towards the way point by dead reckoning (the nose goes down to fly forward and
takes the pad out of a fixed camera's view), then hover; after `climb_after_s` climb to `safe_height_m`, since from higher up more
is in view; when the pad comes back, go on from where the drone then is, after a climb from the first way point again; after
`give_up_after_s`, or at the first way point after `rounds_max` such rounds, hover and leave it to the operator. It never sinks
and never begins to land without a fresh, consistent estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import Literal

import numpy as np

from companion.guidance.pid import SetPoint, fit_to_steer
from estimator.contracts.commands import Hover, Land, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.samples import _vector
from estimator.contracts.time import MonoNs, seconds_between

_DT_MAX_S = 0.2


class Phase(Enum):
    """What the planner is about."""

    WAITING = "waiting"
    """No estimate has come yet."""
    APPROACH = "approach"
    """On the way to a way point that is not the last."""
    DESCEND = "descend"
    """On the way to the last one."""
    LOST = "lost"
    """Hovering without sight."""
    BLIND = "by dead reckoning"
    """Flying level towards the way point without sight."""
    CLIMB = "climb"
    """Climbing without sight."""
    GAVE_UP = "gave up"
    """Hovering for good; a new planner is a new try."""
    LAND = "land"
    """The vehicle was told to land: this is decided once and not taken back."""


@dataclass(frozen=True, slots=True, eq=False)
class WayPoint:
    """A place against the pad, and how near is near enough."""

    d_body_pad_level: F64
    """(3,) m: (0, 0, 2) is two metres above the pad; (0.1, 0, 2) has the pad ten centimetres ahead of the nose."""
    reached_m: float
    """Horizontal distance of the drone."""
    reached_height_m: float
    dwell_s: float
    """It must stay that near for so long."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "d_body_pad_level", _vector("WayPoint.d_body_pad_level", self.d_body_pad_level, (3,)))
        if not (self.reached_m > 0.0 and self.reached_height_m > 0.0 and self.dwell_s >= 0.0):
            raise ValueError("reached_m and reached_height_m must be positive and dwell_s not negative")
        if not self.d_body_pad_level[2] > 0.0:
            raise ValueError(f"a way point must lie above the pad, got a height of {self.d_body_pad_level[2]} m")


@dataclass(frozen=True, slots=True)
class Plan:
    """Where to fly, and when to stop.

    Raises:
        ValueError: no way point, or a number out of its range.
    """

    way_points: tuple[WayPoint, ...]
    speed_m_s: float = 0.4
    slow_within_m: float = 1.0
    slow_least: float = 0.1
    """Of the speed, however near the way point."""
    lead_m: float = 0.8
    """The set point waits for a drone that is farther behind than this."""
    heading: Literal["keep", "align"] = "keep"
    """Turn until the nose points along the arrow, or leave the heading alone."""
    stale_after_s: float = 0.5
    """Age of the newest sighting beyond which the pad counts as lost."""
    blind_s: float = 4.0
    """After the last sight, how long dead reckoning may go on flying level towards the way point; 0 for hovering at once."""
    blind_sigma_m: float = 1.0
    """Horizontal 1-sigma of the estimate above which it hovers instead."""
    climb_after_s: float = 1.5
    climb_m_s: float = 0.3
    safe_height_m: float = 2.0
    give_up_after_s: float = 20.0
    rounds_max: int = 3
    touchdown_s: float = 0.6
    """The drone counts as near the last way point only if it will still be there after this at its present velocity."""
    sigma_land_m: float = 0.15
    """Horizontal 1-sigma of the estimate above which the drone does not land, however near it believes itself."""

    def __post_init__(self) -> None:
        if not self.way_points:
            raise ValueError("a plan needs at least one way point")
        for name in ("speed_m_s", "slow_within_m", "slow_least", "lead_m", "stale_after_s", "climb_m_s", "sigma_land_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive, got {value}")
        if not (self.blind_s >= 0.0 and self.blind_sigma_m > 0.0 and self.touchdown_s >= 0.0):
            raise ValueError("blind_s and touchdown_s must not be negative, and blind_sigma_m must be positive")
        if not 0.0 < self.climb_after_s < self.give_up_after_s:
            raise ValueError("0 < climb_after_s < give_up_after_s must hold")

    @staticmethod
    def over_the_pad(via_height_m: float = 2.0, final_height_m: float = 0.3, pad_ahead_m: float = 0.0) -> Plan:
        """The thesis' way points, straight above the pad; or with the pad a little ahead, for a camera mounted at the nose."""
        return Plan(
            (
                WayPoint(np.array([pad_ahead_m, 0.0, via_height_m]), reached_m=0.25, reached_height_m=0.25, dwell_s=0.3),
                WayPoint(np.array([pad_ahead_m, 0.0, final_height_m]), reached_m=0.12, reached_height_m=0.12, dwell_s=0.2),
            )
        )


@dataclass(frozen=True, slots=True, eq=False)
class Planner:
    """The planner's memory."""

    leg: int = 0
    """Index of the way point it flies to."""
    point: F64 | None = None
    """(3,) m, the set point, `d_body_pad_level`; None before the first estimate and after the pad was lost."""
    yaw_rad: float | None = None
    """The body's heading that `point` was last written for."""
    near_since: MonoNs | None = None
    last: MonoNs | None = None
    seen: MonoNs | None = None
    """When there last was an estimate to steer by."""
    seen_height_m: float = math.inf
    climbed: bool = False
    """It has climbed since the pad was last seen."""
    rounds: int = 0
    """How often it began anew after a climb."""
    landing: bool = False
    gave_up: bool = False

    @staticmethod
    def start() -> Planner:
        return Planner()


Aim = SetPoint | Velocity | Hover | Land
"""What the planner asks for: a set point for the position controller, or a command as it stands. `Velocity` never sinks."""


def planner_step(state: Planner, plan: Plan, now: MonoNs, estimate: RelativeState | None) -> tuple[Planner, Aim, Phase]:
    """One turn. Once it has answered `Land` it answers nothing else, so repeating the answer is harmless."""
    if state.landing:
        return state, Land(), Phase.LAND
    if state.gave_up:
        return state, Hover(), Phase.GAVE_UP
    if estimate is None or not fit_to_steer(estimate, now, plan.stale_after_s):
        return _without_sight(state, plan, now, estimate)

    if state.climbed:
        state = replace(state, climbed=False, rounds=state.rounds + 1, leg=0)
        if state.rounds > plan.rounds_max and len(plan.way_points) == 1:
            return replace(state, gave_up=True), Hover(), Phase.GAVE_UP
    dt = 0.0 if state.last is None else min(max(0.0, seconds_between(state.last, now)), _DT_MAX_S)
    drone = estimate.d_body_pad_level
    goal = plan.way_points[state.leg]
    point = drone if state.point is None else _turned_with_the_body(state, estimate)
    point, v_body_level = _flown_on(point, drone, goal.d_body_pad_level, plan, dt)
    state = replace(state, point=point, yaw_rad=estimate.yaw_rad, last=now, seen=now, seen_height_m=estimate.height_m)

    off = drone - goal.d_body_pad_level
    near = math.hypot(off[0], off[1]) <= goal.reached_m and abs(off[2]) <= goal.reached_height_m
    last_leg = state.leg == len(plan.way_points) - 1
    if near and last_leg:
        then = off + plan.touchdown_s * estimate.v_pad_level
        near = math.hypot(then[0], then[1]) <= goal.reached_m and _sigma_m(estimate) <= plan.sigma_land_m
    since = (now if state.near_since is None else state.near_since) if near else None
    state = replace(state, near_since=since)
    if since is not None and seconds_between(since, now) >= goal.dwell_s:
        if state.rounds > plan.rounds_max:
            return replace(state, gave_up=True), Hover(), Phase.GAVE_UP
        if last_leg:
            return replace(state, landing=True), Land(), Phase.LAND
        state = replace(state, leg=state.leg + 1, near_since=None)
        last_leg = state.leg == len(plan.way_points) - 1
    aim = SetPoint(point, 0.0 if plan.heading == "align" else None, v_body_level)
    return state, aim, Phase.DESCEND if last_leg else Phase.APPROACH


def _without_sight(state: Planner, plan: Plan, now: MonoNs, estimate: RelativeState | None) -> tuple[Planner, Aim, Phase]:
    if state.seen is None:
        return replace(state, last=now), Hover(), Phase.WAITING
    lost_s = seconds_between(state.seen, now)
    state = replace(state, point=None, near_since=None, last=now)
    if lost_s > plan.give_up_after_s:
        return replace(state, gave_up=True), Hover(), Phase.GAVE_UP
    v = np.zeros(3)
    if lost_s <= plan.blind_s and estimate is not None and _fit_to_fly_level(estimate, plan, now):
        off = estimate.d_body_pad_level[:2] - plan.way_points[state.leg].d_body_pad_level[:2]
        v[:2] = off * min(plan.speed_m_s / plan.slow_within_m, plan.speed_m_s / max(1e-9, math.hypot(off[0], off[1])))
    climb_s = max(0.0, plan.safe_height_m - state.seen_height_m) / plan.climb_m_s
    if plan.climb_after_s < lost_s <= plan.climb_after_s + climb_s:
        v[2] = -plan.climb_m_s
        return replace(state, climbed=True), Velocity(v, 0.0), Phase.CLIMB
    if np.any(v != 0.0):
        return state, Velocity(v, 0.0), Phase.BLIND
    return state, Hover(), Phase.LOST


def _fit_to_fly_level(estimate: RelativeState, plan: Plan, now: MonoNs) -> bool:
    """Whether an estimate without sight still tells where the pad is, roughly."""
    computed_s = abs(seconds_between(estimate.at, now))
    return estimate.consistent and computed_s <= plan.stale_after_s and _sigma_m(estimate) <= plan.blind_sigma_m


def _sigma_m(estimate: RelativeState) -> float:
    """Largest horizontal 1-sigma."""
    return math.sqrt(float(np.linalg.eigvalsh(estimate.cov[:2, :2])[-1]))


def _turned_with_the_body(state: Planner, estimate: RelativeState) -> F64:
    """The set point in today's level axes: it keeps its place against the pad while the body turns."""
    assert state.point is not None
    if state.yaw_rad is None or estimate.yaw_rad is None:
        return state.point
    turned = wrap_pi(estimate.yaw_rad - state.yaw_rad)
    c, s = math.cos(turned), math.sin(turned)
    x, y, z = state.point
    return np.array([c * x + s * y, -s * x + c * y, z])


def _flown_on(point: F64, drone: F64, goal: F64, plan: Plan, dt: float) -> tuple[F64, F64]:
    """The set point `dt` later on its straight line to the goal, and the velocity (of the body, in level) it moves with."""
    to_go = goal - point
    distance_m = float(np.linalg.norm(to_go))
    if distance_m < 1e-6 or float(np.linalg.norm(point - drone)) > plan.lead_m:
        return (goal if distance_m < 1e-6 else point), np.zeros(3)
    speed = plan.speed_m_s * max(min(1.0, distance_m / plan.slow_within_m), plan.slow_least)
    direction = to_go / distance_m
    if speed * dt >= distance_m:
        return goal, np.zeros(3)
    return point + direction * (speed * dt), -direction * speed
