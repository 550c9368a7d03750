"""The effect of faults on a vehicle's sensor readings.

The same readings, faults and seed give the same result, however often it is asked for.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Literal

import numpy as np
from msgspec.structs import replace

from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import MonoNs, after
from sitl.faults.fault import Fault
from sitl.faults.kinds import LowBattery, NavdataMisstamped
from sitl.faults.sensors import (
    MOST_DELAY_S,
    Accelerometer,
    AttitudeReading,
    Barometer,
    Gyro,
    HeadingReading,
    Magnetometer,
    SensorFault,
    Ultrasound,
    VelocityReading,
)
from sitl.faults.timer import FaultTimer
from sitl.sensors.sensors import Readings

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
_MAY_FAIL = (Ultrasound, Magnetometer)
"""Sensors that say nothing where a reading is dropped; the others repeat the one before."""


class FaultySensors:
    """Turns true readings into those of faulty sensors.

    Args:
        faults: which faults are active.
        seed: seed of dropped readings and of noise.
    """

    def __init__(self, faults: FaultTimer, seed: int) -> None:
        self._faults = faults
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
        for battery, _ in self._faults.on(LowBattery):
            r = replace(r, battery_fraction=min(r.battery_fraction, battery.fraction))
        for stamp, _ in self._faults.on(NavdataMisstamped):
            r = replace(r, at=after(r.at, stamp.by_s))
        return r

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
            r = replace(r, magnetometer=_turned(r.magnetometer, by_rad))
        return _put(r, field, value)

    def _at(self, at: MonoNs, true: Readings) -> Readings:
        """Return the readings that were the newest at an instant; the oldest known if none is as old."""
        older = [one for one in self._past if one.at <= at]
        return older[-1] if older else (self._past[0] if self._past else true)


def _array(value: Sequence[float] | float | None) -> F64 | None:
    return None if value is None else np.atleast_1d(np.asarray(value, float)).copy()


def _put(r: Readings, field: Field, value: F64 | None) -> Readings:
    """Return the readings with another value; a sensor that can fail may have None, the others then keep theirs."""
    if field == "ultrasound_m":
        return replace(r, ultrasound_m=None if value is None else max(0.0, float(value[0])))
    if field == "magnetometer":
        return replace(r, magnetometer=None if value is None else _three(value))
    if value is None:
        return r
    match field:
        case "f_body":
            return replace(r, f_body=_three(value))
        case "w_body":
            return replace(r, w_body=_three(value))
        case "rpy_rad":
            return replace(r, rpy_rad=_three(value))
        case "v_level_m_s":
            return replace(r, v_level_m_s=(float(value[0]), float(value[1])))
        case "pressure_pa":
            return replace(r, pressure_pa=float(value[0]))


def _three(value: F64) -> tuple[float, float, float]:
    x, y, z = value.tolist()
    return x, y, z


def _turned(field: tuple[float, float, float] | None, by_rad: float) -> tuple[float, float, float] | None:
    """Return the magnetic field as a compass beside steel reads it."""
    if field is None or by_rad == 0.0:
        return field
    c, s = math.cos(by_rad), math.sin(by_rad)
    return c * field[0] + s * field[1], c * field[1] - s * field[0], field[2]
