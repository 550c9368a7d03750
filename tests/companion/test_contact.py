"""A contact: a step of the accelerometer, or going up faster than any command of late; found on a deck, and in no flight."""

import math

import numpy as np
import pytest
from msgspec import structs

from companion.base.mission import Event, Reason, ReasonCause, State
from companion.guidance.controller import Impact, Knowledge
from companion.guidance.mission.contact import ENOUGH, ContactWatch, reason_of, votes, watched
from companion.guidance.mission.contact import way_s as contact_way_s
from companion.guidance.mission.held_up import HELD_S, HeldUp
from companion.guidance.mission.machine import mission_step, take_order
from companion.guidance.mission.progress import GuidanceCycle, Progress
from companion.guidance.mission.wind import WindOverDrone
from companion.settings.guidance import GuidanceOptions
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from tests.make import estimate, imu, ns

STEP_S, HELD_STEP_S, OPTIONS = 0.005, 0.02, GuidanceOptions()


def watch_forces(up: F64) -> list[float]:
    """Return the times, s, of the contacts that an upward specific force shows."""
    watch, found = ContactWatch(), []
    for k, force in enumerate(up.tolist()):
        before = watch.newest
        watch = felt(watch, 1e3 * STEP_S * k, force)
        if watch.newest is not before:
            found.append(watch.newest.at * 1e-9)
    return found


def flight_force(seconds: float, seed: int = 0) -> F64:
    """Upward specific force of a flight: vibration, gusts, climbs that are begun and ended as quickly as rotors can."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, STEP_S)
    steps = 1.5 * np.sign(np.sin(2.0 * t))
    lagging = np.zeros_like(t)
    for k in range(1, len(t)):
        lagging[k] = lagging[k - 1] + STEP_S / 0.05 * (steps[k] - lagging[k - 1])
    return np.asarray(9.81 + 0.3 * np.sin(1.3 * t) + lagging + 0.25 * rng.standard_normal(t.size))


@pytest.mark.hazard("H4")
@pytest.mark.parametrize("seed", range(3))
def test_no_flight_is_a_contact(seed: int) -> None:
    assert watch_forces(flight_force(60.0, seed)) == []


@pytest.mark.parametrize("speed_m_s", [0.2, 0.45, 0.8])
def test_feet_on_a_deck_are_one_contact_within_a_twentieth_of_a_second(speed_m_s: float) -> None:
    """Feet of 6000 N/m under 1.5 kg take the speed away within a quarter of their period, and give a little of it back."""
    up, w = flight_force(4.0), math.sqrt(6000.0 / 1.477)
    for k in range(up.size):
        t = k * STEP_S - 3.0
        if t >= 0.0:
            up[k] += speed_m_s * w * math.exp(-0.7 * w * t) * math.cos(w * t)
    found = watch_forces(up)
    assert len(found) == 1
    assert 3.0 <= found[0] <= 3.05


def test_a_sensor_that_jumps_to_another_bias_for_good_is_at_most_one_contact() -> None:
    up = flight_force(6.0)
    up[600:] += 4.0
    assert len(watch_forces(up)) <= 1


def test_samples_after_a_gap_begin_again() -> None:
    watch = ContactWatch()
    for ms, force in ((0, 9.81), (5, 9.81), (2000, 40.0), (2005, 40.0)):
        watch = felt(watch, ms, force)
    assert watch.newest is None


def felt(watch: ContactWatch, ms: float, up: float) -> ContactWatch:
    """Return the memory after an upward specific force, m/s^2, at an instant in ms."""
    return watched(watch, imu(1e-3 * ms, f=(0.0, 0.0, -up)))


def test_of_quick_samples_one_alone_is_in_doubt_and_two_are_a_contact() -> None:
    pushed = felt(felt(ContactWatch(), 100.0, 9.0), 105.0, 50.0)
    assert pushed.newest is None
    assert felt(pushed, 110.0, 40.0).newest == Impact(MonoNs(110_000_000), "accelerometer", 41.0)
    assert felt(pushed, 110.0, 9.2).newest == Impact(MonoNs(105_000_000), "accelerometer", 41.0, doubtful=True)


@pytest.mark.parametrize(("after_ms", "told"), [(300, False), (300.1, True)])
def test_a_contact_s_rebounds_are_none_for_three_tenths(after_ms: float, told: bool) -> None:
    watch = felt(felt(ContactWatch(), 0.0, 9.0), 20.0, 30.0)
    first = watch.newest
    assert first is not None
    for ms in (50.0, 150.0, 250.0, 20.0 + after_ms - 20.0):
        watch = felt(watch, ms, 9.0)
    watch = felt(watch, 20.0 + after_ms, 30.0)
    assert (watch.newest is not first) is told


@pytest.mark.parametrize(("turns", "touches"), [("a step", True), ("a command", False), ("noise", False)])
def test_a_foot_that_the_deck_holds_turns_the_body_at_once_and_no_flight_does(turns: str, touches: bool) -> None:
    """Traced: 33 degrees a second within two samples, 0.25 s before anything else showed the contact."""
    rng, watch, turn_rad_s = np.random.default_rng(3), ContactWatch(), 0.0
    for k in range(300):
        wanted = 0.55 * (k >= 200)
        if turns == "a step":
            turn_rad_s = wanted
        elif turns == "a command":
            turn_rad_s += 0.01 / 0.3 * (wanted - turn_rad_s)
        else:
            turn_rad_s = 0.05 * rng.standard_normal()
        watch = watched(watch, imu(0.01 * k, w=(0.0, 0.0, turn_rad_s), f=(0.0, 0.0, -9.81 + 0.1 * rng.standard_normal())))
    assert (watch.touch is not None) is touches
    assert watch.newest is None, "in doubt by itself"
    if watch.touch is not None:
        assert watch.touch.doubtful
        assert reason_of(watch.touch).text.startswith("contact: the deck holds a foot, it turned by")


def test_an_accelerometer_that_repeats_itself_feels_nothing_and_a_live_one_does() -> None:
    live = ContactWatch()
    for k in range(200):
        live = felt(live, 5.0 * k, 9.8 + 0.01 * (k % 3))
        assert live.feels
    dead = live
    for k in range(200, 231):
        dead = felt(dead, 5.0 * k, 9.8)
    assert not dead.feels
    assert felt(dead, 1160.0, 9.81).feels


def test_a_spike_and_one_push_of_many_are_in_doubt() -> None:
    first = felt(ContactWatch(), 0.0, 9.0)
    spike = felt(first, 11.0, 209.0).newest
    assert spike.doubtful, "no landing takes 2.2 m/s away at once"
    watch = felt(felt(first, 11.0, 30.0), 20.0, 9.0)
    assert not watch.newest.doubtful
    for ms in range(120, 1000, 100):
        watch = felt(watch, float(ms), 9.0)
    again = felt(watch, 935.0, 30.0).newest
    assert again is not watch.newest
    assert again.doubtful


GUST = WindOverDrone(3.0, 0.5, 12.0, (1.0, 0.0), 0.1, False, begins_m_s=3.9, begins_most_m_s=3.4)
FIRM, FAINT = Impact(ns(9.9), "accelerometer", 9.0), Impact(ns(9.9), "accelerometer", 300.0, doubtful=True)


@pytest.mark.hazard("H4")
@pytest.mark.parametrize(
    ("feet_m", "down_m_s", "felt_by", "more", "contact"),
    [
        (0.02, 0.4, FIRM, {}, True), (0.1, 0.4, FIRM, {}, True), (0.2, 0.4, FIRM, {}, False), (0.2, 0.0, FIRM, {}, True),
        (0.2, 0.4, FAINT, {}, False), (0.08, 0.4, FAINT, {}, False), (0.02, 0.4, FAINT, {}, True),
        (0.02, 0.4, FIRM, {"feels": False}, True), (0.1, 0.4, FIRM, {"feels": False}, False),
        (-0.04, 0.0, None, {}, False), (-0.1, 0.4, None, {}, False), (-0.1, 0.0, None, {}, True), (-0.4, 0.0, None, {}, False),
        (-0.1, 0.4, None, {"feels": False}, True), (0.02, 0.4, None, {"feels": False}, False),
        (0.02, 0.0, None, {"feels": False}, True), (0.02, 0.4, None, {"feels": False, "range_m": 0.1}, True),
        (0.1, 0.4, FIRM, {"range_m": 0.5}, False), (0.02, 0.4, FIRM, {"range_m": 0.5}, True),
        (0.2, 0.4, Impact(ns(9.9), "velocity", held_m_s=0.5), {"range_m": 0.1}, True),
        (0.02, 0.0, None, {"wind": GUST}, True), (0.02, 0.4, None, {"wind": GUST}, False),
        (0.2, 0.0, None, {"wind": GUST}, False), (0.02, 0.0, None, {"wind": GUST._replace(begins_most_m_s=4.0)}, False),
    ],
)  # fmt: skip
def test_a_contact_is_a_vote_in_which_no_lone_witness_in_doubt_decides(feet_m, down_m_s, felt_by, more, contact):
    for age_s in (0.0, 1.0):
        seen = estimate(10.0, (0.0, 0.0, feet_m + OPTIONS.cone.feet_below_m), (0.0, 0.0, -down_m_s), age=age_s)
        s = GuidanceCycle(ns(10.0), Knowledge(ns(10.0), seen, impact=felt_by), **more)
        assert (votes(s, felt_by, OPTIONS, 1.0) >= ENOUGH) is contact, "the estimate counts for as long as the commit flies by it"


@pytest.mark.parametrize(
    ("feet_m", "more", "age_s", "way_s"),
    [
        (0.2, {}, 0.0, 0.5), (0.2, {}, 1.4, 0.5), (0.2, {}, 1.6, 0.0), (0.02, {}, 0.0, 0.0), (0.2, {"range_m": 0.1}, 0.0, 0.0),
        (0.2, {"range_m": 0.5}, 0.0, 0.5), (-0.4, {}, 0.0, 0.0),
    ],
)  # fmt: skip
def test_the_way_that_is_left_at_a_contact_is_that_of_the_height_that_contradicts_it(feet_m, more, age_s, way_s):
    seen = estimate(10.0, (0.0, 0.0, feet_m + OPTIONS.cone.feet_below_m), age=age_s)
    assert contact_way_s(GuidanceCycle(ns(10.0), Knowledge(ns(10.0), seen), **more), OPTIONS) == pytest.approx(way_s)


def test_what_is_not_known_has_no_vote() -> None:
    for seen in (None, estimate(10.0, (0.0, 0.0, 1.0), consistent=False), estimate(10.0, (0.0, 0.0, 1.0), sigma=0.2)):
        s = GuidanceCycle(ns(10.0), Knowledge(ns(10.0), seen))
        assert [votes(s, felt, OPTIONS, 1.0) for felt in (FIRM, FAINT, None)] == [1.0, 0.5, -0.5]


def test_one_foot_that_touches_is_a_contact_only_at_the_deck() -> None:
    """WHAT: the push of a foot in simulation: 7 m/s^2 that fall off within 20 ms, below what a deck under all feet takes away."""
    up = flight_force(4.0)
    for k, push in enumerate((7.0, 5.2, 3.7)):
        up[600 + k] += push
    watch = ContactWatch()
    for k, force in enumerate(up.tolist()):
        watch = felt(watch, 5.0 * k, force)
    assert watch.newest is None or watch.newest.doubtful
    assert watch.touch is not None
    for feet_m, is_contact in ((0.04, True), (0.1, False)):
        height_m = OPTIONS.cone.feet_below_m + feet_m
        s = GuidanceCycle(ns(9.0), Knowledge(ns(9.0), estimate(9.0, (0.0, 0.0, height_m), v=(0.0, 0.0, 0.4))))
        assert (votes(s, watch.touch, OPTIONS, 0.5) >= ENOUGH) is is_contact


# Held up: a deck that is met softly


def contacts(command: F64, speed: F64, deck: F64 | None = None) -> list[float]:
    """Return the times of contacts, s, for vertical speeds commanded and flown, m/s down; by those to a deck if there is one."""
    held, by_deck, found = HeldUp(), HeldUp(), []
    for k, (u, v, d) in enumerate(zip(command.tolist(), speed.tolist(), (speed if deck is None else deck).tolist(), strict=True)):
        at, before = ns(k * HELD_STEP_S), (held if deck is None else by_deck).newest
        held = held.commanded(at, u)
        if deck is None:
            held = held.measured(at, v)
        else:
            by_deck = by_deck.commanded(at, held.to_deck(at, d)).measured(at, v - d)
        newest = (held if deck is None else by_deck).newest
        if newest is not before and newest is not None:
            assert newest.by == "velocity"
            assert newest.held_m_s >= 0.3
            found.append(k * HELD_STEP_S)
    return found


def answered(command: F64, delay_s: float, lag_s: float, push_m_s: float = 0.0) -> F64:
    """Return the flight of a vehicle with delay and lag, with a disturbance besides."""
    v, out = float(command[0]), []
    for k in range(command.size):
        u = float(command[max(k - round(delay_s / HELD_STEP_S), 0)])
        v += (1.0 - math.exp(-HELD_STEP_S / lag_s)) * (u - v)
        out.append(v + push_m_s)
    return np.array(out)


def heave(seed: int, seconds: float = 60.0) -> F64:
    """Commands that follow a heaving deck down, with steps as at the begin of a commit."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, HELD_STEP_S)
    waves = np.zeros_like(t)
    for _ in range(3):
        waves += rng.uniform(0.1, 0.4) * np.sin(2.0 * math.pi * t / rng.uniform(4.0, 9.0) + rng.uniform(0.0, 6.3))
    steps = 0.45 * (np.floor(t / 3.0) % 2.0)
    return np.asarray(waves + steps)


@pytest.mark.parametrize("deck_m_s", [-0.6, -0.3, 0.0])
def test_a_vehicle_that_goes_with_the_deck_against_its_commands_stands_on_it(deck_m_s: float) -> None:
    """A PX4 1.16.2 slowed down over 0.3 s, then was carried, while the command was 0.4 m/s more."""
    t = np.arange(0.0, 5.0, HELD_STEP_S)
    command = np.full(t.size, deck_m_s + 0.4)
    speed = answered(command, 0.14, 0.12)
    stood = np.clip((t - 3.0) / 0.3, 0.0, 1.0)
    found = contacts(command, (1.0 - stood) * speed + stood * deck_m_s)
    assert 3.0 + HELD_S < found[0] < 3.7


@pytest.mark.parametrize(("delay_s", "lag_s"), [(0.14, 0.12), (0.28, 0.2), (0.1, 0.1), (0.12, 0.4)])
@pytest.mark.parametrize("seed", range(4))
def test_no_flight_over_a_heaving_deck_is_a_contact_by_the_speeds_over_the_ground_or_to_it(seed, delay_s, lag_s):
    """Commands lead the deck by the vehicle's answer, as the law's do; ground effect holds up, the deck's speed is uncertain."""
    whole = heave(seed)
    assert contacts(whole, answered(whole, delay_s, lag_s, push_m_s=-0.1)) == []
    deck = whole - 0.45 * (np.floor(np.arange(whole.size) * HELD_STEP_S / 3.0) % 2.0)
    ahead = round((delay_s + lag_s) / HELD_STEP_S)
    command = np.concatenate((deck[ahead:], np.full(ahead, deck[-1]))) + (whole - deck)
    speed = answered(command, delay_s, lag_s, push_m_s=-0.1)
    assert contacts(command, speed, deck + 0.05) == contacts(command, speed, deck - 0.05) == []


def test_nothing_is_found_before_a_command_had_its_time_to_be_answered() -> None:
    command = np.full(30, 0.5)
    assert contacts(command, np.zeros(30)) == []
    held = HeldUp()
    for k in range(100):
        at = ns(k * HELD_STEP_S)
        held = held.commanded(at, None if k == 80 else 0.5).measured(at, 0.5 if k < 81 else 0.0)
    assert held.newest is None, "a person's order in between begins anew"


def touch_in(commits: list[tuple[float, bool, float]]) -> tuple[Progress, list[Reason]]:
    """Return the memory after commits, each with the height of the feet at a touch, whether that is in doubt and the sight's age.

    A climb comes between two of them.
    """
    p, t, ended = Progress(State.COMMIT, automatic=False, begun=True, stood=False, since=ns(0.0)), 0.0, []
    for feet_m, doubtful, age_s in commits:
        t += 20.0
        p = structs.replace(p, state=State.COMMIT, since=ns(t), kept=None)
        for k in range(1, 6):
            at = t + 0.1 * k
            seen = estimate(at, (0.0, 0.0, OPTIONS.cone.feet_below_m + feet_m + 0.02 * k), age=age_s)
            knows = Knowledge(ns(at), seen, impact=Impact(ns(t + 0.1), "accelerometer", 5.0, doubtful=doubtful))
            p, _, changes = mission_step(p, GuidanceCycle(ns(at), knows), OPTIONS)
            ended += [change.reason for change in changes if change.target is State.GO_AROUND]
    return p, ended


@pytest.mark.hazard("H4")
@pytest.mark.parametrize(
    ("commits", "names"),
    [
        ([(0.2, False, 0.1), (0.23, False, 0.1)], True),
        ([(0.2, False, 0.1)], False),
        ([(0.2, False, 0.1), (0.4, False, 0.1)], False),
        ([(0.2, True, 0.1), (0.2, True, 0.1)], False),
        ([(0.2, False, 3.0), (0.2, False, 3.0)], False),
        ([(0.4, False, 0.1), (0.2, False, 0.1), (0.2, False, 0.1)], True),
    ],
    ids=["the same height twice", "once", "two heights", "in doubt", "unseen", "the newest two"],
)
def test_feet_that_touch_at_the_same_wrong_height_in_two_commits_are_named_and_end_the_tries(commits, names):
    p, ended = touch_in(commits)
    causes = [reason.cause for reason in ended]
    assert (ReasonCause.FEET in causes) is names
    if not names:
        return
    assert ended[-1].text.startswith("the feet touch 2")
    high = structs.replace(p, state=State.GO_AROUND, since=ns(90.0), in_sight=True, entered_height_m=0.3)
    seen = estimate(95.0, (0.0, 0.0, OPTIONS.tries.safe_height_m + 0.5), age=0.1)
    refused, _, _ = mission_step(high, GuidanceCycle(ns(95.0), Knowledge(ns(95.0), seen)), OPTIONS)
    assert refused.state is State.REFUSED
    assert take_order(refused, Event.BEGIN, ns(96.0), OPTIONS)[0].touches == (), "who begins again has looked"
