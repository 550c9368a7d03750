"""A contact on a deck that then falls faster than the vehicle's own landing: it is not made, and if it was it is noticed."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from companion.guidance.mission import Event, State, StateChange
from companion.guidance.reason import ReasonCause
from companion.runtime.observer import Decision, NullObserver
from sitl.ending import Ending
from sitl.one_flight import fly, perception_level, settings_for
from sitl.scenario import load

ROUGH, FALLING = ("sea_state_4", 21037), ("sea_state_5", 21023)
"""Scenarios with seeds: a deck that is about to fall away at the gate, and one that falls away as it is met."""


class _Changes(NullObserver):
    def __init__(self) -> None:
        self.all: list[StateChange] = []

    def on_decision(self, decision: Decision) -> None:
        self.all.extend(decision.transitions)


def flown(flight: tuple[str, int], commit_rate_m_s: float | None = None, **limits: Any) -> tuple[Ending, list[StateChange]]:
    (name, seed), scenario = flight, load(flight[0])
    settings = settings_for(scenario, None)
    guidance = replace(settings.guidance, limits=replace(settings.guidance.limits, **limits))
    if commit_rate_m_s is not None:
        guidance = replace(guidance, cone=replace(guidance.cone, commit_rate_m_s=commit_rate_m_s))
    changes = _Changes()
    ending = fly(name, scenario, seed, replace(settings, guidance=guidance), perception_level("model"), observers=[changes])
    return ending, changes.all


def assert_landed_softly(ending: Ending) -> None:
    assert ending.on_pad
    assert ending.contact is not None
    assert ending.contact.lateral_m < 0.05
    assert ending.contact.vertical_speed_m_s < 0.5


def test_it_waits_at_the_gate_while_the_deck_will_fall_away_from_a_drone_that_stands_on_it() -> None:
    ending, changes = flown(ROUGH)
    assert_landed_softly(ending)
    assert len(ending.contacts) == 1
    assert State.GO_AROUND not in {change.target for change in changes}


def test_a_drone_that_is_in_the_air_again_after_the_contact_goes_around() -> None:
    ending, changes = flown(FALLING, commit_rate_m_s=0.45, deck_fall_m_s=10.0)
    (around,) = (change for change in changes if change.target is State.GO_AROUND)
    assert (around.source, around.event, around.reason.cause) == (State.DOWN, Event.LIMIT, ReasonCause.OFF_DECK)
    assert around.reason.measured == pytest.approx(1.24, abs=0.1)
    assert_landed_softly(ending)
    assert len(ending.contacts) == 2
