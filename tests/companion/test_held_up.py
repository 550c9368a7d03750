"""A deck that is met softly: going up faster than any command of late is a contact; a flight that answers late is none."""

import math

import numpy as np
import pytest
from msgspec import structs

from companion.base.mission import State
from companion.guidance.controller import Impact, Knowledge
from companion.guidance.mission.contact import ANSWERS_S, HELD_S, HeldUp
from companion.guidance.mission.cycle import GuidanceCycle
from companion.guidance.mission.machine import mission_step
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from tests.companion.mission_flights import PointFlight, guided, holding
from tests.make import estimate, ns

STEP_S = 0.02


def contacts(command: F64, speed: F64) -> list[float]:
    """Return the times of contacts, s, for vertical speeds commanded and flown, m/s down."""
    held, found = HeldUp(), []
    for k, (u, v) in enumerate(zip(command.tolist(), speed.tolist(), strict=True)):
        at, before = MonoNs(round(k * STEP_S * 1e9)), held.newest
        held = held.commanded(at, u).measured(at, v)
        if held.newest is not before and held.newest is not None:
            assert held.newest.by == "velocity"
            assert held.newest.held_m_s >= 0.3
            found.append(k * STEP_S)
    return found


def flown(command: F64, delay_s: float, lag_s: float, push_m_s: float = 0.0) -> F64:
    """Return the flight of a vehicle with delay and lag, with a disturbance besides."""
    v, out = float(command[0]), []
    for k in range(command.size):
        u = float(command[max(k - round(delay_s / STEP_S), 0)])
        v += (1.0 - math.exp(-STEP_S / lag_s)) * (u - v)
        out.append(v + push_m_s)
    return np.array(out)


def heave(seed: int, seconds: float = 60.0) -> F64:
    """Commands that follow a heaving deck down, with steps as at the begin of a commit."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, STEP_S)
    waves = np.zeros_like(t)
    for _ in range(3):
        waves += rng.uniform(0.1, 0.4) * np.sin(2.0 * math.pi * t / rng.uniform(4.0, 9.0) + rng.uniform(0.0, 6.3))
    steps = 0.45 * (np.floor(t / 3.0) % 2.0)
    return np.asarray(waves + steps)


@pytest.mark.parametrize(("delay_s", "lag_s"), [(0.14, 0.12), (0.28, 0.2), (0.12, 0.4)])
@pytest.mark.parametrize("seed", range(4))
def test_no_flight_over_a_heaving_deck_is_a_contact(seed: int, delay_s: float, lag_s: float) -> None:
    command = heave(seed)
    assert contacts(command, flown(command, delay_s, lag_s, push_m_s=-0.1)) == []


@pytest.mark.parametrize("deck_m_s", [-0.6, -0.3, 0.0])
def test_a_vehicle_that_goes_with_the_deck_against_its_commands_stands_on_it(deck_m_s: float) -> None:
    """A PX4 1.16.2 slowed down over 0.3 s, then was carried, while the command was 0.4 m/s more."""
    t = np.arange(0.0, 5.0, STEP_S)
    command = np.full(t.size, deck_m_s + 0.4)
    speed = flown(command, 0.14, 0.12)
    stood = np.clip((t - 3.0) / 0.3, 0.0, 1.0)
    found = contacts(command, (1.0 - stood) * speed + stood * deck_m_s)
    assert found
    assert 3.0 + HELD_S < found[0] < 3.7


def contacts_by_deck(command: F64, speed: F64, deck: F64) -> list[float]:
    """Return the times of contacts by the speeds to the deck, s."""
    held, by_deck, found = HeldUp(), HeldUp(), []
    for k, (u, v, d) in enumerate(zip(command.tolist(), speed.tolist(), deck.tolist(), strict=True)):
        at, before = MonoNs(round(k * STEP_S * 1e9)), by_deck.newest
        held = held.commanded(at, u)
        by_deck = by_deck.commanded(at, held.to_deck(at, d)).measured(at, v - d)
        if by_deck.newest is not before:
            found.append(k * STEP_S)
    return found


def test_a_deck_that_falls_faster_and_faster_is_felt_by_the_speeds_to_the_deck() -> None:
    """The least of the commands over the ground is then that of 0.7 s ago, which the deck has passed."""
    t = np.arange(0.0, 6.0, STEP_S)
    deck = -0.5 + 0.4 * np.maximum(t - 2.0, 0.0)
    command = deck + 0.4 * ANSWERS_S + 0.4
    stood = np.clip((t - 3.5) / 0.3, 0.0, 1.0)
    speed = (1.0 - stood) * flown(command, 0.14, 0.12) + stood * deck
    assert contacts(command, speed) == []
    found = contacts_by_deck(command, speed, deck)
    assert found
    assert 3.5 + HELD_S < found[0] < 4.2


@pytest.mark.parametrize(("delay_s", "lag_s"), [(0.14, 0.12), (0.28, 0.2), (0.1, 0.1)])
@pytest.mark.parametrize("seed", range(4))
def test_no_flight_is_a_contact_by_the_speeds_to_the_deck(seed: int, delay_s: float, lag_s: float) -> None:
    """Commands lead the deck by the vehicle's answer, as the law's do; ground effect holds up, the deck's speed is uncertain."""
    whole = heave(seed)
    deck = whole - 0.45 * (np.floor(np.arange(whole.size) * STEP_S / 3.0) % 2.0)
    ahead = round((delay_s + lag_s) / STEP_S)
    command = np.concatenate((deck[ahead:], np.full(ahead, deck[-1]))) + (whole - deck)
    speed = flown(command, delay_s, lag_s, push_m_s=-0.1)
    assert contacts_by_deck(command, speed, deck + 0.05) == contacts_by_deck(command, speed, deck - 0.05) == []


def test_to_the_deck_counts_the_command_that_is_answered_now() -> None:
    held = remembered((0, 0.1), (100, 0.2), (300, 0.5))
    assert held.to_deck(at_ms(299.9), 0.3) is None
    assert held.to_deck(at_ms(399.9), 0.3) == pytest.approx(-0.2)
    assert held.to_deck(at_ms(400), 0.3) == pytest.approx(-0.1)
    assert held.to_deck(at_ms(400), None) is None


def test_nothing_is_found_before_a_command_had_its_time_to_be_flown() -> None:
    command = np.full(30, 0.5)
    assert contacts(command, np.zeros(30)) == []
    held = HeldUp()
    for k in range(100):
        at = MonoNs(round(k * STEP_S * 1e9))
        held = held.commanded(at, None if k == 80 else 0.5).measured(at, 0.5 if k < 81 else 0.0)
    assert held.newest is None, "a person's order in between begins anew"


def at_ms(ms: float) -> MonoNs:
    return MonoNs(round(ms * 1e6))


def remembered(*commands: tuple[float, float]) -> HeldUp:
    """Return the memory after commands, each at an instant in ms, of m/s down."""
    held = HeldUp()
    for ms, down_m_s in commands:
        held = held.commanded(at_ms(ms), down_m_s)
    return held


def test_commands_are_remembered_for_seven_tenths_of_a_second_and_the_one_that_was_flown_then() -> None:
    held = remembered((0, 0.1), (100, 0.2), (200, 0.3), (300, 0.4), (900, 0.5))
    assert held.commands == tuple((at_ms(ms), v) for ms, v in ((100, 0.2), (200, 0.3), (300, 0.4), (900, 0.5)))
    assert remembered((0, 0.1), (100, 0.2), (800, 0.3)).commands[0] == (0, 0.1)
    assert remembered((0, 0.1), (100, 0.2), (800.001, 0.3)).commands[0] == (at_ms(100), 0.2)
    assert remembered((0, 0.1), (100, 0.2), (200, 0.3), (5000, 0.4)).commands == ((at_ms(200), 0.3), (at_ms(5000), 0.4))
    assert remembered((0, 0.1), (5000, 0.2)).commands == ((0, 0.1), (at_ms(5000), 0.2)), "it was flown when the window began"


@pytest.mark.parametrize(
    ("ms", "faster_m_s", "holds"), [(699.9, 0.4, False), (700, 0.4, True), (800, 0.3, True), (800, 0.29, False)]
)
def test_a_vehicle_is_held_up_by_three_tenths_against_the_least_of_commands_that_had_their_time(ms, faster_m_s, holds):
    held = remembered((0, 0.5), (100, 0.3), (200, 0.7))
    after = held.measured(at_ms(ms), 0.3 - faster_m_s)
    assert after.since == (at_ms(ms) if holds else None)
    assert after.newest is None
    assert after.measured(at_ms(ms + 1), 0.3).since is None, "it ends when the vehicle follows again"


@pytest.mark.parametrize(("held_ms", "found"), [(249.9, False), (250, True)])
def test_it_is_a_contact_after_a_quarter_of_a_second(held_ms: float, found: bool) -> None:
    first = remembered((0, 0.5)).measured(at_ms(1000), -0.5)
    last = first.measured(at_ms(1000 + held_ms), 0.1)
    assert last.since == at_ms(1000), "it began with the first"
    assert last.newest == (Impact(at_ms(1250), "velocity", held_m_s=0.4) if found else None)
    assert last.commanded(at_ms(1300), 0.5).newest is last.newest
    assert last.commanded(at_ms(1300), None) == HeldUp(newest=last.newest)


@pytest.mark.parametrize(
    ("height_m", "age_s", "by", "state"),
    [
        (0.05, 0.0, "velocity", State.PRESS),
        (0.28, 0.0, "velocity", State.COMMIT),
        (0.05, 0.6, "velocity", State.COMMIT),
        (0.28, 0.1, "accelerometer", State.PRESS),
        (0.28, 0.0, "accelerometer", State.COMMIT),
    ],
)
def test_being_held_up_is_a_contact_near_the_deck_alone_and_while_it_lasts(height_m, age_s, by, state):
    """An updraft holds a vehicle up as well, and the motors stop by force after a contact."""
    o = guided("cone")
    began, t = 1.0, 2.0
    progress = structs.replace(PointFlight([0.0, 0.0, height_m], o).progress, state=State.COMMIT, since=ns(began))
    seen = estimate(t, [0.0, 0.0, height_m])
    s = GuidanceCycle(ns(t), Knowledge(ns(t), seen, impact=Impact(ns(t - age_s), by, 9.0)))
    after, _, _ = mission_step(progress, holding(s, True), o)
    assert after.state is state
