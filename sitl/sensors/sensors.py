"""The vehicle's sensors, with the errors measured on a real AR.Drone 2.0 (provenance: `sitl.scenario.scenario.SensorSettings`).

Every sensor has its own random generator and advances with the physics, whether it is read or not: the same seed gives the same
readings to the bit. Roll, pitch and velocity are the drone's own estimates, which its loops use too. The formulae are the core's,
`sitl/core/physics/sensors.c`.

Faults act on finished readings: the same readings, faults and seed give the same result, however often it is requested.
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import Literal

import numpy as np
from msgspec import Struct, structs

from estimator.contracts.geometry import F64, GeoPoint, moved, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.contracts.time import MonoNs, after, seconds_between
from sitl.core.abi import DL_ECHOES_MAX, DL_SENSOR_NOISE
from sitl.core.library import SIM
from sitl.faults.fault import (
    MOST_DELAY_S,
    Accelerometer,
    AttitudeReading,
    Barometer,
    Corruptions,
    Fault,
    FaultTimer,
    Gyro,
    HeadingReading,
    Magnetometer,
    SensorFault,
    Signal,
    Ultrasound,
    VelocityReading,
)
from sitl.faults.kinds import LowBattery, NavdataMisstamped, charge_left
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


Field = Literal["f_body", "w_body", "rpy_rad", "v_level_m_s", "ultrasound_m", "pressure_pa", "magnetometer"]
_FIELDS: dict[type[SensorFault], Field] = {
    Accelerometer: "f_body",
    Gyro: "w_body",
    AttitudeReading: "rpy_rad",
    HeadingReading: "rpy_rad",
    VelocityReading: "v_level_m_s",
    Ultrasound: "ultrasound_m",
    Barometer: "pressure_pa",
    Magnetometer: "magnetometer",
}
_SIGNALS: dict[Signal, tuple[Field, slice]] = {
    "accelerometer": ("f_body", slice(3)),
    "gyro": ("w_body", slice(3)),
    "attitude": ("rpy_rad", slice(2)),
    "heading": ("rpy_rad", slice(2, 3)),
    "velocity": ("v_level_m_s", slice(2)),
    "range": ("ultrasound_m", slice(1)),
    "barometer": ("pressure_pa", slice(1)),
}
"""The signals of the readings: the field of each, and its part of it."""
_MAY_FAIL = (Ultrasound, Magnetometer)
"""Sensors that say nothing where a reading is dropped; the others repeat the one before."""


class FaultySensors:
    """Turns true readings into those of faulty sensors.

    Args:
        faults: which faults are active.
        seed: seed of dropped readings and of noise.
        corruptions: what the signals say instead of what was measured.
        battery_life_s: time in which a full battery is used up.
    """

    def __init__(self, faults: FaultTimer, seed: int, corruptions: Corruptions, battery_life_s: float) -> None:
        self._faults, self._corruptions, self._battery_life_s = faults, corruptions, battery_life_s
        self._seed = seed
        self._begun: dict[int, Readings] = {}
        """The true readings at the beginning of each frozen sensor's fault."""
        self._reported: dict[int, F64 | None] = {}
        """The newest value that each sensor with dropped readings has reported."""
        self._past: deque[Readings] = deque()
        self._newest: tuple[Readings, Readings] | None = None

    def begin(self, fault: Fault, true: Readings) -> None:
        """Take note of a fault that begins now, with the true readings of this instant."""
        if isinstance(fault, SensorFault) and fault.frozen:
            self._begun[id(fault)] = true

    def distorted(self, true: Readings) -> Readings:
        """Return the readings as the faulty sensors give them.

        Args:
            true: the readings without any fault; readings of a later instant each time, or the same ones again.
        """
        if self._newest is None or self._newest[0].at != true.at:
            if self._faults.delays:
                self._past.append(true)
                while self._past[0].at < after(true.at, -MOST_DELAY_S - 0.1):
                    self._past.popleft()
            self._newest = true, self._now(true)
        return self._newest[1]

    def _now(self, true: Readings) -> Readings:
        r = true
        for number, (fault, since_s) in enumerate(self._faults.on(SensorFault)):
            r = self._with(fault, since_s, number, true, r)
        if self._corruptions.signals:
            r = self._corrupted(true, r)
        if low := self._faults.on(LowBattery):
            r = structs.replace(r, battery_fraction=charge_left(r.battery_fraction, low, self._battery_life_s))
        for stamp, _ in self._faults.on(NavdataMisstamped):
            r = structs.replace(r, at=after(r.at, stamp.by_s))
        return r

    def _corrupted(self, true: Readings, r: Readings) -> Readings:
        """Return the readings with what the corrupted signals say."""
        for signal, (field, part) in _SIGNALS.items():
            value = _array(getattr(r, field))
            if value is None or signal not in self._corruptions.signals:
                continue
            before = tuple(value[part].tolist())
            after_it = self._corruptions.of(signal, before, true.at)
            if after_it is not before:
                value[part] = after_it
                r = _put(r, field, value)
        (stamp_s,) = self._corruptions.of("sample_stamps", ((at_s := true.at * 1e-9),), true.at)
        return r if stamp_s == at_s else structs.replace(r, at=after(r.at, stamp_s - at_s))

    def _with(self, fault: SensorFault, since_s: float, number: int, true: Readings, r: Readings) -> Readings:
        """Return the readings with one fault more."""
        field, errors = _FIELDS[type(fault)], fault.errors
        value = _array(getattr(r, field))
        mine = np.array(errors.axes)
        if fault.delay_s > 0.0 or fault.frozen:
            source = self._begun[id(fault)] if fault.frozen else self._at(after(true.at, -fault.delay_s), true)
            other = _array(getattr(source, field))
            value = None if value is None or other is None else np.where(mine, other, value)
        rng = np.random.default_rng([self._seed, true.at // 1_000_000, number])
        if fault.dropped_fraction > 0.0 and rng.random() < fault.dropped_fraction:
            value = None if isinstance(fault, _MAY_FAIL) else self._reported.get(id(fault), value)
        elif fault.dropped_fraction > 0.0:
            self._reported[id(fault)] = value
        if value is not None:
            added = np.array(errors.offset) + since_s * np.array(errors.drift)
            if errors.noise > 0.0:
                added = added + mine * errors.noise * rng.standard_normal(len(value))
            value = np.where(mine, fault.scale * value, value) + added
            value = np.where(mine, np.clip(value, -errors.limit, errors.limit), value)
        if isinstance(fault, HeadingReading) and value is not None:
            by_rad = errors.offset[2] + since_s * errors.drift[2]
            value[2] = wrap_pi(float(value[2]))
            r = structs.replace(r, magnetometer=_turned(r.magnetometer, by_rad))
        return _put(r, field, value)

    def _at(self, at: MonoNs, true: Readings) -> Readings:
        """Return the readings that were the newest at an instant; the oldest known if none is as old."""
        older = [one for one in self._past if one.at <= at]
        return older[-1] if older else (self._past[0] if self._past else true)


def _array(value: Sequence[float] | float | None) -> F64 | None:
    return None if value is None else np.atleast_1d(np.asarray(value, float)).copy()


def _put(r: Readings, field: Field, value: F64 | None) -> Readings:
    """Return the readings with another value; a sensor that can fail may have None, the others then keep theirs."""
    if value is None:
        return structs.replace(r, **{field: None}) if field in ("ultrasound_m", "magnetometer") else r
    numbers = value.tolist()
    if field == "ultrasound_m":
        numbers = [max(0.0, numbers[0])]
    return structs.replace(r, **{field: tuple(numbers) if len(numbers) > 1 else numbers[0]})


def _turned(field: tuple[float, float, float] | None, by_rad: float) -> tuple[float, float, float] | None:
    """Return the magnetic field as a compass beside steel reads it."""
    if field is None or by_rad == 0.0:
        return field
    c, s = math.cos(by_rad), math.sin(by_rad)
    return c * field[0] + s * field[1], c * field[1] - s * field[0], field[2]


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
