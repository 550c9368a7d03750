"""The flight to the ship by her reports: to the hold-off point, over the pattern, never down, refused in time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.mission import State, StateChange
from companion.base.reason import Reason, ReasonCause
from companion.guidance.controller import Knowledge
from companion.guidance.mission import search
from companion.guidance.mission.cycle import GuidanceCycle, VehicleHold, VesselPosition
from companion.guidance.mission.machine import mission_step, take_status
from companion.guidance.mission.progress import Progress
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.guidance import GuidanceOptions
from companion.settings.vessel import RendezvousOptions
from estimator.contracts.commands import Velocity
from tests.make import estimate, ns, status

OPTIONS = RendezvousOptions(enabled=True)
DT = 0.1


def place(d, *, v=(0.0, 0.0), axis=0.0, bow=True, height=10.0, t=0.0, sigma=2.0) -> VesselPosition:
    return VesselPosition(ns(t), np.array(d, float), sigma, np.array(v, float), axis, bow, height)


def fly(d, *, v=(0.0, 0.0), axis=0.0, bow=True, height=10.0, seconds=120.0, known=lambda t: True, seen=lambda t, d: False):
    """Fly a point by the machine; return its states, its ways from body to pad, and its heights."""
    o = GuidanceOptions(rendezvous=OPTIONS)
    p, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    d, own = np.array(d, float), np.zeros(2)
    states: list[State] = []
    ways, heights, changes = [], [], list[StateChange]()
    for n in range(round(seconds / DT)):
        t = n * DT
        vessel = place(d, v=v, axis=axis, bow=bow, height=height, t=t) if known(t) else Reason(ReasonCause.VESSEL_SILENT)
        sight = estimate(t, [*d, height]) if seen(t, d) else None
        s = GuidanceCycle(ns(t), Knowledge(ns(t), sight), vessel=vessel)
        p, aim, made = mission_step(p, s, o)
        changes += made
        states.append(p.state)
        ways.append(d.copy())
        heights.append(height)
        if p.state in (State.INTERCEPT, State.REFUSED, State.GAVE_UP):
            break
        wanted = aim.v_level if isinstance(aim, Velocity) else np.zeros(3)
        assert wanted[2] <= 0.0
        own = own + (wanted[:2] - own) * DT / 0.5
        d = d + (np.array(v) - own) * DT
        height -= wanted[2] * DT
    return states, ways, heights, changes


@pytest.mark.parametrize(("north", "east"), [(60.0, 0.0), (-60.0, 5.0), (0.0, 60.0), (40.0, -40.0)])
@pytest.mark.parametrize("axis", [0.0, 2.0, -1.0])
def test_from_every_side_it_comes_behind_a_moving_ship_and_not_over_her(north: float, east: float, axis: float) -> None:
    v = 1.5 * np.array([math.cos(axis), math.sin(axis)])
    states, ways, *_ = fly([north, east], v=v, axis=axis)
    assert State.RENDEZVOUS in states
    arrival = next(n for n, state in enumerate(states) if state is State.SEARCH and n > states.index(State.RENDEZVOUS))
    behind = ways[arrival] @ np.array([math.cos(axis), math.sin(axis)])
    assert behind == pytest.approx(OPTIONS.range_m, abs=OPTIONS.reached_m)
    on_the_way = [math.hypot(*way) for way, state in zip(ways, states, strict=True) if state is State.RENDEZVOUS]
    assert min(on_the_way) > 0.6 * OPTIONS.range_m
    nearest = min(math.hypot(*way) for way in ways[arrival:])
    assert nearest < 1.0, "the search begins over the pad's reported place"
    assert max(math.hypot(*way) for way in ways[arrival:]) < math.sqrt(2.0) * OPTIONS.extent_m + 2.0


def test_without_a_bow_it_holds_off_on_its_own_side() -> None:
    point = search.hold_off(place([60.0, 0.0], bow=False), OPTIONS)
    assert point == pytest.approx([60.0 - OPTIONS.range_m, 0.0])


def test_it_climbs_to_the_height_over_the_pad_and_stays_higher_if_it_is() -> None:
    _, _, low, _ = fly([60.0, 0.0], height=2.0, seconds=40.0)
    assert OPTIONS.height_m - 0.6 <= low[-1] <= OPTIONS.height_m
    _, _, high, _ = fly([60.0, 0.0], height=30.0, seconds=40.0)
    assert set(high) == {30.0}


def test_the_pad_in_sight_ends_it_anywhere() -> None:
    states, *_ = fly([60.0, 0.0], seen=lambda t, d: math.hypot(*d) < 30.0)
    assert states[-1] is State.INTERCEPT
    assert State.RENDEZVOUS in states


def test_a_source_that_stops_is_waited_for_and_then_refused_with_its_reason() -> None:
    states, _, _, changes = fly([60.0, 0.0], known=lambda t: t < 5.0)
    assert states[-1] is State.REFUSED
    assert changes[-1].reason.cause is ReasonCause.VESSEL_SILENT
    assert len(states) * DT == pytest.approx(5.0 + OPTIONS.lost_s, abs=0.3)
    states, _, _, _ = fly([60.0, 0.0], known=lambda t: not 5.0 < t < 12.0)
    assert State.REFUSED not in states, "a gap shorter than that is bridged"


def test_a_pad_in_sight_needs_no_place_of_the_ship() -> None:
    states, *_ = fly([3.0, 0.0], known=lambda t: False, seen=lambda t, d: t > 2.0)
    assert states[-1] is State.INTERCEPT


def test_a_ship_that_is_never_reached_is_given_up() -> None:
    o = GuidanceOptions(rendezvous=RendezvousOptions(enabled=True, time_s=5.0))
    p, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    for n in range(70):
        s = GuidanceCycle(ns(n * DT), Knowledge(ns(n * DT), None), vessel=place([60.0, 0.0], t=n * DT))
        p, _, _ = mission_step(p, s, o)
    assert p.state is State.GAVE_UP


def test_the_tilt_of_the_way_is_not_taken_for_wind_and_that_of_the_wind_is() -> None:
    o = GuidanceOptions(rendezvous=OPTIONS)
    way_s, strong, calm = (
        3.0,
        WindOverDrone(12.0, 1.0, 8.0, (1.0, 0.0), 0.4, True),
        WindOverDrone(1.0, 1.0, 8.0, (1.0, 0.0), 0.1, False),
    )
    p, _ = take_status(Progress.start(automatic=True), status(0.0, True), o)
    states = []
    for n in range(round((way_s + 20.0) / DT)):
        t = n * DT
        far_away = [60.0, 0.0] if t < way_s else [OPTIONS.range_m, 0.0]
        s = GuidanceCycle(ns(t), Knowledge(ns(t), None), wind=strong if t > 0.5 else calm, vessel=place(far_away, t=t))
        p, _, changes = mission_step(p, s, o)
        states.append(p.state)
        if p.state is State.REFUSED:
            assert changes[-1].reason.cause is ReasonCause.WIND
            break
    assert State.RENDEZVOUS in states
    assert states[-1] is State.REFUSED
    assert way_s + 17.0 < len(states) * DT < way_s + 19.0, (
        "10 s in which the tilt of the way fades, then 8 s of too strong a wind"
    )


def test_the_square_expands_and_begins_again() -> None:
    corners = [tuple(search.expanding_square(n)) for n in range(7)]
    assert corners == [(0, 0), (1, 0), (1, 1), (-1, 1), (-1, -1), (2, -1), (2, 2)]
    leg, seen = 0, []
    for _ in range(60):
        corner = search.expanding_square(leg) * OPTIONS.spacing_m
        seen.append(leg)
        leg = search.next_leg(leg, place(-corner), OPTIONS)
    assert seen.count(0) > 1
    assert max(math.hypot(*search.expanding_square(n)) * OPTIONS.spacing_m for n in seen) >= OPTIONS.extent_m - OPTIONS.spacing_m


ANY = st.floats(-300, 300)


@given(ANY, ANY, ANY, ANY, st.floats(-10, 10), st.one_of(st.none(), st.floats(-50, 300)), st.integers(0, 40), st.booleans())
def test_no_place_of_the_ship_brings_it_down_or_makes_it_too_fast(x, y, vx, vy, axis, height, leg, over_ground):
    at = place([x, y], v=(vx, vy), axis=axis, height=height)
    for command, most in (
        (search.to_hold_off(at, OPTIONS, 0.5, VehicleHold(over_ground)), OPTIONS.speed_m_s),
        (search.along_pattern(leg, at, OPTIONS, 0.5, VehicleHold(over_ground)), OPTIONS.search_speed_m_s),
    ):
        assert command.v_level[2] <= 0.0
        relative = command.v_level[:2] - (0.0 if over_ground else at.v_level)
        assert math.hypot(*relative) <= most + 1e-9
