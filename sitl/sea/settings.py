"""The table `[sea]` of a scenario: which waves there are, and the systems of waves that follow from it."""

from __future__ import annotations

import math
from typing import Annotated, Literal, NamedTuple

from msgspec import Struct

from estimator.contracts.keys import choice, number
from sitl.sea.sea import SEA_STATES, Components, SeaState, Waves

Direction = Annotated[float, number("mean direction the waves run to, clockwise from north", "deg", -360.0, 360.0)]
Spread = Annotated[float, number("exponent s of the cos^2s spread of directions; 10 a wind sea, 75 a swell", "1", 1.0, 100.0)]

EXCLUDES: dict[str, tuple[str, ...]] = {
    "sea_state": ("significant_height_m", "peak_period_s", "swell", "wind_sea"),
    "significant_height_m": ("sea_state", "swell", "wind_sea"),
    "peak_period_s": ("sea_state",),
    "swell": ("sea_state", "significant_height_m", "peak_period_s"),
    "wind_sea": ("sea_state", "significant_height_m", "peak_period_s"),
}
"""Keys that take the place of those of a base when a scenario that is built on it says them."""


class System(NamedTuple):
    """One system of waves, and where it runs."""

    state: SeaState
    towards_rad: float
    spreading: float


class WaveSystem(Struct, frozen=True, forbid_unknown_fields=True):
    """One of the two parts of an Ochi-Hubble sea."""

    height_m: Annotated[float, number("significant height of this part alone", "m", 0.0, 10.0)]
    period_s: Annotated[float, number("period of its peak", "s", 1.0, 25.0)]
    shape: Annotated[float, number("Ochi and Hubble's lambda: 1.5 a wind sea, 3 and more a swell", "1", 0.8, 30.0)] = 3.0
    runs_to_deg: Direction | None = None
    spreading: Spread | None = None


class Sea(Struct, frozen=True, forbid_unknown_fields=True):
    """The waves, which also move the vessel."""

    sea_state: Annotated[int, number("WMO code 3700; gives significant height and peak period", "1", 0, 6)] | None = None
    spectrum: Annotated[
        Literal["jonswap", "pierson_moskowitz", "ochi_hubble"],
        choice(
            "JONSWAP; a fully grown sea, where the height alone sets the period; or a swell and a wind sea, "
            "the most probable ones for the height unless swell and wind_sea say which"
        ),
    ] = "jonswap"
    components: Annotated[
        Components, choice("the harmonics' frequencies: random places in geometric bins, or in bins of equal energy")
    ] = "geometric"
    significant_height_m: (
        Annotated[float, number("significant wave height, 4 sqrt(m0); 0 is flat water; 0.3 unless said", "m", 0.0, 10.0)] | None
    ) = None
    peak_period_s: Annotated[float, number("period of the spectrum's peak; 3.5 unless said", "s", 1.0, 20.0)] | None = None
    peak_enhancement: (
        Annotated[float, number("JONSWAP's gamma, 3.3 unless said; 1 is a fully grown sea", "1", 1.0, 10.0, "mean JONSWAP")]
        | None
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
        if self.sea_state is not None:
            for name in ("significant_height_m", "peak_period_s", *parts):
                if getattr(self, name) is not None:
                    raise ValueError(f"sea_state sets the height and the period: give either it or {name}")
        if self.spectrum != "jonswap" and self.peak_enhancement is not None:
            raise ValueError(f"peak_enhancement is JONSWAP's; the spectrum is {self.spectrum}")
        if self.spectrum != "jonswap" and self.peak_period_s is not None:
            raise ValueError(f"peak_period_s does not go with {self.spectrum}: its periods follow from the height")
        if parts and self.spectrum != "ochi_hubble":
            raise ValueError(f"{parts[0]} belongs to the spectrum ochi_hubble; the spectrum is {self.spectrum}")
        if parts and self.significant_height_m is not None:
            raise ValueError(f"significant_height_m follows from swell and wind_sea: give either it or {parts[0]}")
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
        if self.spectrum == "pierson_moskowitz":
            return (System(SeaState.fully_grown(height), towards, wide),)
        if self.spectrum == "jonswap":
            gamma = 3.3 if self.peak_enhancement is None else self.peak_enhancement
            return (System(SeaState(height, self._period_s(), gamma), towards, wide),)
        if self.swell is None and self.wind_sea is None:
            swell, wind = SeaState.swell_and_wind_sea(height)
            return (System(swell, towards, 75.0 if self.spreading is None else wide), System(wind, towards, wide))
        said = ((self.swell, 75.0), (self.wind_sea, 10.0))
        return tuple(
            System(
                SeaState(part.height_m, part.period_s, 1.0, part.shape),
                towards if part.runs_to_deg is None else math.radians(part.runs_to_deg),
                part.spreading or self.spreading or usual,
            )
            for part, usual in said
            if part is not None
        )

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
