"""The AR.Drone's helm at each of its edges: ages, timeouts, what the drone said, and what is remembered of a command."""

import numpy as np
import pytest

from drivers.ardrone import at
from drivers.ardrone import navdata as nd
from drivers.ardrone.arbiter import HOVER, STAY_UP
from drivers.ardrone.command_streamer import RESET, CommandStreamer, step
from drivers.ardrone.counters import Counters
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.commands import CutMotors, Hover, Land, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, Baro, BodyVelocity
from estimator.contracts.time import MonoNs, Stamp

FORWARD = Velocity(np.array([0.4, 0.0, 0.0]), 0.0)
FLYING, HOVERING, LANDING, LANDED = (
    nd.ControlState.FLYING, nd.ControlState.HOVERING, nd.ControlState.LANDING, nd.ControlState.LANDED,
)  # fmt: skip
GROUND = at.REF_BASE


def ms(t: float) -> MonoNs:
    return MonoNs(10_000_000_000 + round(t * 1_000_000))


class Cockpit:
    """A helm, what it counts, and what it receives."""

    def __init__(self) -> None:
        self.counters = Counters()
        self.options = ArDroneOptions(
            command_timeout_s=0.25, velocity_timeout_s=0.2, take_off_timeout_s=5.0, navdata_silence_s=1.0, landing_timeout_s=0.5
        )
        self.streamer = CommandStreamer(self.options, self.counters)

    def hears(self, t: float, control: nd.ControlState | None, bits: int = 0, *, altitude_m: float = 1.0) -> None:
        state = bits | (0 if control in (LANDED, nd.ControlState.INIT, nd.ControlState.DEFAULT) else nd.NavdataState.FLYING)
        demo = () if control is None else (nd.Demo(control.word, 50, 0.0, 0.0, 0.0, round(1000 * altitude_m), 0.0, 0.0, 0.0),)
        self.streamer.on_navdata(nd.Navdata.of(state, 1, demo), ms(t))

    def measures(self, t: float, forward_m_s: float = 0.0) -> None:
        stamp = Stamp(ms(t), ms(t), 0.001, "synced")
        self.streamer.on_sample(BodyVelocity(stamp, np.array([forward_m_s, 0.0, 0.0]), np.diag([0.1, 0.1, UNKNOWN_VAR])))

    def leans(self, t: float, pitch_rad: float) -> None:
        stamp = Stamp(ms(t), ms(t), 0.001, "synced")
        self.streamer.on_sample(Attitude(stamp, Rotation.from_rpy(0.0, pitch_rad, 0.0), 1e-4 * np.eye(3)))

    def ref(self, t: float) -> int | None:
        return self.streamer.command(ms(t)).ref

    def sticks(self, t: float) -> at.Pcmd:
        return self.streamer.command(ms(t)).sticks


@pytest.fixture
def cockpit() -> Cockpit:
    return Cockpit()


def test_each_age_may_be_reached(cockpit: Cockpit) -> None:
    cockpit.hears(0, FLYING)
    cockpit.measures(50)
    cockpit.streamer.take(FORWARD, ms(0))
    assert cockpit.sticks(250) != HOVER
    assert cockpit.sticks(250.001) == HOVER
    assert (cockpit.counters.hover_for_age, cockpit.counters.hover_for_blindness) == (1, 0)
    cockpit.streamer.take(FORWARD, ms(200))
    assert cockpit.sticks(250.001) == HOVER
    assert (cockpit.counters.hover_for_age, cockpit.counters.hover_for_blindness) == (1, 1)
    assert cockpit.ref(1000) == STAY_UP
    assert cockpit.ref(1000.001) is None
    assert cockpit.streamer.flying, "what it said last is known all the same"


def test_a_take_off_is_wished_for_up_to_its_timeout_and_given_up_once(cockpit: Cockpit) -> None:
    cockpit.streamer.take(TakeOff(), ms(0))
    assert cockpit.ref(5000) == STAY_UP
    assert cockpit.ref(5000.001) is None
    assert cockpit.ref(5001) is None
    assert cockpit.counters.take_offs_given_up == 1


def test_a_hover_in_place_of_a_velocity_is_the_word_of_this_period_and_not_as_old_as_the_velocity(cockpit: Cockpit) -> None:
    cockpit.hears(0, FLYING)
    cockpit.measures(0)
    cockpit.streamer.take(FORWARD, ms(0))
    word = cockpit.streamer.command(ms(100))
    assert (word.sticks != HOVER, word.until) == (True, ms(250))
    word = cockpit.streamer.command(ms(900))
    assert (word.sticks, word.ref, word.until) == (HOVER, STAY_UP, ms(1150))


def test_a_persons_landing_is_not_made_guidances_own_by_repeating_it(cockpit: Cockpit) -> None:
    cockpit.hears(0, FLYING)
    for standing, renewed in ((False, True), (True, False)):
        cockpit.streamer.take(Land(persistent=standing), ms(1))
        assert cockpit.streamer.command(ms(1)).landing is renewed
    cockpit.streamer.take(Land(), ms(2))
    cockpit.streamer.take(FORWARD, ms(3))
    assert cockpit.streamer.landing
    assert cockpit.streamer.command(ms(4)).landing is False


EMERGENCY = at.REF_BASE | at.REF_EMERGENCY


@pytest.mark.parametrize(
    ("command", "bit", "toggles"),
    [
        (CutMotors(), nd.NavdataState.EMERGENCY, False), (CutMotors(), 0, True), (CutMotors(), None, True),
        (LeaveEmergency(), nd.NavdataState.EMERGENCY, True), (LeaveEmergency(), 0, False), (LeaveEmergency(), None, True),
    ],
)  # fmt: skip
def test_the_first_toggle_is_sent_unless_the_drone_is_already_where_it_leads(cockpit, command, bit, toggles):
    """Motors that somebody else has cut would be released by it."""
    if bit is not None:
        cockpit.hears(0, LANDED, bit)
    cockpit.streamer.take(command, ms(1))
    assert (cockpit.ref(2) == EMERGENCY) is toggles


@pytest.mark.parametrize(
    ("command", "bit", "again_ms"), [(CutMotors(), 0, 300), (LeaveEmergency(), nd.NavdataState.EMERGENCY, 2000)]
)
def test_a_toggle_without_effect_is_sent_again_when_its_time_is_over(cockpit, command, bit, again_ms):
    cockpit.hears(0, LANDED, bit)
    cockpit.streamer.take(command, ms(0))
    assert [cockpit.ref(t) for t in (1, 2, 3)] == [EMERGENCY] * 3
    for t, toggles in ((again_ms - 0.001, False), (again_ms, True)):
        cockpit.hears(t, LANDED, bit)
        cockpit.streamer.take(command, ms(t))
        assert (cockpit.ref(t) == EMERGENCY) is toggles


@pytest.mark.parametrize(("age_ms", "ref"), [(250, STAY_UP), (250.001, None)])
def test_a_low_landing_for_our_silence_is_called_off_while_guidance_flies(cockpit, age_ms, ref):
    cockpit.streamer.take(FORWARD, ms(0))
    cockpit.hears(age_ms, LANDING, nd.NavdataState.COM_WATCHDOG, altitude_m=0.3)
    assert cockpit.ref(age_ms) == ref


def test_what_holds_against_the_wind_stays_where_it_blows_from_while_the_nose_turns(cockpit: Cockpit) -> None:
    def sticks(t: float, yaw_rad: float | None) -> at.Pcmd:
        cockpit.hears(t, FLYING)
        cockpit.measures(t, -0.4 if t < 2000 else 0.0)
        if yaw_rad is not None:
            cockpit.streamer.on_sample(
                Attitude(Stamp(ms(t), ms(t), 0.001, "synced"), Rotation.from_rpy(0.0, 0.0, yaw_rad), np.eye(3))
            )
        cockpit.streamer.take(Velocity(np.zeros(3), 0.0), ms(t))
        return cockpit.sticks(t)

    for t in range(0, 2000, 20):
        sticks(t, 0.5)
    ahead, turned = sticks(2000, 0.5), sticks(2020, 0.5 + np.pi / 2)
    assert ahead.pitch < -0.01
    assert abs(ahead.roll) < 1e-9
    assert (turned.roll, turned.pitch) == (pytest.approx(ahead.pitch, rel=0.05), pytest.approx(0.0, abs=1e-9))


def test_a_datagram_without_the_control_state_leaves_the_one_before(cockpit: Cockpit) -> None:
    cockpit.hears(0, nd.ControlState.TAKING_OFF)
    cockpit.streamer.take(FORWARD, ms(0))
    cockpit.measures(0)
    cockpit.hears(1, None)
    assert cockpit.sticks(2) == HOVER, "it is still taking off"
    cockpit.hears(3, HOVERING)
    assert cockpit.sticks(4) != HOVER


@pytest.mark.parametrize(("silent_ms", "altitude_m", "ref"), [(500, 1.0, GROUND), (500.001, 1.0, STAY_UP), (900, 0.49, GROUND)])
def test_a_landing_nobody_renews_is_given_up_after_its_time(cockpit, silent_ms, altitude_m, ref):
    cockpit.hears(0, FLYING)
    cockpit.streamer.take(Land(), ms(0))
    cockpit.hears(silent_ms, LANDING, altitude_m=altitude_m)
    assert cockpit.ref(silent_ms) == ref
    given_up = int(ref == STAY_UP)
    assert (cockpit.counters.landings_given_up, cockpit.counters.landings_called_off) == (given_up, given_up)
    cockpit.hears(silent_ms + 20, LANDING, altitude_m=0.2)
    assert cockpit.ref(silent_ms + 20) == ref, "called off once, it is called off down to fifteen centimetres"
    cockpit.hears(silent_ms + 40, LANDING, altitude_m=0.14)
    assert cockpit.ref(silent_ms + 40) == (None if given_up else GROUND)


@pytest.mark.parametrize(
    "before", [(), (Land(), FORWARD, None), (Land(), FORWARD, Land(), TakeOff())], ids=["new", "landed", "flown"]
)
def test_how_low_a_landing_for_our_silence_is_called_off_owes_nothing_to_one_before(cockpit, before):
    for t, command in enumerate(before):
        cockpit.hears(10 * t, LANDED if command is None else FLYING)
        if command is not None:
            cockpit.streamer.take(command, ms(10 * t))
    if before:
        cockpit.hears(100, FLYING)
    for t, altitude_m, ref in ((2000, 0.3, None), (2010, 0.6, STAY_UP)):
        cockpit.hears(t, LANDING, nd.NavdataState.COM_WATCHDOG, altitude_m=altitude_m)
        assert cockpit.ref(t) == ref


def test_a_drone_that_says_both_that_it_lands_and_that_it_does_not_fly_has_not_landed(cockpit: Cockpit) -> None:
    cockpit.streamer.take(Land(persistent=True), ms(0))
    demo = nd.Demo(LANDING.word, 50, 0.0, 0.0, 0.0, 100, 0.0, 0.0, 0.0)
    cockpit.streamer.on_navdata(nd.Navdata.of(0, 1, (demo,)), ms(1))
    assert cockpit.streamer.landing


def test_the_first_step_of_the_loop_takes_no_time_and_other_samples_say_nothing_to_it(cockpit: Cockpit) -> None:
    cockpit.hears(0, FLYING)
    cockpit.measures(0, 0.1)
    cockpit.streamer.on_sample(Baro(Stamp(ms(0), ms(0), 0.001, "synced"), 1.0, 0.5))
    cockpit.streamer.take(FORWARD, ms(0))
    _, wanted = step(RESET, FORWARD, np.array([0.1, 0.0, 0.0]), None, 0.0, cockpit.options)
    sticks = cockpit.sticks(0)
    assert (sticks.roll, sticks.pitch, sticks.gaz, sticks.yaw) == (wanted.roll, wanted.pitch, wanted.gaz, wanted.yaw)


def test_the_watchdog_is_counted_as_often_as_it_is_reset(cockpit: Cockpit) -> None:
    cockpit.hears(0, FLYING, nd.NavdataState.COM_WATCHDOG)
    assert cockpit.streamer.command(ms(1)).watchdog
    assert cockpit.streamer.command(ms(2)).watchdog
    cockpit.hears(3, FLYING)
    assert not cockpit.streamer.command(ms(4)).watchdog
    assert cockpit.counters.watchdog_resets == 2


def test_the_tilt_counts_while_it_is_recent(cockpit: Cockpit) -> None:
    def pitch(age_ms: float | None) -> float:
        flown = Cockpit()
        flown.hears(1000, FLYING)
        flown.measures(1000)
        flown.streamer.take(FORWARD, ms(1000))
        if age_ms is not None:
            flown.leans(1000 - age_ms, -0.2)
        return flown.sticks(1000).pitch

    assert pitch(0.0) == pitch(200.0) != pitch(None)
    assert pitch(200.001) == pitch(None)


def test_the_loop_steps_by_the_time_between_periods_and_begins_again_after_a_hover(cockpit: Cockpit) -> None:
    def flown(*instants_ms: float, hover_at: float | None = None) -> at.Pcmd:
        cockpit = Cockpit()
        sticks = HOVER
        for t in instants_ms:
            cockpit.hears(t, FLYING)
            cockpit.measures(t)
            cockpit.streamer.take(Hover() if t == hover_at else FORWARD, ms(t))
            sticks = cockpit.sticks(t)
        return sticks

    assert flown(0) == flown(1000)
    assert flown(0, 30) != flown(0), "the integral has grown"
    assert flown(0, 30) != flown(0, 60)
    assert flown(0, 30, 60, hover_at=30) == flown(0)
