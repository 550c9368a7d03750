"""The sequential planner: move the set point from the drone's position over the way points, then land.

Source: Sundvoll 2020, sec. 4.6 (0.4 m/s, slower within 1 m, (0, 0, 2) then (0, 0, 0.3), then land). Unlike there, the next way
point is chosen when the drone has arrived, not the set point, and losing sight of the pad stops the descent.

Without sight the drone flies level towards the way point for `blind_s` by dead reckoning (the nose goes down to fly forward and
takes the pad out of a fixed camera's view), then hovers; after `climb_after_s` it goes around.

A go-around ends a try: climb to `safe_height_m`, over the pad where it is seen, then begin with the first way point again. It is
made when the pad stays lost low, when the try's budget is used up (`budget.Spent`), and when an ordered landing does not end in
one (`lease.Lease`). After `go_arounds_max` of them, or `give_up_after_s` without sight, it hovers and leaves it to the operator.

A pad that is suddenly seen where no motion explains it (`RelativeState.track` counts up) is another pad: climb, and wait for the
operator, or as `PlannerOptions.another_pad` says. It never descends and never begins to land without a fresh, consistent
estimate of the pad that this approach was begun with.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from companion.guidance.budget import Spent
from companion.guidance.lease import Lease, renewed
from companion.guidance.pid import SetPoint, fit_to_steer
from companion.guidance.plan import Plan
from estimator.contracts.commands import Hover, Land, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, seconds_between

_DT_MAX_S = 0.2
_NEAR_SAFE_M = 0.25
"""A height at most this far below the safe height counts as the safe height, metres."""
_CLIMB_PATIENCE, _CLIMB_PATIENCE_S = 3.0, 10.0
"""A go-around that takes this many times the expected time plus this many seconds is not climbing."""


class Phase(Enum):
    """The planner's phase."""

    WAITING = "waiting"
    """No estimate has come yet."""
    APPROACH = "approach"
    """Flying to a way point that is not the last."""
    DESCEND = "descend"
    """Flying to the last way point."""
    LOST = "lost"
    """Hovering without sight."""
    BLIND = "by dead reckoning"
    """Flying level towards the way point without sight."""
    CLIMB = "climb"
    """Climbing without sight."""
    GO_AROUND = "go-around"
    """Climbing over the pad, to begin again."""
    ANOTHER_PAD = "another pad"
    """The pad is seen at a place that no motion explains: climbing, then hovering until the operator begins again."""
    GAVE_UP = "gave up"
    """Hovering for good; a new planner begins a new try."""
    LAND = "land"
    """Commanding the vehicle to land, in every guidance cycle for as long as time, height and sight allow it."""


@dataclass(frozen=True, slots=True)
class GoAround:
    """A climb that ends a try."""

    since: MonoNs
    from_height_m: float


@dataclass(frozen=True, slots=True)
class Question:
    """An open question to the operator: another pad was seen."""

    since: MonoNs
    from_height_m: float
    """Height over the earlier pad when that was last seen, metres."""
    track: int
    """Number of the newest track."""
    steady_since: MonoNs | None = None
    """Time since which this track alone has been in unbroken sight; None while it is not."""


@dataclass(frozen=True, slots=True, eq=False)
class Planner:
    """The planner's memory."""

    leg: int = 0
    """Index of the way point that the drone flies to."""
    point: F64 | None = None
    """The set point `d_body_pad_level`, (3,) m; None before the first estimate and after the pad was lost."""
    yaw_rad: float | None = None
    """The body's heading at the last update of `point`, rad."""
    near_since: MonoNs | None = None
    last: MonoNs | None = None
    since_last_s: float = 0.0
    seen: MonoNs | None = None
    """Time of the last estimate that was fit to steer by."""
    sighted_height_m: float = math.inf
    in_sight: bool = False
    """Whether the pad was in sight in the previous guidance cycle."""
    track: int | None = None
    """Track of the pad that this approach flies to."""
    spent: Spent = field(default_factory=Spent)
    go_arounds: int = 0
    questions: int = 0
    going_around: GoAround | None = None
    question: Question | None = None
    landing: Lease | None = None
    gave_up: bool = False
    reason: str = ""
    """Why the planner last went around, asked or gave up, as text for the operator."""

    @staticmethod
    def start() -> Planner:
        return Planner()


Aim = SetPoint | Velocity | Hover | Land
"""The planner's output: a set point for the position controller, or a finished command. `Velocity` never descends."""


def planner_step(state: Planner, plan: Plan, now: MonoNs, estimate: RelativeState | None) -> tuple[Planner, Aim, Phase]:
    """Run one guidance cycle; return the new state, the aim and the phase."""
    if state.gave_up:
        return state, Hover(), Phase.GAVE_UP
    since_last_s = 0.0 if state.last is None else max(0.0, seconds_between(state.last, now))
    state = replace(state, since_last_s=since_last_s, last=now)
    if estimate is not None and state.track is not None and estimate.track != state.track and state.question is None:
        state = _asked(state, now, estimate.track)
    fit = estimate if estimate is not None and fit_to_steer(estimate, now, plan.guidance.stale_after_s) else None
    if state.question is not None:
        return _questioned(state, state.question, plan, now, fit)
    state = _accounted(state, plan, now, fit)
    if state.landing is not None:
        lease, over = renewed(state.landing, plan, now, estimate, fit)
        if over is None:
            return replace(state, landing=lease), Land(), Phase.LAND
        state = _around(state, now, over)
    if state.going_around is None and (used_up := state.spent.exhausted(plan, now)) is not None:
        state = _around(state, now, used_up)
    if state.going_around is not None:
        return _going_around(state, state.going_around, plan, now, estimate, fit)
    return _without_sight(state, plan, now, estimate) if fit is None else _with_sight(state, plan, now, fit)


def _accounted(state: Planner, plan: Plan, now: MonoNs, fit: RelativeState | None) -> Planner:
    """Charge the guidance cycle to the try's budget."""
    spent, last_leg = state.spent, state.leg == len(plan.way_points) - 1
    if fit is None:
        if state.in_sight and (last_leg or state.sighted_height_m < plan.options.safe_height_m - _NEAR_SAFE_M):
            spent = spent.lost()
        if state.seen is not None:
            spent = spent.unseen(state.since_last_s)
        return replace(state, spent=spent, in_sight=False)
    if not state.in_sight and state.seen is not None:
        spent = spent.descended(state.sighted_height_m - fit.height_m)
    spent = spent.seen(now, state.since_last_s)
    return replace(state, spent=spent, in_sight=True, seen=now, sighted_height_m=fit.height_m)


def _with_sight(state: Planner, plan: Plan, now: MonoNs, estimate: RelativeState) -> tuple[Planner, Aim, Phase]:
    goal = plan.way_points[state.leg]
    drone = estimate.d_body_pad_level
    state, v_body_level = _towards(state, goal.d_body_pad_level, plan, estimate)
    assert state.point is not None
    point = state.point
    off = drone - goal.d_body_pad_level
    near = math.hypot(off[0], off[1]) <= goal.reached_m and abs(off[2]) <= goal.reached_height_m
    last_leg = state.leg == len(plan.way_points) - 1
    if near and last_leg:
        then = off + plan.options.touchdown_s * estimate.v_pad_level
        near = math.hypot(then[0], then[1]) <= goal.reached_m and _sigma_m(estimate) <= plan.options.sigma_land_m
    since = (now if state.near_since is None else state.near_since) if near else None
    state = replace(state, near_since=since, track=estimate.track)
    if since is not None and seconds_between(since, now) >= goal.dwell_s:
        if last_leg:
            return replace(state, landing=Lease.begin(now, estimate)), Land(), Phase.LAND
        state = replace(state, leg=state.leg + 1, near_since=None)
        last_leg = state.leg == len(plan.way_points) - 1
    if last_leg:
        state = replace(state, spent=state.spent.descends(now))
    aim = SetPoint(point, 0.0 if plan.options.heading == "align" else None, v_body_level)
    return state, aim, Phase.DESCEND if last_leg else Phase.APPROACH


def _without_sight(state: Planner, plan: Plan, now: MonoNs, estimate: RelativeState | None) -> tuple[Planner, Aim, Phase]:
    state = replace(state, point=None, near_since=None)
    if state.seen is None:
        return state, Hover(), Phase.WAITING
    lost_s, over = seconds_between(state.seen, now), state.spent.without_sight_s > plan.options.give_up_after_s
    low = state.sighted_height_m < plan.options.safe_height_m
    if over and not low:
        return _given_up(state, state.reason or "the pad was not found again")
    if low and (over or lost_s > plan.options.climb_after_s):
        state = _around(state, now, f"the pad was lost at {state.sighted_height_m:.1f} m")
        assert state.going_around is not None
        return _going_around(state, state.going_around, plan, now, estimate, None)
    v = _level_velocity(state, plan, now, estimate)
    if np.any(v != 0.0):
        return state, Velocity(v, 0.0), Phase.BLIND
    return state, Hover(), Phase.LOST


def _around(state: Planner, now: MonoNs, why: str) -> Planner:
    """End the try and begin a go-around."""
    climb = GoAround(now, state.sighted_height_m)
    return replace(
        state, landing=None, point=None, near_since=None, leg=0, going_around=climb, go_arounds=state.go_arounds + 1, reason=why
    )


def _going_around(
    state: Planner, climb: GoAround, plan: Plan, now: MonoNs, estimate: RelativeState | None, fit: RelativeState | None
) -> tuple[Planner, Aim, Phase]:
    expected_s = max(0.0, plan.options.safe_height_m - climb.from_height_m) / plan.options.climb_m_s
    if seconds_between(climb.since, now) > _CLIMB_PATIENCE * expected_s + _CLIMB_PATIENCE_S:
        return _given_up(state, f"{state.reason}, and it did not climb")
    if fit is not None:
        if fit.height_m >= plan.options.safe_height_m - _NEAR_SAFE_M:
            if state.go_arounds > plan.options.go_arounds_max:
                return _given_up(state, state.reason)
            state = replace(state, going_around=None, spent=Spent().seen(now, 0.0), point=None)
            return _with_sight(state, plan, now, fit)
        over = np.append(plan.way_points[0].d_body_pad_level[:2], plan.options.safe_height_m)
        state, v_body_level = _towards(state, over, plan, fit)
        assert state.point is not None
        return state, SetPoint(state.point, None, v_body_level), Phase.GO_AROUND
    state = replace(state, point=None)
    blind_since = max(climb.since, state.seen or climb.since)
    if seconds_between(blind_since, now) * plan.options.climb_m_s < plan.options.safe_height_m - state.sighted_height_m:
        v = _level_velocity(state, plan, now, estimate)
        v[2] = -plan.options.climb_m_s
        return state, Velocity(v, 0.0), Phase.CLIMB
    if state.go_arounds > plan.options.go_arounds_max:
        return _given_up(state, state.reason)
    without_s = state.spent.without_sight_s
    state = replace(
        state, going_around=None, spent=replace(Spent(), without_sight_s=without_s), sighted_height_m=plan.options.safe_height_m
    )
    return state, Hover(), Phase.LOST


def _asked(state: Planner, now: MonoNs, track: int) -> Planner:
    question = Question(now, state.sighted_height_m, track)
    return replace(
        state, landing=None, going_around=None, point=None, near_since=None, leg=0, question=question, in_sight=False,
        questions=state.questions + 1, reason="the pad is seen in another place, which no motion explains",
    )  # fmt: skip


def _questioned(
    state: Planner, question: Question, plan: Plan, now: MonoNs, fit: RelativeState | None
) -> tuple[Planner, Aim, Phase]:
    climbed_m = seconds_between(question.since, now) * plan.options.climb_m_s
    climbing = climbed_m < plan.options.safe_height_m - question.from_height_m
    track = question.track if fit is None else fit.track
    steady = None
    if fit is not None and track == question.track:
        steady = now if question.steady_since is None else question.steady_since
    state = replace(state, question=replace(question, track=track, steady_since=steady))
    if fit is not None and steady is not None and not climbing and _may_decide(state, question, plan, fit):
        held_s = seconds_between(steady, now)
        if held_s >= plan.options.another_pad_s:
            new = Planner(last=now, questions=state.questions, go_arounds=state.go_arounds, reason=state.reason)
            return _with_sight(_accounted(new, plan, now, fit), plan, now, fit)
    if seconds_between(question.since, now) > plan.options.operator_wait_s:
        return _given_up(state, f"{state.reason}, and nobody said to go on")
    if climbing:
        return state, Velocity(np.array([0.0, 0.0, -plan.options.climb_m_s]), 0.0), Phase.ANOTHER_PAD
    return state, Hover(), Phase.ANOTHER_PAD


def _may_decide(state: Planner, question: Question, plan: Plan, fit: RelativeState) -> bool:
    """Return whether no person has to agree: this is the first question, and the drone was and is not below the safe height."""
    if plan.options.another_pad != "automatic" or state.questions > 1:
        return False
    return min(question.from_height_m, fit.height_m) >= plan.options.safe_height_m - _NEAR_SAFE_M


def _given_up(state: Planner, why: str) -> tuple[Planner, Aim, Phase]:
    return replace(state, gave_up=True, reason=why), Hover(), Phase.GAVE_UP


def _towards(state: Planner, goal: F64, plan: Plan, estimate: RelativeState) -> tuple[Planner, F64]:
    """Move the set point towards a goal; return the new state and the body velocity of that motion in level axes, (3,) m/s."""
    previous = state.point
    dt = min(state.since_last_s, _DT_MAX_S)
    point = estimate.d_body_pad_level if previous is None else _turned_with_the_body(previous, state.yaw_rad, estimate)
    point, v_body_level = _flown_on(point, estimate.d_body_pad_level, goal, plan, dt)
    return replace(state, point=point, yaw_rad=estimate.yaw_rad), v_body_level


def _level_velocity(state: Planner, plan: Plan, now: MonoNs, estimate: RelativeState | None) -> F64:
    """Return a level velocity towards the way point, (3,) m/s, while dead reckoning locates it; zeros after that."""
    v = np.zeros(3)
    if state.seen is None or estimate is None or seconds_between(state.seen, now) > plan.options.blind_s:
        return v
    computed_s = abs(seconds_between(estimate.at, now))
    if not estimate.consistent or computed_s > plan.guidance.stale_after_s or _sigma_m(estimate) > plan.options.blind_sigma_m:
        return v
    off = estimate.d_body_pad_level[:2] - plan.way_points[state.leg].d_body_pad_level[:2]
    v[:2] = off * plan.options.speed_m_s / max(plan.options.slow_radius_m, math.hypot(off[0], off[1]))
    return v


def _sigma_m(estimate: RelativeState) -> float:
    """Return the largest horizontal 1-sigma, metres."""
    return math.sqrt(float(np.linalg.eigvalsh(estimate.cov[:2, :2]).max()))


def _turned_with_the_body(point: F64, yaw_rad: float | None, estimate: RelativeState) -> F64:
    """Return the set point in the present level axes, so that it keeps its position relative to the pad while the body turns."""
    if yaw_rad is None or estimate.yaw_rad is None:
        return point
    turned = wrap_pi(estimate.yaw_rad - yaw_rad)
    c, s = math.cos(turned), math.sin(turned)
    x, y, z = point
    return np.array([c * x + s * y, -s * x + c * y, z])


def _flown_on(point: F64, drone: F64, goal: F64, plan: Plan, dt: float) -> tuple[F64, F64]:
    """Return the set point `dt` seconds later on its straight line to the goal, and the body velocity of that motion."""
    to_go = goal - point
    distance_m = float(np.linalg.norm(to_go))
    if float(np.linalg.norm(point - drone)) > plan.options.lead_m:
        return point, np.zeros(3)
    speed = plan.options.speed_m_s * max(min(1.0, distance_m / plan.options.slow_radius_m), plan.options.slow_floor)
    if speed * dt >= distance_m:
        return goal, np.zeros(3)
    direction = to_go / distance_m
    return point + direction * (speed * dt), -direction * speed
