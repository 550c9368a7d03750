"""The effect of faults on a vehicle's sensor readings. It is pure: the same readings and faults give the same result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.time import after
from sitl.faults import (
    AccelOffset,
    AttitudeOffset,
    FaultTimer,
    GyroOffset,
    HeadingOffset,
    LowBattery,
    NavdataMisstamped,
    PressureOffset,
    UltrasoundOffset,
)
from sitl.sensors import Readings

FROZEN = ("imu_frozen", "ultrasound_frozen")
"""Kinds for which the readings at their beginning have to be kept."""
_AXES = "xyz"


def distorted(true: Readings, faults: FaultTimer, held: Mapping[str, Readings]) -> Readings:
    """Return the readings as the faulty sensors give them.

    Args:
        true: the readings without any fault.
        held: for each kind of `FROZEN` that is on, the readings when it began.
    """
    r = true
    if faults.active("imu_frozen"):
        r = replace(r, f_body=held["imu_frozen"].f_body, w_body=held["imu_frozen"].w_body)
    for accel, _ in faults.on(AccelOffset):
        r = replace(r, f_body=r.f_body + accel.by_m_s2 * _unit(accel.axis))
    for gyro, _ in faults.on(GyroOffset):
        r = replace(r, w_body=r.w_body + math.radians(gyro.by_deg_s) * _unit(gyro.axis))
    for heading, since_s in faults.on(HeadingOffset):
        r = _turned(r, math.radians(heading.by_deg + heading.drift_deg_s * since_s))
    for attitude, _ in faults.on(AttitudeOffset):
        off = np.array([math.radians(attitude.roll_deg), math.radians(attitude.pitch_deg), 0.0])
        r = replace(r, rpy_rad=r.rpy_rad + off)
    if faults.active("ultrasound_frozen"):
        r = replace(r, ultrasound_m=held["ultrasound_frozen"].ultrasound_m)
    for echo, _ in faults.on(UltrasoundOffset):
        if r.ultrasound_m is not None:
            r = replace(r, ultrasound_m=max(0.0, r.ultrasound_m + echo.by_m))
    for pressure, _ in faults.on(PressureOffset):
        r = replace(r, pressure_pa=r.pressure_pa + pressure.by_pa)
    for battery, _ in faults.on(LowBattery):
        r = replace(r, battery_fraction=min(r.battery_fraction, battery.fraction))
    for stamp, _ in faults.on(NavdataMisstamped):
        r = replace(r, at=after(r.at, stamp.by_s))
    return r


def _unit(axis: str) -> F64:
    return np.array([float(axis == name) for name in _AXES])


def _turned(r: Readings, by_rad: float) -> Readings:
    """The heading and the field it comes from, as a compass beside steel reads them."""
    rpy = r.rpy_rad.copy()
    rpy[2] = wrap_pi(rpy[2] + by_rad)
    field = r.magnetometer
    if field is not None:
        c, s = math.cos(by_rad), math.sin(by_rad)
        field = np.array([c * field[0] + s * field[1], c * field[1] - s * field[0], field[2]])
    return replace(r, rpy_rad=rpy, magnetometer=field)
