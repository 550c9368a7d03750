"""The vehicle's sensors, with the errors measured on a real AR.Drone 2.0 (provenance: `sitl.scenario.scenario.SensorSettings`).

Every sensor has its own random generator and advances with the physics, whether it is read or not: the same seed gives the same
readings to the bit. Roll, pitch and velocity are the drone's own estimates, which its loops use too. The formulae are the core's,
`sitl/core/physics/sensors.c`.

Faults act on finished readings: the same readings, faults and seed give the same result, however often it is requested.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import Struct, structs

from estimator.contracts.geometry import F64, GeoPoint, moved
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import MonoNs, seconds_between
from sitl.core.abi import DL_ECHOES_MAX, DL_SENSOR_NOISE
from sitl.core.library import SIM
from sitl.faults.readings import FaultyReadings, SensorFault
from sitl.sensors.settings import SensorSettings
from sitl.vehicle.airframe import rotors
from sitl.vehicle.disturbances import BLOCK, NoiseRows, keep_and_fresh
from sitl.vehicle.vehicle import Vehicle

Rng = np.random.Generator
BOARD_TEMPERATURE_C = 43.5
"""Temperature of the board as in a captured navdata: the chip sits beside warm electronics."""

_READ_NUMBERS = SIM.ffi.sizeof("dl_sim_readings") // 8
_PRESSURE_TIME_S = 60.0
"""Correlation time of the pressure's drift."""
_MOTORS = ("front_left", "front_right", "rear_right", "rear_left")
"""The four motors that an AR.Drone's telemetry has; those at the sides of a hexacopter are left out."""


class Readings(Struct, frozen=True, eq=False):
    """The newest reading of each sensor, in SI units and body axes."""

    at: MonoNs
    """Instant at which the inertial values were measured."""
    f_body: tuple[float, float, float]
    """Specific force, m/s^2."""
    w_body: tuple[float, float, float]
    """Turn rates, rad/s."""
    rpy_rad: tuple[float, float, float]
    """Roll, pitch and heading by the drone's own estimate."""
    v_level_m_s: tuple[float, float]
    """Velocity forward and right that the drone reports; it reports no vertical speed."""
    ultrasound_m: float | None
    """Distance to the nearest surface in the cone; None if there is no echo."""
    pressure_pa: float
    temperature_c: float
    magnetometer: tuple[float, float, float] | None
    """Magnetic field, tesla; None while the magnetometer is silent."""
    battery_fraction: float
    motors_pwm: tuple[int, int, int, int]
    """0..255 of the front left, front right, rear right, rear left motor."""


class Sensors:
    """Sensors of one vehicle.

    Args:
        seed: parent of one child seed for each sensor.
        vehicle: whose readings these are; they are as fresh as its newest step.
        scales: readings of accelerometer and gyro over the truth.
    """

    def __init__(
        self, settings: SensorSettings, vehicle: Vehicle, seed: np.random.SeedSequence, scales: tuple[float, float] = (1.0, 1.0)
    ) -> None:
        self._vehicle = vehicle
        s, step_s = settings, vehicle.step_s
        imu, heading, ultrasound, pressure, field = (np.random.Generator(np.random.PCG64(c)) for c in seed.spawn(5))
        heading_sigma = math.radians(s.heading_drift_sigma_deg)
        of_heading = keep_and_fresh(heading_sigma, s.heading_drift_time_s, step_s)
        of_pressure = keep_and_fresh(s.pressure_drift_sigma_pa, _PRESSURE_TIME_S, step_s)
        echo_every = max(1, round(1.0 / (s.ultrasound_rate_hz * step_s)))
        echo_delay = round(s.ultrasound_delay_s / step_s)
        if echo_delay >= echo_every * (DL_ECHOES_MAX - 1):
            raise ValueError(
                f"more than {DL_ECHOES_MAX} echoes would be under way: every {echo_every} steps, {echo_delay} steps late"
            )
        each = rotors(vehicle.airframe)
        names = [rotor.name for rotor in each]
        self.params = SIM.new(
            "dl_sim_sensor_params",
            echo_every=echo_every, echo_delay=echo_delay, motor=[names.index(name) for name in _MOTORS], step_s=step_s,
            accel_scale=scales[0], gyro_scale=scales[1], vibration=vehicle.airframe.effects.vibration_m_s2,
            accel_sigma=(s.accel_rest_sigma_m_s2, s.accel_noise_sigma_m_s2),
            gyro_sigma=(s.gyro_rest_sigma_rad_s, s.gyro_noise_sigma_rad_s),
            accel_bias=s.accel_bias_sigma_m_s2 * imu.standard_normal(3),
            gyro_bias=s.gyro_bias_sigma_rad_s * imu.standard_normal(3),
            heading_bias=math.radians(s.heading_bias_sigma_deg) * heading.standard_normal(),
            field_bias=s.magnetometer_bias_sigma_t * field.standard_normal(3), field_sigma=s.magnetometer_sigma_t,
            heading_keep=of_heading[0], heading_fresh=of_heading[1],
            pressure_keep=of_pressure[0], pressure_fresh=of_pressure[1], pressure_sigma=s.pressure_sigma_pa,
            cone_rad=math.radians(s.ultrasound_cone_deg), echo_sigma=s.ultrasound_sigma_m,
            echo_min_m=s.ultrasound_min_m, echo_max_m=s.ultrasound_max_m, battery_life_s=s.battery_life_s,
            hover_n=vehicle.airframe.mass_kg * G_M_S2 / len(each),
        )  # fmt: skip
        """The core's `dl_sim_sensor_params`."""
        block = _NoiseBlocks(imu, field, pressure, heading, ultrasound, echo_every)
        drift = heading_sigma * heading.standard_normal()
        self.noise = NoiseRows(block.draw)
        """The numbers of all sensors."""
        row = self.noise.next()
        self.state = SIM.new(
            "dl_sim_sensors", heading_drift=drift, noise=row, battery=s.battery_start, echo_m=math.nan,
            pressure_drift=s.pressure_drift_sigma_pa * block.first,
        )  # fmt: skip
        """The core's `dl_sim_sensors`."""
        self._readings = SIM.new("dl_sim_readings")
        self._numbers = SIM.ffi.cast("double *", self._readings)

    def read(self, at: MonoNs) -> Readings:
        """Return the readings of the newest step. Reading changes nothing."""
        v = self._vehicle
        SIM.lib.dl_sim_sensors_read(v.params, v.state, self.params, self.state, self._readings)
        # All at once: one member after the other takes four times as long, at every step of a flight.
        (
            fx, fy, fz, p, q, r, roll, pitch, yaw, ahead, aside, mx, my, mz, echo_m, pressure_pa, battery,
            front_left, front_right, rear_right, rear_left,
        ) = SIM.ffi.unpack(self._numbers, _READ_NUMBERS)  # fmt: skip
        return Readings(
            at,
            (fx, fy, fz),
            (p, q, r),
            (roll, pitch, yaw),
            (ahead, aside),
            None if echo_m != echo_m else echo_m,
            pressure_pa,
            BOARD_TEMPERATURE_C,
            (mx, my, mz),
            battery,
            (int(front_left), int(front_right), int(rear_right), int(rear_left)),
        )


class _NoiseBlocks:
    """Blocks of the sensors' noise, each sensor's from its own generator.

    The white noise and the drift of one sensor share a generator and take blocks in turn.

    Attributes:
        first: the number with which the drift of the pressure begins.
    """

    def __init__(self, imu: Rng, field: Rng, pressure: Rng, heading: Rng, ultrasound: Rng, echo_every: int) -> None:
        self._imu, self._field, self._pressure, self._heading, self._ultrasound = imu, field, pressure, heading, ultrasound
        self._echo_every = echo_every
        self._drawn = 0
        self.first = 0.0

    def draw(self) -> F64:
        """Return the next (BLOCK, DL_SENSOR_NOISE) numbers; the ultrasound has one where it measures."""
        rows = np.zeros((BLOCK, DL_SENSOR_NOISE))
        rows[:, 0:6] = self._imu.standard_normal((BLOCK, 6))
        rows[:, 6:9] = self._field.standard_normal((BLOCK, 3))
        rows[:, 9] = self._pressure.standard_normal(BLOCK)
        rows[:, 10] = self._heading.standard_normal(BLOCK)
        if self._drawn == 0:
            self.first = self._pressure.standard_normal()
        rows[:, 11] = self._pressure.standard_normal(BLOCK)
        measured = np.arange(-self._drawn % self._echo_every, BLOCK, self._echo_every)
        rows[measured, 12] = self._ultrasound.standard_normal(len(measured))
        self._drawn += BLOCK
        return rows


class FaultySensors:
    """Turns the readings of the true sensors into those of faulty ones.

    Args:
        readings: what faults make of each reading.
    """

    def __init__(self, readings: FaultyReadings) -> None:
        self._readings = readings
        self._newest: tuple[Readings, Readings] | None = None

    def hold(self, fault: SensorFault, true: Readings) -> None:
        """Keep what the sensors read as a fault begins that repeats it."""
        self._readings.held[id(fault)] = _array(getattr(true, fault.READING))

    def distorted(self, true: Readings) -> Readings:
        """Return the readings as the faulty sensors give them.

        Args:
            true: the readings without any fault; readings of a later instant each time, or the same ones again.
        """
        if self._newest is None or self._newest[0].at != true.at:
            self._newest = true, self._now(true)
        return self._newest[1]

    def _now(self, true: Readings) -> Readings:
        changed: dict[str, Any] = {}
        for name in self._readings.names:
            value = _array(getattr(true, name))
            if (wrong := self._readings.of(name, value, true.at)) is not value:
                numbers = None if wrong is None else wrong.tolist()
                changed[name] = numbers[0] if numbers is not None and len(numbers) == 1 else numbers and tuple(numbers)
        return structs.replace(true, at=self._readings.stamp(true.at), **changed)


def _array(value: Sequence[float] | float | None) -> F64 | None:
    return None if value is None else np.atleast_1d(np.asarray(value, float)).copy()


ORIGIN_DEG = (63.44, 10.40)
"""Latitude and longitude of the world's origin: off Trondheim."""
ORIGIN = GeoPoint.of_degrees(*ORIGIN_DEG, 0.0)
"""The place of the world's origin, on the still water."""
SIGMA_M = 1.5
"""Standard deviation on each horizontal axis; upward it is twice that."""
_TIME_S = 60.0
_NOISE_M = 0.05


class GnssErrors:
    """The error of one GNSS receiver, which wanders: a Gauss-Markov process of some metres over minutes and centimetres of noise.

    Source: Rankin, An error model for sensor simulation: GPS and differential GPS, IEEE PLANS 1994.

    Args:
        seed: of its own random numbers, apart from all others of the flight.
    """

    def __init__(self, seed: list[int]) -> None:
        self._rng = np.random.default_rng(seed)
        self._wander = SIGMA_M * self._rng.standard_normal(3)
        self._at: MonoNs | None = None

    def place(self, p_ned: F64, now: MonoNs) -> GeoPoint:
        """Return the place that the receiver reports at `p_ned`, (3,) m from the world's origin."""
        since_s = 0.0 if self._at is None else seconds_between(self._at, now)
        keep = math.exp(-since_s / _TIME_S)
        self._wander = keep * self._wander + SIGMA_M * math.sqrt(1.0 - keep**2) * self._rng.standard_normal(3)
        self._at = now
        error = self._wander + _NOISE_M * self._rng.standard_normal(3)
        return moved(ORIGIN, p_ned + error * np.array([1.0, 1.0, 2.0]))
