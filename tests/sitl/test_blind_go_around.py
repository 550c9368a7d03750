"""Sight of the pad lost near the deck, with an estimate that drifts by more than it knows."""

import pytest

from sitl.flight.one_flight import FlyOptions
from sitl.scenario.scenario import load
from sitl.scenario.with_fault import faulty
from tests.fly import land


@pytest.mark.parametrize("seed", [7020, 7021])
def test_it_touches_nothing_before_its_landing(seed: int) -> None:
    """The accelerometer is wrong by 0.8 m/s^2 for seed 7020; below 0.2 m neither camera nor ultrasound measures the height."""
    ending = land("ardrone1", seed, level="model")
    assert ending.good
    assert len(ending.contacts) == 1


def test_after_a_contact_that_nobody_felt_the_pad_a_third_of_a_metre_from_the_estimate_is_the_same_one() -> None:
    """One of three navdata datagrams comes too late to be used; the go-around begins on the pad."""
    wanted = faulty(load("demo"), 2325, possible=lambda _: True, name="faults/navdata_overtaken")
    assert land(wanted, 2325, level="model", options=FlyOptions(overtime_s=30.0)).good
