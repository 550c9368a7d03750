"""Forecast of the deck's motion in the next seconds, with bands. Every member of the bank contributes by its weight."""

import math
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from estimator.ekf.params import REST_ODDS

_SCALARS = ("height", "sigma_height", "rise", "sigma_rise", "roll", "sigma_roll", "pitch", "sigma_pitch")
_Z = {0.5: 0.6745, 0.68: 0.9945, 0.8: 1.2816, 0.9: 1.6449, 0.95: 1.9600, 0.99: 2.5758}


class Forecast(Struct, frozen=True, eq=False):
    """The deck at H instants ahead of `at`. Axes are those of `level` at `at`; the body is taken to keep its velocity.

    What the body really does is up to whoever steers it: subtract the planned departure from uniform motion.
    """

    at: MonoNs
    horizons_s: F64
    """(H,)"""
    d_body_pad_level: F64
    """(H, 3) m."""
    cov_d_level: F64
    """(H, 3, 3) m^2."""
    v_pad_level: F64
    """(H, 3) velocity of the pad's centre over the ground, m/s."""
    deck_height_m: F64
    """(H,) of the pad's centre above its mean level, positive up."""
    sigma_deck_height_m: F64
    rise_m_s: F64
    """(H,) vertical speed of the pad's centre, positive up."""
    sigma_rise_m_s: F64
    roll_rad: F64
    """(H,) of the deck about the arrow, starboard down positive."""
    sigma_roll_rad: F64
    pitch_rad: F64
    """(H,) of the deck, arrow up positive."""
    sigma_pitch_rad: F64
    """The fields from `deck_height_m` on are `_SCALARS` of the core's `dl_deck_ahead`, in order."""

    @classmethod
    def of(cls, at: MonoNs, horizons_s: F64, found: NDArray[Any]) -> Self:
        """Return the forecast that the core wrote as `dl_deck_ahead`, one for each horizon."""
        n = horizons_s.size
        cov_d = found["cov_d"].reshape(n, 3, 3)
        return cls(at, horizons_s, found["d"], cov_d, found["v_pad"], *(found[name] for name in _SCALARS))

    def band(self, name: str, probability: float) -> tuple[F64, F64]:
        """Return the lower and upper end of a quantity's central band.

        Each is (H,) for `deck_height_m`, `rise_m_s`, `roll_rad` and `pitch_rad`, and (H, 3) for `d_body_pad_level`.

        Raises:
            KeyError: another probability than 0.5, 0.68, 0.8, 0.9, 0.95, 0.99.
            AttributeError: another name.
        """
        z = _Z[probability]
        mean: F64 = getattr(self, name)
        if name == "d_body_pad_level":
            sigma = np.sqrt(np.maximum(np.diagonal(self.cov_d_level, axis1=1, axis2=2), 0.0))
        else:
            sigma = getattr(self, f"sigma_{name}")
        return mean - z * sigma, mean + z * sigma


def log_evidence_of_rest(rest: float) -> float:
    """Return the log of how much likelier all that was seen is from a deck at rest than from one that moves.

    Args:
        rest: the probability that the deck is at rest, by the bank.
    """
    rest = min(max(rest, 1e-12), 1.0 - 1e-12)
    return math.log(rest / (1.0 - rest)) - REST_ODDS


def probability_of_motion(
    evidence_of_rest: float, v_ned: Sequence[float], var_ned: tuple[float, float, float], prior_rest: float = 0.5
) -> float:
    """Return the probability that the vessel is under way or rocks, by the bank's evidence and the steady velocity.

    Args:
        evidence_of_rest: of the bank, `log_evidence_of_rest`.
        v_ned: (2,) the vessel's steady velocity north and east, m/s.
        var_ned: variance north, covariance, and variance east of that, (m/s)^2.
        prior_rest: the probability of rest before any evidence.
    """
    evidence = evidence_of_rest
    north, east = v_ned
    nn, ne, ee = var_ned
    # Standing still to a few cm/s against moving with some 1 m/s.
    for var, sign in ((0.03**2, 1.0), (1.0, -1.0)):
        n, e = nn + var, ee + var
        det = n * e - ne * ne
        evidence += sign * -0.5 * (math.log(det) + (e * north * north - 2.0 * ne * north * east + n * east * east) / det)
    odds = prior_rest / (1.0 - prior_rest) * math.exp(max(-60.0, min(60.0, evidence)))
    return 1.0 / (1.0 + odds)
