"""A velocity that lies against the accelerometer, in sight of the pad and out of it (own truth)."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, BodyVelocity, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity import inertial
from estimator.integrity.inertial import Inertial
from estimator.integrity.options import IntegrityOptions

OPTIONS = IntegrityOptions()
DT, BEGIN_S = 0.01, 3.0
Change = Callable[[F64, float], F64]


def flown(
    velocity: Change,
    *,
    seen: bool,
    blind_from: float = math.inf,
    size_m_s: float = 0.8,
    deck_m_s: float = 0.0,
    accelerometer: F64 | None = None,
    since: float = BEGIN_S,
    until: float = 9.0,
    seed: int = 1,
) -> list[Inertial]:
    """Return the states of a body that swings to and fro over a deck that does, every `DT`.

    Args:
        velocity: what the sensor makes of the velocity against the deck, (2,) m/s, with the time for which it lies, s.
        seen: the pad's sightings come, 30 a second, until `blind_from`, s.
        deck_m_s: size of the deck's own swing.
        accelerometer: what it adds to the specific force from `since` on, s, (3,) m/s^2.
    """
    rng, state, out = np.random.default_rng(seed), Inertial(), list[Inertial]()
    p = np.zeros(2)
    for n in range(round(until / DT)):
        t = n * DT
        stamp = Stamp(MonoNs(round(t * 1e9)), MonoNs(round(t * 1e9)), 0.001, "sim")
        phases = np.array([1.7 * t, 1.3 * t + 1.0])
        own, a = size_m_s * np.sin(phases), size_m_s * np.array([1.7, 1.3]) * np.cos(phases)
        deck = deck_m_s * np.sin(0.8 * t + np.array([0.3, 1.4]))
        p = p + (own - deck) * DT
        f = np.array([*a, -9.81]) + 0.1 * rng.standard_normal(3)
        if accelerometer is not None and t >= since:
            f = f + accelerometer
        state, _ = inertial.felt(state, Imu(stamp, 0.01 * rng.standard_normal(3), f), OPTIONS, True)
        v = own - deck
        v = velocity(v, t - BEGIN_S) if t >= BEGIN_S else v
        state = inertial.moved(
            state, BodyVelocity(stamp, np.array([*(v + 0.05 * rng.standard_normal(2)), 0.0]), np.diag([0.01] * 2 + [1e6]))
        )
        attitude = Rotation.from_rotvec(0.002 * rng.standard_normal(3))
        state = inertial.levelled(state, Attitude(stamp, attitude, 1e-4 * np.eye(3)), True)
        if seen and n % 3 == 0 and t < blind_from:
            at = tuple((-p + 0.01 * rng.standard_normal(2)).tolist())
            state = inertial.sighted(state, stamp.measured_at, (*at, 2.0), 0.0)
        out.append(state)
    return out


def named_after_s(states: list[Inertial]) -> float:
    return next((n * DT - BEGIN_S for n, state in enumerate(states) if state.velocity_fault is not None), math.inf)


LIES: dict[str, Change] = {
    "sign": lambda v, t: -v,
    "swapped": lambda v, t: v[::-1] * (1.0, -1.0),
    "runs away": lambda v, t: v * max(-1.0, 1.0 - t),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("off_m_s2", [0.0, 0.9])
def test_a_velocity_against_the_accelerometer_is_named_within_two_seconds(lie: str, seen: bool, off_m_s2: float) -> None:
    states = flown(LIES[lie], seen=seen, accelerometer=np.array([0.0, off_m_s2, 0.0]), since=0.0)
    assert 0.0 < named_after_s(states) < 2.5
    (text,) = states[-1].lost
    assert text.startswith("the velocity")
    assert (states[-1].named > 0) is not seen, "out of sight the estimate has followed it, and begins again"


@settings(max_examples=15, deadline=None)
@given(st.floats(0.0, 1.2), st.floats(0.0, 0.8), st.floats(-1.1, 1.1), st.booleans(), st.integers(0, 99))
def test_an_honest_velocity_is_never_named_over_a_deck_that_sways_nor_for_an_attitude_that_errs(
    size_m_s, deck_m_s, off_m_s2, seen, seed
):
    off = np.array([0.0, off_m_s2, 0.0])
    states = flown(
        lambda v, t: v, seen=seen, size_m_s=size_m_s, deck_m_s=deck_m_s, accelerometer=off, since=0.0, until=6.0, seed=seed
    )
    assert named_after_s(states) == math.inf


@pytest.mark.parametrize(("size_m_s", "since"), [(0.8, BEGIN_S), (0.1, 0.0)])
def test_an_accelerometer_that_lies_in_sight_leaves_the_velocity_alone(size_m_s: float, since: float) -> None:
    lies = np.array([2.5, 0.0, 0.0])
    states = flown(lambda v, t: v, seen=True, size_m_s=size_m_s, accelerometer=lies, since=since, blind_from=4.5)
    assert named_after_s(states) == math.inf, "nor out of sight soon after"


def test_a_late_velocity_is_named_once_it_swings_the_vehicle() -> None:
    """Its share of the integral's swing is of the right sign; in clean flights the difference is a third of this one's."""
    late = deque([np.zeros(2)] * 50)

    def half_a_second_old(v: F64, t: float) -> F64:
        late.append(v)
        return late.popleft()

    assert named_after_s(flown(half_a_second_old, seen=False, size_m_s=2.0)) < 3.0


def test_a_deck_that_ends_below_makes_a_leap_and_no_lie() -> None:
    states = flown(lambda v, t: v + np.array([4.0, 0.0]), seen=False)
    assert named_after_s(states) == math.inf


def test_a_naming_is_withdrawn_when_the_velocity_agrees_again() -> None:
    states = flown(lambda v, t: -v if t < 2.5 else v, seen=True, until=12.0)
    assert states[round(5.4 / DT)].velocity_fault is not None
    assert states[-1].velocity_fault is None
