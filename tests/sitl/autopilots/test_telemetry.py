"""Measurements of an autopilot that are corrupted on their way to the service."""

import math

import numpy as np
import pytest

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from estimator.contracts.geometry import Rotation
from estimator.contracts.motion import G_M_S2
from sitl.emulators.autopilots.lock_step import LockStepClock
from sitl.emulators.autopilots.telemetry import FaultyTelemetry, in_datagrams
from sitl.faults.corrupted import Corrupted
from sitl.faults.faulty_streams import FlightFaults

AUTOPILOT = Codec(1, 1)
YAW_RAD = math.radians(90.0)
ATTITUDE = mav.MAVLink_attitude_quaternion_message(7, *Rotation.from_rpy(0.02, -0.03, YAW_RAD).quat_wxyz, 0.0, 0.0, 0.0)
VELOCITY = mav.MAVLink_local_position_ned_message(7, 1.0, 2.0, -3.0, 0.5, 0.25, -0.1)
HIGHRES = mav.MAVLink_highres_imu_message(7, 0.1, 0.2, -9.8, 0.01, 0.02, 0.03, 0, 0, 0, 1000.0, 0, 0, 20.0, 63)
RAW = mav.MAVLink_raw_imu_message(7, 10, 20, -1000, 10, 20, 30, 0, 0, 0)
RANGE = mav.MAVLink_distance_sensor_message(7, 5, 5000, 200, 0, 0, 25, 0)


def told(message: Message, *faults: Corrupted) -> Message:
    """Return a message as it is told, after an attitude."""
    timer = FlightFaults(faults)
    timer.update(1.0, 5.0, None)
    link = in_datagrams(FaultyTelemetry(timer, 1, LockStepClock()).reported)
    link(AUTOPILOT.pack(ATTITUDE))
    data = AUTOPILOT.pack(message)
    (changed,) = Codec(0, 0, datagrams=True).feed(link(data))
    (true,) = Codec(0, 0, datagrams=True).feed(data)
    assert (changed.get_srcSystem(), changed.get_srcComponent(), changed.get_seq()) == (1, 1, true.get_seq())
    return changed


def biased(signal: str, size: float, axis: str = "all") -> Corrupted:
    return Corrupted(signal=signal, error="biased", size=size, axis=axis, at_s=0.0)


def test_a_signal_is_told_wrong_in_its_own_axes_and_unit() -> None:
    east = told(VELOCITY, biased("velocity", 1.0, "x"))
    assert (east.vx, east.vy, east.vz) == pytest.approx((0.5, 1.25, -0.1)), "forward of a vehicle that looks east"
    turned = told(ATTITUDE, biased("attitude", 5.0, "x"), biased("heading", 10.0))
    rpy = Rotation.from_quat((turned.q1, turned.q2, turned.q3, turned.q4)).rpy_rad
    assert np.degrees(rpy) == pytest.approx((5.0 + math.degrees(0.02), math.degrees(-0.03), 100.0), abs=1e-3)
    both = biased("accelerometer", 0.5, "z"), biased("gyro", math.degrees(0.1), "y")
    imu = told(HIGHRES, *both)
    assert (imu.xacc, imu.zacc, imu.ygyro) == pytest.approx((0.1, -9.3, 0.12))
    milli = told(RAW, *both)
    assert (milli.xacc, milli.zacc, milli.ygyro) == (10, round(-1000 + 500 / G_M_S2), 120)
    assert told(RANGE, biased("range", 0.5)).current_distance == 250
    assert told(RANGE, biased("range", -9.0)).current_distance == 0, "none is negative"


def test_what_nothing_is_wrong_with_passes_as_it_is() -> None:
    pack = AUTOPILOT.pack(VELOCITY) + AUTOPILOT.pack(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3))
    for faults in ((), (biased("gyro", 1.0),)):
        link = FaultyTelemetry(FlightFaults(faults), 1, LockStepClock())
        assert in_datagrams(link.reported)(pack) == in_datagrams(link.ordered)(pack) == pack, "before it begins"
