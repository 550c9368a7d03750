"""The way points of the thesis' mission, its gate over the last of them, and the vehicle's own landing from there."""

import pytest

from companion.base.mission import Event, ReasonCause, State
from companion.guidance.mission.gate import gate_of
from companion.guidance.mission.machine import account
from estimator.contracts.commands import Land
from tests.companion.test_mission_flights import guided
from tests.companion.test_mission_states import cycle, first, memory, sees
from tests.companion.test_steer import LOW, asked, known, may_descend


@pytest.mark.parametrize(
    ("state", "d", "event"),
    [
        (State.INTERCEPT, (0.1, 0.2, 2.1), Event.IN_CONE), (State.INTERCEPT, (0.1, 0.3, 2.1), None),
        (State.DESCEND, (0.1, 0.0, 0.35), Event.AT_GATE), (State.DESCEND, (0.1, 0.13, 0.35), None),
        (State.GATE, (0.1, 0.23, 0.3), None), (State.GATE, (0.1, 0.25, 0.3), Event.OUT_OF_CONE),
    ],
)  # fmt: skip
def test_the_way_points_of_the_thesis(state: State, d: tuple[float, float, float], event: Event | None) -> None:
    o = guided("thesis", thesis={"pad_ahead_m": 0.1})
    found = first(memory(state), cycle(sees(d)), o)
    assert (None if found is None else found[0]) is event


@pytest.mark.parametrize(
    ("d", "v", "cause"),
    [
        ((0.1, 0.0, 0.3), (0.0, 0.0, 0.0), None), ((0.3, 0.1, 0.3), (0.0, 0.0, 0.0), ReasonCause.ERROR),
        ((0.1, 0.0, 0.43), (0.0, 0.0, 0.0), ReasonCause.ERROR), ((0.1, 0.0, 0.3), (0.21, 0.0, 0.0), ReasonCause.ERROR_AHEAD),
        ((0.1, 0.05, 0.3), (0.15, -0.1, 0.0), None),
    ],
)  # fmt: skip
def test_the_thesis_gate_opens_over_the_last_way_point_now_and_at_the_touchdown(d, v, cause):
    o = guided("thesis", thesis={"pad_ahead_m": 0.1})
    blocked = gate_of(account(memory(State.GATE), cycle(sees(d, v=v)), o)).blocked
    assert (None if blocked is None else blocked.cause) is cause


def test_on_the_way_to_its_first_point_the_drone_may_descend_too() -> None:
    assert may_descend(0.0, guided("thesis")) - may_descend(0.0, guided()) == {State.INTERCEPT}


def test_from_the_last_point_down_the_vehicle_lands_by_itself() -> None:
    assert asked(State.DOWN, known((0.0, 0.0, 0.1)), guided("thesis"), **LOW)[1] == Land(on_deck=False)
