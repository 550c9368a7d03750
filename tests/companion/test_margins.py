"""Margins and errors of one axis: against loops of the textbook, and against the law flown cycle by cycle."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from msgspec import structs

from companion.guidance.controller import Knowledge, Target
from companion.guidance.law.follow_deck import FollowDeck
from companion.guidance.law.gains import tilt_model
from companion.guidance.law.margins import (
    MEDIAN_OF_AXIS,
    PERIOD_S,
    AxisDisturbances,
    GaussMarkov,
    axis_error_m,
    by_frequency,
    expected_error_m,
    margins,
)
from companion.settings.guidance import ClimbResponse, Response, TiltResponse
from companion.settings.load import shipped_response
from estimator.contracts.commands import Lean
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2
from tests.make import body, estimate, ns

SHIPPED = shipped_response("ardrone2").tilt
AGILE = TiltResponse(0.01, 45.0, 0.6, 0.0)
SLOW = TiltResponse(0.14, 5.0, 0.7, 0.07)
QUIET = GaussMarkov(0.0, 1.0)
W = np.geomspace(0.01, 60.0, 40_000)
LOOP = 1j * W

# Loops of the textbook


def test_an_integrator_and_two_lags() -> None:
    """1 / (s (s + 1)^2) turns by half a turn at 1 rad/s, where it is one half."""
    (down, up), phase_deg, delay_s, sensitivity = by_frequency(W, L := 1.0 / (LOOP * (1.0 + LOOP) ** 2))
    crossing = 0.68233
    assert (down, up) == (0.0, pytest.approx(2.0, rel=1e-3))
    assert phase_deg == pytest.approx(90.0 - 2.0 * math.degrees(math.atan(crossing)), abs=0.05)
    assert delay_s == pytest.approx(math.radians(phase_deg) / crossing, rel=1e-3)
    assert sensitivity == pytest.approx(1.0 / np.abs(1.0 + L).min())


def test_a_loop_that_too_little_gain_makes_unstable() -> None:
    """The loop k (s + 1)^2 / s^3 is stable above k = 1/2."""
    (down, up), *_ = by_frequency(W, 2.0 * (LOOP + 1.0) ** 2 / LOOP**3)
    assert (down, up) == (pytest.approx(0.25, rel=1e-3), math.inf)


def test_of_several_half_turns_the_nearest_on_either_side_count_and_whole_turns_do_not() -> None:
    """10 exp(-s) / s is real and negative at pi/2, 5 pi/2 and 9 pi/2 rad/s, positive between."""
    (down, up), *_ = by_frequency(W, 10.0 * np.exp(-LOOP) / LOOP)
    assert (down, up) == (pytest.approx(0.25 * math.pi, rel=1e-3), pytest.approx(0.45 * math.pi, rel=1e-3))


@pytest.mark.parametrize(("gain", "peak_rad_s", "late_s"), [(0.4, 10.0, 0.0), (1.0, 4.0, 0.3), (0.6, 8.0, 0.12)])
def test_of_several_crossings_the_least_phase_and_the_least_delay_count(gain: float, peak_rad_s: float, late_s: float) -> None:
    """An integrator and a resonance: the size is one three times."""
    L = gain / LOOP / ((LOOP / peak_rad_s) ** 2 + 0.02 * LOOP / peak_rad_s + 1.0) * np.exp(-late_s * LOOP)
    at = np.flatnonzero(np.diff(np.sign(np.abs(L) - 1.0)))
    assert at.size == 3
    lag = -np.unwrap(np.angle(L))[at]
    left = (math.pi - lag) % math.tau
    _, phase_deg, delay_s, _ = by_frequency(W, L)
    assert math.radians(phase_deg) == pytest.approx(np.minimum(left, math.tau - left).min(), abs=1e-2)
    assert delay_s == pytest.approx((left / W[at]).min(), rel=1e-2)


def test_a_loop_that_never_reaches_one_has_every_margin() -> None:
    assert by_frequency(W, 0.3 / (1.0 + LOOP))[:3] == ((0.0, math.inf), pytest.approx(180.0), math.inf)


# The law flown

SMALL = 1e-4
"""Share of the disturbances that is flown: no limit of the law is reached."""


class Pushed(NamedTuple):
    """Disturbance of one cycle: of the body's acceleration, and of its measurement."""

    gust: float = 0.0
    tilt: float = 0.0
    place: float = 0.0
    speed: float = 0.0
    accel: float = 0.0
    deck: float = 0.0


def fly_pushed(
    assumed: TiltResponse, true: TiltResponse, pushes: list[Pushed], cycles: int, *, answer: float = 1.0, drag_1_s: float = 0.35
) -> F64:
    """Return place and speed of the pad against the body and the command, (cycles, 3), of a flight by the law.

    It begins at rest; `answer` scales commands. The pushes are so small that the loop is linear.
    """
    law = FollowDeck(Response(assumed, ClimbResponse(0.1, 0.1)), PERIOD_S, forecast=False)
    model, memory, out = tilt_model(true, PERIOD_S), law.start(), np.empty((cycles + 1, 3))
    x = np.zeros(len(model.A))
    for k in range(-1, cycles):  # the law begins with a cycle at rest
        by = pushes[k] if 0 <= k < len(pushes) else Pushed()
        t, reported = (k + 1) * PERIOD_S, Rotation.from_rpy(0.0, -math.atan(SMALL * x[2] / G_M_S2), 0.0)
        at = estimate(t, (SMALL * (x[0] + by.place), 0.0, 1.0), (SMALL * (x[1] + by.speed), 0.0, 0.0), sigma=0.01)
        moves = body(t, (SMALL * (x[2] + by.accel + by.gust - by.tilt), 0.0, 0.0), (0.0, -SMALL * x[3] / G_M_S2, 0.0), reported)
        memory, command = law.step(memory, ns(t), Knowledge(ns(t), at, moves), Target(np.array([0.0, 0.0, 1.0])))
        assert isinstance(command, Lean)
        u = float(command.a_level[0] + command.trim_level[0]) / SMALL
        out[k + 1] = *x[:2], u
        push, w = by.deck + by.tilt - by.gust, x[1]
        x = model.A @ x + model.B * answer * u
        x[0] += 0.5 * PERIOD_S**2 * push
        x[1] += PERIOD_S * (push - drag_1_s * w)
    return out[1:]


def settles(assumed: TiltResponse, true: TiltResponse, answer: float = 1.0) -> bool:
    """Return whether a push dies away."""
    course = np.abs(fly_pushed(assumed, true, [Pushed(gust=1.0)], 1500, answer=answer)[:, 0])
    return bool(course[-400:].max() < 0.5 * course[-900:-500].max())


@pytest.mark.parametrize("assumed", [SHIPPED, SLOW])
def test_a_vehicle_may_answer_more_or_less_by_the_gain_margins_and_no_further(assumed: TiltResponse) -> None:
    found = margins(assumed)
    down, up = found.gain
    assert found.stable
    assert settles(assumed, assumed)
    assert math.isfinite(up)
    assert settles(assumed, assumed, 0.97 * up)
    assert not settles(assumed, assumed, 1.03 * up)
    if down > 0.0:
        assert settles(assumed, assumed, 1.03 * down)
        assert not settles(assumed, assumed, 0.97 * down)


@pytest.mark.parametrize("assumed", [SHIPPED, AGILE])
def test_a_vehicle_may_be_later_than_assumed_by_the_delay_margin_and_no_further(assumed: TiltResponse) -> None:
    more_s = margins(assumed).delay_s
    for share, stands in ((0.9, True), (1.1, False)):
        true = structs.replace(assumed, delay_s=assumed.delay_s + share * more_s)
        beside = margins(assumed, true)
        assert beside.stable is settles(assumed, true) is stands
        assert math.isfinite(beside.error_m) is math.isfinite(beside.speed_m_s) is stands


def wandering(name: str, of: GaussMarkov, cycles: int) -> list[Pushed]:
    """Return the course of one process after a single new part; its squares, summed, are the share of the variance."""
    keep = math.exp(-PERIOD_S / of.time_s)
    return [Pushed(**{name: of.sigma * math.sqrt(1.0 - keep**2) * keep**k}) for k in range(cycles)]


@pytest.mark.parametrize("tilt", [SHIPPED, AGILE])
@pytest.mark.parametrize("name", Pushed._fields)
def test_each_disturbance_moves_the_body_as_much_as_it_should(name: str, tilt: TiltResponse) -> None:
    fields = {"gust": "gust_m_s2", "tilt": "tilt_m_s2", "place": "place_m", "speed": "speed_m_s", "accel": "accel_m_s2",
              "deck": "deck_m_s2"}  # fmt: skip
    silent = AxisDisturbances(*[QUIET] * 6, sample_m_s2=0.0)
    of = GaussMarkov(0.3, 0.7)
    found = margins(tilt, around=silent._replace(**{fields[name]: of}))
    course = fly_pushed(tilt, tilt, wandering(name, of, 1200), 1200)
    if name == "gust":
        assert margins(tilt, around=silent._replace(downwash_m_s2=of))[5:] == pytest.approx(found[5:]), "it feels both alike"
    assert found[5:] == pytest.approx(np.sqrt((course**2).sum(axis=0)).tolist(), rel=1e-5)


def test_single_samples_of_the_accelerometer_and_another_drag_move_it_as_well() -> None:
    found = margins(SHIPPED, around=AxisDisturbances(*[QUIET] * 6, sample_m_s2=0.5, drag_1_s=1.2))
    course = fly_pushed(SHIPPED, SHIPPED, [Pushed(accel=0.5)], 1200, drag_1_s=1.2)
    assert found[5:] == pytest.approx(np.sqrt((course**2).sum(axis=0)).tolist(), rel=1e-5)


def test_the_error_to_expect_grows_with_the_delay_of_the_video() -> None:
    expected = [expected_error_m(SHIPPED, late_s) for late_s in (0.0, 0.09, 0.17, 0.26, 0.4)]
    assert expected == sorted(expected)
    assert expected[0] == pytest.approx(MEDIAN_OF_AXIS * axis_error_m(SHIPPED, SHIPPED))
    assert expected[3] == pytest.approx(0.032, abs=0.002), "as flown"
