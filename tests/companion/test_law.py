"""The gains of the law that follows the deck, beside scipy's, and its model of the vehicle."""

import math

import numpy as np
import pytest
from msgspec import structs
from scipy.linalg import solve_discrete_are

from companion.guidance.law.gains import (
    SIGMAS_P_M,
    ObserverNoise,
    TiltWeights,
    chosen,
    exponential,
    observer,
    observer_gains,
    regulator,
    tilt_gains,
    tilt_model,
)
from companion.guidance.law.margins import margins
from companion.settings.guidance import TiltResponse
from companion.settings.load import shipped_response

RESPONSE = shipped_response("ardrone2")
TILT = TiltResponse(0.05, 9.0, 0.7, lag_s=0.08)
T = 0.02


def test_what_no_input_reaches_has_no_gains() -> None:
    with pytest.raises(ValueError, match="stabilised"):
        regulator(np.array([[1.1]]), np.array([[0.0]]), np.eye(1), np.eye(1))


def test_the_observer_gain_is_that_of_the_scalar_filter() -> None:
    """X' = x + w, z = x + v: P = (q + sqrt(q^2 + 4 q r)) / 2 before the measurement (Anderson & Moore 1979, sec. 4.4)."""
    q, r = 0.04, 0.3
    P = 0.5 * (q + math.sqrt(q * q + 4.0 * q * r))
    L = observer(np.eye(1), np.eye(1), np.array([[q]]), np.array([[r]]))
    assert L[0, 0] == pytest.approx(P / (P + r))


def test_the_exponential_turns() -> None:
    for angle in (1e-6, 0.3, 4.0, -11.0):
        e = exponential(np.array([[0.0, -angle], [angle, 0.0]]))
        assert e == pytest.approx(np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]))


@pytest.mark.parametrize("delay_s", [0.0, 0.013, 0.02, 0.05, 0.0731])
@pytest.mark.parametrize("lag_s", [0.0, 0.073])
def test_the_discrete_model_is_the_continuous_one(delay_s: float, lag_s: float) -> None:
    """The model is compared with small steps of the differential equations, for commands that are held for a period each."""
    tilt = TiltResponse(delay_s, 5.0, 0.7, lag_s)
    model = tilt_model(tilt, T)
    u = np.random.default_rng(3).standard_normal(25)
    x = np.zeros(model.A.shape[0])
    for command in u:
        x = model.A @ x + model.B * command
    dt = 1e-5
    p = w = a = rate = f = 0.0
    for k in range(round(25 * T / dt)):
        at = k * dt - delay_s
        given_now = u[int(at / T + 1e-9)] if at >= -1e-12 else 0.0
        f = f + dt * (given_now - f) / lag_s if lag_s else given_now
        p, w, a, rate = p + dt * w, w - dt * a, a + dt * rate, rate + dt * (25.0 * (f - a) - 7.0 * rate)
    assert x[:4] == pytest.approx([p, w, a, rate], rel=2e-3, abs=2e-3)


def test_the_shipped_law_stands_sixty_milliseconds_more_than_it_knows() -> None:
    whole = margins(RESPONSE.tilt)
    assert whole.stable
    assert whole.delay_s >= 0.06
    assert whole.gain[1] >= 2.0
    assert whole.phase_deg >= 25.0
    assert whole.error_m < 0.018


def test_the_gains_that_are_kept_reach_from_five_millimetres_to_sixteen_centimetres() -> None:
    assert SIGMAS_P_M == (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
    for n, sigma in enumerate(SIGMAS_P_M):
        assert chosen(SIGMAS_P_M, 0.9 * sigma) == sigma
        assert chosen(SIGMAS_P_M, 1.4 * sigma) == sigma
        assert chosen(SIGMAS_P_M, 1.41 * sigma) == SIGMAS_P_M[min(n + 1, 5)]


@pytest.mark.parametrize("accelerometer", [True, False])
def test_the_observers_gains_solve_its_riccati_equation(accelerometer: bool) -> None:
    table = observer_gains(ObserverNoise(accelerometer=accelerometer), T)
    A = np.array([[1.0, T, -0.5 * T**2, 0.0], [0.0, 1.0, -T, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
    Q = np.diag([1e-8, 0.01 * T, 2.0 * T, 0.1 * T])
    for sigma, gains in zip(SIGMAS_P_M, table, strict=True):
        R = np.diag([10.0 * sigma**2, 10.0 * 0.08**2, 0.06**2 if accelerometer else 1e6])
        P = solve_discrete_are(A.T, C.T, Q, R)
        np.testing.assert_allclose(gains.rows, P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=2e-4, atol=1e-7)
    assert ObserverNoise().accelerometer


@pytest.mark.parametrize(("lag_s", "delay_line"), [(0.08, True), (0.0, True), (0.08, False)])
def test_the_regulators_gains_solve_its_riccati_equation(lag_s: float, delay_line: bool) -> None:
    response = structs.replace(TILT, lag_s=lag_s)
    gains = tilt_gains(response, TiltWeights(), T, delay_line=delay_line)
    model = tilt_model(structs.replace(response, delay_s=0.05 if delay_line else 0.0), T)
    B, Q = model.B[:, None], np.zeros_like(model.A)
    Q[:3, :3] = np.outer((1.0, 0.0, 0.01), (1.0, 0.0, 0.01)) / 0.006**2
    Q[1, 1] = 4.1**-2
    R = np.array([[0.3**-2]])
    S = solve_discrete_are(model.A, B, Q, R)
    K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ model.A)[0]
    lag = (gains.lag,) if lag_s else ()
    np.testing.assert_allclose((*gains[:4], *lag, *gains.under_way), K, rtol=1e-9)
    assert delay_line is (gains == tilt_gains(response, TiltWeights(), T))
    assert len(gains.under_way) == (3 if delay_line else 1)
    assert (gains.lag == 0.0) is (lag_s == 0.0)
