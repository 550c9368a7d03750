"""The command arbiter at each of its edges: the deadline, the hold, the age of a report, and what the drone said."""

import pytest

from drivers.ardrone import at
from drivers.ardrone import navdata as nd
from drivers.ardrone.arbiter import HOVER, STAY_UP, CommandArbiter, TimedCommand
from drivers.ardrone.landing_watch import DroneReport
from estimator.contracts.time import MonoNs

AHEAD = at.Pcmd(at.PCMD_PROGRESSIVE, 0.0, -0.5, 0.0, 0.0)
FLY = at.Ref(STAY_UP)


def ms(t: int) -> MonoNs:
    return MonoNs(5_000_000_000 + t * 1_000_000)


def report(control: nd.ControlState | None, *, flying: bool, bits: int = 0, altitude_m: float | None = 1.5) -> DroneReport:
    return DroneReport(bits | (nd.NavdataState.FLYING if flying else 0), control, altitude_m)


def silent(hold_s: float = 60.0, **word: bool) -> CommandArbiter:
    """Return an arbiter whose newest word ran out at 120 ms."""
    arbiter = CommandArbiter(hold_s, 2.0)
    arbiter.take(TimedCommand(ms(120), AHEAD, STAY_UP, **word))
    return arbiter


def test_a_word_without_orders_sends_its_sticks_alone_and_its_parts_come_in_order() -> None:
    assert TimedCommand(ms(0), AHEAD).commands() == [AHEAD]
    assert TimedCommand(ms(0), AHEAD, at.REF_BASE).commands() == [at.Ref(at.REF_BASE), AHEAD]
    assert TimedCommand(ms(0), AHEAD, STAY_UP, watchdog=True).commands() == [at.ComWdg(), FLY, AHEAD]


def test_before_the_first_word_nothing_is_fresh_and_nothing_is_silent() -> None:
    arbiter = CommandArbiter(2.0, 2.0)
    assert not arbiter.fresh(ms(0))
    assert arbiter.silent_s(ms(0)) == 0.0
    assert arbiter.latest is None
    arbiter.lost(ms(0))
    assert arbiter.latest is None
    assert arbiter.hovers == 0


def test_silence_is_counted_from_the_deadline_and_held_up_to_its_end() -> None:
    arbiter = silent(2.0)
    assert arbiter.silent_s(ms(0)) == arbiter.silent_s(ms(120)) == 0.0
    assert arbiter.silent_s(ms(1120)) == 1.0
    assert arbiter.commands(ms(2120)) == [HOVER]
    assert arbiter.commands(ms(2121)) == []
    assert arbiter.commands(ms(121)) == [HOVER]
    assert arbiter.hovers == 2, "a datagram that is not sent is none"


def test_a_service_that_is_gone_never_lengthens_its_word() -> None:
    arbiter = silent()
    arbiter.lost(ms(5000))
    assert arbiter.latest is not None
    assert arbiter.latest.until == ms(120)
    arbiter.lost(ms(50))
    assert not arbiter.fresh(ms(50))
    assert arbiter.fresh(MonoNs(ms(50) - 1))


@pytest.mark.parametrize("watchdog", [True, False])
def test_without_a_report_the_watchdog_is_reset_where_the_word_requested_it(watchdog: bool) -> None:
    expected = [at.ComWdg(), HOVER] if watchdog else [HOVER]
    assert silent(watchdog=watchdog).commands(ms(121)) == expected
    late = silent(watchdog=watchdog)
    late.on_report(report(nd.ControlState.HOVERING, flying=True), ms(200))
    assert late.commands(ms(400)) == [FLY, HOVER], "as old as it may be"
    assert late.commands(ms(401)) == expected


@pytest.mark.parametrize(
    ("control", "flying", "on_ground"),
    [
        (nd.ControlState.LANDED, False, True),
        (nd.ControlState.INIT, False, True),
        (nd.ControlState.DEFAULT, False, True),
        (None, False, True),
        (nd.ControlState.HOVERING, False, False),
        (nd.ControlState.LANDING, False, False),
        (nd.ControlState.LANDED, True, False),
        (None, True, False),
    ],
)
def test_it_stands_where_state_and_control_both_say_so(control: nd.ControlState | None, flying: bool, on_ground: bool) -> None:
    arbiter = silent()
    assert not arbiter.on_ground(ms(200)), "nobody has said so"
    arbiter.on_report(report(control, flying=flying), ms(200))
    assert arbiter.on_ground(ms(1200)) is on_ground
    assert not arbiter.on_ground(ms(1201)), "said too long ago"
