"""The air: Dryden's turbulence against its spectra, the profile, discrete gusts, and the wake of the superstructure."""

import math
from pathlib import Path

import numpy as np
import pytest

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from sitl.core.library import SIM
from sitl.scenario.scenario import load
from sitl.vehicle.airframe import ardrone2
from sitl.vehicle.vehicle import Vehicle
from sitl.vessel.air import AirModel, GustOnce, WakingHull
from sitl.vessel.contact import DeckShape, Ground, Vec
from sitl.vessel.seakeeping import Superstructure

STEP_S = 0.01
LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
BLOCK = Superstructure(20.0, 10.0, 16.0, 10.0)


def held(model: AirModel, p: Vec, v: Vec, seconds: float, batch: int, step_s: float = STEP_S) -> F64:
    """(T, B, 3) m/s: the air that vehicles meet which are held at a place, on a ship whose deck is at -3 m and goes with them."""
    ground = Ground((0.0, 0.0, -3.0), v, LEVEL, (0.0, 0.0, 0.0), 0.0)
    shape = DeckShape(30.0, 30.0, 10.0, 10.0)
    rows = np.empty((round(seconds / step_s), batch, 3))
    for i in range(batch):
        vehicle = Vehicle(ardrone2(), shape, step_s, np.random.SeedSequence([7, i]), air=model)
        vehicle.place(np.array(p), np.array(v), 0.0)
        before = [x - step_s * u for x, u in zip(p, v, strict=True)]
        for row in rows[:, i]:
            SIM.fill(vehicle.state, p=before, v=v)
            vehicle.step(ground)
            row[:] = vehicle.air_ned
    return rows


def met(model: AirModel, height_m: float, seconds: float, batch: int = 16) -> F64:
    """(T, B, 3) m/s: the air at a place that stands still over the water."""
    return held(model, (0.0, 0.0, -height_m), (0.0, 0.0, 0.0), seconds, batch)


@pytest.mark.parametrize(("height_m", "flights"), [(4.0, 12), (30.0, 20)])
def test_drydens_turbulence_has_the_strength_and_spectra_of_the_specification(height_m: float, flights: int) -> None:
    """Variance and power by frequency of some flights of 80 s, hovering in a wind of 10 m/s to the east."""
    model = AirModel(10.0, math.pi / 2, turbulence="dryden")
    at = met(model, height_m, 80.0, flights)
    u, v, w = at[..., 1] - 10.0, -at[..., 0], at[..., 2]
    h = max(height_m / 0.3048, 10.0)
    sigma_w = 0.1 * 10.0
    sigma_u, length_u, length_w = sigma_w / (0.177 + 0.000823 * h) ** 0.4, 0.3048 * h / (0.177 + 0.000823 * h) ** 1.2, 0.3048 * h
    f = np.fft.rfftfreq(at.shape[0], STEP_S)[1:]
    window = np.hanning(at.shape[0])
    for x, sigma, length, first_order in (
        (u, sigma_u, length_u, True),
        (v, sigma_u, length_u, False),
        (w, sigma_w, length_w, False),
    ):
        assert x.std() == pytest.approx(sigma, rel=0.08)
        power = (np.abs(np.fft.rfft(x * window[:, None], axis=0)[1:]) ** 2).mean(axis=1) * 2 * STEP_S / (window**2).sum()
        s = math.tau * f * length / 10.0
        shape = 2.0 / (1.0 + s**2) if first_order else (1.0 + 3.0 * s**2) / (1.0 + s**2) ** 2
        expected = 2.0 * sigma**2 * length / 10.0 * shape
        for low, high in ((0.1, 0.3), (0.3, 1.0), (1.0, 3.0)):
            band = (f >= low) & (f < high)
            assert power[band].mean() == pytest.approx(expected[band].mean(), rel=0.2)


def test_kaimals_turbulence_has_the_spectra_of_the_surface_layer() -> None:
    """The power is n S / u*^2 at f = n z / U along, across and up. It is of 16 flights of 80 s at 5 m in a wind of 10 m/s."""
    at = met(AirModel(10.0, math.pi / 2, logarithmic=True, turbulence="kaimal"), 5.0, 80.0)
    mean = 10.0 * math.log(5.0 / 0.0002) / math.log(10.0 / 0.0002)
    friction = 0.4 * 10.0 / math.log(10.0 / 0.0002)
    n = np.fft.rfftfreq(at.shape[0], STEP_S)[1:]
    f, window = n * 5.0 / mean, np.hanning(at.shape[0])
    expected = (105 * f / (1 + 33 * f) ** (5 / 3), 17 * f / (1 + 9.5 * f) ** (5 / 3), 2.1 * f / (1 + 5.3 * f ** (5 / 3)))
    for x, sigma, formula in zip((at[..., 1] - mean, -at[..., 0], at[..., 2]), (2.18, 1.64, 1.24), expected, strict=True):
        assert x.std() == pytest.approx(sigma * friction, rel=0.12)
        power = (np.abs(np.fft.rfft(x * window[:, None], axis=0)[1:]) ** 2).mean(axis=1) * 2 * STEP_S / (window**2).sum()
        for low, high in ((0.02, 0.1), (0.1, 0.5), (0.5, 2.0)):
            band = (f >= low) & (f < high)
            assert power[band].mean() == pytest.approx((friction**2 * formula / n)[band].mean(), rel=0.3)


def test_the_hulls_windward_edge_slows_the_air_over_the_deck_alone() -> None:
    hull = WakingHull(3.0, (30.0, 30.0, 10.0, 10.0))

    def share(y: float, z: float) -> float:
        steps = held(AirModel(10.0, math.pi / 2, hull=hull), (0.0, y, -3.0 - z), (0.0, 0.0, 0.0), 2.0, 60)[..., 1]
        return 1.0 - float(steps.mean()) / 10.0

    assert share(-12.0, 1.0) == 0.0, "beside the ship to windward there is none"
    assert share(-5.0, 1.0) > share(-5.0, 5.0) > -0.02
    assert 0.1 < share(0.0, 1.0) < 0.9


def test_a_gust_rises_stays_and_goes() -> None:
    gust = GustOnce(2.0, 1.0, 3.0, (4.0, 0.0))
    blown = met(AirModel(3.0, 0.0, gusts=(gust,)), 5.0, 8.0, batch=1)[:, 0, 0]
    at = {t: float(blown[min(round(t / STEP_S), len(blown) - 1)]) - 3.0 for t in (0.0, 2.0, 2.5, 3.0, 4.5, 6.0, 6.5, 7.0, 8.0)}
    assert list(at.values()) == pytest.approx([0, 0, 2, 4, 4, 4, 2, 0, 0], abs=0.1)
    assert blown[[0, -1]] == pytest.approx([3.0, 3.0])


def deficit(
    x: float,
    y: float,
    z: float,
    *,
    towards_rad: float = math.pi,
    ship_m_s: float = 0.0,
    turbulence: bool = False,
    block: Superstructure = BLOCK,
) -> float:
    """Share of the wind that is missing at a place from amidships, or the added turbulence over the wind; head wind 10 m/s."""
    model = AirModel(10.0, towards_rad, wake=block)
    steps = held(model, (x, y, -3.0 - z), (ship_m_s, 0.0, 0.0), 2.0, 80)[..., 0]
    if turbulence:
        return float(steps.std()) / (10.0 + ship_m_s)
    return 1.0 - float(steps.mean() - ship_m_s) / (10.0 * math.cos(towards_rad) - ship_m_s)


def test_the_wake_is_behind_the_superstructure_and_fades() -> None:
    assert deficit(40.0, 0.0, 3.0) == pytest.approx(0.0, abs=0.01), "upwind there is none"
    assert deficit(5.0, 30.0, 3.0) == pytest.approx(0.0, abs=0.01), "nor far to the side"
    near, far = deficit(-5.0, 0.0, 3.0), deficit(-80.0, 0.0, 3.0)
    assert 0.6 < near <= 0.92
    assert 0.02 < far < 0.6 * near
    assert deficit(-5.0, 0.0, 40.0) < 0.25 * near, "high above it the wind blows"
    assert deficit(-60.0, 0.0, 3.0, towards_rad=0.0) == pytest.approx(0.0, abs=0.01), "the wind comes from astern"
    # Perera's formula itself, where it holds, ten heights behind, for a block so wide that the spread sideways is not felt.
    eta = 0.3 * (0.32 / math.log(10 / 0.0002) * 10.0) ** -0.47
    expected = 9.75 / 10.0 * eta * math.exp(-0.67 * eta**1.5)
    wide = Superstructure(20.0, 10.0, 200.0, 10.0)
    assert deficit(20.0 - 5.0 - 100.0, 0.0, 3.0, block=wide) == pytest.approx(expected, rel=0.05)


def test_a_wake_needs_a_superstructure_and_dryden_takes_the_place_of_a_bases_gusts(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text('title = "a"\nbase = "demo"\n[wind]\nwake = true\n')
    with pytest.raises(BadInput, match=r"hull ferry: wind\.wake needs a vessel with a superstructure"):
        load(tmp_path / "a.toml")
    (tmp_path / "b.toml").write_text('title = "b"\nbase = "demo"\n[wind]\nmodel = "dryden"\n')
    assert load(tmp_path / "b.toml").wind.gust_sigma_m_s is None
    (tmp_path / "c.toml").write_text('title = "c"\nbase = "moderate"\n[vessel]\nfile = "supply_ship"\n[wind]\nwake = true\n')
    assert load(tmp_path / "c.toml").vessel.hull is None
