"""Range and barometer against the camera at each edge: where a range counts, how far it may lie, and for how long."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Baro, Range
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.heights import HeightWatch, ranged, sighted, weighed
from estimator.integrity.options import IntegrityOptions

LIMITS = IntegrityOptions()
S = 1_000_000_000
T = 100 * S
OVER = HeightWatch(seen_at=T, d_level=(0.0, 0.0, 2.0), range_at=T - S // 4)
"""Two metres over the pad, the range before a quarter of a second ago."""


JUST_BEYOND_M = 2.24 + 1e-8
"""A range that differs from a camera height of 2 m by no more than what is allowed and a trace."""


def stamp(t: int) -> Stamp:
    return Stamp(MonoNs(t), MonoNs(t), 0.001, "sim")


def received_at(state: HeightWatch, range_m: float, t: int = T, sigma_m: float = 1e-9) -> HeightWatch:
    return ranged(state, Range(stamp(t), range_m, sigma_m), LIMITS)


def speaks(state: HeightWatch, range_m: float, t: int = T, sigma_m: float = 1e-9) -> bool | None:
    """Return whether a range agrees; None where it counts for nothing."""
    after = received_at(state, range_m, t, sigma_m)
    assert after.range_at == t
    return True if after.agreed_at == t else False if after.against_s > 0.0 else None


def test_a_sighting_is_kept_with_the_bodys_down_axis() -> None:
    roll, pitch = 0.2, 0.1
    seen = Sighting(stamp(T), 1, "registration", np.array([1.0, 2.0, 3.0]), 0.0, False, 1e-4 * np.eye(4), 0.9)
    state = sighted(HeightWatch(), seen, Rotation.from_rpy(roll, pitch, 1.3))
    assert (state.seen_at, state.d_level) == (T, (1.0, 2.0, 3.0))
    assert state.down_level == pytest.approx(
        (math.sin(pitch) * math.cos(roll), -math.sin(roll), math.cos(pitch) * math.cos(roll))
    )


@pytest.mark.parametrize(
    ("height_m", "range_m", "sigma_m", "agrees"),
    [
        (2.0, 2.23, 1e-9, True), (2.0, 2.25, 1e-9, False), (2.0, 1.77, 1e-9, True), (2.0, 1.75, 1e-9, False),
        (2.0, 2.33, 0.05, True), (2.0, 2.35, 0.05, False), (2.0, 1.67, 0.05, True), (2.0, 1.65, 0.05, False),
        (4.0, 4.39, 1e-9, True), (4.0, 4.41, 1e-9, False),
    ],
)  # fmt: skip
def test_a_range_may_lie_a_length_a_share_and_two_sigmas_away(height_m, range_m, sigma_m, agrees):
    assert speaks(replace(OVER, d_level=(0.0, 0.0, height_m)), range_m, sigma_m=sigma_m) is agrees


def leaning(cx: float, cy: float, foot_m: tuple[float, float] = (0.0, 0.0), height_m: float = 2.0) -> HeightWatch:
    """Return a state in which the sensor's axis meets the deck this far from the pad."""
    cz = math.sqrt(1.0 - cx * cx - cy * cy)
    d = (cx * height_m / cz + foot_m[0], cy * height_m / cz + foot_m[1], height_m)
    return replace(OVER, d_level=d, down_level=(cx, cy, cz))


@pytest.mark.parametrize("lean", [(0.4, 0.0), (0.0, 0.4), (-0.3, 0.3)])
def test_it_counts_where_the_axis_meets_the_deck_and_anything_between_axis_and_perpendicular_agrees(lean):
    along_m = 2.0 / math.sqrt(1.0 - lean[0] ** 2 - lean[1] ** 2)
    for range_m, agrees in ((along_m + 0.23, True), (along_m + 0.25, False), (2.0, True), (1.77, True), (1.75, False)):
        assert speaks(leaning(*lean), range_m) is agrees
    for foot in ((0.49, 0.0), (0.0, -0.49), (0.3, 0.3)):
        assert speaks(leaning(lean[0], lean[1], foot), 2.1) is True
    for foot in ((0.51, 0.0), (0.0, -0.51), (0.4, 0.4)):
        assert speaks(leaning(lean[0], lean[1], foot), 2.1) is None


@pytest.mark.parametrize(
    ("foot_m", "range_m", "says"),
    [(1.39, 3.59, False), (1.39, 3.61, None), (1.39, 6.0, None), (1.41, 2.0, None), (0.49, 3.61, True), (0.49, 6.0, False)],
)
def test_beyond_the_deck_only_what_is_nearer_than_the_pad_counts_and_only_close_around_it(foot_m, range_m, says):
    assert speaks(replace(OVER, d_level=(foot_m, 0.0, 4.0)), range_m) is says


@pytest.mark.parametrize(
    ("state", "range_m", "counts"),
    [
        (replace(OVER, down_level=(0.0, 0.0, 0.85)), 3.0, True),
        (replace(OVER, down_level=(0.0, 0.0, 0.849)), 3.0, False),
        (replace(OVER, d_level=(0.0, 0.0, 0.35)), 3.0, True),
        (replace(OVER, d_level=(0.0, 0.0, 0.349)), 3.0, False),
        (replace(OVER, d_level=(0.0, 0.0, 0.6)), 0.175, True),
        (replace(OVER, d_level=(0.0, 0.0, 0.6)), 0.174, False),
    ],
)
def test_a_tilt_or_a_height_beyond_the_sensor_reports_nothing(state: HeightWatch, range_m: float, counts: bool) -> None:
    assert speaks(state, range_m) is (False if counts else None)


@pytest.mark.parametrize(
    ("after", "counts"), [(3 * S // 10, True), (3 * S // 10 + 1, False), (-3 * S // 10, True), (-3 * S // 10 - 1, False)]
)
def test_a_sighting_is_compared_for_three_tenths_of_a_second(after: int, counts: bool) -> None:
    state = replace(OVER, range_at=T - S)
    assert speaks(state, 2.0, T + after) is (True if counts else None)
    weighed_after = weighed(state, Baro(stamp(T + after), 30.0, 0.5), LIMITS)
    assert (weighed_after.rise != ()) is counts


@pytest.mark.parametrize(("off", "times"), [(1.5, 1.5), (2.9, 2.9), (3.1, 3.0), (9.0, 3.0)])
def test_a_large_difference_counts_up_to_three_times_as_fast(off: float, times: float) -> None:
    state = replace(OVER, range_at=T - S // 10)
    assert received_at(state, 2.0 + 0.24 * off).against_s == pytest.approx(0.1 * times)


def test_a_second_against_contradicts_and_agreement_ends_it_only_when_it_has_weighed_it_up() -> None:
    assert received_at(replace(OVER, against_s=0.75), JUST_BEYOND_M).contradicted
    assert not received_at(replace(OVER, against_s=0.74), JUST_BEYOND_M).contradicted
    assert received_at(replace(OVER, against_s=1.4), 3.0).against_s == 1.5, "no grudge for ever"
    assert received_at(replace(OVER, against_s=0.5, contradicted=True), 2.0).contradicted
    over = received_at(replace(OVER, against_s=0.25, contradicted=True), 2.0)
    assert (over.against_s, over.contradicted) == (0.0, False)
    assert received_at(replace(OVER, against_s=0.1), 2.0).against_s == 0.0
    assert not received_at(replace(OVER, against_s=0.5), 2.0).contradicted


def pressed(state: HeightWatch, baro_m: float, t: int = T) -> HeightWatch:
    return weighed(state, Baro(stamp(t), baro_m, 0.5), LIMITS)


@pytest.mark.parametrize(
    ("drift_m", "from_m", "contradicts"),
    [
        (2.5, 2.0, False), (2.51, 2.0, True), (-2.5, 2.0, False), (-2.51, 2.0, True),
        (3.5, 5.0, False), (3.51, 5.0, True), (3.5, -1.0, False), (3.51, -1.0, True),
    ],
)  # fmt: skip
def test_it_contradicts_beyond_its_tolerance_and_a_third_of_the_change(drift_m: float, from_m: float, contradicts: bool) -> None:
    rise = ((T - 10 * S, 0.0), (T - S // 4, 0.75 * drift_m))
    state = replace(OVER, rise=rise, rise_now=drift_m, seen_height=((T - 8 * S, from_m), (T - S // 4, 2.0)))
    assert pressed(state, 2.0 + drift_m).baro_contradicted is contradicts
    short = replace(state, rise=((T - 10 * S + 1, 0.0), *rise[1:]))
    assert not pressed(short, 2.0 + drift_m).baro_contradicted
    twice = replace(short, rise_now=2.0 * drift_m)
    assert pressed(twice, 2.0 + 2.0 * drift_m).baro_contradicted is contradicts, "too short a time for a wave's crest and trough"


@pytest.mark.parametrize("now_m", [-3.0, 0.0, 5.0, 9.0])
def test_a_difference_within_what_it_was_is_a_wave_that_came_back(now_m: float) -> None:
    rise = ((T - 11 * S, 7.0), (T - 8 * S, -1.0), (T - 7 * S, 3.0))
    state = replace(OVER, rise=rise, rise_now=now_m, seen_height=((T - 8 * S, 2.0),))
    assert not pressed(state, 2.0 + now_m).baro_contradicted
    assert pressed(replace(state, rise=rise[1:], rise_now=9.0), 11.0).baro_contradicted
