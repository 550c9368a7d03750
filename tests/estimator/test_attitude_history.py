"""Attitudes of the body and of a gimbal at an exposure, and the moving median and mean of sightings."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator import median_mean
from estimator.attitude_history import DOWN, AttitudeHistory, GimbalHistory
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, PathName, Sighting
from estimator.contracts.geometry import Rotation, Transform, wrap_pi
from estimator.contracts.samples import Attitude, GimbalAttitude, GimbalFrame
from estimator.contracts.time import MonoNs, Stamp
from estimator.median_mean import VARIANCE_RATIO, MedianMean, circular_median
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from estimator.vision.camera.camera import Camera
from tests.make import attitude, gimbal, ns, stamp

# The body


def turning(t_s: float) -> Attitude:
    R = Rotation.from_rpy(0.1, -0.05, 0.0) @ Rotation.from_rotvec([0.5 * t_s, 0, 0])
    return Attitude(stamp(t_s), R, 1e-4 * np.eye(3))


def filled() -> AttitudeHistory:
    """Return a history of a second at 200 Hz, of which the last half is kept."""
    return AttitudeHistory(0.5).add(*(turning(i * 0.005) for i in range(201)))


@settings(max_examples=50)
@given(t_s=st.floats(0.51, 1.03))
def test_between_samples_and_a_little_past_the_newest_it_is_the_true_attitude(t_s: float) -> None:
    found = filled().at(ns(t_s), stamp(t_s))
    assert found.R_ned_body.angle_to(turning(t_s).R_ned_body) < 1e-6
    past_s = max(0.0, t_s - 1.0)
    np.testing.assert_allclose(np.diag(found.cov_body), [1e-4 + (0.05 * past_s) ** 2, 1e-4, 1e-4], rtol=1e-3)


@pytest.mark.parametrize(
    ("history", "t_s"), [(AttitudeHistory(), 0.0), (filled(), 0.2), (filled(), 1.2), (filled().add(turning(1.4)), 1.2)]
)
def test_it_says_none_rather_than_guess(history: AttitudeHistory, t_s: float) -> None:
    assert history.at(ns(t_s), stamp(t_s)) is None


@settings(max_examples=50)
@given(st.lists(st.integers(0, 40), max_size=12), st.integers(0, 12))
def test_several_attitudes_together_leave_what_one_by_one_does(at_50_ms: list[int], together_from: int) -> None:
    samples, one_by_one = [turning(0.05 * i) for i in at_50_ms], AttitudeHistory(span_s=0.5)
    for sample in samples:
        one_by_one = one_by_one.add(sample)
    together = AttitudeHistory(span_s=0.5).add(*samples[:together_from]).add(*samples[together_from:])
    assert together.samples == one_by_one.samples


def test_it_is_bounded_and_ignores_what_is_not_newer() -> None:
    history = filled()
    assert len(history.samples) == pytest.approx(101, abs=1)
    assert history.add(turning(0.9)) is history


# The gimbal

RPY = (0.12, -0.07, 1.9)
R_NED_BODY = Rotation.from_rpy(*RPY)


def pointing(t: float, R: Rotation = DOWN, frame: GimbalFrame = "level", sigma_s: float = 0.0) -> GimbalAttitude:
    return gimbal(stamp(t, sigma_s=sigma_s), R, frame)


def swinging(t: float) -> Rotation:
    return Rotation.from_rpy(0.0, -0.5 * math.pi + 0.2 * math.sin(5.0 * t), 0.0)


@pytest.mark.parametrize("frame", ["ned", "level", "body"])
def test_the_same_pose_in_each_frame_is_the_same_camera_on_the_body(frame: GimbalFrame) -> None:
    R = Rotation.from_rpy(0.05, -1.4, 0.2)
    reported = {"ned": R_NED_BODY @ R, "level": R_NED_BODY.without_heading() @ R, "body": R}[frame]
    history = GimbalHistory().add(pointing(1.0, reported, frame), pointing(1.1, reported, frame))
    held = history.at(stamp(1.05), attitude(1.05, *RPY))
    assert held.R_body_gimbal.angle_to(R) < 1e-9


def test_a_gimbal_that_points_down_holds_a_straight_camera_with_the_nose_at_the_top_of_the_image() -> None:
    mount = Transform(Rotation.from_rpy(math.pi / 2, 0.0, math.pi / 2), np.array([0.1, 0.0, 0.05]))
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, np.zeros(5), mount)
    held = camera.held(DOWN)
    assert held.T_body_cam.R.angle_to(Rotation.from_rpy(0.0, 0.0, math.pi / 2)) < 1e-9
    assert held.T_body_cam.t.tolist() == [0.1, 0.0, 0.05]
    assert held.optics == camera.optics, "what is computed for a lens is found again"


def test_a_swinging_gimbal_is_interpolated_within_its_claimed_error() -> None:
    history = GimbalHistory().add(*(pointing(t, swinging(t)) for t in np.arange(0.0, 1.0, 0.05)))
    for t in np.arange(0.3, 0.9, 0.013):
        held = history.at(stamp(t), attitude(0.5, var=1e-6))
        off = float(held.R_body_gimbal.angle_to(swinging(t)))
        assert off < min(0.004, 3.0 * math.sqrt(float(held.cov_body[1, 1])))


def test_what_it_turns_within_the_uncertainty_of_the_times_is_in_the_covariance() -> None:
    var = []
    for sigma_s in (0.0, 0.02):
        history = GimbalHistory().add(*(pointing(t, swinging(t), sigma_s=sigma_s) for t in (0.58, 0.60, 0.62, 0.64)))
        held = history.at(stamp(0.63), attitude(0.5, var=1e-6))
        var.append(held.cov_body[1, 1])
    assert math.sqrt(var[1] - var[0]) == pytest.approx(abs(math.cos(5.0 * 0.63)) * 0.02, rel=0.02)


@pytest.mark.parametrize("exposed_s", [0.4, 1.1, 2.2, 3.0])
def test_reports_that_do_not_cover_the_exposure_give_nothing(exposed_s: float) -> None:
    history = GimbalHistory().add(*(pointing(t) for t in (0.5, 0.6, 1.4, 1.5, 2.1)))
    assert history.at(stamp(exposed_s), attitude(exposed_s, *RPY)) is None
    assert GimbalHistory().at(stamp(exposed_s), attitude(exposed_s, *RPY)) is None


def test_a_change_of_frame_begins_again_and_the_next_report_is_awaited_only_while_reports_come() -> None:
    history = GimbalHistory().add(pointing(1.0, frame="level"), pointing(1.1, frame="ned"))
    assert (history.at(stamp(1.05), attitude(1.05, *RPY)), history.frame) == (None, "ned")
    assert [h.reports(stamp(t)) for h, t in ((history, 1.2), (history, 1.5), (GimbalHistory(), 1.0))] == [True, False, False]


@pytest.mark.parametrize("shadows", [(), ("median_mean",)])
def test_the_estimator_keeps_the_reports_with_one_path_and_with_several(shadows: tuple[PathName, ...]) -> None:
    memory = RelativeEstimator(EstimatorOptions(), shadows)
    memory.put([attitude(1.0, *RPY), pointing(1.0), attitude(1.1, *RPY), pointing(1.1)])
    held = memory.held_at(stamp(1.05), attitude(1.05, *RPY))
    assert held.R_body_gimbal.angle_to(R_NED_BODY.without_heading().inv @ DOWN) < 1e-9


TICK = 33_000_000
angles = st.floats(-math.pi, math.pi, exclude_min=True)


def filter_values(values, yaws=None, ambiguous=None, ticks=None, state=None) -> list[Any]:
    state = state or MedianMean()
    out: list[Any] = []
    for i, v in enumerate(values):
        t = MonoNs(TICK * (ticks[i] if ticks else i))
        yaw = yaws[i] if yaws else None
        state, f = state.step(t, np.array([v, 0.0, 2.0]), yaw, ambiguous[i] if ambiguous else False)
        out.append(f)
    return out


def test_a_single_outlier_leaves_no_trace():
    out = filter_values([1.0, 1.0, 1.0, 50.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert [f.d_body_pad_level[0] for f in out] == [1.0] * 9


def test_a_ramp_comes_out_two_samples_late_and_reports_it():
    out = filter_values([0.1 * i for i in range(10)])
    for i, f in enumerate(out):
        lag = (f.measured_at - f.holds_at) / TICK
        assert f.d_body_pad_level[0] == pytest.approx(0.1 * (i - lag), abs=1e-9)
    assert (out[-1].measured_at - out[-1].holds_at) / TICK == pytest.approx(2.0)
    assert out[0].v_pad_level is None
    assert out[-1].v_pad_level[0] == pytest.approx(0.1 / (TICK * 1e-9))


def test_a_gap_forgets_the_past():
    out = filter_values([1.0, 1.0, 1.0, 5.0, 5.0], ticks=[0, 1, 2, 30, 31])
    assert out[3].d_body_pad_level[0] == 5.0
    assert out[3].samples == 1


def test_a_sighting_that_is_not_newer_changes_nothing():
    state, _ = MedianMean().step(MonoNs(100), np.ones(3), 0.1, False)
    for t in (100, 50):
        again, out = state.step(MonoNs(t), np.zeros(3), 0.2, False)
        assert again is state
        assert out is None


@settings(max_examples=60)
@given(angles, st.lists(st.floats(-0.05, 0.05), min_size=1, max_size=8))
def test_heading_is_the_same_wherever_the_circle_is_cut(base, wobbles):
    at_zero = filter_values([0.0] * len(wobbles), yaws=wobbles)
    turned = filter_values([0.0] * len(wobbles), yaws=[wrap_pi(base + w) for w in wobbles])
    for a, b in zip(at_zero, turned, strict=True):
        assert abs(wrap_pi(b.yaw_rad - a.yaw_rad - base)) < 1e-6


@given(angles, st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), angles)
def test_circular_median_ignores_one_wild_angle_of_three(base, a, b, wild):
    got = circular_median([wrap_pi(base + a), wrap_pi(base + b), wild])
    assert abs(wrap_pi(got - base)) <= 0.2 + 1e-9


def test_an_h_alone_keeps_the_branch_the_arrow_chose():
    yaws = [3.0, 3.0, 3.0] + [wrap_pi(3.0 + math.pi)] * 12
    ambiguous = [False] * 3 + [True] * 12
    for f in filter_values([0.0] * 15, yaws=yaws, ambiguous=ambiguous):
        assert abs(wrap_pi(f.yaw_rad - 3.0)) < 1e-9
        assert not f.yaw_ambiguous


def test_an_h_alone_from_the_start_stays_ambiguous_until_the_arrow_shows():
    h = [0.2, wrap_pi(0.2 + math.pi), 0.2, 0.2]
    out = filter_values([0.0] * 5, yaws=[*h, wrap_pi(0.2 + math.pi)], ambiguous=[True] * 4 + [False])
    assert all(f.yaw_ambiguous for f in out[:4])
    assert abs(wrap_pi(2 * (out[3].yaw_rad - 0.2))) < 1e-9
    assert not out[4].yaw_ambiguous
    assert abs(wrap_pi(out[4].yaw_rad - 0.2 - math.pi)) < 1e-9


def test_variance_ratios_are_those_of_white_noise():
    rng = np.random.default_rng(5)
    noise = rng.standard_normal((5, 400_000))
    for n, ratio in enumerate(VARIANCE_RATIO, start=1):
        assert median_mean._medians(noise[:n]).mean(axis=0).var() == pytest.approx(ratio, rel=0.02)


def test_smooth_gives_a_sighting_of_the_instant_it_holds_for():
    state, out = MedianMean(), None
    for i in range(6):
        t = MonoNs(TICK * i)
        stamp = Stamp(t, MonoNs(t + 50_000_000), 1e-3, "sim")
        raw = Sighting(stamp, i, "selected", np.array([0.1 * i, 0.0, 2.0]), 0.1, False, np.diag([4e-4, 4e-4, 9e-4, 1e-2]), 0.9)
        state, out = state.smooth(raw)
    assert out.stamp.measured_at == 3 * TICK
    assert out.stamp.received_at == 5 * TICK + 50_000_000
    assert out.d_body_pad_level[0] == pytest.approx(0.3)
    assert out.cov[0, 0] == pytest.approx(4e-4 * VARIANCE_RATIO[-1])


def test_smooth_claims_no_heading_the_newest_sighting_lacks():
    stamp = Stamp(MonoNs(0), MonoNs(0), 1e-3, "sim")
    cov = np.diag([1e-4, 1e-4, 1e-4, UNKNOWN_YAW_VAR])
    _, out = MedianMean().smooth(Sighting(stamp, 0, "ellipse", np.array([0.0, 0.0, 2.0]), None, False, cov, 0.9))
    assert out.yaw_rad is None
    assert out.cov[3, 3] == UNKNOWN_YAW_VAR
