"""Whole flights: what an ending says, and landings that went wrong once."""

import re
from collections import Counter
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import FlightOutcome, State
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.guidance.pilot import Pilot
from estimator.contracts.time import NS_PER_S
from sitl.campaign.figures import in_words
from sitl.flight.ending import Ending
from sitl.flight.one_flight import TRUTH_EACH, FlyOptions, fly
from sitl.scenario.scenario import load
from sitl.scenario.settings import settings_for
from sitl.scenario.with_fault import faulty
from sitl.world.truth import Truth
from tests.fly import ObservedCalls, land, near, simulate
from tests.make import change
from tests.sitl.campaign.fakes import tally_of


def test_the_same_arguments_give_the_same_ending() -> None:
    scenario = near(duration_limit_s=1.0)
    truth: list[Truth] = []
    first = land(scenario, 3, level="pixels", options=FlyOptions(on_truth=truth.append)).as_json()
    pilots: list[Pilot] = []
    again = land(scenario, 3, level="pixels", options=FlyOptions(render_beside=True, on_pilot=pilots.append)).as_json()
    assert len(pilots) == 1
    assert first.pop("cpu_s") > 0 < again.pop("cpu_s")
    assert first == again
    assert first["outcome"] == "time ran out"
    reported = [sample.at for sample in truth]
    assert reported == sorted(reported)
    assert len(reported) >= 200 // TRUTH_EACH, "one each 20 ms, and one at each exposure"
    assert reported[-1] == 1_000_000_000, "the last one at the end"
    assert land(scenario, 4, level="pixels").as_json()["seed"] == 4


def test_a_hold_in_fast_flight_stops_there_and_does_not_fly_back_to_where_it_was_ordered() -> None:
    orders = ({"order": "stay", "at_s": 0.5}, {"order": "manual", "at_s": 4.0, "forward": 1.0}, {"order": "hold", "at_s": 5.5})
    flown = near(
        duration_limit_s=11.0, faults=[{"kind": "operator"} | order for order in orders], expect="either", because="held"
    )
    truth: list[Truth] = []
    land(flown, 3, options=FlyOptions(on_truth=truth.append))
    far = [float(np.hypot(*one.d_body_pad_level[:2])) for one in truth]
    assert 0.8 < max(far) < far[-1] + 0.3


def test_an_order_that_arrives_after_a_stop_and_was_given_before_it_is_refused() -> None:
    held, late = {"order": "hold", "at_s": 1.0}, {"order": "begin", "late_s": 2.0, "at_s": 2.0}
    faults = [{"kind": "operator"} | order for order in (held, late)]
    ending = land(near(duration_limit_s=4.0, faults=faults, expect="hold", because="a person holds it"), 3)
    assert (ending.judged.unsafe, ending.judged.grade) == ((), "refused rightly")


def test_what_is_flown_on_without_a_link_is_reported_and_is_no_blind_descent() -> None:
    """The drone holds its last command for two seconds, in a descent that no order could end."""
    lost = {"kind": "link_lost", "below_height_m": 1.7, "for_s": 2.5}
    scenario = near(faults=[lost], expect="either", because="it hovers by itself", duration_limit_s=9.0)
    ending = land(scenario, 3)
    assert ending.judged.unsafe == ()
    assert "while nothing reached it" in ending.judged.because


def test_a_link_lost_in_the_descent_ends_on_the_pad_and_what_touched_meanwhile_is_reported() -> None:
    """WHY: it landed by itself up to 1.8 m beside the pad, while guidance took itself to be two metres up."""
    scenario = faulty(load("demo"), 5069, possible=lambda _: True, name="link_lost_4_s")
    ending = land(scenario, 5069)
    assert ending.outcome is FlightOutcome.LANDED
    assert ending.judged.unsafe == ()
    assert ending.judged.contacts_outside_commit == 1, "two seconds with the last command end on the deck; it is counted"
    assert re.search("touched the (deck|pad)", ending.judged.because)


def test_a_sea_that_rises_faster_than_the_drone_climbs_does_not_reach_it_at_the_gate() -> None:
    scenario = load("sea_state_5")
    ending = land(scenario, 204)
    assert ending.judged.contacts_outside_commit == 0
    assert ending.outcome in (FlightOutcome.LANDED, FlightOutcome.REFUSED), "a deck that outruns the climb is refused"


def test_a_campaign_counts_the_flights_in_which_a_sensor_was_named() -> None:
    stuck = {"kind": "accelerometer", "at_s": 1.0, "frozen": True}
    flights = [land(near(duration_limit_s=2.0, faults=faults), 3, level="model").as_json() for faults in ([], [stuck])]
    watched = land(near(duration_limit_s=2.0, faults=[stuck]), 3, level="model", options=FlyOptions(on_start=vars)).as_json()
    assert {**watched, "cpu_s": 0.0} == {**flights[1], "cpu_s": 0.0}, "results that somebody asks for change nothing"
    assert flights[0]["named"] == []
    (named,) = flights[1]["named"]
    assert named["text"] == "the accelerometer repeats its readings; flying without it"
    assert 1.0 < named["at_s"] < 1.3
    summary = tally_of({**flight, "hash": ""} for flight in flights).summary("near", "model", 1.0)
    assert (summary["flights_naming_a_sensor"], summary["named_sensors"]) == (1, {"accelerometer": 1})
    assert "flights in which a sensor was named: 1 (accelerometer in 1)" in in_words(summary)


class Chosen(NullObserver):
    """Counts by what the pad was seen."""

    def __init__(self) -> None:
        self.by: Counter[str | None] = Counter()

    def on_frame(self, processed: ProcessedFrame) -> None:
        if processed.detection is not None:
            self.by[processed.detection.chosen] += 1


def test_a_vehicle_lands_at_night_by_the_lamps_of_the_pad():
    chosen = Chosen()
    start = replace(load("night").start, height_m=2.5)
    ending = land("night", 300, level="pixels", observers=[chosen], start=start).as_json()
    assert ending["landed_on_pad"], ending
    assert ending["touchdown"]["lateral_m"] < 0.1
    assert ending["contacts_outside_commit"] == 0
    assert chosen.by["lamps"] > 100
    # Near the deck the lamps leave the picture, once more with each try.
    assert chosen.by["registration"] < 0.2 * chosen.by["lamps"]


SCENARIO = "sea_state_5"
SEED = 40001
"""A deck that is about to fall away while the drone is at the gate."""


def fly_with_limits(seed: int, **limits: Any) -> tuple[Ending, set[State]]:
    """Return the ending of a flight with other limits, and the states that it came into."""
    settings, calls = change(settings_for(load(SCENARIO), None), guidance={"limits": limits}), ObservedCalls()
    ending = land(SCENARIO, seed, level="model", settings=settings, observers=[calls])
    return ending, {change.target for decision in calls.decisions for change in decision.transitions}


def assert_landed_softly(ending: Ending) -> None:
    assert ending.on_pad
    assert ending.contact.lateral_m < 0.05
    assert ending.contact.vertical_speed_m_s < 0.5


@pytest.mark.hazard("H3")
def test_it_waits_at_the_gate_while_the_deck_will_fall_away_from_a_drone_that_stands_on_it() -> None:
    hasty, _ = fly_with_limits(SEED, deck_fall_m_s=10.0)
    ending, states = fly_with_limits(SEED)
    assert_landed_softly(ending)
    assert_landed_softly(hasty)
    assert len(ending.contacts) == 1
    assert hasty.contacts[0].at < ending.contacts[0].at - NS_PER_S, "without the limit it meets the deck before that falls"
    assert State.GO_AROUND not in states


FEET_M = 0.25


class _Gate(NullObserver):
    def __init__(self) -> None:
        self.heights_m: list[float] = []

    def on_decision(self, decision: Decision) -> None:
        if decision.phase == State.GATE.value and decision.belief is not None:
            self.heights_m.append(decision.belief.height_m)


def flown(feet_m: float | None = None, **changes: float) -> tuple[Ending, list[float]]:
    """Return the ending of a flight with its own feet or others, and its heights at the gate, m."""
    scenario, gate = replace(load("hexa_7kg"), **changes), _Gate()
    settings = settings_for(scenario, None)
    assert settings.guidance.cone.feet_below_m == FEET_M
    cone = replace(settings.guidance.cone, feet_below_m=FEET_M if feet_m is None else feet_m)
    settings = replace(settings, guidance=replace(settings.guidance, cone=cone))
    return fly("hexa_7kg", scenario, 17, settings, "model", observers=[gate]), gate.heights_m


def test_it_waits_with_its_feet_over_the_deck_and_touches_in_the_commit_alone() -> None:
    ending, heights_m = flown()
    assert ending.good
    assert len(ending.contacts) == 1
    assert min(heights_m) > FEET_M + 0.1


@pytest.mark.parametrize("seed", [7020, 7021])
def test_it_touches_nothing_before_its_landing(seed: int) -> None:
    """The accelerometer is wrong by 0.8 m/s^2 for seed 7020; below 0.2 m neither camera nor ultrasound measures the height."""
    ending = land("ardrone1", seed, level="model")
    assert ending.good
    assert len(ending.contacts) == 1


def test_after_a_contact_that_nobody_felt_the_pad_a_third_of_a_metre_from_the_estimate_is_the_same_one() -> None:
    """One of three navdata datagrams comes too late to be used; the go-around begins on the pad."""
    wanted = faulty(load("demo"), 2325, possible=lambda _: True, name="faults/navdata_overtaken")
    assert land(wanted, 2325, level="model", duration_limit_s=120.0).good


def test_from_60_m_away_it_finds_the_ship_and_lands(capsys):
    """The flow measures against the deck, at 1.5 m/s, for a second before it sees the pad: no velocity leaps."""
    code, ending = simulate(capsys, "rendezvous", "--seed", "3014", level="model")
    assert (code, ending["outcome"], ending["landed_on_pad"]) == (0, "landed", True)
    assert ending["contacts_outside_commit"] == 0
    assert ending["duration_s"] < 90.0


@pytest.mark.parametrize(
    ("words", "code", "reason"),
    [
        (["faults/ship_place_stops"], 0, "the ship's newest place is"),
        (["faults/ship_place_jumps"], 0, "reported place jumped"),
        (["faults/ship_place_late"], 0, "come too late"),
        (["rendezvous", "--set", "vehicle.gnss_hz=0"], 1, "the drone does not know its own place (no GNSS)"),
    ],
)
def test_places_that_are_wrong_or_missing_are_refused_with_their_reason(capsys, monkeypatch, words, code, reason):
    monkeypatch.setattr("sitl.flight.afterwards.WATCHED_S", 2.0)
    ended, ending = simulate(capsys, *words)
    assert (ended, ending["outcome"], ending["contacts"]) == (code, "refused", [])
    assert reason in str(ending["refused"])
