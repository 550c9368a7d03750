"""The sensors in plain floats."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs
from sitl.sea.spectra import GRAVITY_M_S2
from sitl.sensors.sensors import BOARD_TEMPERATURE_C, Readings
from sitl.sensors.settings import SensorSettings
from sitl.vehicle.rotors import rotors
from sitl.vessel.contact import DeckShape, Ground
from tests.sitl.oracle.algebra import Vec, inverse_rotate, rotate, rotation_of, rpy_of
from tests.sitl.oracle.vehicle import PlainVehicle

EARTH_FIELD_NED_T = (1.36e-5, 0.9e-6, 5.0e-5)
SEA_LEVEL_PA = 101325.0
HOVER_PWM = 170.0
_BLOCK = 256
_RAYS = (-0.5, 0.0, 0.5)


class PlainSensors:
    """Sensors of one vehicle.

    Args:
        seed: parent of one child seed for each sensor.
    """

    def __init__(self, settings: SensorSettings, shape: DeckShape, seed: np.random.SeedSequence, step_s: float) -> None:
        self._s, self._shape, self._step_s = settings, shape, step_s
        s = settings
        imu, heading, ultrasound, pressure, magnetometer = (np.random.Generator(np.random.PCG64(c)) for c in seed.spawn(5))
        self._accel_bias = (s.accel_bias_sigma_m_s2 * imu.standard_normal(3)).tolist()
        self._gyro_bias = (s.gyro_bias_sigma_rad_s * imu.standard_normal(3)).tolist()
        self._heading_bias = math.radians(s.heading_bias_sigma_deg) * float(heading.standard_normal())
        self._magnetic_bias = (s.magnetometer_bias_sigma_t * magnetometer.standard_normal(3)).tolist()
        self._imu, self._magnetometer = _White(imu, 6), _White(magnetometer, 3)
        self._heading = _Wandering(heading, math.radians(s.heading_drift_sigma_deg), s.heading_drift_time_s, step_s)
        self._pressure = _White(pressure, 1)
        self._pressure_drift = _Wandering(pressure, s.pressure_drift_sigma_pa, 60.0, step_s)
        self._echo_noise = _White(ultrasound, 1)
        self._echo_every = max(1, round(1.0 / (s.ultrasound_rate_hz * step_s)))
        self._echoes: deque[tuple[int, float | None]] = deque()
        self._echo: float | None = None
        self._tick = 0
        self._battery = s.battery_start

    def step(self, vehicle: PlainVehicle, ground: Ground, motors_on: bool) -> None:
        """Advance by one step of the physics. Call it after the vehicle's step."""
        s = self._s
        self._tick += 1
        self._imu.step()
        self._magnetometer.step()
        self._pressure.step()
        self._heading.step()
        self._pressure_drift.step()
        if motors_on:
            self._battery = max(0.0, self._battery - self._step_s / s.battery_life_s)
        if self._tick % self._echo_every == 0:
            self._echo_noise.step()
            received_at = nearest_surface(self._shape, vehicle, ground, math.radians(s.ultrasound_cone_deg))
            if received_at is not None:
                received_at += s.ultrasound_sigma_m * self._echo_noise.values[0]
                received_at = received_at if s.ultrasound_min_m <= received_at <= s.ultrasound_max_m else None
            self._echoes.append((self._tick + round(s.ultrasound_delay_s / self._step_s), received_at))
        while self._echoes and self._echoes[0][0] <= self._tick:
            self._echo = self._echoes.popleft()[1]

    def read(self, at: MonoNs, vehicle: PlainVehicle, motors_on: bool) -> Readings:
        """Return the readings of the newest step. Reading changes nothing."""
        s = self._s
        rows = rotation_of(vehicle.q)
        roll, pitch, yaw = rpy_of(rows)
        off = vehicle.tilt_error_rad
        noise = self._imu.values
        accel = s.accel_noise_sigma_m_s2 if motors_on else s.accel_rest_sigma_m_s2
        gyro = s.gyro_noise_sigma_rad_s if motors_on else s.gyro_rest_sigma_rad_s
        x, y, z = vehicle.a
        force = inverse_rotate(rows, (x, y, z - GRAVITY_M_S2))
        field = inverse_rotate(rows, EARTH_FIELD_NED_T)
        height = -float(vehicle.p[2])
        pressure = SEA_LEVEL_PA * (1.0 - 2.25577e-5 * height) ** 5.25588
        return Readings(
            at=at,
            f_body=_measured(force, self._accel_bias, accel, noise[:3]),
            w_body=_measured(vehicle.w, self._gyro_bias, gyro, noise[3:]),
            rpy_rad=np.array([roll + off[0], pitch + off[1], wrap_pi(float(yaw) + self._heading_bias + self._heading.value)]),
            v_level_m_s=np.array(vehicle.flow),
            ultrasound_m=self._echo,
            pressure_pa=pressure + self._pressure_drift.value + s.pressure_sigma_pa * self._pressure.values[0],
            temperature_c=BOARD_TEMPERATURE_C,
            magnetometer=_measured(field, self._magnetic_bias, s.magnetometer_sigma_t, self._magnetometer.values),
            battery_fraction=self._battery,
            motors_pwm=_pwm(vehicle),
        )


def _measured(true: Vec, bias: list[float], sigma: float, standard: list[float]) -> F64:
    """Return (3,) with bias and noise. Python floats: for three numbers numpy's calls take several times as long."""
    return np.array([t + b + sigma * n for t, b, n in zip(true, bias, standard, strict=True)])


def nearest_surface(shape: DeckShape, vehicle: PlainVehicle, ground: Ground, cone_rad: float) -> float | None:
    """Return the distance, m, from the body's origin to the nearest surface within a cone about the body's down axis.

    A ray meets the deck or else the water; the result is None if no ray meets anything. There are nine rays as in the thesis'
    simulator, and the plumb lines.
    """
    rows = rotation_of(vehicle.q)
    p, g = vehicle.p, ground.p
    d = inverse_rotate(ground.R, (p[0] - g[0], p[1] - g[1], p[2] - g[2]))
    above_water = ground.sea_z - p[2]
    rays: list[Vec] = [(math.tan(a * cone_rad), math.tan(b * cone_rad), 1.0) for a in _RAYS for b in _RAYS]
    down = rotate(rows, (0.0, 0.0, 1.0))
    rays_ned = [_unit(rotate(rows, ray)) for ray in rays]
    least = math.cos(0.5 * cone_rad)
    for plumb in ((0.0, 0.0, 1.0), rotate(ground.R, (0.0, 0.0, 1.0))):
        if plumb[0] * down[0] + plumb[1] * down[1] + plumb[2] * down[2] >= least:
            rays_ned.append(plumb)
    best = math.inf
    for ray in rays_ned:
        u = inverse_rotate(ground.R, ray)
        distance = math.inf
        if u[2] > 1e-6 and d[2] < 0.0:
            t = -d[2] / u[2]
            if shape.holds(d[0] + t * u[0], d[1] + t * u[1]):
                distance = float(t)
        if math.isinf(distance) and ray[2] > 1e-6 and above_water > 0.0:
            distance = float(above_water / ray[2])
        best = min(best, distance)
    return None if math.isinf(best) else best


def _unit(v: Vec) -> Vec:
    n = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return (v[0] / n, v[1] / n, v[2] / n)


_MOTORS = ("front_left", "front_right", "rear_right", "rear_left")
"""The four motors that an AR.Drone's telemetry has; those at the sides of a hexacopter are not told."""


def _pwm(vehicle: PlainVehicle) -> tuple[int, int, int, int]:
    """Return the motors' PWM. Rotor thrust is proportional to the square of the speed, and the speed to the pulse width."""
    thrust_n = vehicle.rotors_n
    hover = vehicle.airframe.mass_kg * 9.80665 / len(thrust_n)
    a, b, c, d = [min(255, round(HOVER_PWM * math.sqrt(max(0.0, thrust_n[i]) / hover))) for i in _motors(vehicle)]
    return (a, b, c, d)


def _motors(vehicle: PlainVehicle) -> tuple[int, ...]:
    """Return the place of each of `_MOTORS` among the rotors of a layout."""
    names = [rotor.name for rotor in rotors(vehicle.airframe)]
    return tuple(names.index(name) for name in _MOTORS)


class _White:
    """Standard normal numbers that are new at each step; they are drawn in blocks."""

    def __init__(self, rng: np.random.Generator, width: int) -> None:
        self._rng, self._width = rng, width
        self._block: list[list[float]] = []
        self._i = _BLOCK
        self.values: list[float] = [0.0] * width
        self.step()

    def step(self) -> None:
        if self._i == _BLOCK:
            self._block, self._i = self._rng.standard_normal((_BLOCK, self._width)).tolist(), 0
        self.values = self._block[self._i]
        self._i += 1


class _Wandering:
    """A first-order Gauss-Markov process in its steady state, exact for any step length."""

    def __init__(self, rng: np.random.Generator, sigma: float, time_s: float, step_s: float) -> None:
        self._keep = math.exp(-step_s / time_s)
        self._fresh = sigma * math.sqrt(1.0 - self._keep**2)
        self.value = sigma * float(rng.standard_normal())
        self._white = _White(rng, 1)

    def step(self) -> None:
        self._white.step()
        self.value = self._keep * self.value + self._fresh * self._white.values[0]
