"""Hull responses against limits and published peaks; motion against its own derivatives and the sea it rides on."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.geometry import Rotation
from sitl.sea.sea import SEA_STATES, Waves
from sitl.vessel.seakeeping import FERRY, OTTER, SUPPLY_SHIP, responses
from sitl.vessel.vessel import Mooring, Vessel

PERIODS = np.arange(5.0, 18.0, 0.25)


def test_the_supply_ship_answers_as_its_published_tables_say() -> None:
    # Fossen's MSS supply vessel at rest: roll peaks at 3.1 deg/m near 9.5 s in beam seas, pitch at 2.4 deg/m near 8.5 s in
    # head seas.
    w = math.tau / PERIODS
    roll = np.degrees(np.abs(responses(SUPPLY_SHIP, w, np.full_like(w, math.pi / 2))[3]))
    pitch = np.degrees(np.abs(responses(SUPPLY_SHIP, w, np.full_like(w, math.pi))[4]))
    assert roll.max() == pytest.approx(3.1, rel=0.1)
    assert PERIODS[roll.argmax()] == pytest.approx(9.5, abs=0.75)
    assert pitch.max() == pytest.approx(2.4, rel=0.25)
    assert PERIODS[pitch.argmax()] == pytest.approx(8.5, abs=0.75)


def test_a_boat_follows_the_surface_that_waves_show() -> None:
    # Sea state 4 is long for a 2 m boat: what `elevation` and `slope` say at its place is what it does.
    waves = Waves.draw(SEA_STATES[4], 3, towards_rad=0.4)
    vessel = Vessel(OTTER, waves, heading_rad=1.1, p0_ne_m=(20.0, -7.0))
    t = np.arange(0.0, 60.0, 0.1)
    eta = vessel.motion(t).eta[0]
    surface = waves.elevation((20.0, -7.0), t)[0]
    assert np.std(eta[:, 2] + surface) < 0.15 * surface.std()
    slope = waves.slope((20.0, -7.0), t)[0]
    ahead = slope @ [math.cos(1.1), math.sin(1.1)]
    assert np.corrcoef(ahead, eta[:, 4])[0, 1] > 0.9


def test_under_way_it_meets_the_waves_of_the_places_it_passes() -> None:
    waves = Waves.draw(SEA_STATES[4], 8, towards_rad=2.6)
    vessel = Vessel(OTTER, waves, heading_rad=-0.5, speed_m_s=2.0, p0_ne_m=(5.0, 9.0))
    t = np.arange(0.0, 40.0, 0.1)
    way = np.array([5.0, 9.0]) + 2.0 * t[:, None] * [math.cos(-0.5), math.sin(-0.5)]
    surface = waves.elevation(way, t)[0]
    assert np.std(vessel.motion(t).eta[0, :, 2] + surface) < 0.25 * surface.std()


@given(
    which=st.sampled_from([FERRY, SUPPLY_SHIP]),
    seed=st.integers(0, 10**6),
    heading_rad=st.floats(-4, 4),
    speed_m_s=st.floats(0, 5),
    t=st.floats(0, 300),
    pad_yaw_rad=st.floats(-3, 3),
)
@settings(max_examples=40)
def test_velocity_and_acceleration_are_the_derivatives_of_place_and_attitude(which, seed, t, heading_rad, speed_m_s, pad_yaw_rad):
    course = {"heading_rad": heading_rad, "speed_m_s": speed_m_s, "pad_yaw_rad": pad_yaw_rad}
    vessel = Vessel(which, Waves.draw(SEA_STATES[4], seed), mooring=Mooring(), seeds=seed, **course)
    h = 1e-3
    before, now, later = (vessel.pad_at(t + s) for s in (-h, 0.0, h))
    np.testing.assert_allclose(now.v_ned, (later.p_ned - before.p_ned) / (2 * h), atol=3e-5)
    np.testing.assert_allclose(now.a_ned, (later.v_ned - before.v_ned) / (2 * h), atol=3e-5)
    turned = Rotation(before.R_ned).inv @ Rotation(later.R_ned)
    np.testing.assert_allclose(now.w, turned.rotvec_rad / (2 * h), atol=3e-5)


def test_times_in_equal_steps_and_any_others_give_the_same_motion() -> None:
    vessel = Vessel(FERRY, Waves.draw(SEA_STATES[4], 5), mooring=Mooring())
    equal = 4000.0 + 0.004 * np.arange(400)
    alone = [vessel.motion(t) for t in equal]
    for name in ("eta", "eta_dot", "eta_ddot"):
        ours = getattr(vessel.motion(equal), name)[0]
        np.testing.assert_allclose(ours, [getattr(m, name)[0] for m in alone], atol=1e-11)
