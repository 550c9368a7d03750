"""Many flights at once fly as each would alone."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.contracts.time import MonoNs
from sitl.fleet import Fleet
from sitl.scenario import load
from sitl.vehicle import VehiclePhase
from sitl.world import Stick, World

SEEDS = [3, 8, 21]


def test_each_flight_is_that_of_the_world_with_its_seed() -> None:
    scenario = load("moderate")
    fleet, worlds = Fleet(scenario, SEEDS), [World(scenario, seed) for seed in SEEDS]
    sticks = [Stick(0.2, -0.1, -0.2, 0.4, True), Stick(), Stick(-0.1, 0.0, 0.3, 0.0, True)]
    roll, pitch, gaz, yaw = np.array([(s.roll, s.pitch, s.gaz, s.yaw) for s in sticks]).T
    fleet.vehicle.command(roll, pitch, gaz, yaw, np.array([s.progressive for s in sticks]))
    for world, stick in zip(worlds, sticks, strict=True):
        world.stick(stick)
    for _ in range(600):
        fleet.step()
    for n, world in enumerate(worlds):
        world.advance(MonoNs(round(fleet.seconds * 1e9)))
        truth = world.truth()
        assert fleet.d_body_pad_level[n] == pytest.approx(truth.d_body_pad_level, abs=1e-3)
        assert fleet.v_pad_level[n] == pytest.approx(truth.v_pad_level, abs=5e-3)
        assert fleet.yaw_rad[n] == pytest.approx(truth.yaw_rad, abs=1e-3)


def test_lands_on_moving_decks_and_is_carried() -> None:
    fleet = Fleet(load("demo"), range(20))
    v = fleet.vehicle
    pad = fleet.vessel.pad(0.0)
    v.place(pad.p_ned - np.array([0.0, 0.0, 0.8]), np.zeros(3), 0.0)
    v.land()
    for _ in range(1100):
        fleet.step()
    assert np.all(np.asarray(v.phase) == VehiclePhase.LANDED)
    assert np.all(fleet.on_deck < 0.8)
    rest = fleet.d_body_pad_level
    assert rest[:, 2] == pytest.approx([0.045] * 20, abs=0.05)
    for _ in range(250):
        fleet.step()
    assert np.abs(np.linalg.norm(fleet.d_body_pad_level, axis=1) - np.linalg.norm(rest, axis=1)).max() < 1e-4
