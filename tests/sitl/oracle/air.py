"""The air over a ship, as `sitl.vessel.air` describes it."""

from __future__ import annotations

import math

import numpy as np

from sitl.vessel.air import AirModel, GustOnce
from sitl.vessel.contact import Ground
from sitl.vessel.seakeeping import Superstructure
from tests.sitl.oracle.algebra import Vec, clip, inverse_rotate
from tests.sitl.oracle.contact import Relative
from tests.sitl.oracle.disturbances import Noise

_FT = 0.3048
_LOWEST_M = 0.5
_DEFICIT_MAX = 0.9
_WAKE_TURBULENCE = 0.32
_DECK_TIME_S = 5.0


def gust_share(gust: GustOnce, t_s: float) -> float:
    """Return the share of its speed that it has at an instant."""
    x = t_s - gust.at_s
    if x <= 0.0 or x >= 2.0 * gust.rise_s + gust.hold_s:
        return 0.0
    x = min(x, max(2.0 * gust.rise_s + gust.hold_s - x, 0.0), gust.rise_s)
    return 0.5 * (1.0 - math.cos(math.pi * x / gust.rise_s))


class Air:
    """The air that one vehicle meets; random parts begin in their steady state.

    Args:
        seed: of turbulence and eddies.
    """

    def __init__(self, model: AirModel, step_s: float, seed: np.random.SeedSequence) -> None:
        self.model, self._dt = model, step_s
        self._noise = Noise(seed)
        start, second = self._noise.next(), self._noise.next()
        self._u: float = start[0]
        # The lag of the lag of white noise has half the variance of the lag, and a covariance of a half with it.
        self._v: tuple[float, float] = (start[1], 0.5 * (start[1] + second[1]))
        self._w: tuple[float, float] = (start[2], 0.5 * (start[2] + second[2]))
        self._eddy: Vec = (start[3], start[4], start[5])
        self._ship: tuple[float, float] | None = None
        c, s = math.cos(model.towards_rad), math.sin(model.towards_rad)
        self._along = (c, s)
        self._log10m = math.log(10.0 / model.roughness_m)

    def mean_m_s(self, height_m: float) -> float:
        """Return the mean wind at a height over the water.

        Source: logarithmic profile of neutral air, U = U10 ln(h / z0) / ln(10 / z0), as in DNV-RP-C205 (2010), 2.3.2.4.
        """
        model = self.model
        if not model.logarithmic:
            return model.speed_m_s + 0.0 * height_m
        h = clip(height_m, _LOWEST_M, 1e4)
        return model.speed_m_s * math.log(h / model.roughness_m) / self._log10m

    def step(self, ground: Ground, r: Relative, v: Vec, height_m: float, t_s: float) -> Vec:
        """Advance by one step and return the velocity of the air at the vehicle, m/s in ned.

        Args:
            r: the vehicle relative to the deck.
            v: the vehicle's velocity, m/s in ned.
            height_m: of the vehicle over the water.
        """
        n = self._noise.next()
        mean, (c, s) = self.mean_m_s(height_m), self._along
        north, east, down = mean * c, mean * s, 0.0 * mean
        if self.model.wake is not None:
            north, east, down = self._behind(self.model.wake, ground, r, (north, east, down), n)
        if self.model.dryden:
            along, across, up = self._dryden(v, mean, height_m, n)
            north, east, down = north + c * along - s * across, east + s * along + c * across, down + up
        for gust in self.model.gusts:
            share = gust_share(gust, t_s)
            north, east = north + share * gust.v_ned[0], east + share * gust.v_ned[1]
        return north, east, down

    def _dryden(self, v: Vec, mean: float, height_m: float, noise: list[float]) -> Vec:
        """Return the turbulence along and across the wind and downwards.

        Source: MIL-F-8785C, 3.7.1.2 and 3.7.3.4 (low altitude): sigma_w = 0.1 W20, sigma_u = sigma_w / (0.177 + 0.000823 h)^0.4,
        L_w = h, L_u = h / (0.177 + 0.000823 h)^1.2 in feet, from 10 to 1000 ft. Spectra: along, first order; across and vertical,
        (1 + sqrt(3) T s) / (1 + T s)^2, T being length over airspeed.
        """
        dt = self._dt
        c, s = self._along
        h = clip(height_m / _FT, 10.0, 1000.0)
        term = 0.177 + 0.000823 * h
        sigma_w = 0.1 * self.mean_m_s(20.0 * _FT)
        sigma_u = sigma_w / term**0.4
        length_u, length_w = _FT * h / term**1.2, _FT * h
        x, y = mean * c - v[0], mean * s - v[1]
        speed = clip(math.sqrt(x * x + y * y), 1.0, 1e3)
        keep = math.exp(-dt * speed / length_u)
        fresh = math.sqrt(1.0 - keep * keep)
        self._u = keep * self._u + fresh * noise[0]
        self._v = _second(self._v, keep, fresh, noise[1])
        keep = math.exp(-dt * speed / length_w)
        self._w = _second(self._w, keep, math.sqrt(1.0 - keep * keep), noise[2])
        return sigma_u * self._u, sigma_u * _shaped(self._v), sigma_w * _shaped(self._w)

    def _behind(self, block: Superstructure, ground: Ground, r: Relative, wind: Vec, noise: list[float]) -> Vec:
        """Return the wind with what the superstructure takes from it and the eddies that it sheds.

        Source: deficit behind a solid fence after Perera, Shelter behind two-dimensional solid and porous fences, J. Wind Eng.
        Ind. Aerodyn. 8 (1981), in the form of the European Wind Atlas (Troen & Petersen 1989), spread sideways as by Taylor &
        Salmon, J. Appl. Meteorology 32 (1993), for obstacles of finite width. Added turbulence: 0.32 of the deficit, that of a
        plane self-preserving wake (Pope, Turbulent Flows, 2000, 5.4), in eddies of half the height. The spread sideways of a
        tenth of the distance and the limit of the near wake are assumed.
        """
        dt = self._dt
        if self._ship is None:
            self._ship = (ground.v[0], ground.v[1])
        slow = dt / _DECK_TIME_S
        ship = (self._ship[0] + slow * (ground.v[0] - self._ship[0]), self._ship[1] + slow * (ground.v[1] - self._ship[1]))
        self._ship = ship
        rel = (wind[0] - ship[0], wind[1] - ship[1], 0.0 * wind[0])
        on_deck = inverse_rotate(ground.R, rel)
        cy, sy = math.cos(self.model.pad_yaw_rad), math.sin(self.model.pad_yaw_rad)
        ahead, aside = cy * on_deck[0] - sy * on_deck[1], sy * on_deck[0] + cy * on_deck[1]
        speed = clip(math.sqrt(ahead * ahead + aside * aside), 1e-3, 1e3)
        ex, ey = ahead / speed, aside / speed
        x = cy * r.d[0] - sy * r.d[1] + (self.model.pad_m[0] - block.forward_m)
        y = sy * r.d[0] + cy * r.d[1] + (self.model.pad_m[1] - block.starboard_m)
        along, across = x * ex + y * ey, y * ex - x * ey
        size_x, size_y = math.sqrt(ex * ex), math.sqrt(ey * ey)
        half_width = 0.5 * (block.width_m * size_x + block.length_m * size_y)
        behind = along - 0.5 * (block.length_m * size_x + block.width_m * size_y)
        h = block.height_m
        far = clip(behind / h, 0.5, 1e4)
        z = clip(-r.d[2] / h, 0.02, 50.0)
        k = 0.32 / math.log(h / self.model.roughness_m)
        eta = z * (k * far) ** -0.47
        deficit = clip(9.75 / far * eta * math.exp(-0.67 * eta**1.5), 0.0, _DEFICIT_MAX)
        width = 0.551 * (0.1 * h * far) + 0.02 * h
        inside = _rises((half_width - across) / width) * _rises((half_width + across) / width)
        deficit = deficit * inside * clip(behind / (0.5 * h), 0.0, 1.0)
        keep = math.exp(-dt * speed / (0.5 * h))
        fresh = math.sqrt(1.0 - keep * keep)
        e = self._eddy
        self._eddy = (keep * e[0] + fresh * noise[3], keep * e[1] + fresh * noise[4], keep * e[2] + fresh * noise[5])
        sigma = _WAKE_TURBULENCE * deficit * speed
        return (
            wind[0] - deficit * rel[0] + sigma * self._eddy[0],
            wind[1] - deficit * rel[1] + sigma * self._eddy[1],
            wind[2] + sigma * self._eddy[2],
        )


def _second(state: tuple[float, float], keep: float, fresh: float, noise: float) -> tuple[float, float]:
    """Advance white noise through one lag (variance 1) and that through the same lag again (variance 1/2, covariance 1/2)."""
    a, b = state
    return keep * a + fresh * noise, keep * b + (1.0 - keep) * a


def _shaped(state: tuple[float, float]) -> float:
    """Return (1 + sqrt(3) T s) / (1 + T s)^2 of white noise, with variance 1: sqrt(3) a + (1 - sqrt(3)) b has variance 2."""
    return math.sqrt(0.5) * (math.sqrt(3.0) * state[0] + (1.0 - math.sqrt(3.0)) * state[1])


def _rises(x: float) -> float:
    return 1.0 / (1.0 + math.exp(-clip(x, -40.0, 40.0)))
