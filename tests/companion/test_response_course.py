"""The courses that a response is identified from: every command at its instant, and nothing compared that nobody knows."""

import math

import numpy as np
import pytest

from companion.guidance.law.response_course import Track, asked_descent, asked_lean, course_of, joined, reported_lean
from companion.guidance.law.response_fit import STEP_S, FlightCourse
from estimator.contracts.commands import Hover, Lean, Velocity
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2


def test_the_tilt_that_is_requested_is_that_of_the_law_with_its_trim() -> None:
    lean = Lean(np.array([0.3, -0.2]), np.array([0.1, 0.5]), np.array([1.0, 2.0, -0.4]), 0.0)
    assert asked_lean(lean) == pytest.approx((0.4, 0.3))
    for command in (None, Hover(), Velocity(np.array([1.0, 2.0, 3.0]), 0.0)):
        assert all(map(math.isnan, asked_lean(command)))
    assert asked_descent(lean) == -0.4
    assert asked_descent(Velocity(np.array([1.0, 2.0, 3.0]), 0.0)) == 3.0
    assert math.isnan(asked_descent(Hover()))
    assert math.isnan(asked_descent(None))


@pytest.mark.parametrize(("roll", "pitch"), [(0.2, 0.0), (0.0, 0.3), (-0.4, 0.25), (0.3, -0.5)])
def test_a_reported_tilt_is_where_a_thrust_that_holds_the_height_pushes(roll: float, pitch: float) -> None:
    """Whatever the heading: the thrust is along the body's own axis, and its part upward is gravity's."""
    thrust = Rotation.from_rpy(roll, pitch, 0.0).matrix @ np.array([0.0, 0.0, -1.0])
    for yaw in (0.0, 2.0):
        assert reported_lean(Rotation.from_rpy(roll, pitch, yaw)) == pytest.approx((-thrust / thrust[2] * G_M_S2)[:2])


def uneven_tracks(seed: int) -> tuple[Track, Track]:
    """Commands and reports at uneven instants: hovering now and then, a silence of either, reports that begin later."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.012, 0.03, 700)) + 3.0
    t[400:] += 0.55
    asked = rng.normal(size=(t.size, 2))
    asked[150:153] = asked[550] = math.nan
    asked[560, 1] = math.nan
    at = np.cumsum(rng.uniform(0.004, 0.02, 1400)) + 3.1
    at[500:] += 0.26
    return Track(t, asked), Track(at, rng.normal(size=(at.size, 2)))


def held_at(asked: Track, t: F64) -> F64:
    """Return the command that holds at each instant; nan where it was not renewed within half a second."""
    k = np.searchsorted(asked.t_s, t, side="right") - 1
    ends = np.append(asked.t_s[1:], asked.t_s[-1] + 0.5)
    return np.where((ends - asked.t_s <= 0.5)[k][:, None], asked.values[k], math.nan)


@pytest.mark.parametrize("seed", range(6))
def test_a_course_is_the_mean_of_what_held_over_each_step_beside_what_was_reported_at_its_beginning(seed: int) -> None:
    asked, reported = uneven_tracks(seed)
    course = course_of(asked, reported, 0.003, 1)
    assert course is not None
    first, last = max(asked.t_s[0], reported.t_s[0]), min(asked.t_s[-1], reported.t_s[-1])
    n = int((last - first) / STEP_S)
    assert course.asked.shape == course.reported.shape == (n, 2)
    assert (course.stamp_sigma_s, course.drifts) == (0.003, 1)
    fine = 200
    held = held_at(asked, first + STEP_S * (np.arange(n * fine) + 0.5) / fine).reshape(n, fine, 2)
    begins = first + STEP_S * np.arange(n)
    y = np.column_stack([np.interp(begins, reported.t_s, one) for one in reported.values.T])
    known = np.isfinite(held).all(axis=(1, 2))
    np.testing.assert_allclose(course.reported, y)
    np.testing.assert_allclose(course.asked[known], held.mean(axis=1)[known], atol=0.05)
    np.testing.assert_allclose((course.asked - held.mean(axis=1))[known].mean(axis=0), 0.0, atol=1e-3)
    np.testing.assert_array_equal(course.asked[~known], y[~known], "where nobody asks, the vehicle leans as it likes")
    between = np.clip(np.searchsorted(reported.t_s, begins), 1, None)
    received = reported.t_s[between] - reported.t_s[between - 1] <= 0.25
    counts = [bool(known[k] and received[k] and k >= 60 and known[k - 60 : k].all()) for k in range(n)]
    np.testing.assert_array_equal(course.counts, counts)
    assert 100 < sum(counts) < n - 200


@pytest.mark.parametrize(("seconds", "steps"), [(0.035, None), (0.05, 2), (0.07, 3)])
def test_two_steps_are_a_course_and_fewer_are_none(seconds: float, steps: int | None) -> None:
    two = Track(np.array([1.0, 1.0 + seconds]), np.zeros((2, 1)))
    course = course_of(two, two)
    assert (None if course is None else len(course.counts)) == steps
    later = Track(two.t_s + 9.0, two.values)
    assert course_of(two, later) is course_of(later, two) is None, "they do not overlap"
    one = Track(two.t_s[:1], two.values[:1])
    assert course_of(one, two) is course_of(two, one) is None
    none = Track(np.empty(0), np.empty((0, 1)))
    assert course_of(none, two) is course_of(two, none) is course_of(none, none) is None


def test_flights_are_joined_in_their_order() -> None:
    def part(n: int, value: float) -> FlightCourse:
        return FlightCourse(np.full((n, 2), value), np.full((n, 2), -value), np.arange(n) > 1, 0.01 * value, 1)

    assert joined([]) is None
    both = joined([part(3, 1.0), part(4, 2.0)])
    assert both is not None
    np.testing.assert_array_equal(both.asked[:, 0], [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0])
    np.testing.assert_array_equal(both.reported, -both.asked)
    np.testing.assert_array_equal(both.counts, [False, False, True, False, False, True, True])
    assert (both.stamp_sigma_s, both.drifts) == (0.01, 1)
