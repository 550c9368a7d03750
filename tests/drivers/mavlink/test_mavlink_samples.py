"""Messages to samples: units, axes, refusals. Every number differs, so that none can be swapped unseen."""

import math
from typing import Any

import numpy as np
import pytest

from drivers.mavlink.boot_clock import BootClock
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.samples import MavlinkSampler, inertial_delay_s, tilt_max_deg
from drivers.mavlink.timesync import TimeSync
from drivers.mavlink.vehicle import Stack
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Baro, GeoFix, Range, VehicleStatus, VesselReport
from estimator.contracts.time import MonoNs

NOW = MonoNs(9_000_000_000)


def sampler(stack: Stack = Stack.ARDUPILOT, **options: Any) -> MavlinkSampler:
    return MavlinkSampler(stack, BootClock(TimeSync()), **options)


def attitude_message(yaw_deg: float, roll_deg: float = 3.0, pitch_deg: float = -5.0) -> Any:
    q = Rotation.from_rpy(math.radians(roll_deg), math.radians(pitch_deg), math.radians(yaw_deg)).quat_wxyz
    return mav.MAVLink_attitude_quaternion_message(4000, *q, 0.0, 0.0, 0.0)


def test_attitude_in_angles_where_no_quaternion_comes() -> None:
    s = sampler()
    (quaternion,) = sampler().samples(attitude_message(70.0), NOW)
    assert np.degrees(quaternion.R_ned_body.rpy_rad) == pytest.approx((3.0, -5.0, 70.0))
    angles = mav.MAVLink_attitude_message(4000, *np.radians((3.0, -5.0, 70.0)), 0.1, 0.2, 0.3)
    (sample,) = s.samples(angles, NOW)
    assert np.degrees(sample.R_ned_body.rpy_rad) == pytest.approx((3.0, -5.0, 70.0))
    assert s.samples(mav.MAVLink_attitude_message(4000, math.nan, 0, 0, 0, 0, 0), NOW) == []
    assert s.refused["ATTITUDE"] == 1
    s.samples(attitude_message(70.0), NOW)
    assert s.samples(angles, NOW) == [], "one attitude an instant"


@pytest.mark.parametrize("yaw_deg", range(-135, 181, 45))
def test_velocity_is_turned_into_level_by_the_heading_alone(yaw_deg: int) -> None:
    s = sampler()
    s.samples(attitude_message(yaw_deg), NOW)
    (sample,) = s.samples(mav.MAVLink_local_position_ned_message(4000, 11.0, 12.0, -13.0, 1.5, -2.5, 0.5), NOW)
    yaw = math.radians(yaw_deg)
    expected = (1.5 * math.cos(yaw) - 2.5 * math.sin(yaw), -1.5 * math.sin(yaw) - 2.5 * math.cos(yaw), 0.5)
    assert sample.v_level == pytest.approx(expected)
    assert s.positions[-1].p_body_ned == pytest.approx((11.0, 12.0, -13.0))


def test_imu_of_both_stacks() -> None:
    (raw,) = sampler().samples(mav.MAVLink_raw_imu_message(4_000_000, 100, -200, -1000, 10, -20, 30, 0, 0, 0), NOW)
    assert raw.f_body == pytest.approx((0.980665, -1.96133, -9.80665))
    assert raw.w_body == pytest.approx((0.01, -0.02, 0.03))
    px4 = sampler(Stack.PX4)
    assert px4.samples(mav.MAVLink_raw_imu_message(4_000_000, 1, 2, 3, 4, 5, 6, 0, 0, 0), NOW) == []
    message = mav.MAVLink_highres_imu_message(4_000_000, 0.1, -0.2, -9.8, 0.01, -0.02, 0.03, 0, 0, 0, 1013.25, 0, 0, 20.0, 0x3F)
    (high,) = px4.samples(message, NOW)
    assert (*high.f_body, *high.w_body) == pytest.approx((0.1, -0.2, -9.8, 0.01, -0.02, 0.03))
    message.fields_updated = 0x200
    (baro,) = px4.samples(message, NOW)
    assert isinstance(baro, Baro)
    assert baro.height_m == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("stack", "values", "delay_ms"),
    [
        (Stack.ARDUPILOT, {"INS_GYRO_FILTER": 20.0}, 11.254),
        (Stack.ARDUPILOT, {"INS_GYRO_FILTER": 40.0}, 5.627),
        (Stack.ARDUPILOT, {"INS_GYRO_FILTER": 1.0}, 50.0),
        (Stack.ARDUPILOT, {"INS_GYRO_FILTER": 0.0}, 0.0),
        (Stack.ARDUPILOT, {"INS_GYRO_FILTER": -20.0}, 0.0),
        (Stack.ARDUPILOT, {"IMU_INTEG_RATE": 200.0}, 0.0),
        (Stack.PX4, {"IMU_INTEG_RATE": 200.0}, 2.5),
        (Stack.PX4, {"INS_GYRO_FILTER": 20.0}, 0.0),
        (Stack.OTHER, {"INS_GYRO_FILTER": 20.0, "IMU_INTEG_RATE": 200.0}, 0.0),
    ],
)
def test_the_delay_of_inertial_readings_by_parameter(stack: Stack, values: dict[str, float], delay_ms: float) -> None:
    assert 1e3 * inertial_delay_s(stack, values) == pytest.approx(delay_ms, abs=0.001)


@pytest.mark.parametrize(
    ("stack", "values", "tilt_deg"),
    [
        (Stack.ARDUPILOT, {}, None),
        (Stack.ARDUPILOT, {"ANGLE_MAX": 3000.0, "PSC_ANGLE_MAX": 0.0}, 30.0),
        (Stack.ARDUPILOT, {"ATC_ANGLE_MAX": 40.0, "PSC_ANGLE_MAX": 25.0}, 25.0),
        (Stack.PX4, {"MPC_TILTMAX_AIR": 45.0, "ANGLE_MAX": 3000.0}, 45.0),
        (Stack.OTHER, {"ANGLE_MAX": 3000.0}, None),
    ],
)
def test_the_limit_of_the_tilt_is_in_the_status(stack: Stack, values: dict[str, float], tilt_deg: float | None) -> None:
    s = sampler()
    s.tilt_max_deg = tilt_max_deg(stack, values)
    assert s.status(NOW, link_ok=True).tilt_max_deg == pytest.approx(tilt_deg)


def distance(cm: int, **fields: Any) -> Any:
    given = {"orientation": 25, "covariance": 4, "signal_quality": 0} | fields
    return mav.MAVLink_distance_sensor_message(4000, 20, 4000, cm, 0, 1, **given)


def test_range() -> None:
    (sample,) = sampler().samples(distance(345), NOW)
    assert (sample.range_m, sample.sigma_m) == pytest.approx((3.45, 0.02))
    (sample,) = sampler().samples(distance(345, covariance=255), NOW)
    assert isinstance(sample, Range)
    assert sample.sigma_m == pytest.approx(0.03)


@pytest.mark.parametrize("cm", [10, 20, 4000, 4100])
def test_a_range_at_the_sensor_s_own_limits_is_none(cm: int) -> None:
    assert sampler().samples(distance(cm), NOW) == []


def status(s: MavlinkSampler, message: Any, at: int = NOW) -> VehicleStatus | None:
    out = s.samples(message, MonoNs(at))
    assert len(out) <= 1
    assert not out or isinstance(out[0], VehicleStatus)
    return out[0] if out else None  # type: ignore[return-value]


def test_status_follows_mode_motors_and_ground() -> None:
    s = sampler(Stack.PX4)
    s.samples(mav.MAVLink_sys_status_message(0, 0, 0, 0, 12000, -1, 61, 0, 0, 0, 0, 0, 0), NOW)
    first = status(s, mav.MAVLink_heartbeat_message(2, 12, 0x81, 6 << 16, 4, 3))
    assert (first.mode, first.flying, first.battery_fraction, first.emergency) == ("offboard", None, 0.61, False)
    assert status(s, mav.MAVLink_heartbeat_message(2, 12, 0x81, 6 << 16, 4, 3)) is None, "nothing new"
    landed = status(s, mav.MAVLink_extended_sys_state_message(0, 1))
    assert landed.flying is False
    assert status(s, mav.MAVLink_heartbeat_message(2, 12, 0x81, 6 << 16, 4, 3), NOW + 600_000_000) is not None
    flying = status(s, mav.MAVLink_extended_sys_state_message(0, 4))
    assert flying.flying is True
    cut = status(s, mav.MAVLink_heartbeat_message(2, 12, 0x81, 6 << 16, 8, 3))
    assert cut.emergency


@pytest.mark.parametrize(("armed", "lasts_s", "flies"), [(True, 0.3, True), (True, 0.7, False), (False, 0.1, False)])
def test_landed_for_a_moment_is_not_believed_of_a_vehicle_that_flew(armed: bool, lasts_s: float, flies: bool) -> None:
    s, second = sampler(Stack.ARDUPILOT), 1_000_000_000
    s.samples(mav.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3), NOW)
    s.samples(mav.MAVLink_extended_sys_state_message(0, 2), NOW)
    for n in range(round(10 * lasts_s) + 1):
        at = MonoNs(NOW + second + n * second // 10)
        s.samples(mav.MAVLink_heartbeat_message(2, 3, 0x81 if armed else 0x01, 4, 4, 3), at)
        s.samples(mav.MAVLink_extended_sys_state_message(0, 1), at)
    assert s.condition.flying is flies
    s.samples(mav.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3), MonoNs(NOW + 2 * second))
    s.samples(mav.MAVLink_extended_sys_state_message(0, 2), MonoNs(NOW + 2 * second))
    assert s.condition.flying is True


def test_each_part_of_the_condition_has_an_age() -> None:
    s, beat, later = sampler(Stack.ARDUPILOT), mav.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3), MonoNs(NOW + 20_000_000_000)
    s.samples(mav.MAVLink_sys_status_message(0, 0, 0, 0, 12000, -1, 61, 0, 0, 0, 0, 0, 0), NOW)
    s.samples(mav.MAVLink_extended_sys_state_message(0, 1), NOW)
    s.samples(beat, NOW)
    assert (s.condition.flying, s.status(NOW, link_ok=True).battery_fraction) == (False, 0.61)
    old = s.status(later, link_ok=True)
    assert (old.mode, old.flying, old.battery_fraction) == ("unknown", None, None)
    assert status(s, beat, later) is not None, "what it reports itself stands where nothing else has been reported lately"
    assert s.condition.flying is True


@pytest.mark.parametrize("stack", [Stack.PX4, Stack.ARDUPILOT])
def test_an_armed_px4_flies_only_when_it_reports_it_or_reports_nothing_for_long(stack: Stack) -> None:
    """It is active as soon as it is armed, ArduPilot as soon as it flies."""
    s = sampler(stack)
    armed, apm = mav.MAVLink_heartbeat_message(2, 12 if stack is Stack.PX4 else 3, 0x81, 6 << 16, 4, 3), stack is Stack.ARDUPILOT
    for after_ms, flying in ((0, apm), (2_999, apm), (3_000, True)):
        s.samples(armed, MonoNs(NOW + after_ms * 1_000_000))
        assert (s.condition.flying is True) is flying
    again = sampler(stack)
    again.samples(armed, NOW)
    again.samples(mav.MAVLink_extended_sys_state_message(0, 2), NOW)
    assert again.condition.flying is True
    disarmed = mav.MAVLink_heartbeat_message(2, 12, 0x01, 6 << 16, 3, 3)
    other = sampler(stack)
    other.samples(disarmed, NOW)
    assert other.condition.flying is False


def test_the_vessel_reports_its_velocity_and_bow() -> None:
    place = (543_210_000, 102_030_000, 12_500, 4)
    fix, sample = sampler().vessel(mav.MAVLink_global_position_int_message(4000, *place, 150, -250, 50, 12345), NOW)
    assert fix.whose == "vessel"
    assert np.degrees([fix.place.latitude_rad, fix.place.longitude_rad]) == pytest.approx([54.321, 10.203])
    assert fix.place.height_m == pytest.approx(12.5)
    assert fix.v_ned == pytest.approx((1.5, -2.5, 0.5))
    assert sample.v_vessel_ned == pytest.approx((1.5, -2.5, 0.5))
    assert sample.heading_rad == pytest.approx(math.radians(123.45))
    (own,) = sampler().samples(mav.MAVLink_global_position_int_message(4000, *place, 150, -250, 50, 0), NOW)
    assert (own.whose, own.place) == ("vehicle", fix.place)
    nowhere = mav.MAVLink_global_position_int_message(4000, 0, 0, 3, 4, 150, -250, 50, 65535)
    assert sampler().samples(nowhere, NOW) == []
    (sample,) = sampler().vessel(nowhere, NOW)
    assert isinstance(sample, VesselReport), "0 N 0 E is where receivers without a fix are"
    assert sample.heading_rad is None


def follow_target(**changed: Any) -> Message:
    fields = {
        "timestamp": 4000, "est_capabilities": 3, "lat": 543_210_000, "lon": 102_030_000, "alt": 12.5, "vel": [1.5, -2.5, 0.5],
        "acc": [0, 0, 0], "attitude_q": [0, 0, 0, 0], "rates": [0, 0, 0], "position_cov": [6.0, 9.0, 0], "custom_state": 0,
    }  # fmt: skip
    return mav.MAVLink_follow_target_message(**{**fields, **changed})


def test_a_follow_target_is_the_ship_s_place_and_velocity_as_far_as_it_reports_it() -> None:
    fix, report = sampler().vessel(follow_target(), NOW)
    assert (fix.whose, fix.sigma_m, fix.place.height_m) == ("vessel", 6.0, 12.5)
    assert report.v_vessel_ned == pytest.approx((1.5, -2.5, 0.5))
    assert [type(s) for s in sampler().vessel(follow_target(est_capabilities=1), NOW)] == [GeoFix]
    assert [type(s) for s in sampler().vessel(follow_target(est_capabilities=2), NOW)] == [VesselReport]
    s = sampler()
    assert s.vessel(follow_target(lat=910_000_000, vel=[math.inf, 0, 0]), NOW) == []
    assert s.refused == {"FOLLOW_TARGET": 1}


@pytest.mark.parametrize(
    "message",
    [
        mav.MAVLink_attitude_quaternion_message(10**6, math.nan, 0, 0, 0, 0, 0, 0),
        mav.MAVLink_attitude_quaternion_message(10**6, 0.0, 0, 0, 0, 0, 0, 0),
        mav.MAVLink_local_position_ned_message(10**6, math.inf, 0, 0, 0, math.nan, 0),
        mav.MAVLink_highres_imu_message(10**9, math.nan, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x3F),
        mav.MAVLink_highres_imu_message(10**9, 1e4, 0, -9.8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x3F),
        mav.MAVLink_highres_imu_message(10**9, 0, 0, -9.8, 0, 101.0, 0, 0, 0, 0, 0, 0, 0, 0, 0x3F),
        mav.MAVLink_local_position_ned_message(10**6, 0, 0, -1e38, -1e38, 0, 0),
        mav.MAVLink_local_position_ned_message(10**6, 0, 0, 0, 0, 200.0, 0),
        mav.MAVLink_attitude_message(10**6, 1e6, 0, 0, 0, 0, 0),
        mav.MAVLink_scaled_pressure_message(10**6, 1e38, 0, 0, 0),
    ],
    ids=lambda message: str(message.get_type()),
)
def test_what_no_sensor_can_measure_is_refused_before_its_stamp_is_accepted(message: Any) -> None:
    s = sampler(Stack.PX4)
    assert s.samples(message, NOW) == []
    assert s.refused == {message.get_type(): 1}
    assert s._clock._newest is None, "nor does it move the autopilot's clock"


def test_a_message_that_came_twice_or_was_overtaken_is_counted_and_makes_no_sample() -> None:
    s, codec = sampler(), Codec(1, 1)

    def at(boot_ms: int) -> Any:
        q = Rotation.from_rpy(0.0, 0.0, 1e-5 * boot_ms).quat_wxyz
        return codec.feed(codec.pack(mav.MAVLink_attitude_quaternion_message(boot_ms, *q, 0.0, 0.0, 0.0)))[0]

    twice = at(5000)
    assert len(s.samples(twice, NOW)) == 1
    assert s.samples(twice, NOW) == []
    assert len(s.samples(at(5020), NOW)) == 1
    assert s.samples(at(5010), NOW) == []
    assert s.attitude.R_ned_body.rpy_rad[2] == pytest.approx(1e-5 * 5020, abs=1e-6)
    assert s.out_of_order == {"ATTITUDE_QUATERNION": 2}
    broken = at(5900)
    broken.q1 = math.nan
    assert s.samples(broken, NOW) == []
    assert len(s.samples(at(5040), NOW)) == 1, "a message that makes no sense moves nothing"
    assert len(s.samples(at(300), NOW)) == 1, "the autopilot has booted"
    assert len(s.samples(at(320), NOW)) == 1
