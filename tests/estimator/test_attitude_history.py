import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.attitude_history import AttitudeHistory
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs
from tests.make import ns, stamp


def turning(t_s: float, rate_rad_s: float = 0.5) -> Attitude:
    return Attitude(
        stamp(t_s), Rotation.from_rpy(0.1, -0.05, 0.0) @ Rotation.from_rotvec([rate_rad_s * t_s, 0, 0]), 1e-4 * np.eye(3)
    )


def filled(until_s: float = 1.0, step_s: float = 0.005) -> AttitudeHistory:
    history = AttitudeHistory(span_s=0.5)
    for i in range(round(until_s / step_s) + 1):
        history = history.add(turning(i * step_s))
    return history


@settings(max_examples=50)
@given(t_s=st.floats(0.51, 1.03))
def test_between_samples_and_a_little_past_the_newest_it_is_the_true_attitude(t_s: float) -> None:
    found = filled().at(ns(t_s), stamp(t_s))
    assert found is not None
    assert found.R_ned_body.angle_to(turning(t_s).R_ned_body) < 1e-6


def test_it_says_none_rather_than_guess() -> None:
    history = filled()
    assert AttitudeHistory().at(MonoNs(0), stamp(0)) is None
    assert history.at(ns(0.2), stamp(0.2)) is None
    assert history.at(ns(1.2), stamp(1.2)) is None
    holed = history.add(turning(1.4))
    assert holed.at(ns(1.2), stamp(1.2)) is None


@settings(max_examples=50)
@given(st.lists(st.integers(0, 40), max_size=12), st.integers(0, 12))
def test_several_attitudes_together_leave_what_one_by_one_does(at_50_ms: list[int], together_from: int) -> None:
    given_in_turn = [turning(0.05 * i) for i in at_50_ms]
    one_by_one = AttitudeHistory(span_s=0.5)
    for sample in given_in_turn:
        one_by_one = one_by_one.add(sample)
    together = AttitudeHistory(span_s=0.5).add(*given_in_turn[:together_from]).add(*given_in_turn[together_from:])
    assert together.samples == one_by_one.samples


def test_it_is_bounded_and_ignores_what_is_not_newer() -> None:
    history = filled()
    assert len(history.samples) == pytest.approx(101, abs=1)
    assert history.add(turning(0.9)) is history


def test_carrying_on_costs_certainty() -> None:
    found = filled().at(ns(1.04), stamp(1.04))
    assert found is not None
    assert found.cov_body[0, 0] > 1e-4
    assert math.isclose(found.cov_body[1, 1], 1e-4, rel_tol=1e-3)
