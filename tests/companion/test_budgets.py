"""A landing ends by itself: whatever the sensors and estimates are, within the time that docs/limits.md states."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.base.mission import DESCENDS, ENDED, Event, State
from companion.guidance.controller import Impact, Knowledge, Target
from companion.guidance.mission.cycle import GuidanceCycle, unfit
from companion.guidance.mission.machine import mission_step, take_order, take_status
from companion.guidance.mission.progress import Progress
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Land, Velocity
from tests.companion.mission_flights import guided
from tests.make import estimate, ns, status

SHORT = guided(tries={"search_s": 10.0, "landing_s": 25.0, "try_s": 12.0, "leg_s": 8.0, "operator_wait_s": 6.0})
KINDS = ("fresh", "fresh", "gate", "none", "stale", "inconsistent", "another")


def tail_s(o: GuidanceOptions) -> float:
    """Return the time that an attempt may still take: from the gate to the deck, up again, four touches, a question."""
    climb_s = 3.0 * (o.tries.safe_height_m + 0.3) / o.tries.climb_m_s + 10.0
    once_s = o.cone.press_s + o.cone.commit_s + o.land_timeout_s + climb_s
    return o.cone.commit_s + 5.0 * once_s + 2.0 * o.tries.operator_wait_s


def test_the_stated_budget_is_that_of_the_defaults() -> None:
    o = GuidanceOptions()
    text = (Path(__file__).parents[2] / "docs" / "limits.md").read_text(encoding="utf-8")
    once_s = (tail_s(o) - o.cone.commit_s - 2.0 * o.tries.operator_wait_s) / 5.0
    for stated_s in (o.tries.search_s, o.tries.landing_s, o.cone.commit_s + once_s, once_s, o.tries.operator_wait_s):
        assert f"{stated_s:.0f} s" in text


@pytest.mark.hazard("H10")
@settings(max_examples=60)
@given(
    spells=st.lists(
        st.tuples(
            st.sampled_from(KINDS), st.integers(1, 30), st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.3, 6.0)),
            st.booleans(), st.sampled_from([0.1, 0.2, 0.7]),
        ),
        min_size=1, max_size=8,
    ),
    another_pad=st.sampled_from(["operator", "automatic"]),
    mission=st.sampled_from(["cone", "thesis"]),
)  # fmt: skip
def test_whatever_is_seen_and_felt_the_landing_ends_within_its_budget(spells, another_pad, mission) -> None:
    o = structs.replace(SHORT, mission=mission, tries=structs.replace(SHORT.tries, another_pad=another_pad))
    p, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    budget_s = o.tries.search_s + o.tries.landing_s + tail_s(o)
    t, track, impact = 0.0, 1, None
    while p.state not in ENDED:
        assert t < budget_s, (p.state, p.reason)
        for kind, ticks, d, felt, dt in spells:
            track += kind == "another"
            for _ in range(ticks):
                t += dt
                low = {State.INTERCEPT: 2.0, State.DESCEND: 0.3, State.GATE: 0.3}.get(p.state, d[2])
                where = (0.01, 0.0, low) if kind == "gate" else d
                known = {"stale": {"age": 2.0}, "inconsistent": {"consistent": False}}.get(kind, {})
                seen = None if kind == "none" else estimate(t, where, track=track, **known)
                if felt and p.state in (State.COMMIT, State.GO_AROUND):
                    impact = Impact(ns(t), "accelerometer", 9.0)
                s = GuidanceCycle(ns(t), Knowledge(ns(t), seen, impact=impact))
                p, aim, _ = mission_step(p, s, o)
                stale_s = o.limits.commit_sighting_age_s if p.state is State.COMMIT else o.stale_after_s
                fit = seen is not None and unfit(seen, ns(t), stale_s) is None and seen.track == p.track
                if isinstance(aim, Target) and (aim.descent_rate_m_s or 0.0) > 0.0:
                    assert p.state is State.PRESS or (fit and p.state in DESCENDS)
                assert not isinstance(aim, Velocity) or aim.v_level[2] <= 0.0
                assert not isinstance(aim, Land) or p.state in (State.PRESS, State.DOWN)


@pytest.mark.hazard("H10")
def test_flips_between_states_restart_no_budget() -> None:
    """Sight that comes and goes each second: descend, hold blind, descend; the attempt's and the landing's times go on."""
    o = guided(tries={"landing_s": 20.0, "losses_max": 1000, "blind_descent_max_m": 10.0, "climb_after_s": 15.0})
    p, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    t = 0.0
    while p.state not in ENDED:
        t += 0.1
        age_s = 0.0 if t % 2.0 < 1.0 else 0.9
        p, _, _ = mission_step(p, GuidanceCycle(ns(t), Knowledge(ns(t), estimate(t, (0.0, 0.0, 2.5), age=age_s))), o)
        assert t < 20.0 + 23.0
    assert p.state is State.GAVE_UP


def test_an_order_in_the_air_is_another_landing() -> None:
    o = SHORT
    p, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    for k in range(1, 200):
        p, _, _ = mission_step(p, GuidanceCycle(ns(0.1 * k), Knowledge(ns(0.1 * k), None)), o)
    assert p.state is State.GAVE_UP
    p, _ = take_order(p, Event.BEGIN, ns(20.0), o)
    assert (p.state, p.asked_at) == (State.SEARCH, ns(20.0))
