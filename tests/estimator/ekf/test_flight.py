"""A real AR.Drone flight: sightings made from the motion capture, with a gap."""

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.ekf import Filter
from tests.estimator.ekf.core_state import newest
from tests.support import mocap_flight

pytestmark = pytest.mark.skipif(not mocap_flight.FOLDER.is_dir(), reason="the recorded flight with motion capture is not here")


def test_a_gap_of_three_seconds_and_the_return() -> None:
    flight = mocap_flight.load()
    begin, end = 24.0, 27.0
    # Every fifth sample of 200 a second is enough to see whether it works.
    thinned = replace(flight, samples=tuple(s for k, s in enumerate(flight.samples) if k // 4 % 4 == 0))
    t, error, nees = mocap_flight.run(thinned, mocap_flight.sightings(flight, 10.0, [(begin, end)]), 30.0)
    before, after = (t > 18.0) & (t < begin), t > end + 0.5
    assert np.sqrt(np.mean(np.sum(error[before] ** 2, axis=1))) < 0.05
    assert float(np.linalg.norm(error[np.searchsorted(t, end), :2])) < 0.30
    assert np.sqrt(np.mean(np.sum(error[after] ** 2, axis=1))) < 0.06
    # The covariance grows as the error may: it is neither left behind nor useless.
    gap = (t > begin + 0.5) & (t < end)
    assert np.mean(nees[gap]) < 3.0 * 3.0
    assert np.mean(nees[before]) < 2.0 * 3.0


def test_the_velocity_scale_of_the_real_drone_is_found() -> None:
    """Motion capture has 0.83-0.87 for the share of the true velocity that this drone tells."""
    flight = mocap_flight.load()
    path = Filter(mocap_flight.OPTIONS)
    mocap_flight.run(flight, mocap_flight.sightings(flight, 5.0, []), 24.0, path)
    assert 0.75 < newest(path).x[15] < 1.0
