"""A view that stands still, at each edge: how many looks over how long, and how far the body has to have turned."""

import math

import numpy as np
import pytest
from msgspec import structs

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, Stamp
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.view import ViewWatch, watch

LIMITS = IntegrityOptions()
S, MS = 1_000_000_000, 1_000_000


def looked(
    instants_ms: list[float],
    limits: IntegrityOptions = LIMITS,
    *,
    swing_rad: float = 0.05,
    height_m: float = 2.0,
    own: float = 0.0,
) -> ViewWatch:
    """Return the watch after a roll to and fro by `swing_rad` at each look; the body's bearing moves by `own` of that."""
    state = ViewWatch()
    for i, ms in enumerate(instants_ms):
        t = MonoNs(10 * S + round(ms * MS))
        stamp, roll = Stamp(t, t, 0.001, "sim"), swing_rad * (-1) ** i
        R = Rotation.from_rpy(roll, 0.0, 0.7)
        d = R.without_heading() @ (height_m * np.array([0.0, math.sin(own * roll), math.cos(own * roll)]))
        sighting = Sighting(stamp, i, "registration", d, 0.1, False, 1e-4 * np.eye(4), 0.9)
        state = watch(state, sighting, Attitude(stamp, R, 1e-5 * np.eye(3)), limits)
    return state


EIGHT = [300.0 * i / 7 for i in range(8)]


def test_a_new_watch_is_not_frozen() -> None:
    assert ViewWatch() == ViewWatch((), False)


@pytest.mark.parametrize(
    ("instants_ms", "frozen"),
    [
        (EIGHT, True),
        (EIGHT[:1] + EIGHT[2:], False),
        ([*EIGHT[:-1], 299.999], False),
        ([0.0, *(480.0 + i for i in range(7))], True),
        ([0.0, *(495.0 + i for i in range(7))], False),
    ],
    ids=["eight in three tenths", "seven", "too quick", "within half a second", "beyond it"],
)
def test_it_takes_eight_looks_over_three_tenths_of_the_last_half_second(instants_ms: list[float], frozen: bool) -> None:
    assert looked(instants_ms).frozen is frozen


def test_looks_are_kept_for_half_a_second_and_none_from_the_future() -> None:
    assert len(looked([0.0, 500.0]).bearings) == 2
    assert len(looked([0.0, 500.000001]).bearings) == 1
    assert len(looked([0.0, -10.0]).bearings) == 1
    assert len(looked([0.0, 0.0]).bearings) == 2


def test_a_bearing_is_a_direction_whatever_the_distance() -> None:
    for height_m in (0.1, 1.0, 30.0):
        state = looked(EIGHT, height_m=height_m, own=0.05)
        assert all(np.linalg.norm(bearing) == pytest.approx(1.0) for _, bearing, *_ in state.bearings)
        assert state.frozen


def test_a_pad_at_no_distance_has_no_bearing() -> None:
    assert looked(EIGHT, height_m=0.9e-6).bearings == ()
    assert looked([0.0], height_m=1.1e-6).bearings != ()


@pytest.mark.parametrize(("limit", "swing_rad", "frozen"), [(0.01, 0.0099, False), (0.01, 0.0101, True), (0.03, 0.0297, False)])
def test_the_body_has_to_have_turned(limit: float, swing_rad: float, frozen: bool) -> None:
    assert looked(EIGHT, structs.replace(LIMITS, view_turned_min_rad=limit), swing_rad=swing_rad).frozen is frozen


@pytest.mark.parametrize(("own", "frozen"), [(0.0, True), (0.095, True), (0.115, False), (1.0, False)])
def test_the_bearing_has_to_have_moved_less_than_a_tenth_of_that(own: float, frozen: bool) -> None:
    assert looked(EIGHT, own=own).frozen is frozen
