"""The law as the core steps it beside the plain one: the same commands and the same memory, cycle by cycle."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from estimator.core.abi import UNDER_WAY_MAX
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.base.response_in_use import ResponseInUse, ResponseState
from companion.guidance import law_records
from companion.guidance.controller import Knowledge, Target
from companion.guidance.follow_deck import FollowDeck
from companion.guidance.view import FieldOfView
from companion.settings.load import shipped_response
from companion.settings.response import Response
from estimator.contracts.commands import Hover, Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs
from estimator.ekf import Forecast
from tests.companion.oracle.follow_deck import OracleLaw, OracleMemory
from tests.companion.oracle.memory import packed, plain

T = 0.02
SHIPPED = shipped_response("ardrone2")
RESPONSES = (
    SHIPPED,
    Response(structs.replace(SHIPPED.tilt, lag_s=0.0, delay_s=0.01), structs.replace(SHIPPED.climb, delay_s=0.0)),
    Response(structs.replace(SHIPPED.tilt, delay_s=0.3), structs.replace(SHIPPED.climb, delay_s=0.25)),
)
LAWS: tuple[tuple[Response, dict[str, Any]], ...] = (
    (RESPONSES[0], {"view": FieldOfView(0.05, -0.02, 0.45, 0.7)}),
    (RESPONSES[1], {"over_ground": True}),
    (RESPONSES[2], {"forecast": False}),
)
IN_USE = (
    None,
    ResponseInUse(ResponseState.ASSUMED, 0.05, None),
    ResponseInUse(ResponseState.KNOWN, 0.05, 0.01),
    ResponseInUse(ResponseState.IDENTIFIED, 0.2, 0.02, 0.05),
)


AHEAD_S = (0.0, T, SHIPPED.tilt.slowness_s, T * max(1, round(SHIPPED.climb.delay_s / T)), 0.5)
"""Times at which the shipped law asks for the deck, as the horizons of some forecasts: a line ends there and another begins."""


def forecast(rng: np.random.Generator, at: int) -> Forecast:
    if rng.random() < 0.5:
        horizons = np.array(AHEAD_S[: rng.integers(2, len(AHEAD_S) + 1)])
    else:
        horizons = np.array([0.0, *np.cumsum(rng.uniform(0.05, 0.6, rng.integers(1, 5)))])
    n, z = horizons.size, np.zeros(horizons.size)
    rates = rng.normal(size=(n, 3))
    return Forecast(MonoNs(at), horizons, np.zeros((n, 3)), np.zeros((n, 3, 3)), rates, z, z, z, z, z, z, z, z)


def cycle(rng: np.random.Generator, at: int, made: Forecast | None, response: ResponseInUse | None) -> Knowledge:
    """What is known in one cycle: any state that a flight might have, and some that none has."""
    now, heading = MonoNs(at), rng.uniform(-math.pi, math.pi)
    var = 10.0 ** rng.uniform(-5.0, -1.0, 2)
    d = rng.normal(size=3) * [1.0, 1.0, 3.0]
    yaw = None if rng.random() < 0.2 else rng.uniform(-math.pi, math.pi)
    relative = RelativeState(now, "ekf", d, rng.normal(size=3), yaw, np.diag([*var, *[1e-4] * 5]), now, True)
    roll, pitch = rng.normal(scale=0.1, size=2).tolist()
    lean = Rotation.from_rpy(roll, pitch, heading)
    body = BodyMotion(now, heading, rng.normal(size=3), 1e-4 * np.eye(3), rng.normal(size=3), lean, 1e-4 * np.eye(3))
    deck = DeckMotion(now, rng.normal(size=3), rng.normal(size=3), 1e-4 * np.eye(6), 0.0, 0.0, 0.0, 0.0, np.zeros((4, 4)))
    return Knowledge(now, relative, body, None if rng.random() < 0.2 else deck, made, response=response)


def target(rng: np.random.Generator) -> Target | None:
    if rng.random() < 0.2:
        return None
    rate, yaw, lean = (None if rng.random() < 0.5 else rng.normal() for _ in range(3))
    lean = None if lean is None else abs(0.1 * lean)
    return Target(rng.normal(size=3), rate, np.zeros(3), rng.uniform(0.1, 2.0), rng.uniform(0.1, 4.0), yaw, lean)


def flat(memory: OracleMemory) -> list[float]:
    """Every number of a memory."""
    out = [memory.pushed_down_m_s2, memory.share, *memory.climbs, *(memory.turn or ())]
    for axis in memory.axes or ():
        out += [*structs.astuple(axis.seen), axis.lean, axis.rate, axis.lag, *axis.under_way]
    return out + [number for part in memory.own or () for number in part]


@pytest.mark.parametrize(("response", "options"), LAWS)
@given(st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_each_cycle_has_the_plain_law_s_command_and_memory(response: Response, options: dict[str, Any], seed: int) -> None:
    rng = np.random.default_rng(seed)
    law, oracle = FollowDeck(response, T, **options), OracleLaw(response, T, **options)
    memory, expected, at, made, in_use = law.start(), oracle.start(), 0, None, None
    for _ in range(40):
        at += int(rng.choice([20_000_000, 20_000_000, 20_000_000, 0, 31_000_000, 500_000_000, 500_000_001, -7_000_000]))
        if rng.random() < 0.2:
            made = None if rng.random() < 0.3 else forecast(rng, at - int(rng.integers(-1, 6)) * 100_000_000)
        if rng.random() < 0.1:
            in_use = IN_USE[rng.integers(len(IN_USE))]
        known, wanted = cycle(rng, at, made, in_use), target(rng)
        memory, command = law.step(memory, known.at, known, wanted)
        expected, plainly = oracle.step(expected, known.at, known, wanted)
        found = plain(memory, law._remembered, over_ground=options.get("over_ground", False))
        assert (found.at, found.tuning, found.tuning_before) == (expected.at, expected.tuning, expected.tuning_before)
        assert (found.turn is None, found.own is None) == (expected.turn is None, expected.own is None)
        np.testing.assert_allclose(flat(found), flat(expected), rtol=1e-12, atol=1e-12)
        if isinstance(plainly, Hover):
            assert command == plainly
            continue
        assert isinstance(command, Lean)
        for one, other in (
            (command.a_level, plainly.a_level), (command.trim_level, plainly.trim_level), (command.v_level, plainly.v_level),
            (command.yaw_rate_rad_s, plainly.yaw_rate_rad_s),
        ):  # fmt: skip
            np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_a_memory_of_plain_values_is_the_core_s() -> None:
    rng, law = np.random.default_rng(3), FollowDeck(SHIPPED, T, over_ground=True)
    memory = law.start()
    for k in range(5):
        known = cycle(rng, 20_000_000 * k, None, None)
        memory, _ = law.step(memory, known.at, known, Target(np.array([0.0, 0.0, 1.0])))
    again = packed(plain(memory, law._remembered, over_ground=True))
    assert again.words.tolist() == memory.words[: again.words.size].tolist()


def test_the_law_keeps_as_many_commands_as_the_core_has_room_for() -> None:
    law_records.packed_params(SHIPPED.tilt, SHIPPED.climb, T, UNDER_WAY_MAX, looks_ahead=True, over_ground=False)
    with pytest.raises(ValueError, match=f"the law keeps {UNDER_WAY_MAX}"):
        law_records.packed_params(SHIPPED.tilt, SHIPPED.climb, T, UNDER_WAY_MAX + 1, looks_ahead=True, over_ground=False)


def test_a_deck_that_is_not_looked_at_stands_still() -> None:
    rng, still = np.random.default_rng(5), FollowDeck(SHIPPED, T, forecast=False)
    known = cycle(rng, 0, forecast(rng, 0), None)
    over = Target(np.array([0.0, 0.0, 1.0]))
    _, command = still.step(still.start(), known.at, known, over)
    assert isinstance(command, Lean)
    bare = structs.replace(known, forecast=None, deck=None)
    _, plainly = still.step(still.start(), bare.at, bare, over)
    assert isinstance(plainly, Lean)
    assert command.a_level.tolist() == plainly.a_level.tolist()
