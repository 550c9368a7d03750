"""A response that a flight has found reaches recording, events, metrics and the ground station."""

from typing import Any

from companion.base.observer import Decision
from companion.base.response_in_use import ResponseInUse, ResponseState, TiltShape
from companion.parts.mavlink.component import Component, ComponentOptions
from companion.parts.mavlink.outputs import MavSeverity
from estimator.contracts.time import MonoNs
from tests.support.clocks import SteppedClock

ASSUMED = ResponseInUse(ResponseState.ASSUMED, 0.05, None)
KNOWN = ResponseInUse(ResponseState.KNOWN, 0.05, 0.02)
LATER = ResponseInUse(ResponseState.IDENTIFIED, 0.15, 0.012, 0.1)
SLOWER = ResponseInUse(ResponseState.KNOWN, 0.05, 0.02, shape=TiltShape(0.75, 0.9, 2.0, 0.05))
ALL = (ASSUMED, KNOWN, LATER, SLOWER)


def decision(response: ResponseInUse | None, at: int = 7) -> Decision:
    return Decision(MonoNs(at), "descend", None, None, response=response)


def test_the_ground_station_learns_of_a_contradiction_only() -> None:
    class Nobody:
        def __getattr__(self, name: str) -> Any:
            raise AssertionError(name)

    component = Component(ComponentOptions(0.39, 0.5), Nobody(), None, healthy=lambda: None, clock=SteppedClock())  # type: ignore[arg-type]
    output: list[tuple[MavSeverity, str]] = []
    component.texts.say = lambda severity, words, now: output.append((severity, words))  # type: ignore[method-assign,assignment]
    for response in ALL:
        component.on_decision(decision(response))
    told = [one for one in output if "answers" in one[1] or "response" in one[1]]
    assert [severity for severity, _ in told] == 2 * [MavSeverity.WARNING]
    assert LATER.text in told[0][1]
    assert "this vehicle answers 25 % slower than its file (sigma 5 %), damped 10 % less; the vehicle's" in told[1][1]
