"""A frozen frame under fresh noise: the pad keeps its place in the image while the body turns."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.crosschecks import ViewWatch, watch_view
from estimator.integrity.options import IntegrityOptions

LIMITS = IntegrityOptions()


def frozen_shares(seed: int, frozen: bool, sway_rad: float, height_m: float = 1.5, seconds: float = 10.0) -> float:
    """Share of sightings after which the view counts as frozen; the body sways and drifts as a hovering drone does."""
    return sum(one.frozen for one in watched(seed, frozen, sway_rad, np.eye(3), height_m, seconds)) / (30 * seconds)


def watched(
    seed: int, frozen: bool, sway_rad: float, mirror: F64, height_m: float = 1.5, seconds: float = 10.0, late_s: float = 0.0,
    round_m_s: float = 0.0, noise: float = 0.0005,
) -> Iterator[ViewWatch]:  # fmt: skip
    """Yield the watch after each sighting; the camera turns bearings in the body by `mirror`, and the attitude is late.

    Args:
        round_m_s: speed of the pad on a circle of 2 m about the drone.
        noise: deviation of a place over the height.
    """
    rng = np.random.default_rng(seed)
    state = ViewWatch()
    phases, n = rng.uniform(0, 2 * math.pi, 6), round(seconds * 30)

    def swaying(t: float) -> tuple[list[float], Rotation]:
        sways = [math.sin(2 * math.pi * hz * t + p) for hz, p in zip((0.7, 0.9, 2.1), phases[:3], strict=True)]
        return sways, Rotation.from_rpy(sway_rad * (sways[0] + 0.3 * sways[2]), sway_rad * sways[1], 0.2 * t)

    for i in range(n):
        t = i / 30
        (sways, R), (_, reported) = swaying(t), swaying(t - late_s)
        # A body that tilts one way is pushed that way: g times the tilt, twice integrated, so the pad moves as the tilt moves it.
        drift_m = 9.81 * sway_rad / (2 * math.pi * 0.8) ** 2
        true = np.array([0.1 - drift_m * sways[1], drift_m * sways[0], height_m])
        if round_m_s:
            true[:2] += 2.0 * np.array([math.cos(0.5 * round_m_s * t), math.sin(0.5 * round_m_s * t)])
        if frozen:
            true = R.without_heading() @ np.array([0.1, 0.05, height_m])
        level = R.without_heading()
        d = reported.without_heading() @ (mirror @ (level.inv @ true)) + rng.normal(0, noise * height_m, 3)
        stamp = Stamp(MonoNs(round(t * 1e9)), MonoNs(round((t + 0.09) * 1e9)), 0.001, "sim")
        sighting = Sighting(stamp, i, "registration", d, 0.1, False, np.diag([1e-4, 1e-4, 1e-4, 1e-3]), 0.9)
        state = watch_view(state, sighting, Attitude(stamp, reported, 1e-5 * np.eye(3)), LIMITS)
        yield state


@pytest.mark.parametrize("seed", range(3))
def test_a_frozen_view_is_known_while_the_body_turns(seed: int) -> None:
    assert frozen_shares(seed, frozen=True, sway_rad=math.radians(2.0)) > 0.8


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sway_deg", [0.2, 1.0, 5.0])
def test_a_true_view_is_not(seed: int, sway_deg: float) -> None:
    assert frozen_shares(seed, frozen=False, sway_rad=math.radians(sway_deg)) == 0.0


def test_a_still_body_reports_nothing() -> None:
    assert frozen_shares(1, frozen=True, sway_rad=math.radians(0.2)) == 0.0


@pytest.mark.hazard("H12")
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("axis_deg", [0.0, 90.0, 35.0])
def test_a_mirrored_view_is_known_within_two_seconds_of_a_flight_that_sways(seed: int, axis_deg: float) -> None:
    c, s = math.cos(2 * math.radians(axis_deg)), math.sin(2 * math.radians(axis_deg))
    mirror = np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, 1.0]])
    for height_m, noise in ((0.5, 0.0005), (3.0, 0.0005), (2.0, 0.015)):
        seen = [one.reversed for one in watched(seed, False, math.radians(1.0), mirror, height_m, 5.0, noise=noise)]
        assert all(seen[60:]), f"first at {seen.index(True) / 30:.1f} s"


def test_a_camera_mounted_the_other_way_round_is_known_and_a_right_one_is_never_named() -> None:
    turned = [one.reversed for one in watched(1, False, math.radians(1.0), np.diag([-1.0, -1.0, 1.0]))]
    assert all(turned[60:])
    for sway_deg, height_m, noise in ((0.05, 0.3, 0.0005), (0.5, 1.0, 0.015), (3.0, 8.0, 0.0005)):
        seen = watched(2, False, math.radians(sway_deg), np.eye(3), height_m, 20.0, noise=noise)
        assert not any(one.reversed for one in seen)


@pytest.mark.parametrize(("late_s", "known"), [(0.1, True), (-0.1, True), (0.03, False), (0.0, False)])
def test_an_attitude_a_tenth_of_a_second_late_against_the_image_is_known_within_three_seconds(late_s: float, known: bool) -> None:
    for seed in range(3):
        found = [one.late_s for one in watched(seed, False, math.radians(3.0), np.eye(3), 3.0, 6.0, late_s)]
        assert all((s != 0.0) is known for s in found[90:])
        assert not known or abs(found[-1] - late_s) <= 0.021


def test_close_to_the_pad_a_way_aside_is_no_delay() -> None:
    """The pad's bearing is the vehicle's way aside there, which follows its lean late; and so it is after a ship that stops."""
    for height_m, round_m_s, known in ((0.9, 0.0, False), (1.1, 0.0, True), (3.0, 1.0, True), (3.0, 2.5, False)):
        found = [one.late_s for one in watched(1, False, math.radians(3.0), np.eye(3), height_m, 6.0, 0.1, round_m_s)]
        assert any(found[90:]) is known
