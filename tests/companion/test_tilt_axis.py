"""One axis of the deck's follower: what it makes of a cycle's measurement, and its two tables of gains beside scipy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec import structs
from scipy.linalg import solve_discrete_are

from companion.guidance import disturbance
from companion.guidance.disturbance import SIGMAS_P_M, ObserverGains, ObserverNoise
from companion.guidance.tilt_law import TiltGains, TiltWeights, tilt_gains
from companion.guidance.tilt_model import tilt_model
from companion.settings.response import TiltResponse
from tests.companion.oracle import axis, observer
from tests.companion.oracle.axis import AxisMeasured, TiltAxis, tilt_command
from tests.companion.oracle.observer import Observed

NO_GAINS = ObserverGains(((0.0, 0.0, 0.0),) * 4)
GAINS = ObserverGains(((0.11, 0.22, 0.33), (0.44, 0.55, 0.66), (-0.77, -0.88, 0.99), (0.13, -0.17, 0.19)))
X = Observed(1.0, -0.5, 0.7, 0.2)
TILT = TiltResponse(0.05, 9.0, 0.7, lag_s=0.08)
KNOWN = TiltAxis(Observed(1.0, -0.5, 0.7, 0.2), lean=0.3, rate=1.1, lag=0.9, under_way=(1.0, 2.0, 3.0))
Z = AxisMeasured(1.2, -0.4, 0.5, 2.0, 1.6, 0.25)
LAW = TiltGains(2.0, 3.0, 5.0, 7.0, 11.0, (13.0, 17.0))
DT = 0.02


def test_without_gains_the_pad_moves_on_by_what_pushes_the_body() -> None:
    x = observer.observed(X, NO_GAINS, 0.5, 1.5, 0.3, 9.0, 9.0, 9.0)
    assert tuple(structs.astuple(x)) == pytest.approx((1.0 - 0.25 + 0.125 * 0.5, -0.5 + 0.25, 0.7, 0.2))


@pytest.mark.parametrize(("a_body", "missing"), [(2.0, 2.0 - 0.3 - 0.7 - 0.2), (None, 0.0)])
def test_what_is_measured_corrects_by_its_gain(a_body: float | None, missing: float) -> None:
    still = structs.astuple(observer.observed(X, NO_GAINS, 0.5, 1.5, 0.3, 0.0, 0.0, None))
    errors = np.array([1.4 - still[0], -0.6 - still[1], missing])
    x = observer.observed(X, GAINS, 0.5, 1.5, 0.3, 1.4, -0.6, a_body)
    assert tuple(structs.astuple(x)) == pytest.approx(tuple(np.array(still) + np.array(GAINS.rows) @ errors))


def test_the_gains_that_are_kept_reach_from_five_millimetres_to_sixteen_centimetres() -> None:
    assert SIGMAS_P_M == (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
    for n, sigma in enumerate(SIGMAS_P_M):
        assert disturbance.chosen(SIGMAS_P_M, 0.9 * sigma) == sigma
        assert disturbance.chosen(SIGMAS_P_M, 1.4 * sigma) == sigma
        assert disturbance.chosen(SIGMAS_P_M, 1.41 * sigma) == SIGMAS_P_M[min(n + 1, 5)]
    with pytest.raises(IndexError):
        disturbance.chosen((1.0,), 1.0)


@pytest.mark.parametrize("accelerometer", [True, False])
def test_the_observers_gains_solve_its_riccati_equation(accelerometer: bool) -> None:
    table = disturbance.observer_gains(ObserverNoise(accelerometer=accelerometer), DT)
    A = np.array([[1.0, DT, -0.5 * DT**2, 0.0], [0.0, 1.0, -DT, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
    Q = np.diag([1e-8, 0.01 * DT, 2.0 * DT, 0.1 * DT])
    for sigma, gains in zip(SIGMAS_P_M, table, strict=True):
        R = np.diag([10.0 * sigma**2, 10.0 * 0.08**2, 0.06**2 if accelerometer else 1e6])
        P = solve_discrete_are(A.T, C.T, Q, R)
        np.testing.assert_allclose(gains.rows, P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=2e-4, atol=1e-7)
    assert ObserverNoise().accelerometer


@pytest.mark.parametrize(("lag_s", "delay_line"), [(0.08, True), (0.0, True), (0.08, False)])
def test_the_regulators_gains_solve_its_riccati_equation(lag_s: float, delay_line: bool) -> None:
    response = structs.replace(TILT, lag_s=lag_s)
    gains = tilt_gains(response, TiltWeights(), DT, delay_line=delay_line)
    model = tilt_model(structs.replace(response, delay_s=0.05 if delay_line else 0.0), DT)
    B, Q = model.B[:, None], np.zeros_like(model.A)
    Q[0, 0], Q[1, 1] = 0.006**-2, 4.1**-2
    R = np.array([[0.3**-2]])
    S = solve_discrete_are(model.A, B, Q, R)
    K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ model.A)[0]
    lag = (gains.lag,) if lag_s else ()
    np.testing.assert_allclose((*gains[:4], *lag, *gains.under_way), K, rtol=1e-9)
    assert delay_line is (gains == tilt_gains(response, TiltWeights(), DT))
    assert len(gains.under_way) == (3 if delay_line else 1)
    assert (gains.lag == 0.0) is (lag_s == 0.0)


def test_the_command_is_the_later_reference_less_what_is_off_now() -> None:
    off = 2.0 * 0.1 + 3.0 * 0.2 + 5.0 * (0.9 - 0.4) + 7.0 * 0.3 + 11.0 * (0.6 - 0.4) + 13.0 * (0.5 - 0.4) + 17.0 * (0.7 - 0.4)
    assert tilt_command(LAW, 0.1, 0.2, 0.9, 0.3, 0.6, (0.5, 0.7), 0.4, 0.8) == pytest.approx(0.8 - off)
    with pytest.raises(ValueError, match="shorter"):
        tilt_command(LAW, 0.1, 0.2, 0.9, 0.3, 0.6, (0.5,), 0.4, 0.8)


def test_an_axis_begins_as_it_is_measured_and_keeps_what_it_learned_of_the_wind() -> None:
    assert axis.begun(Z, 2) == TiltAxis(Observed(1.2, -0.4, 0.0, 0.0), 0.5, 0.0, 0.5, (0.5, 0.5))
    assert axis.begun(Z, 3, KNOWN) == TiltAxis(Observed(1.2, -0.4, 0.7, 0.2), 0.5, 0.0, 0.5, (0.5, 0.5, 0.5))


@pytest.mark.parametrize(("lag_s", "keep"), [(0.0, 0.0), (1e-4, 0.0), (1.1e-4, math.exp(-1.0 / 1.1)), (0.01, math.exp(-0.01))])
def test_rotors_have_a_lag_from_a_tenth_of_a_millisecond_on(lag_s: float, keep: float) -> None:
    new = axis.observed(KNOWN, Z, 1e-4, GAINS, structs.replace(TILT, lag_s=lag_s), arrived=-0.6)
    assert new.lag == pytest.approx(keep * 0.9 + (1.0 - keep) * -0.6)


def test_the_tilt_is_carried_on_by_the_model_and_a_quarter_of_the_gyro() -> None:
    new = axis.observed(KNOWN, Z, DT, GAINS, TILT, arrived=-0.6)
    assert new.seen == observer.observed(KNOWN.seen, GAINS, DT, 0.25, 0.4, 1.2, -0.4, 1.6)
    keep = math.exp(-DT / 0.08)
    assert new.lag == pytest.approx(keep * 0.9 + (1.0 - keep) * -0.6)
    model = 1.1 + DT * (81.0 * (0.9 - 0.3) - 2.0 * 0.7 * 9.0 * 1.1)
    assert new.rate == pytest.approx(0.75 * model + 0.25 * 2.0)
    assert (new.lean, new.under_way) == (0.5, KNOWN.under_way)


@pytest.mark.parametrize(("a_body", "d"), [(60.0, 4.0), (-60.0, -4.0)])
def test_no_disturbance_is_beyond_four_metres_per_second_squared(a_body: float, d: float) -> None:
    z = structs.replace(Z, a_body=a_body)
    new = axis.observed(KNOWN, z, DT, GAINS, TILT, 0.0)
    free = observer.observed(KNOWN.seen, GAINS, DT, 0.25, 0.4, 1.2, -0.4, a_body)
    assert abs(free.d) > 4.0
    assert new.seen == structs.replace(free, d=d)


def test_a_deck_stands_still_unless_its_acceleration_is_told() -> None:
    assert AxisMeasured(1.0, 2.0, 3.0, 4.0, 5.0).a_deck == 0.0


def test_a_command_is_remembered_first_and_the_oldest_forgotten() -> None:
    assert axis.commanded(KNOWN, 9.0) == structs.replace(KNOWN, under_way=(9.0, 1.0, 2.0))


def test_the_body_leans_as_the_deck_accelerates_and_against_the_disturbance() -> None:
    assert axis.reference(KNOWN, 1.5) == pytest.approx(0.8)
    wanted = tilt_command(LAW, 0.1, -0.5, 0.3, 1.1, 0.9, (1.0, 2.0), 1.5 - 0.7, 2.5 - 0.7)
    assert axis.command(KNOWN, LAW, 0.1, 1.5, 2.5) == pytest.approx(wanted)
