"""Spectra and the surface made of them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.motion import G_M_S2
from sitl.sea.sea import SEA_STATES, Components, Sea, SeaState, Waves, WaveSystem

WMO_3700_M: dict[int, tuple[float, float]] = {
    0: (0.0, 0.0), 1: (0.0, 0.1), 2: (0.1, 0.5), 3: (0.5, 1.25), 4: (1.25, 2.5), 5: (2.5, 4.0), 6: (4.0, 6.0)
}  # fmt: skip
"""Lowest and highest significant height of each sea state: WMO Manual on Codes (WMO-No. 306), code table 3700."""


@given(st.integers(0, 2**31), st.sampled_from([*SEA_STATES.values()]), st.floats(-10, 10))
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


FINE_W = np.geomspace(0.02, 80.0, 40_000)
SWELL, WIND = SeaState.swell_and_wind_sea(2.0)
STATES = {"jonswap": SEA_STATES[4], "pierson_moskowitz": SeaState.fully_grown(2.0), "swell": SWELL, "wind sea": WIND}


def test_a_fully_grown_sea_is_pierson_and_moskowitz() -> None:
    """The spectrum by wind is S = 0.0081 g^2 w^-5 exp(-0.74 (g / V w)^4); a height of 0.209 V^2 / g belongs to the wind V."""
    g, wind = 9.80665, 12.0
    height = math.sqrt(16.0 * 0.0081 / (4 * 0.74)) * wind**2 / g
    band = FINE_W[(FINE_W > 0.65) & (FINE_W < 4.0)]
    by_wind = 0.0081 * g**2 * band**-5 * np.exp(-0.74 * (g / (wind * band)) ** 4)
    np.testing.assert_allclose(SeaState.fully_grown(height).density(band), by_wind, rtol=0.05)


@pytest.mark.parametrize("components", ["geometric", "equal_energy"])
@pytest.mark.parametrize("state", STATES.values(), ids=STATES.keys())
def test_a_drawn_sea_has_the_height_period_and_energy_of_its_spectrum(state: SeaState, components: Components) -> None:
    """The variance of 150 seeds, by time and by band of frequency, equals the spectrum's integral."""
    waves = Waves.draw(state, range(150), components=components)
    assert 4.0 * math.sqrt(float((waves.amplitude_m**2).sum(axis=1).mean()) / 2.0) == pytest.approx(state.hs_m)
    wp = math.tau / state.tp_s
    edges = wp * np.array([0.5, 0.8, 0.95, 1.1, 1.4, 2.0, 3.0])
    energy, _ = np.histogram(waves.w_rad_s, edges, weights=0.5 * waves.amplitude_m**2 / waves.batch)
    fine = np.linspace(edges[:-1], edges[1:], 400, axis=-1)
    expected = np.trapezoid(state.density(fine), fine, axis=-1)
    whole = np.trapezoid(state.density(np.linspace(0.5, 5.0, 4000) * wp), np.linspace(0.5, 5.0, 4000) * wp)
    share = expected * (state.hs_m / 4.0) ** 2 / whole  # the energy beyond the sampled band is put into it
    assert energy == pytest.approx(share, abs=0.02 * (state.hs_m / 4.0) ** 2)
    assert whole == pytest.approx((state.hs_m / 4.0) ** 2, rel=0.015), "hardly any energy lies beyond the sampled band"


def test_sea_states_lie_in_the_bands_of_the_wmo() -> None:
    assert SEA_STATES.keys() == WMO_3700_M.keys()
    for code, (low, high) in WMO_3700_M.items():
        assert low <= SEA_STATES[code].hs_m <= high
        (system,) = Sea(sea_state=code).systems()
        assert (system.state.hs_m, system.state.tp_s) == (SEA_STATES[code].hs_m, SEA_STATES[code].tp_s)


def test_a_crossing_swell_is_a_system_of_its_own() -> None:
    sea = Sea(
        spectrum="ochi_hubble", runs_to_deg=0.0, swell=WaveSystem(1.2, 12.0, runs_to_deg=90.0), wind_sea=WaveSystem(0.5, 4.0, 1.5)
    )
    waves = sea.waves([1, 2, 3])
    assert waves.hs_m == pytest.approx([1.3] * 3)
    long = waves.w_rad_s < 0.8
    east = np.cos(waves.towards_rad - math.pi / 2)
    energy = waves.amplitude_m**2
    assert (energy * east)[long].sum() / energy[long].sum() > 0.95
    assert abs((energy * east)[~long].sum() / energy[~long].sum()) < 0.25
    assert not np.array_equal(sea.waves([1]).phase_rad[0, :60], sea.waves([1]).phase_rad[0, 60:])


def test_a_current_carries_the_waves_and_shifts_their_frequency() -> None:
    still, carried = Sea(runs_to_deg=20.0).waves([4]), Sea(runs_to_deg=20.0, current_m_s=1.5, current_to_deg=50.0).waves([4])
    north, east = carried.current_ne_m_s
    assert math.hypot(north, east) == pytest.approx(1.5)
    p, t = np.array([3.0, -7.0]), 11.0
    assert carried.elevation(p + t * np.array([north, east]), t) == pytest.approx(still.elevation(p, t))
    assert (carried.seen_rad_s > carried.w_rad_s).mean() > 0.9, "waves that run with the current pass faster"
    assert carried.longest(3).current_ne_m_s == carried.current_ne_m_s
