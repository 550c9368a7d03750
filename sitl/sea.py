"""The sea as a sum of harmonics: spectra, sea states, and the surface's height at any place and time.

Waves are linear and run over deep water. `towards_rad` is the compass direction a wave runs to, clockwise from north.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64

GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, slots=True)
class SeaState:
    """Significant height 4 sqrt(m0), peak period of the spectrum, and the peak's enhancement.

    Raises:
        ValueError: a negative height, or a period or enhancement that is not positive.
    """

    hs_m: float
    tp_s: float
    gamma: float = 3.3
    """1 gives the ITTC (Bretschneider) shape, 3.3 the mean JONSWAP one."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.hs_m) and self.hs_m >= 0):
            raise ValueError(f"hs_m must be a height of 0 m or more, got {self.hs_m!r}")
        if not (math.isfinite(self.tp_s) and self.tp_s > 0 and math.isfinite(self.gamma) and self.gamma >= 1):
            raise ValueError(f"tp_s must be positive and gamma 1 or more, got {self.tp_s!r}, {self.gamma!r}")


SEA_STATES: dict[int, SeaState] = {
    0: SeaState(0.0, 2.0),
    1: SeaState(0.05, 2.0),
    2: SeaState(0.30, 7.0),
    3: SeaState(0.88, 7.5),
    4: SeaState(1.88, 8.8),
    5: SeaState(3.25, 9.7),
    6: SeaState(5.00, 12.4),
}
"""Mean heights of the WMO 3700 bands with the modal periods usual for the open North Atlantic (NATO type tables)."""

SHELTERED_SLIGHT = SeaState(0.20, 3.0)
"""Sea state 2 in sheltered water, where the period is 2 to 4 s: what a boat at anchor in a bay feels."""


def sea_state(code: int) -> SeaState:
    """The preset of a WMO sea state code 0..6.

    Raises:
        BadInput: another code.
    """
    if code not in SEA_STATES:
        raise BadInput(f"sea state must be one of {', '.join(map(str, SEA_STATES))}, got {code!r}")
    return SEA_STATES[code]


def ittc(w_rad_s: F64, hs_m: float, tp_s: float) -> F64:
    """ITTC's modified Pierson-Moskowitz spectrum, m^2 s, of the angular frequency (same shape as `w_rad_s`, positive).

    Source: ITTC 1978 two-parameter spectrum with the modal period, A = 487 Hs^2 / T0^4, B = 1949 / T0^4.
    """
    w = np.asarray(w_rad_s, dtype=float)
    return np.asarray(487.0 * hs_m**2 / tp_s**4 * w**-5 * np.exp(-1949.0 / tp_s**4 * w**-4))


def jonswap(w_rad_s: F64, hs_m: float, tp_s: float, gamma: float = 3.3) -> F64:
    """JONSWAP spectrum, m^2 s, of the angular frequency (same shape as `w_rad_s`, positive).

    Source: Hasselmann et al. 1973; scaled to a significant height as in DNV-RP-C205 (2010), 3.5.5, good to 1 %.
    """
    w = np.asarray(w_rad_s, dtype=float)
    wp = math.tau / tp_s
    sigma = np.where(w <= wp, 0.07, 0.09)
    peak = gamma ** np.exp(-0.5 * ((w - wp) / (sigma * wp)) ** 2)
    scale = (1.0 - 0.287 * math.log(gamma)) * 5.0 / 16.0 * hs_m**2 * wp**4
    return np.asarray(scale * w**-5 * np.exp(-1.25 * (wp / w) ** 4) * peak)


@dataclass(frozen=True, slots=True, eq=False)
class Waves:
    """B seas of N harmonics each; the surface stands at sum a cos(k.p - w t + phase) above mean water."""

    amplitude_m: F64
    """(B, N)."""
    w_rad_s: F64
    """(B, N), positive."""
    towards_rad: F64
    """(B, N)."""
    phase_rad: F64
    """(B, N)."""

    @staticmethod
    def draw(
        state: SeaState,
        seeds: int | Sequence[int],
        *,
        towards_rad: float = 0.0,
        spreading: float = 10.0,
        harmonics: int = 60,
    ) -> Waves:
        """One sea a seed. The same seed gives the same sea, alone or in a batch, and `hs_m` is met exactly.

        Frequencies lie at random places inside geometric bins from 0.5 to 5 times the peak's, so that the sum does not
        repeat itself within a flight; amplitudes come from the spectrum's energy in the bin.

        Args:
            towards_rad: mean direction the waves run to.
            spreading: exponent s of the cos^2s((towards - mean) / 2) spread; 10 is a wind sea, 75 a long swell.
        Source: spread after Longuet-Higgins, Cartwright & Smith 1963; random phases and places as in DNV-RP-C205, 3.3.2.
        """
        edges = np.geomspace(0.5, 5.0, harmonics + 1) * math.tau / state.tp_s
        grid = np.geomspace(edges[0], edges[-1], 8 * harmonics + 1)
        density = jonswap(grid, state.hs_m, state.tp_s, state.gamma)
        energy = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(grid))])
        in_bin = np.diff(energy[::8])
        total = float(in_bin.sum())
        amplitude = np.sqrt(2.0 * in_bin * ((state.hs_m / 4.0) ** 2 / total)) if total > 0 else np.zeros(harmonics)
        angle = np.linspace(-math.pi, math.pi, 721)
        cdf = np.cumsum(np.cos(angle / 2.0) ** (2.0 * spreading))
        cdf = cdf / cdf[-1]
        w, towards, phase = [], [], []
        for seed in [seeds] if isinstance(seeds, int) else seeds:
            rng = np.random.default_rng([seed, 0x5EA])
            place, direction, start = rng.random((3, harmonics))
            w.append(edges[:-1] + place * np.diff(edges))
            towards.append(towards_rad + np.interp(direction, cdf, angle))
            phase.append(math.tau * start)
        w_all = np.array(w)
        return Waves(np.broadcast_to(amplitude, w_all.shape), w_all, np.array(towards), np.array(phase))

    @staticmethod
    def flat(batch: int = 1) -> Waves:
        """No waves at all."""
        zero = np.zeros((batch, 1))
        return Waves(zero, zero + 1.0, zero, zero)

    @property
    def batch(self) -> int:
        return int(self.amplitude_m.shape[0])

    @property
    def hs_m(self) -> F64:
        """(B,) m, 4 sqrt(m0) of the harmonics."""
        return np.asarray(4.0 * np.sqrt((self.amplitude_m**2).sum(axis=1) / 2.0))

    @property
    def k_ne(self) -> F64:
        """(B, N, 2) rad/m, wave number north and east: w^2 = g k in deep water."""
        k = self.w_rad_s**2 / GRAVITY_M_S2
        return np.stack([k * np.cos(self.towards_rad), k * np.sin(self.towards_rad)], axis=-1)

    def longest(self, n: int) -> Waves:
        """The n harmonics of greatest amplitude, those that a frame from some metres up shows as swell."""
        order = np.argsort(-self.amplitude_m, axis=1, kind="stable")[:, :n]
        return Waves(
            *(np.take_along_axis(v, order, 1) for v in (self.amplitude_m, self.w_rad_s, self.towards_rad, self.phase_rad))
        )

    def elevation(self, p_ne: ArrayLike, t_s: ArrayLike = 0.0) -> F64:
        """(B, ...) m above mean water at places (..., 2) m north and east and times broadcast to (...)."""
        return np.asarray((self.amplitude_m * np.cos(self._angle(p_ne, t_s))).sum(axis=-1).transpose(self._order(p_ne, t_s)))

    def slope(self, p_ne: ArrayLike, t_s: ArrayLike = 0.0) -> F64:
        """(B, ..., 2) rise of the surface per metre north and east; shapes as in `elevation`."""
        s = -self.amplitude_m * np.sin(self._angle(p_ne, t_s))
        k = self.k_ne
        order = self._order(p_ne, t_s)
        return np.stack([(s * k[..., i]).sum(axis=-1).transpose(order) for i in (0, 1)], axis=-1)

    def _angle(self, p_ne: ArrayLike, t_s: ArrayLike) -> F64:
        """(..., B, N) rad."""
        p = np.asarray(p_ne, dtype=float)[..., None, None, :]
        t = np.asarray(t_s, dtype=float)[..., None, None]
        k = self.k_ne
        return np.asarray(p[..., 0] * k[..., 0] + p[..., 1] * k[..., 1] - self.w_rad_s * t + self.phase_rad)

    @staticmethod
    def _order(p_ne: ArrayLike, t_s: ArrayLike) -> tuple[int, ...]:
        n = max(np.ndim(p_ne) - 1, np.ndim(t_s))
        return (n, *range(n))
