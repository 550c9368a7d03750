"""The Cramer-Rao bound against a case that is solved on paper, and against an estimator that reaches it."""

import numpy as np
import pytest

from tests.support.bound import information, sigmas


def test_a_line_through_noisy_points() -> None:
    x = np.arange(10.0)
    plus = [2.0 + 3.0 * x + 0.1, 2.0 + 3.1 * x]
    minus = [2.0 + 3.0 * x - 0.1, 2.0 + 2.9 * x]
    fisher = information(minus, plus, [0.1, 0.1], np.full(10, 0.25))
    assert fisher == pytest.approx(np.array([[10.0, x.sum()], [x.sum(), (x * x).sum()]]) / 0.25)
    # Textbook: the slope's variance is that of a point over the sum of squares about the mean; a known level leaves the sum.
    assert sigmas(fisher)[1] == pytest.approx(0.5 / np.sqrt(((x - x.mean()) ** 2).sum()))
    assert sigmas(fisher, known=(0,)) == pytest.approx([0.0, 0.5 / np.sqrt((x * x).sum())])


def test_an_edge_fitted_to_pixels_reaches_it() -> None:
    rng = np.random.default_rng(3)
    u, sigma = np.arange(-6.0, 7.0), 0.02

    def edge(at: float) -> np.ndarray:
        return 1.0 / (1.0 + np.exp(-(u - at)))

    fisher = information([edge(-1e-3)], [edge(1e-3)], [1e-3], np.full(len(u), sigma**2))
    slope = (edge(1e-3) - edge(-1e-3)) / 2e-3
    found = [slope @ (edge(0.0) + rng.normal(0.0, sigma, len(u)) - edge(0.0)) / (slope @ slope) for _ in range(4000)]
    assert float(np.std(found)) == pytest.approx(sigmas(fisher)[0], rel=0.05)
