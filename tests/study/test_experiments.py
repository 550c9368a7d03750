"""The thesis' experiments: axes, paths, what was printed, and a short one flown through the command's own functions."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.settings.load import load
from sitl.world.world import World
from study.experiments.chapter5 import error_of, spread
from study.experiments.flown import Estimate, ExperimentFlight, calm_scenario, fly_by_hand
from study.experiments.hand import (
    HeldPose,
    hold,
    level_axes,
    thesis_axes,
    thesis_yaw_rad,
)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.1, 10), st.floats(-3.1, 3.1))
def test_the_axes_of_the_thesis_lead_back(x: float, y: float, z: float, yaw: float) -> None:
    assert thesis_axes(level_axes(HeldPose(x, y, z))).tolist() == [x, y, z]
    assert math.isclose(math.cos(thesis_yaw_rad(thesis_yaw_rad(yaw)) - yaw), 1.0, abs_tol=1e-12)


def test_a_flight_begins_at_the_pose_of_the_thesis() -> None:
    truth = World(calm_scenario(HeldPose(1.0, 2.0, 3.5, -90.0), 5.0, exact_attitude=True), 1).truth()
    assert thesis_axes(truth.d_body_pad_level) == pytest.approx([1.0, 2.0, 3.5], abs=0.02)
    assert math.degrees(thesis_yaw_rad(truth.yaw_rad)) == pytest.approx(-90.0, abs=0.5)


def test_the_spread_counts_frames_without_an_estimate() -> None:
    flown = ExperimentFlight(frames=4)
    for error in (0.01, 0.03):
        flown.sightings.append(Estimate(1.0, "arrow", np.array([error, 0.0, 1.0]), 0.1, np.array([0.0, 0.0, 1.0]), 0.0, 0.01))
    found = spread(flown, "arrow", "x")
    assert found is not None
    assert found == pytest.approx((20.0, 10.0, 10.0, 30.0, 0.5))
    assert error_of(flown.sightings[0], "yaw") == pytest.approx(math.degrees(0.1))
    assert spread(flown, "corners", "x") is None
    half = replace(flown.sightings[0], name="corners", yaw_rad=0.1 - math.pi)
    assert error_of(half, "yaw") == pytest.approx(math.degrees(0.1))
    assert error_of(replace(half, name="arrow"), "yaw") == pytest.approx(math.degrees(0.1 - math.pi))


def test_a_short_hover_by_hand_sees_the_pad_and_errs_little() -> None:
    settings = load("sim")
    settings = msgspec.structs.replace(settings, vision=msgspec.structs.replace(settings.vision, method="fused"))
    flown = fly_by_hand(settings, hold(HeldPose(0.0, 0.0, 1.0)), 0.6, 3)
    assert flown.frames >= 5
    for method in ("arrow", "corners", "registration", "best"):
        found = spread(flown, method, "z")
        assert found is not None
        assert found.available > 0.8
        assert abs(found.mean) < 10.0
    assert {e.name for e in flown.beliefs} == {"ekf", "median_mean", "dead_reckoning"}
    assert max(abs(float(e.xyz_m[2] - e.true_xyz_m[2])) for e in flown.of("ekf")) < 0.1
