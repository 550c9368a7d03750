"""The sensors of the ship that a scenario gives her: motion sensor, rate-of-turn gyro and anemometer, as the service gets them.

They measure the world's true motion with the errors of real instruments, and know nothing of any estimator. A sample is stamped
on arrival, as a driver stamps a sentence that carries no time.
"""

import math

import numpy as np

from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import VesselMotion, VesselReport, VesselWind
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between
from sitl.scenario.scenario import ship_model, wind_of
from sitl.world.world import World

STEP_S = 0.02
"""Time between the samples that a motion sensor takes inside."""
_DAMPING = 0.7
"""Damping of its high-pass (assumed)."""
_TILT_STEP_RAD, _HEAVE_STEP_M = math.radians(0.01), 0.01
"""Last digit of what it reports, as in PSXN,23."""
_TILT_SIGMA_RAD, _MOUNT_SIGMA_RAD, _HEAVE_SIGMA_M = math.radians(0.03), math.radians(0.3), 0.02
"""Noise, and how well it is mounted along the ship's axes (assumed)."""
_ACCELERATION_SIGMA_M_S2, _ACCELERATION_STEP_M_S2 = 0.02, 0.0383
"""Noise of its horizontal acceleration (assumed), and that one's last digit in TSS1."""
_WANDER_S = (20.0, 60.0)
"""Shortest and longest period of the wander of its heave (assumed)."""
_TURN_SIGMA_RAD_S, _COMPASS_BIAS_RAD, _COMPASS_SIGMA_RAD = math.radians(0.2), math.radians(0.7), math.radians(0.2)
"""Noise of the rate of turn, and constant error and noise of the compass (assumed)."""
_MAST_M, _MAST_TIME_S = (0.0, 0.0, -12.0), 5.0
"""The anemometer's place from the pad, and the correlation time of the turbulence there."""
_DISTORTED, _DEFLECTED_RAD, _TURBULENCE = 0.1, math.radians(6.0), 0.1
"""Errors of speed, as a share, and of direction by the ship's own flow, and the intensity of the turbulence (assumed; Yelland
et al. 1998 found ten per cent on research vessels)."""
_ARRIVAL_SIGMA_S = 0.2
"""The sigma that a driver claims of a sentence without a time."""


class ShipAt:
    """The true motion of the ship's places at the newest step."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._R_pad_vessel = Rotation.from_rpy(0.0, 0.0, -math.radians(world.scenario.vessel.pad_yaw_deg))

    def place(self, at_m: tuple[float, float, float]) -> tuple[F64, F64]:
        """Return place and velocity in ned of a point that is (3,) m forward, to starboard and down from the pad's centre."""
        truth = self._world.truth()
        arm = (truth.R_ned_pad @ self._R_pad_vessel).matrix @ np.array(at_m)
        return truth.p_pad_ned + arm, truth.v_pad_ned + np.cross(truth.R_ned_pad.matrix @ truth.w_pad, arm)

    @property
    def rpy_rad(self) -> tuple[float, float, float]:
        """Roll, pitch and heading of the ship."""
        return (self._world.truth().R_ned_pad @ self._R_pad_vessel).rpy_rad

    @property
    def turn_rad_s(self) -> float:
        """Rate of turn, clockwise seen from above."""
        truth = self._world.truth()
        return float((truth.R_ned_pad.matrix @ truth.w_pad)[2])


class MotionSensor:
    """A motion reference unit: its heave is a second-order high-pass of its own displacement, which leads at long periods."""

    def __init__(self, world: World) -> None:
        self._world, self._ship, self._of = world, ShipAt(world), world.scenario.vessel
        self._rng = rng = np.random.default_rng([world.seed, 0x6E57])
        self._rng_a = np.random.default_rng([world.seed, 0x6E5A])
        self._mounted_rad = _MOUNT_SIGMA_RAD * rng.standard_normal(2)
        self._wander_rad_s = math.tau / rng.uniform(*_WANDER_S, 2)
        self._wander_from_rad = rng.uniform(0.0, math.tau, 2)
        self._slow_m = self._of.motion_at_m[2] - ship_model(world.scenario).hull.freeboard_m
        self._slow_m_s = 0.0
        self._at = world.at
        self._v_ne, self._a_ne = self._ship.place(self._of.motion_at_m)[1][:2], np.zeros(2)

    def follow(self, now: MonoNs) -> None:
        """Take the sensor's own samples up to now."""
        while seconds_between(self._at, now) >= STEP_S:
            self._at = after(self._at, STEP_S)
            off_m, corner = self._down_m() - self._slow_m, math.tau / self._of.motion_high_pass_s
            self._slow_m += STEP_S * (self._slow_m_s + 2.0 * _DAMPING * corner * off_m)
            self._slow_m_s += STEP_S * corner**2 * off_m
            before, self._v_ne = self._v_ne, self._ship.place(self._of.motion_at_m)[1][:2]
            self._a_ne = (self._v_ne - before) / STEP_S

    def measured(self, now: MonoNs) -> tuple[VesselMotion]:
        """Return what it reports of this instant."""
        noise, corrupted = self._rng.standard_normal(3), self._world.corruptions.of
        wander = np.sin(self._wander_from_rad + self._wander_rad_s * seconds_between(self._world.started, now))
        tilt = np.array(self._ship.rpy_rad[:2]) + self._mounted_rad + _TILT_SIGMA_RAD * noise[:2]
        down_m = self._down_m() - self._slow_m + self._of.motion_wander_m * float(wander.sum()) + _HEAVE_SIGMA_M * float(noise[2])
        roll, pitch = corrupted("ship_tilt", (float(tilt[0]), float(tilt[1])), now)
        (down_m,) = corrupted("ship_heave", (down_m,), now)
        tilt_sigma, heave_sigma = _TILT_STEP_RAD / math.sqrt(12.0), _HEAVE_STEP_M / math.sqrt(12.0)
        roll, pitch = (_TILT_STEP_RAD * round(angle / _TILT_STEP_RAD) for angle in (roll, pitch))
        down_m = _HEAVE_STEP_M * round(down_m / _HEAVE_STEP_M)
        a_m_s2 = math.hypot(*(self._a_ne + _ACCELERATION_SIGMA_M_S2 * self._rng_a.standard_normal(2)))
        a_m_s2 = _ACCELERATION_STEP_M_S2 * round(a_m_s2 / _ACCELERATION_STEP_M_S2)
        return (VesselMotion(_of(now), "simulated", roll, pitch, tilt_sigma, down_m, heave_sigma, a_m_s2),)

    def _down_m(self) -> float:
        return float(self._ship.place(self._of.motion_at_m)[0][2])


class TurnSensor:
    """A gyrocompass with its rate of turn."""

    def __init__(self, world: World) -> None:
        self._world, self._ship = world, ShipAt(world)
        self._rng = np.random.default_rng([world.seed, 0x6E58])
        self._bias_rad = _COMPASS_BIAS_RAD * self._rng.standard_normal()

    def measured(self, now: MonoNs) -> tuple[VesselReport]:
        """Return what it reports of this instant."""
        noise = self._rng.standard_normal(2)
        corrupted = self._world.corruptions.of
        (turn,) = corrupted("ship_turn", (self._ship.turn_rad_s + _TURN_SIGMA_RAD_S * float(noise[0]),), now)
        heading = self._ship.rpy_rad[2] + self._bias_rad + _COMPASS_SIGMA_RAD * float(noise[1])
        (heading,) = corrupted("ship_heading", (float(heading),), now)
        return (VesselReport(_of(now), None, None, wrap_pi(heading), _COMPASS_BIAS_RAD, turn, _TURN_SIGMA_RAD_S),)


class Anemometer:
    """An anemometer on the mast: the ship's flow distorts it, the mast's swing is in it, and single gusts pass it by."""

    def __init__(self, world: World) -> None:
        self._world, self._ship = world, ShipAt(world)
        self._rng = rng = np.random.default_rng([world.seed, 0x6E59])
        self._phases_rad = rng.uniform(0.0, math.tau, 2)
        wind = wind_of(world.scenario)
        over_m = ship_model(world.scenario).hull.freeboard_m - _MAST_M[2]
        steeper = math.log(over_m / wind.roughness_m) / math.log(10.0 / wind.roughness_m)
        self._speed_m_s = wind.speed_m_s * (steeper if wind.profile == "logarithmic" else 1.0)
        self._from_rad = math.radians(wind.from_deg)
        self._gust = _TURBULENCE * self._speed_m_s * rng.standard_normal(2)
        self._at = world.at

    def measured(self, now: MonoNs) -> tuple[VesselWind]:
        """Return the wind over the ground that it reports of this instant."""
        keep = math.exp(-seconds_between(self._at, now) / _MAST_TIME_S)
        fresh = _TURBULENCE * self._speed_m_s * math.sqrt(1.0 - keep**2)
        self._gust, self._at = keep * self._gust + fresh * self._rng.standard_normal(2), now
        swing = (self._ship.place(_MAST_M)[1] - self._ship.place((0.0, 0.0, 0.0))[1])[:2]
        blows = -self._speed_m_s * np.array([math.cos(self._from_rad), math.sin(self._from_rad)])
        north, east = (blows + self._gust - swing).tolist()
        speed, comes_from = math.hypot(north, east), math.atan2(-east, -north)
        beside = comes_from - self._ship.rpy_rad[2] + self._phases_rad
        speed *= 1.0 + _DISTORTED * math.cos(beside[0])
        comes_from += _DEFLECTED_RAD * math.sin(beside[1])
        (speed,) = self._world.corruptions.of("ship_wind", (speed,), now)
        return (VesselWind(_of(now), "simulated", wrap_pi(comes_from), abs(speed)),)


def _of(now: MonoNs) -> Stamp:
    return Stamp(now, now, _ARRIVAL_SIGMA_S, "arrival")
