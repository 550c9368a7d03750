"""The belief about the deck widens where sightings keep missing it, and single wrong sightings change nothing."""

import numpy as np

from tests.support.voyage_score import fly
from tests.support.voyage_truth import VoyageScene


def test_a_wake_after_a_calm_is_followed_from_its_first_second() -> None:
    """A filter without the widening refuses the pad for a while: 0.46 m rms, NEES/7 3.8."""
    scene = VoyageScene(seed=406, sea="wake", hidden_delay_s=-0.03, duration_s=17.0, imu_hz=50.0, range_hz=5.0)
    s = fly(scene, since_s=10.0, forecasts=False)
    assert np.mean(s.nees) / 7.0 < 3.2
    assert s.rms_m < 0.3
