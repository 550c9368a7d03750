"""A landing where the drone is: the place that is told is the one that is flown to, and nothing but a person ends it."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.base.mission import CONTACT_INTENDED, ENDED, FLOWN, Event, ReasonCause, State
from companion.guidance.controller import AtContact, Impact, Knowledge, Target
from companion.guidance.flight_memory import FlightMemory
from companion.guidance.mission.land_here import touch
from companion.guidance.mission.machine import allowed, mission_step, take_order, take_status
from companion.guidance.mission.progress import GuidanceCycle, Here, Progress, VehicleHold
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.guidance import ClimbResponse, GuidanceOptions
from estimator.contracts.commands import Land, Lean, Velocity
from estimator.contracts.estimates import IntegrityAlert
from tests.companion.test_flight_memory import back
from tests.companion.test_mission_flights import PointFlight, guided
from tests.make import deck, estimate, ns, status, vessel_position

OPTIONS = GuidanceOptions()
places = st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0), st.floats(0.2, 8.0))
flown = sorted(FLOWN | {State.READY, State.PAUSED, State.REFUSED, State.GAVE_UP, State.ABORTED, State.TAKEN}, key=str)


def landing(state: State = State.PAUSED, at_s: float = 0.0, o: GuidanceOptions = OPTIONS) -> Progress:
    """Return the memory after an order to land, given in this state."""
    p = Progress(state, automatic=False, begun=True, stood=False, since=ns(0.0))
    return take_order(p, Event.LAND, ns(at_s), o)[0]


def cycle(t: float, seen: Any = None, *, over_ground: bool = False, **more: Any) -> GuidanceCycle:
    knows = {name: more.pop(name) for name in ("impact", "deck", "trusts_velocity", "at_contact", "climb") if name in more}
    return GuidanceCycle(ns(t), Knowledge(ns(t), seen, **knows), hold=VehicleHold(over_ground), **more)


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("mission", ["cone", "thesis", "targets"])
@pytest.mark.parametrize("state", flown)
def test_the_order_is_taken_in_every_state_of_a_flight(state: State, mission: Any) -> None:
    o = guided(mission)
    p = landing(state, o=o)
    assert p.lands_here
    on_deck = mission == "cone" and state in (State.PRESS, State.DOWN)
    assert p.state is (state if on_deck else State.LAND_HERE)
    for event, target in ((Event.HOLD, State.PAUSED), (Event.ABORT, State.ABORTED), (Event.BEGIN, State.SEARCH)):
        ended, _ = take_order(p, event, ns(1.0), o)
        assert not ended.lands_here
        assert ended.state is (p.state if on_deck and event is Event.BEGIN else target)
    taken, _ = take_status(p, status(1.0, taken="mode loiter"), o, resumes=True)
    assert (taken.state, taken.lands_here) == (State.TAKEN, False)
    back, _ = take_status(taken, status(2.0), o, resumes=True)
    assert back.state is State.TAKEN, "a vehicle that is given back was not on its way to the pad"


@pytest.mark.hazard("H9", "A1")
@settings(max_examples=200)
@given(places, st.floats(-math.pi, math.pi), st.sampled_from([0.0, 0.3, 4.0]), st.floats(0.01, 0.9))
def test_the_place_that_is_told_before_is_the_one_that_is_flown_to(d: Any, yaw: float, age: float, sigma: float) -> None:
    seen = estimate(1.0, d, yaw=yaw, age=age, sigma=sigma)
    told = touch(cycle(1.0, seen), OPTIONS)
    p, aim, _ = mission_step(landing(at_s=0.9), cycle(1.0, seen), OPTIONS)
    assert p.here is not None
    assert told.lateral_m == pytest.approx(math.hypot(*aim.d_body_pad_level[:2]))
    assert touch(cycle(1.0, seen), OPTIONS, p.here) == told, "and so is what is told on the way"
    assert told.spread_m > 2.0 * sigma or told.unsure == ""
    assert (told.unsure == "") is (age <= OPTIONS.stale_after_s)
    turned = estimate(1.1, d, yaw=yaw + 0.5, age=age, sigma=sigma)
    _, later, _ = mission_step(p, cycle(1.1, turned), OPTIONS)
    c, s = math.cos(0.5), math.sin(0.5)
    x, y, _ = aim.d_body_pad_level
    assert later.d_body_pad_level[:2] == pytest.approx([c * x + s * y, c * y - s * x]), "it is a place on the deck"


def test_from_inside_the_cone_it_is_the_pads_centre_and_from_aside_the_place_below() -> None:
    for off_m, height_m, lateral_m in ((0.3, 1.0, 0.0), (1.4, 5.0, 0.0), (1.4, 3.0, 1.4), (4.0, 6.0, 4.0)):
        assert touch(cycle(1.0, estimate(1.0, (off_m, 0.0, height_m))), OPTIONS).lateral_m == pytest.approx(lateral_m)
    blind = [touch(cycle(1.0, estimate(1.0, (0.1, 0.0, h), age=2.0, sigma=0.1)), OPTIONS).spread_m for h in (1.0, 2.0, 4.0)]
    assert blind == sorted(blind), "the longer the way the less is known"
    frozen = estimate(1.0, (0.1, 0.0, 2.0), consistent=False, alerts=(IntegrityAlert.CAMERA_FROZEN,))
    assert touch(cycle(1.0, frozen), OPTIONS).text.endswith("rail or water; the camera repeats its frames")
    windy = WindOverDrone(24.0, 1.0, 18.0, (1.0, 0.0), 0.6, spent=True)
    told = touch(cycle(1.0, wind=windy), OPTIONS).text
    assert told.endswith("rail or water; 24.0 m/s of wind over the drone carries it off: its tilt can fly 18.0 m/s")
    by_ship = touch(cycle(1.0, vessel=vessel_position(1.0, (30.0, 40.0))), OPTIONS)
    assert by_ship.lateral_m == pytest.approx(50.0)


@pytest.mark.hazard("H6", "H12")
def test_a_lens_elsewhere_bars_no_persons_landing_and_is_told_with_its_spread() -> None:
    seen = estimate(1.0, (0.1, 0.0, 2.0))
    off = structs.replace(seen, lens_off_m=(0.3, 0.0))
    placed, told = (touch(cycle(1.0, each), OPTIONS) for each in (seen, off))
    assert told.spread_m == pytest.approx(placed.spread_m + 0.3)
    assert "the lens is 30 cm from where" in told.text
    p, aim, _ = mission_step(landing(at_s=0.9), cycle(1.0, off), OPTIONS)
    assert (p.state, isinstance(aim, Target)) == (State.LAND_HERE, True), "it follows the deck all the same"


@pytest.mark.hazard("H3", "A1")
@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.one_of(st.none(), places), st.sampled_from([0.0, 0.4, 3.0]), st.booleans(), st.booleans()), min_size=1),
    st.booleans(),
    st.sampled_from([0.0, 2.0]),
    st.sampled_from(["cone", "thesis", "targets"]),
)
def test_whatever_is_seen_and_felt_it_goes_down_until_a_person_ends_it(looks, ground, silent, mission):
    o = guided(mission)
    p, t = landing(State.ABORTED, o=o), 0.0
    for d, age, ok, felt in looks * 20:
        t += 0.1
        seen = None if d is None else estimate(t, d, (0.0, 0.0, -0.4), age=age, consistent=ok, track=1 + (t > 1.0))
        impact = Impact(ns(t), "accelerometer", 5.0) if felt else None
        moved = deck(t, (1.0, 0.0, 0.2))
        p, aim, _ = mission_step(p, cycle(t, seen, over_ground=ground, silent_s=silent, impact=impact, deck=moved), o)
        assert p.lands_here
        assert p.state in CONTACT_INTENDED
        down = aim.descent_rate_m_s if isinstance(aim, Target) else aim.v_level[2] if isinstance(aim, Velocity) else 0.0
        waits = 0.0 if p.in_state_s(ns(t)) <= 8.1 else 0.1
        assert isinstance(aim, Land) or (down is not None and down >= (-1.0 if p.state is State.LAND_HERE and d else waits))
        assert mission != "targets" or aim == Land(here=True)
    p, _ = take_order(p, Event.HOLD, ns(t), o)
    assert p.state is State.PAUSED


def test_out_of_sight_and_without_a_velocity_a_drone_lands_by_its_own_loops_and_an_autopilot_by_its_velocity() -> None:
    """WHY: with an attitude 17 degrees off the tilt against the wind drove it at 8 m/s into the water (weather_3, 894201)."""
    for ground, trusts, age_s in itertools.product((False, True), (False, True), (0.1, None)):
        seen = None if age_s is None else estimate(1.0, (0.1, 0.0, 2.0), age=age_s)
        s = cycle(1.0, seen, over_ground=ground, trusts_velocity=trusts)
        _, aim, _ = mission_step(landing(at_s=0.9), s, OPTIONS)
        expected = Target if age_s is not None else Velocity if ground or trusts else Land
        assert isinstance(aim, expected)


def land(flight: PointFlight, at_m: float) -> PointFlight:
    """Fly until this height, order to land, and fly on."""
    while flight.d[2] > at_m:
        flight.cycle()
    flight.order(Event.LAND)
    while flight.progress.state not in ENDED and flight.t < 120.0:
        flight.cycle()
    return flight


@pytest.mark.hazard("A1")
@pytest.mark.parametrize("over_ground", [False, True])
@pytest.mark.parametrize(("at_m", "seen"), [(3.0, True), (1.0, True), (3.0, False), (1.0, False)])
def test_it_follows_the_deck_to_the_contact_feels_it_and_stops_the_motors(at_m: float, seen: bool, over_ground: bool) -> None:
    flight = PointFlight([0.5, 0.0, 3.2], pad_v=(1.5, 0.0, 0.0), over_ground=over_ground)
    flight.sight = lambda t, d: seen or not flight.progress.lands_here
    land(flight, at_m)
    assert flight.progress.state is State.LANDED
    assert flight.states[-3:] == [State.LAND_HERE, State.PRESS, State.DOWN]
    assert float(np.hypot(*flight.d[:2])) < 0.05
    contact = next(change for change in flight.changes if change.event is Event.CONTACT)
    assert contact.reason.cause is ReasonCause.FELT


def vague(t: float, height_m: float, v_down: float = 0.0, sigma: float = 0.4) -> Any:
    """Return an estimate after 5 s without sight: nothing contradicts it, but its place is known to 1.2 m."""
    seen = estimate(t, (0.3, 0.0, height_m), (0.0, 0.0, v_down), age=5.0, sigma=sigma, consistent=False)
    cov = seen.cov.copy()
    cov[0, 0] = cov[1, 1] = 1.2**2
    return structs.replace(seen, cov=cov)


ONCE, HELD = (1.0, 1.1), (1.0, 99.0)


@pytest.mark.hazard("H4")
@pytest.mark.parametrize(
    ("felt", "height_m", "command"),
    [
        ({"accelerometer": ONCE, "velocity": HELD}, None, Land(on_deck=True)),
        ({"velocity": HELD}, 0.2, Land(on_deck=True)),
        ({"velocity": HELD}, None, Land()),
        ({"accelerometer": ONCE}, None, None),
        ({"accelerometer": ONCE}, 0.2, None),
        ({"velocity": HELD}, 4.0, None),
    ],
)
def test_without_sight_it_takes_two_witnesses_to_stop_an_autopilots_motors_by_force(felt, height_m, command):
    """One that felt the deck once goes on down: LAND holds over the ground, and a ship under way slides on under it."""
    p, aim = landing(), None
    for k in range(500):
        t = 0.02 * k
        by = [name for name, (begins, ends) in felt.items() if begins <= t <= ends and (name != "velocity" or t > 1.3)]
        impact = Impact(ns(t), by[-1], 5.0, 0.4) if by else None
        seen = None if height_m is None else vague(t, height_m)
        p, aim, _ = mission_step(p, cycle(t, seen, over_ground=True, impact=impact), OPTIONS)
        if p.state is State.DOWN:
            break
    assert (aim if p.state is State.DOWN else None) == command
    assert p.lands_here
    if command is None:
        p = structs.replace(p, state=State.PRESS, since=ns(70.0), reckoned=None)
        p, _, _ = mission_step(p, cycle(73.1, over_ground=True), OPTIONS)
        assert p.state is State.DOWN, "at last its own landing is better than nothing"


@pytest.mark.hazard("H4", "A1")
@pytest.mark.parametrize(
    ("ranges_m", "height_m", "v_down", "sigma", "contact"),
    [
        ([None], 2.5, -0.05, 0.3, False),
        ([None], 0.3, -0.05, 0.3, False),
        ([None], 0.3, -0.05, 0.1, True),
        ([3.0], 0.3, -0.05, 0.1, False),
        ([3.0, None], 1.2, -0.4, 0.4, False),
        ([0.24, None], 1.2, -0.4, 0.4, True),
        ([0.1], 1.2, -0.4, 0.4, True),
        ([0.24, 0.6, None], 1.2, -0.4, 0.4, False),
    ],
)
def test_without_sight_a_descent_has_ended_only_where_that_is_sure(ranges_m, height_m, v_down, sigma, contact):
    p = landing()
    for k in range(200):
        t, range_m = 0.02 * k, ranges_m[min(k // 20, len(ranges_m) - 1)]
        p, _, _ = mission_step(p, cycle(t, vague(t, height_m, v_down, sigma), range_m=range_m), OPTIONS)
    assert (p.state is not State.LAND_HERE) is contact


def test_a_contact_that_is_felt_outweighs_a_height_that_has_become_vague() -> None:
    p = landing()
    for k in range(100):
        t = 0.02 * k
        felt = Impact(ns(1.0), "accelerometer", 5.0) if t >= 1.0 else None
        p, _, _ = mission_step(p, cycle(t, vague(t, 2.0), impact=felt), OPTIONS)
    assert p.state in (State.PRESS, State.DOWN)


@pytest.mark.parametrize(("age", "down_m_s"), [(0.5, 0.9), (3.0, 0.4)])
def test_without_sight_it_goes_down_over_the_ground_and_after_no_heave_that_it_does_not_see(age: float, down_m_s: float) -> None:
    seen, p = estimate(1.0, (0.1, 0.0, 0.4), age=age), landing()
    s = cycle(1.0, seen)
    p, _, _ = mission_step(p, s, OPTIONS)
    command = allowed(Lean(np.zeros(2), np.zeros(2), np.array([0.1, 0.0, 0.9]), 0.0), p, s, OPTIONS)
    assert isinstance(command, Lean)
    assert command.v_level == pytest.approx([0.1, 0.0, down_m_s])


def test_without_sight_it_is_flown_by_the_estimate_while_its_speed_is_known() -> None:
    told = touch(cycle(1.0, vague(1.0, 3.0)), OPTIONS)
    assert told.on_pad, "the mean is still the best that is known"
    assert told.spread_m > 2.4 * 1.2
    assert isinstance(mission_step(landing(), cycle(1.0, vague(1.0, 3.0)), OPTIONS)[1], Target)
    for over_ground in (False, True):
        unknown = cycle(1.0, vague(1.0, 3.0, sigma=0.6), over_ground=over_ground)
        assert isinstance(mission_step(landing(), unknown, OPTIONS)[1], Velocity)
        assert touch(unknown, OPTIONS).lateral_m == pytest.approx(0.3)
    wrong = estimate(1.0, (0.3, 0.0, 3.0), age=5.0, sigma=0.1, consistent=False)
    assert touch(cycle(1.0, wrong), OPTIONS).lateral_m is None


@pytest.mark.hazard("H4")
@pytest.mark.parametrize("age_s", [0.1, 0.9])
def test_it_waits_at_the_gate_for_a_contact_to_come_that_is_slow_and_goes_back_while_it_can(age_s: float) -> None:
    """WHY: feet met the deck at .9 m/s along it where the loop was on its way back to the place (weather_3, 908214)."""
    fast, slow = AtContact(0.1, 0.9, 0.0), AtContact(0.1, 0.1, 0.0)

    def flown(p: Progress, t: float, ahead: AtContact, height_m: float) -> tuple[Progress, float]:
        s = cycle(t, estimate(t, (0.02, 0.0, height_m), age=age_s), at_contact=ahead, climb=ClimbResponse(0.14, 0.12))
        p, aim, _ = mission_step(p, s, OPTIONS)
        assert isinstance(aim, Target)
        assert aim.descent_rate_m_s is not None
        return p, aim.descent_rate_m_s

    gate_m, most_m_s = OPTIONS.cone.gate_m, OPTIONS.cone.commit_rate_m_s
    p, waits = flown(landing(at_s=0.9), 1.0, fast, gate_m)
    assert waits == pytest.approx(0.0, abs=0.01)
    p, down = flown(p, 1.1, slow, gate_m)
    assert down == most_m_s
    p, back = flown(p, 1.2, fast, gate_m - 0.02)
    assert back < 0.0
    p, _ = flown(p, 1.3, slow, gate_m - 0.02)
    p, low = flown(p, 1.4, fast, OPTIONS.cone.feet_below_m + 0.03)
    assert low == most_m_s, "so low a climb comes after the contact"
    assert flown(p, 10.0, fast, gate_m)[1] == most_m_s, "no longer than that"


def test_what_is_announced_just_out_of_sight_knows_that_the_speed_becomes_vague_more_so_over_the_ground() -> None:
    for height_m, least_m in ((1.0, 0.5), (3.0, 1.5)):
        lost = estimate(1.0, (0.1, 0.0, height_m), age=0.6, sigma=0.01)
        by_flow, by_ground = (touch(cycle(1.0, lost, over_ground=ground), OPTIONS).spread_m for ground in (False, True))
        assert least_m < by_flow < by_ground


def test_an_estimate_that_has_stopped_is_announced_as_ever_less_sure() -> None:
    now, *later = (touch(cycle(at, estimate(1.0, (0.4, 0.0, 3.0))), OPTIONS) for at in (1.0, 3.0, 6.0))
    assert [told.unsure for told in (now, *later)] == ["", "last seen 2 s ago", "last seen 5 s ago"]
    assert [told.lateral_m for told in later] == pytest.approx([0.4, 0.4])
    assert now.spread_m < later[0].spread_m < later[1].spread_m


def test_what_left_the_deck_again_goes_down_again_and_nothing_else_follows_a_landing_that_does_not_end() -> None:
    p = structs.replace(landing(), state=State.DOWN, since=ns(0.0), here=Here((0.3, 0.0), frozenset({"velocity"})))
    up = cycle(1.0, estimate(1.0, (0.3, 0.0, 0.6)))
    again, _, changes = mission_step(p, up, OPTIONS)
    assert (again.state, changes[0].reason.cause) == (State.LAND_HERE, ReasonCause.OFF_DECK)
    assert (again.here, again.bounces) == (Here((0.3, 0.0)), 1)
    late = cycle(OPTIONS.land_timeout_s + 0.1, estimate(OPTIONS.land_timeout_s + 0.1, (0.0, 0.0, -0.9), age=3.0, track=2))
    assert mission_step(p, late, OPTIONS)[0].state is State.LAND_HERE
    assert mission_step(p, cycle(1.0, late.estimate), OPTIONS)[0].state is State.DOWN, "a height that drifts and another pad"


@pytest.mark.hazard("H4")
@pytest.mark.parametrize(("over_ground", "here", "stops"), [(True, True, True), (False, True, False), (True, False, False)])
def test_an_autopilot_that_finds_the_ground_before_us_is_ordered_to_stop_its_motors(over_ground, here, stops):
    p, _ = take_status(landing(), status(1.0, flying=False), OPTIONS)
    p = p if here else structs.replace(p, here=None)
    assert p.state is State.LANDED
    p, at_once, _ = mission_step(p, cycle(1.1, over_ground=over_ground), OPTIONS)
    assert at_once == (Land(on_deck=True) if stops else None)
    assert mission_step(p, cycle(3.5, over_ground=over_ground), OPTIONS)[1] is None


def test_a_service_that_comes_back_goes_on_to_the_place_that_was_meant() -> None:
    guidance = back(FlightMemory(ns(100.0), "LAND_HERE", True, 1.0, here=(0.4, 1.0))).pilot.landing
    assert guidance.mission.lands_here
    assert guidance.mission.here == Here((0.4, 1.0))
    assert (guidance.memory.state, guidance.memory.here) == ("LAND_HERE", (0.4, 1.0))
