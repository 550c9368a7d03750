"""The native core's forecast is the numpy oracle's."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guidance.controller import HORIZONS_S
from estimator.contracts.geometry import F64
from estimator.contracts.time import MonoNs
from estimator.ekf import Forecast, deck_motion_bank
from estimator.ekf.params import FilterParams
from tests.estimator.ekf.belief import Belief, DeckMotionBank, Skill, holding, unknown
from tests.estimator.ekf.hand import MS, TOOLS, S, T, belief, diagonal, params, under
from tests.estimator.ekf.oracle import answers, bank
from tests.estimator.ekf.oracle import forecast as oracle
from tests.estimator.ekf.oracle.propagate import propagated_with_covariance
from tests.estimator.ekf.test_core import beginning

OFTEN = params(tick_s=0.01, hold_s=0.02)
FIELDS = [name for name in Forecast.__dataclass_fields__ if name != "at"]


def learned(seed: int, looks: int, size: float) -> DeckMotionBank:
    """Return a bank that has seen a deck for a while: at rest where `size` is zero; every third time no tilt."""
    rng, sea = np.random.default_rng(seed), bank.unknown()
    w = math.tau / rng.uniform(3.0, 12.0, 5)
    swing = size * np.array([0.2, 0.3, 0.5, 0.04, 0.06])
    var = np.array([1e-4] * 3 + [1e-5] * 2)
    for k in range(looks):
        t = 0.25 * k
        seen = var.copy() if seed % 3 else np.array([1e-4] * 3 + [1e6] * 2)
        y = swing * np.sin(w * t) + np.sqrt(var) * rng.normal(size=5)
        sea = bank.observe(sea, T - 100 * MS - round((looks - 1 - k) * 0.25 * S), y, seen, TOOLS.carrying, 2.0)
    product, square, came = rng.normal(size=(3, 5, 2)), *rng.uniform(0.0, 2.0, (2, 3, 5, 2))
    known = Skill(sea.skill.issued, rng.uniform(0.0, 60.0, 3), product, square, came)
    return sea._replace(skill=known) if seed % 2 else sea


def expected(b: Belief, now: int, horizons_s: F64, chosen: FilterParams) -> Forecast:
    moved = propagated_with_covariance(b, now, chosen)
    x, A = answers.aligned(moved)
    return oracle.forecast(moved._replace(x=x, P=A.dot(moved.P).dot(A.T)), MonoNs(now), horizons_s, chosen.options)


def same_forecast(b: Belief, now: int, horizons_s: tuple[float, ...], chosen: FilterParams) -> None:
    ours = holding(b, chosen).forecast(MonoNs(now), horizons_s)
    assert ours is not None
    theirs = expected(b, now, np.array(horizons_s), chosen)
    assert ours.at == theirs.at
    for name in FIELDS:
        one, two = getattr(ours, name), getattr(theirs, name)
        assert one.shape == two.shape
        scale = float(np.abs(two).max()) if two.size else 1.0
        np.testing.assert_allclose(one, two, rtol=1e-9, atol=1e-9 * scale, err_msg=name)


@given(
    st.integers(0, 2**31), st.integers(0, 250), st.sampled_from([TOOLS, OFTEN]), st.sampled_from([0, 1, 12]),
    st.sampled_from([0.0, 1.0]),
    st.sampled_from([HORIZONS_S, (7.3,), (20.0, 1e-3), (3.0, 2.0, 1.0, 0.0)]),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_a_forecast_is_the_oracle_s(seed, later_ms, chosen, looks, size, horizons_s):
    """The states and banks are random: one or many horizons; no look, one or many; at rest and moving."""
    sea = learned(seed % 1000, looks, size) if looks else unknown()
    b = beginning(seed)._replace(sighted=T - 20 * MS, sea=sea)
    same_forecast(b, b.t + later_ms * MS, horizons_s, chosen)


@pytest.mark.parametrize("rest", [0.0, 1.0])
def test_a_bank_that_is_sure_forecasts_by_its_members_at_rest_or_by_the_others_alone(rest: float) -> None:
    sea = learned(3, 8, 1.0)
    weight = sea.weight.copy()
    weight[:, 1:] *= (1.0 - rest) / weight[:, 1:].sum(axis=1, keepdims=True)
    weight[:, 0] = rest
    b = beginning(3)._replace(sighted=T, sea=sea._replace(weight=weight))
    same_forecast(b, T + 10 * MS, HORIZONS_S, TOOLS)


def test_a_motion_of_a_micrometre_is_foretold_by_the_skill_in_foretelling_it() -> None:
    sea, tiny = learned(4, 8, 1.0), np.full((3, 5, 2), 1.5e-12)
    b = beginning(4)._replace(sighted=T, sea=sea._replace(skill=Skill(sea.skill.issued, np.full(3, 50.0), tiny, tiny, tiny)))
    same_forecast(b, T + 10 * MS, HORIZONS_S, TOOLS)


def test_a_bank_from_after_the_instant_is_taken_as_it_is() -> None:
    """A sighting may be newer than the instant requested, by the camera's clock."""
    sea = learned(5, 6, 1.0)
    b = beginning(5)._replace(sighted=T, sea=sea._replace(t=T + 30 * MS))
    same_forecast(b, T, (0.0, 1.0), TOOLS)


def test_a_sea_looked_at_in_the_first_instant_is_foretold_from_there() -> None:
    sea = learned(4, 12, 1.0)
    b = belief(t=300 * MS, x=under(), P=diagonal(d=0.01), sea=sea._replace(t=0))
    same_forecast(b, 400 * MS, HORIZONS_S, TOOLS)


def test_a_covariance_is_symmetric_and_finite_and_a_sigma_is_not_negative() -> None:
    for seed in range(20):
        b = beginning(seed)._replace(sighted=T, sea=learned(seed, 5, float(seed % 2)))
        found = holding(b, TOOLS).forecast(MonoNs(T + 5 * MS), HORIZONS_S)
        assert found is not None
        np.testing.assert_allclose(found.cov_d_level, found.cov_d_level.transpose(0, 2, 1), rtol=1e-12, atol=1e-15)
        for name in FIELDS:
            assert np.all(np.isfinite(getattr(found, name)))
            assert not name.startswith("sigma") or np.all(getattr(found, name) >= 0.0)


@pytest.mark.parametrize(("ago_ns", "foretold"), [(S // 2, True), (S // 2 + 1, False)])
def test_a_pad_is_foretold_until_it_is_forgotten_to_the_nanosecond(ago_ns: int, foretold: bool) -> None:
    b = beginning(2)._replace(sighted=T - ago_ns)
    found = holding(b, params(forget_s=0.5)).forecast(MonoNs(T), HORIZONS_S)
    assert (found is not None) is foretold


def test_no_horizons_make_a_forecast_of_nothing() -> None:
    found = holding(beginning(2)._replace(sighted=T), TOOLS).forecast(MonoNs(T), [])
    assert found is not None
    assert (found.d_body_pad_level.shape, found.cov_d_level.shape, found.roll_rad.shape) == ((0, 3), (0, 3, 3), (0,))


def test_the_members_of_an_oscillator_lie_side_by_side() -> None:
    w, zeta = deck_motion_bank.W[1:].reshape(27, 5), deck_motion_bank.ZETA[1:].reshape(27, 5)
    assert np.all(w == w[:, :1])
    assert np.all(zeta == zeta[:, :1])
