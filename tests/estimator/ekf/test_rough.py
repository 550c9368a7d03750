"""The filter where the world is not as its model, on a truth that shares nothing with the simulator: `voyage_truth.py`."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, BodyVelocity, Imu, Range
from estimator.contracts.time import MonoNs
from estimator.ekf import Filter
from estimator.ekf.params import TURN_RATE
from tests.estimator.ekf.core_state import copied, newest
from tests.make import tuned
from tests.support import voyage_truth
from tests.support.voyage_score import Score, fly_voyage
from tests.support.voyage_truth import OPTIONS, Event, Voyage, VoyageScene, ns

QUICK = VoyageScene(duration_s=20.0, imu_hz=50.0, sighting_hz=10.0, range_hz=5.0, gaps=1)
BEGIN_S, HOUR_NS = 12.0, 3_600_000_000_000
AHEAD = np.array([1.0, 0.0, 0.0])
Spoil = Callable[[Event], Sequence[Event]]
"""Turns an event into what is received in its place."""


def each(kind: type, change: Callable[[Any], Event]) -> Spoil:
    """Change the events of one kind."""
    return lambda e: [change(e)] if isinstance(e, kind) else [e]


def imu(w: float = 0.0, f: float = 0.0) -> Spoil:
    """Add a turn rate in roll, rad/s, and a specific force to starboard, m/s^2."""
    by_w, by_f = np.array([w, 0.0, 0.0]), np.array([0.0, f, 0.0])
    return each(Imu, lambda e: structs.replace(e, w_body=e.w_body + by_w, f_body=e.f_body + by_f))


def stamped_later(e: Event, by_ns: int) -> Event:
    """Return an event with its stamp later by this much."""
    at, received_at = (MonoNs(t + by_ns) for t in (e.stamp.measured_at, e.stamp.received_at))
    return structs.replace(e, stamp=structs.replace(e.stamp, measured_at=at, received_at=received_at))


def turned_round(e: Sighting) -> Sighting:
    return e if e.yaw_rad is None else structs.replace(e, yaw_rad=wrap_pi(e.yaw_rad + math.pi))


def frozen() -> Spoil:
    """Repeat one inertial sample with new stamps."""
    first: list[Imu] = []

    def repeated(e: Imu) -> Imu:
        first.append(e)
        return structs.replace(e, w_body=first[0].w_body, f_body=first[0].f_body)

    return each(Imu, repeated)


FAULTS: dict[str, tuple[Spoil, float]] = {
    "accelerometer 1e4": (imu(f=1e4), 0.015),
    "accelerometer 500": (imu(f=500.0), 0.015),
    "accelerometer 45": (imu(f=45.0), 0.015),
    "accelerometer 75": (imu(f=75.0), 0.015),
    "gyro 300": (imu(w=300.0), 0.015),
    "gyro 12": (imu(w=12.0), 0.015),
    "gyro 34": (imu(w=34.0), 0.015),
    "attitude 40 degrees": (
        each(Attitude, lambda e: structs.replace(e, R_ned_body=e.R_ned_body @ Rotation.from_rpy(0.7, 0.0, 0.7))), 0.3
    ),
    "velocity 30 m/s": (each(BodyVelocity, lambda e: structs.replace(e, v_level=e.v_level + 30.0 * AHEAD)), 0.4),
    "range 0": (each(Range, lambda e: structs.replace(e, range_m=0.0)), 0.5),
    "sightings 2 m aside": (
        each(Sighting, lambda e: structs.replace(e, d_body_pad_level=e.d_body_pad_level + 2.0 * AHEAD)), 0.4
    ),
    "heading turned round": (each(Sighting, turned_round), 2.0),
    "an hour ahead": (lambda e: [stamped_later(e, HOUR_NS)], 0.005),
}  # fmt: skip
"""Faults of single sensors in the middle of a voyage, and how long each lasts, s."""


def suffered(spoil: Spoil, lasts_s: float, duration_s: float) -> tuple[Score, float]:
    """Return a flight with a fault, scored from 11 s on, and when the fault ends, s."""
    scene = VoyageScene(sea="jonswap", duration_s=duration_s, gaps=0, imu_hz=50.0, sighting_hz=10.0)
    end = BEGIN_S + lasts_s

    def received(e: Event, t: float) -> Sequence[Event]:
        return spoil(e) if BEGIN_S <= t < end else [e]

    return fly_voyage(scene, since_s=11.0, spoil=received, forecasts=False), end


@pytest.mark.parametrize("sea", ["small boat", "turning", "swell and wind", "narrow"])
def test_rough_seas_with_every_sensor_error_at_once(sea: str) -> None:
    s = fly_voyage(replace(QUICK, sea=sea, seed=2), since_s=6.0)
    assert s.rms_m < 0.13
    assert 0.3 < np.mean(s.nees) / 7.0 < 1.6
    assert s.inside > 0.8
    # Bands of the position, and a vertical speed that is foretold no worse than by saying nothing.
    for horizon in (1.0, 2.0, 3.0):
        assert np.mean(s.bands["d_body_pad_level", horizon, 0.95]) > 0.85
        assert np.mean(s.bands["rise_m_s", horizon, 0.95]) > 0.8
    rise = np.array(s.rise)
    # Twelve seconds hold one swell of twelve: too few to say what its forecast is worth.
    assert sea == "swell and wind" or np.sqrt(np.mean(rise[:, 1] ** 2) / np.mean(rise[:, 4] ** 2)) < 1.25


def test_the_rate_of_a_turn_is_learned_and_goes_on_out_of_sight() -> None:
    """Three degrees a second at 2 m/s: without a rate of turn the filter errs by two metres after 3 s."""
    scene = replace(QUICK, sea="turning", seed=4, speed_m_s=2.0, blind=((15.0, 18.0),), gaps=0)
    s = fly_voyage(scene, since_s=15.0, forecasts=False)
    assert abs(abs(math.degrees(newest(s.memory).x[TURN_RATE])) - 3.0) < 1.0
    gap = [e for t, e in zip(s.t, s.error_m, strict=True) if t < 18.2]
    assert max(gap) < 0.5


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_leaves_no_scar_after_a_second(name: str) -> None:
    s, end = suffered(*FAULTS[name], 16.5)
    t, error, sigma = np.array(s.t), np.array(s.error_m), np.array(s.sigma_m)
    late = t >= min(end + 1.0, 16.0)
    assert late.any()
    assert error[late].max() < 0.2
    assert (error / sigma)[late].max() < 3.0
    assert np.abs(s.yaw_error)[t >= BEGIN_S].max() < math.radians(12.0), "the heading is held"
    assert not any(claimed and ratio > 4.0 for claimed, ratio in zip(s.consistent, error / sigma, strict=True))


@pytest.mark.parametrize("spoil", [lambda e: [] if isinstance(e, Imu) else [e], frozen()], ids=["none", "frozen"])
def test_five_seconds_without_inertial_data_widen_the_belief(spoil: Spoil) -> None:
    s, end = suffered(spoil, 4.9, 19.0)
    t, ratio = np.array(s.t), np.array(s.error_m) / np.array(s.sigma_m)
    assert ratio[t > BEGIN_S].max() < 3.5
    assert np.array(s.sigma_m)[(t > BEGIN_S + 1.0) & (t < end)].min() > 1.1 * s.sigma_m[0]


def test_a_cold_start_in_flight_with_an_attitude_that_is_degrees_off() -> None:
    """The reported roll is always six degrees wrong; the filter starts in the air."""
    worst = []
    for seed in (1, 2):
        scene = replace(QUICK, seed=seed, attitude_bias_deg=6.0, duration_s=14.0, gaps=0)
        s = fly_voyage(scene, since_s=6.5, from_s=6.0, forecasts=False)
        t = np.array(s.t)
        assert np.mean(np.array(s.nees)[t < 11.0]) / 7.0 < 2.5
        worst.append(np.sqrt(np.mean(np.array(s.error_m)[t > 11.0] ** 2)))
        assert s.inside > 0.6
    assert max(worst) < 0.25


def test_a_pad_that_stands_is_not_reported_to_move_because_the_attitude_errs() -> None:
    scene = replace(QUICK, sea="calm", speed_m_s=0.0, attitude_bias_deg=3.0, outliers=0.0)
    s = fly_voyage(scene, since_s=7.0, from_s=6.0, forecasts=False)
    state = s.memory.at(ns(19.9))
    assert dict(state.details)["probability_moving"] < 0.3


def flown_along(scene: VoyageScene, until_s: float) -> tuple[Filter, list[Event]]:
    received_at = voyage_truth.events(Voyage(scene))
    ekf = Filter(OPTIONS)
    for event in received_at:
        if event.stamp.received_at > ns(until_s):
            break
        ekf.put([event])
    return ekf, received_at


def test_a_belief_that_nothing_confirms_is_not_called_consistent() -> None:
    ekf, _ = flown_along(replace(QUICK, duration_s=9.0), 8.0)
    for later_s, expected in ((8.1, True), (8.6, True), (9.5, False), (29.0, False)):
        state = ekf.at(ns(later_s))
        assert state.consistent is expected
    strict = Filter(tuned(type(OPTIONS), **structs.asdict(OPTIONS), consistent_sigma_m=1e-3), ekf.save())
    state = strict.at(ns(8.1))
    assert not state.consistent, "a sigma beyond the bound"


def test_without_sightings_a_velocity_confirms_and_inertial_data_alone_do_not() -> None:
    for left_out, expected in ((Sighting, True), ((Sighting, BodyVelocity), False)):
        ekf, received_at = flown_along(replace(QUICK, duration_s=11.0), 8.0)
        for event in received_at:
            if event.stamp.received_at > ns(8.0) and not isinstance(event, left_out):
                ekf.put([event])
        state = ekf.at(ns(10.0))
        assert state.consistent is expected


def test_one_stamp_far_ahead_is_refused_and_time_that_leaps_is_followed() -> None:
    ekf, received_at = flown_along(replace(QUICK, duration_s=9.0), 8.0)
    rest = [e for e in received_at if e.stamp.received_at > ns(8.0)]
    for by in (HOUR_NS, -10_000_000_000):
        after = copied(ekf)
        outcomes = after.put([stamped_later(rest[0], by)])
        assert outcomes[0].verdict is (Verdict.TOO_NEW if by > 0 else Verdict.TOO_OLD)
        assert newest(after).t == newest(ekf).t
        outcomes = after.put([rest[1]])
        assert outcomes[0].verdict in (Verdict.FUSED, Verdict.GATED)
        # Every one of them so far away: it is time itself.
        verdicts, leapt = [], copied(ekf)
        for event in rest:
            outcomes = leapt.put([stamped_later(event, by)])
            verdicts.append(outcomes[0].verdict)
        refused = [v for v in verdicts if v in (Verdict.TOO_NEW, Verdict.TOO_OLD)]
        assert len(refused) == OPTIONS.leap_count - 1
        assert verdicts[-1] in (Verdict.FUSED, Verdict.GATED)


def test_sightings_three_times_as_bad_as_they_say_are_not_consistent() -> None:
    scene = VoyageScene(seed=3, sea="jonswap", duration_s=9.5, imu_hz=50.0, sighting_hz=10.0, range_hz=2.0, gaps=0, outliers=0.0)
    received = voyage_truth.events(Voyage(scene))
    for factor, expected in ((0.0, True), (3.0, False)):
        rng, ekf = np.random.default_rng(0), Filter(OPTIONS)
        for event in received:
            if isinstance(event, Sighting):
                noise = factor * np.sqrt(np.diag(event.cov)[:3]) * rng.standard_normal(3)
                event = structs.replace(event, d_body_pad_level=event.d_body_pad_level + noise)
            ekf.put([event])
        state = ekf.at(ns(9.4))
        assert state.consistent is expected


def test_a_wake_after_a_calm_is_followed_from_its_first_second() -> None:
    """A filter that does not widen what it claims of the deck refuses the pad for a while: 0.46 m rms, NEES/7 3.8."""
    scene = VoyageScene(seed=406, sea="wake", hidden_delay_s=-0.03, duration_s=17.0, imu_hz=50.0, range_hz=5.0)
    s = fly_voyage(scene, since_s=10.0, forecasts=False)
    assert np.mean(s.nees) / 7.0 < 3.2
    assert s.rms_m < 0.3


def test_a_heading_that_stays_turned_round_is_accepted_in_the_end() -> None:
    scene = replace(QUICK, duration_s=14.0, gaps=0, outliers=0.0)
    voyage = Voyage(scene)
    received_at = voyage_truth.events(voyage)
    ekf, believed_at = Filter(OPTIONS), math.inf
    for event in received_at:
        if isinstance(event, Sighting) and event.stamp.measured_at > ns(4.0):
            event = turned_round(event)
        ekf.put([event])
        state = ekf.at(event.stamp.received_at) if isinstance(event, Sighting) else None
        if state is not None and state.yaw_rad is not None and event.stamp.measured_at > ns(4.0):
            t = (event.stamp.received_at - voyage_truth.EPOCH_NS) * 1e-9
            wrong = abs(math.remainder(state.yaw_rad - voyage.relative(t)[2], math.tau))
            if wrong > 2.5:
                believed_at = min(believed_at, t)
    # It had agreed for nearly four seconds, so it is held for as long.
    assert 7.0 < believed_at < 9.0
