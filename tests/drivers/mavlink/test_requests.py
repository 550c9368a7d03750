"""Streams and parameters are requested until they are answered, and refusals are kept."""

import itertools
import struct

import pytest

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.requests import Parameters, RateLimit, Streams, VersionRequest, parameter_value, wire_value
from drivers.mavlink.vehicle import Stack
from tests.make import ns

TARGET = (7, 1)


def ack(result: int = 0) -> Message:
    return mav.MAVLink_command_ack_message(mav.MAV_CMD_SET_MESSAGE_INTERVAL, result)


def test_one_stream_at_a_time_since_the_answer_does_not_say_which() -> None:
    streams = Streams({"ATTITUDE_QUATERNION": 100.0, "LOCAL_POSITION_NED": 50.0})
    (first,) = streams.due(ns(0), TARGET)
    assert (first.param1, first.param2, first.command) == (31, 10_000, 511)
    assert streams.due(ns(0.1), TARGET) == []
    streams.on_message(ack(), ns(0.2))
    (second,) = streams.due(ns(0.2), TARGET)
    assert (second.param1, second.param2) == (32, 20_000)
    streams.on_message(ack(2), ns(0.3))
    assert streams.due(ns(1), TARGET) == []
    assert streams.settled
    assert streams.refused == {"LOCAL_POSITION_NED": 2}


def test_where_the_quaternion_is_refused_the_angles_are_requested() -> None:
    streams = Streams({"ATTITUDE_QUATERNION": 100.0, "RAW_IMU": 50.0})
    streams.due(ns(0), TARGET)
    streams.on_message(ack(4), ns(0.1))
    asked = []
    for n in (1, 2):
        (request,) = streams.due(ns(0.2 * n), TARGET)
        asked.append((request.param1, request.param2))
        streams.on_message(ack(), ns(0.2 * n + 0.1))
    assert asked == [(27, 20_000), (30, 10_000)]
    assert streams.settled
    assert streams.refused == {"ATTITUDE_QUATERNION": 4}
    streams.restart()
    assert not streams.settled


def test_an_unanswered_request_is_repeated_and_then_given_up() -> None:
    streams = Streams({"RAW_IMU": 100.0}, tries=3)
    asked = [m for n in range(40) for m in streams.due(ns(0.1 * n), TARGET)]
    assert [m.confirmation for m in asked] == [0, 1, 2]
    assert streams.refused == {"RAW_IMU": -1}
    streams.restart()
    assert len(streams.due(ns(9), TARGET)) == 1


def test_a_stream_that_falls_silent_is_requested_again() -> None:
    streams = Streams({"RAW_IMU": 100.0})
    streams.due(ns(0), TARGET)
    streams.on_message(ack(), ns(0.1))
    for n in range(50):
        streams.on_message(mav.MAVLink_raw_imu_message(0, 0, 0, 0, 0, 0, 0, 0, 0, 0), ns(0.1 + 0.1 * n))
        assert streams.due(ns(0.1 + 0.1 * n), TARGET) == []
    assert len(streams.due(ns(9), TARGET)) == 1


@pytest.mark.parametrize(("result", "each_s", "most_s"), [(4, 1.0, 0.2), (0, 1.0, 0.32), (0, 0.2, 0.2)])
def test_the_mode_is_polled_where_its_reports_come_less_often_than_asked(result: int, each_s: float, most_s: float) -> None:
    """PX4 refuses HEARTBEAT more often than once a second, and answers the request for one; ArduPilot sends them as asked."""
    streams, arrivals, polls, begins_s = Streams({"HEARTBEAT": 5.0, "RAW_IMU": 100.0}), [0.0], 0, 10.0
    for n in range(1, 251):
        now_s = begins_s + 0.02 * n
        asked = streams.due(ns(now_s), TARGET)
        streams.on_message(mav.MAVLink_command_ack_message(mav.MAV_CMD_REQUEST_MESSAGE, 2), ns(now_s))  # no answer to a stream
        for m in asked:
            if m.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
                streams.on_message(ack(result if m.param1 == 0 else 0), ns(now_s))
        polled = [m for m in asked if m.command == mav.MAV_CMD_REQUEST_MESSAGE]
        assert all(m.param1 == 0 for m in polled)
        if polled or n % round(each_s / 0.02) == 0:
            streams.on_message(mav.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3), ns(now_s))
            arrivals.append(0.02 * n)
            polls += len(polled)
    assert max(b - a for a, b in itertools.pairwise(arrivals)) <= most_s + 0.02
    assert polls == 0 if each_s < 1.0 else 10 <= polls <= 32
    assert streams.refused == ({"HEARTBEAT": 4} if result else {})


def value(name: str, number: float, kind: int = 9) -> Message:
    return mav.MAVLink_param_value_message(name.encode(), number, kind, 900, 65535)


def test_parameters_are_read_a_few_at_a_time() -> None:
    names = [f"PLND_{n}" for n in range(6)]
    reader = Parameters(Stack.ARDUPILOT, names, at_once=2, tries=2)
    assert [m.param_id for m in reader.due(ns(0), TARGET)] == names[:2]
    reader.on_message(value("PLND_0", 0.5))
    assert [m.param_id for m in reader.due(ns(0.1), TARGET)] == [names[2]]
    for n in range(1, 120):
        for m in reader.due(ns(0.1 * n), TARGET):
            if m.param_id != "PLND_3":
                reader.on_message(value(m.param_id, 2.0))
    assert reader.settled
    assert reader.absent == {"PLND_3"}
    assert reader.values["PLND_0"] == 0.5
    reader.request(["PLND_3"])
    assert not reader.settled


@pytest.mark.parametrize(("value", "kind"), [(245, 6), (-1, 6), (-3, 2), (200, 1), (4_000_000_000, 5), (0.25, 9)])
def test_a_parameter_comes_back_as_it_was_set(value: float, kind: int) -> None:
    for stack in (Stack.PX4, Stack.ARDUPILOT):
        sent = mav.MAVLink_param_set_message(1, 1, b"NAME", wire_value(stack, value, kind), kind)
        (wire,) = struct.unpack("<f", struct.pack("<f", sent.param_value))
        assert parameter_value(stack, wire, kind) == pytest.approx(value, rel=1e-7)
    assert wire_value(Stack.PX4, -7, 6) == pytest.approx(struct.unpack("<f", struct.pack("<i", -7))[0], nan_ok=True), "as bytes"


@pytest.mark.parametrize(("value", "kind"), [(0.5, 6), (300, 1), (-1, 5)])
def test_what_does_not_fit_an_integer_is_refused(value: float, kind: int) -> None:
    with pytest.raises(ValueError, match=r"integer|does not fit"):
        wire_value(Stack.PX4, value, kind)


def test_requests_are_bounded_in_rate_whatever_is_requested() -> None:
    limit, sent = RateLimit(20.0, 100), 0
    for tick in range(250):  # 10 s
        while limit.allows(ns(0.04 * tick)):
            limit.spend(4)
            sent += 4
    assert 280 <= sent <= 310
    assert limit.allows(ns(1000.0)), "after a pause"


def test_the_version_is_requested_until_it_is_answered_and_not_for_ever() -> None:
    request = VersionRequest()
    asked = [t for t in range(60) if request.due(ns(float(t)), (1, 1))]
    assert asked == [0, 2, 4, 6]
    request = VersionRequest()
    (message,) = request.due(ns(0.0), (7, 1))
    assert (message.target_system, message.command, message.param1) == (7, 512, 148)
    request.answered = True
    assert not any(request.due(ns(float(t)), (7, 1)) for t in range(10))
