"""Low over the deck without sight: in every state it climbs, moves nowhere else, and not for ever."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.base.mission import ENDED, FLOWN, GROUND, State
from companion.guidance.controller import Knowledge
from companion.guidance.mission.machine import mission_step
from companion.guidance.mission.progress import GuidanceCycle, Progress, VehicleHold
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Hover, Velocity
from estimator.contracts.estimates import IntegrityAlert
from tests.companion.test_mission_flights import holding
from tests.make import deck, estimate, ns, vessel_position

NOW, DT = 100.0, 0.05
OPTIONS = GuidanceOptions()
SAFE_M = OPTIONS.tries.safe_height_m
WINDY = WindOverDrone(9.0, 1.0, 12.0, (0.6, 0.8), 0.3, False, 0.4)
BY_ITSELF = sorted(FLOWN - {State.COMMIT, State.PRESS, State.DOWN} | {State.REFUSED, State.GAVE_UP}, key=str)
HELD = [State.PAUSED, State.ABORTED]

heights = st.one_of(st.just(math.inf), st.floats(0.0, 6.0))
memories = st.fixed_dictionaries(
    {
        "seen_height_m": heights, "was_silent": st.booleans(), "climbed_m": st.floats(0.0, 5.0),
        "deck_rise_m": st.floats(-2.0, 2.0), "in_sight": st.just(False),
        "seen": st.sampled_from([None, ns(NOW - 0.3)]), "go_arounds": st.integers(0, 2),
    }
)  # fmt: skip


def waiting(state: State, **memory: Any) -> Progress:
    return Progress(state, automatic=True, begun=True, stood=False, since=ns(NOW - 1.0), last=ns(NOW - DT), **memory)


@pytest.mark.hazard("H3")
@settings(max_examples=300)
@given(
    state=st.sampled_from(BY_ITSELF + HELD),
    memory=memories,
    range_m=st.one_of(st.none(), st.floats(0.02, 6.0)),
    rises_m_s=st.one_of(st.none(), st.floats(-1.0, 1.0)),
    ship=st.one_of(st.none(), st.builds(lambda h: vessel_position(NOW, height_m=h), st.one_of(st.none(), st.floats(-1.0, 9.0)))),
    over_ground=st.booleans(),
)
def test_no_order_moves_a_drone_along_a_deck_that_may_be_within_reach(state, memory, range_m, rises_m_s, ship, over_ground):
    moved = None if rises_m_s is None else deck(NOW, (0.5, 0.0, -rises_m_s))
    s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None, deck=moved), wind=WINDY, vessel=ship, range_m=range_m)
    p, found, _ = mission_step(waiting(state, **memory), holding(s, over_ground), OPTIONS)
    if p.state in GROUND or p.state in ENDED - {State.REFUSED, State.GAVE_UP, State.ABORTED}:
        return
    assert isinstance(found, Velocity | Hover)
    v = found.v_level if isinstance(found, Velocity) else np.zeros(3)
    assert v[2] <= 0.0, "without sight it never goes lower"
    from_m = 0.0 if math.isinf(memory["seen_height_m"]) or memory["was_silent"] else memory["seen_height_m"]
    near = range_m is not None and range_m < SAFE_M - 0.25
    if near and memory["climbed_m"] + from_m < 2.0 * SAFE_M:
        assert v[2] <= -OPTIONS.tries.climb_m_s, "the range sensor finds the deck"
        assert v[:2].tolist() == [0.0, 0.0]
    if v[2] < 0.0 and not (p.state in (State.RENDEZVOUS, State.SEARCH) and ship is not None):
        assert v[:2].tolist() == [0.0, 0.0]


class Sea:
    """A drone that flies as it is ordered, with a lag, over a deck in a swell, and sees nothing."""

    def __init__(
        self, state: State, height_m: float, *, ranged: float | bool | None, over_ground: bool = False, swell_m: float = 0.0
    ) -> None:
        self.p = waiting(state)
        self.o = replace(OPTIONS, tries=replace(OPTIONS.tries, search_s=3600.0, give_up_after_s=600.0, operator_wait_s=3600.0))
        self.height_m, self.v_up, self.t = height_m, 0.0, 0.0
        self.ranged, self.over_ground, self.swell_m = ranged, over_ground, swell_m
        self.low_moves, self.climbed_m = 0.0, 0.0

    def fly(self, seconds: float) -> "Sea":
        for _ in range(round(seconds / DT)):
            deck_up = self.swell_m * math.cos(math.tau * self.t / 9.0) * math.tau / 9.0
            read = self.height_m if self.ranged is True else self.ranged
            s = GuidanceCycle(
                ns(NOW + self.t), Knowledge(ns(NOW + self.t), None, climb_max_m_s=1.0), wind=WINDY, range_m=read or None
            )
            self.p, found, _ = mission_step(self.p, holding(s, self.over_ground), self.o)
            v = found.v_level if isinstance(found, Velocity) else np.zeros(3)
            self.v_up += (-float(v[2]) - self.v_up) * DT / 0.4
            self.climbed_m += DT * self.v_up
            if self.height_m < 1.0:
                self.low_moves = max(self.low_moves, math.hypot(*v[:2]))
            self.height_m = max(0.0, self.height_m + DT * (self.v_up - deck_up))
            self.t += DT
        return self


@pytest.mark.parametrize(("over_ground", "ranged"), [(False, True), (True, True), (True, False)])
@pytest.mark.parametrize("state", BY_ITSELF)
def test_from_the_deck_it_comes_out_of_reach_in_every_state(state: State, ranged: bool, over_ground: bool) -> None:
    sea = Sea(state, 0.3, ranged=ranged, over_ground=over_ground).fly(9.0)
    assert sea.height_m > SAFE_M - 0.3
    assert sea.low_moves == 0.0
    flown = sea.fly(60.0)
    assert flown.climbed_m < 2.0 * SAFE_M + 0.5, "and stays there"


@pytest.mark.parametrize("state", [State.SEARCH, State.HOLD_BLIND, State.REFUSED, State.PAUSED])
def test_over_a_swell_a_range_sensor_keeps_it_clear_of_the_crests(state: State) -> None:
    sea = Sea(state, 0.5, ranged=True, swell_m=1.2).fly(12.0)
    lowest = min(sea.fly(DT).height_m for _ in range(1200))
    assert lowest > 1.0
    assert sea.low_moves == 0.0


@pytest.mark.parametrize("state", [State.SEARCH, State.REFUSED, State.PAUSED, State.RENDEZVOUS])
def test_a_range_sensor_that_lies_ends_neither_the_search_nor_the_hold(state: State) -> None:
    sea = Sea(state, 3.0, ranged=0.3).fly(60.0)
    assert sea.climbed_m == pytest.approx(2.0 * SAFE_M, abs=0.3)
    s = GuidanceCycle(ns(NOW + 60.0), Knowledge(ns(NOW + 60.0), None), wind=WINDY, range_m=0.3)
    found = mission_step(sea.p, s, sea.o)[1]
    assert (isinstance(found, Velocity) and bool(found.v_level[:2].any())) is (state is State.SEARCH), "it looks upwind"


@pytest.mark.parametrize("over_ground", [True, False])
def test_where_an_ultrasound_would_find_the_deck_its_silence_begins_the_search(over_ground: bool) -> None:
    s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None), wind=WINDY, hold=VehicleHold(over_ground))
    found = mission_step(waiting(State.SEARCH), s, OPTIONS)[1]
    assert (isinstance(found, Velocity) and bool(found.v_level[:2].any())) is not over_ground


def test_a_nearer_range_is_believed_while_the_unseen_deck_is_thought_to_fall() -> None:
    """WHY: a filter that begins anew takes a deck for one that falls from its crest, and the deck came up."""
    for range_m, climbs in ((1.0, True), (None, False), (1.9, False)):
        s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None, deck=deck(NOW, (0.5, 0.0, 0.8))), range_m=range_m)
        found = mission_step(waiting(State.HOLD_BLIND, seen_height_m=2.5, deck_rise_m=-1.0), s, OPTIONS)[1]
        assert isinstance(found, Velocity) is climbs


@pytest.mark.parametrize("state", HELD)
def test_what_a_person_holds_moves_by_a_witness_alone(state: State) -> None:
    """A person who pauses it high up without a range sensor does not want to see it climb."""
    for memory, range_m, climbs in (
        ({}, None, False), ({}, 0.4, True), ({}, 3.0, False), ({"seen_height_m": 0.4}, None, True),
        ({"seen_height_m": 5.0}, 0.4, True),
    ):  # fmt: skip
        s = GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None), range_m=range_m)
        found = mission_step(waiting(state, **memory), s, OPTIONS)[1]
        assert isinstance(found, Velocity) is climbs
        stands = mission_step(replace(waiting(state, **memory), stood=True), s, OPTIONS)[1]
        assert state is State.PAUSED or stands == Hover(), "what was landed since is not taken off"


@pytest.mark.parametrize(
    ("age_s", "range_m", "height_m", "alerts", "climbs"),
    [
        (20.0, 5.0, 5.1, (), False),
        (20.0, 5.0, 3.9, (), True),
        (20.0, 6.0, 4.5, (), True),
        (20.0, None, 5.1, (), True),
        (0.0, None, 5.1, (), False),
        (20.0, 5.0, 5.1, (IntegrityAlert.RANGE,), True),
    ],
)
def test_a_refused_drone_climbs_no_further_where_range_and_estimate_agree_that_it_is_high(
    age_s, range_m, height_m, alerts, climbs
):
    """WHY: each wave lifted it a little without counting, and after it gave up it climbed by 3 m more, to 8.6 m."""
    seen = replace(estimate(NOW, (0.0, 0.0, height_m), age=age_s, sigma=0.2), alerts=alerts)
    p = waiting(State.GAVE_UP, seen_height_m=0.4, climbed_m=1.5)
    p, _, _ = mission_step(p, GuidanceCycle(ns(NOW), Knowledge(ns(NOW), seen), range_m=range_m), OPTIONS)
    lost = GuidanceCycle(ns(NOW + DT), Knowledge(ns(NOW + DT), None))
    _, found, _ = mission_step(p, lost, OPTIONS)
    assert (isinstance(found, Velocity) and bool(found.v_level[2] < 0.0)) is climbs
