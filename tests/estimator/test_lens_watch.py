"""A lens that is not where the camera's file has it is told within an approach, and one that is there is never accused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from estimator.contracts.estimates import RelativeState, Sighting
from estimator.integrity.options import IntegrityOptions
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from tests.support.estimator_truth import OPTIONS, TruthFlight, events, setting

Lens = tuple[float, float, float]
PLACED = (0.0, 0.0, 0.0)


def approach(seed: int, lens_off_m: Lens, lens_sigma_m: float = 0.3, seconds: float = 20.0) -> list[RelativeState]:
    """Return the estimate after each sighting of an approach, which turns and comes down."""
    options = EstimatorOptions(ekf=OPTIONS, integrity=IntegrityOptions(lens_sigma_m=lens_sigma_m))
    estimator, waiting, states = RelativeEstimator(options), [], []
    for event in events(TruthFlight(replace(setting(seed), lens_off_m=lens_off_m, duration_s=seconds))):
        waiting.append(event)
        if isinstance(event, Sighting):
            estimator.put(waiting, wanted=False)
            states.append(estimator.at(event.stamp.measured_at))
            waiting = []
    return [state for state in states if state is not None]


@pytest.mark.hazard("H12")
@pytest.mark.parametrize(("seed", "lens_off_m"), [(3, (0.3, 0.0, 0.05)), (7, (-0.2, 0.25, 0.0))])
def test_a_lens_elsewhere_is_told_with_its_place(seed: int, lens_off_m: Lens) -> None:
    said = [state.lens_off_m for state in approach(seed, lens_off_m) if state.lens_off_m is not None]
    assert said, "so that nobody lands by it"
    assert math.dist(said[-1], lens_off_m[:2]) < 0.06


@pytest.mark.hazard("H12")
@pytest.mark.parametrize("seed", [3, 8])
def test_a_lens_in_its_place_is_not_accused_and_known_as_well_as_is_claimed(seed: int) -> None:
    states = approach(seed, PLACED)
    assert not [state for state in states if state.lens_off_m is not None]
    figures = dict(states[-1].details)
    assert math.hypot(figures["lens_ahead_m"], figures["lens_right_m"]) < 4.0 * figures["sigma_lens_m"] < 0.6


def test_a_place_that_is_exact_is_not_watched_and_the_watch_steers_nothing() -> None:
    unwatched, watched = (approach(3, (0.3, 0.0, 0.0), sigma_m, 3.0) for sigma_m in (0.0, 0.3))
    assert dict(unwatched[-1].details)["lens_ahead_m"] == 0.0 != dict(watched[-1].details)["lens_ahead_m"]
    for one, other in zip(unwatched, watched, strict=True):
        np.testing.assert_array_equal(one.d_body_pad_level, other.d_body_pad_level)
