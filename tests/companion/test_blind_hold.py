"""Flight without sight of the pad: it needs a good estimate, and never goes lower than the deck does."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import State
from companion.guidance.controller import Knowledge
from companion.guidance.mission.cycle import GuidanceCycle, VehicleHold
from companion.guidance.mission.machine import allowed
from companion.guidance.mission.phase import never_lower, usable
from companion.guidance.mission.progress import Progress
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.commands import Command, Hover, Land, Lean, Velocity
from estimator.contracts.estimates import IntegrityAlert, RelativeState
from tests.companion.mission_flights import guided
from tests.make import deck, estimate, ns

NOW = 20.0


def falling(down_m_s: float | None, sigma_m_s: float = 0.0, *, over_ground: bool = False) -> GuidanceCycle:
    var = (1.0, 1.0, sigma_m_s**2, 1.0, 1.0, 1.0)
    moves = None if down_m_s is None else deck(NOW, (3.0, 0.0, down_m_s), var=var)
    return GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None, deck=moves), hold=VehicleHold(over_ground))


def commands(down_m_s: float) -> tuple[Velocity, Lean]:
    v = np.array([0.4, -0.3, down_m_s])
    return Velocity(v, 0.1), Lean(np.ones(2), np.zeros(2), v, 0.1)


@pytest.mark.hazard("H1")
@pytest.mark.parametrize(
    ("deck_m_s", "fit", "over_ground", "velocity_m_s", "lean_m_s"),
    [
        (0.2, True, False, 0.2, 0.2),
        (0.2, True, True, 0.0, 0.2),
        (0.2, False, False, 0.0, 0.0),
        (0.9, True, False, 0.5, 0.5),
        (-0.3, True, False, 0.0, 0.0),
        (None, True, False, 0.0, 0.0),
    ],
)
def test_nothing_goes_down_but_with_a_deck_that_is_known_to_fall(deck_m_s, fit, over_ground, velocity_m_s, lean_m_s):
    s = falling(deck_m_s, over_ground=over_ground)
    for command, rate in zip(commands(0.5), (velocity_m_s, lean_m_s), strict=True):
        slower = never_lower(command, s, fit=fit)
        assert type(slower) is type(command)
        assert (slower.v_level.tolist(), slower.yaw_rate_rad_s) == ([0.4, -0.3, rate], 0.1)
    unsure = never_lower(commands(0.5)[1], falling(0.3, 0.1), fit=True)
    assert isinstance(unsure, Lean)
    assert unsure.v_level[2] == pytest.approx(0.1), "as far as it is certain"
    others: list[Command] = [*commands(-0.4), *commands(0.0), Hover(), Land(on_deck=True)]
    assert all(never_lower(each, s, fit=False) is each for each in others)


def allowed_in(state: State, command: Command, s: GuidanceCycle) -> Command:
    return allowed(command, Progress(state, automatic=True, begun=True), s, GuidanceOptions())


def test_a_climb_without_sight_and_a_press_have_their_least_rate() -> None:
    """WHY: an accelerometer that was wrong at the contact made the estimate sink into the deck, and the drone floated off."""
    o, s = GuidanceOptions(), falling(0.2)
    for asked_m_s in (0.4, 0.0, -0.2, -1.5):
        for command in commands(asked_m_s):
            climbs = allowed_in(State.GO_AROUND, command, s)
            assert isinstance(climbs, Velocity | Lean)
            assert climbs.v_level.tolist() == [0.4, -0.3, min(asked_m_s, -o.tries.climb_m_s)]
    for asked_m_s in (0.1, 1.0):
        pressed = allowed_in(State.PRESS, commands(asked_m_s)[1], s)
        assert isinstance(pressed, Lean)
        assert pressed.v_level[2] == pytest.approx(max(asked_m_s, o.cone.commit_rate_m_s + 0.2))
    for own in (Hover(), Land(on_deck=True)):
        assert allowed_in(State.GO_AROUND, own, s) is allowed_in(State.PRESS, own, s) is own


def is_usable(one: RelativeState | None, **tries: float) -> bool:
    found = usable(GuidanceCycle(ns(NOW), Knowledge(ns(NOW), one)), guided(tries=tries))
    assert found is None or found is one
    return found is not None


def test_an_estimate_carries_on_while_it_is_new_consistent_and_known_well_enough() -> None:
    for late_s, sigma_m, consistent, expected in (
        (0.0, 0.5, True, True), (0.5, 0.1, True, True), (-0.4, 0.1, True, True),
        (0.6, 0.1, True, False), (-0.6, 0.1, True, False), (0.0, 0.51, True, False), (0.0, 0.1, False, False),
    ):  # fmt: skip
        one = estimate(NOW + late_s, (0.0, 0.0, 1.0), sigma=sigma_m, consistent=consistent, age=9.0)
        assert is_usable(one, blind_sigma_m=0.5) is expected
    assert not is_usable(None)
    for sigma_m in (2.4, 2.6):
        swung = replace(estimate(NOW, (0.0, 0.0, 1.0), sigma=sigma_m), adrift=True)
        assert is_usable(swung, blind_sigma_m=0.5) is (sigma_m < 2.5)


@pytest.mark.parametrize(
    ("adrift", "alerts", "flown_by"), [(True, (), True), (True, (IntegrityAlert.DECK,), False), (False, (), False)]
)
def test_it_flies_by_an_estimate_adrift_though_the_last_sightings_disagree(adrift, alerts, flown_by):
    """WHY: a ship that turned hard made them so, and a drone that climbed blind did not find her again."""
    one = replace(estimate(NOW, (0.0, 0.0, 1.0), consistent=False, age=1.0), adrift=adrift, alerts=alerts)
    assert is_usable(one) is flown_by


@pytest.mark.parametrize("over_ground", [False, True])
@pytest.mark.parametrize("climb_m_s", [0.0, 0.5, 1.0])
def test_without_an_estimate_it_stays_with_the_deck_or_climbs_from_it(climb_m_s: float, over_ground: bool) -> None:
    command = VehicleHold(over_ground).staying(climb_m_s)
    if climb_m_s == 0.0 and not over_ground:
        assert isinstance(command, Hover)
    else:
        assert isinstance(command, Velocity)
        assert (command.v_level.tolist(), command.yaw_rate_rad_s) == ([0.0, 0.0, -climb_m_s], 0.0)
