"""Baselines between two antennas: what the estimate knows by them, and who is believed when they and the camera disagree."""

import math
import re
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from msgspec import Struct

from estimator.contracts.estimates import IntegrityAlert, RelativeState
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Baseline
from estimator.contracts.time import MonoNs
from estimator.pipeline import RelativeEstimator
from tests.make import imu, ns, sighting, stamp, velocity, vessel

HEADING, SHIP = 0.2, 0.4
"""Headings of the body and of the ship, whose pad's arrow points to her bow."""
HZ, EACH_BASELINE, LATE_S = 200, 20, 0.2
BODY_ARM, SHIP_ARM = (0.1, 0.0, -0.1), (-0.8, 0.5, -0.4)
ROLL = math.radians(1.0)


class Way(Struct):
    """One flight and its perception of the pad. The body hovers, the deck heaves by 0.2 m and has a list."""

    seconds: float = 12.0
    camera_until_s: float = 5.0
    off: Callable[[float], tuple[float, float, float]] = lambda t: (0.0, 0.0, 0.0)
    """Error of the baseline at a time, m."""
    body_arm: tuple[float, float, float] = BODY_ARM
    ship_arm: tuple[float, float, float] = SHIP_ARM
    more: Callable[[float], dict[str, Any]] = lambda t: {}


def pad_ned(t: float) -> F64:
    return np.array([1.5, -0.8, 3.0 + 0.2 * math.sin(0.7 * t)])


def truth(t: float) -> F64:
    return Rotation.from_rpy(0.0, 0.0, HEADING).inv @ pad_ned(t)


def baseline(t: float, way: Way, noise: F64) -> Baseline:
    R_ship, R_body = Rotation.from_rpy(ROLL, 0.0, SHIP), Rotation.from_rpy(0.0, 0.0, HEADING)
    d = R_body @ np.array(way.body_arm) - pad_ned(t) - R_ship @ np.array(way.ship_arm) + noise + np.array(way.off(t))
    given = {"fix": "fixed", "cov_ned": np.diag([0.012, 0.012, 0.02]) ** 2, **way.more(t)}
    return Baseline(
        stamp(t, LATE_S), d_ned=d, antenna_body=np.array(way.body_arm), antenna_vessel=np.array(way.ship_arm), **given
    )


def perceived(way: Way) -> Iterator[tuple[float, RelativeEstimator, RelativeState | None]]:
    """Yield the estimate every half second."""
    rng, estimator, under_way = np.random.default_rng(8), RelativeEstimator(), list[Any]()
    for n in range(round(way.seconds * HZ)):
        t = n / HZ
        estimator.on_imu(imu(t, 0.001 * rng.standard_normal(3), (0.0, 0.0, -9.80665) + 0.03 * rng.standard_normal(3)))
        if n % 4 == 0:
            tilt = 0.003 * rng.standard_normal(3) + (0.0, 0.0, HEADING)
            estimator.on_attitude(Attitude(stamp(t), Rotation.from_rpy(*tilt), np.eye(3) * 0.008**2))
        if n % 10 == 0:
            estimator.on_velocity(velocity(t, tuple(0.05 * rng.standard_normal(3))))
            estimator.on_vessel(vessel(t, heading_rad=wrap_pi(SHIP + 0.01 * rng.standard_normal()), sigma_rad=0.01))
        if n % EACH_BASELINE == 0:
            under_way.append(baseline(t, way, 0.006 * rng.standard_normal(3)))
        if t < way.camera_until_s and n % 10 == 5:
            d = truth(t) + 0.004 * rng.standard_normal(3)
            under_way.append(sighting(stamp(t, 0.09), tuple(d), HEADING - SHIP, var=0.005**2, yaw_var=0.01**2))
        now = ns(t)
        for event in [one for one in under_way if one.stamp.received_at <= now]:
            under_way.remove(event)
            estimator.put((event,))
        if n % 100 == 99:
            yield t, estimator, estimator.at(now)


def estimates(way: Way, since_s: float) -> list[tuple[float, RelativeState]]:
    """Return the estimates since a time; there is one at each."""
    found = [(t, state) for t, _, state in perceived(way) if t >= since_s]
    assert all(state is not None for _, state in found)
    return [(t, state) for t, state in found if state is not None]


def off_m(t: float, state: RelativeState) -> float:
    return math.hypot(*(state.d_body_pad_level - truth(t)))


def test_without_the_camera_the_pad_is_known_as_well_as_by_the_receivers_and_counts_as_seen():
    for t, state in estimates(Way(), 6.0):
        assert off_m(t, state) < 0.07, t
        assert state.age_s(ns(t)) < LATE_S + EACH_BASELINE / HZ + 0.02
        assert state.consistent
        z = (state.d_body_pad_level - truth(t)) / np.sqrt(np.diag(state.cov)[:3])
        assert np.abs(z).max() < 3.5, t


def test_receivers_whose_error_lasts_are_not_believed_beyond_it_while_pictures_come():
    """WHY: all ten in a second counted, and from 2 m down both were farther off than the camera alone, and sure of it."""
    ways = [Way(16.0, 99.0, lambda t, side=side: (0.009 * side, -0.007 * side, 0.012 * side)) for side in (1.0, -1.0)]
    off = [((s.d_body_pad_level - truth(t))[:2], s.cov[:2, :2]) for way in ways for t, s in estimates(way, 8.0)]
    assert np.mean([e @ np.linalg.solve(cov, e) / 2.0 for e, cov in off]) < 0.8


def test_both_know_it_better_than_the_receivers_alone():
    both, alone = (estimates(Way(camera_until_s=until_s), 6.0) for until_s in (99.0, 5.0))
    assert np.mean([off_m(*one) for one in both]) < np.mean([off_m(*one) for one in alone])


@pytest.mark.parametrize(("body_arm", "ship_arm"), [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), ((0.3, -0.2, 0.1), (0.4, -1.2, -1.0))])
def test_it_does_not_depend_on_where_the_antennas_are(body_arm, ship_arm):
    for t, state in estimates(Way(body_arm=body_arm, ship_arm=ship_arm), 6.0):
        assert off_m(t, state) < 0.1, t


def test_a_landing_does_not_begin_without_sight_of_the_pad_unless_the_settings_allow_it():
    assert all(state is None for *_, state in perceived(Way(camera_until_s=0.0, seconds=4.0)))
    for t, state in estimates(Way(camera_until_s=0.0, seconds=8.0, more=lambda t: {"alone": True}), 2.0):
        assert state.track == 1
        assert state.yaw_rad == pytest.approx(HEADING - SHIP, abs=0.1)
        assert off_m(t, state) < 0.3


def leap(begins_s: float, ends_s: float) -> Callable[[float], tuple[float, float, float]]:
    return lambda t: (0.38, -0.19, 0.19) if begins_s <= t < ends_s else (0.0, 0.0, 0.0)


def test_the_camera_outvotes_a_baseline_that_leaps_and_believes_it_again_afterwards():
    named = []
    for t, estimator, state in perceived(Way(camera_until_s=99.0, off=leap(5.0, 8.0))):
        if t > 2.0:
            assert off_m(t, state) < 0.05
            assert state.consistent
            assert not state.alerts
        named += [(t, words) for words in estimator.guard.lost]
    assert min(t for t, _ in named) > 5.0
    assert max(t for t, _ in named) < 9.6
    (words,) = {words for _, words in named}
    assert re.fullmatch(r"the RTK baseline is off by 0\.4\d m; flying without it", words)


def test_without_a_picture_a_leap_is_undecided_and_is_not_followed_at_once():
    during, after_it = [], []
    for t, state in estimates(Way(seconds=21.0, off=leap(7.0, 9.0)), 6.0):
        if 7.5 < t < 9.0:
            during.append((IntegrityAlert.BASELINE in state.alerts, off_m(t, state)))
        if t > 20.0:
            after_it.append((state.alerts, off_m(t, state)))
    assert all(alerted and apart_m < 0.35 for alerted, apart_m in during)
    assert all(not alerts and apart_m < 0.1 for alerts, apart_m in after_it)


def test_an_antenna_that_is_not_where_the_settings_say_is_undecided_with_a_picture_too():
    always = leap(0.0, 99.0)
    for t, state in estimates(Way(camera_until_s=99.0, seconds=6.0, off=always), 2.0):
        assert IntegrityAlert.BASELINE in state.alerts
        assert off_m(t, state) < 0.05, "it is the camera's"


def test_a_float_is_no_sight_and_claims_little():
    way = Way(more=lambda t: {"fix": "float", "cov_ned": np.diag([0.3, 0.3, 0.5]) ** 2}, off=lambda t: (0.25, -0.2, 0.3))
    for t, state in estimates(way, 9.0):
        assert state.age_s(MonoNs(ns(t))) > 3.5
        assert math.sqrt(state.cov[:3, :3].diagonal().max()) > 0.15
        z = (state.d_body_pad_level - truth(t)) / np.sqrt(np.diag(state.cov)[:3])
        assert np.abs(z).max() < 4.0


def test_the_first_solution_after_a_float_has_to_last_before_anybody_descends_by_it():
    wide = np.diag([0.3, 0.3, 0.5]) ** 2

    def floating(t: float) -> dict[str, Any]:
        return {"fix": "float", "cov_ned": wide} if 6.0 <= t < 12.0 else {}

    found = estimates(Way(seconds=24.0, more=floating, off=leap(12.0, 16.0)), 5.0)
    assert all(IntegrityAlert.BASELINE in state.alerts for t, state in found if 12.6 < t < 21.0)
    assert not found[0][1].alerts
    assert off_m(*found[-1]) < 0.1
