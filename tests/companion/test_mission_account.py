"""Accounts in the machine's memory after a guidance cycle, before the events are determined."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from companion.base.mission import FLOWN, State
from companion.base.reason import Reason, ReasonCause
from companion.base.response_in_use import ResponseInUse, ResponseState
from companion.guidance.controller import Knowledge
from companion.guidance.mission.cycle import GuidanceCycle, VesselPosition
from companion.guidance.mission.limits import InputQuality
from companion.guidance.mission.progress import Attempt, HeadingMemory, Progress
from companion.guidance.mission.watch import account
from companion.settings.guidance import GuidanceOptions
from tests.companion.mission_flights import estimate, guided, ns

NOW = 100.0
OPTIONS = GuidanceOptions()
SAFE_M = 2.0 - 0.25


def memory(state: State, **more: Any) -> Progress:
    """Return a memory whose last cycle was 20 ms ago and saw pad 1 at a metre."""
    fields: dict[str, Any] = {
        "automatic": True, "since": ns(NOW - 1.0), "last": ns(NOW - 0.02), "seen": ns(NOW - 0.02), "seen_height_m": 1.0,
        "in_sight": True, "track": 1,
    }  # fmt: skip
    return Progress(state, **{**fields, **more})


def seen(height_m: float = 1.0, *, aside_m: float = 0.0, **more: Any):
    return estimate(NOW, (aside_m, 0.0, height_m), **more)


def after(p: Progress, relative: Any = None, o: GuidanceOptions = OPTIONS, **more: Any) -> Progress:
    response = more.pop("response", None)
    return account(p, GuidanceCycle(ns(NOW), Knowledge(ns(NOW), relative, response=response), **more), o)


# Time


def test_a_cycle_s_time_is_charged_once_and_never_backward() -> None:
    for last_s, since_last_s in ((NOW - 0.02, 0.02), (NOW + 5.0, 0.0), (None, 0.0)):
        p = after(memory(State.READY, last=None if last_s is None else ns(last_s)))
        assert (p.last, p.since_last_s) == (ns(NOW), pytest.approx(since_last_s))
    assert after(memory(State.READY, since=None)).since == ns(NOW)
    assert after(memory(State.READY)).since == ns(NOW - 1.0)


@pytest.mark.parametrize(("silent_s", "silent"), [(0.3, False), (0.301, True)])
def test_a_silent_vehicle_may_not_have_climbed_until_the_pad_is_seen_again(silent_s: float, silent: bool) -> None:
    p = after(memory(State.GO_AROUND, climbs_m_s=0.5, climbed_m=1.0), silent_s=silent_s)
    assert (p.climbed_m, p.was_silent) == (pytest.approx(1.0 if silent else 1.01), silent)
    p = after(replace(p, was_silent=True), seen(), silent_s=0.1)
    assert (p.climbed_m, p.was_silent) == (0.0, False)


def test_only_a_landing_that_is_flown_is_accounted_for() -> None:
    for state in set(State) - FLOWN:
        p = after(memory(state, in_sight=False, seen=None), seen(0.5))
        assert (p.seen, p.in_sight, p.attempt) == (None, False, Attempt())


# Sight


@pytest.mark.parametrize("state", sorted(FLOWN - {State.ANOTHER_PAD}, key=str))
def test_sight_is_noted_with_its_height_its_track_and_its_heading(state: State) -> None:
    turned = Reason(ReasonCause.HEADING_TURNED, 170.0, 90.0)
    p = after(memory(state, heading=HeadingMemory(0.1), attempt=Attempt(with_sight_s=1.0)), seen(0.7, yaw=0.2, track=1))
    assert (p.in_sight, p.seen, p.seen_height_m, p.track, p.heading) == (True, ns(NOW), 0.7, 1, HeadingMemory(0.2))
    assert (p.attempt.began, p.attempt.with_sight_s, p.turned) == (ns(NOW), pytest.approx(1.02), None)
    assert p.landing_began == ns(NOW)
    assert after(replace(p, landing_began=ns(7.0)), seen()).landing_began == ns(7.0), "the first sight of all"
    assert after(memory(state, track=None), seen(track=6)).track == 6
    opposite = after(memory(state, heading=HeadingMemory(0.1)), seen(yaw=3.1))
    assert opposite.turned is not None
    assert opposite.turned.cause is ReasonCause.HEADING_TURNED
    assert after(memory(state, heading=HeadingMemory(0.1), turned=turned), seen(yaw=0.2)).turned == turned, "not forgotten"


@pytest.mark.parametrize("relative", [None, seen(0.5, track=2), seen(0.5, age=0.51), seen(0.5, consistent=False)])
def test_without_a_fit_estimate_of_its_pad_there_is_no_sight(relative: Any) -> None:
    p = after(memory(State.HOLD_BLIND, attempt=Attempt(with_sight_s=3.0)), relative)
    assert (p.in_sight, p.seen, p.seen_height_m, p.track) == (False, ns(NOW - 0.02), 1.0, 1)
    assert p.attempt == Attempt(losses=1, without_sight_s=p.since_last_s)
    assert after(memory(State.SEARCH, seen=None, in_sight=False), relative).attempt.without_sight_s == 0.0, "never seen yet"
    any_pad = after(memory(State.DESCEND, track=None), seen(0.5, track=2))
    assert (any_pad.in_sight, any_pad.track) == (True, 2)


@pytest.mark.parametrize(
    ("state", "height_m", "in_sight", "counts"),
    [
        (State.DESCEND, SAFE_M - 0.001, True, True), (State.DESCEND, SAFE_M, True, False), (State.DESCEND, 0.5, False, False),
        (State.COMMIT, 0.5, True, False), (State.GATE, 0.5, True, True),
    ],
)  # fmt: skip
def test_a_loss_of_sight_counts_low_over_the_deck_and_once(state: State, height_m: float, in_sight: bool, counts: bool) -> None:
    assert after(memory(state, seen_height_m=height_m, in_sight=in_sight)).attempt.losses == counts


@pytest.mark.parametrize(
    ("state", "in_sight", "seen_s", "lost_m"),
    [
        (State.HOLD_BLIND, False, 1.0, 0.4), (State.HOLD_BLIND, True, 1.0, 0.0), (State.HOLD_BLIND, False, None, 0.0),
        (State.GO_AROUND, False, 1.0, 0.0),
    ],
)  # fmt: skip
def test_height_that_was_lost_without_sight_is_charged(
    state: State, in_sight: bool, seen_s: float | None, lost_m: float
) -> None:  # fmt: skip
    p = memory(state, in_sight=in_sight, seen=None if seen_s is None else ns(seen_s))
    assert after(p, seen(0.6)).attempt.blind_descent_m == pytest.approx(lost_m)


@pytest.mark.parametrize(
    ("height_m", "longer_s", "low"), [(0.164, 0.0, True), (0.166, 0.0, False), (0.244, 0.2, True), (0.246, 0.2, False)]
)
def test_just_over_the_deck_there_is_no_return_for_a_moment(height_m: float, longer_s: float, low: bool) -> None:
    """0.3 s to the contact of the feet at 0.4 m/s, 0.045 m below the body, and what the vehicle is later than its file says."""
    response = ResponseInUse(ResponseState.IDENTIFIED, 0.3, 0.01, longer_s)
    p = after(memory(State.COMMIT, no_return_until=ns(1.0)), seen(height_m), response=response)
    assert p.no_return_until == (ns(NOW + 0.3) if low else None)
    assert after(memory(State.DESCEND), seen(height_m), response=response).no_return_until is None
    assert after(memory(State.COMMIT, no_return_until=ns(7.0))).no_return_until == ns(7.0), "it stands without sight"


# The ship


def test_the_way_to_the_ship_and_her_place_are_noted_and_the_search_goes_on_from_corner_to_corner() -> None:
    over = VesselPosition(ns(NOW), np.array([0.1, 0.0]), 1.0, np.zeros(2), 0.0, True, 6.0)
    beside = VesselPosition(ns(NOW), np.array([5.0, 0.0]), 1.0, np.zeros(2), 0.0, True, 6.0)
    for state in (State.RENDEZVOUS, State.SEARCH, State.INTERCEPT):
        p = after(memory(state), vessel=over)
        assert p.on_way == (ns(NOW) if state is State.RENDEZVOUS else None)
        assert p.place_known == ns(NOW)
        assert p.search_leg == (1 if state is State.SEARCH else 0)
        assert after(memory(state), vessel=beside).search_leg == 0
        assert after(memory(state), vessel=Reason(ReasonCause.VESSEL_SILENT)).place_known is None


# The gate


def test_time_at_the_gate_is_charged_in_the_gate() -> None:
    used = Attempt(over_pad_s=1.0, in_descent_s=2.0, at_gate_s=3.0)
    for state, spent in ((State.INTERCEPT, 0), (State.DESCEND, 1), (State.GATE, 2), (State.HOLD_BLIND, None)):
        p = after(memory(state, attempt=used), seen(0.3)).attempt
        expected = [seconds + 0.02 * (i == spent) for i, seconds in enumerate((1.0, 2.0, 3.0))]
        assert [p.over_pad_s, p.in_descent_s, p.at_gate_s] == pytest.approx(expected)


def test_what_keeps_the_gate_shut_is_noted_and_since_when_nothing_does() -> None:
    p = after(memory(State.GATE), seen(0.3))
    assert (p.blocked, p.good_since, p.waits_for) == (None, ns(NOW), None)
    assert after(memory(State.GATE, good_since=ns(99.0)), seen(0.3)).good_since == ns(99.0)
    for relative, cause in (
        (seen(0.3, aside_m=0.09), ReasonCause.ERROR),
        (seen(0.3, age=0.6), ReasonCause.STALE),
        (None, ReasonCause.NO_ESTIMATE),
    ):
        p = after(memory(State.GATE, good_since=ns(99.0)), relative)
        assert p.blocked is not None
        assert (p.blocked.cause, p.good_since, p.waits_for, p.waits_since) == (cause, None, p.blocked, ns(NOW))
        elsewhere = after(memory(State.DESCEND, good_since=ns(99.0)), relative)
        assert (elsewhere.blocked, elsewhere.good_since) == (None, ns(99.0))
    unsure = after(memory(State.GATE), seen(0.3), quality=InputQuality(normalized_nis=4.1))
    assert unsure.blocked is not None
    assert unsure.blocked.cause is ReasonCause.NIS
    across = seen(0.3, yaw=1.0)
    assert after(memory(State.GATE), across).blocked is None
    aligned = after(memory(State.GATE), across, guided(tries={"heading": "align"}))
    assert aligned.blocked is not None
    assert aligned.blocked.cause is ReasonCause.HEADING


@pytest.mark.parametrize(("stood_s", "stands"), [(1.999, True), (2.0, False)])
def test_the_operator_sees_one_cause_for_two_seconds(stood_s: float, stands: bool) -> None:
    old = Reason(ReasonCause.SIGMA, 0.2, 0.15)
    p = after(memory(State.GATE, waits_for=old, waits_since=ns(NOW - stood_s)), seen(0.3, aside_m=0.09))
    assert (p.waits_for == old) is stands
    assert p.waits_since == ns(NOW - stood_s if stands else NOW)
    assert p.blocked is not None
    assert p.blocked.cause is ReasonCause.ERROR


@pytest.mark.parametrize(
    ("d", "v", "sigma", "cause", "figure"),
    [
        ((0.1, 0.0, 0.3), (0.0, 0.0), 0.01, None, 0.0),
        ((0.3, 0.1, 0.3), (0.0, 0.0), 0.01, ReasonCause.ERROR, math.hypot(0.2, 0.1)),
        ((0.1, 0.0, 0.43), (0.0, 0.0), 0.01, ReasonCause.ERROR, 0.0),
        ((0.1, 0.0, 0.3), (0.0, 0.0), 0.16, ReasonCause.SIGMA, 0.16),
        ((0.1, 0.05, 0.3), (0.15, 0.1), 0.01, ReasonCause.ERROR_AHEAD, math.hypot(0.09, 0.11)),
        ((0.1, 0.05, 0.3), (0.15, -0.1), 0.01, None, 0.0), ((0.1, 0.0, 0.3), (0.19, 0.0), 0.01, None, 0.0),
        ((0.1, 0.0, 0.3), (0.21, 0.0), 0.01, ReasonCause.ERROR_AHEAD, 0.126),
    ],
)  # fmt: skip
def test_the_thesis_gate_opens_over_the_last_way_point_now_and_at_the_touchdown(d, v, sigma, cause, figure):
    """0.12 m about it, and 0.6 s ahead at the present velocity; the pad is kept 0.1 m ahead of the body."""
    o = guided("thesis", thesis={"pad_ahead_m": 0.1})
    found = after(memory(State.GATE), estimate(NOW, d, (*v, 0.0), sigma=sigma), o).blocked
    if cause is None:
        assert found is None
        return
    assert found is not None
    limit = 0.15 if cause is ReasonCause.SIGMA else 0.12
    assert (found.cause, found.measured, found.limit) == (cause, pytest.approx(figure, abs=1e-12), limit)


# Another pad


def test_another_pad_is_in_steady_sight_since_its_track_began() -> None:
    p = memory(State.ANOTHER_PAD, track=None, newest_track=None)
    first = after(p, seen(track=5))
    assert (first.newest_track, first.good_since, first.in_sight, first.seen) == (5, ns(NOW), p.in_sight, p.seen)
    going = replace(p, newest_track=5, good_since=ns(98.0))
    assert after(going, seen(track=5)).good_since == ns(98.0)
    assert after(going, seen(track=6)).good_since == ns(NOW)
    for lost in (None, seen(track=5, age=0.6), seen(track=5, consistent=False)):
        assert (after(going, lost).good_since, after(going, lost).newest_track) == (None, 5)
