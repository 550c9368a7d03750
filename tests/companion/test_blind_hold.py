"""Flight without sight of the pad: it needs a good estimate, and never goes lower than the deck does."""

import numpy as np
import pytest
from msgspec.structs import replace

from companion.guidance.controller import Knowledge
from companion.guidance.mission.cycle import GuidanceCycle
from companion.guidance.mission.steer import climbing, never_lower, pressing, usable, without_estimate
from companion.settings.mission import TryOptions
from estimator.contracts.commands import Hover, Land, Lean, Velocity
from estimator.contracts.estimates import IntegrityAlert
from estimator.contracts.motion import DeckMotion
from tests.companion.mission_flights import estimate, ns

NOW = 20.0


def falling(down_m_s: float | None, sigma_m_s: float = 0.0) -> Knowledge:
    deck = None
    if down_m_s is not None:
        v = np.array([3.0, 0.0, down_m_s])
        cov = np.diag([1.0, 1.0, sigma_m_s**2, 1.0, 1.0, 1.0])
        deck = DeckMotion(ns(NOW), v, np.zeros(3), cov, 0, 0, 0, 0, 1e-4 * np.eye(4))
    return Knowledge(ns(NOW), None, deck=deck)


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
    knowledge = falling(deck_m_s)
    for command, rate in (
        (Velocity(np.array([0.4, -0.3, 0.5]), 0.1), velocity_m_s),
        (Lean(np.ones(2), np.zeros(2), np.array([0.4, -0.3, 0.5]), 0.1), lean_m_s),
    ):
        slower = never_lower(command, knowledge, fit=fit, over_ground=over_ground)
        assert type(slower) is type(command)
        assert slower.v_level.tolist() == [0.4, -0.3, rate]
        assert slower.yaw_rate_rad_s == 0.1


@pytest.mark.parametrize(("sigma_m_s", "rate"), [(0.05, 0.2), (0.1, 0.1), (0.2, 0.0)])
def test_a_fall_of_the_deck_is_followed_as_far_as_it_is_certain(sigma_m_s: float, rate: float) -> None:
    down = Lean(np.ones(2), np.zeros(2), np.array([0.0, 0.0, 0.5]), 0.0)
    kept = never_lower(down, falling(0.3, sigma_m_s), fit=True, over_ground=False)
    assert isinstance(kept, Lean)
    assert kept.v_level[2] == pytest.approx(rate)


def test_what_climbs_and_what_is_the_vehicle_s_own_is_left_as_it_is() -> None:
    for command in (Velocity(np.array([0.0, 0.0, -0.4]), 0.0), Velocity(np.zeros(3), 0.0), Hover(), Land(on_deck=True)):
        assert never_lower(command, falling(0.2), fit=False, over_ground=False) is command


@pytest.mark.parametrize(("asked_m_s", "given_m_s"), [(0.4, -0.5), (0.0, -0.5), (-0.2, -0.5), (-0.5, -0.5), (-1.5, -1.5)])
def test_a_climb_without_sight_is_as_fast_as_it_is_counted_to_be(asked_m_s: float, given_m_s: float) -> None:
    for command in (
        Velocity(np.array([0.4, -0.3, asked_m_s]), 0.1),
        Lean(np.ones(2), np.zeros(2), np.array([0.4, -0.3, asked_m_s]), 0.1),
    ):
        climbs = climbing(command, 0.5)
        assert type(climbs) is type(command)
        assert (climbs.v_level.tolist(), climbs.yaw_rate_rad_s) == ([0.4, -0.3, given_m_s], 0.1)
    hover = Hover()
    assert climbing(hover, 0.5) is hover


@pytest.mark.parametrize(("asked_m_s", "given_m_s"), [(0.1, 0.55), (0.55, 0.55), (1.0, 1.0)])
def test_a_press_is_never_less_than_its_rate_against_the_deck(asked_m_s: float, given_m_s: float) -> None:
    """WHY: an accelerometer that was wrong at the contact made the estimate sink into the deck, and the drone floated off."""
    lean = Lean(np.ones(2), np.zeros(2), np.array([0.4, -0.3, asked_m_s]), 0.1)
    pressed = pressing(lean, falling(0.2), 0.35)
    assert isinstance(pressed, Lean)
    assert pressed.v_level.tolist() == [0.4, -0.3, pytest.approx(given_m_s)]
    land = Land(on_deck=True)
    assert pressing(land, falling(0.2), 0.35) is land


def test_an_estimate_carries_on_while_it_is_new_consistent_and_known_well_enough() -> None:
    options = TryOptions(blind_sigma_m=0.5)
    for late_s, sigma_m, consistent, is_usable in (
        (0.0, 0.5, True, True), (0.4, 0.1, True, True), (-0.4, 0.1, True, True),
        (0.5, 0.1, True, True), (0.6, 0.1, True, False),
        (-0.6, 0.1, True, False), (0.0, 0.51, True, False), (0.0, 0.1, False, False),
    ):  # fmt: skip
        one = estimate(NOW + late_s, (0.0, 0.0, 1.0), sigma=sigma_m, consistent=consistent, age=9.0)
        found = usable(GuidanceCycle(ns(NOW), Knowledge(ns(NOW), one)), options, 0.5)
        assert (found is one) is is_usable
    assert usable(GuidanceCycle(ns(NOW), Knowledge(ns(NOW), None)), options, 0.5) is None
    for sigma_m in (2.4, 2.6):
        swung = replace(estimate(NOW, (0.0, 0.0, 1.0), sigma=sigma_m), adrift=True)
        assert (usable(GuidanceCycle(ns(NOW), Knowledge(ns(NOW), swung)), options, 0.5) is swung) is (sigma_m < 2.5)


@pytest.mark.parametrize(
    ("adrift", "alerts", "flown_by"), [(True, (), True), (True, (IntegrityAlert.DECK,), False), (False, (), False)]
)
def test_it_flies_by_an_estimate_adrift_though_the_last_sightings_disagree(adrift, alerts, flown_by):
    """WHY: a ship that turned hard made them so, and a drone that climbed blind did not find her again."""
    one = replace(estimate(NOW, (0.0, 0.0, 1.0), consistent=False, age=1.0), adrift=adrift, alerts=alerts)
    assert (usable(GuidanceCycle(ns(NOW), Knowledge(ns(NOW), one)), TryOptions(), 0.5) is one) is flown_by


@pytest.mark.parametrize("over_ground", [False, True])
@pytest.mark.parametrize("climb_m_s", [0.0, 0.5, 1.0])
def test_without_an_estimate_it_stays_with_the_deck_or_climbs_from_it(climb_m_s: float, over_ground: bool) -> None:
    command = without_estimate(climb_m_s, over_ground=over_ground)
    if climb_m_s == 0.0 and not over_ground:
        assert isinstance(command, Hover)
    else:
        assert isinstance(command, Velocity)
        assert (command.v_level.tolist(), command.yaw_rate_rad_s) == ([0.0, 0.0, -climb_m_s], 0.0)
