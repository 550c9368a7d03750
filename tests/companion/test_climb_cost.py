"""What a wrong climb costs: as simulated landings by wrong files showed it."""

import math

import numpy as np
import pytest
from msgspec import structs

from companion.settings.load import shipped_response
from companion.settings.mission import ConeOptions
from companion.tools.calibrate.touchdown_cost import climb_loop, climb_of_file, climb_of_sigma, contact

ARDRONE = shipped_response("ardrone2")
MISSING_M_S = 0.06
"""What the loop says too much by: it knows no ground effect."""


@pytest.mark.parametrize(
    ("delay_s", "lag_s", "mean_m_s", "spread_m_s"),
    [
        (0.06, 0.4, 0.394, 0.024),
        (0.06, 0.8, 0.405, 0.026),
        (0.0, 0.4, 0.402, 0.024),
        (0.16, 0.4, 0.380, 0.025),
        (0.26, 0.4, 0.365, 0.035),
    ],
)
def test_contacts_are_those_of_simulated_landings(delay_s: float, lag_s: float, mean_m_s: float, spread_m_s: float) -> None:
    """30 flights each of `sea_state_4`, seeds 5001 to 5030, by such a file, with a commit at 0.45 m/s."""
    found = contact(structs.replace(ARDRONE.climb, delay_s=delay_s, lag_s=lag_s), ARDRONE, ConeOptions(commit_rate_m_s=0.45))
    assert 0.0 < found.speed_m_s - mean_m_s < MISSING_M_S
    assert found.spread_m_s == pytest.approx(spread_m_s, abs=0.005)
    assert found.drift_cm < 1.0, "no file cost centimetres that 30 flights show"


def test_the_own_climb_costs_nothing_and_a_vehicle_that_answers_later_is_worse_than_one_that_answers_sooner() -> None:
    right = climb_of_file(ARDRONE.climb, ARDRONE)
    assert (right.cost_m_s, right.cost_cm) == (0.0, 0.0)
    slow = structs.replace(ARDRONE, climb=structs.replace(ARDRONE.climb, lag_s=0.8))
    quick = structs.replace(ARDRONE, climb=structs.replace(ARDRONE.climb, lag_s=0.2))
    assert climb_of_file(ARDRONE.climb, slow).cost_m_s > 0.03 > climb_of_file(ARDRONE.climb, quick).cost_m_s
    late = structs.replace(ARDRONE, climb=structs.replace(ARDRONE.climb, delay_s=0.3))
    assert not climb_loop(ARDRONE.climb, late).stable
    assert math.isinf(climb_of_file(ARDRONE.climb, late).cost_m_s)


def test_one_sigma_is_the_worst_of_its_ellipsoid_and_grows_with_it() -> None:
    small, large = (climb_of_sigma(ARDRONE, np.diag([s**2, (4.0 * s) ** 2])) for s in (0.01, 0.03))
    assert 0.0 < small[0].cost_m_s < large[0].cost_m_s < 0.1
    assert 0.0 < small[1].cost_cm < large[1].cost_cm < 1.0
    assert math.isinf(climb_of_sigma(ARDRONE, np.diag([0.3**2, 0.01**2]))[0].cost_m_s)
