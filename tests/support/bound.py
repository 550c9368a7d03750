"""Compute the Cramer-Rao bound: the smallest errors that any unbiased estimator can reach on given frames.

Source: Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, section 3.9 (signals in Gaussian noise).
"""

import numpy as np

from estimator.contracts.geometry import F64


def information(minus: list[F64], plus: list[F64], steps: list[float], var: F64) -> F64:
    """Return the Fisher information about parameters, computed from mean frames at small steps to either side.

    Args:
        minus, plus: P mean frames each, any shape; frame i has parameter i moved down or up by its step.
        steps: P steps, in the parameters' units.
        var: variance of each pixel's noise, in the frames' shape. The noise is independent between pixels; its own dependence on
            the parameters is neglected.

    Returns:
        (P, P) symmetric information matrix.
    """
    changes = np.stack([((p - m) / (2.0 * s)).ravel() for m, p, s in zip(minus, plus, steps, strict=True)])
    return np.asarray((changes / var.ravel()) @ changes.T)


def sigmas(fisher: F64, known: tuple[int, ...] = ()) -> F64:
    """Return the (P,) smallest standard deviations of unbiased estimates; 0 for the parameters with an index in `known`."""
    free = [i for i in range(len(fisher)) if i not in known]
    out = np.zeros(len(fisher))
    out[free] = np.sqrt(np.diag(np.linalg.inv(fisher[np.ix_(free, free)])))
    return out
