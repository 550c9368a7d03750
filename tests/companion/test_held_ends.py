"""The charge of a drone that a person left in the air: told in time, and ended as he has chosen beforehand."""

from itertools import product
from typing import Any

import pytest
from msgspec.structs import replace

from companion.base.mission import Event, Reason, ReasonCause, State, StateChange
from companion.guidance.landing import LandingGuidance, PilotOptions
from companion.guidance.mission.charge import ChargeWatch
from companion.guidance.mission.machine import PHASES, mission_step, take_order
from companion.guidance.mission.progress import HELD_BY_PERSON, VehicleHold, entered
from companion.settings.guidance import GuidanceOptions
from companion.settings.load import from_mapping
from estimator.contracts.commands import Hover
from tests.companion.test_mission_states import NOW, blind, cycle, first, memory, sees
from tests.make import ns, status

LANDS, RETURNS = GuidanceOptions(), GuidanceOptions(held_ends="return")
WORD = GuidanceOptions(held_ends="hold")
HELD = sorted(HELD_BY_PERSON, key=str)


@pytest.mark.hazard("H10", "A5")
@pytest.mark.parametrize("state", HELD)
def test_a_held_drone_ends_as_its_person_has_chosen_and_by_default_on_the_deck(state: State) -> None:
    for battery, sight in product((0.11, 0.09, 0.05, 0.01, 0.0), (sees(), None)):
        s = cycle(sight, battery=battery)
        assert first(memory(state, 60.0), s, WORD) is None, "nothing of ours lands against a person's order to hold"
        assert first(memory(state, 9.9), s, LANDS) is None, "it is told first"
        assert first(memory(state, 60.0, stood=True), s, LANDS) is None
        assert first(memory(state, 60.0), replace(s, by_hand=True), LANDS) is None
        found = first(memory(state, 60.0), s, LANDS)
        wanted = Event.LAND if battery <= 0.05 else Event.BATTERY_ENDS if battery < 0.1 and sight is not None else None
        assert (None if found is None else found[0]) is wanted


@pytest.mark.parametrize("state", HELD)
def test_an_order_that_calls_the_end_off_stands_for_the_flight(state: State) -> None:
    why = Reason(ReasonCause.LANDS_HERE, 4.0, 5.0)
    p = entered(memory(state, 60.0), StateChange(ns(NOW), state, Event.LAND, State.LAND_HERE, why))
    p = entered(p, StateChange(ns(NOW), State.LAND_HERE, Event.HOLD, State.PAUSED, Reason(ReasonCause.OPERATOR)))
    later = replace(p, since=ns(NOW - 60.0))
    assert first(later, cycle(sees(), battery=0.03), LANDS) is None
    again = entered(later, StateChange(ns(NOW), State.LANDED, Event.TAKEN_OFF, State.READY, why))
    assert not again.end_begun, "another flight"


def test_what_an_autopilot_flies_before_our_first_order_is_left_to_whoever_flies_it() -> None:
    s = cycle(sees(), battery=0.03, hold=VehicleHold(over_ground=True))
    assert first(memory(State.READY, 60.0), s, LANDS) is None
    assert first(memory(State.PAUSED, 60.0), s, LANDS) is not None


@pytest.mark.parametrize("state", [State.PAUSED, State.ABORTED])
def test_an_autopilot_flies_back_with_the_last_charge_where_the_settings_say_so(state: State) -> None:
    for battery, options, returns in ((0.05, RETURNS, True), (0.06, RETURNS, False), (0.05, WORD, False), (0.05, LANDS, False)):
        s = cycle(battery=battery, hold=VehicleHold(over_ground=True))
        found = PHASES[state].aim(blind(state, 60.0, climbed_m=50.0), s, options)[1]
        assert (found == Hover(returns=True)) is returns
    data: dict[str, Any] = {
        "vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}, "guidance": {"held_ends": "return"},
    }  # fmt: skip
    assert "has no return" in next(from_mapping(data, "x").faults(), "")


@pytest.mark.hazard("H6")
@pytest.mark.parametrize("order", [Event.HOLD, Event.ABORT])
@pytest.mark.parametrize("state", [State.PAUSED, State.ABORTED, State.REFUSED, State.GAVE_UP])
def test_a_way_back_or_elsewhere_that_began_by_itself_ends_by_an_order_for_the_flight(state: State, order: Event) -> None:
    """An order to hold was refused while a drone that had refused its landing flew back, as its flight was over."""
    s = cycle(battery=0.05, hold=VehicleHold(over_ground=True))
    o = replace(RETURNS, refused="return")
    p, found = PHASES[state].aim(blind(state, 60.0, climbed_m=50.0), s, o)
    assert found == Hover(returns=True)
    p, _ = take_order(p, order, ns(NOW), o)
    assert p.state is (State.ABORTED if state is State.ABORTED or order is Event.ABORT else State.PAUSED)
    for battery in (0.9, 0.05) if state in HELD_BY_PERSON else (0.9,):
        stays = PHASES[p.state].aim(replace(p, since=ns(NOW - 60.0)), replace(s, battery=battery), o)[1]
        assert stays != Hover(returns=True)
    assert state is State.PAUSED or not take_order(memory(state, 60.0, stood=True), order, ns(NOW), o)[1]


@pytest.mark.hazard("H10", "A5")
@pytest.mark.parametrize(
    ("order", "by_hand", "options", "said"),
    [
        (Event.HOLD, False, WORD, "it holds on until it falls: land it"),
        (Event.ABORT, False, WORD, "it holds on until it falls: land it"),
        (Event.HOLD, False, LANDS, "at 10 % it lands on a pad in sight, at 5 % where it is"),
        (Event.HOLD, False, RETURNS, "at 5 % it flies back by the autopilot's own return"),
        (Event.HOLD, True, LANDS, "whoever flies it has to land it before"),
        (None, False, WORD, "it holds on until it falls: land it"),
    ],
)
def test_whoever_left_it_in_the_air_reads_in_time_how_its_charge_ends(order, by_hand, options, said) -> None:
    guidance = LandingGuidance(options, PilotOptions(automatic=False))
    guidance.on_samples([status(0.5, flying=False), status(1.0)])
    assert guidance.state is State.READY
    if order is not None:
        guidance.order(order, ns(2.0))
    guidance.by_hand = by_hand
    for t in range(3, 400):
        charge = 0.6 - 0.001 * t
        guidance.on_samples([status(float(t), battery_fraction=round(charge, 2))])
        if guidance.charge:
            break
    assert 0.2 <= charge < 0.26, "four minutes at a tenth of a percent a second, before any limit"
    assert guidance.charge.startswith("battery at 25 %, about 4 min left: ")
    assert guidance.charge.endswith(said)
    assert guidance.charge in guidance.reason


def test_the_time_that_is_left_follows_the_measured_rate_and_another_battery() -> None:
    watch = ChargeWatch()
    for t in range(0, 300, 2):
        watch = watch.reported(ns(t), round(0.5 - t / 900.0, 2))
        left = watch.left_s(ns(t))
        if t < 20:
            assert left is None
        elif left is not None:
            assert left == pytest.approx(450.0 - t, rel=0.15, abs=20.0)
    assert left is not None
    assert watch.reported(ns(301.0), 0.95).left_s(ns(301.0)) is None
    assert watch.reported(ns(301.0), None).left_s(ns(301.0)) is None


def test_the_machine_lands_a_held_drone_where_it_is_with_its_last_charge() -> None:
    s = cycle(battery=0.04)
    assert mission_step(blind(State.PAUSED, 60.0), s, LANDS)[0].lands_here
    assert mission_step(blind(State.PAUSED, 60.0), s, WORD)[0].state is State.PAUSED
