import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guidance.options import PidOptions
from companion.guidance.pid import Pid, SetPoint, fit_to_steer, pid_step
from companion.guidance.plan import Plan, WayPoint
from companion.guidance.planner import Phase, Planner, planner_step
from estimator.contracts.commands import Hover, Land, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.time import MonoNs
from tests.companion.plans import changed

DT = 0.05


def ns(seconds: float) -> MonoNs:
    return MonoNs(round(seconds * 1e9))


def estimate(t, d, v=(0, 0, 0), yaw=0.0, age=0.0, consistent=True, sigma=0.01, track=1):
    cov = sigma**2 * np.eye(7)
    return RelativeState(ns(t), "ekf", np.array(d, float), np.array(v, float), yaw, cov, ns(t - age), consistent, track=track)


def fly(d0, plan, seconds, sight=lambda t, d: True, yaw_rate=0.0, pad_v=(0.0, 0.0, 0.0), track=lambda t: 1, lands=True):
    """Fly planner, controller and a vehicle with 0.3 s lag; return rows of (t, d, aim, phase).

    Told to land it descends at 0.4 m/s; the flight ends there if it `lands`, else it never says that it stands. Without sight the
    estimate is reckoned on.
    """
    planner, pid, d, v, yaw = Planner.start(), Pid.start(), np.array(d0, float), np.zeros(3), 0.0
    rows, seen, seen_at = [], None, 0.0
    for i in range(round(seconds / DT)):
        t = i * DT
        if sight(t, d):
            seen = estimate(t, d, np.array(pad_v) - v, yaw, track=track(t))
            seen_at = t
        elif seen is not None:
            seen = estimate(t, d, np.array(pad_v) - v, yaw, age=t - seen_at, track=track(t), sigma=2.0)
        planner, aim, phase = planner_step(planner, plan, ns(t), seen)
        rows.append((t, d.copy(), aim, phase))
        command: object = aim
        if isinstance(aim, SetPoint):
            pid, command = pid_step(pid, PidOptions(), ns(t), seen, aim, 0.5)
        if isinstance(command, Land) and lands:
            break
        wanted = command.v_level if isinstance(command, Velocity) else np.zeros(3)
        if isinstance(command, Land):
            wanted = np.array([0.0, 0.0, 0.4])
        v = v + (wanted - v) * DT / 0.3
        turn = yaw_rate * DT
        c, s = math.cos(turn), math.sin(turn)
        d = d + (np.array(pad_v) - v) * DT
        d = np.array([c * d[0] + s * d[1], -s * d[0] + c * d[1], d[2]])
        yaw = wrap_pi(yaw + turn)
    return rows


def test_flies_over_the_pad_then_down_then_lands_once():
    rows = fly([3.0, 1.0, 5.0], Plan.over_the_pad(), 60)
    phases = [p for i, (*_, p) in enumerate(rows) if i == 0 or rows[i - 1][3] != p]
    assert phases == [Phase.APPROACH, Phase.DESCEND, Phase.LAND]
    assert sum(isinstance(aim, Land) for *_, aim, _ in rows) == 1
    t, d, *_ = rows[-1]
    assert t < 40
    assert math.hypot(d[0], d[1]) <= 0.12
    assert abs(d[2] - 0.3) <= 0.12
    over = next(d for _, d, _, p in rows if p is Phase.DESCEND)
    assert math.hypot(over[0], over[1]) <= 0.25
    assert abs(over[2] - 2.0) <= 0.25


def test_the_set_point_flies_at_04_and_slows_down_within_a_metre():
    plan, planner = Plan.over_the_pad(), Planner.start()
    d, points = np.array([0.0, 0.0, 4.0]), []
    for i in range(400):
        planner, aim, _ = planner_step(planner, plan, ns(i * DT), estimate(i * DT, d))
        if planner.leg:
            break
        points.append(aim.d_body_pad_level)
        assert aim.v_body_level[2] >= 0
        d = aim.d_body_pad_level
    heights = np.array(points)[:, 2]
    speeds = -np.diff(heights) / DT
    to_go = heights[:-1] - 2.0
    np.testing.assert_allclose(speeds[to_go > 1.0], 0.4, rtol=1e-6)
    slow = (to_go < 1.0) & (to_go > 0.21)
    np.testing.assert_allclose(speeds[slow], 0.4 * to_go[slow], rtol=1e-6)


def test_the_next_way_point_waits_for_the_drone_not_for_the_set_point():
    planner, plan = Planner.start(), Plan.over_the_pad()
    for i in range(2000):
        planner, aim, phase = planner_step(planner, plan, ns(i * DT), estimate(i * DT, [0.7, 0.0, 2.0]))
    assert phase is Phase.APPROACH
    np.testing.assert_allclose(aim.d_body_pad_level, [0, 0, 2.0], atol=1e-6)


def test_passing_through_is_not_staying():
    planner, plan = Planner.start(), Plan((WayPoint(np.array([0.0, 0, 2.0]), 0.1, 0.1, dwell_s=0.5),))
    for i in range(200):
        d = [0.0 if i % 5 else 1.0, 0.0, 2.0]
        planner, aim, _ = planner_step(planner, plan, ns(i * 0.05), estimate(i * 0.05, d))
        assert not isinstance(aim, Land)


def test_way_points_that_coincide_and_a_drone_already_there():
    point = WayPoint(np.array([0.0, 0.0, 2.0]), 0.1, 0.1, 0.0)
    planner, plan = Planner.start(), Plan((point, point, point))
    aims = []
    for i in range(5):
        planner, aim, _ = planner_step(planner, plan, ns(i * DT), estimate(i * DT, [0, 0, 2.0]))
        aims.append(aim)
    assert isinstance(aims[2], Land)
    assert all(np.all(np.isfinite(a.d_body_pad_level)) for a in aims[:2])


def test_no_landing_on_an_estimate_that_is_not_sure_of_itself():
    planner, plan = Planner.start(), Plan((WayPoint(np.array([0.0, 0.0, 0.3]), 0.1, 0.1, 0.0),))
    for i in range(100):
        planner, aim, _ = planner_step(planner, plan, ns(i * DT), estimate(i * DT, [0, 0, 0.3], sigma=0.3))
        assert not isinstance(aim, Land)
    _, aim, _ = planner_step(planner, plan, ns(100 * DT), estimate(100 * DT, [0, 0, 0.3], sigma=0.05))
    assert isinstance(aim, Land)


def test_a_pad_lost_for_a_moment_stops_the_descent_and_it_goes_on_from_where_the_drone_is():
    rows = fly([0.0, 0.0, 3.0], Plan.over_the_pad(), 60, sight=lambda t, d: not 8.0 < t < 9.5)
    phases = [p for i, (*_, p) in enumerate(rows) if i == 0 or rows[i - 1][3] != p]
    assert Phase.LOST in phases
    assert phases[-1] is Phase.LAND
    back = next(i for i, (t, *_) in enumerate(rows) if t > 9.5)
    assert np.linalg.norm(rows[back][2].d_body_pad_level - rows[back][1]) < 0.05


def test_a_pad_lost_low_is_sought_from_higher_up_and_found():
    """Sight fails below 1 m until the drone has been above 1.5 m again."""
    state = {"blind": False, "done": False}

    def sight(t, d):
        if d[2] < 1.0 and not state["done"]:
            state["blind"] = True
        if d[2] > 1.5 and state["blind"]:
            state["blind"], state["done"] = False, True
        return not state["blind"]

    rows = fly([0.0, 0.0, 3.0], Plan.over_the_pad(), 90, sight)
    seen = {p for *_, p in rows}
    assert {Phase.LOST, Phase.CLIMB, Phase.LAND} <= seen


def test_a_pad_lost_for_good_is_given_up_at_a_safe_height():
    rows = fly([0.0, 0.0, 1.0], Plan.over_the_pad(), 60, sight=lambda t, d: t < 2.0)
    assert rows[-1][3] is Phase.GAVE_UP
    assert isinstance(rows[-1][2], Hover)
    assert rows[-1][1][2] == pytest.approx(2.0, abs=0.4)
    planner, aim, phase = planner_step(Planner(gave_up=True), Plan.over_the_pad(), ns(99), estimate(99, [0, 0, 0.3]))
    assert isinstance(aim, Hover)
    assert phase is Phase.GAVE_UP
    assert planner.gave_up


def test_a_pad_never_seen_from_near_is_not_tried_for_ever():
    rows = fly([0.0, 0.0, 3.0], Plan.over_the_pad(), 200, sight=lambda t, d: d[2] > 1.0)
    phases = [p for i, (*_, p) in enumerate(rows) if i == 0 or rows[i - 1][3] != p]
    assert phases.count(Phase.CLIMB) == Plan.over_the_pad().options.go_arounds_max + 1
    assert phases[-1] is Phase.GAVE_UP
    assert rows[-1][1][2] == pytest.approx(2.0, abs=0.25)


def test_waits_on_the_ground_of_nothing_known():
    planner = Planner.start()
    for i in range(1000):
        planner, aim, phase = planner_step(planner, Plan.over_the_pad(), ns(i * DT), None)
        assert isinstance(aim, Hover)
        assert phase is Phase.WAITING


def test_a_turning_drone_keeps_to_the_line_over_the_pad():
    rows = fly([3.0, 0.0, 3.0], Plan.over_the_pad(), 60, yaw_rate=0.3)
    assert rows[-1][3] is Phase.LAND
    for _, d, aim, _ in rows[:-1]:
        assert np.linalg.norm(aim.d_body_pad_level - d) < 0.9


def test_heading_is_kept_or_aligned():
    for heading, want in (("keep", None), ("align", 0.0)):
        plan = changed(Plan.over_the_pad(), heading=heading)
        _, aim, _ = planner_step(Planner.start(), plan, ns(0), estimate(0, [1, 1, 4], yaw=1.0))
        assert aim.yaw_rad == want


def phases_of(rows):
    return [p for i, (*_, p) in enumerate(rows) if i == 0 or rows[i - 1][3] != p]


def test_a_landing_that_is_not_reported_is_taken_back_and_after_the_last_try_it_hovers_high_up():
    """The vehicle sinks and never says that it stands; the pad is out of view below 0.25 m."""
    plan = Plan.over_the_pad()
    rows = fly([0.0, 0.0, 2.5], plan, 300, sight=lambda t, d: d[2] > 0.25, lands=False)
    phases = phases_of(rows)
    assert phases.count(Phase.LAND) == plan.options.go_arounds_max + 1
    lands = [t for t, _, aim, _ in rows if isinstance(aim, Land)]
    longest = begun = 0.0
    for i, t in enumerate(lands):
        begun = t if i == 0 or t - lands[i - 1] > 2 * DT else begun
        longest = max(longest, t - begun)
    assert longest <= plan.guidance.land_timeout_s + 2 * DT
    assert phases[-1] is Phase.GAVE_UP
    assert min(d[2] for _, d, *_ in rows) > -1.0
    assert rows[-1][1][2] == pytest.approx(plan.options.safe_height_m, abs=0.3)


@pytest.mark.parametrize(
    ("of", "why"),
    [
        (lambda t: estimate(t, [0.9, 0, 0.3]), "drifted off"),
        (lambda t: estimate(t, [0, 0, 1.0]), "rose"),
        (lambda t: estimate(t, [0, 0, 0.3], track=2), "another place"),
    ],
)
def test_a_landing_ends_when_sight_or_height_say_so(of, why):
    planner, plan = Planner.start(), Plan((WayPoint(np.array([0.0, 0.0, 0.3]), 0.1, 0.1, 0.0),))
    planner, aim, _ = planner_step(planner, plan, ns(0.0), estimate(0.0, [0, 0, 0.3]))
    assert isinstance(aim, Land)
    for i in range(1, 5):
        planner, aim, phase = planner_step(planner, plan, ns(i * DT), estimate(i * DT, [0, 0, 0.3]))
        assert (aim, phase) == (Land(), Phase.LAND)
    planner, aim, phase = planner_step(planner, plan, ns(5 * DT), of(5 * DT))
    assert not isinstance(aim, Land)
    assert phase is not Phase.LAND
    assert why in planner.reason


def test_a_landing_from_high_up_ends_when_the_pad_is_lost_and_one_from_low_down_does_not():
    for height, goes_on in ((0.3, True), (1.5, False)):
        planner, plan = Planner.start(), Plan((WayPoint(np.array([0.0, 0.0, height]), 0.1, 0.1, 0.0),))
        planner, aim, _ = planner_step(planner, plan, ns(0.0), estimate(0.0, [0, 0, height]))
        if not goes_on:
            assert planner.landing is not None
            planner = replace(planner, landing=replace(planner.landing, height_m=height + 1.0))
        for i in range(1, 20):
            planner, aim, _ = planner_step(planner, plan, ns(i * DT), None)
        assert isinstance(aim, Land) == goes_on


def test_losses_that_come_and_go_end_in_a_go_around_and_the_tries_are_bounded():
    """A look every two seconds below 1.2 m: timers since the last sight alone would start again at each."""
    plan = Plan.over_the_pad()
    rows = fly([0.0, 0.0, 2.2], plan, 400, sight=lambda t, d: d[2] > 1.2 or (t % 2.0) < 0.1)
    phases = phases_of(rows)
    assert phases.count(Phase.GO_AROUND) + phases.count(Phase.CLIMB) >= plan.options.go_arounds_max
    assert phases[-1] is Phase.GAVE_UP
    assert rows[-1][1][2] > 1.2


def test_hovering_low_for_ever_ends_in_a_go_around():
    """Held 0.4 m aside at 0.19 m it can neither land nor is anything lost."""
    plan, planner, t, seen = Plan.over_the_pad(), Planner.start(), 0.0, []
    for d in ([0, 0, 2.0], [0.4, 0, 0.5]):
        for _ in range(round((plan.options.descend_s + 5.0) / 0.1) if d[0] else 20):
            t += 0.1
            planner, _, phase = planner_step(planner, plan, ns(t), estimate(t, d))
            seen.append(phase)
    assert Phase.GO_AROUND in seen
    assert "of descent" in planner.reason


def test_height_lost_without_sight_ends_the_try():
    plan, planner = Plan.over_the_pad(), Planner.start()
    t, height = 0.0, 1.9
    while t < 20 and planner.going_around is None:
        t += 0.1
        blind = (t % 1.0) < 0.5
        height -= 0.02 if blind else 0.0
        planner, _, _ = planner_step(planner, plan, ns(t), None if blind else estimate(t, [0.02, 0, height]))
    assert "lower without sight" in planner.reason
    assert 1.9 - height <= plan.options.blind_descent_max_m + 0.25


def test_another_pad_is_not_flown_to_but_asked_about_from_higher_up():
    plan = Plan.over_the_pad()
    rows = fly([0.0, 0.0, 2.5], plan, 120, track=lambda t: 1 if t < 6 else 2)
    asked = [(t, d, aim) for t, d, aim, phase in rows if phase is Phase.ANOTHER_PAD]
    assert asked[0][0] == pytest.approx(6, abs=2 * DT)
    for _, _, aim in asked:
        assert isinstance(aim, Hover) or aim.v_level[2] < 0.0
    assert asked[-1][1][2] == pytest.approx(plan.options.safe_height_m, abs=0.4)
    assert rows[-1][3] is Phase.GAVE_UP
    assert asked[-1][0] - asked[0][0] == pytest.approx(plan.options.operator_wait_s, abs=0.2)


@pytest.mark.parametrize(("jump_at", "lands"), [(2.0, True), (12.0, False)], ids=["high up", "below the safe height"])
def test_on_its_own_it_takes_another_pad_only_where_set_so_only_high_up_and_only_once(jump_at, lands):
    plan = changed(Plan.over_the_pad(), another_pad="automatic")
    rows = fly([0.5, 0.0, 3.5], plan, 120, track=lambda t: 1 if t < jump_at else 2)
    assert (rows[-1][3] is Phase.LAND) == lands
    twice = fly([0.5, 0.0, 3.5], plan, 200, track=lambda t: 1 if t < 2 else 2 if t < 9 else 3)
    assert twice[-1][3] is Phase.GAVE_UP


def test_on_its_own_it_waits_for_unbroken_sight_of_one_pad():
    plan = changed(Plan.over_the_pad(), another_pad="automatic")
    rows = fly([0.5, 0.0, 3.5], plan, 40, track=lambda t: 1 if t < 2 else 2, sight=lambda t, d: t < 2 or (t % 4.0) < 3.0)
    assert phases_of(rows)[-1] is Phase.ANOTHER_PAD


histories = st.lists(
    st.tuples(
        st.sampled_from(["fresh", "none", "stale", "inconsistent", "frozen", "another"]),
        st.tuples(st.floats(-4, 4), st.floats(-4, 4), st.floats(-0.2, 6.0)),
        st.floats(0.0, 1.2),
        st.sampled_from([None, 0.0, 3.0, -3.0]),
    ),
    max_size=60,
)


@settings(deadline=None, max_examples=200)
@given(histories, st.booleans())
def test_it_never_sinks_nor_begins_to_land_without_a_fresh_consistent_estimate(history, near):
    """Planner and controller together, over any history of estimates.

    A landing is a lease: it goes on without sight from low down and within its time alone, and not a round beyond another pad.
    """
    plan, planner, pid, t = Plan.over_the_pad(), Planner.start(), Pid.start(), 0.0
    last, landed_at, track, flown = None, None, 1, None
    for kind, d, dt, yaw in history:
        t += dt
        track += kind == "another"
        if near:
            d = (0.01 * d[0], 0.01 * d[1], plan.way_points[planner.leg].d_body_pad_level[2])
        seen = {
            "fresh": lambda d=d, t=t, yaw=yaw, track=track: estimate(t, d, yaw=yaw, track=track),
            "another": lambda d=d, t=t, yaw=yaw, track=track: estimate(t, d, yaw=yaw, track=track),
            "none": lambda: None,
            "stale": lambda d=d, t=t, yaw=yaw: estimate(t, d, yaw=yaw, age=0.51),
            "inconsistent": lambda d=d, t=t, yaw=yaw: estimate(t, d, yaw=yaw, consistent=False),
            "frozen": lambda last=last: last,
        }[kind]()
        last = seen if kind == "fresh" else last
        planner, aim, phase = planner_step(planner, plan, ns(t), seen)
        command: object = aim
        if isinstance(aim, SetPoint):
            pid, command = pid_step(pid, PidOptions(), ns(t), seen, aim, 0.5)
        fit = fit_to_steer(seen, ns(t), plan.guidance.stale_after_s)
        lands = isinstance(command, Land)
        if fit and seen is not None and flown is None:
            flown = seen.track
        unbroken = fit and seen is not None and seen.track == flown
        descends = isinstance(command, Velocity) and command.v_level[2] > 0.0
        if not unbroken:
            assert not descends
            assert not lands or landed_at is not None
        if seen is not None and flown is not None and seen.track != flown:
            assert not lands
        if lands:
            landed_at = t if landed_at is None else landed_at
            assert t - landed_at <= plan.guidance.land_timeout_s + 1e-6
        else:
            landed_at = None
        assert lands == (phase is Phase.LAND)


def test_the_property_above_does_see_landings():
    """The histories of the test above with `near` do end in Land when all are fresh."""
    planner, plan = Planner.start(), Plan.over_the_pad()
    for i in range(40):
        d = [0, 0, plan.way_points[planner.leg].d_body_pad_level[2]]
        planner, aim, _ = planner_step(planner, plan, ns(i * 0.1), estimate(i * 0.1, d))
    assert isinstance(aim, Land)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Plan(()),
        lambda: changed(Plan.over_the_pad(), speed_m_s=0.0),
        lambda: changed(Plan.over_the_pad(), climb_after_s=30.0),
        lambda: WayPoint(np.array([0, 0, -1.0]), 0.1, 0.1, 0.1),
        lambda: WayPoint(np.array([0, 0, 1.0]), 0.0, 0.1, 0.1),
    ],
)
def test_plans_that_make_no_sense_are_refused(make):
    with pytest.raises(ValueError, match=r"must|needs"):
        make()


def blind(t, d, sigma=0.1, consistent=True):
    """Carried on by dead reckoning: computed now, seen two seconds ago."""
    return estimate(t, d, age=2.0, sigma=sigma, consistent=consistent)


def lost_at(t, d):
    planner, _, _ = planner_step(Planner.start(), Plan.over_the_pad(), ns(t), estimate(t, d))
    return planner


def test_without_sight_it_flies_level_towards_the_pad_for_a_while():
    plan = Plan.over_the_pad()
    planner = lost_at(0.0, [1.5, -0.5, 4.0])
    planner, aim, phase = planner_step(planner, plan, ns(1.0), blind(1.0, [1.5, -0.5, 4.0]))
    assert phase is Phase.BLIND
    assert isinstance(aim, Velocity)
    assert aim.v_level[0] > 0 > aim.v_level[1]
    assert aim.v_level[2] == 0.0
    assert math.hypot(*aim.v_level[:2]) <= plan.options.speed_m_s + 1e-9
    _, aim, phase = planner_step(
        planner, plan, ns(plan.options.blind_s + 0.1), blind(plan.options.blind_s + 0.1, [1.5, -0.5, 4.0])
    )
    assert (aim, phase) == (Hover(), Phase.LOST)


@pytest.mark.parametrize(
    "bad",
    [
        blind(1.0, [1.5, 0, 4.0], sigma=2.0),
        blind(1.0, [1.5, 0, 4.0], consistent=False),
        estimate(0.0, [1.5, 0, 4.0]),
        None,
    ],
    ids=["wide", "inconsistent", "computed long ago", "none"],
)
def test_without_sight_it_hovers_where_dead_reckoning_does_not_tell(bad):
    _, aim, phase = planner_step(lost_at(0.0, [1.5, 0, 4.0]), Plan.over_the_pad(), ns(1.0), bad)
    assert (aim, phase) == (Hover(), Phase.LOST)


def test_it_does_not_land_while_it_drifts_away():
    plan = Plan.over_the_pad()
    over = WayPoint(np.array([0, 0, 0.3]), reached_m=0.12, reached_height_m=0.12, dwell_s=0.2)
    plan = Plan((over,), plan.guidance)
    for speed, phase in ((0.0, Phase.LAND), (0.5, Phase.DESCEND)):
        planner = Planner.start()
        for i in range(20):
            planner, _, now = planner_step(planner, plan, ns(i * DT), estimate(i * DT, [0.02, 0, 0.3], v=(speed, 0, 0)))
        assert now is phase
