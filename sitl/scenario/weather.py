"""Weather that belongs together: the waves that a wind raises, its profile, its gusts, and the wake of the ship in it.

A scenario's table `[weather]` names the wind or the sea state, and takes the place of waves and wind.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from msgspec import Struct

from estimator.contracts.keys import choice, number
from estimator.contracts.motion import G_M_S2
from sitl.sea.sea import SEA_STATES, Sea, SeaState, WaveSystem
from sitl.vessel.air import WindSettings

_PM_HEIGHT = 2.0 * math.sqrt(0.0081 / 0.74)
"""Significant height of a fully grown sea by U^2 / g, U being the wind at 19.5 m (Pierson & Moskowitz 1964)."""
_FETCH_HEIGHT, _FETCH_PEAK = 4.0 * math.sqrt(1.6e-7), 3.5
"""JONSWAP's laws of growth (Hasselmann et al. 1973): height by U^2 / g is the first times the root of x = g F / U^2, and the
peak's frequency, Hz, by g / U is the second times x^(-1/3)."""
_CHARNOCK, _KARMAN = 0.0144, 0.4
"""Charnock's constant of the open sea (DNV-RP-C205 gives 0.011 to 0.014; 0.0144 after Garratt 1977)."""
_LEAST_ROUGHNESS_M = 1e-5
_SWELL_HEIGHT, _SWELL_PERIOD, _SWELL_ASIDE_DEG = 0.5, 1.6, 60.0
"""The swell of open water by the height and period of the wind's own sea. With it spectra are about as wide and as little peaked
as buoys measure them (docs/evidence.md); how far it crosses is assumed."""


class WeatherSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The wind, and the sea that it raises."""

    wind_m_s: Annotated[float, number("mean wind 10 m over the water", "m/s", 0.5, 20.0)] | None = None
    sea_state: (
        Annotated[int, number("WMO code 3700 of a sea that the wind raised, or of an older one beside wind_m_s", "1", 1, 6)]
        | None
    ) = None
    fetch_km: (
        Annotated[float, number("length of water over which the wind blows; a fully grown sea by default", "km", 0.1, 2e4)] | None
    ) = None
    from_deg: (
        Annotated[float, number("direction from which wind and waves come; the wind's by default", "deg", -360.0, 360.0)] | None
    ) = None
    gusts: Annotated[
        Literal["kaimal", "dryden"],
        choice("turbulence: Kaimal's over the sea's roughness, or MIL-F-8785C's, which is about twice as strong"),
    ] = "kaimal"
    wake: Annotated[bool, choice("whether hull and superstructure slow and stir the air")] = True

    @property
    def given(self) -> bool:
        """True if it sets anything."""
        return self.wind_m_s is not None or self.sea_state is not None

    def sea(self, beside: Sea, from_deg: float) -> Sea:
        """Return the waves that the wind raises, and on open water a swell that crosses them.

        Args:
            beside: a sea whose current stays.
            from_deg: direction of the wind where these settings say none.
        """
        state, to_deg = self._state(), (self._from_deg(from_deg) + 180.0) % 360.0
        height_m, period_s = _SWELL_HEIGHT * state.hs_m, _SWELL_PERIOD * state.tp_s
        return Sea(
            significant_height_m=state.hs_m,
            peak_period_s=state.tp_s,
            peak_enhancement=state.gamma,
            runs_to_deg=to_deg,
            swell=WaveSystem(height_m, period_s, runs_to_deg=to_deg + _SWELL_ASIDE_DEG) if self.fetch_km is None else None,
            current_m_s=beside.current_m_s,
            current_to_deg=beside.current_to_deg,
        )

    def wind(self, beside: WindSettings, *, superstructure: bool) -> WindSettings:
        """Return the wind over this sea.

        Args:
            beside: a wind whose direction and single gusts stay where these settings say none.
            superstructure: whether the ship has one.
        """
        return WindSettings(
            speed_m_s=self._speed_m_s(),
            from_deg=self._from_deg(beside.from_deg),
            model=self.gusts,
            profile="logarithmic",
            roughness_m=roughness_m(self._speed_m_s()),
            wake=self.wake and superstructure,
            hull_wake=self.wake,
            gusts=beside.gusts,
        )

    def _from_deg(self, otherwise: float) -> float:
        return otherwise if self.from_deg is None else self.from_deg

    def _state(self) -> SeaState:
        if self.wind_m_s is not None and self.sea_state is not None:
            return SeaState.fully_grown(SEA_STATES[self.sea_state].hs_m)
        return raised_sea(self._speed_m_s(), self.fetch_km)

    def _speed_m_s(self) -> float:
        if self.wind_m_s is not None:
            return self.wind_m_s
        return raising_wind_m_s(SEA_STATES[self.sea_state or 1].hs_m, self.fetch_km)


def roughness_m(wind_m_s: float) -> float:
    """Return the roughness of the sea's surface under a wind at 10 m, by Charnock's relation z0 = a u*^2 / g."""
    z = 2e-4
    for _ in range(20):
        z = max(_LEAST_ROUGHNESS_M, _CHARNOCK * (_KARMAN * wind_m_s / math.log(10.0 / z)) ** 2 / G_M_S2)
    return z


def raised_sea(wind_m_s: float, fetch_km: float | None = None) -> SeaState:
    """Return the sea that a steady wind at 10 m raises over a fetch; the fully grown one where no fetch limits it."""
    grown = SeaState.fully_grown(_PM_HEIGHT * (wind_m_s * _by_height(wind_m_s)) ** 2 / G_M_S2)
    if fetch_km is None:
        return grown
    x = 1e3 * fetch_km * G_M_S2 / wind_m_s**2
    height_m = _FETCH_HEIGHT * math.sqrt(x) * wind_m_s**2 / G_M_S2
    if height_m >= grown.hs_m:
        return grown
    return SeaState(height_m, wind_m_s / (G_M_S2 * _FETCH_PEAK * x ** (-1.0 / 3.0)), 3.3)


def raising_wind_m_s(height_m: float, fetch_km: float | None = None) -> float:
    """Return the steady wind at 10 m that raises a significant height over a fetch, by bisection."""
    low, high = 0.1, 60.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if raised_sea(middle, fetch_km).hs_m < height_m else (low, middle)
    return high


def _by_height(wind_m_s: float) -> float:
    """Return the wind at 19.5 m over that at 10 m, by the logarithmic profile."""
    z = roughness_m(wind_m_s)
    return math.log(19.5 / z) / math.log(10.0 / z)


_KEPT = {"sea": ("current_m_s", "current_to_deg"), "wind": ("from_deg", "gusts")}
"""Keys of waves and wind that a table `weather` leaves as they are."""


def _says(table: object) -> bool:
    return isinstance(table, dict) and bool(table.keys() & {"wind_m_s", "sea_state"})


def contradicted(data: Mapping[str, Any]) -> str:
    """Return why a file's table `weather` contradicts its waves or its wind; empty where it does not."""
    if not _says(data.get("weather")):
        return ""
    for table, kept in _KEPT.items():
        output = data.get(table)
        if isinstance(output, dict) and (more := sorted(output.keys() - set(kept))):
            return f"{table}.{more[0]} follows from the weather; beside it {table} may say {', '.join(kept)} alone"
    return ""


def merged_under(over: Mapping[str, Any], base: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a base without the waves and the wind that a table `weather` replaces."""
    if not _says(over.get("weather")):
        return base
    out = dict(base)
    for table, keys in _KEPT.items():
        before = base.get(table)
        if isinstance(before, dict):
            out[table] = {key: value for key, value in before.items() if key in keys}
    before, other = base.get("weather"), "sea_state" if "wind_m_s" in over["weather"] else "wind_m_s"
    if isinstance(before, dict):
        out["weather"] = {key: value for key, value in before.items() if key != other}
    return out
