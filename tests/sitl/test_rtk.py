"""The simulated pair of receivers: how it errs, and that a landing goes on by it where the lens is covered."""

from types import SimpleNamespace as Of

import numpy as np
import pytest

from benches.landings import Watch
from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Baseline
from estimator.contracts.time import after
from sitl.flight.one_flight import fly
from sitl.flight.vessel_reports import RtkPair
from sitl.scenario.scenario import Scenario, load
from sitl.scenario.settings import settings_for
from sitl.sensors.rtk import RtkErrors, RtkSettings
from sitl.world.world import World


def test_it_errs_as_receivers_do_and_claims_the_same_of_a_wrong_solution():
    errors, epochs = RtkErrors(RtkSettings(10.0), [1]), 60_000
    made = [errors.epoch() for _ in range(epochs)]
    right = np.array([e.error_m for e in made if e is not None and e.right])
    wrong = np.array([e.error_m for e in made if e is not None and e.fix == "fixed" and not e.right])
    floats = np.array([e.error_m for e in made if e is not None and e.fix == "float"])
    assert np.sqrt(np.mean(right**2, axis=0)) == pytest.approx([0.0072, 0.0072, 0.0128], rel=0.3)
    assert 0.14 < np.linalg.norm(wrong, axis=1).min() < 0.24, "a wavelength"
    assert np.linalg.norm(wrong, axis=1).max() < 0.85
    assert len(wrong) / epochs == pytest.approx(0.001 * 50.0, rel=0.4), "one in a thousand begins, and lasts for 5 s"
    assert np.sqrt(np.mean(floats[:, 0] ** 2)) == pytest.approx(0.25, rel=0.5)
    assert {e.claimed_m for e in made if e is not None and e.fix == "fixed"} == {0.01}
    assert sum(e is None for e in made) / epochs == pytest.approx(0.5 * 1.15 / 60.0, rel=0.5)


def test_a_baseline_is_the_vector_between_the_antennas_late_and_stamped_as_a_driver_does():
    of = RtkSettings(5.0, 0.2, (0.1, 0.2, -0.3), (-2.0, 1.0, -3.0), 0.0, 0.0, 0.0)
    world = World(Scenario(title="x", rtk=of), 3)
    pair, found = RtkPair(world), list[Baseline]()
    for _ in range(400):
        world.advance(after(world.now, 0.005))
        found += [one for one in pair.arrived(world.now) if isinstance(one, Baseline)]
    assert len(found) == pytest.approx(9, abs=1)
    for one in found:
        assert 0.12 < one.stamp.delay_s < 0.32
        assert (*one.antenna_body, *one.antenna_vessel) == (*of.antenna_m, *of.ship_antenna_m)
    truth = world.truth()
    expected = truth.p_body_ned + truth.R_ned_body.matrix @ of.antenna_m - truth.p_pad_ned
    expected -= truth.R_ned_pad.matrix @ of.ship_antenna_m
    assert np.linalg.norm(found[-1].d_ned - expected) < 0.5


@pytest.mark.parametrize("seed", [4, 11])
def test_with_the_lens_covered_it_lands_by_the_receivers_alone(seed):
    name = "faults/rtk_camera_covered"
    scenario = load(name)
    ending = fly(name, scenario, seed, settings_for(scenario, None), "model")
    assert ending.judged.grade == "on pad", ending.judged.because
    assert not ending.judged.unsafe


def test_a_wrong_solution_after_a_float_brings_no_drone_down(monkeypatch):
    """The first solution of this seed after a float of 9 s is wrong by 0.55 m, and the lens is covered."""
    monkeypatch.setattr("sitl.flight.afterwards.WATCHED_S", 10.0)
    scenario = load("faults/rtk_camera_covered")
    assert not fly("x", scenario, 411, settings_for(scenario, None), "model").judged.unsafe


def test_the_table_judges_forecasts_from_the_first_sight_on_by_the_truth_of_their_instant():
    watch, second, ahead_s = Watch(), 1_000_000_000, np.array([1.0, 2.0])
    watch.on_pilot(Of(landing=Of(forecast_made=lambda at: Of(horizons_s=ahead_s, rise_m_s=np.sin(at / second + ahead_s) + 0.1))))
    for at in range(0, 10 * second, second // 50):
        verdict = Verdict.FUSED if at >= 2 * second else Verdict.NO_PAD
        watch.on_frame(Of(verdict=verdict, frame=Of(stamp=Of(measured_at=at))))
        watch.on_decision(Of(at=at, belief=Of(d_body_pad_level=(0.53, 0.04, 2.0))))
        watch.on_truth(Of(at=at, d_body_pad_level=(0.5, 0.0, 2.0), v_pad_ned=(0.0, 0.0, -np.sin(at / second))))
    counts, squares = np.transpose(watch.forecasts())
    assert counts == pytest.approx([350, 300, 151, 151], abs=1)
    assert squares / counts == pytest.approx([0.01] * 4, rel=1e-3)
    assert watch.at_contact(5 * second) == pytest.approx((0.05, np.hypot(0.53, 0.04)))
