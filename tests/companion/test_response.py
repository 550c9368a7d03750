"""The response of a vehicle as a file gives it: its ranges, how late it is, and the model of it in steps."""

import math
from typing import Any

import numpy as np
import pytest

from companion.guidance.law.gains import tilt_model
from companion.settings.guidance import ClimbResponse, TiltResponse, response_from_mapping
from estimator.contracts.errors import BadInput
from estimator.contracts.motion import G_M_S2


@pytest.mark.parametrize(
    "wrong", [{"delay_s": 0.61}, {"frequency_rad_s": 0.9}, {"damping": 0.1}, {"lag_s": -0.01}, {"max_deg": 46.0}]
)
def test_a_tilt_outside_its_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        TiltResponse(**{"delay_s": 0.05, "frequency_rad_s": 5.0, "damping": 0.7, **wrong})


@pytest.mark.parametrize("wrong", [{"delay_s": 0.61}, {"lag_s": 0.01}, {"max_m_s": 5.1}])
def test_a_climb_outside_its_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ClimbResponse(**{"delay_s": 0.05, "lag_s": 0.4, **wrong})


def test_the_largest_tilt_is_the_acceleration_of_a_hovering_thrust() -> None:
    assert TiltResponse(0.05, 5.0, 0.7, max_deg=30.0).max_m_s2 == pytest.approx(G_M_S2 / math.sqrt(3.0))


@pytest.mark.parametrize(
    "tilt", [TiltResponse(0.07, 6.0, 0.8, 0.05), TiltResponse(0.2, 15.0, 0.4), TiltResponse(0.0, 5.0, 1.5, 0.2)]
)
def test_a_steady_change_of_the_command_is_followed_as_late_as_is_reported(tilt: TiltResponse) -> None:
    """A command that is held for a period is half a period later than the line through its beginnings."""
    period_s = 0.01
    model = tilt_model(tilt, period_s)
    x = np.zeros(len(model.A))
    for k in range(2000):
        x = model.A @ x + model.B * (k * period_s)
    assert 2000 * period_s - x[2] == pytest.approx(tilt.slowness_s + 0.5 * period_s, abs=1e-6)


COV = [[4e-4, 1e-3, 2e-4], [1e-3, 9e-2, 3e-3], [2e-4, 3e-3, 1e-2]]


def response_file(cov: Any = COV, **tilt: float) -> dict[str, Any]:
    given = {"delay_s": 0.05, "frequency_rad_s": 5.0, "damping": 0.7, "cov_delay_frequency_damping": cov, **tilt}
    return {"tilt": given, "climb": {"delay_s": 0.06, "lag_s": 0.4, "cov_delay_lag": [[1e-4, 0.0], [0.0, 4e-4]]}}


def test_a_covariance_gives_the_standard_deviations_that_a_file_leaves_out() -> None:
    read = response_from_mapping(response_file(damping_sigma=0.1), "mine.toml")
    assert read.tilt.cov_delay_frequency_damping == tuple(tuple(row) for row in COV)
    assert (read.tilt.delay_sigma_s, read.tilt.frequency_sigma_rad_s, read.tilt.damping_sigma) == pytest.approx((0.02, 0.3, 0.1))
    assert (read.climb.delay_sigma_s, read.climb.lag_sigma_s) == pytest.approx((0.01, 0.02))


def with_entry(row: int, column: int, value: Any) -> list[list[Any]]:
    return [[value if (i, j) == (row, column) else v for j, v in enumerate(one)] for i, one in enumerate(COV)]


@pytest.mark.parametrize(
    ("cov", "said"),
    [
        (with_entry(1, 1, math.nan), "row 2, column 2 must be a finite number, got nan"),
        (with_entry(0, 2, math.inf), "row 1, column 3 must be a finite number, got inf"),
        (with_entry(0, 1, 1.1e-3), "must be symmetric: row 1, column 2 is 0.0011 and row 2, column 1 is 0.001"),
        (with_entry(2, 2, -1e-2), "the variance in row 3 must be above 0 and at most 9, got -0.01"),
        (with_entry(0, 0, 0.5), "the variance in row 1 must be above 0 and at most 0.36, got 0.5"),
        ([[4e-4, 6.1e-3, 0.0], [6.1e-3, 9e-2, 0.0], [0.0, 0.0, 1e-2]], "must be positive definite"),
        (with_entry(2, 2, "much"), "Expected `float`"),
        (COV[:2], "length 3"),
    ],
)
def test_what_is_no_covariance_is_refused_with_its_place_and_what_to_do(cov: Any, said: str) -> None:
    with pytest.raises(BadInput) as refused:
        response_from_mapping(response_file(cov), "mine.toml")
    assert str(refused.value).startswith("mine.toml: ")
    assert said in str(refused.value)
    assert "tilt" in str(refused.value)
    assert "Expected" in said or "length" in said or "leave it out" in str(refused.value)


def test_a_standard_deviation_and_a_covariance_have_to_agree() -> None:
    response_from_mapping(response_file(delay_sigma_s=0.0203), "mine.toml")
    with pytest.raises(BadInput, match=r"delay_sigma_s is 0\.021, but cov_delay_frequency_damping says 0\.02"):
        response_from_mapping(response_file(delay_sigma_s=0.021), "mine.toml")
