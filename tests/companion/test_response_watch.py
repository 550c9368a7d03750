"""The response identified in flight: true or unchanged, never by one fit alone, and without a bump in the command.

Margins and errors of one axis stand against loops of the textbook, and against the law flown cycle by cycle.
"""

import functools
import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from msgspec.structs import replace

from companion.base.mission import Event, State
from companion.base.observer import AS_FILED, ResponseInUse, ResponseState  # fmt: skip
from companion.guidance.controller import Knowledge, Target
from companion.guidance.law.flown_course import course_of, track
from companion.guidance.law.follow_deck import FollowDeck, FollowDeckMemory, TuningChoice, chosen_tuning, tuned
from companion.guidance.law.gains import TiltWeights, tilt_model
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
from companion.guidance.law.response_fit import TiltFit, fit_tilt
from companion.guidance.law.response_watch import (
    CONTRADICTION_S,
    DELAY_MAX_S,
    ResponseIdentifier,
    ResponseWatch,
    asked,
    begun,
    judged,
    landed,
    reported,
    shaped,
)
from companion.guidance.pilot import make_pilot
from companion.settings.guidance import ClimbResponse, FollowDeckOptions, GuidanceOptions, Response, TiltResponse
from companion.settings.load import load, shipped, shipped_response
from estimator.contracts.commands import Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2, BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs, Stamp
from tests.companion.test_identify import drawn_flight, gauss_markov
from tests.make import body, estimate, ns

GIVEN = shipped_response("ardrone2")
SURE = structs.replace(GIVEN.tilt, delay_sigma_s=0.02)
KNOWN_S = 0.04
T = 0.02
ASSUMED = ResponseInUse(ResponseState.ASSUMED, GIVEN.tilt.delay_s, None)


@pytest.mark.parametrize(("sigma_s", "state"), [(0.039, ResponseState.KNOWN), (0.041, ResponseState.ASSUMED)])
def test_the_covariance_of_a_file_says_whether_its_delay_is_known(sigma_s: float, state: ResponseState) -> None:
    cov = ((sigma_s**2, 0.9 * sigma_s * 0.4, 0.0), (0.9 * sigma_s * 0.4, 0.16, 0.0), (0.0, 0.0, 0.01))
    tilt = TiltResponse(0.05, 3.82, 0.825, 0.073, cov_delay_frequency_damping=cov)
    assert begun(tilt, KNOWN_S).in_use.state is state
    later = ResponseInUse(ResponseState.IDENTIFIED, 0.15, 0.01, 0.1)
    assert tuned(tilt, TiltWeights(), chosen_tuning(later))[0].cov_delay_frequency_damping == cov


def leans(seed: int, seconds: float, size_m_s2: float) -> F64:
    """Return the commands of guidance against gusts, one row a cycle."""
    rng, n = np.random.default_rng(seed), round(seconds / T)
    keep = math.exp(-T / 1.0)
    out = np.zeros((n, 2))
    for k in range(1, n):
        out[k] = keep * out[k - 1] + size_m_s2 * math.sqrt(1.0 - keep * keep) * rng.standard_normal(2)
    return out


def answers(true: TiltResponse, u: F64, seed: int) -> F64:
    """Return the reports of the vehicle at each cycle, with errors that last for a second."""
    model, rng = tilt_model(true, T), np.random.default_rng(seed + 1)
    out = np.zeros_like(u)
    for axis in range(2):
        x = np.zeros(model.A.shape[0])
        for k in range(u.shape[0]):
            out[k, axis] = x[2]
            x = model.A @ x + model.B * u[k, axis]
        out[:, axis] += 0.05 + gauss_markov(rng, u.shape[0], 0.05, 2.0)
    return out


def watch_response(watch: ResponseWatch, u: F64, y: F64, late_s: float = 0.01) -> Iterator[tuple[ResponseWatch, ResponseWatch]]:
    """Yield the memory before and after each cycle."""
    for k in range(u.shape[0]):
        measured_at = ns(k * T)
        watch = reported(watch, Stamp(measured_at, MonoNs(measured_at + ns(late_s)), 0.002, "synced"), (y[k, 0], y[k, 1]))
        before, watch = watch, asked(watch, ns(k * T), Lean(u[k], np.zeros(2), np.zeros(3), 0.0), KNOWN_S)
        yield before, watch


@settings(max_examples=20, derandomize=True)
@given(st.integers(0, 1_000_000), st.floats(0.02, 0.35))
def test_the_delay_flown_with_comes_to_the_vehicles_own_and_never_by_one_fit(seed: int, delay_s: float) -> None:
    u = leans(seed, 16.0, 0.6)
    y = answers(structs.replace(GIVEN.tilt, delay_s=delay_s), u, seed)
    watch = begun(GIVEN.tilt, KNOWN_S)
    for before, after in watch_response(watch, u, y):
        if after.in_use is not before.in_use:
            assert before.doubt.state is after.in_use.state
            assert abs(before.doubt.delay_s - after.in_use.delay_s) <= CONTRADICTION_S
        watch = after
    if watch.in_use.state is ResponseState.ASSUMED:
        # A delay between agreement and contradiction leaves the gains soft.
        assert CONTRADICTION_S - 0.03 < abs(delay_s - GIVEN.tilt.delay_s) < 0.12
        return
    assert abs(watch.in_use.delay_s - delay_s) < CONTRADICTION_S + 3.0 * watch.in_use.sigma_s
    if watch.in_use.state is ResponseState.KNOWN:
        assert watch.in_use.delay_s == GIVEN.tilt.delay_s
    else:
        assert watch.in_use.longer_s == pytest.approx(watch.in_use.delay_s - GIVEN.tilt.delay_s)


@pytest.mark.parametrize(("delay_s", "too_late"), [(0.3, False), (0.38, False), (0.45, True)])
def test_a_delay_that_nothing_can_fly_with_is_reported_after_two_fits(delay_s: float, too_late: bool) -> None:
    u = leans(3, 16.0, 0.6)
    watch = begun(GIVEN.tilt, KNOWN_S)
    for before, after in watch_response(watch, u, answers(structs.replace(GIVEN.tilt, delay_s=delay_s), u, 3)):
        assert after.late_s is None or before.late_doubt
        watch = after
    assert (watch.late_s is not None) is too_late
    assert not too_late or watch.late_s == pytest.approx(delay_s, abs=0.03)
    assert landed(watch).late_s is None


def test_an_order_to_begin_again_ends_what_nothing_can_take_back() -> None:
    """WHY: a drone that was refused for late answers hovers: no answer of it is seen, and each order was refused at once."""
    landing = make_pilot(load("sim")).landing
    landing._response._watch = structs.replace(landing._response._watch, late_s=0.5, late_doubt=True)
    assert landing._response.late_s == 0.5
    landing.order(Event.BEGIN)
    assert landing._response.late_s is None


NOT_THIS_FLIGHT: dict[str, Callable[[F64, F64], tuple[F64, F64, float]]] = {
    "held by hand": lambda u, y: (u, gauss_markov(np.random.default_rng(9), 2 * u.shape[0], 0.5, 1.0).reshape(2, -1).T, 0.01),
    "standing still": lambda u, y: (u, np.zeros_like(u), 0.01),
    "degrees for radians": lambda u, y: (u, np.degrees(y), 0.01),
    "turned the wrong way": lambda u, y: (u, -y, 0.01),
    "axes swapped": lambda u, y: (u, y[:, ::-1], 0.01),
    "at its limit of tilt": lambda u, y: (5.0 * u, np.clip(5.0 * y, -0.6, 0.6), 0.01),
    "reports two seconds old": lambda u, y: (u, y, 2.0),
    "later than may be flown with": lambda u, y: (u, answers(structs.replace(GIVEN.tilt, delay_s=0.5), u, 5), 0.01),
}


@pytest.mark.parametrize("given_tilt", [GIVEN.tilt, SURE])
@pytest.mark.parametrize("kind", NOT_THIS_FLIGHT)
def test_what_is_not_this_vehicles_flight_changes_nothing(kind: str, given_tilt: TiltResponse) -> None:
    first, u = begun(given_tilt, KNOWN_S), leans(5, 16.0, 0.6)
    y = answers(structs.replace(GIVEN.tilt, delay_s=0.2), u, 5)
    for _, after in watch_response(first, *NOT_THIS_FLIGHT[kind](u, y)):
        assert after.in_use is first.in_use
        assert after.shape is AS_FILED


@pytest.mark.parametrize(("frequency", "damping"), [(0.75, 1.0), (1.25, 1.0), (1.0, 0.55), (0.5, 1.0), (1.0, 1.0)])
def test_a_vehicle_that_answers_otherwise_than_its_file_is_flown_by_its_own_frequency_and_damping(frequency, damping):
    u, watch = leans(5, 16.0, 0.6), begun(SURE, KNOWN_S)
    true = structs.replace(shaped(SURE, frequency, damping), delay_s=0.06)
    for before, after in watch_response(watch, u, answers(true, u, 5)):
        assert after.shape is before.shape or before.shape_doubt is not None, "never by one fit"
        watch = after
    differs = (frequency, damping) != (1.0, 1.0)
    assert (watch.shape is not AS_FILED) is differs
    assert watch.in_use.state is ResponseState.KNOWN, "the delay is the file's"
    if differs:
        assert watch.shape[:2] == pytest.approx((frequency, damping), rel=0.15)
        assert watch.shape.softer < 3.0, "no softer than it has to be"
        gains_for, weights = tuned(SURE, TiltWeights(), TuningChoice(0.0, False, watch.shape.slow, *watch.shape[1:3]))
        kept = margins(gains_for, true, weights=weights)
        assert kept.stable
        assert kept.phase_deg > 25.0
        assert kept.sensitivity < 2.3 < margins(SURE, true).sensitivity or frequency > 1.0


def test_the_same_course_without_the_nonsense_is_identified() -> None:
    u = leans(5, 16.0, 0.6)
    *_, (_, after) = watch_response(begun(SURE, KNOWN_S), u, answers(structs.replace(GIVEN.tilt, delay_s=0.2), u, 5))
    assert after.in_use.state is ResponseState.IDENTIFIED
    assert after.in_use.delay_s == pytest.approx(0.2, abs=0.04)
    assert landed(after).in_use is after.in_use, "the next flight begins with it"


@functools.cache
def some_fit() -> TiltFit:
    fit = fit_tilt(drawn_flight(1, 0.5)[1], GIVEN.tilt)
    assert fit is not None
    return fit


def fit_of(delay_s: float, sigma_s: float) -> TiltFit:
    fit = some_fit()
    cov = fit.fitted.cov.copy()
    cov[0, 0] = sigma_s**2
    return structs.replace(fit, response=structs.replace(fit.response, delay_s=delay_s), fitted=fit.fitted._replace(cov=cov))


@given(st.floats(0.0, DELAY_MAX_S), st.floats(0.0, 0.2), st.sampled_from([None, 0.02, 0.1]), st.floats(0.0, DELAY_MAX_S))
def test_a_fit_confirms_contradicts_or_decides_nothing(delay_s, sigma_s, file_sigma_s, flown_with_s):
    tilt = structs.replace(GIVEN.tilt, delay_sigma_s=file_sigma_s)
    found = ResponseInUse(ResponseState.IDENTIFIED, flown_with_s, 0.01, flown_with_s - tilt.delay_s)
    for in_use in (begun(tilt, KNOWN_S).in_use, found):
        output = judged(in_use, tilt, fit_of(delay_s, sigma_s), KNOWN_S)
        if output is in_use:
            continue
        assert sigma_s <= KNOWN_S + 1e-12
        if output.state is ResponseState.ASSUMED:
            assert in_use is found, "nothing known is forgotten but a longer delay"
            assert delay_s < tilt.delay_s == output.delay_s
            continue
        assert output.delay_s >= tilt.delay_s, "no shorter delay is flown with"
        if output.state is ResponseState.KNOWN:
            assert output.delay_s == tilt.delay_s
            assert output.longer_s == 0.0
        assert abs(output.delay_s - delay_s) <= CONTRADICTION_S
        if output.delay_s != in_use.delay_s:
            assert abs(delay_s - in_use.delay_s) > max(CONTRADICTION_S, 3.0 * sigma_s)


def test_a_delay_that_may_be_longer_is_not_taken_for_the_files() -> None:
    # Why: 80 ms more with a sigma of 35 ms is no contradiction yet, and stiff gains do not stand it.
    assert judged(ASSUMED, GIVEN.tilt, fit_of(0.13, 0.035), KNOWN_S) is ASSUMED
    assert judged(ASSUMED, GIVEN.tilt, fit_of(0.13, 0.025), KNOWN_S).state is ResponseState.IDENTIFIED
    assert judged(ASSUMED, GIVEN.tilt, fit_of(0.06, 0.035), KNOWN_S).state is ResponseState.KNOWN


# --- the gains -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shipped("responses"))
def test_every_response_that_may_be_flown_by_keeps_the_margin_of_60_ms(name: str) -> None:
    tilt = shipped_response(name).tilt
    for delay_s in (0.0, 0.1, 0.2, 0.3, DELAY_MAX_S):
        longer_s = delay_s - tilt.delay_s
        response, weights = tuned(tilt, TiltWeights(), TuningChoice(longer_s))
        found = margins(response, structs.replace(tilt, delay_s=delay_s), weights=weights)
        assert found.stable
        assert found.delay_s >= 0.06
    soft, weights = tuned(tilt, TiltWeights(), TuningChoice(soft=True))
    assert margins(soft, tilt, weights=weights).delay_s > 1.8 * margins(tilt).delay_s
    late = structs.replace(tilt, delay_s=tilt.delay_s + 0.1)
    assert margins(soft, late, weights=weights).stable


TARGET = Target(np.array([0.0, 0.0, 1.0]))


def over(k: int, response: ResponseInUse | None) -> Knowledge:
    """Return a drone that sways over a deck that heaves."""
    at, t = ns(k * T), k * T
    d = np.array([0.1 * math.sin(0.5 * t), 0.08 * math.cos(0.4 * t), 1.05 + 0.1 * math.sin(0.6 * t)])
    v = np.array([0.05 * math.cos(0.5 * t), -0.032 * math.sin(0.4 * t), 0.06 * math.cos(0.6 * t)])
    lean = Rotation.from_rpy(0.02 * math.sin(0.8 * t), 0.02 * math.cos(0.7 * t), 0.4)
    body = BodyMotion(
        at, 0.4, np.array([0.2 * math.sin(2.0 * t), 0.1, 0.1]), 1e-4 * np.eye(3), np.zeros(3), lean, 1e-4 * np.eye(3)
    )
    rising = np.array([0.0, 0.0, 0.3 * math.sin(0.8 * t)])
    deck = DeckMotion(at, rising, np.array([0.0, 0.0, 0.24 * math.cos(0.8 * t)]), 1e-4 * np.eye(6), *(0.0,) * 4, np.zeros((4, 4)))
    return Knowledge(at, RelativeState(at, "ekf", d, v, 0.0, 1e-4 * np.eye(7), at, True), body, deck, response=response)


def differences(before: ResponseInUse | None, found: list[ResponseInUse], cycles: int) -> F64:
    """Return the difference between a law that learns other responses, one each 0.4 s, and one that does not, by cycle."""
    law = FollowDeck(GIVEN, T)
    memory: FollowDeckMemory = law.start()
    for k in range(100):
        memory, _ = law.step(memory, over(k, before).at, over(k, before), TARGET)
    stays, turns, out = memory, memory, []
    for k in range(100, 100 + cycles):
        after = found[min((k - 100) // 20, len(found) - 1)]
        stays, a = law.step(stays, over(k, before).at, over(k, before), TARGET)
        turns, b = law.step(turns, over(k, after).at, over(k, after), TARGET)
        lean = float(np.hypot(*(b.a_level + b.trim_level - a.a_level - a.trim_level)))
        out.append([lean, abs(float(b.v_level[2] - a.v_level[2])), float(np.hypot(*(b.v_level - a.v_level)[:2]))])
        # The two go on from the same commands, so that what differs is this cycle's alone.
        stays = structs.replace(stays, core=turns.core)
    return np.array(out)


KNOWN = replace(ASSUMED, state=ResponseState.KNOWN, sigma_s=0.02)
LATER = ResponseInUse(ResponseState.IDENTIFIED, 0.2, 0.02, 0.15)


@pytest.mark.parametrize(
    ("before", "found"), [(ASSUMED, [KNOWN]), (ASSUMED, [LATER]), (KNOWN, [LATER]), (None, [LATER]), (ASSUMED, [KNOWN, LATER])]
)
def test_other_gains_come_without_a_bump(before: ResponseInUse | None, found: list[ResponseInUse]) -> None:
    off = differences(before, found, 120)
    assert off[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9), "the cycle of the switch commands what it would have"
    assert off[50:].max(axis=0)[0] > 0.1, "after a second the gains are others"
    largest_step = np.abs(np.diff(off, axis=0)).max(axis=0)
    assert (largest_step <= 0.1 * off.max(axis=0) + 1e-12).all(), "a jump would be all of it in one cycle"


# --- the pilot's part ------------------------------------------------------------------------------------------------------


def identified_by(guidance: GuidanceOptions, tilt: TiltResponse, **other: Any) -> tuple[ResponseIdentifier, list[ResponseInUse]]:
    identifier, noted = ResponseIdentifier(tilt, guidance), []
    u = leans(5, 16.0, 0.6)
    y = answers(structs.replace(GIVEN.tilt, delay_s=0.2), u, 5)
    for k in range(round(other.get("ends_s", 16.0) / T)):
        identifier.on_attitude(Stamp(ns(k * T), ns(k * T + 0.01), 0.002, "synced"), (y[k, 0], y[k, 1]))
        command = other.get("command") or Lean(u[k], np.zeros(2), np.zeros(3), 0.0)
        state = State.TAKEN if k * T >= other.get("taken_s", math.inf) else other.get("state", State.DESCEND)
        found = identifier.on_command(ns(k * T), command, state, flown=other.get("flown", True))
        noted += [] if found is None else [found]
    return identifier, noted


def test_softer_gains_and_a_contradiction_are_reported_once_each() -> None:
    identifier, noted = identified_by(GuidanceOptions(), GIVEN.tilt)
    assert [one.state for one in noted] == [ResponseState.ASSUMED, ResponseState.IDENTIFIED]
    assert identifier.in_use is noted[-1]
    assert "softer gains" in noted[0].text
    assert "ms longer than its response file says" in noted[1].text
    _, noted = identified_by(GuidanceOptions(), SURE)
    assert [one.state for one in noted] == [ResponseState.IDENTIFIED], "that the file holds is nothing to tell"


BY_OTHERS = (State.STANDBY, State.COMMIT, State.PRESS, State.DOWN, State.LANDED, State.TAKEN)


@pytest.mark.parametrize("other", [*({"state": state} for state in BY_OTHERS), {"flown": False}])
def test_a_drone_that_touches_something_or_flies_by_others_reports_nothing(other: dict[str, Any]) -> None:
    identifier, noted = identified_by(GuidanceOptions(), GIVEN.tilt, **other)
    assert identifier.in_use == ASSUMED
    assert noted in ([], [ASSUMED])


def test_cycles_that_come_late_are_not_learned_from() -> None:
    for period_s, learned in ((0.2, True), (0.3, False)):
        flown = course_of(track([(period_s * k, 0.1, 0.0) for k in range(50)]), track([(T * k, 0.1, 0.0) for k in range(500)]))
        assert flown.counts.any() == learned


@pytest.mark.parametrize("at_s", [5.1, 5.5, 6.1, 6.5, 7.1])
def test_nothing_more_is_decided_once_another_has_the_vehicle(at_s: float) -> None:
    taken, cut = (identified_by(GuidanceOptions(), GIVEN.tilt, **{key: at_s})[0].in_use for key in ("taken_s", "ends_s"))
    assert taken == cut


@pytest.mark.parametrize(
    "guidance", [GuidanceOptions(follow_deck=FollowDeckOptions(identify=False)), GuidanceOptions(controller="pid")]
)
def test_without_identification_the_file_is_flown_as_it_is(guidance: GuidanceOptions) -> None:
    identifier, noted = identified_by(guidance, GIVEN.tilt)
    assert noted == []
    assert identifier.in_use is None


def test_reports_do_not_pile_up_while_nobody_decides() -> None:
    watch = begun(GIVEN.tilt, KNOWN_S)
    for k in range(3000):
        watch = reported(watch, Stamp(ns(k * T), ns(k * T), 0.002, "synced"), (0.0, 0.0))
    assert len(watch.reported) <= 500


def test_every_shipped_response_of_a_real_vehicle_is_only_assumed() -> None:
    # Why: nobody has flown these vehicles to measure them, and a file that claims more gets stiff gains from the first second.
    # The others are of simulated vehicles, which were flown.
    known_s = load("sim").guidance.follow_deck.delay_known_s
    states = {name: begun(shipped_response(name).tilt, known_s).in_use.state for name in shipped("responses")}
    assert {name for name, state in states.items() if state is ResponseState.ASSUMED} == {"ardrone2", "autopilot", "px4"}
    assert {name for name, state in states.items() if state is ResponseState.KNOWN} == {"quad_1_5kg", "hexa_7kg"}


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
    law = FollowDeck(Response(assumed, ClimbResponse(0.1, 0.1)), PERIOD_S)
    model, memory, out = tilt_model(true, PERIOD_S), law.start(), np.empty((cycles + 1, 3))
    x = np.zeros(len(model.A))
    for k in range(-1, cycles):  # the law begins with a cycle at rest
        by = pushes[k] if 0 <= k < len(pushes) else Pushed()
        t, reported = (k + 1) * PERIOD_S, Rotation.from_rpy(0.0, -math.atan(SMALL * x[2] / G_M_S2), 0.0)
        at = estimate(t, (SMALL * (x[0] + by.place), 0.0, 1.0), (SMALL * (x[1] + by.speed), 0.0, 0.0), sigma=0.01)
        moves = body(t, (SMALL * (x[2] + by.accel + by.gust - by.tilt), 0.0, 0.0), (0.0, -SMALL * x[3] / G_M_S2, 0.0), reported)
        memory, command = law.step(memory, ns(t), Knowledge(ns(t), at, moves), Target(np.array([0.0, 0.0, 1.0])))
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
