"""Landings, take-offs and final messages of the setpoint streamer: what is sent, for how long, and what ends it."""

import numpy as np
import pytest

from drivers.mavlink.custody import Hand
from drivers.mavlink.dialect import Message
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.setpoint_streamer import SetpointStreamer
from drivers.mavlink.vehicle import Condition, Identity, Stack
from estimator.contracts.commands import Command, CutMotors, Hover, Land, LeaveEmergency, TakeOff, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from tests.drivers.mavlink.test_setpoint_streamer import GO, modes, stops, velocities

GUIDED, LAND, BRAKE = (4, 0), (9, 0), (17, 0)
OFFBOARD, LOITER, AUTO_LAND = (6, 0), (4, 3), (4, 6)


def ms(t: float) -> MonoNs:
    return MonoNs(50_000_000_000 + round(t * 1_000_000))


class Flight:
    """A helm, with a heading of north at every period unless it is `blind`."""

    def __init__(self, stack: Stack = Stack.ARDUPILOT, mode: str = "loiter", **options: object) -> None:
        self.streamer = SetpointStreamer(Identity(7, 1, stack, 2), AutopilotOptions("udpin://127.0.0.1:0", **options))  # type: ignore[arg-type]
        self.told(mode)

    def told(self, mode: str, *, flying: bool | None = True, armed: bool | None = True) -> None:
        self.streamer.on_condition(Condition(mode, armed, flying))

    def take(self, command: Command, t: float, way: F64 | None = None) -> None:
        self.streamer.take(command, ms(t), way)

    def sends(
        self, t: float, *, blind: bool = False
    ) -> tuple[list[tuple[float, float, float, float]], list[tuple[float, float]]]:
        """Return the velocities and modes of one period."""
        if not blind:
            self.streamer.on_attitude(Attitude(Stamp(ms(t), ms(t), 0.001, "synced"), Rotation.identity(), 1e-4 * np.eye(3)))
        return said(self.streamer.period(ms(t)))


def said(messages: list[Message]) -> tuple[list[tuple[float, float, float, float]], list[tuple[float, float]]]:
    return velocities(messages), modes(messages)


STILL = (0.0, 0.0, 0.0, 0.0)


def ours(stack: Stack = Stack.ARDUPILOT, way: F64 | None = None, **options: object) -> Flight:
    """Steered since 0 ms and in the velocity mode."""
    flight = Flight(stack, "loiter" if stack is Stack.ARDUPILOT else "offboard", **options)
    flight.take(GO, 0, way)
    flight.sends(0)
    flight.told("guided" if stack is Stack.ARDUPILOT else "offboard")
    assert flight.streamer.hand is Hand.OURS
    return flight


@pytest.mark.parametrize(("flying", "hand"), [(True, Hand.TAKING), (None, Hand.TAKING), (False, Hand.NOBODY)])
def test_it_takes_no_vehicle_that_stands(flying: bool | None, hand: Hand) -> None:
    flight = Flight()
    flight.told("loiter", flying=flying)
    flight.take(GO, 0)
    assert flight.streamer.hand is hand
    other = Flight(Stack.OTHER)
    other.take(GO, 0)
    assert other.streamer.hand is Hand.NOBODY, "nor one whose velocity mode is not known"


def test_on_the_ground_it_is_over_unless_it_is_about_to_take_off() -> None:
    flight = ours()
    flight.told("guided", flying=None)
    assert flight.streamer.hand is Hand.OURS
    flight.told("guided", flying=False, armed=True)
    assert flight.streamer.hand is Hand.OURS, "an armed vehicle whose setpoints end takes that for a failure"
    flight.told("guided", flying=False, armed=False)
    assert flight.streamer.hand is Hand.NOBODY


def sinking(t: float = 0, **options: object) -> Flight:
    """Return a landing by velocity since `t`, over a deck that makes 1 m/s ahead, two metres below its origin's height."""
    flight = Flight(Stack.PX4, "offboard", **options)
    flight.take(Velocity(np.array([1.0, 0.5, 0.25]), 0.1), t)
    flight.told("offboard")
    flight.streamer.on_position(-2.0)
    flight.take(Land(), t)
    return flight


DOWN, LEVEL = (1.0, 0.5, 0.4, 0.0), (1.0, 0.5, 0.0, 0.0)


def test_a_landing_by_velocity_sinks_while_it_is_requested_then_holds_then_ends() -> None:
    flight = sinking()
    said_at = [flight.sends(t) for t in (0, 500, 500.001, 600, 3000, 3000.001, 6000, 6000.001)]
    assert said_at == [([v], []) for v in (DOWN, DOWN, LEVEL, LEVEL, LEVEL, STILL, STILL)] + [([STILL], [LOITER])]
    assert flight.streamer.hand is Hand.HOLDING


def test_a_landing_by_velocity_ends_by_its_time() -> None:
    flight = sinking()
    for t in range(400, 15_001, 400):
        flight.take(Land(), t)
        assert flight.sends(t)[0] == [DOWN]
    flight.take(Land(), 15_000)
    assert flight.sends(15_000)[0] == [DOWN]
    assert flight.sends(15_000.001)[0] == [LEVEL]
    flight.take(Land(), 15_100)
    assert flight.sends(15_100)[0] == [LEVEL], "though it is asked for"
    flight.take(Hover(), 15_200)
    assert flight.streamer.hand is Hand.TAKING
    flight.told("offboard")
    flight.take(Land(), 15_300)
    assert flight.sends(15_300)[0] == [DOWN], "another one is another one"


def test_a_persons_landing_by_velocity_becomes_the_autopilots_own_after_its_time() -> None:
    """It sank for ever."""
    flight = sinking()
    flight.take(Land(persistent=True), 1_000)
    flight.streamer.on_position(5.0)
    assert flight.sends(16_000) == ([DOWN], []), "not renewed, and from any height"
    assert flight.sends(16_000.001) == ([], [AUTO_LAND])
    assert flight.sends(16_500) == ([], [])
    assert flight.sends(17_001) == ([], [AUTO_LAND]), "asked for again until it has come about"
    flight.told("auto.land")
    assert flight.sends(60_000) == ([], [])
    assert flight.streamer.hand is Hand.LANDING
    assert flight.streamer.leave(ms(60_000)) == []


def test_a_person_may_order_the_landing_that_guidance_has_under_way_or_has_used_up() -> None:
    flight = sinking()
    flight.take(Land(persistent=True), 100)
    flight.take(Land(), 200)
    assert flight.sends(5_000)[0] == [DOWN], "guidance's own asking makes it no less a person's"
    spent = sinking()
    spent.streamer.on_position(1.001)
    assert spent.sends(100)[0] == [LEVEL]
    spent.take(Land(persistent=True), 200)
    assert spent.sends(5_000)[0] == [DOWN]


@pytest.mark.parametrize(("down_m", "v"), [(1.0, DOWN), (1.001, LEVEL), (-9.0, DOWN)])
def test_a_landing_by_velocity_ends_by_its_depth(down_m: float, v: tuple[float, ...]) -> None:
    flight = sinking()
    flight.streamer.on_position(down_m)
    assert flight.sends(100)[0] == [v]


def test_a_landing_by_mode_is_requested_until_it_has_come_about_and_called_off_when_it_is_not_renewed() -> None:
    flight = ours()
    for t in (100, 600, 1099, 1100):
        flight.take(Land(), t)
        assert flight.sends(t) == ([], [LAND] if t in (100, 1100) else [])
    flight.told("land")
    assert flight.sends(1600) == ([], [])
    assert flight.sends(1600.001) == ([STILL], [GUIDED])
    assert flight.streamer.hand is Hand.TAKING


@pytest.mark.parametrize(
    ("stack", "landing", "lands_by_velocity"),
    [
        (Stack.PX4, "by stack", True), (Stack.ARDUPILOT, "by stack", False), (Stack.PX4, "mode", False),
        (Stack.ARDUPILOT, "velocity", True), (Stack.PX4, "velocity", True),
    ],
)  # fmt: skip
def test_how_it_lands_is_chosen_by_option_or_stack(stack: Stack, landing: str, lands_by_velocity: bool) -> None:
    flight = ours(stack, landing=landing)
    flight.take(Land(), 100)
    v, modes = flight.sends(100)
    assert (bool(v), bool(modes)) == (lands_by_velocity, not lands_by_velocity)
    other = Flight(stack, "stabilize", landing=landing)
    other.take(Land(), 100)
    assert other.sends(100)[1] == [LAND if stack is Stack.ARDUPILOT else AUTO_LAND], "out of another mode always by its own"


@pytest.mark.parametrize(("landing", "expected"), [("mode", ([STILL], [BRAKE])), ("velocity", ([STILL], []))])
def test_the_last_word_of_a_landing_nobody_renews_is_to_hold(landing: str, expected: object) -> None:
    flight = ours(landing=landing)
    flight.take(Land(), 100)
    flight.sends(100)
    assert said(flight.streamer.leave(ms(110))) == expected
    person = ours(landing=landing)
    person.take(Land(persistent=True), 100)
    person.sends(100)
    assert said(person.streamer.leave(ms(110))) == ([], [LAND] if landing == "velocity" else [])


def test_the_last_word_is_to_stand_still_where_the_vehicle_is_ours() -> None:
    assert said(ours().streamer.leave(ms(10))) == ([STILL], [])
    assert said(ours(Stack.PX4).streamer.leave(ms(10))) == ([STILL], [LOITER])
    released = ours()
    released.told("loiter")
    assert released.streamer.leave(ms(10)) == []
    taking = Flight()
    taking.take(GO, 0)
    taking.sends(0)
    assert said(taking.streamer.leave(ms(10))) == ([STILL], [])


# A landing by mode, on deck, the motors, and a person during a take-off


def standing(armed: bool | None = True) -> Flight:
    """Return a streamer on the deck after a landing with a felt contact, at 1000 ms."""
    flight = sinking(900)
    flight.take(Land(on_deck=True), 1000)
    flight.told("offboard", armed=armed)
    assert flight.streamer.hand is Hand.STANDING
    return flight


FORCED, ASKED = (0.0, 21196.0), (0.0, 0.0)


@pytest.mark.parametrize(
    ("armed", "t", "last"), [(True, 1100, [FORCED]), (None, 1100, [FORCED]), (True, 1300, [ASKED]), (False, 1100, [])]
)
def test_the_last_word_on_deck_is_to_stop_the_motors_that_still_turn(armed: bool | None, t: float, last: list[object]) -> None:
    assert stops(standing(armed).streamer.leave(ms(t))) == last


def test_a_cut_waits_for_no_other_request_and_is_repeated_until_it_is_reported() -> None:
    for before, t in ((Land(), 100), (Land(on_deck=True), 101)):
        flight = ours()
        flight.take(before, t)
        flight.sends(t)
        flight.take(CutMotors(), t + 1)
        assert stops(flight.streamer.period(ms(t + 1))) == [FORCED]
    sent = 0
    for t in range(200, 20_000, 100):
        flight.take(Land(persistent=True), t)
        flight.take(TakeOff(), t)
        sent += len(stops(flight.streamer.period(ms(t))))
    assert sent > 30
    flight.told("guided", flying=False, armed=False)
    assert flight.streamer.motors_cut
    flight.take(TakeOff(), 20_000)
    assert flight.streamer.period(ms(20_000)) == [] == flight.streamer.leave(ms(20_000))
    flight.take(LeaveEmergency(), 20_100)
    flight.take(TakeOff(), 20_200)
    assert stops(flight.streamer.period(ms(20_200))) == [(1.0, 0.0)]


def test_a_report_from_before_the_cut_ends_no_cut() -> None:
    """The motors were commanded to arm, and the newest HEARTBEAT knows nothing of it."""
    flight = Flight(mode="guided")
    flight.told("guided", flying=False, armed=False)
    flight.take(TakeOff(), 0)
    assert stops(flight.streamer.period(ms(0))) == [(1.0, 0.0)]
    flight.take(CutMotors(), 40)
    for t in (40, 240, 440):
        assert stops(flight.streamer.period(ms(t))) == [FORCED]
        flight.told("guided", flying=False, armed=False)
    flight.streamer.period(ms(640))
    flight.told("guided", flying=False, armed=False)
    assert stops(flight.streamer.period(ms(840))) == []


@pytest.mark.parametrize("stack", [Stack.ARDUPILOT, Stack.PX4])
def test_what_was_flown_is_held_once_when_it_is_unclear_who_is_the_autopilot(stack: Stack) -> None:
    flight = ours(stack)
    held = said(flight.streamer.suspend(ms(40)))
    assert held == ([STILL], [LOITER] if stack is Stack.PX4 else [])
    assert flight.streamer.hand is Hand.HOLDING
    flight.take(GO, 80)
    assert flight.streamer.hand is Hand.TAKING, "guidance has it again when it is clear"
    taken = ours(stack)
    taken.told("poshold" if stack is Stack.ARDUPILOT else "posctl")
    assert taken.streamer.suspend(ms(40)) == []
