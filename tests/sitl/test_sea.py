"""Spectra and the surface made of them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.errors import BadInput
from estimator.contracts.motion import G_M_S2
from sitl.sea.sea import SEA_STATES, SHELTERED_SLIGHT, SeaState, Waves, jonswap, sea_state
from tests.sitl.closed_forms import ittc

W = np.linspace(0.02, 60.0, 200_000)


@pytest.mark.parametrize("state", [s for s in SEA_STATES.values() if s.hs_m > 0], ids=str)
def test_spectra_hold_the_energy_of_their_height_and_peak_where_reported(state: SeaState) -> None:
    for density in (jonswap(W, state.hs_m, state.tp_s), ittc(W, state.hs_m, state.tp_s)):
        assert 4.0 * math.sqrt(np.trapezoid(density, W)) == pytest.approx(state.hs_m, rel=0.01)
        assert W[density.argmax()] == pytest.approx(math.tau / state.tp_s, rel=0.01)


@given(st.integers(0, 2**31), st.sampled_from([*SEA_STATES.values(), SHELTERED_SLIGHT]), st.floats(-10, 10))
@settings(max_examples=30)
def test_significant_height_is_met_exactly_by_every_seed(seed: int, state: SeaState, towards_rad: float) -> None:
    waves = Waves.draw(state, seed, towards_rad=towards_rad)
    assert waves.hs_m == pytest.approx([state.hs_m], abs=1e-12)


def test_a_seed_gives_the_same_sea_alone_and_in_a_batch_and_seeds_differ() -> None:
    batch = Waves.draw(SEA_STATES[3], [5, 6, 7])
    alone = Waves.draw(SEA_STATES[3], 6)
    p = np.array([[0.0, 0.0], [3.0, -2.0]])
    assert np.array_equal(batch.elevation(p, 7.0)[1], alone.elevation(p, 7.0)[0])
    assert not np.allclose(batch.elevation(p, 7.0)[0], batch.elevation(p, 7.0)[2])


def test_slope_is_the_derivative_of_height() -> None:
    waves = Waves.draw(SEA_STATES[4], [1, 2], towards_rad=0.7)
    p = np.random.default_rng(0).uniform(-50, 50, (30, 2))
    h = 1e-4
    for axis in (0, 1):
        d = np.eye(2)[axis] * h
        numeric = (waves.elevation(p + d, 3.0) - waves.elevation(p - d, 3.0)) / (2 * h)
        np.testing.assert_allclose(waves.slope(p, 3.0)[..., axis], numeric, atol=1e-7)


def test_crests_run_where_reported_at_the_speed_of_deep_water() -> None:
    # One harmonic: its shape moves with w / k = g / w along its direction, and stays level across it.
    w, towards = 1.3, 0.9
    waves = Waves(np.array([[0.5]]), np.array([[w]]), np.array([[towards]]), np.array([[0.4]]))
    along, across = np.array([math.cos(towards), math.sin(towards)]), np.array([-math.sin(towards), math.cos(towards)])
    at = waves.elevation((2.0, 5.0), 1.0)
    assert waves.elevation((2.0, 5.0) + along * G_M_S2 / w * 0.7, 1.7) == pytest.approx(at)
    assert waves.elevation((2.0, 5.0) + across * 11.0, 1.0) == pytest.approx(at)


def test_directions_spread_about_the_mean_by_the_exponent() -> None:
    for s in (5.0, 25.0):
        off = Waves.draw(SEA_STATES[4], range(60), towards_rad=2.0, spreading=s).towards_rad - 2.0
        # Circular mean of cos^2s(x / 2) is s / (s + 1).
        assert np.cos(off).mean() == pytest.approx(s / (s + 1.0), abs=0.01)
        assert abs(np.sin(off).mean()) < 0.02


def test_bad_states_are_refused_with_their_names() -> None:
    with pytest.raises(BadInput, match="sea state must be one of 0, 1, 2, 3, 4, 5, 6, got 9"):
        sea_state(9)
    with pytest.raises(ValueError, match="hs_m"):
        SeaState(-1.0, 5.0)
    with pytest.raises(ValueError, match="tp_s"):
        SeaState(1.0, 0.0)
