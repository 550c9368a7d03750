"""The identification of a vehicle's properties, on signals whose answer is known."""

import numpy as np
import pytest

from benches.vehicle_identification import _best_lag, interval, loops_behind_lag
from estimator.contracts.geometry import F64


def test_a_known_lag_is_found_within_its_interval() -> None:
    rng = np.random.default_rng(3)
    n, step, lag = 6000, 0.005, 0.05
    u = np.convolve(rng.standard_normal(n), np.ones(10) / 10, "same")
    y = np.zeros(n)
    for i in range(1, n):
        y[i] = y[i - 1] + step / lag * (u[i] - y[i - 1])
    text = _best_lag(u, y + 0.02 * rng.standard_normal(n), np.arange(n) // 400, step, "known")
    value, low, high = (float(x) for x in text.replace("[", " ").replace("]", " ").replace(",", " ").split()[3:6])
    assert value == pytest.approx(lag, abs=0.0051)
    assert low <= value <= high


def test_an_interval_widens_with_the_noise_of_the_pieces() -> None:
    rng = np.random.default_rng(4)
    widths = []
    for sigma in (0.1, 1.0):
        values = 5.0 + sigma * rng.standard_normal(40)

        def mean(count: F64, values: F64 = values) -> F64:
            return np.array([float(values @ count / count.sum())])

        best, low, high = interval(mean, 40)
        assert low[0] < best[0] < high[0]
        widths.append(float(high[0] - low[0]))
    assert widths[1] == pytest.approx(2 * 1.96 / np.sqrt(40), rel=0.35)
    assert widths[0] < 0.2 * widths[1]


def test_loops_behind_a_motor_lag_have_the_poles_requested() -> None:
    p, d = loops_behind_lag(11.5, 0.65, 0.03)
    roots = np.roots([0.03, 1.0, d, p])
    slow = roots[np.argsort(np.abs(roots))[:2]]
    assert np.abs(slow) == pytest.approx([11.5, 11.5])
    assert -slow.real / np.abs(slow) == pytest.approx([0.65, 0.65])
    with pytest.raises(ValueError, match="too long"):
        loops_behind_lag(11.5, 0.65, 0.06)
