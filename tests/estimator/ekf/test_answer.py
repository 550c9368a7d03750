"""Answers of the native core for an instant equal those of the numpy oracle."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.geometry import F64
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs
from estimator.ekf import Filter
from estimator.ekf.params import FilterParams
from tests.estimator.ekf.belief import Belief, follow
from tests.estimator.ekf.belief import holding as core_holding
from tests.estimator.ekf.hand import LEVEL, MS, TOOLS, T, belief, correlated, imu, params, state
from tests.estimator.ekf.oracle import answers
from tests.estimator.ekf.test_core import beginning, row

OFTEN = params(tick_s=0.01, hold_s=0.02)
FORGETFUL = params(forget_s=0.1)


def holding(b: Belief, chosen: FilterParams) -> Filter:
    return core_holding(b, chosen)


def close(ours: object, oracle: object, what: str) -> None:
    np.testing.assert_allclose(np.asarray(ours, float), np.asarray(oracle, float), rtol=1e-9, atol=1e-9, err_msg=what)


def close_cov(ours: F64, oracle: F64, what: str) -> None:
    """Agree to 1e-9 of the standard deviations, and be symmetric to the bit."""
    sigma = np.sqrt(np.diagonal(oracle))
    np.testing.assert_allclose(ours / np.outer(sigma, sigma), oracle / np.outer(sigma, sigma), atol=1e-9, err_msg=what)
    np.testing.assert_array_equal(ours, ours.T)


def same_answer(b: Belief, now: int, chosen: FilterParams) -> tuple[bool, bool]:
    """Hold pad, body and deck at an instant to the oracle's; return whether there was a pad, and a body."""
    ekf, o = holding(b, chosen), chosen.options
    expected = answers.settled(b, now, chosen)
    body, deck = ekf.motion(MonoNs(now))
    found = ekf.at(MonoNs(now))
    sighted = b.sighted >= 0 and now - b.sighted <= round(o.forget_s * 1e9)
    assert (found is not None) is (deck is not None) is sighted
    if found is not None and deck is not None:
        pad, its = answers.pad(expected), answers.deck(expected)
        close(found.d_body_pad_level, pad.d, "d")
        close(found.v_pad_level, pad.v, "v")
        assert (found.yaw_rad is None) is (pad.yaw is None)
        if found.yaw_rad is not None and pad.yaw is not None:
            close(math.remainder(found.yaw_rad - pad.yaw, math.tau), 0.0, "yaw")
            assert abs(found.yaw_rad) <= math.pi
        close_cov(found.cov, pad.cov, "cov")
        close(deck.v_level, its.v, "deck's velocity")
        close(deck.a_level, its.a, "deck's acceleration")
        close([deck.roll_rad, deck.pitch_rad, deck.roll_rate_rad_s, deck.pitch_rate_rad_s], its.tilt, "tilt")
        close_cov(deck.cov_level, its.cov, "deck's covariance")
        close_cov(deck.cov_tilt, its.cov_tilt, "covariance of the tilt")
    moves = b.t_imu >= 0 and now - b.t_imu <= round(o.hold_s * 1e9) and b.levelled_by is not None
    assert (body is not None) is moves
    if body is not None:
        its_body = answers.body(expected, chosen)
        close(body.heading_rad, its_body.heading, "heading")
        close(body.a_level, its_body.a, "body's acceleration")
        close_cov(body.cov_a_level, its_body.cov_a, "covariance of the acceleration")
        close(body.w_body, its_body.w, "rates")
        assert expected.b.levelled_by is not None
        close(body.reported.matrix, expected.b.levelled_by, "reported attitude")
        close(body.cov_reported, expected.b.cov_levelled_by, "its covariance")
    return sighted, moves


@given(st.integers(0, 2**31), st.integers(0, 250), st.sampled_from([TOOLS, OFTEN, FORGETFUL]), st.booleans())
@settings(max_examples=60)
def test_an_answer_is_the_oracle_s(seed: int, later_ms: int, chosen: FilterParams, known: bool) -> None:
    b = beginning(seed)._replace(heading_known=known, cov_levelled_by=np.diag([1e-4, 2e-4, 3e-4]))
    if seed % 3 == 0:
        b = b._replace(levelled_by=None)
    same_answer(b, b.t + later_ms * MS, chosen)


@pytest.mark.parametrize("later_ms", [0, 4, 30, 200])
def test_after_a_row_of_samples_it_is_the_oracle_s(later_ms: int) -> None:
    """The answer includes all changes since the last propagation of the covariance: IMU samples, a jolt, a coast."""
    seen = 0
    for seed in range(12):
        row_of = [*row(seed, 9, 0.2, 3.0), imu(T + 40 * MS, (0.1, 0.0, 0.2), (0.5, 0.1, -9.6))]
        b, _ = follow(beginning(seed)._replace(sighted=T - 20 * MS), row_of, TOOLS)[-1]
        pad, body = same_answer(b, b.t + later_ms * MS, TOOLS)
        seen += pad + body
    assert seen == (24 if later_ms < 100 else 12)


@pytest.mark.parametrize("t_imu", [0, 3 * MS])
@pytest.mark.parametrize(("later_ns", "moves"), [(0, True), (20 * MS, True), (20 * MS + 1, False)])
def test_the_body_moves_as_its_newest_sample_says_until_it_holds_no_longer_to_the_nanosecond(t_imu, later_ns, moves):
    b = belief(LEVEL, t=t_imu, x=state(), t_imu=t_imu, f=(0.5, 0.1, -9.6))
    assert same_answer(b, t_imu + later_ns, OFTEN)[1] is moves


def test_an_answer_is_worked_out_once_for_all_that_ask() -> None:
    ekf = holding(belief(LEVEL, x=state()), TOOLS)
    now = MonoNs(T + 3 * MS)
    assert ekf.at(now) is ekf.at(now)
    assert ekf.motion(now)[1] is ekf.motion(now)[1]
    first = ekf.at(now)
    for k in range(4):
        ekf.at(MonoNs(now + k))
    assert ekf.at(now) is first, "guidance, recorder and links ask for instants of their own in between"
    for k in range(20):
        ekf.at(MonoNs(now + k))


def test_an_answer_holds_through_later_samples_and_no_longer_after_one_that_was_before_its_instant() -> None:
    """Vision requests the estimate at an exposure, and the guard again when the sighting comes, after some more samples."""

    def turning(at_ns: int) -> Imu:
        return imu(at_ns, (0.1, 0.0, 0.2), (0.5, 0.1, -9.6))

    ekf = holding(belief(LEVEL, x=state()), TOOLS)
    ekf.put([turning(T + MS)])
    now = MonoNs(T + 3 * MS)
    first = ekf.at(now)
    assert first is not None
    ekf.put([turning(T + 4 * MS)])
    assert ekf.at(now) is first
    ekf.put([turning(T + 2 * MS)])
    other = ekf.at(now)
    assert other is not None
    assert other is not first
    assert not np.array_equal(other.d_body_pad_level, first.d_body_pad_level)


def test_an_estimate_s_figures_read_as_a_tuple_s() -> None:
    found = holding(belief(LEVEL, x=state(), P=correlated()), TOOLS).at(MonoNs(T))
    assert found is not None
    figures = tuple(found.details)
    assert len(found.details) == len(figures) == len(dict(figures)) > 30
    assert found.details[0] == figures[0]
    assert found.details[-2:] == figures[-2:]
    assert [value for _, value in found.details] == [value for _, value in figures]
