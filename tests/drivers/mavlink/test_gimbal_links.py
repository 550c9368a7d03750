"""Reports and answers that count as the gimbal's, and the requests to it."""

import math
from types import SimpleNamespace
from typing import Any, cast

from drivers.clock import SystemClock
from drivers.mavlink.access import AccessLevel
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.gimbal import Gimbal
from drivers.mavlink.gimbal_options import GimbalOptions
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import TimeSyncOptions
from drivers.mavlink.timesync import BootClock, TimeSync
from drivers.mavlink.vehicle import Identity, Stack
from estimator.contracts.time import NS_PER_S, MonoNs

HERE, ELSEWHERE = (0, ("10.0.0.1", 14550)), (0, ("10.0.0.9", 14550))
INTERVAL, CONFIGURE = int(mav.MAV_CMD_SET_MESSAGE_INTERVAL), int(mav.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE)


def autopilot(*, settled: bool = True) -> Any:
    return SimpleNamespace(
        identity=Identity(1, 1, Stack.ARDUPILOT, 2),
        streams=SimpleNamespace(settled=settled),
        connected=True,
        connects=1,
        boot_clock=BootClock(TimeSync(TimeSyncOptions())),
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


def taken(gimbal: Gimbal, *args: Any, **more: Any) -> bool:
    return gimbal.on_message(cast(Autopilot, autopilot()), received(*args, **more)) is not None


def test_only_reports_of_the_vehicle_s_own_gimbal_from_one_place_count() -> None:
    gimbal = Gimbal(GimbalOptions(154), SystemClock())
    assert not taken(gimbal, gimbal_report(), 171, 0.0), "another gimbal"
    assert not taken(gimbal, gimbal_report(1), 1, 0.1), "one that the autopilot drives"
    assert not taken(gimbal, gimbal_report(), 154, 0.2, system=2), "another vehicle's"
    assert not taken(gimbal, gimbal_report(), 154, 0.3, level=AccessLevel.UNKNOWN)
    assert taken(gimbal, gimbal_report(), 154, 0.4)
    assert not taken(gimbal, gimbal_report(), 154, 0.5, source=ELSEWHERE), "its ids from another place"
    assert taken(gimbal, gimbal_report(), 154, 0.6)
    assert taken(gimbal, gimbal_report(), 154, 5.0, source=ELSEWHERE), "the first has been silent"
    assert gimbal.counted()["reports"] == 3


def test_a_gimbal_that_the_autopilot_drives_is_reported_by_its_number_and_an_old_autopilot_gives_none() -> None:
    first, second = (Gimbal(GimbalOptions(n), SystemClock()) for n in (1, 2))
    for number, who in ((0, [True, False]), (1, [True, False]), (2, [False, True])):
        assert [taken(g, gimbal_report(number), 1, float(number)) for g in (first, second)] == who
    assert not taken(first, gimbal_report(1), 154, 3.0)


def test_the_autopilot_is_queried_when_its_other_streams_are_settled_and_a_gimbal_at_once() -> None:
    now = MonoNs(100 * NS_PER_S)
    for device, target in ((1, (1, 1)), (154, (1, 154))):
        busy = Gimbal(GimbalOptions(device), SystemClock()).due(cast(Autopilot, autopilot(settled=False)), now)
        free = Gimbal(GimbalOptions(device), SystemClock()).due(cast(Autopilot, autopilot()), now)
        assert [(m.target_system, m.target_component, m.command, m.param1, m.param2) for m in free] == [
            (*target, INTERVAL, 285, 20000)
        ]
        assert len(busy) == (device > 6)


def test_a_manager_that_reports_of_itself_is_the_one_that_is_commanded_and_answers() -> None:
    gimbal, to = Gimbal(GimbalOptions(154, point_down=True), SystemClock()), cast(Autopilot, autopilot())
    gimbal.on_message(to, received(mav.MAVLink_gimbal_manager_status_message(0, 0, 171, 0, 0, 0, 0), 171, 0.0))
    gimbal.on_message(to, received(mav.MAVLink_gimbal_manager_status_message(0, 0, 154, 0, 0, 0, 0), 154, 0.0))
    asked = [m for m in gimbal.due(to, MonoNs(100 * NS_PER_S)) if m.command == CONFIGURE]
    assert [(m.target_system, m.target_component, m.param7) for m in asked] == [(1, 154, 154.0)]
    accepted = mav.MAVLink_command_ack_message(CONFIGURE, 0)
    assert gimbal.pointer is not None
    gimbal.on_message(to, received(accepted, 1, 0.1))
    assert gimbal.pointer.step.name == "CONTROL", "an answer of another component"
    gimbal.on_message(to, received(accepted, 154, 0.2))
    assert gimbal.pointer.step.name == "POINT"
