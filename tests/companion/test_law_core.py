"""The law's memory in the core, and what a law without a forecast does not look at."""

import math

import numpy as np
import pytest
from msgspec import structs

from companion.base.response_in_use import ResponseInUse
from companion.guidance.controller import Knowledge, Target
from companion.guidance.law.follow_deck import FollowDeck
from companion.guidance.law.records import law_params
from companion.settings.load import shipped_response
from estimator.contracts.commands import Lean
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.motion import BodyMotion, DeckMotion
from estimator.contracts.time import MonoNs
from estimator.core.abi import DL_UNDER_WAY_MAX
from estimator.core.library import CORE
from estimator.ekf import Forecast
from tests.companion.law_memory import packed, plain

T = 0.02
SHIPPED = shipped_response("ardrone2")


def forecast(rng: np.random.Generator, at: int) -> Forecast:
    horizons = np.array([0.0, *np.cumsum(rng.uniform(0.05, 0.6, 4))])
    n, z = horizons.size, np.zeros(horizons.size)
    rates = rng.normal(size=(n, 3))
    return Forecast(MonoNs(at), horizons, np.zeros((n, 3)), np.zeros((n, 3, 3)), rates, z, z, z, z, z, z, z, z)


def cycle(rng: np.random.Generator, at: int, made: Forecast | None, response: ResponseInUse | None) -> Knowledge:
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


def test_a_memory_of_plain_values_is_the_core_s() -> None:
    rng, law = np.random.default_rng(3), FollowDeck(SHIPPED, T, over_ground=True)
    memory = law.start()
    for k in range(5):
        known = cycle(rng, 20_000_000 * k, None, None)
        memory, _ = law.step(memory, known.at, known, Target(np.array([0.0, 0.0, 1.0])))
    again = packed(plain(memory, law._remembered, over_ground=True))
    assert bytes(CORE.ffi.buffer(again.core)) == bytes(CORE.ffi.buffer(memory.core))


def test_the_law_keeps_as_many_commands_as_the_core_has_room_for() -> None:
    law_params(SHIPPED.tilt, SHIPPED.climb, T, DL_UNDER_WAY_MAX, looks_ahead=True, over_ground=False)
    with pytest.raises(ValueError, match=f"the law keeps {DL_UNDER_WAY_MAX}"):
        law_params(SHIPPED.tilt, SHIPPED.climb, T, DL_UNDER_WAY_MAX + 1, looks_ahead=True, over_ground=False)


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
