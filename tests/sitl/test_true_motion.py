"""Guidance at the level `truth` is told the deck's motion as it is, up to the claimed errors."""

import math

import numpy as np
from msgspec import structs

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from sitl.perception.levels import TrueMotion
from sitl.scenario.scenario import load
from sitl.world.world import World

STEP_NS = 4_000_000


class WithoutErrors:
    """Stands for the generator of the errors."""

    def standard_normal(self, n: int) -> F64:
        return np.zeros(n)


def test_the_tilt_rates_are_those_of_the_deck_whatever_the_ships_heading() -> None:
    """A rate turned by the ship's heading once more would exchange roll and pitch."""
    scenario = load("sea_state_4")
    world = World(structs.replace(scenario, vessel=structs.replace(scenario.vessel, heading_deg=100.0)), 3)
    reported = TrueMotion(world, WithoutErrors())  # type: ignore[arg-type]
    differences, rates, size = [], [], []
    for k in range(1, 200):
        world.advance(MonoNs(25 * k * STEP_NS - STEP_NS))
        before = world.truth().R_ned_pad.rpy_rad
        world.advance(MonoNs(25 * k * STEP_NS))
        _, deck = reported.motion(world.at, None)
        after = world.truth().R_ned_pad.rpy_rad
        differences.append([(after[i] - before[i]) / (STEP_NS * 1e-9) for i in (0, 1)])
        rates.append([deck.roll_rate_rad_s, deck.pitch_rate_rad_s])
        size.append(deck.tilt_rad)
    off = np.array(rates) - np.array(differences)
    assert np.abs(off).max() < 2e-3
    assert np.abs(differences).max() > 2e-2, "there is a motion to be told"
    assert max(size) < math.radians(30.0)
