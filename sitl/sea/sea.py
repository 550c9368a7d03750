"""The sea as a sum of harmonics: sea states, the surface's height at any place and time, and a scenario's table `[sea]`.

Waves are linear and run over deep water. `towards_rad` is the compass direction a wave runs to, clockwise from north.

Spectra give the energy of the surface per angular frequency, and the spread of its directions. Every spectrum is one-sided, in
m^2 s over rad/s, and scaled to a significant height of 4 sqrt(m0).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from estimator.contracts.geometry import F64
from estimator.contracts.keys import choice, number
from estimator.contracts.motion import G_M_S2
from sitl.core.library import SIM


def jonswap(w_rad_s: F64, hs_m: float, tp_s: float, gamma: float = 3.3) -> F64:
    """Return the JONSWAP spectrum at angular frequencies, positive, of any shape.

    Source: Hasselmann et al. 1973; scaled to a significant height as in DNV-RP-C205 (2010), 3.5.5, good to 1 %.
    """
    w = np.asarray(w_rad_s, dtype=float)
    wp = math.tau / tp_s
    sigma = np.where(w <= wp, 0.07, 0.09)
    peak = gamma ** np.exp(-0.5 * ((w - wp) / (sigma * wp)) ** 2)
    scale = (1.0 - 0.287 * math.log(gamma)) * 5.0 / 16.0 * hs_m**2 * wp**4
    return np.asarray(scale * w**-5 * np.exp(-1.25 * (wp / w) ** 4) * peak)


def ochi_hubble_part(w_rad_s: F64, hs_m: float, tp_s: float, shape: float) -> F64:
    """Return one of the two three-parameter parts of the Ochi-Hubble spectrum; a shape of 1 is Bretschneider's.

    Source: Ochi & Hubble, Six-parameter wave spectra, Coastal Engineering 1976, chapter 18, eq. 2.
    """
    w = np.asarray(w_rad_s, dtype=float)
    b = (4.0 * shape + 1.0) / 4.0 * (math.tau / tp_s) ** 4
    # In logarithms, because b^shape and w^-(4 shape + 1) overflow for the narrow spectra of swell.
    log = shape * math.log(b) - math.lgamma(shape) - (4.0 * shape + 1.0) * np.log(w) - b * w**-4
    return np.asarray(0.25 * hs_m**2 * np.exp(log))


Components = Literal["geometric", "equal_energy"]
"""The choice of the harmonics' frequencies: a random place inside each of geometric bins, or of bins of equal energy."""


class SeaState(Struct, frozen=True):
    """One system of waves: significant height 4 sqrt(m0), peak period of the spectrum, and its shape."""

    hs_m: float
    tp_s: float
    gamma: float = 3.3
    """Peak enhancement: 1 gives the ITTC (Bretschneider) shape, 3.3 the mean JONSWAP one."""
    shape: float | None = None
    """The shape parameter of an Ochi-Hubble part, in place of JONSWAP; 3 is a swell, 1.5 a wind sea."""

    def density(self, w_rad_s: F64) -> F64:
        """Return the spectrum, m^2 s, at angular frequencies, positive, of any shape."""
        if self.shape is not None:
            return ochi_hubble_part(w_rad_s, self.hs_m, self.tp_s, self.shape)
        return jonswap(w_rad_s, self.hs_m, self.tp_s, self.gamma)

    @staticmethod
    def fully_grown(hs_m: float) -> SeaState:
        """Return the one-parameter Pierson-Moskowitz sea: the height sets the period.

        Source: Pierson & Moskowitz 1964 by height, S = 0.0081 g^2 w^-5 exp(-0.032 (g / Hs)^2 w^-4): wp = 0.4 sqrt(g / Hs).
        """
        return SeaState(hs_m, math.tau / (0.4 * math.sqrt(G_M_S2 / hs_m)) if hs_m > 0 else 2.0, 1.0)

    @staticmethod
    def swell_and_wind_sea(hs_m: float) -> tuple[SeaState, SeaState]:
        """Return the two parts of the most probable Ochi-Hubble spectrum of this significant height.

        The two heights are scaled by 0.14 % so that they add up to `hs_m`.
        Source: Ochi & Hubble 1976, table 2b, "most probable" of 800 North Atlantic spectra.
        """
        swell, wind = 0.84, 0.54
        scale = hs_m / math.hypot(swell, wind)
        return (
            SeaState(swell * scale, math.tau / (0.70 * math.exp(-0.046 * hs_m)), 1.0, 3.0),
            SeaState(wind * scale, math.tau / (1.15 * math.exp(-0.039 * hs_m)), 1.0, 1.54 * math.exp(-0.062 * hs_m)),
        )


SEA_STATES: dict[int, SeaState] = {
    0: SeaState(0.0, 2.0),
    1: SeaState(0.05, 2.0),
    2: SeaState(0.30, 7.0),
    3: SeaState(0.88, 7.5),
    4: SeaState(1.88, 8.8),
    5: SeaState(3.25, 9.7),
    6: SeaState(5.00, 12.4),
}
"""Mean heights of the WMO 3700 bands with the most probable modal periods of the open North Atlantic.

Source: Bales, Designing ships to the natural environment, Naval Engineers Journal 1983, as in STANAG 4194; the periods of 0, 1
and 2 are assumed (waves that low have no typical period there).
"""


@dataclass(frozen=True, eq=False)
class Waves:
    """B seas of N harmonics each; the surface is at sum a cos(k.p - w t + phase) above mean water."""

    amplitude_m: F64
    """(B, N) amplitudes, m."""
    w_rad_s: F64
    """(B, N) angular frequencies, rad/s, positive."""
    towards_rad: F64
    """(B, N) directions to which the harmonics run, rad."""
    phase_rad: F64
    """(B, N) phases, rad."""
    current_ne_m_s: tuple[float, float] = (0.0, 0.0)
    """Velocity of the water itself, m/s north and east, which carries the waves along; `w_rad_s` is relative to the water."""

    @staticmethod
    def draw(
        state: SeaState,
        seeds: int | Sequence[int],
        *,
        towards_rad: float = 0.0,
        spreading: float = 10.0,
        harmonics: int = 60,
        components: Components = "geometric",
        stream: int = 0,
    ) -> Waves:
        """Draw one sea for each seed. The same seed gives the same sea, alone or in a batch, and `hs_m` is met exactly.

        Frequencies lie at random places inside bins from 0.5 to 5 times the peak's, so that the sum does not repeat itself within
        a flight; amplitudes come from the spectrum's energy in the bin.

        Args:
            components: geometric bins show the tail that moves small vessels; bins of equal energy lie close around the peak.
            stream: distinguishes the systems of waves of one seed.
            towards_rad: mean direction to which the waves run.
            spreading: exponent s of the cos^2s((towards - mean) / 2) spread; 10 is a wind sea, 75 a long swell.

        Source: spread after Longuet-Higgins, Cartwright & Smith 1963; random phases and places as in DNV-RP-C205, 3.3.2.
        """
        edges = np.geomspace(0.5, 5.0, harmonics + 1) * math.tau / state.tp_s
        grid = np.geomspace(edges[0], edges[-1], 8 * harmonics + 1)
        density = state.density(grid)
        energy = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(grid))])
        if components == "equal_energy" and energy[-1] > 0:
            in_bin = np.full(harmonics, energy[-1] / harmonics)
        else:
            in_bin = np.diff(energy[::8])
        total = float(in_bin.sum())
        amplitude = np.sqrt(2.0 * in_bin * ((state.hs_m / 4.0) ** 2 / total)) if total > 0 else np.zeros(harmonics)
        angle = np.linspace(-math.pi, math.pi, 721)
        cdf = np.cumsum(np.cos(angle / 2.0) ** (2.0 * spreading))
        cdf = cdf / cdf[-1]
        w, towards, phase = [], [], []
        for seed in [seeds] if isinstance(seeds, int) else seeds:
            rng = np.random.default_rng([seed, 0x5EA, stream] if stream else [seed, 0x5EA])
            place, direction, start = rng.random((3, harmonics))
            if components == "equal_energy" and total > 0:  # a place by energy, or the tail of the last bin would be overstated
                w.append(np.interp((np.arange(harmonics) + place) / harmonics, energy / energy[-1], grid))
            else:
                w.append(edges[:-1] + place * np.diff(edges))
            towards.append(towards_rad + np.interp(direction, cdf, angle))
            phase.append(math.tau * start)
        w_all = np.array(w)
        return Waves(np.broadcast_to(amplitude, w_all.shape), w_all, np.array(towards), np.array(phase))

    @staticmethod
    def together(systems: Sequence[Waves]) -> Waves:
        """Return the sum of systems of waves of the same batch, such as a swell and a wind sea."""
        first = systems[0]
        amplitude, w, towards, phase = (
            np.concatenate([getattr(s, name) for s in systems], axis=1)
            for name in ("amplitude_m", "w_rad_s", "towards_rad", "phase_rad")
        )
        return Waves(amplitude, w, towards, phase, first.current_ne_m_s)

    def carried(self, current_ne_m_s: tuple[float, float]) -> Waves:
        """Return the same waves on water that moves with this velocity, m/s north and east."""
        return replace(self, current_ne_m_s=current_ne_m_s)

    @property
    def batch(self) -> int:
        return int(self.amplitude_m.shape[0])

    @property
    def hs_m(self) -> F64:
        """Significant wave height (B,), m: 4 sqrt(m0) of the harmonics."""
        return np.asarray(4.0 * np.sqrt((self.amplitude_m**2).sum(axis=1) / 2.0))

    @cached_property
    def k_ne(self) -> F64:
        """Wave numbers (B, N, 2) north and east, rad/m: w^2 = g k in deep water."""
        k = self.w_rad_s**2 / G_M_S2
        return np.stack([k * np.cos(self.towards_rad), k * np.sin(self.towards_rad)], axis=-1)

    @cached_property
    def seen_rad_s(self) -> F64:
        """Angular frequencies (B, N), rad/s, at a place fixed over the ground: w + k . current (Doppler)."""
        north, east = self.current_ne_m_s
        return self.w_rad_s if north == 0.0 and east == 0.0 else self.w_rad_s + self.k_ne @ np.array([north, east])

    def longest(self, n: int) -> Waves:
        """Return the n harmonics of greatest amplitude, which a frame from some metres up shows as swell."""
        order = np.argsort(-self.amplitude_m, axis=1, kind="stable")[:, :n]
        amplitude, w, towards, phase = (
            np.take_along_axis(v, order, 1) for v in (self.amplitude_m, self.w_rad_s, self.towards_rad, self.phase_rad)
        )
        return Waves(amplitude, w, towards, phase, self.current_ne_m_s)

    def elevation(self, p_ne: ArrayLike, t_s: ArrayLike = 0.0) -> F64:
        """Return the surface's height (B, ...), m above mean water, at places (..., 2) m north and east and times (...)."""
        return np.asarray((self.amplitude_m * np.cos(self._angle(p_ne, t_s))).sum(axis=-1).transpose(self._order(p_ne, t_s)))

    def packed(self, index: int = 0) -> NDArray[Any]:
        """Return one sea as the core's `dl_sim_wave`s, (N,), with frequencies as seen."""
        waves = np.empty(self.amplitude_m.shape[1], SIM.dtype("dl_sim_wave"))
        waves["amplitude_m"], waves["k"] = self.amplitude_m[index], self.k_ne[index]
        waves["w_rad_s"], waves["phase_rad"] = self.seen_rad_s[index], self.phase_rad[index]
        return waves

    def _angle(self, p_ne: ArrayLike, t_s: ArrayLike) -> F64:
        """Return the phase angle (..., B, N) of each harmonic, rad."""
        p = np.asarray(p_ne, dtype=float)[..., None, None, :]
        t = np.asarray(t_s, dtype=float)[..., None, None]
        k = self.k_ne
        return np.asarray(p[..., 0] * k[..., 0] + p[..., 1] * k[..., 1] - self.seen_rad_s * t + self.phase_rad)

    @staticmethod
    def _order(p_ne: ArrayLike, t_s: ArrayLike) -> tuple[int, ...]:
        n = max(np.ndim(p_ne) - 1, np.ndim(t_s))
        return (n, *range(n))


Direction = Annotated[float, number("mean direction the waves run to, clockwise from north", "deg", -360.0, 360.0)]
Spread = Annotated[float, number("exponent s of the cos^2s spread of directions; 10 a wind sea, 75 a swell", "1", 1.0, 100.0)]

EXCLUDES: dict[str, tuple[str, ...]] = {
    "sea_state": ("significant_height_m", "peak_period_s", "swell", "wind_sea"),
    "significant_height_m": ("sea_state", "swell", "wind_sea"),
    "peak_period_s": ("sea_state",),
    "wind_sea": ("sea_state", "significant_height_m", "peak_period_s"),
}
"""Keys that take the place of those of a base when a scenario that is built on it says them."""


class System(NamedTuple):
    """One system of waves, and where it runs."""

    state: SeaState
    towards_rad: float
    spreading: float


class WaveSystem(Struct, frozen=True, forbid_unknown_fields=True):
    """One of the two parts of an Ochi-Hubble sea, or a swell beside another one."""

    height_m: Annotated[float, number("significant height of this part alone", "m", 0.0, 10.0)]
    period_s: Annotated[float, number("period of its peak", "s", 1.0, 25.0)]
    shape: Annotated[float, number("Ochi and Hubble's lambda: 1.5 a wind sea, 3 and more a swell", "1", 0.8, 30.0)] = 3.0
    runs_to_deg: Direction | None = None
    spreading: Spread | None = None

    def beside(self, sea: Sea, usual_spreading: float) -> System:
        """Return this part of a sea, which has its direction and spreading where this says none."""
        to_deg = sea.runs_to_deg or 0.0 if self.runs_to_deg is None else self.runs_to_deg
        state = SeaState(self.height_m, self.period_s, 1.0, self.shape)
        return System(state, math.radians(to_deg), self.spreading or sea.spreading or usual_spreading)


class Sea(Struct, frozen=True, forbid_unknown_fields=True):
    """The waves, which also move the vessel."""

    sea_state: Annotated[int, number("WMO code 3700; gives significant height and peak period", "1", 0, 6)] | None = None
    spectrum: Annotated[
        Literal["jonswap", "pierson_moskowitz", "ochi_hubble"],
        choice(
            "JONSWAP; a fully grown sea, where the height alone sets the period; or a swell and a wind sea, "
            "the most probable ones for the height unless swell and wind_sea say which; a swell may stand beside the others too"
        ),
    ] = "jonswap"
    components: Annotated[
        Components, choice("the harmonics' frequencies: random places in geometric bins, or in bins of equal energy")
    ] = "geometric"
    significant_height_m: (
        Annotated[float, number("significant wave height, 4 sqrt(m0); 0 is flat water; 0.3 by default", "m", 0.0, 10.0)] | None
    ) = None
    peak_period_s: Annotated[float, number("period of the spectrum's peak; 3.5 by default", "s", 1.0, 20.0)] | None = None
    peak_enhancement: (
        Annotated[float, number("JONSWAP's gamma, 3.3 by default; 1 is a fully grown sea", "1", 1.0, 10.0, "mean JONSWAP")] | None
    ) = None
    runs_to_deg: Direction | None = None
    spreading: Spread | None = None
    swell: WaveSystem | None = None
    wind_sea: WaveSystem | None = None
    current_m_s: Annotated[float, number("speed of the water, which carries waves and unmoored vessels", "m/s", 0.0, 5.0)] = 0.0
    current_to_deg: (
        Annotated[float, number("direction to which the current runs, clockwise from north", "deg", -360.0, 360.0)] | None
    ) = None

    def __post_init__(self) -> None:
        parts = [name for name in ("swell", "wind_sea") if getattr(self, name) is not None]
        shared = parts if self.spectrum == "ochi_hubble" or self.wind_sea is not None else []
        if self.sea_state is not None:
            for name in ("significant_height_m", "peak_period_s", *shared):
                if getattr(self, name) is not None:
                    raise ValueError(f"sea_state sets the height and the period: give either it or {name}")
        if self.spectrum != "jonswap" and self.peak_enhancement is not None:
            raise ValueError(f"peak_enhancement is JONSWAP's; the spectrum is {self.spectrum}")
        if self.spectrum != "jonswap" and self.peak_period_s is not None:
            raise ValueError(f"peak_period_s does not go with {self.spectrum}: its periods follow from the height")
        if self.wind_sea is not None and self.spectrum != "ochi_hubble":
            raise ValueError(f"wind_sea belongs to the spectrum ochi_hubble; the spectrum is {self.spectrum}")
        if shared and self.significant_height_m is not None:
            raise ValueError(f"significant_height_m follows from swell and wind_sea: give either it or {shared[0]}")
        if self.spreading is not None and self.runs_to_deg is None:
            raise ValueError("spreading needs runs_to_deg, the direction about which the waves spread")
        for name in parts:
            part = getattr(self, name)
            if part.spreading is not None and part.runs_to_deg is None and self.runs_to_deg is None:
                raise ValueError(f"{name}.spreading needs runs_to_deg, the direction about which the waves spread")
        if self.current_m_s > 0 and self.current_to_deg is None:
            raise ValueError("current_m_s needs current_to_deg, the direction that the current runs to")

    def systems(self) -> tuple[System, ...]:
        """Return the systems of waves that these settings describe."""
        towards = math.radians(self.runs_to_deg or 0.0)
        wide = 10.0 if self.spreading is None else self.spreading
        height = self._height_m()
        swell = () if self.swell is None else (self.swell.beside(self, 75.0),)
        if self.spectrum == "pierson_moskowitz":
            return (System(SeaState.fully_grown(height), towards, wide), *swell)
        if self.spectrum == "jonswap":
            gamma = 3.3 if self.peak_enhancement is None else self.peak_enhancement
            return (System(SeaState(height, self._period_s(), gamma), towards, wide), *swell)
        if self.swell is None and self.wind_sea is None:
            old, young = SeaState.swell_and_wind_sea(height)
            return (System(old, towards, 75.0 if self.spreading is None else wide), System(young, towards, wide))
        return (*swell, *(() if self.wind_sea is None else (self.wind_sea.beside(self, 10.0),)))

    def waves(self, seeds: list[int]) -> Waves:
        """Return B seas, one for each seed."""
        systems = [
            Waves.draw(
                s.state, seeds, towards_rad=s.towards_rad, spreading=s.spreading, components=self.components, stream=stream
            )
            for stream, s in enumerate(self.systems())
        ]
        waves = systems[0] if len(systems) == 1 else Waves.together(systems)
        return waves.carried(self.current_ne_m_s) if self.current_m_s > 0 else waves

    @property
    def current_ne_m_s(self) -> tuple[float, float]:
        """Velocity of the water, m/s north and east."""
        to = math.radians(self.current_to_deg or 0.0)
        return (self.current_m_s * math.cos(to), self.current_m_s * math.sin(to))

    def _height_m(self) -> float:
        if self.sea_state is not None:
            return SEA_STATES[self.sea_state].hs_m
        return 0.3 if self.significant_height_m is None else self.significant_height_m

    def _period_s(self) -> float:
        if self.sea_state is not None:
            return SEA_STATES[self.sea_state].tp_s
        return 3.5 if self.peak_period_s is None else self.peak_period_s
