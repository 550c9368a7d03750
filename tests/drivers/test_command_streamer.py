import numpy as np
import pytest

from drivers.ardrone import at
from drivers.ardrone import navdata as nd
from drivers.ardrone.arbiter import HOVER
from drivers.ardrone.custody import CommandStreamer
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.commands import Hover, Land, Lean, TakeOff, Velocity
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity
from estimator.contracts.time import MonoNs, Stamp
from tests.make import tuned

FLY = at.Ref(at.REF_BASE | at.REF_TAKE_OFF)
GROUND = at.Ref(at.REF_BASE)
FORWARD = Velocity(np.array([0.4, 0.0, 0.0]), 0.0)


def ms(t: float) -> MonoNs:
    return MonoNs(10_000_000_000 + round(t * 1_000_000))


class Cockpit:
    """A streamer and what it receives."""

    def __init__(self) -> None:
        self.options = tuned(ArDroneOptions, command_timeout_s=0.25, velocity_timeout_s=0.2, take_off_timeout_s=5.0)
        self.streamer = CommandStreamer(self.options)

    def hears(self, t: float, control: nd.ControlState | None, state: int = 0, altitude_m: float = 0.0) -> None:
        demo = {} if control is None else {"ctrl_state": control.word, "altitude_mm": round(1000 * altitude_m)}
        on_ground = control in (nd.ControlState.LANDED, nd.ControlState.INIT)
        self.streamer.on_navdata(nd.Navdata.of(state | (0 if on_ground else nd.NavdataState.FLYING), 1, **demo), ms(t))

    def measures(self, t: float, forward_m_s: float = 0.0) -> None:
        stamp = Stamp(ms(t), ms(t), 0.001, "synced")
        self.streamer.on_sample(BodyVelocity(stamp, np.array([forward_m_s, 0.0, 0.0]), np.diag([0.1, 0.1, UNKNOWN_VAR])))

    def stands(self, t: float, heading_rad: float = 0.0) -> None:
        attitude = Rotation.from_rpy(0.0, 0.0, heading_rad)
        self.streamer.on_sample(Attitude(Stamp(ms(t), ms(t), 0.001, "synced"), attitude, 1e-4 * np.eye(3)))

    def sends(self, t: float) -> list[at.AtCommand]:
        return self.streamer.command(ms(t)).commands()


@pytest.fixture
def cockpit() -> Cockpit:
    return Cockpit()


def test_before_any_word_of_the_drone_only_hover_is_sent(cockpit: Cockpit) -> None:
    """A REF to a drone that flies would have to guess its wish: without the bit it lands, with it one on the ground takes off."""
    cockpit.streamer.take(FORWARD, ms(0))
    assert cockpit.sends(0) == [HOVER]


def test_velocity_is_flown_by_the_sticks_and_hover_by_none(cockpit: Cockpit) -> None:
    cockpit.hears(0, nd.ControlState.HOVERING)
    cockpit.measures(0)
    cockpit.streamer.take(Velocity(np.array([0.4, 0.2, -0.5]), 0.5), ms(0))
    ref, sticks = cockpit.sends(1)
    assert ref == FLY
    assert sticks.flags == at.PCMD_PROGRESSIVE
    assert sticks.pitch < 0 < sticks.roll < -sticks.pitch
    assert sticks.gaz == pytest.approx(0.5 / cockpit.options.vz_max_m_s)
    assert sticks.yaw == pytest.approx(0.5 / cockpit.options.yaw_rate_max_rad_s)
    cockpit.streamer.take(Hover(), ms(2))
    assert cockpit.sends(3) == [FLY, HOVER]


def test_a_velocity_command_without_a_fresh_measurement_is_flown_as_hover(cockpit: Cockpit) -> None:
    cockpit.hears(0, nd.ControlState.FLYING)
    cockpit.streamer.take(FORWARD, ms(0))
    assert cockpit.sends(1)[1] == HOVER
    cockpit.measures(2)
    assert cockpit.sends(3)[1] != HOVER
    cockpit.streamer.take(FORWARD, ms(210))
    assert cockpit.sends(211)[-1] == HOVER


def test_a_climb_is_flown_without_a_fresh_measurement_by_the_tilt_that_holds_against_the_wind(cockpit: Cockpit) -> None:
    cockpit.hears(0, nd.ControlState.FLYING)
    for t in range(0, 2000, 20):
        cockpit.measures(t)
        cockpit.streamer.take(FORWARD, ms(t))
        cockpit.sends(t + 1)
    cockpit.streamer.take(Velocity(np.array([0.0, 0.0, -0.5]), 0.0), ms(2300))
    climbs = _sticks(cockpit, 2301)
    assert climbs.flags == at.PCMD_PROGRESSIVE
    assert climbs.gaz * cockpit.options.vz_max_m_s > 0.3, "a deck that rises comes up to a hover"
    assert climbs.pitch < 0.0
    assert abs(climbs.roll) < 0.05


@pytest.mark.parametrize(("altitude_m", "sent"), [(0.3, [FLY, HOVER]), (0.1, [HOVER])])
def test_whoever_ordered_a_landing_calls_it_off_unless_it_is_about_to_end(cockpit, altitude_m, sent):
    for t, ends in ((0, Hover(calls_off=True)), (1000, FORWARD)):
        cockpit.hears(t, nd.ControlState.FLYING)
        cockpit.streamer.take(Land(), ms(t + 1))
        landing_at(cockpit, t + 50, altitude_m)
        cockpit.streamer.take(Land(), ms(t + 51))
        assert cockpit.sends(t + 52) == [GROUND, HOVER]
        cockpit.streamer.take(ends, ms(t + 53))
        assert cockpit.sends(t + 54) == sent


@pytest.mark.parametrize(
    ("control", "command", "last"),
    [
        (nd.ControlState.HOVERING, FORWARD, [FLY, HOVER]),
        (nd.ControlState.FLYING, Land(), [GROUND, HOVER]),
        (nd.ControlState.LANDED, TakeOff(), [GROUND, HOVER]),
    ],
)
def test_the_last_word_is_hover_or_the_landing_commanded(cockpit, control, command, last):
    cockpit.hears(0, control)
    cockpit.streamer.take(command, ms(1))
    assert cockpit.streamer.leave(ms(2)).commands() == last


def landing_at(cockpit: Cockpit, t: int, altitude_m: float, state: int = 0) -> None:
    cockpit.hears(t, nd.ControlState.LANDING, state, altitude_m)


def test_a_landing_for_our_silence_is_called_off_when_we_are_back(cockpit: Cockpit) -> None:
    landing_at(cockpit, 0, 1.2, nd.NavdataState.COM_WATCHDOG)
    assert cockpit.sends(1) == [at.ComWdg(), FLY, HOVER]
    landing_at(cockpit, 5, 1.2)
    assert cockpit.sends(6) == [FLY, HOVER], "the bit is down, as we answered it, and the reason is remembered"


@pytest.mark.parametrize(("altitude_m", "flies", "called_off"), [(0.3, True, True), (0.3, False, False), (0.14, True, False)])
def test_guidance_that_flies_takes_the_drone_out_of_a_landing_for_our_silence_from_lower_down(
    cockpit: Cockpit, altitude_m: float, flies: bool, called_off: bool
) -> None:
    """WHY: after four silent seconds the drone was at 0.3 m, and landed 0.9 m beside the pad although guidance was back."""
    landing_at(cockpit, 0, altitude_m, nd.NavdataState.COM_WATCHDOG)
    cockpit.streamer.take(FORWARD if flies else Hover(), ms(1))
    assert (FLY in cockpit.sends(2)) is called_off


def test_a_word_ends_with_the_guidance_cycle_that_it_came_from(cockpit: Cockpit) -> None:
    """The period that repeats it does not make it younger; the sender flies hover 120 ms after guidance spoke last."""
    cockpit.options = ArDroneOptions()
    cockpit.streamer = CommandStreamer(cockpit.options)
    cockpit.hears(0, nd.ControlState.FLYING)
    cockpit.measures(0)
    cockpit.streamer.take(FORWARD, ms(0))
    assert cockpit.streamer.command(ms(90)).until == ms(120)
    cockpit.streamer.take(Hover(), ms(90))
    assert cockpit.streamer.command(ms(100)).until == ms(220)


LEAN = Lean(np.array([0.3, -0.2]), np.array([0.6, 0.1]), np.array([0.1, 0.0, 0.5]), 0.0)


def _sticks(cockpit: Cockpit, t: float) -> at.Pcmd:
    sticks = cockpit.sends(t)[-1]
    assert isinstance(sticks, at.Pcmd)
    return sticks


def test_a_tilt_is_flown_without_a_measured_velocity_but_not_without_an_attitude(cockpit: Cockpit) -> None:
    cockpit.hears(0, nd.ControlState.FLYING)
    cockpit.streamer.take(LEAN, ms(0))
    assert _sticks(cockpit, 1) == HOVER
    cockpit.stands(2)
    flown = _sticks(cockpit, 3)
    assert flown.pitch < 0.0 < -flown.roll + 0.2
    assert flown.gaz == pytest.approx(-0.5 / cockpit.options.vz_max_m_s)


def test_a_tilt_that_nobody_renews_is_flown_as_hover(cockpit: Cockpit) -> None:
    """Whatever a law requests, it ends with the law."""
    cockpit.hears(0, nd.ControlState.FLYING)
    cockpit.streamer.take(LEAN, ms(0))
    for t in (0, 100, 200, 300, 400):
        cockpit.stands(t)
        assert (_sticks(cockpit, t) == HOVER) is (t > 250), t
        assert cockpit.streamer.command(ms(t)).until <= ms(max(t, 250) + 250)


def test_the_tilt_against_the_wind_is_kept_over_a_hover_and_forgotten_on_the_ground(cockpit: Cockpit) -> None:
    cockpit.hears(0, nd.ControlState.FLYING)
    cockpit.stands(0)
    cockpit.streamer.take(LEAN, ms(0))
    _sticks(cockpit, 1)
    cockpit.streamer.take(Hover(), ms(10))
    assert _sticks(cockpit, 11) == HOVER
    still = Velocity(np.zeros(3), 0.0)
    for t in (200, 220):
        cockpit.stands(t)
        cockpit.measures(t)
        cockpit.streamer.take(still, ms(t))
        assert _sticks(cockpit, t + 1).pitch < -0.2
    cockpit.hears(300, nd.ControlState.LANDED)
    cockpit.hears(400, nd.ControlState.FLYING)
    cockpit.stands(401)
    cockpit.measures(401)
    cockpit.streamer.take(still, ms(401))
    assert _sticks(cockpit, 402).pitch == pytest.approx(0.0)


def test_a_datagram_without_the_control_state_leaves_the_one_before(cockpit: Cockpit) -> None:
    cockpit.hears(0, nd.ControlState.TAKING_OFF)
    cockpit.streamer.take(FORWARD, ms(0))
    cockpit.measures(0)
    cockpit.hears(1, None)
    assert cockpit.sends(2)[-1] == HOVER, "it is still taking off"
    cockpit.hears(3, nd.ControlState.HOVERING)
    assert cockpit.sends(4)[-1] != HOVER


def test_a_landing_that_guidance_renews_no_more_is_called_off_high_up_and_finished_low(cockpit: Cockpit) -> None:
    """The sender, which outlives the service, is told which landings are renewed."""
    for t, altitude_m, ends in ((0, 1.0, True), (2000, 0.4, False)):
        cockpit.hears(t, nd.ControlState.FLYING)
        cockpit.streamer.take(Land(), ms(t))
        landing_at(cockpit, t + 300, altitude_m)
        assert cockpit.streamer.command(ms(t + 300)).landing
        landing_at(cockpit, t + 600, altitude_m)
        assert (cockpit.sends(t + 600)[0] == FLY) is ends
