"""A gimbal's reports and commands: frames, refusals, clocks, whose reports count, and when it is pointed down."""

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.clock import SystemClock
from drivers.mavlink.access import AccessLevel
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.boot_clock import BootClock
from drivers.mavlink.dialect import Message, MountStatus, mav
from drivers.mavlink.gimbal import Gimbal
from drivers.mavlink.gimbal_pointer import GimbalPointer, Step
from drivers.mavlink.gimbal_reports import GimbalSampler
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import GimbalOptions, GimbalReport
from drivers.mavlink.timesync import TimeSync
from drivers.mavlink.vehicle import Identity, Stack
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import GimbalAttitude
from estimator.contracts.time import NS_PER_S, MonoNs

NOW = MonoNs(50 * NS_PER_S)
VEHICLE, EARTH, LOCK = 32, 64, 16
TURNED = Rotation.from_rpy(0.1, -1.2, 0.7)
MOUNTED = Rotation.from_rpy(*np.radians([10.0, -80.0, 30.0]))
US, MANAGER = (1, 191), (1, 1)


def gimbal_status(
    rotation: Rotation = TURNED, flags: int = VEHICLE, *, ms: int = 0, failure: int = 0, delta: float = math.nan
) -> Message:
    return mav.MAVLink_gimbal_device_attitude_status_message(
        1, 0, ms, flags, rotation.quat_wxyz.tolist(), 0.0, 0.0, 0.0, failure, delta, math.nan, 0
    )


def taken(message: Message, report: GimbalReport = "auto") -> tuple[GimbalAttitude | None, GimbalSampler]:
    sampler = GimbalSampler(GimbalOptions(154, report=report))
    return sampler.sample(message, NOW, None), sampler


@pytest.mark.parametrize(
    ("message", "frame", "rotation"),
    [
        (MountStatus(1, 1, -8000, 1000, 3000), "body", MOUNTED),
        (gimbal_status(flags=VEHICLE), "level", TURNED),
        (gimbal_status(flags=0), "level", TURNED),
        (gimbal_status(flags=EARTH), "ned", TURNED),
        (gimbal_status(flags=LOCK), "ned", TURNED),
        (gimbal_status(flags=LOCK | VEHICLE), "level", TURNED),
        (gimbal_status(flags=EARTH, delta=0.4), "level", Rotation.from_rpy(0.0, 0.0, -0.4) @ TURNED),
        (gimbal_status(flags=EARTH, delta=0.0), "ned", TURNED),
        (gimbal_status(flags=LOCK, delta=0.4), "ned", TURNED),
        (mav.MAVLink_mount_orientation_message(0, 10.0, -80.0, 30.0, 90.0), "level", MOUNTED),
        (
            mav.MAVLink_mount_orientation_message(0, 10.0, -80.0, math.nan, 90.0),
            "ned",
            Rotation.from_rpy(*np.radians([10, -80, 90])),
        ),
    ],
)
def test_each_message_says_what_its_angles_are_relative_to(message: Message, frame: str, rotation: Rotation) -> None:
    sample, _ = taken(message, "mount_status" if frame == "body" else "auto")
    assert sample.frame == frame
    assert frame != "body" or taken(message)[0] is None, "only where the settings say so"
    assert sample.R_frame_gimbal.angle_to(rotation) < 1e-6


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (gimbal_status(flags=VEHICLE | EARTH), "frame"),
        (gimbal_status(failure=32), "failure"),
        (gimbal_status(failure=8 | 2), "failure"),
        (mav.MAVLink_gimbal_device_attitude_status_message(1, 0, 0, VEHICLE, [math.nan] * 4, 0, 0, 0, 0, 0, 0), "rotation"),
        (mav.MAVLink_gimbal_device_attitude_status_message(1, 0, 0, VEHICLE, [0.0] * 4, 0, 0, 0, 0, 0, 0), "rotation"),
        (mav.MAVLink_gimbal_device_attitude_status_message(1, 0, 0, VEHICLE, [0.5, 0, 0, 0], 0, 0, 0, 0, 0, 0), "rotation"),
        (mav.MAVLink_mount_orientation_message(0, 0.0, -90.0, math.nan, math.nan), "angle"),
        (mav.MAVLink_mount_orientation_message(0, 0.0, 1e9, 0.0), "angle"),
    ],
)
def test_what_is_no_attitude_is_refused_and_counted(message: Message, why: str) -> None:
    sample, sampler = taken(message)
    assert sample is None
    assert sampler.refused == {why: 1}


def test_the_older_message_counts_only_while_the_newer_one_does_not_come() -> None:
    sampler = GimbalSampler(GimbalOptions(154))
    older = mav.MAVLink_mount_orientation_message(0, 0.0, -90.0, 0.0, 0.0)
    assert sampler.sample(older, NOW, None) is not None
    assert sampler.sample(gimbal_status(), MonoNs(NOW + 1), None) is not None
    assert sampler.sample(older, MonoNs(NOW + NS_PER_S // 2), None) is None
    assert sampler.sample(older, MonoNs(NOW + 3 * NS_PER_S), None) is not None
    assert sampler.refused == {}


def test_a_report_that_was_overtaken_is_refused_and_the_latency_is_taken_off() -> None:
    sampler = GimbalSampler(GimbalOptions(154, latency_s=0.1, latency_sigma_s=0.03))
    clock = BootClock(TimeSync())
    first = sampler.sample(gimbal_status(ms=1000), NOW, clock)
    assert 0.1 <= (NOW - first.stamp.measured_at) * 1e-9 < 0.11
    assert first.stamp.sigma_s >= 0.03
    assert sampler.sample(gimbal_status(ms=1000), MonoNs(NOW + 1000), clock) is None
    assert sampler.sample(gimbal_status(ms=980), MonoNs(NOW + 2000), clock) is None
    assert sampler.refused == {"old": 2}
    assert sampler.sample(gimbal_status(ms=1020), MonoNs(NOW + 20_000_000), clock) is not None


numbers = st.floats(width=32)
words = st.integers(0, 2**32 - 1)
DEVICE = st.builds(
    mav.MAVLink_gimbal_device_attitude_status_message,
    *(st.integers(0, 255), st.integers(0, 255), words, st.integers(0, 65535), st.lists(numbers, min_size=4, max_size=4)),
    *(numbers, numbers, numbers, st.sampled_from([0, 1, 8]) | words, numbers, numbers, st.integers(0, 255)),
)
TOLD = (
    DEVICE
    | st.builds(mav.MAVLink_mount_orientation_message, words, numbers, numbers, numbers, numbers)
    | st.builds(MountStatus, *[st.integers(0, 255)] * 2, *[st.integers(-(2**31), 2**31 - 1)] * 3)
)


@given(st.lists(st.tuples(TOLD, st.integers(0, NS_PER_S)), max_size=6), st.sampled_from(["auto", "mount_status"]), st.booleans())
@settings(max_examples=150, deadline=None)
def test_no_message_raises_and_each_of_the_chosen_kind_is_a_sample_or_counted(told, report, own):
    sampler, instant, given_out = GimbalSampler(GimbalOptions(1, report=report)), int(NOW), []
    boot = BootClock(TimeSync()) if own else None
    for message, later in told:
        instant += later
        sample = sampler.sample(message, MonoNs(instant), boot)
        if sample is not None:
            given_out.append(sample)
            assert np.all(np.isfinite(sample.R_frame_gimbal.matrix))
            assert sample.stamp.measured_at <= instant
    times = [s.stamp.measured_at for s in given_out]
    assert times == sorted(set(times))
    assert len(given_out) + sampler.refused.total() <= len(told)


def instant(seconds: float) -> MonoNs:
    return MonoNs(NOW + round(seconds * NS_PER_S))


def requested(pointer: GimbalPointer, seconds: float, off_rad: float | None) -> tuple[int, list[float]] | None:
    messages = pointer.due(instant(seconds), US, MANAGER, off_rad)
    if not messages:
        return None
    (m,) = messages
    assert (m.target_system, m.target_component) == MANAGER
    return m.command, [m.param1, m.param2, m.param5, m.param7]


def test_it_takes_control_points_down_and_does_so_again_when_the_gimbal_has_left() -> None:
    pointer = GimbalPointer(154)
    assert requested(pointer, 0.0, None) == (1001, [1.0, 191.0, 0.0, 154.0])
    assert requested(pointer, 0.5, None) is None, "it waits for the answer"
    assert requested(pointer, 1.1, None) == (1001, [1.0, 191.0, 0.0, 154.0]), "and asks again without one"
    pointer.on_ack(1000, 0, instant(1.15))
    assert pointer.step is Step.CONTROL, "an answer to another command"
    pointer.on_ack(1001, 0, instant(1.2))
    assert requested(pointer, 1.2, 1.5) == (1000, [-90.0, 0.0, 44.0, 154.0])
    pointer.on_ack(1000, 0, instant(1.3))
    assert requested(pointer, 2.0, 1.5) is None, "it is on its way"
    assert requested(pointer, 9.0, 0.1) is None
    assert requested(pointer, 10.0, 0.3) == (1001, [1.0, 191.0, 0.0, 154.0])
    assert pointer.counts == {"pointed": 1, "left": 1}


def test_a_refusal_is_counted_and_requested_again_later(caplog: pytest.LogCaptureFixture) -> None:
    pointer = GimbalPointer(1)
    for n, t in enumerate((0.0, 10.0)):
        assert requested(pointer, t, None) is not None
        pointer.on_ack(1001, 2, instant(t + 0.1))
        assert requested(pointer, t + 3.0, None) is None
        assert pointer.counts["refused"] == n + 1
    assert [r.getMessage() for r in caplog.records] == ["gimbal 1: its manager refuses control (result 2); requesting it again"]
    assert requested(pointer, 20.0, None) is not None
    pointer.on_ack(1001, 3, instant(20.1))
    assert requested(pointer, 20.2, None) is not None
    assert pointer.step is Step.POINT, "a manager that knows no control may still point"


HERE, ELSEWHERE = (0, ("10.0.0.1", 14550)), (0, ("10.0.0.9", 14550))
INTERVAL, CONFIGURE = int(mav.MAV_CMD_SET_MESSAGE_INTERVAL), int(mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE)


def autopilot(*, settled: bool = True) -> Any:
    return SimpleNamespace(
        identity=Identity(1, 1, Stack.ARDUPILOT, 2),
        streams=SimpleNamespace(settled=settled),
        connected=True,
        connects=1,
        boot_clock=BootClock(TimeSync()),
        links=SimpleNamespace(identity=(1, 191)),
    )


def gimbal_report(number: int = 0) -> Message:
    return mav.MAVLink_gimbal_device_attitude_status_message(1, 0, 0, 32, [1, 0, 0, 0], 0, 0, 0, 0, math.nan, math.nan, number)


def received(
    message: Message, component: int, seconds: float, *, system: int = 1, source: Any = HERE, level: int = AccessLevel.OPERATOR
) -> ReceivedMessage:
    link, peer = source
    at = MonoNs(100 * NS_PER_S + round(seconds * NS_PER_S))
    return ReceivedMessage(message, link, at, system, component, peer, AccessLevel(level))


def is_taken(gimbal: Gimbal, *args: Any, **more: Any) -> bool:
    return gimbal.on_message(cast("Autopilot", autopilot()), received(*args, **more)) is not None


def test_only_reports_of_the_vehicle_s_own_gimbal_from_one_place_count() -> None:
    gimbal = Gimbal(GimbalOptions(154), SystemClock())
    assert not is_taken(gimbal, gimbal_report(), 171, 0.0), "another gimbal"
    assert not is_taken(gimbal, gimbal_report(1), 1, 0.1), "one that the autopilot drives"
    assert not is_taken(gimbal, gimbal_report(), 154, 0.2, system=2), "another vehicle's"
    assert not is_taken(gimbal, gimbal_report(), 154, 0.3, level=AccessLevel.UNKNOWN)
    assert is_taken(gimbal, gimbal_report(), 154, 0.4)
    assert not is_taken(gimbal, gimbal_report(), 154, 0.5, source=ELSEWHERE), "its ids from another place"
    assert is_taken(gimbal, gimbal_report(), 154, 0.6)
    assert is_taken(gimbal, gimbal_report(), 154, 5.0, source=ELSEWHERE), "the first has been silent"
    assert gimbal.counted()["reports"] == 3
    first, second = (Gimbal(GimbalOptions(n), SystemClock()) for n in (1, 2))
    for number, who in ((0, [True, False]), (1, [True, False]), (2, [False, True])):
        assert [is_taken(g, gimbal_report(number), 1, float(number)) for g in (first, second)] == who, (
            "an old one gives no number"
        )


def test_the_autopilot_is_queried_when_its_other_streams_are_settled_and_a_gimbal_at_once() -> None:
    now = MonoNs(100 * NS_PER_S)
    for device, target in ((1, (1, 1)), (154, (1, 154))):
        busy = Gimbal(GimbalOptions(device), SystemClock()).due(cast("Autopilot", autopilot(settled=False)), now)
        free = Gimbal(GimbalOptions(device), SystemClock()).due(cast("Autopilot", autopilot()), now)
        assert [(m.target_system, m.target_component, m.command, m.param1, m.param2) for m in free] == [
            (*target, INTERVAL, 285, 20000)
        ]
        assert len(busy) == (device > 6)


def test_a_manager_that_reports_of_itself_is_the_one_that_is_commanded_and_answers() -> None:
    gimbal, to = Gimbal(GimbalOptions(154, point_down=True), SystemClock()), cast("Autopilot", autopilot())
    gimbal.on_message(to, received(mav.MAVLink_gimbal_manager_status_message(0, 0, 171, 0, 0, 0, 0), 171, 0.0))
    gimbal.on_message(to, received(mav.MAVLink_gimbal_manager_status_message(0, 0, 154, 0, 0, 0, 0), 154, 0.0))
    asked = [m for m in gimbal.due(to, MonoNs(100 * NS_PER_S)) if m.command == CONFIGURE]
    assert [(m.target_system, m.target_component, m.param7) for m in asked] == [(1, 154, 154.0)]
    accepted = mav.MAVLink_command_ack_message(CONFIGURE, 0)
    gimbal.on_message(to, received(accepted, 1, 0.1))
    assert gimbal.pointer.step.name == "CONTROL", "an answer of another component"
    gimbal.on_message(to, received(accepted, 154, 0.2))
    assert gimbal.pointer.step.name == "POINT"
