"""Output of the command arbiter once the service has fallen silent, in virtual time."""

from collections.abc import Callable

import pytest
from msgspec.structs import replace

from drivers.ardrone import at
from drivers.ardrone import navdata as nd
from drivers.ardrone.arbiter import CLEAR_M, HOVER, Cause, CommandArbiter, LandingWatch, TimedCommand
from estimator.contracts.time import MonoNs

AHEAD = at.Pcmd(at.PCMD_PROGRESSIVE, 0.0, -0.5, 0.0, 0.0)
FLY = at.Ref(at.REF_BASE | at.REF_TAKE_OFF)
GROUND = at.Ref(at.REF_BASE)
CLIMB = at.Pcmd(at.PCMD_PROGRESSIVE, 0.1, -0.2, 1.0, 0.0)
PERIOD_MS = 30


def ms(t: int) -> MonoNs:
    return MonoNs(5_000_000_000 + t * 1_000_000)


def drone_report(control: nd.ControlState | None, altitude_m: float | None = 1.5, bits: int = 0) -> nd.Navdata:
    in_the_air = control not in (nd.ControlState.LANDED, nd.ControlState.INIT)
    word = None if control is None else control.word
    altitude_mm = None if altitude_m is None else round(1000 * altitude_m)
    state = bits | (nd.NavdataState.FLYING if in_the_air else 0)
    return nd.Navdata(state, 1, ctrl_state=word, altitude_mm=altitude_mm)


def test_a_word_is_flown_up_to_its_deadline_and_hover_after_it() -> None:
    arbiter = CommandArbiter(60.0, 2.0)
    assert arbiter.commands(ms(0)) == [], "nothing is said before the service has said something"
    arbiter.take(TimedCommand(ms(120), AHEAD, FLY.bits))
    assert arbiter.commands(ms(0)) == arbiter.commands(ms(120)) == [FLY, AHEAD]
    assert arbiter.commands(ms(121)) == [HOVER], "no order to take off outlives its word"
    arbiter.take(TimedCommand(ms(120), AHEAD, GROUND.bits))
    assert arbiter.commands(ms(5000)) == [HOVER], "it waited in the socket while we, or the service, were stopped"


def test_a_word_of_a_service_that_is_gone_ends_at_once() -> None:
    arbiter = CommandArbiter(60.0, 2.0)
    arbiter.take(TimedCommand(ms(120), AHEAD, FLY.bits))
    arbiter.lost(ms(10))
    assert arbiter.commands(ms(10)) == [HOVER]
    arbiter.lost(ms(50))
    assert arbiter.silent_s(ms(50)) == pytest.approx(0.04), "counted from when it was lost first"


def test_a_drone_in_the_air_is_held_there_and_its_watchdog_answered() -> None:
    arbiter = CommandArbiter(60.0, 2.0)
    arbiter.take(TimedCommand(ms(120), AHEAD, FLY.bits))
    arbiter.on_report(drone_report(nd.ControlState.HOVERING, bits=nd.NavdataState.COM_WATCHDOG), ms(1000))
    assert arbiter.commands(ms(1001)) == [at.ComWdg(), FLY, HOVER]
    assert arbiter.commands(ms(1300)) == [HOVER], "told too late, the wish to fly would start the motors of one that has landed"
    arbiter.on_report(drone_report(nd.ControlState.LANDED), ms(1400))
    assert arbiter.commands(ms(1401)) == [HOVER]
    assert arbiter.on_ground(ms(1401))


def climbed_m(sticks: at.Pcmd, ref: int | None, reports: Callable[[float], nd.Navdata | None], *, died: bool = True) -> float:
    """Return the height that an arbiter climbs in 20 s after its service has died, or fell silent.

    Args:
        reports: the report after a climb of so much, m; None to receive none.
    """
    arbiter, height_m = CommandArbiter(60.0, 2.0), 0.0
    arbiter.take(TimedCommand(ms(120), sticks, ref, climb=CLIMB))
    if died:
        arbiter.lost(ms(0))
    for t in range(0, 20_000, PERIOD_MS):
        if (said := reports(height_m)) is not None:
            arbiter.on_report(said, ms(t))
        *_, flown = arbiter.commands(ms(t))
        assert flown in ((HOVER, CLIMB) if died or t > 1120 else (HOVER, AHEAD))
        height_m += 2e-3 * PERIOD_MS if flown == CLIMB else 0.0
    return height_m


@pytest.mark.hazard("H5")
@pytest.mark.parametrize("died", [True, False])
@pytest.mark.parametrize("sticks", [AHEAD, HOVER])
def test_a_drone_without_a_service_climbs_out_of_the_reach_of_the_deck(sticks: at.Pcmd, died: bool) -> None:
    near = climbed_m(sticks, FLY.bits, lambda by_m: drone_report(nd.ControlState.FLYING, 0.3 + by_m), died=died)
    assert 0.3 + near == pytest.approx(CLEAR_M, abs=0.1)
    assert climbed_m(sticks, FLY.bits, lambda _: drone_report(nd.ControlState.FLYING, 2.1), died=died) == 0.0, "it is high enough"
    for mute in (None, drone_report(nd.ControlState.FLYING, None), drone_report(nd.ControlState.HOVERING, 0.0)):
        by_time = climbed_m(sticks, FLY.bits, lambda _, said=mute: said, died=died)
        assert by_time == pytest.approx(CLEAR_M if sticks is AHEAD else 0.0, abs=0.15), "without a height by time, if it steered"
    stuck = climbed_m(sticks, FLY.bits, lambda _: drone_report(nd.ControlState.FLYING, 0.3), died=died)
    assert stuck == pytest.approx(2.0 * CLEAR_M, abs=0.15), "an ultrasound that never changes is not believed for ever"


def test_nothing_climbs_that_does_not_fly_or_that_a_person_lands_or_cut() -> None:
    for control in (nd.ControlState.LANDED, nd.ControlState.TAKING_OFF, nd.ControlState.LANDING):
        said = drone_report(control, 0.3)
        assert climbed_m(AHEAD, FLY.bits, lambda _, said=said: said) == 0.0
    assert climbed_m(AHEAD, GROUND.bits, lambda _: drone_report(nd.ControlState.FLYING, 0.3)) == 0.0


def test_a_service_that_speaks_again_ends_the_climb() -> None:
    arbiter = CommandArbiter(60.0, 2.0)
    for t in (0, 5000):
        arbiter.take(TimedCommand(ms(t + 120), AHEAD, FLY.bits, climb=CLIMB))
        assert arbiter.commands(ms(t)) == [FLY, AHEAD]
        assert arbiter.commands(ms(t + 121)) == [HOVER], "a pause is not the end"
        arbiter.lost(ms(t + 130))
        assert arbiter.commands(ms(t + 130)) == [CLIMB]


def test_it_is_held_for_a_bounded_time() -> None:
    arbiter = CommandArbiter(2.0, 2.0)
    arbiter.take(TimedCommand(ms(120), AHEAD, FLY.bits))
    assert arbiter.commands(ms(2110)) == [HOVER]
    assert arbiter.commands(ms(2130)) == []


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
    arbiter = CommandArbiter(60.0, 2.0)
    assert not arbiter.on_ground(ms(200)), "nobody has said so"
    arbiter.on_report(replace(drone_report(control), state=nd.NavdataState.FLYING if flying else 0), ms(200))
    assert arbiter.on_ground(ms(300)) is on_ground
    assert not arbiter.on_ground(ms(1300)), "said too long ago"


@pytest.mark.parametrize(("landing", "altitude_m", "called_off"), [(True, 1.0, True), (True, 0.3, False), (False, 1.0, False)])
def test_a_landing_nobody_renews_is_called_off_unless_it_is_about_to_end(landing, altitude_m, called_off):
    """The landing of a person, which is not to be renewed, goes on."""
    arbiter = CommandArbiter(60.0, 2.0)
    arbiter.take(TimedCommand(ms(120), HOVER, GROUND.bits, landing=landing))
    arbiter.on_report(drone_report(nd.ControlState.LANDING, altitude_m), ms(300))
    assert arbiter.commands(ms(301)) == ([FLY, HOVER] if called_off else [HOVER])


SILENT = nd.NavdataState.COM_WATCHDOG | nd.NavdataState.COMMUNICATION_LOST


@pytest.mark.parametrize(
    ("bits", "first_at", "cause"),
    [
        (SILENT, None, Cause.SILENCE),
        (nd.NavdataState.COM_WATCHDOG, None, Cause.SILENCE),
        (SILENT, 9000, Cause.OTHERS),
        (0, None, Cause.OTHERS),
        (SILENT | nd.NavdataState.BATTERY_LOW, None, Cause.OTHERS),
        (SILENT | nd.NavdataState.USER_EMERGENCY, None, Cause.OTHERS),
    ],
)
def test_whose_landing_it_is(bits: int, first_at: int | None, cause: Cause) -> None:
    """A landing is attributed to our silence only if it began in a gap of navdata; never if a battery or a person began it."""
    watch = LandingWatch()
    if first_at is not None:
        watch.on_report(drone_report(nd.ControlState.HOVERING), ms(first_at), ordered=False)
    watch.on_report(drone_report(nd.ControlState.LANDING, 1.5, bits), ms(9500), ordered=False)
    assert watch.cause is cause
    assert watch.calls_off(ms(9510)) is (cause is Cause.SILENCE)
    assert not watch.calls_off(ms(9800)), "known too long ago"
    watch.on_report(drone_report(nd.ControlState.LANDING, 0.4), ms(9900), ordered=False)
    assert not watch.calls_off(ms(9901)), "too near the ground"
    watch.on_report(drone_report(nd.ControlState.HOVERING), ms(9950), ordered=False)
    assert watch.cause is None
