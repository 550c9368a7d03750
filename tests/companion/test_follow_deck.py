"""The law that follows the deck: its axes, limits and silences in one guidance cycle, and its gains beside scipy's."""

import math
from collections.abc import Sequence
from itertools import cycle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from scipy.linalg import solve_discrete_are

from companion.base.observer import ResponseInUse, ResponseState
from companion.guidance.controller import FieldOfView, Knowledge, Target
from companion.guidance.law import follow_deck
from companion.guidance.law.follow_deck import FollowDeck, FollowDeckMemory, TuningChoice
from companion.guidance.law.gains import (
    SIGMAS_P_M,
    ObserverNoise,
    TiltWeights,
    chosen,
    exponential,
    observer_gains,
    regulator,
    tilt_gains,
    tilt_model,
)
from companion.guidance.law.margins import margins
from companion.guidance.law.pid import PidController
from companion.settings.guidance import PidOptions, TiltResponse
from companion.settings.load import shipped_response
from estimator.contracts.commands import Hover, Lean, Velocity
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.ekf import Forecast
from tests.make import body, deck, estimate, ns

RESPONSE = shipped_response("ardrone2")
T = 0.02
LAW = FollowDeck(RESPONSE, T)
OVER = np.array([0.0, 0.0, 1.0])
HOLD, ALONG = Target(OVER), Target(OVER, yaw_rad=0.0)
IDENTIFIED = ResponseInUse(ResponseState.IDENTIFIED, 0.2, 0.02, 0.15)


def knows(
    t: float, d: tuple[float, float, float] = (0.0, 0.0, 1.0), v: tuple[float, float, float] = (0.0, 0.0, 0.0), *,
    a: tuple[float, float] = (0.0, 0.0), lean: tuple[float, float] = (0.0, 0.0),
    rates: tuple[float, float, float] = (0.0, 0.0, 0.0), v_deck: tuple[float, float, float] | None = None,
    yaw: float | None = 0.0, heading: float = 0.0, var: tuple[float, float] = (1e-6, 1e-6), response: ResponseInUse | None = None,
    a_deck: tuple[float, float, float] = (0.0, 0.0, 0.0), a_down: float = 0.0, forecast: Forecast | None = None,
) -> Knowledge:  # fmt: skip
    """Return the knowledge at an instant: vectors in level, tilts and accelerations in m/s^2."""
    pitch, roll = -math.atan(lean[0] / G_M_S2), math.atan(lean[1] / math.hypot(G_M_S2, lean[0]))
    relative = structs.replace(estimate(t, d, v, yaw), cov=np.diag([*var, 1e-6, 1e-4, 1e-4, 1e-4, 1e-4]))
    moves = body(t, (*a, a_down), rates, Rotation.from_rpy(roll, pitch, heading), heading=heading)
    return Knowledge(ns(t), relative, moves, None if v_deck is None else deck(t, v_deck, a_deck), forecast, response=response)


def stepped(
    memory: FollowDeckMemory, k: Knowledge, target: Target | None = HOLD, law: FollowDeck = LAW
) -> tuple[FollowDeckMemory, Lean]:
    memory, command = law.step(memory, k.at, k, target)
    assert isinstance(command, Lean)
    return memory, command


def ask_law(command: Lean) -> F64:
    return np.asarray(command.a_level + command.trim_level)


def swaying(seed: int, heading: float, *, swapped: bool = False) -> list[Lean]:
    """Commands over half a second of random motion; `swapped` has forward and right in each other's place."""
    rng, memory, out = np.random.default_rng(seed), LAW.start(), []
    way = (1, 0) if swapped else (0, 1)
    for k in range(25):
        d, v, a, lean, v_deck, a_deck, place = (0.3 * rng.standard_normal((7, 2))[:, way]).tolist()
        roll_rate, pitch_rate = 0.2 * rng.standard_normal(2)
        rates = (-pitch_rate, -roll_rate, 0.0) if swapped else (roll_rate, pitch_rate, 0.0)
        var = (1e-6, 1e-2) if swapped else (1e-2, 1e-6)
        now = knows(
            k * T, (*d, 1.0), (*v, 0.0), a=a, lean=lean, rates=rates, v_deck=(*v_deck, 0.0), heading=heading, var=var,
            a_deck=(*a_deck, 0.0), response=None if k < 5 else IDENTIFIED,
        )  # fmt: skip
        memory, command = stepped(memory, now, Target(np.array([*place, 1.0])))
        out.append(command)
    return out


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000), st.floats(-math.pi, math.pi))
def test_what_it_requests_in_level_does_not_depend_on_where_the_nose_points(seed: int, heading: float) -> None:
    for one, other in zip(swaying(seed, heading), swaying(seed, 0.0), strict=True):
        np.testing.assert_allclose(one.a_level, other.a_level, atol=1e-9)
        np.testing.assert_allclose(one.trim_level, other.trim_level, atol=1e-9)
        np.testing.assert_allclose(one.v_level, other.v_level, atol=1e-9)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_forward_and_right_are_flown_alike(seed: int) -> None:
    for one, other in zip(swaying(seed, 0.0), swaying(seed, 0.0, swapped=True), strict=True):
        np.testing.assert_allclose(one.a_level, other.a_level[::-1], atol=1e-9)
        np.testing.assert_allclose(one.trim_level, other.trim_level[::-1], atol=1e-9)
        np.testing.assert_allclose(one.v_level, other.v_level[[1, 0, 2]], atol=1e-9)


@pytest.mark.parametrize("v", [(0.12, -0.08), (0.08, -0.05)])
@pytest.mark.parametrize(
    ("moved", "leapt"), [((3.0, -4.0), True), ((0.31, 0.41), True), ((0.29, 0.39), False), ((0.0, 0.0), False)]
)
def test_an_estimate_that_leaps_is_not_come_after_little_by_little(moved, leapt, v):
    memory = LAW.start()
    for k in range(100):
        memory, _ = stepped(memory, knows(k * T, (2.0, 1.0, 1.0), lean=(0.5, -0.3), heading=0.7))
    before = memory.core.axes
    again = knows(100 * T, (2.0 + moved[0], 1.0 + moved[1], 1.0), (*v, 0.0), lean=(0.5, -0.3), heading=0.7)
    after = stepped(memory, again)[0].core.axes
    c, s = math.cos(0.7), math.sin(0.7)
    there = c * (2.0 + moved[0]) - s * (1.0 + moved[1]), s * (2.0 + moved[0]) + c * (1.0 + moved[1])
    assert (math.dist([axis.p for axis in after], there) < 0.01) is (leapt or not any(moved))
    at_once = math.dist([axis.w for axis in after], (c * v[0] - s * v[1], s * v[0] + c * v[1])) < 0.02
    assert at_once is (leapt or math.hypot(*v) > 0.12) or moved == (0.29, 0.39)
    if leapt:
        assert [axis.d for axis in after] == pytest.approx([axis.d for axis in before], abs=0.01)


@pytest.mark.parametrize(("silent_s", "kept"), [(0.02, True), (0.5, True), (0.501, False), (0.0, False), (-0.1, False)])
def test_after_half_a_second_of_silence_it_begins_again_and_keeps_the_wind(silent_s: float, kept: bool) -> None:
    memory = LAW.start()
    for k in range(100):
        memory, _ = stepped(memory, knows(k * T, lean=(0.5, -0.3), yaw=0.2, rates=(0.0, 0.0, 0.1)))
    wind = [axis.d for axis in memory.core.axes]
    assert abs(wind[0]) > 0.1
    after = stepped(memory, knows(99 * T + silent_s, (0.0, 0.0, 1.0), lean=(0.1, 0.2), yaw=0.2))[0].core
    if kept:
        before, periods = list(memory.core.axes[0].under_way), round(silent_s / T)
        held = [before[0]] * (periods - 1) + before
        assert list(after.axes[0].under_way)[1 : LAW._remembered] == held[: LAW._remembered - 1], "a command acts until the next"
        assert after.turn_rate_rad_s != 0.0
    else:
        assert list(after.axes[0].under_way)[1 : LAW._remembered] == [pytest.approx(0.1)] * (LAW._remembered - 1)
        assert [axis.d for axis in after.axes] == wind
        assert after.turn_rate_rad_s == 0.0


@pytest.mark.parametrize("v_deck", [None, (0.4, -0.3, 0.0)])
def test_its_velocity_is_the_decks_and_the_drones_with_what_the_tilt_will_give(v_deck: tuple[float, float, float] | None) -> None:
    now = knows(0.0, (0.5, -0.4, 1.0), (-0.2, 0.1, 0.0), v_deck=v_deck)
    _, command = stepped(LAW.start(), now)
    soon = RESPONSE.tilt.slowness_s
    wanted = [0.0, 0.0] if v_deck is None else [0.4 + 0.2 + soon * command.a_level[0], -0.3 - 0.1 + soon * command.a_level[1]]
    assert command.v_level[:2] == pytest.approx(wanted)
    _, own = stepped(LAW.start(), now, law=FollowDeck(RESPONSE, T, over_ground=True))
    assert own.v_level[:2] == pytest.approx([0.0, 0.0] if v_deck is None else [0.6, -0.4])


@pytest.mark.parametrize("own_deg", [None, 10.0, 43.0])
@pytest.mark.parametrize("most_rad", [None, 0.05, 1.0])
def test_a_tilt_beyond_the_limit_is_shortened_and_keeps_its_direction(most_rad: float | None, own_deg: float | None) -> None:
    by_vehicle = RESPONSE.tilt.max_m_s2 if own_deg is None else G_M_S2 * math.tan(math.radians(own_deg))
    most = min(by_vehicle, math.inf if most_rad is None else G_M_S2 * math.tan(most_rad))
    now = structs.replace(knows(0.0, (0.9, -1.2, 1.0), (3.0, -4.0, 0.0)), tilt_max_deg=own_deg)
    _, command = stepped(LAW.start(), now, Target(OVER, lean_max_rad=most_rad))
    assert ask_law(command) == pytest.approx([0.6 * most, -0.8 * most])
    _, little = stepped(LAW.start(), knows(0.0, (0.003, -0.004, 1.0)), Target(OVER, lean_max_rad=most_rad))
    assert 0.0 < np.hypot(*ask_law(little)) < 0.5 * G_M_S2 * math.tan(0.05)


def test_a_place_further_off_requests_no_more_than_the_speed_that_is_allowed() -> None:
    def lean(far: float, speed: float) -> F64:
        return ask_law(stepped(LAW.start(), knows(0.0, (0.6 * far, 0.8 * far, 1.0)), Target(OVER, speed_max_m_s=speed))[1])

    assert lean(20.0, 0.02) == pytest.approx(lean(5.0, 0.02))
    assert np.hypot(*lean(20.0, 0.04)) == pytest.approx(2.0 * np.hypot(*lean(20.0, 0.02)))
    assert np.hypot(*lean(0.02, 0.5)) == pytest.approx(2.0 * np.hypot(*lean(0.01, 0.5)))


def test_a_vertical_speed_is_no_more_than_the_vehicle_makes() -> None:
    most = RESPONSE.climb.max_m_s
    assert LAW.climb_max_m_s == most
    for height, down in ((50.0, most), (-50.0, -most)):
        _, command = stepped(LAW.start(), knows(0.0, (0.0, 0.0, height)), Target(OVER, vertical_rate_max_m_s=40.0))
        assert command.v_level[2] == pytest.approx(down)


def climbed(z_m: float, cycles: int, v_deck: float = 0.0) -> list[float]:
    """Return the heights over a still deck, m, of a vehicle that is ordered to 1 m and answers as the law knows.

    Args:
        v_deck: speed down that the filter has wrong of deck and vehicle, m/s.
    """
    climb, v, memory, heights = RESPONSE.climb, 0.0, LAW.start(), [z_m]
    under_way = [0.0] * (round(climb.delay_s / T) + 1)
    for n in range(cycles):
        now = knows(n * T, (0.0, 0.0, z_m), (0.0, 0.0, -v), v_deck=(0.0, 0.0, v_deck), a_down=(under_way[0] - v) / climb.lag_s)
        memory, command = stepped(memory, now, Target(OVER, vertical_rate_max_m_s=1.0))
        under_way = [*under_way[1:], float(command.v_level[2])]
        v += T * (under_way[0] - v) / climb.lag_s
        z_m -= T * v
        heights.append(z_m)
    return heights


@pytest.mark.parametrize("from_m", [0.8, 1.3, 3.0])
def test_it_comes_to_a_height_without_going_past_it(from_m: float) -> None:
    heights = np.array(climbed(from_m, 250))
    past_m = np.max((1.0 - heights) * np.sign(from_m - 1.0))
    assert past_m < 0.001
    assert heights[-1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("wrong_m_s", [0.8, -0.8, 0.9])
def test_a_speed_over_the_ground_that_the_filter_has_wrong_moves_neither_drone_nor_deck(wrong_m_s: float) -> None:
    """WHY: with an accelerometer off by a tenth the filter has both too fast, and the drone went up or met the deck hard."""
    heights = climbed(1.0, 250, wrong_m_s)
    assert heights[-1] == pytest.approx(1.0, abs=0.005)
    assert heights[-2] == pytest.approx(heights[-1], abs=0.001)


def test_without_the_bodys_motion_the_plain_controller_flies_and_without_that_nobody() -> None:
    both = knows(0.0, (0.5, 0.0, 1.5))
    bodiless = structs.replace(both, body=None)
    begun = LAW.start()
    assert LAW.step(begun, ns(0.0), bodiless, HOLD) == (begun, Hover())
    plain = PidController(PidOptions())
    law = FollowDeck(RESPONSE, T, fallback=plain)
    memory, command = law.step(law.start(), ns(0.0), bodiless, HOLD)
    _, wanted = plain.step(plain.start(), ns(0.0), bodiless, HOLD)
    assert isinstance(command, Velocity)
    assert isinstance(wanted, Velocity)
    assert command.v_level.tolist() == wanted.v_level.tolist()
    assert memory.plain.last == 0
    assert isinstance(law.step(memory, ns(T), both, HOLD)[1], Lean)


# The deck ahead, what is under way, and what the vehicle does by itself


def turning(t: float, early: float, late: float) -> Forecast:
    """Return a forecast, made at t, of an accelerating deck (forward, right, down): by `early` until 0.05 s, then by `late`."""
    h, z = np.array([0.0, 0.05 - t, 5.0 - t]), np.zeros(3)
    v = np.outer([0.0, h[1] * early, h[1] * early + 4.95 * late], [1.0, 2.0, 3.0])
    return Forecast(ns(t), h, np.zeros((3, 3)), np.zeros((3, 3, 3)), v, z, z, z, z, z, z, z, z)


def test_the_decks_acceleration_counts_now_and_when_the_command_has_taken_effect() -> None:
    def lean(forecast: Forecast | None) -> F64:
        now = knows(0.0, (0.001, -0.002, 1.0), v_deck=(0.0, 0.0, 0.0), forecast=forecast)
        return np.append(ask_law(command := stepped(LAW.start(), now)[1]), command.v_level[2])

    plain, early, late = lean(None), lean(turning(0.0, 0.2, 0.0)), lean(turning(0.0, 0.0, 0.2))
    assert np.all(np.abs(early[:2] - plain[:2]) > 1e-3)
    assert np.all(np.abs(late - plain) > 1e-3)
    for made_s, counts in ((-0.04, True), (-0.49, True), (-0.51, False)):
        assert lean(turning(made_s, 0.0, 0.2)) == pytest.approx(late if counts else plain)


def test_a_tilt_is_cut_so_that_the_camera_keeps_the_pad() -> None:
    field = FieldOfView(0.01, 0.0, 0.07, 0.06)
    now = knows(0.0, (0.06, -0.04, 1.5), heading=0.7)
    _, free = stepped(LAW.start(), now)
    _, seeing = stepped(LAW.start(), now, law=FollowDeck(RESPONSE, T, field))
    # Leaning forward turns the camera astern, so that the pad moves towards the forward edge by as much.
    bearings, half = np.array([math.atan2(0.06 - 0.01, 1.5), math.atan2(-0.04, 1.5)]), np.array([0.07, 0.06])
    edge = G_M_S2 * np.tan(half - np.abs(bearings)) * np.sign(bearings)
    least = seeing.trim_level + 0.6 * np.sign(bearings)  # without any, the wind would carry it off
    assert ask_law(seeing) == pytest.approx(np.where(np.abs(edge) > np.abs(least), edge, least))
    assert np.all(np.abs(ask_law(free)) > np.abs(ask_law(seeing)))
    # A pad that a level camera does not show is not kept in view: the drone flies to it.
    away = knows(0.0, (1.5, -0.04, 1.5))
    (_, free), (_, seeing) = stepped(LAW.start(), away), stepped(LAW.start(), away, law=FollowDeck(RESPONSE, T, field))
    assert ask_law(seeing)[0] == pytest.approx(ask_law(free)[0], rel=1e-3)


def test_a_law_keeps_no_more_commands_than_the_core() -> None:
    with pytest.raises(ValueError, match=r"136 commands of 0\.00333.* are under way, and the law keeps 132"):
        FollowDeck(RESPONSE, 1.0 / 300.0)
    with pytest.raises(ValueError, match="a command that acts after 30 periods is forgotten after 24"):
        LAW._gains(TuningChoice(0.7), 0.01)


@pytest.mark.parametrize("state", [ResponseState.ASSUMED, ResponseState.KNOWN])
def test_no_gains_of_the_file_are_solved_in_flight(state: ResponseState, monkeypatch: pytest.MonkeyPatch) -> None:
    law = FollowDeck(RESPONSE, T)
    monkeypatch.setattr(follow_deck, "tilt_gains", None)
    for sigma in (1e-3, 0.03, 0.3, 3.0):
        stepped(law.start(), knows(0.0, var=(sigma**2, 0.0), response=ResponseInUse(state, 0.05, None)), law=law)


@pytest.mark.parametrize("over_ground", [False, True])
def test_a_wind_that_takes_thirty_five_degrees_is_known_whole(over_ground: bool) -> None:
    """WHY: what an autopilot leans by itself counted up to 17 degrees; in 10 m/s it flew upwind past the pad and lost it."""
    memory = (law := FollowDeck(shipped_response("autopilot"), T, over_ground=over_ground)).start()
    for k in range(1000):
        memory, _ = law.step(memory, ns(k * T), knows(k * T, lean=(7.0, -1.0)), None if over_ground else HOLD)
    assert [axis.d for axis in memory.core.axes] == pytest.approx([-7.0, 1.0], abs=0.05)
    if over_ground:
        assert [part.own for part in memory.core.own] == pytest.approx([7.0, -1.0], abs=0.05)
        jumped = law.step(memory, ns(1000 * T), knows(1000 * T, lean=(4.0, -1.0)), None)[0].core.axes[0]
        assert jumped.under_way[0] == pytest.approx(4.0), "a tilt that others fly is noted as it is"


def come_from(
    beside_m: float, jerk_m_s3: float, stated_m_s3: float | None, late: Sequence[int] = (1,), holds_1_s: float = 0.0
) -> tuple[list[float], list[float]]:
    """Fly a vehicle of the shipped response to the pad, through a limit of the jerk; return its places and commanded jerks.

    `late` are the periods from one guidance cycle to the next, `holds_1_s` the stiffness of the vehicle's own velocity loop.
    """
    response = shipped_response("autopilot")
    tilt = structs.replace(response.tilt, jerk_max_m_s3=None)
    law = FollowDeck(structs.replace(response, tilt=tilt), T, over_ground=True)
    memory, places, jerks = law.start(), list[float](), list[float]()
    p, v, lean, rate, shaped, before, due, lengths = beside_m, 0.0, 0.0, 0.0, 0.0, 0.0, 0, cycle(late)
    waiting = [0.0] * round(tilt.delay_s / T)
    in_use = ResponseInUse(ResponseState.KNOWN, tilt.delay_s, 0.005, 0.0)
    for k in range(400):
        now = knows(
            k * T, (p, 0.0, 1.5), (v, 0.0, 0.0), a=(lean, 0.0), lean=(lean, 0.0), rates=(0.0, -rate / G_M_S2, 0.0),
            v_deck=(0.0, 0.0, 0.0), response=in_use,
        )  # fmt: skip
        now = structs.replace(now, jerk_max_m_s3=stated_m_s3)
        if k == due:
            due += next(lengths)
            memory, command = stepped(memory, now, Target(np.array([0.0, 0.0, 1.5])), law)
            jerks.append(abs(ask_law(command)[0] - before) / T)
        before = command.a_level[0] + (holds_1_s * (command.v_level[0] + v) if holds_1_s else command.trim_level[0])
        shaped += float(np.clip(before - shaped, -jerk_m_s3 * T, jerk_m_s3 * T))
        waiting.append(shaped)
        arrived = waiting.pop(0)
        for _ in range(10):
            dt = 0.1 * T
            rate += dt * (tilt.frequency_rad_s**2 * (arrived - lean) - 2.0 * tilt.damping * tilt.frequency_rad_s * rate)
            lean += dt * rate
            v -= dt * lean
            p += dt * v
        places.append(p)
    return places, jerks


@pytest.mark.parametrize("beside_m", [0.03, 0.25, 1.0, 3.0])
@pytest.mark.parametrize("jerk_m_s3", [5.0, 20.0])
def test_a_vehicle_that_limits_jerk_comes_to_the_pad_from_any_distance(beside_m: float, jerk_m_s3: float) -> None:
    places, jerks = come_from(beside_m, jerk_m_s3, jerk_m_s3)
    assert min(places) > -0.45 * beside_m
    assert max(map(abs, places[300:])) < 0.02
    assert max(jerks[1:]) < 1.02 * jerk_m_s3


@pytest.mark.parametrize("late", [(5,), (7,), (2, 2, 2, 10), (3, 10, 5, 8)])
def test_late_cycles_drive_no_vehicle_with_a_velocity_loop_away(late: tuple[int, ...]) -> None:
    """WHY: at 100 ms a cycle the model of its tilt grew without end; it left the pad that it hovered over by 50 m."""
    places, _ = come_from(0.25, 20.0, 20.0, late, 2.0)
    assert max(map(abs, places)) < 0.8
    assert max(map(abs, places[350:])) < 0.3


@pytest.mark.parametrize(
    ("off_m", "push_m_s2", "seconds", "lag_s"), [(0.05, 0.0, 0.6, 0.0), (0.0, 0.8, 0.6, 0.073), (-0.08, 0.5, 0.3, 0.073)]
)
def test_it_knows_where_it_will_be(off_m: float, push_m_s2: float, seconds: float, lag_s: float) -> None:
    """WHY: the gate opens, and the commit ends, on the error at the contact to come."""
    response = structs.replace(RESPONSE, tilt=structs.replace(RESPONSE.tilt, lag_s=lag_s))
    model, law = tilt_model(response.tilt, T), FollowDeck(response, T)
    x, memory = np.zeros(len(model.A)), law.start()
    x[0] = off_m
    place: list[float] = []
    output: tuple[float, float] | None = None
    after, asked_at = round(seconds / T), 60
    assert law.ahead(memory, knows(0.0), seconds) is None, "nothing is under way before the first cycle"
    for n in range(asked_at + after):
        k = knows(
            n * T, (x[0], 0.0, 1.0), (x[1], 0.0, 0.0), a=(x[2] + push_m_s2, 0.0), lean=(x[2], 0.0),
            rates=(0.0, -x[3] / G_M_S2, 0.0), v_deck=(0.0, 0.0, 0.0),
        )  # fmt: skip
        memory, command = stepped(memory, k, law=law)
        if n == asked_at:
            output = law.ahead(memory, k, seconds)
        x = model.A @ x + model.B * float(command.a_level[0] + command.trim_level[0])
        x[:2] -= push_m_s2 * np.array([0.5 * T * T, T])
        place.append(abs(float(x[0])))
    assert output[0] == pytest.approx(place[-1], abs=0.004)


@pytest.mark.parametrize("push_m_s2", [3.0, -4.0])
def test_without_an_accelerometer_it_holds_against_the_wind_all_the_same(push_m_s2: float) -> None:
    """WHY: what takes the accelerometer's place knows of no wind; believed, it let the drone level and be blown off."""
    model, memory = tilt_model(RESPONSE.tilt, T), LAW.start()
    x = np.zeros(len(model.A))
    x[2] = -push_m_s2
    for n in range(500):
        k = knows(
            n * T, (x[0], 0.0, 1.0), (x[1], 0.0, 0.0), a=(x[2] + push_m_s2 * (n < 100), 0.0), lean=(x[2], 0.0),
            rates=(0.0, -x[3] / G_M_S2, 0.0), v_deck=(0.0, 0.0, 0.0),
        )  # fmt: skip
        memory, command = stepped(memory, structs.replace(k, unfelt=n >= 100))
        if n == 100:
            before = [axis.d for axis in memory.core.axes]
        x = model.A @ x + model.B * float(command.a_level[0] + command.trim_level[0])
        x[:2] -= push_m_s2 * np.array([0.5 * T * T, T])
        assert n < 100 or abs(x[0]) < 0.15
    assert [axis.d for axis in memory.core.axes] == pytest.approx(before, abs=0.3)


@pytest.mark.parametrize(("noise_m_s2", "most_m_s2"), [(0.35, 1.8), (1.3, 2.5)])
def test_an_accelerometer_that_is_four_times_as_rough_moves_the_drone_hardly_more(noise_m_s2: float, most_m_s2: float) -> None:
    """WHY: PX4's simulated quadcopter (SIH) shakes so, and a law that believed it swung by 6 degrees and did not land."""
    response = shipped_response("quad_1_5kg")
    law, model, rng = FollowDeck(response, T), tilt_model(response.tilt, T), np.random.default_rng(1)
    memory, x, asked = law.start(), np.zeros(len(model.A)), list[float]()
    for n in range(500):
        felt = (x[2] + noise_m_s2 * rng.standard_normal(), noise_m_s2 * rng.standard_normal())
        k = knows(n * T, (x[0], 0.0, 1.0), (x[1], 0.0, 0.0), a=felt, lean=(x[2], 0.0), rates=(0.0, -x[3] / G_M_S2, 0.0))
        memory, command = stepped(memory, k, law=law)
        asked.append(float(ask_law(command)[0]))
        x = model.A @ x + model.B * asked[-1]
    assert np.std(asked[200:]) < most_m_s2


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_a_wind_that_was_learned_in_hover_is_leant_against_from_the_first_step(yaw: float) -> None:
    """Somebody else commands for two seconds in a wind; whoever takes over would otherwise be blown off."""
    memory = LAW.start()
    for k in range(100):
        now = knows(k * T, lean=(0.9, -0.4), heading=yaw)
        memory, command = LAW.step(memory, now.at, now, None)
        assert command == Hover()
    _, command = stepped(memory, knows(100 * T, lean=(0.9, -0.4), heading=yaw))
    assert ask_law(command) == pytest.approx([0.9, -0.4], abs=0.05)
    assert command.trim_level == pytest.approx([0.9, -0.4], abs=0.05)


@pytest.mark.parametrize("rate", [0.45, -0.3])
@pytest.mark.parametrize("push", [0.0, 0.3, -0.3])
def test_a_wanted_rate_is_reached_within_a_second_whatever_pushes(rate: float, push: float) -> None:
    """The vehicle has the shipped response."""
    climb, memory, v, h = RESPONSE.climb, LAW.start(), 0.0, 6.0
    waiting = [0.0] * max(1, round(climb.delay_s / T))
    for k in range(300):
        a = (waiting.pop(0) - v) / climb.lag_s + push
        now = knows(k * T, (0.0, 0.0, h), (0.0, 0.0, -v), a_down=a, v_deck=(0.0, 0.0, 0.0))
        memory, command = stepped(memory, now, Target(OVER, rate))
        waiting.append(float(command.v_level[2]))
        v += T * a
        h -= T * v
        assert k < 75 or abs(v - rate) < 0.03


# The nose follows the arrow of a ship that turns


def turn_headings(turn_deg_s: float, off_deg: float, seconds: float, lag_s: float = 0.3, noise_deg: float = 0.0) -> list[float]:
    """Return the heading against the arrow, degrees, of a vehicle that takes up a turn rate with a lag."""
    rng, memory, off, rate, out = np.random.default_rng(4), LAW.start(), math.radians(off_deg), 0.0, []
    for k in range(round(seconds / T)):
        seen = wrap_pi(off + math.radians(noise_deg) * rng.standard_normal())
        memory, command = stepped(memory, knows(k * T, yaw=seen, rates=(0.0, 0.0, rate)), ALONG)
        rate += T / lag_s * (command.yaw_rate_rad_s - rate)
        off = wrap_pi(off + T * (rate - math.radians(turn_deg_s)))
        out.append(math.degrees(off))
    return out


@pytest.mark.parametrize("turn_deg_s", [-2.0, 0.0, 2.0, 5.0])
def test_the_nose_lies_on_the_arrow_of_a_ship_that_turns(turn_deg_s: float) -> None:
    course = turn_headings(turn_deg_s, -20.0, 30.0, noise_deg=0.5)
    assert max(abs(x) for x in course[-500:]) < 1.0


def test_coming_round_to_the_arrow_hardly_overshoots() -> None:
    course = turn_headings(0.0, 60.0, 20.0)
    assert min(course) > -3.0
    assert abs(course[-1]) < 0.3


@pytest.mark.parametrize(("yaw", "rate"), [(None, 0.0), (math.pi, 0.6), (-math.pi, 0.6)])
def test_a_heading_that_is_not_known_requests_no_turn_and_half_a_turn_goes_clockwise(yaw: float | None, rate: float) -> None:
    _, command = stepped(LAW.start(), knows(0.0, yaw=yaw), ALONG)
    assert command.yaw_rate_rad_s == pytest.approx(rate)


TILT = TiltResponse(0.05, 9.0, 0.7, lag_s=0.08)


def test_what_no_input_reaches_has_no_gains() -> None:
    with pytest.raises(ValueError, match="stabilised"):
        regulator(np.array([[1.1]]), np.array([[0.0]]), np.eye(1), np.eye(1))


def test_the_exponential_turns() -> None:
    for angle in (1e-6, 0.3, 4.0, -11.0):
        e = exponential(np.array([[0.0, -angle], [angle, 0.0]]))
        assert e == pytest.approx(np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]))


@pytest.mark.parametrize("delay_s", [0.0, 0.013, 0.02, 0.05, 0.0731])
@pytest.mark.parametrize("lag_s", [0.0, 0.073])
def test_the_discrete_model_is_the_continuous_one(delay_s: float, lag_s: float) -> None:
    """The model is compared with small steps of the differential equations, for commands that are held for a period each."""
    tilt = TiltResponse(delay_s, 5.0, 0.7, lag_s)
    model = tilt_model(tilt, T)
    u = np.random.default_rng(3).standard_normal(25)
    x = np.zeros(model.A.shape[0])
    for command in u:
        x = model.A @ x + model.B * command
    dt = 1e-5
    p = w = a = rate = f = 0.0
    for k in range(round(25 * T / dt)):
        at = k * dt - delay_s
        given_now = u[int(at / T + 1e-9)] if at >= -1e-12 else 0.0
        f = f + dt * (given_now - f) / lag_s if lag_s else given_now
        p, w, a, rate = p + dt * w, w - dt * a, a + dt * rate, rate + dt * (25.0 * (f - a) - 7.0 * rate)
    assert x[:4] == pytest.approx([p, w, a, rate], rel=2e-3, abs=2e-3)


def test_the_shipped_law_stands_sixty_milliseconds_more_than_it_knows() -> None:
    whole = margins(RESPONSE.tilt)
    assert whole.stable
    assert whole.delay_s >= 0.06
    assert whole.gain[1] >= 2.0
    assert whole.phase_deg >= 25.0
    assert whole.error_m < 0.018


def test_the_gains_that_are_kept_reach_from_five_millimetres_to_sixteen_centimetres() -> None:
    assert SIGMAS_P_M == (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
    for n, sigma in enumerate(SIGMAS_P_M):
        assert chosen(SIGMAS_P_M, 0.9 * sigma) == sigma
        assert chosen(SIGMAS_P_M, 1.4 * sigma) == sigma
        assert chosen(SIGMAS_P_M, 1.41 * sigma) == SIGMAS_P_M[min(n + 1, 5)]


@pytest.mark.parametrize("accelerometer", [True, False])
def test_the_observers_gains_solve_its_riccati_equation(accelerometer: bool) -> None:
    table = observer_gains(ObserverNoise(accelerometer=accelerometer), T)
    A = np.array([[1.0, T, -0.5 * T**2, 0.0], [0.0, 1.0, -T, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0]])
    Q = np.diag([1e-8, 0.01 * T, 2.0 * T, 0.1 * T])
    for sigma, gains in zip(SIGMAS_P_M, table, strict=True):
        R = np.diag([10.0 * sigma**2, 10.0 * 0.08**2, 0.06**2 if accelerometer else 1e6])
        P = solve_discrete_are(A.T, C.T, Q, R)
        np.testing.assert_allclose(gains.rows, P @ C.T @ np.linalg.inv(C @ P @ C.T + R), rtol=2e-4, atol=1e-7)
    assert ObserverNoise().accelerometer


@pytest.mark.parametrize("lag_s", [0.08, 0.0])
def test_the_regulators_gains_solve_its_riccati_equation(lag_s: float) -> None:
    response = structs.replace(TILT, lag_s=lag_s)
    gains = tilt_gains(response, TiltWeights(), T)
    model = tilt_model(structs.replace(response, delay_s=0.05), T)
    B, Q = model.B[:, None], np.zeros_like(model.A)
    Q[:3, :3] = np.outer((1.0, 0.0, 0.01), (1.0, 0.0, 0.01)) / 0.006**2
    Q[1, 1] = 4.1**-2
    R = np.array([[0.3**-2]])
    S = solve_discrete_are(model.A, B, Q, R)
    K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ model.A)[0]
    lag = (gains.lag,) if lag_s else ()
    np.testing.assert_allclose((*gains[:4], *lag, *gains.under_way), K, rtol=1e-9)
    assert len(gains.under_way) == 3
    assert (gains.lag == 0.0) is (lag_s == 0.0)
