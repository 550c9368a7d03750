"""The gains of one axis of the deck's follower beside scipy's."""

import numpy as np
import pytest
from msgspec import structs
from scipy.linalg import solve_discrete_are

from companion.guidance.law.gains import SIGMAS_P_M, ObserverNoise, TiltWeights, chosen, observer_gains, tilt_gains, tilt_model
from companion.settings.response import TiltResponse

TILT = TiltResponse(0.05, 9.0, 0.7, lag_s=0.08)
DT = 0.02


def test_the_gains_that_are_kept_reach_from_five_millimetres_to_sixteen_centimetres() -> None:
    assert SIGMAS_P_M == (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
    for n, sigma in enumerate(SIGMAS_P_M):
        assert chosen(SIGMAS_P_M, 0.9 * sigma) == sigma
        assert chosen(SIGMAS_P_M, 1.4 * sigma) == sigma
        assert chosen(SIGMAS_P_M, 1.41 * sigma) == SIGMAS_P_M[min(n + 1, 5)]
    with pytest.raises(IndexError):
        chosen((1.0,), 1.0)


@pytest.mark.parametrize("accelerometer", [True, False])
def test_the_observers_gains_solve_its_riccati_equation(accelerometer: bool) -> None:
    table = observer_gains(ObserverNoise(accelerometer=accelerometer), DT)
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
    Q[:3, :3] = np.outer((1.0, 0.0, 0.01), (1.0, 0.0, 0.01)) / 0.006**2
    Q[1, 1] = 4.1**-2
    R = np.array([[0.3**-2]])
    S = solve_discrete_are(model.A, B, Q, R)
    K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ model.A)[0]
    lag = (gains.lag,) if lag_s else ()
    np.testing.assert_allclose((*gains[:4], *lag, *gains.under_way), K, rtol=1e-9)
    assert delay_line is (gains == tilt_gains(response, TiltWeights(), DT))
    assert len(gains.under_way) == (3 if delay_line else 1)
    assert (gains.lag == 0.0) is (lag_s == 0.0)
