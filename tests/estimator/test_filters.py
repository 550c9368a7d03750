import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator import paths
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Sighting
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.time import MonoNs, Stamp
from estimator.paths import GROUP_DELAY_SAMPLES, VARIANCE_RATIO, MedianMean, circular_median

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
    assert (out[-1].measured_at - out[-1].holds_at) / TICK == pytest.approx(GROUP_DELAY_SAMPLES)
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
        assert paths._medians(noise[:n]).mean(axis=0).var() == pytest.approx(ratio, rel=0.02)


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
