"""Whole flights of the machine over a point that follows: which states, how low, how often, and why."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from msgspec.structs import replace

from companion.base.mission import DESCENDS, ENDED, Event, State
from companion.base.reason import Reason, ReasonCause
from companion.guidance.controller import Impact, Knowledge, Target
from companion.guidance.make_pilot import make_pilot
from companion.guidance.mission.cycle import GuidanceCycle, unfit
from companion.guidance.mission.limits import DWELL_S, ChargeWatch, last_landing, of_try
from companion.guidance.mission.machine import mission_step, take_order, take_status
from companion.guidance.mission.progress import Progress
from companion.settings.guidance import GuidanceOptions
from companion.settings.load import load
from estimator.contracts.commands import Hover, Land, Velocity
from estimator.contracts.geometry import F64
from tests.companion.mission_flights import DT, PointFlight, guided, holding
from tests.make import estimate, ns, status

WAY_DOWN = [State.INTERCEPT, State.DESCEND, State.GATE, State.COMMIT, State.PRESS, State.DOWN]


def causes(flight: PointFlight, target: State) -> list[ReasonCause]:
    return [change.reason.cause for change in flight.changes if change.target is target]


def test_it_flies_over_the_pad_down_the_cone_through_the_gate_to_the_deck() -> None:
    flight = PointFlight([3.0, 1.0, 6.0]).run(30)
    assert flight.states == WAY_DOWN
    assert flight.progress.state is State.LANDED
    assert flight.t < 20
    assert math.hypot(*flight.d[:2]) < 0.05
    for _, d, aim, state in flight.rows:
        if isinstance(aim, Target) and aim.descent_rate_m_s is not None and state is State.DESCEND:
            assert aim.descent_rate_m_s <= max(0.0, d[2] - flight.options.cone.gate_height_m) + 1e-9
        if state is State.INTERCEPT:
            assert d[2] > 5.0, "nothing descends outside the cone"


def test_the_thesis_way_points_end_in_the_vehicles_own_landing() -> None:
    flight = PointFlight([3.0, 1.0, 5.0], guided("thesis")).run(60)
    assert flight.states == [State.INTERCEPT, State.DESCEND, State.GATE, State.DOWN]
    assert flight.progress.state is State.LANDED
    over = next(d for _, d, _, state in flight.rows if state is State.DESCEND)
    assert math.hypot(*over[:2]) <= 0.25
    assert over[2] == pytest.approx(2.0, abs=0.25)


def test_a_pad_lost_for_a_moment_stops_the_descent_and_is_found_again() -> None:
    flight = PointFlight([0.0, 0.0, 6.0], sight=lambda t, d: not 2.0 < t < 3.3).run(40)
    assert State.HOLD_BLIND in flight.states
    assert flight.progress.state is State.LANDED
    held = [d[2] for t, d, *_ in flight.rows if 2.6 < t < 3.3]
    assert max(held) - min(held) < 0.2
    assert causes(flight, State.HOLD_BLIND) == [ReasonCause.STALE]


def test_a_pad_lost_low_is_sought_from_higher_up_and_found() -> None:
    state = {"blind": False, "done": False}

    def sight(t, d):
        if d[2] < 1.0 and not state["done"]:
            state["blind"] = True
        if d[2] > 1.5 and state["blind"]:
            state["blind"], state["done"] = False, True
        return not state["blind"]

    flight = PointFlight([0.0, 0.0, 3.0], sight=sight).run(60)
    assert {State.HOLD_BLIND, State.GO_AROUND} <= {change.target for change in flight.changes}
    assert flight.progress.state is State.LANDED
    (why,) = [change.reason for change in flight.changes if change.target is State.GO_AROUND]
    assert why.cause is ReasonCause.LOST_LOW
    assert why.measured == pytest.approx(0.75, abs=0.25)
    assert why.text == f"the pad was lost at {why.measured:.1f} m"


def test_a_pad_lost_for_good_is_given_up_at_a_safe_height() -> None:
    flight = PointFlight([0.0, 0.0, 2.5], sight=lambda t, d: t < 2.0).run(80)
    assert flight.progress.state is State.GAVE_UP
    assert flight.d[2] == pytest.approx(2.0, abs=0.5)
    assert flight.progress.fault is not None
    assert flight.progress.fault.cause in (ReasonCause.LOST_LOW, ReasonCause.NOT_FOUND_AGAIN)


def test_no_pad_at_all_ends_in_giving_up() -> None:
    options = guided(tries={"search_s": 9.0})
    flight = PointFlight([0.0, 0.0, 3.0], options, sight=lambda t, d: False, over_ground=True).run(14)
    assert flight.states == [State.SEARCH, State.GAVE_UP]
    flown = [(t, aim.v_level.tolist()) for t, _, aim, _ in flight.rows if isinstance(aim, Velocity)]
    assert len(flown) == len(flight.rows)
    assert all(v == [0.0, 0.0, -0.0] for t, v in flown if t < 2.9 or t > 7.2)
    climbs = [v for _, v in flown if v != [0.0, 0.0, -0.0]]
    assert all(v == [0.0, 0.0, -0.5] for v in climbs), "out of reach"
    assert len(climbs) == pytest.approx(4.0 / DT, abs=2)


@pytest.mark.parametrize("mission", ["cone", "thesis"])
def test_a_landing_that_nobody_reports_is_taken_back_and_after_the_last_try_it_holds_high_up(mission: str) -> None:
    flight = PointFlight([0.0, 0.0, 2.5], guided(mission), sight=lambda t, d: d[2] > 0.2, stands=False).run(200)
    tries = flight.options.tries.go_arounds_max + 1
    assert flight.states.count(State.COMMIT if mission == "cone" else State.DOWN) == tries
    over = {ReasonCause.NO_CONTACT, ReasonCause.STALE, ReasonCause.SIGHTING_AGE, ReasonCause.NO_LANDING, ReasonCause.PAST_DECK}
    assert set(causes(flight, State.GO_AROUND)) <= over | {ReasonCause.RELATIVE_SPEED}
    # Far below where the deck should be, nobody knows its speed: that may be the reason in the end.
    assert flight.progress.state in (State.GAVE_UP, State.REFUSED)
    assert min(d[2] for _, d, *_ in flight.rows) > -1.6
    assert flight.d[2] > 1.6


def test_a_gate_that_does_not_open_ends_in_a_refusal_that_says_what_kept_it_shut() -> None:
    options = guided(limits={"relative_speed_m_s": 0.02}, tries={"go_arounds_max": 1}, cone={"gate_s": 3.0})
    flight = PointFlight([0.0, 0.0, 2.5], options)
    for _ in range(2000):
        flight.v[0] += 0.08 * math.sin(4.0 * flight.t)
        flight.cycle()
    assert flight.progress.state is State.REFUSED
    assert flight.progress.fault is not None
    assert flight.progress.fault.cause is ReasonCause.RELATIVE_SPEED
    assert "m/s against the deck (limit 0.03 m/s)" in flight.progress.fault.text


@pytest.mark.parametrize("battery", [0.09, 0.03])
def test_a_refused_drone_whose_battery_ends_lands_on_the_pad_or_where_it_is_and_does_not_fall(battery: float) -> None:
    flight = PointFlight([0.3, 0.0, 3.0])
    flight.battery = 0.5
    flight.progress = replace(flight.progress, state=State.REFUSED, begun=True, stood=False, since=ns(0.0))
    assert flight.run(5.0).progress.state is State.REFUSED
    flight.battery = battery
    flight.run(60.0)
    assert flight.progress.state is (State.LANDED if battery > 0.05 else State.REFUSED)
    assert flight.d[2] == 0.0
    assert battery > 0.05 or (flight.progress.stood and flight.rows[-1][2] == Hover()), "and does not take off again"


@pytest.mark.parametrize(
    ("refused", "over_ground", "lands"),
    [("hold", True, True), ("hold", False, True), ("return", True, False), ("return", False, True)],
)
def test_what_flies_nowhere_else_lands_where_it_is_with_its_last_charge(refused, over_ground, lands):
    """An AR.Drone has no return. A person who holds or aborts it decides, and 0 hovers on."""
    o = replace(GuidanceOptions(), refused=refused)
    s = GuidanceCycle(ns(9.0), Knowledge(ns(9.0), None), 0.05, range_m=5.0)

    def ordered_in(state: State, o: GuidanceOptions = o, **memory: Any) -> Any:
        p = Progress(state, automatic=True, begun=True, **{"stood": False, "since": ns(0.0), **memory})
        return mission_step(p, holding(s, over_ground), o)[1]

    for state in (State.REFUSED, State.GAVE_UP):
        assert (ordered_in(state) == Land()) is lands
        assert ordered_in(state, replace(o, last_charge=0.0)) != Land()
        assert ordered_in(state, stood=True) != Land()
    assert ordered_in(State.PAUSED) != Land()
    assert ordered_in(State.ABORTED) != Land()


@given(st.lists(st.tuples(st.floats(0.02, 1.5), st.sampled_from([0.04, 0.06, 0.5])), max_size=40))
@settings(max_examples=60)
def test_a_charge_decides_once_every_report_of_three_seconds_says_so(reports: list[tuple[float, float]]) -> None:
    watch, t, said = ChargeWatch(), 0.0, list[tuple[float, float]]()
    for after_s, charge in reports:
        t += after_s
        said.append((t, charge))
        watch = watch.reported(ns(t), charge)
        known = t - said[0][0] >= DWELL_S
        assert watch.fraction == (max(c for at, c in said if t - at <= DWELL_S) if known else None)
    assert watch.reported(ns(t), None).fraction is None


def test_a_dip_of_the_battery_lands_no_refused_drone_where_it_is() -> None:
    """WHY: one report of 4 % while a climb loaded the battery brought it down into the sea."""
    landing = make_pilot(load("sim")).landing
    landing.on_samples([status(0.0, flying=True)])
    landing.mission = replace(landing.mission, state=State.REFUSED, begun=True, stood=False, since=ns(0.0))
    for n in range(600):
        charge = 0.04 if 5.0 <= 0.02 * n < 7.5 or 0.02 * n >= 8.0 else 0.3
        landing.on_samples([replace(status(0.02 * n, flying=True), battery_fraction=charge)])
        lands = landing.command(Knowledge(ns(0.02 * n), None)) == Land()
        assert lands is (0.02 * n >= 8.0 + DWELL_S), 0.02 * n


@pytest.mark.parametrize(("battery", "lands"), [(0.5, False), (0.09, True), (0.03, True)])
def test_a_landing_whose_battery_ends_bears_more_and_gives_up_for_nothing(battery: float, lands: bool) -> None:
    """WHY: six go-arounds for .46 instead of .45 m/s, and then a landing beside the pad with what the battery had left."""
    flight = PointFlight([0.0, 0.0, 1.0], guided(tries={"go_arounds_max": 1, "landing_s": 30.0}), battery=battery)
    flight.rolled = lambda t, d: math.radians(4.6)
    flight.run(60.0)
    assert (flight.progress.state is State.LANDED) is lands
    flight = PointFlight([0.0, 0.0, 1.0], flight.options, battery=battery, rolled=lambda t, d: math.radians(8.0))
    assert (flight.run(60.0).progress.state in (State.REFUSED, State.GAVE_UP)) is not lands, "beyond what it bears it tries on"


@given(st.data())
def test_what_a_try_allows_stays_within_the_settings_ranges(data: st.DataObject) -> None:
    """WHY: with an error_m of 1.5 m, which the file may have, the third try raised ValueError in flight."""
    edges = data.draw(st.sampled_from([{"error_m": 2.0}, {"deck_tilt_gate_deg": 45.0}, {"relative_speed_m_s": 5.0}, {}]))
    o = guided(limits=edges, cone={"slope": data.draw(st.sampled_from([0.02, 0.22, 1.0]))})
    last = last_landing(o)
    assert of_try(last.limits, data.draw(st.integers(0, 9))).error_m >= o.limits.error_m
    assert last.cone.slope >= o.cone.slope


def bumpy(options: GuidanceOptions) -> PointFlight:
    """Return a flight whose estimate fails for a second in every six, and that is blown out of the cone then."""

    def sight(t: float, d: F64) -> bool:
        return t % 6.0 > 1.0

    flight = PointFlight([0.0, 0.0, 3.2], options, sight=sight)
    while flight.t < 600.0 and flight.progress.state not in (State.GAVE_UP, State.REFUSED, State.LANDED):
        flight.d[0] += 0.2 if flight.t % 6.0 < 1.0 else 0.0
        flight.cycle()
    return flight


def test_the_time_of_a_leg_does_not_begin_again_with_every_loss_of_sight() -> None:
    """WHY: with a shaken accelerometer the estimate failed and recovered for as long as the scenario lasted."""
    flight = bumpy(guided(tries={"try_s": 3600.0, "landing_s": 3600.0, "leg_s": 10.0}))
    assert flight.states.count(State.HOLD_BLIND) > 4
    assert ReasonCause.STATE_TIME in causes(flight, State.GO_AROUND)
    assert flight.progress.state is State.GAVE_UP


def test_a_climb_that_nobody_confirms_is_not_accepted() -> None:
    """WHY: after a lost link guidance took itself to be two metres up by the clock, while the drone hovered at 0.2 m."""
    flight = PointFlight([0.0, 0.0, 2.5], sight=lambda t, d: not 2.5 < t < 14.0)
    while flight.t < 2.5 or flight.progress.state not in (State.GO_AROUND, State.GAVE_UP):
        flight.cycle()
    began = flight.t
    while flight.t < began + 4.0:
        flight.silent_s = flight.t - began
        flight.d[2], flight.v[2] = 0.4, 0.0
        flight.cycle()
    assert flight.progress.state is State.GO_AROUND, "two metres by the clock are none while the vehicle is silent"
    flight.silent_s, back = 0.0, flight.t
    while flight.progress.state is State.GO_AROUND and flight.t < 20.0:
        flight.cycle()
    assert flight.d[2] > 1.8, "it may have flown on down to the deck, so it climbs the whole way to the safe height"
    assert flight.t - back < 6.0
    assert flight.run(40).progress.state is State.LANDED


@pytest.mark.parametrize(("blind", "cause"), [("contradicts", ReasonCause.INCONSISTENT), ("dark", ReasonCause.NOT_FOUND_AGAIN)])
def test_giving_up_gives_the_reason_the_hold_began_and_not_what_ended_an_earlier_try(blind: str, cause: ReasonCause) -> None:
    o = GuidanceOptions()
    earlier = Reason(ReasonCause.DECK_TILT, 3.0, 2.5)
    progress, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    progress = replace(progress, fault=earlier)
    for i in range(1, 900):
        t = i * DT
        seen = estimate(t, [0, 0, 2.5], age=0.0 if t < 2.0 or blind != "dark" else t - 2.0, consistent=t < 2.0 or blind == "dark")
        progress, _, _ = mission_step(progress, GuidanceCycle(ns(t), Knowledge(ns(t), seen)), o)
        if progress.state is State.GAVE_UP:
            break
    assert progress.state is State.GAVE_UP
    assert progress.fault is not None
    assert progress.fault.cause is cause


def test_another_pad_is_not_flown_to_but_confirmed_from_higher_up() -> None:
    flight = PointFlight([0.0, 0.0, 3.0], track=lambda t: 1 if t < 3 else 2).run(120)
    asked = [(t, d, aim) for t, d, aim, state in flight.rows if state is State.ANOTHER_PAD]
    assert asked[0][0] == pytest.approx(3, abs=2 * DT)
    assert asked[-1][1][2] == pytest.approx(flight.options.tries.safe_height_m, abs=0.4)
    assert flight.progress.state is State.GAVE_UP
    assert asked[-1][0] - asked[0][0] == pytest.approx(flight.options.tries.operator_wait_s, abs=0.2)
    again = PointFlight([0.0, 0.0, 3.0], track=lambda t: 1 if t < 3 else 2).run(10)
    again.order(Event.BEGIN)
    assert again.run(60).progress.state is State.LANDED


@pytest.mark.parametrize(("jump_at", "lands"), [(1.0, True), (5.0, False)], ids=["high up", "below the safe height"])
def test_on_its_own_it_takes_another_pad_only_where_set_so_only_high_up_and_only_once(jump_at: float, lands: bool) -> None:
    options = guided(tries={"another_pad": "automatic"})
    flight = PointFlight([0.5, 0.0, 4.5], options, track=lambda t: 1 if t < jump_at else 2).run(120)
    assert (flight.progress.state is State.LANDED) == lands
    ending = PointFlight([0.5, 0.0, 4.5], track=flight.track, battery=0.08).run(120)
    assert not lands or ending.progress.state is State.LANDED, "nobody waits for an answer while the battery ends"
    twice = PointFlight([0.5, 0.0, 4.5], options, track=lambda t: 1 if t < 1 else 2 if t < 7 else 3).run(200)
    assert twice.progress.state is State.GAVE_UP


@pytest.mark.parametrize("over_ground", [False, True])
@pytest.mark.parametrize("blind_sigma_m", [1.0, 0.05])
@pytest.mark.parametrize("order", [Event.PAUSE, Event.ABORT, None])
def test_still_means_still_against_the_deck(order: Event | None, blind_sigma_m: float, over_ground: bool) -> None:
    """The pad sails away at 1.5 m/s; paused, aborted and blind, with an estimate or none, the point stays and loses no height."""
    options = guided(tries={"blind_sigma_m": blind_sigma_m})
    flight = PointFlight([0.5, 0.3, 4.0], options, lambda t, d: t < 2.0, pad_v=(1.5, 0.0, 0.0), over_ground=over_ground).run(2.0)
    if order is not None:
        flight.order(order)
    flight.run(1.0)  # what was seen half a second ago still counts as seen
    before = flight.d.copy()
    flight.run(3.0)
    assert math.hypot(*(flight.d[:2] - before[:2])) < 0.7
    assert flight.d[2] > before[2] - 0.3
    aims = [aim for t, _, aim, _ in flight.rows if t > 3.0]
    without = Velocity if over_ground else Hover
    assert {type(aim) for aim in aims} == {Target if blind_sigma_m > 0.1 else without}


@pytest.mark.parametrize("order", [None, Event.PAUSE, Event.ABORT])
@pytest.mark.parametrize("over_ground", [False, True])
def test_until_a_landing_is_requested_nothing_but_the_vehicles_own_hover_is_commanded(order, over_ground):
    """A velocity would take an autopilot from whoever flies it, even one that holds still."""
    o = GuidanceOptions()
    progress, _ = take_status(Progress.start(automatic=False), status(0.0, True), o)
    if order is not None:
        progress, _ = take_order(progress, order, ns(0.1), o)
    for n in range(10):
        t = 0.2 + n * DT
        s = GuidanceCycle(ns(t), Knowledge(ns(t), estimate(t, [2.5, 0.3, 3.0], v=(1.0, 0.0, 0.0))))
        progress, aim, _ = mission_step(progress, holding(s, over_ground), o)
        assert isinstance(aim, Hover)
    if order is not Event.ABORT:
        progress, _ = take_order(progress, Event.BEGIN, ns(t), o)
        progress, aim, _ = mission_step(progress, holding(s, over_ground), o)
        assert isinstance(aim, Target)
        assert progress.state is State.INTERCEPT
        # Held in the same flight it stays with the deck; in the next one it is left alone again.
        progress, _ = take_order(progress, Event.PAUSE, ns(t), o)
        progress, aim, _ = mission_step(progress, holding(s, over_ground), o)
        assert isinstance(aim, Target)
        progress, _ = take_status(progress, status(t, False), o)
        progress, _ = take_status(progress, status(t, True), o)
        progress, aim, _ = mission_step(progress, holding(s, over_ground), o)
        assert isinstance(aim, Hover)


def test_no_contact_that_nobody_felt_stops_the_motors_of_a_cone() -> None:
    flight = PointFlight([0.0, 0.0, 1.0], feels=False, sight=lambda t, d: True).run(12)
    assert State.PRESS not in flight.states
    assert not any(isinstance(aim, Land) for *_, aim, _ in flight.rows)
    assert ReasonCause.NO_CONTACT in causes(flight, State.GO_AROUND)


# A landing ends by itself within the time that docs/limits.md states


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
