"""The bench of persons' landings reads what the drone says, and a flight of it follows the deck to the contact."""

import math
from dataclasses import dataclass

import pytest

from benches.by_person import Announced, announced, as_announced, cells, flown
from companion.base.mission import State
from companion.base.observer import Decision
from companion.guidance.mission.land_here import Touch
from tests.make import estimate, ns


@dataclass
class _Case:
    touch: Touch
    at_m: float
    within_m: float


@pytest.mark.parametrize(
    "case",
    [
        _Case(Touch(0.0, 0.12, 3.0), 0.0, 0.12),
        _Case(Touch(0.0, 1.24, 3.0, "last seen 3 s ago", stands_m=0.35), 0.0, 1.2),
        _Case(Touch(2.94, 0.3, None), 2.9, 0.3),
        _Case(Touch(), math.nan, math.inf),
    ],
)
def test_what_is_announced_is_read_from_its_text(case: _Case) -> None:
    assert announced(case.touch.text) == pytest.approx((case.at_m, case.within_m), nan_ok=True)


@pytest.mark.parametrize(
    ("touch", "touched_m", "right"),
    [
        (Touch(0.0, 0.12), [(0.08, 0.08)], True),
        (Touch(0.0, 0.12), [(0.09, 0.09)], False),
        (Touch(0.0, 0.12), [(0.0, 0.2), (0.0, 0.0)], False),
        (Touch(0.0, 0.12), [], False),
        (Touch(3.0, 0.5), [(0.0, 3.3)], True),
        (Touch(3.0, 0.5), [(0.0, -3.0)], False),
    ],
)
def test_every_contact_is_to_be_within_the_announced_distance_of_the_announced_place(touch, touched_m, right):
    assert as_announced({"announced": touch.text, "below_m": (0.0, 2.0), "touched_m": touched_m}) is right


def test_the_place_below_the_drone_is_known_in_the_pads_axes() -> None:
    seen = Announced()
    seen.on_decision(Decision(ns(1.0), State.LAND_HERE.value, None, estimate(1.0, (0.0, -3.0, 2.0), yaw=math.pi / 2)))
    assert seen.below_m == pytest.approx((-3.0, 0.0))


def test_a_persons_landing_follows_a_ship_under_way_to_the_pad() -> None:
    row = flown("ardrone", 1.5, 1.0, 870003, blind=False)
    assert row["unsafe"] == []
    assert row["lateral_m"] < 0.15
    assert as_announced(row)
    assert cells([row])[0] == "1 of 1"
