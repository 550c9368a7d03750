"""Cost of a wrong response at touchdown: the file's prediction against simulated landings with wrong files."""

import math
import tomllib

import numpy as np
import pytest
from msgspec import structs

from companion.guidance.law.margins import margins
from companion.guidance.law.response_fit import STEP_S, FlightCourse, fit_climb, fit_tilt, text
from companion.settings.guidance import Response, response_from_mapping
from companion.settings.load import shipped_response
from companion.tools.calibrate.touchdown_cost import ResponseCost, tilt_of_file, tilt_of_sigma
from tests.companion.test_response_fit import GIVEN, WARM, asked_tilts, course

TILT = shipped_response("ardrone2").tilt
COV = np.diag([0.01**2, 0.3**2, 0.05**2])


def test_the_right_file_costs_nothing_and_a_wrong_one_the_squares_difference() -> None:
    right = tilt_of_file(TILT, TILT)
    assert right.cost_cm == 0.0
    assert right.error_cm == pytest.approx(100.0 * math.sqrt(2.0) * margins(TILT).error_m)
    quick = structs.replace(TILT, frequency_rad_s=5.5)
    wrong = tilt_of_file(quick, TILT)
    assert wrong.own_cm == right.own_cm
    assert wrong.error_cm == pytest.approx(100.0 * math.sqrt(2.0) * margins(quick, TILT).error_m)
    assert wrong.cost_cm == pytest.approx(math.sqrt(wrong.error_cm**2 - wrong.own_cm**2))
    assert 1.5 < wrong.cost_cm < 2.5, "80 simulated landings lost 2.6 cm"


def test_a_loop_that_is_unstable_has_no_cost_in_centimetres() -> None:
    assert math.isinf(tilt_of_file(TILT, structs.replace(TILT, delay_s=0.2)).cost_cm)
    assert ResponseCost(2.0, 2.1).cost_cm == 0.0


def test_one_sigma_is_the_worst_vehicle_on_its_ellipsoid() -> None:
    found = tilt_of_sigma(TILT, COV)
    rng = np.random.default_rng(5)
    for step in rng.normal(size=(25, 3)):
        delay, frequency, damping = np.sqrt(np.diag(COV)) * step / np.linalg.norm(step)
        vehicle = structs.replace(
            TILT, delay_s=TILT.delay_s + delay, frequency_rad_s=TILT.frequency_rad_s + frequency, damping=TILT.damping + damping
        )
        assert tilt_of_file(TILT, vehicle).cost_cm < 1.1 * found.cost_cm
    assert tilt_of_sigma(TILT, 0.01 * COV).cost_cm < 0.5 * found.cost_cm
    assert math.isinf(tilt_of_sigma(TILT, 100.0 * COV).cost_cm)


def test_a_file_is_read_back_with_the_covariance_of_its_fits() -> None:
    tilt, u = fit_tilt(course(noise=0.05), GIVEN.tilt), asked_tilts(4, 600)[:, :1]
    v, keep, rng = np.full((600, 1), u[0, 0]), math.exp(-STEP_S / 0.3), np.random.default_rng(1)
    for k in range(1, 600):
        v[k] = keep * v[k - 1] + (1.0 - keep) * u[k - 1, 0]
    climb = fit_climb(FlightCourse(u, v + 0.02 * rng.normal(size=v.shape), np.arange(600) > WARM), GIVEN.climb)
    assert tilt is not None
    assert climb is not None
    read = response_from_mapping(tomllib.loads(text(Response(tilt.response, climb.response), "a", tilt, climb)), "a.toml")
    np.testing.assert_allclose(np.array(read.tilt.cov_delay_frequency_damping), tilt.cov, rtol=1e-5)
    np.testing.assert_allclose(np.array(read.climb.cov_delay_lag), climb.cov, rtol=1e-5)
    assert read.tilt.delay_sigma_s == pytest.approx(tilt.response.delay_sigma_s, rel=1e-5)
    assert read.climb.lag_sigma_s == pytest.approx(climb.response.lag_sigma_s, rel=1e-5)
    kept = text(Response(tilt.response, read.climb), "a", tilt, None)
    assert response_from_mapping(tomllib.loads(kept), "a.toml").climb == structs.replace(
        read.climb, delay_s=round(read.climb.delay_s, 4), lag_s=round(read.climb.lag_s, 4)
    ), "a climb that is kept keeps its covariance"
    given = text(Response(tilt.response, shipped_response("quad_1_5kg").climb), "a", tilt, None)
    assert response_from_mapping(tomllib.loads(given), "a.toml").climb == shipped_response("quad_1_5kg").climb
