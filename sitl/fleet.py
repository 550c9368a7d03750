"""Many flights of one scenario at once, without frames or sensors: vehicles on their own seas, in arrays.

fleet = Fleet(load("sea_state_4"), seeds=range(1000))
fleet.vehicle.command(roll, pitch, gaz, yaw, progressive)
fleet.step()
fleet.d_body_pad_level, fleet.v_pad_level, fleet.yaw_rad
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from estimator.contracts.geometry import F64
from sitl.contact import Ground
from sitl.scenario import Scenario
from sitl.stage import air, airframe, deck_shape, flight_seeds, limits, place, sea_and_vessel, wind
from sitl.vehicle import DECK, Vehicle
from sitl.vessel import Mounted
from sitl.world import STEP_NS

_EVERY = 5


class Fleet:
    """B flights. A seed's flight has the wind, the vessel's motion and the drone's own errors that `sitl.world.World` gives it.

    The deck is computed exactly every 20 ms and carried on by its velocity and acceleration in between, which is good to
    some 10 um and 1 mm/s; the water is level; a scenario's faults do not happen. `vehicle` takes commands as (B,) arrays or
    numbers for all.
    """

    def __init__(self, scenario: Scenario, seeds: Iterable[int]) -> None:
        each = [flight_seeds(seed) for seed in seeds]
        self.scenario = scenario
        self.step_s = STEP_NS * 1e-9
        self._tick = 0
        _, self.vessel = sea_and_vessel(scenario, [s.sea for s in each])
        pad_yaw = math.radians(scenario.vessel.pad_yaw_deg)
        shape = deck_shape(self.vessel.hull, pad_yaw)
        self.vehicle = Vehicle(airframe(scenario), shape, self.step_s, [s.flight for s in each], wind(scenario))
        self.vehicle.limits = limits(scenario)
        self.vehicle.air = air(scenario, self.vessel.hull, [s.flight for s in each], self.step_s)
        self.vehicle.current = scenario.sea.current_ne_m_s
        self._known = self._pad = self.vessel.pad(0.0)
        place(scenario, self.vehicle, _ground(self._pad), self._pad.p_ned, self._pad.R_ned)

    @property
    def seconds(self) -> float:
        """Time since the start."""
        return self._tick * self.step_s

    @property
    def d_body_pad_level(self) -> F64:
        """The pad's position relative to the body: (B, 3) m forward, right, down."""
        return self._level(self._pad.p_ned - self.vehicle.p_ned)

    @property
    def v_pad_level(self) -> F64:
        """The pad's velocity minus that of the body, (B, 3) m/s."""
        return self._level(self._pad.v_ned - self.vehicle.v_ned)

    @property
    def yaw_rad(self) -> F64:
        """The body's heading relative to the arrow, (B,) rad clockwise from above, [-pi, pi)."""
        return np.asarray((_heading(self.vehicle.R_ned_body) - _heading(self._pad.R_ned) + math.pi) % math.tau - math.pi)

    @property
    def on_deck(self) -> F64:
        """Distance of the newest contact from the pad's centre, (B,) m; nan if it was not with the deck or there was none."""
        v = self.vehicle
        return np.where(np.asarray(v.touched_what) == DECK, np.hypot(v.touched_d[0], v.touched_d[1]), np.nan)

    def step(self) -> None:
        """Advance all flights by `step_s`."""
        self._tick += 1
        n = self._tick % _EVERY
        if n == 0:
            self._known = self._pad = self.vessel.pad(self.seconds)
        else:
            self._pad = _carried_on(self._known, n * self.step_s)
        self.vehicle.step(_ground(self._pad))

    def _level(self, v_ned: F64) -> F64:
        yaw = _heading(self.vehicle.R_ned_body)
        c, s = np.cos(yaw), np.sin(yaw)
        x, y, z = v_ned.T
        return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)


def _heading(R_ned: F64) -> F64:
    return np.asarray(np.arctan2(R_ned[..., 1, 0], R_ned[..., 0, 0]))


def _ground(pad: Mounted) -> Ground:
    return Ground.of(pad.p_ned, pad.v_ned, pad.R_ned, pad.w)


def _carried_on(pad: Mounted, dt_s: float) -> Mounted:
    """Return the pad a little later, to second order in time: acceleration and angular velocity are taken as constant."""
    w, R = pad.w * dt_s, pad.R_ned
    turned = np.cross(R, w[..., None, :])
    twice = np.cross(turned, w[..., None, :])
    return Mounted(
        pad.p_ned + dt_s * pad.v_ned + 0.5 * dt_s**2 * pad.a_ned,
        pad.v_ned + dt_s * pad.a_ned,
        pad.a_ned,
        R + turned + 0.5 * twice,
        pad.w,
    )
