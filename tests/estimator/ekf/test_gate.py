"""Wrong sightings are refused and never capture the filter; a filter or a sensor that is wrong itself finds back."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.samples import UNKNOWN_VAR, Range
from estimator.ekf import EkfOptions, Event, Filter
from estimator.ekf.params import ACCEL_BIAS, BARO_OFFSET, POS_REL, VEL, VEL_SCALE, VESSEL_VEL
from tests.estimator.ekf.core_state import newest
from tests.make import attitude, baro, imu, sighting, velocity, vessel
from tests.make import ns as instant
from tests.support.estimator_truth import EPOCH_NS, OPTIONS, Setting, TruthFlight, events, ns, setting

CALM = Setting(seed=1, sea=2, duration_s=9.0, imu_hz=100.0, sighting_hz=20.0, attitude_hz=20.0, velocity_hz=20.0)
OVER = replace(CALM, legs=((0.0, 0.1, 0.0, 2.0), (9.0, 0.1, 0.0, 2.0)), lively=0.2, range_hz=20.0)
BESIDE = replace(OVER, legs=((0.0, 2.5, 0.0, 2.0), (9.0, 2.5, 0.0, 2.0)))
Change = Callable[[Event, float], Event]
"""The event that a test puts in place of one that was measured at so many seconds."""


def fly_gated(
    flight: TruthFlight, change: Change = lambda event, t: event, options: EkfOptions | None = None, until_s: float = 60.0
) -> Iterator[tuple[Filter, float, Event, Verdict]]:
    """Yield the filter, each event's instant, the event and its verdict."""
    ekf = Filter(options)
    for event in events(flight):
        if event.stamp.received_at > ns(until_s):
            break
        t = (event.stamp.measured_at - EPOCH_NS) * 1e-9
        changed = change(event, t)
        yield ekf, t, changed, ekf.put([changed])[0].verdict


def error_m(ekf: Filter, flight: TruthFlight, t: float, by: float | np.ndarray = 0.0) -> float:
    state = ekf.at(ns(t))
    return float(np.linalg.norm(state.d_body_pad_level - flight.relative(np.array([t]))[0][0] - by))


def shifted(s: Sighting, by: np.ndarray) -> Sighting:
    return structs.replace(s, d_body_pad_level=s.d_body_pad_level + by)


def level(flight: TruthFlight, t_s: float, ned: np.ndarray) -> np.ndarray:
    """Return a vector fixed to the world, in the axes that turn with the body."""
    R = flight.attitude(np.array([t_s]))[0]
    c, s = R[:2, 0] / np.hypot(*R[:2, 0])
    return np.array([c * ned[0] + s * ned[1], c * ned[1] - s * ned[0], ned[2]])


def test_five_percent_wrong_sightings_never_capture_it() -> None:
    flight = TruthFlight(replace(CALM, outliers=0.05, duration_s=12.0))
    gated, next_s, worst = 0, 2.0, 0.0
    for ekf, _, event, verdict in fly_gated(flight):
        gated += isinstance(event, Sighting) and verdict is Verdict.GATED
        while event.stamp.received_at > ns(next_s):
            worst = max(worst, error_m(ekf, flight, next_s))
            next_s += 0.1
    assert 3 <= gated <= 25
    assert worst < 0.25


def test_a_false_pad_beside_the_true_one_is_refused_as_long_as_the_true_one_shows() -> None:
    flight = TruthFlight(CALM)

    def is_false(event: Event, t: float) -> bool:
        return isinstance(event, Sighting) and t > 3.0 and event.seq % 2 == 0

    def change(event: Event, t: float) -> Event:
        false = is_false(event, t) and isinstance(event, Sighting)
        return shifted(event, level(flight, t, np.array([0.6, 0.3, 0.0]))) if false else event

    flown = list(fly_gated(flight, change))
    assert {verdict for _, t, event, verdict in flown if is_false(event, t)} == {Verdict.GATED}
    assert error_m(flown[-1][0], flight, 8.9) < 0.1


def test_a_pad_that_has_moved_for_good_is_accepted_after_a_while() -> None:
    """Sightings that are refused again and again, always alike, move the estimate, and `consistent` is false meanwhile."""
    flight, jump, consistent = TruthFlight(CALM), np.array([0.8, -0.5, 0.2]), set[bool]()

    def change(event: Event, t: float) -> Event:
        return shifted(event, level(flight, t, jump)) if isinstance(event, Sighting) and t > 4.0 else event

    verdicts = []
    for ekf, t, event, verdict in fly_gated(flight, change):
        if isinstance(event, Sighting) and t > 4.0:
            verdicts.append((t, verdict))
            state = ekf.at(event.stamp.received_at)
            consistent.add(state.consistent)
    assert 0.5 < min(t for t, v in verdicts if v is Verdict.FUSED) - 4.0 < 1.5
    assert [v for _, v in verdicts][-20:].count(Verdict.FUSED) >= 18
    state = ekf.at(ns(8.9))
    assert (consistent, state.consistent) == ({False, True}, True)
    assert error_m(ekf, flight, 8.9, level(flight, 8.9, jump)) < 0.12


def test_a_state_that_drifts_away_from_what_is_seen_finds_back() -> None:
    """Waves not learned yet, the deck rises 1.5 m/s more than expected: refused sightings agree, though each is farther."""
    flown = fly_gated(TruthFlight(setting(86)), options=OPTIONS, until_s=10.0)
    fused = [t for _, t, event, verdict in flown if isinstance(event, Sighting) and verdict is Verdict.FUSED and t > 2.0]
    assert max(np.diff([2.0, *sorted(fused)])) < 1.5


def test_a_slow_vessel_s_ground_is_not_taken_for_its_deck() -> None:
    """0.2 m/s under way, a sensor over the ground, and an accelerometer that errs by more than that within two seconds."""
    ekf = list(fly_gated(TruthFlight(setting(37)), options=OPTIONS, until_s=10.0))[-1][0]
    assert newest(ekf).over_pad < -1.0
    assert abs(newest(ekf).x[VEL_SCALE] / setting(37).velocity_scale - 1.0) < 0.05


def test_a_wrong_first_sighting_is_soon_overthrown() -> None:
    def change(event: Event, t: float) -> Event:
        return shifted(event, np.array([2.0, 2.0, 1.0])) if isinstance(event, Sighting) and event.seq == 1 else event

    flight = TruthFlight(CALM)
    assert error_m(list(fly_gated(flight, change, until_s=2.0))[-1][0], flight, 2.0) < 0.25


@pytest.mark.parametrize(
    ("flown", "by_m", "verdict"), [(OVER, 0.0, Verdict.FUSED), (OVER, 0.6, Verdict.GATED), (BESIDE, 0.0, Verdict.GATED)]
)
def test_a_range_counts_over_the_deck_and_is_refused_beyond_its_edge(flown: Setting, by_m: float, verdict: Verdict) -> None:
    def change(event: Event, t: float) -> Event:
        return structs.replace(event, range_m=event.range_m + by_m) if isinstance(event, Range) and t > 5.0 else event

    flight = TruthFlight(flown)
    found = list(fly_gated(flight, change))
    verdicts = [v for _, t, event, v in found if isinstance(event, Range) and t > 5.0]
    assert verdicts.count(verdict) > 0.95 * len(verdicts)
    assert flown is BESIDE or error_m(found[-1][0], flight, 8.9) < 0.1


def test_an_offset_of_the_range_sensor_is_learned_and_not_accepted() -> None:
    """An AR.Drone's ultrasound sits 3.4 cm under what motion capture calls the drone."""

    def change(event: Event, t: float) -> Event:
        return structs.replace(event, range_m=event.range_m - 0.06) if isinstance(event, Range) else event

    flight = TruthFlight(OVER)
    state = list(fly_gated(flight, change))[-1][0].at(ns(8.9))
    assert abs(dict(state.details)["range_offset_m"] + 0.06) < 0.02
    assert abs(state.d_body_pad_level[2] - flight.relative(np.array([8.9]))[0][0, 2]) < 0.02


def test_first_imu_alone_levels_the_body() -> None:
    ekf, f = Filter(), np.array([0.5, -0.3, -9.78])
    verdicts = [ekf.put([imu(100.0 + 0.01 * k, f=f + 1e-6 * (k % 2))])[0].verdict for k in range(20)]
    assert verdicts == [Verdict.FUSED] * 20
    np.testing.assert_allclose(newest(ekf).R[2], -f / np.linalg.norm(f), atol=1e-3)


# Sensors of a body that hovers, and jump for good


def hover(
    seconds: float, ekf: Filter, since: float = 100.0, yaw: float = 0.0, forward_m_s: float = 0.0, ship: str = ""
) -> Filter:
    """Hover over a pad two metres below, its arrow to the north-east, with a velocity sensor; a ship may report 1.5 m/s."""
    rng = np.random.default_rng(round(10 * since))
    for k in range(round(seconds * 50)):
        t = since + 0.02 * k
        ekf.put([imu(t, 1e-3 * rng.standard_normal(3), [0.0, 0.0, -9.80665] + 1e-2 * rng.standard_normal(3))])
        ekf.put([attitude(t, yaw=yaw, var=0.005**2)])
        if k % 5 == 0 and ship != "unseen":
            d = np.array([0.2, -0.1, 2.0]) + 0.005 * rng.standard_normal(3)
            ekf.put([sighting(t, d, -0.7 + 0.01 * rng.standard_normal(), var=[1e-4, 1e-4, 4e-4], yaw_var=4e-4, seq=k)])
        if k % 5 == 1:
            v = np.array([forward_m_s, 0.0, 0.0]) + 0.01 * rng.standard_normal(3)
            ekf.put([velocity(t, v, var=[0.02**2, 0.02**2, UNKNOWN_VAR])])
        if k % 10 == 2 and ship:
            ekf.put([vessel(t, [1.5, 0.0, 0.0], 0.7)])
    return ekf


def test_an_attitude_with_a_new_north_comes_back_in_and_the_pad_stays() -> None:
    ekf = hover(4.0, Filter())
    before = ekf.at(instant(103.99))
    state = hover(4.0, ekf, since=104.0, yaw=0.8).at(instant(107.99))
    np.testing.assert_allclose(state.d_body_pad_level, before.d_body_pad_level, atol=0.08)
    assert abs(state.yaw_rad + 0.7) < 0.05
    assert abs(math.atan2(newest(ekf).R[1, 0], newest(ekf).R[0, 0]) - 0.8) < 0.1


def test_a_velocity_that_jumps_for_good_comes_back_in_as_body_and_vessel_together() -> None:
    ekf = hover(4.0, hover(4.0, Filter(EkfOptions(velocity_is_over="ground"))), since=104.0, forward_m_s=1.5)
    b = newest(ekf)
    assert abs(b.x[VEL][0] * b.x[VEL_SCALE] - 1.5) < 0.4
    assert abs(b.x[VESSEL_VEL][0] - b.x[VEL][0]) < 0.2
    np.testing.assert_allclose(b.x[POS_REL], [0.2, -0.1, 2.0], atol=0.05)


def test_a_ship_under_way_that_reports_it_before_sight_is_no_tilt_and_no_bias() -> None:
    x = newest(hover(1.0, hover(1.0, Filter(), ship="unseen"), since=101.0, ship="seen")).x
    np.testing.assert_allclose([*x[VEL][:2], *x[VESSEL_VEL]], [1.5, 0.0, 1.5, 0.0], atol=0.15)
    np.testing.assert_allclose(x[ACCEL_BIAS][:2], 0.0, atol=0.03)


def test_a_barometer_that_jumps_for_good_comes_back_in_by_its_offset() -> None:
    ekf, verdicts = hover(2.0, Filter()), []
    for k in range(200):
        t = 102.0 + 0.02 * k
        hover(0.02, ekf, since=t)
        verdicts += [ekf.put([baro(t + 0.01, 12.0 if k < 50 else 52.0, 0.3)])[0].verdict]
    assert Verdict.GATED in verdicts[50:60]
    assert verdicts[-20:] == [Verdict.FUSED] * 20
    assert abs(newest(ekf).x[BARO_OFFSET] - 50.0) < 0.5
    assert abs(newest(ekf).x[POS_REL][2] - 2.0) < 0.05
