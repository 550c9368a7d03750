"""The Cramer-Rao bound: how well any unbiased estimator could do on given frames.

Source: Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 3.9 (signals in Gaussian noise).
"""

from __future__ import annotations

import numpy as np

from estimator.contracts.geometry import F64


def information(minus: list[F64], plus: list[F64], steps: list[float], var: F64) -> F64:
    """Fisher information about parameters from the mean frames at small steps to either side.

    Args:
        minus, plus: P mean frames each, any shape, one parameter moved by its step down and up.
        steps: P steps, in the parameters' units.
        var: variance of each pixel's noise, of the frames' shape; the noise is independent between pixels, and so weak a
            function of the parameters that it tells nothing by itself.
    Returns:
        (P, P) symmetric.
    """
    changes = np.stack([((p - m) / (2.0 * s)).ravel() for m, p, s in zip(minus, plus, steps, strict=True)])
    return np.asarray((changes / var.ravel()) @ changes.T)


def sigmas(fisher: F64, known: tuple[int, ...] = ()) -> F64:
    """(P,) smallest standard deviations of unbiased estimates, 0 for those parameters that are known beforehand."""
    free = [i for i in range(len(fisher)) if i not in known]
    out = np.zeros(len(fisher))
    out[free] = np.sqrt(np.diag(np.linalg.inv(fisher[np.ix_(free, free)])))
    return out
