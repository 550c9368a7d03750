"""The response of a vehicle as a file gives it, its fit, and the cost of a wrong one at touchdown."""

import math
import tomllib
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from companion.guidance.law.flown_course import Track, asked_descent, asked_lean, course_of, joined, reported_lean
from companion.guidance.law.gains import tilt_model
from companion.guidance.law.margins import margins
from companion.guidance.law.response_fit import STEP_S, FlightCourse, TiltFit, fit_climb, fit_tilt, text
from companion.settings.guidance import ClimbResponse, Response, TiltResponse, response_from_mapping
from companion.settings.load import shipped_response
from companion.tools.calibrate.touchdown_cost import ResponseCost, tilt_of_file, tilt_of_sigma
from estimator.contracts.commands import Hover, Lean, Velocity
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.motion import G_M_S2


@pytest.mark.parametrize(
    "wrong", [{"delay_s": 0.61}, {"frequency_rad_s": 0.9}, {"damping": 0.1}, {"lag_s": -0.01}, {"max_deg": 46.0}]
)
def test_a_tilt_outside_its_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        TiltResponse(**{"delay_s": 0.05, "frequency_rad_s": 5.0, "damping": 0.7, **wrong})


@pytest.mark.parametrize("wrong", [{"delay_s": 0.61}, {"lag_s": 0.01}, {"max_m_s": 5.1}])
def test_a_climb_outside_its_range_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ClimbResponse(**{"delay_s": 0.05, "lag_s": 0.4, **wrong})


def test_the_largest_tilt_is_the_acceleration_of_a_hovering_thrust() -> None:
    assert TiltResponse(0.05, 5.0, 0.7, max_deg=30.0).max_m_s2 == pytest.approx(G_M_S2 / math.sqrt(3.0))


@pytest.mark.parametrize(
    "tilt", [TiltResponse(0.07, 6.0, 0.8, 0.05), TiltResponse(0.2, 15.0, 0.4), TiltResponse(0.0, 5.0, 1.5, 0.2)]
)
def test_a_steady_change_of_the_command_is_followed_as_late_as_is_reported(tilt: TiltResponse) -> None:
    """A command that is held for a period is half a period later than the line through its beginnings."""
    period_s = 0.01
    model = tilt_model(tilt, period_s)
    x = np.zeros(len(model.A))
    for k in range(2000):
        x = model.A @ x + model.B * (k * period_s)
    assert 2000 * period_s - x[2] == pytest.approx(tilt.slowness_s + 0.5 * period_s, abs=1e-6)


COV = [[4e-4, 1e-3, 2e-4], [1e-3, 9e-2, 3e-3], [2e-4, 3e-3, 1e-2]]


def response_file(cov: Any = COV, **tilt: float) -> dict[str, Any]:
    given = {"delay_s": 0.05, "frequency_rad_s": 5.0, "damping": 0.7, "cov_delay_frequency_damping": cov, **tilt}
    return {"tilt": given, "climb": {"delay_s": 0.06, "lag_s": 0.4, "cov_delay_lag": [[1e-4, 0.0], [0.0, 4e-4]]}}


def test_a_covariance_gives_the_standard_deviations_that_a_file_leaves_out() -> None:
    read = response_from_mapping(response_file(damping_sigma=0.1), "mine.toml")
    assert read.tilt.cov_delay_frequency_damping == tuple(tuple(row) for row in COV)
    assert (read.tilt.delay_sigma_s, read.tilt.frequency_sigma_rad_s, read.tilt.damping_sigma) == pytest.approx((0.02, 0.3, 0.1))
    assert (read.climb.delay_sigma_s, read.climb.lag_sigma_s) == pytest.approx((0.01, 0.02))


def with_entry(row: int, column: int, value: Any) -> list[list[Any]]:
    return [[value if (i, j) == (row, column) else v for j, v in enumerate(one)] for i, one in enumerate(COV)]


@pytest.mark.parametrize(
    ("cov", "said"),
    [
        (with_entry(1, 1, math.nan), "row 2, column 2 must be a finite number, got nan"),
        (with_entry(0, 2, math.inf), "row 1, column 3 must be a finite number, got inf"),
        (with_entry(0, 1, 1.1e-3), "must be symmetric: row 1, column 2 is 0.0011 and row 2, column 1 is 0.001"),
        (with_entry(2, 2, -1e-2), "the variance in row 3 must be above 0 and at most 9, got -0.01"),
        (with_entry(0, 0, 0.5), "the variance in row 1 must be above 0 and at most 0.36, got 0.5"),
        ([[4e-4, 6.1e-3, 0.0], [6.1e-3, 9e-2, 0.0], [0.0, 0.0, 1e-2]], "must be positive definite"),
        (with_entry(2, 2, "much"), "Expected `float`"),
        (COV[:2], "length 3"),
    ],
)
def test_what_is_no_covariance_is_refused_with_its_place_and_what_to_do(cov: Any, said: str) -> None:
    with pytest.raises(BadInput) as refused:
        response_from_mapping(response_file(cov), "mine.toml")
    assert str(refused.value).startswith("mine.toml: ")
    assert said in str(refused.value)
    assert "tilt" in str(refused.value)
    assert "Expected" in said or "length" in said or "leave it out" in str(refused.value)


def test_a_standard_deviation_and_a_covariance_have_to_agree() -> None:
    response_from_mapping(response_file(delay_sigma_s=0.0203), "mine.toml")
    with pytest.raises(BadInput, match=r"delay_sigma_s is 0\.021, but cov_delay_frequency_damping says 0\.02"):
        response_from_mapping(response_file(delay_sigma_s=0.021), "mine.toml")


GIVEN = shipped_response("ardrone2")
TRUE = structs.replace(GIVEN.tilt, delay_s=0.12, frequency_rad_s=5.5, damping=0.6)
WARM = 60
"""Steps of a course that are not compared."""


def asked_tilts(seed: int, n: int) -> F64:
    """Return steps of half a second about a trim, two axes."""
    rng = np.random.default_rng(seed)
    return np.asarray(0.4 + np.repeat(rng.normal(size=(n // 25 + 1, 2)), 25, axis=0)[:n])


def answered(true: TiltResponse, u: F64, gain: float = 1.0) -> F64:
    model, out = tilt_model(true, STEP_S), np.zeros_like(u)
    for axis in range(2):
        x = np.zeros(model.A.shape[0])
        for k in range(u.shape[0]):
            out[k, axis] = gain * (x[2] + u[0, axis])
            x = model.A @ x + model.B * (u[k, axis] - u[0, axis])
    return out


def lasting(rng: np.random.Generator, shape: tuple[int, int], sigma: float, rho: float) -> F64:
    out = np.zeros(shape)
    out[0] = sigma * rng.normal(size=shape[1])
    for k in range(1, shape[0]):
        out[k] = rho * out[k - 1] + sigma * math.sqrt(1.0 - rho * rho) * rng.normal(size=shape[1])
    return out


def course(
    seed: int = 1, n: int = 600, *, gain: float = 1.0, noise: float = 0.0, rho: float = 0.9, drifts: int = 0
) -> FlightCourse:
    """Return the reports of `TRUE` for steps, with an offset or a drift; before the compared part they are nonsense."""
    u, counts = asked_tilts(seed, n), np.arange(n) > WARM
    off = np.outer(np.ones(n) if drifts == 0 else np.arange(n) / n, [0.3, -0.2])
    y = answered(TRUE, u, gain) + off + lasting(np.random.default_rng(seed + 100), (n, 2), noise, rho)
    return FlightCourse(u, np.where(counts[:, None], y, 99.0), counts, 0.0, drifts)


def fitted(of: FlightCourse, begin: TiltFit | None = None, steps: int = 12) -> TiltFit:
    found = fit_tilt(of, GIVEN.tilt, begin, steps)
    assert found is not None
    return found


@pytest.mark.parametrize("drifts", [0, 1, 2])
def test_a_course_without_errors_gives_the_response_that_made_it(drifts: int) -> None:
    of = course(gain=1.2, drifts=drifts)
    found = fitted(of)
    got = found.response
    assert (got.delay_s, got.frequency_rad_s, got.damping, found.gain) == pytest.approx((0.12, 5.5, 0.6, 1.2), rel=1e-3)
    assert (got.lag_s, got.max_deg) == (GIVEN.tilt.lag_s, GIVEN.tilt.max_deg)
    assert found.fitted.residual < 1e-3
    assert found.fitted.seconds == pytest.approx((600 - WARM - 2) * STEP_S)
    off = np.outer(np.ones(600) if drifts == 0 else np.arange(600) / 600, [0.3, -0.2])
    np.testing.assert_allclose(found.fitted.offset, off, atol=2e-3)
    assert np.isnan(found.fitted.model[: WARM + 1]).all()
    np.testing.assert_allclose((found.fitted.model + off)[WARM + 1 :], of.reported[WARM + 1 :], atol=5e-3)


def test_an_error_of_the_stamps_is_one_of_the_delay_and_no_delay_is_known_to_less_than_4_ms() -> None:
    sure, unsure = course(noise=0.0), course(noise=0.0)._replace(stamp_sigma_s=0.03)
    assert 0.004 <= fitted(sure).delay_sigma_s < 0.0045
    before, after = fitted(sure).fitted.cov, fitted(unsure).fitted.cov
    assert after[0, 0] - before[0, 0] == pytest.approx(0.03**2)
    assert after[1:, 1:] == pytest.approx(before[1:, 1:])


@pytest.mark.parametrize("rho", [0.5, 0.95])
def test_what_it_says_of_its_errors_is_true(rho: float) -> None:
    off, noted, nees = [], [], []
    for seed in range(16):
        found = fitted(course(seed, noise=0.08, rho=rho))
        off.append(found.fitted.values - [0.12, math.log(5.5), math.log(0.6), 0.0])
        cov = found.fitted.cov - np.diag([0.004**2, 0.0, 0.0, 0.0])
        noted.append(np.sqrt(np.diag(cov)))
        nees.append(off[-1] @ np.linalg.solve(cov, off[-1]) / 4.0)
    assert np.sqrt(np.mean((np.array(off) / np.array(noted)) ** 2, axis=0)) == pytest.approx(np.full(4, 0.9), abs=0.35)
    assert 0.4 < np.mean(nees) < 1.5
    found = fitted(course(3, 3000, noise=0.08, rho=rho))
    assert found.fitted.rho == pytest.approx(rho, abs=0.05)
    assert found.fitted.residual == pytest.approx(0.08, rel=0.15)


@pytest.mark.parametrize(("compared", "fits"), [(199, False), (200, True)])
def test_four_seconds_are_a_flight_to_identify_from(compared: int, fits: bool) -> None:
    of = course()
    of = of._replace(counts=(np.arange(600) >= 100) & (np.arange(600) <= 100 + compared))
    assert (fit_tilt(of, GIVEN.tilt) is not None) is fits


def test_a_gap_in_what_is_compared_is_bridged_by_the_model() -> None:
    of = course()
    counts = of.counts & ~((np.arange(600) > 250) & (np.arange(600) < 330))
    found = fitted(of._replace(counts=counts, reported=np.where(counts[:, None], of.reported, -50.0)))
    assert (found.response.delay_s, found.response.frequency_rad_s) == pytest.approx((0.12, 5.5), rel=1e-3)
    assert found.fitted.seconds == pytest.approx((np.count_nonzero(counts) - 2) * STEP_S)


@pytest.mark.parametrize("delay_s", [0.0, 0.3, 0.55])
def test_the_search_begins_at_the_delay_of_the_largest_correlation(delay_s: float) -> None:
    u = asked_tilts(2, 600)
    of = FlightCourse(u, answered(structs.replace(TRUE, delay_s=delay_s), u), np.arange(600) > WARM)
    assert fitted(of).response.delay_s == pytest.approx(delay_s, abs=2e-3)
    first = fitted(of, steps=1)
    assert abs(first.response.delay_s - delay_s) <= 0.12


def test_a_fit_goes_on_from_one_before_it_that_knew_the_delay() -> None:
    of = course(noise=0.02)
    settled = fitted(of)
    assert settled.fitted.settled
    again = fitted(of, settled, 1)
    assert again.fitted.values == pytest.approx(settled.fitted.values, abs=2e-3)
    far = structs.replace(settled, fitted=settled.fitted._replace(values=np.array([0.5, math.log(9.0), 0.0, 0.3])))
    assert abs(fitted(of, far, 1).response.delay_s - 0.12) > 0.15, "one step of a tenth of a second from where it began"
    vague = far.fitted._replace(cov=np.diag([0.16**2, 1.0, 1.0, 1.0]))
    anew = fitted(of, structs.replace(far, fitted=vague), 1)
    assert anew.fitted.values == pytest.approx(fitted(of, None, 1).fitted.values), "a delay that was not known is no beginning"


def test_what_a_flight_does_not_tell_stays_where_the_search_began() -> None:
    n, rng = 600, np.random.default_rng(5)
    still = FlightCourse(np.zeros((n, 2)), lasting(rng, (n, 2), 0.05, 0.9), np.arange(n) > WARM)
    found = fitted(still)
    given = GIVEN.tilt.delay_s, math.log(GIVEN.tilt.frequency_rad_s), math.log(GIVEN.tilt.damping), 0.0
    assert found.fitted.values == pytest.approx(given, abs=0.02)
    assert np.sqrt(np.diag(found.fitted.cov)) == pytest.approx([0.25, 0.5, 0.5, 0.2], rel=0.05)


@pytest.mark.parametrize(("delay_s", "lag_s"), [(0.1, 0.3), (0.3, 0.6), (0.0, 0.2)])
def test_a_climb_without_errors_gives_the_response_that_made_it(delay_s: float, lag_s: float) -> None:
    u = asked_tilts(4, 600)[:, :1]
    v, late, keep = np.full((600, 1), 1.1 * u[0, 0]), round(delay_s / STEP_S), math.exp(-STEP_S / lag_s)
    for k in range(1, 600):
        v[k] = keep * v[k - 1] + (1.0 - keep) * 1.1 * u[max(0, k - 1 - late)]
    found = fit_climb(FlightCourse(u, v + 0.2, np.arange(600) > WARM), GIVEN.climb)
    got, sigma = found.response, np.sqrt(np.diag(found.fitted.cov))
    assert (got.delay_s, got.lag_s, found.gain) == pytest.approx((delay_s, lag_s, 1.1), abs=4e-3)
    assert got.max_m_s == GIVEN.climb.max_m_s
    assert (got.delay_sigma_s, got.lag_sigma_s) == pytest.approx((sigma[0], lag_s * sigma[1]), rel=0.02)
    assert fit_climb(FlightCourse(u, v, np.arange(600) > 450), GIVEN.climb) is None


def test_the_end_of_a_course_does_not_come_back_at_its_beginning() -> None:
    u = asked_tilts(8, 768)
    of = FlightCourse(u, answered(TRUE, u), np.ones(768, dtype=bool))
    found = fitted(of)
    assert found.fitted.residual < 1e-3
    assert found.fitted.model[:5] == pytest.approx(np.tile(u[0], (5, 1)), abs=2e-3)


def test_residuals_that_never_end_are_whitened_by_less_than_a_difference() -> None:
    drifting = FlightCourse(np.zeros((9000, 1)), 1e-3 * np.arange(9000.0)[:, None], np.ones(9000, dtype=bool))
    found = fit_climb(drifting, GIVEN.climb)
    assert found.fitted.rho == 0.999


def test_a_search_that_has_settled_ends_after_the_third_step() -> None:
    of = course(noise=0.02)
    settled = fitted(of)
    two, three, twelve = (fitted(of, settled, steps).fitted.values.tolist() for steps in (2, 3, 12))
    assert three == twelve
    assert two != twelve


# The courses that a response is identified from


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
    np.testing.assert_array_equal(both.asked[:, 0], [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0])
    np.testing.assert_array_equal(both.reported, -both.asked)
    np.testing.assert_array_equal(both.counts, [False, False, True, False, False, True, True])
    assert (both.stamp_sigma_s, both.drifts) == (0.01, 1)


TILT = shipped_response("ardrone2").tilt
COV_OF_RESPONSE = np.diag([0.01**2, 0.3**2, 0.05**2])


def test_the_right_file_costs_nothing_and_a_wrong_one_the_squares_difference() -> None:
    right = tilt_of_file(TILT, TILT)
    assert right.cost_cm == 0.0
    assert right.error_cm == pytest.approx(100.0 * math.sqrt(2.0) * margins(TILT).error_m)
    quick = structs.replace(TILT, frequency_rad_s=5.5)
    wrong = tilt_of_file(quick, TILT)
    assert wrong.own_cm == right.own_cm
    assert wrong.error_cm == pytest.approx(100.0 * math.sqrt(2.0) * margins(quick, TILT).error_m)
    assert wrong.cost_cm == pytest.approx(math.sqrt(wrong.error_cm**2 - wrong.own_cm**2))
    assert 1.5 < wrong.cost_cm < 2.5, "80 simulated landings lost 2.6 cm"


def test_a_loop_that_is_unstable_has_no_cost_in_centimetres() -> None:
    assert math.isinf(tilt_of_file(TILT, structs.replace(TILT, delay_s=0.2)).cost_cm)
    assert ResponseCost(2.0, 2.1).cost_cm == 0.0


def test_one_sigma_is_the_worst_vehicle_on_its_ellipsoid() -> None:
    found = tilt_of_sigma(TILT, COV_OF_RESPONSE)
    rng = np.random.default_rng(5)
    for step in rng.normal(size=(25, 3)):
        delay, frequency, damping = np.sqrt(np.diag(COV_OF_RESPONSE)) * step / np.linalg.norm(step)
        vehicle = structs.replace(
            TILT, delay_s=TILT.delay_s + delay, frequency_rad_s=TILT.frequency_rad_s + frequency, damping=TILT.damping + damping
        )
        assert tilt_of_file(TILT, vehicle).cost_cm < 1.1 * found.cost_cm
    assert tilt_of_sigma(TILT, 0.01 * COV_OF_RESPONSE).cost_cm < 0.5 * found.cost_cm
    assert math.isinf(tilt_of_sigma(TILT, 100.0 * COV_OF_RESPONSE).cost_cm)


def test_a_file_is_read_back_with_the_covariance_of_its_fits() -> None:
    tilt, u = fit_tilt(course(noise=0.05), GIVEN.tilt), asked_tilts(4, 600)[:, :1]
    v, keep, rng = np.full((600, 1), u[0, 0]), math.exp(-STEP_S / 0.3), np.random.default_rng(1)
    for k in range(1, 600):
        v[k] = keep * v[k - 1] + (1.0 - keep) * u[k - 1, 0]
    climb = fit_climb(FlightCourse(u, v + 0.02 * rng.normal(size=v.shape), np.arange(600) > WARM), GIVEN.climb)
    read = response_from_mapping(tomllib.loads(text(Response(tilt.response, climb.response), "a", tilt, climb)), "a.toml")
    np.testing.assert_allclose(np.array(read.tilt.cov_delay_frequency_damping), tilt.cov, rtol=1e-5)
    np.testing.assert_allclose(np.array(read.climb.cov_delay_lag), climb.cov, rtol=1e-5)
    assert read.tilt.delay_sigma_s == pytest.approx(tilt.response.delay_sigma_s, rel=1e-5)
    assert read.climb.lag_sigma_s == pytest.approx(climb.response.lag_sigma_s, rel=1e-5)
    kept = text(Response(tilt.response, read.climb), "a", tilt, None)
    assert response_from_mapping(tomllib.loads(kept), "a.toml").climb == structs.replace(
        read.climb, delay_s=round(read.climb.delay_s, 4), lag_s=round(read.climb.lag_s, 4)
    ), "a climb that is kept keeps its covariance"
    given = text(Response(tilt.response, shipped_response("quad_1_5kg").climb), "a", tilt, None)
    assert response_from_mapping(tomllib.loads(given), "a.toml").climb == shipped_response("quad_1_5kg").climb
