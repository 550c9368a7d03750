"""Failsafes by the autopilots' own reports: what is one, what is not, from when to when, and in which words."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.mavlink.dialect import Event, Message, mav
from drivers.mavlink.failsafe import FailsafeWatch, event_id
from drivers.mavlink.vehicle import ARMED
from tests.make import ns

ACTIVE, CRITICAL = int(mav.MAV_STATE_ACTIVE), int(mav.MAV_STATE_CRITICAL)


def event(name: str, arguments: bytes = b"") -> Message:
    """Return PX4's EVENT of this name."""
    return Event(0, 0, event_id(name), 0, 0, 0, list(arguments.ljust(40, b"\0")))


def heartbeat(watch: FailsafeWatch, t_s: float, state: int = ACTIVE, *, armed: bool = True) -> str | None:
    """Report a HEARTBEAT; return the words of the failsafe in force."""
    watch.on_heartbeat(mav.MAVLink_heartbeat_message(2, 3, ARMED if armed else 0, 4, state, 3), ns(t_s))
    return None if watch.now is None else watch.now.words


NAMES = """
Battery Failsafe; Radio Failsafe - Continuing Landing; EKF Failsafe: changed to LAND Mode
GCS + Battery Failsafe - Continuing Landing
Failsafe: Terrain data missing; Alt Max fence breached; Fence Breached; Dead Reckoning started; Potential Thrust Loss (3)
Failsafe activated; Battery 1 is low 10.40V used 3000 mAh; Crash: Disarming: AngErr=60>30, Accel=1.0<3.0"""
NAMES_NONE = """
Radio Failsafe Cleared; EKF Failsafe Cleared; Fence breach cleared; PreArm: Radio failsafe on; Arm: Battery failsafe
Failsafe warning: Low battery; Dead Reckoning stopped; Land complete; Mode change to LOITER; Battery Monitor found"""
TEXTS = [
    (text, names)
    for texts, names in ((NAMES, True), (NAMES_NONE, False))
    for text in texts.strip().replace("\n", "; ").split("; ")
]


@pytest.mark.parametrize(("text", "names"), TEXTS)
def test_a_text_names_a_failsafe_that_came_and_none_that_ends_or_keeps_from_arming(text: str, names: bool) -> None:
    watch = FailsafeWatch()
    heartbeat(watch, 0.0)
    watch.on_text(text, ns(1.0))
    assert (watch.now is not None) is names
    assert heartbeat(watch, 1.1, CRITICAL) == (text if names else "a failsafe")


@pytest.mark.hazard("A9")
def test_it_lasts_as_long_as_the_state_says_and_words_may_come_behind_it() -> None:
    watch = FailsafeWatch()
    assert heartbeat(watch, 0.0) is None
    assert heartbeat(watch, 1.0, CRITICAL) == "a failsafe"
    first = watch.now
    watch.on_text("Radio Failsafe", ns(2.0))
    assert (watch.now.words, watch.now.since) == ("Radio Failsafe", first.since)
    assert heartbeat(watch, 60.0, CRITICAL) == "Radio Failsafe"
    watch.on_text("Battery Failsafe", ns(61.0))
    assert (watch.now.words, watch.now.since) == ("Battery Failsafe", ns(61.0)), "another one"
    assert heartbeat(watch, 62.0) == "Battery Failsafe", "its text is not old"
    assert heartbeat(watch, 67.0) is None
    assert heartbeat(watch, 70.0, CRITICAL) == "a failsafe", "an old text names none that comes later"
    assert heartbeat(watch, 71.0, CRITICAL, armed=False) is None


def test_px4_says_why_in_an_event_and_a_fence_by_its_status() -> None:
    watch = FailsafeWatch()
    heartbeat(watch, 0.0)
    hold = struct.pack("<IBHB", 0, 5, 5, 1)
    watch.on_event(event("commander_failsafe_enter_hold", hold), ns(1.0))
    watch.on_text("Failsafe activated: entering Hold for 5 seconds", ns(1.0))
    watch.on_event(event("commander_failsafe_enter", struct.pack("<IBB", 0, 7, 1)), ns(6.0))
    watch.on_text("Failsafe activated", ns(6.0))
    assert heartbeat(watch, 6.1, CRITICAL) == "manual control lost"
    watch.on_event(event("another"), ns(9.0))
    assert heartbeat(watch, 20.0) is None
    watch.on_fence(mav.MAVLink_fence_status_message(1, 1, 2, 0), ns(21.0))
    assert heartbeat(watch, 40.0) == "the fence is breached"
    watch.on_fence(mav.MAVLink_fence_status_message(0, 1, 0, 0), ns(41.0))
    assert watch.now is None


@given(st.lists(st.tuples(st.integers(0, 8), st.text(max_size=50), st.binary(max_size=40), st.floats(0.0, 9.0)), max_size=12))
def test_any_reports_are_taken_and_a_failsafe_never_began_in_the_future(reports: list[tuple[int, str, bytes, float]]) -> None:
    watch, t_s = FailsafeWatch(), 0.0
    for state, text, arguments, wait_s in reports:
        t_s += wait_s
        watch.on_text(text, ns(t_s))
        watch.on_event(event("commander_failsafe_enter", arguments), ns(t_s))
        words = heartbeat(watch, t_s, state)
        assert words != ""
        assert watch.now is None or watch.now.since <= ns(t_s)
