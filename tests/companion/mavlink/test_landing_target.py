"""The target as each autopilot understands it: every field, the receivers' own arithmetic, and what they drop."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import Struct

from companion.parts.mavlink.outputs import (
    distance_sensor,
    landing_target,
    range_along_down,
    target_relative,
)
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message
from estimator.contracts.geometry import Rotation
from tests.companion.mavlink.receivers import ArduPilotReceiver, Px4Receiver, Vector, ned_to_body

HEADINGS_DEG = (0, 45, 90, 135, 180, -135, -90, -45)
TILTS_DEG = ((0.0, 0.0), (15.0, -7.0), (-11.0, 18.0))
D_NED: Vector = (0.83, -1.42, 4.1)
P_NED: Vector = (31.0, -52.0, -17.0)
ARROW_DEG = 25.0
RADIUS_M = 0.39
TIME_US = 1_234_567_890


class Case(Struct, frozen=True):
    """One vector."""

    stack: str
    heading_deg: int
    roll_deg: float
    pitch_deg: float

    @property
    def name(self) -> str:
        return f"{self.stack} heading {self.heading_deg} roll {self.roll_deg:g} pitch {self.pitch_deg:g}"

    @property
    def rpy(self) -> Vector:
        return math.radians(self.roll_deg), math.radians(self.pitch_deg), math.radians(self.heading_deg)


CASES = [Case(stack, h, *tilt) for stack in ("ardupilot", "px4") for h in HEADINGS_DEG for tilt in TILTS_DEG]


ARROW = Rotation.from_rpy(0.0, 0.0, math.radians(ARROW_DEG))


def send(case: Case, R_ned_pad: Rotation | None = None) -> Message:
    body, place = Rotation.from_rpy(*case.rpy), None if case.stack == "ardupilot" else np.array(P_NED)
    message = landing_target(TIME_US, np.array(D_NED), body, place, pad_radius_m=RADIUS_M, R_ned_pad=R_ned_pad)
    assert message is not None
    return message


def over_the_wire(message: Message) -> Message:
    (got,) = Codec(1, 1).feed(Codec(7, 191).pack(message))
    return got


@pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)
def test_every_field_is_what_one_turn_after_the_other_gives(case: Case) -> None:
    """The fields are computed by the receivers' own turns, not by the geometry under test."""
    x, y, z = ned_to_body(case.rpy, D_NED)
    distance = math.sqrt(x * x + y * y + z * z)
    size = 2 * math.atan(RADIUS_M / distance)
    if case.stack == "ardupilot":
        frame, place = 12, (x, y, z)
    else:
        frame, place = 1, (P_NED[0] + D_NED[0], P_NED[1] + D_NED[1], P_NED[2] + D_NED[2])
    m = over_the_wire(send(case))
    ours = (m.angle_x, m.angle_y, m.distance, m.size_x, m.size_y, m.x, m.y, m.z)
    assert ours == pytest.approx((math.atan(y / z), math.atan(-x / z), distance, size, size, *place), rel=2e-7, abs=2e-7)
    assert (m.time_usec, m.target_num, m.frame, m.type, m.position_valid) == (TIME_US, 0, frame, 3, 1)
    assert list(m.q) == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize("case", [c for c in CASES if c.stack == "px4"], ids=lambda c: c.name)
def test_px4_takes_the_target_where_it_is(case: Case) -> None:
    m = over_the_wire(send(case, ARROW))
    receiver = Px4Receiver()
    kind, place = receiver.on_message(m) or ("", (0.0, 0.0, 0.0))
    assert kind == "absolute"
    assert place == pytest.approx([p + d for p, d in zip(P_NED, D_NED, strict=True)], abs=1e-5)
    assert (m.frame, m.position_valid, m.type, m.time_usec) == (1, 1, 3, TIME_US)
    assert list(m.q) == pytest.approx(ARROW.quat_wxyz, abs=1e-6)


coordinate = st.floats(-8.0, 8.0)


@settings(max_examples=80)
@given(coordinate, coordinate, st.floats(0.3, 20.0), st.floats(-0.35, 0.35), st.floats(-0.35, 0.35), st.floats(-3.14, 3.14))
def test_angles_position_and_distance_agree_wherever_the_pad_is(x, y, z, roll, pitch, yaw):
    d: Vector = (x, y, z)
    message = landing_target(1, np.array(d), Rotation.from_rpy(roll, pitch, yaw), pad_radius_m=0.39)
    if message is None:
        assert ned_to_body((roll, pitch, yaw), d)[2] < 0.03
        return
    m = over_the_wire(message)
    tolerance_m = 2e-5 * m.distance / max(m.z, 0.02)
    for form in ("position", "angles of 4.0", "angles and a rangefinder"):
        receiver = ArduPilotReceiver(angles_only=form != "position")
        if form == "angles and a rangefinder":
            m.distance, receiver.rangefinder_m = 0.0, ned_to_body((roll, pitch, yaw), d)[2]
        receiver.loop((roll, pitch, yaw))
        assert receiver.on_message(m) == pytest.approx(d, abs=tolerance_m)


def test_the_receivers_drop_what_the_real_ones_drop() -> None:
    """The models of this test against what was measured on the programs themselves."""
    good = over_the_wire(send(CASES[0]))
    receiver = ArduPilotReceiver()
    receiver.loop((0.0, 0.0, 0.0))
    for frame in (1, 8):
        good.frame = frame
        assert receiver.on_message(good) is None
    assert receiver.texts == ["Plnd: Frame not supported"]
    good.frame, good.distance = 12, 0.0
    assert receiver.on_message(good) is None
    px4 = Px4Receiver()
    assert px4.on_message(good) is None
    assert px4.events == ["landing target: unsupported coordinate frame 12"]


def test_target_relative_for_the_vision_target_estimator() -> None:
    body = Rotation.from_rpy(0.1, -0.2, math.radians(90.0))
    cov = np.diag([0.01, 0.04, 0.09])
    m = over_the_wire(target_relative(TIME_US, np.array(D_NED), cov, body, ARROW, 0.05))
    assert (m.timestamp, m.frame, m.type) == (TIME_US, 1, 3)
    expected = ned_to_body((0.1, -0.2, math.radians(90.0)), D_NED)
    assert (m.x, m.y, m.z) == pytest.approx(expected, abs=1e-5)
    # Nose east: forward carries east's sigma, right carries north's
    assert m.pos_std[:2] == pytest.approx((0.2, 0.1), abs=0.02)
    assert sum(s * s for s in m.pos_std) == pytest.approx(0.14, rel=1e-5), "a rotation keeps the trace"
    assert m.yaw_std == pytest.approx(0.05)
    to_ned = Rotation.from_quat(m.q_sensor)
    assert (to_ned @ Rotation.from_quat(m.q_target)).angle_to(ARROW) < 1e-5
    assert to_ned @ np.array([m.x, m.y, m.z]) == pytest.approx(D_NED, abs=1e-5)


def test_distance_sensor_looks_down_and_says_when_it_sees_nothing() -> None:
    m = over_the_wire(distance_sensor(2**32 + 7, 3.456, 0.03, 9))
    assert (m.current_distance, m.orientation, m.covariance, m.id, m.signal_quality) == (346, 25, 9, 9, 0)
    assert m.min_distance < m.current_distance < m.max_distance
    m = over_the_wire(distance_sensor(7, None, 0.03, 9))
    assert m.current_distance > m.max_distance
    assert m.signal_quality == 1


def test_the_range_is_along_the_bodys_down_axis() -> None:
    for roll, pitch in ((0.0, 0.0), (0.3, -0.2), (-0.1, 0.35)):
        body = Rotation.from_rpy(roll, pitch, 1.0)
        reading = range_along_down(np.array([1.0, -2.0, 4.0]), body)
        assert reading is not None
        assert (body @ np.array([0.0, 0.0, reading]))[2] == pytest.approx(4.0)
    assert range_along_down(np.array([0.0, 0.0, -1.0]), Rotation.identity()) is None
