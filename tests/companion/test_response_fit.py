"""The fit of a response: it finds what made a course, says how well, and begins where it is told."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from companion.guidance.law.gains import tilt_model
from companion.guidance.law.response_fit import (
    STEP_S,
    FlightCourse,
    TiltFit,
    _climb_transfer,
    _covariance,
    _good_size,
    _Loop,
    _tilt_transfer,
    _Whitened,
    fit_climb,
    fit_tilt,
)
from companion.settings.load import shipped_response
from companion.settings.response import TiltResponse
from estimator.contracts.geometry import F64

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


def test_sigmas_are_those_of_the_covariance() -> None:
    found = fitted(course(noise=0.05))
    sigma, got = np.sqrt(np.diag(found.fitted.cov)), found.response
    assert (got.delay_sigma_s, found.delay_sigma_s) == pytest.approx((sigma[0], sigma[0]))
    assert got.frequency_sigma_rad_s == pytest.approx(got.frequency_rad_s * sigma[1])
    assert got.damping_sigma == pytest.approx(got.damping * sigma[2])
    assert found.fitted.values == pytest.approx(
        [got.delay_s, math.log(got.frequency_rad_s), math.log(got.damping), math.log(found.gain)]
    )


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
    again = fitted(of, settled, 1)
    assert again.fitted.values == pytest.approx(settled.fitted.values, abs=2e-3)
    far = structs.replace(settled, fitted=settled.fitted._replace(values=np.array([0.5, math.log(9.0), 0.0, 0.3])))
    assert abs(fitted(of, far, 1).response.delay_s - 0.12) > 0.15, (
        "one step of a tenth of a second from where it was told to begin"
    )
    vague = far.fitted._replace(cov=np.diag([0.16**2, 1.0, 1.0, 1.0]))
    anew = fitted(of, structs.replace(far, fitted=vague), 1)
    assert anew.fitted.values == pytest.approx(fitted(of, None, 1).fitted.values), "a delay that was not known is no beginning"


def test_what_a_flight_does_not_tell_stays_where_the_search_began() -> None:
    n, rng = 600, np.random.default_rng(5)
    still = FlightCourse(np.zeros((n, 2)), lasting(rng, (n, 2), 0.05, 0.9), np.arange(n) > WARM)
    found = fitted(still)
    assert found.fitted.values[1:] == pytest.approx(
        [math.log(GIVEN.tilt.frequency_rad_s), math.log(GIVEN.tilt.damping), 0.0], abs=0.02
    )
    assert np.sqrt(np.diag(found.fitted.cov)) == pytest.approx([0.25, 0.5, 0.5, 0.2], rel=0.05)


@pytest.mark.parametrize(("delay_s", "lag_s"), [(0.1, 0.3), (0.3, 0.6), (0.0, 0.2)])
def test_a_climb_without_errors_gives_the_response_that_made_it(delay_s: float, lag_s: float) -> None:
    u = asked_tilts(4, 600)[:, :1]
    v, late, keep = np.full((600, 1), 1.1 * u[0, 0]), round(delay_s / STEP_S), math.exp(-STEP_S / lag_s)
    for k in range(1, 600):
        v[k] = keep * v[k - 1] + (1.0 - keep) * 1.1 * u[max(0, k - 1 - late)]
    found = fit_climb(FlightCourse(u, v + 0.2, np.arange(600) > WARM), GIVEN.climb)
    assert found is not None
    got, sigma = found.response, np.sqrt(np.diag(found.fitted.cov))
    assert (got.delay_s, got.lag_s, found.gain) == pytest.approx((delay_s, lag_s, 1.1), abs=4e-3)
    assert got.max_m_s == GIVEN.climb.max_m_s
    assert (got.delay_sigma_s, got.lag_sigma_s) == pytest.approx((sigma[0], lag_s * sigma[1]), rel=0.02)
    assert fit_climb(FlightCourse(u, v, np.arange(600) > 450), GIVEN.climb) is None


def test_a_length_for_the_transform_holds_the_course_and_is_hardly_longer() -> None:
    for least in range(2, 5000, 7):
        size = _good_size(least)
        assert least <= size <= 1.5 * least
        odd = size // (size & -size)
        assert odd in (1, 3)
    assert (_good_size(1024), _good_size(1025), _good_size(1537)) == (1024, 1536, 2048)


@pytest.mark.parametrize(
    ("made", "x"),
    [
        (lambda: _tilt_transfer(0.05), [0.12, math.log(5.5), math.log(0.6), 0.3]),
        (lambda: _climb_transfer, [0.2, math.log(0.4), -0.2]),
    ],
)
def test_the_derivatives_are_those_of_the_transfer_function(made: Any, x: list[float]) -> None:
    transfer, s, step = made(), 2j * math.pi * np.linspace(0.0, 3.0, 20), 1e-6
    _, dH = transfer(np.array(x), s)
    for k, of_k in enumerate(dH):
        more, less = (transfer(np.array(x) + sign * step * np.eye(len(x))[k], s)[0] for sign in (1, -1))
        np.testing.assert_allclose(of_k, (more - less) / (2.0 * step), atol=1e-7)
    H, _ = transfer(np.array(x), np.zeros(1, dtype=np.complex128))
    assert H[0] == pytest.approx(math.exp(x[-1])), "of what stands still the answer is the gain"


def test_a_response_beyond_what_a_vehicle_has_is_the_nearest_that_one_may_have() -> None:
    u = asked_tilts(6, 600)
    sluggish = tilt_course(frequency_rad_s=8.0, damping=4.0)
    assert math.exp(sluggish.fitted.values[2]) > 3.2
    assert sluggish.response.damping == 3.0
    ringing = tilt_course(frequency_rad_s=4.0, damping=0.15)
    assert math.exp(ringing.fitted.values[2]) < 0.18
    assert ringing.response.damping == 0.2
    slow, keep = np.full((600, 1), u[0, 0]), math.exp(-STEP_S / 5.0)
    for k in range(1, 600):
        slow[k] = keep * slow[k - 1] + (1.0 - keep) * u[k - 1, 0]
    found = fit_climb(FlightCourse(u[:, :1], slow, np.arange(600) > 0), GIVEN.climb)
    assert found is not None
    assert math.exp(found.fitted.values[1]) > 3.3
    assert found.response.lag_s == 3.0
    at_once = FlightCourse(u[:, :1], np.vstack([u[:1, :1], u[:-1, :1]]), np.arange(600) > 0)
    found = fit_climb(at_once, structs.replace(GIVEN.climb, lag_s=0.03))
    assert found is not None
    assert math.exp(found.fitted.values[1]) < 0.018
    assert found.response.lag_s == 0.02


def tilt_course(frequency_rad_s: float, damping: float) -> TiltFit:
    """Fit an answer beyond the ranges of `TiltResponse`, integrated in small steps; it comes without a delay."""
    u, parts = asked_tilts(6, 600), 40
    out, x, v = np.empty_like(u), u[0].copy(), np.zeros(2)
    lagged = u[0].copy()
    for k in range(600):
        out[k] = x
        for _ in range(parts):
            lagged = lagged + STEP_S / parts / GIVEN.tilt.lag_s * (u[k] - lagged) if GIVEN.tilt.lag_s > 0.0 else u[k]
            v = v + STEP_S / parts * (frequency_rad_s**2 * (lagged - x) - 2.0 * damping * frequency_rad_s * v)
            x = x + STEP_S / parts * v
    return fitted(FlightCourse(u, out, np.arange(600) > 0))


def test_of_a_climb_that_requested_nothing_lag_and_gain_stay_where_the_search_began() -> None:
    still = FlightCourse(np.zeros((600, 1)), lasting(np.random.default_rng(5), (600, 1), 0.05, 0.9)[:, :1], np.arange(600) > WARM)
    found = fit_climb(still, GIVEN.climb)
    assert found is not None
    assert found.fitted.values[1:] == pytest.approx([math.log(GIVEN.climb.lag_s), 0.0], abs=0.02)


def test_of_a_flight_that_reports_little_most_stays_where_the_search_began() -> None:
    n = 600
    u = 0.004 * asked_tilts(7, n)
    y = answered(TRUE, u) + lasting(np.random.default_rng(7), (n, 2), 0.08, 0.9)
    found = fitted(FlightCourse(u, y, np.arange(n) > WARM))
    begun = [math.log(GIVEN.tilt.frequency_rad_s), math.log(GIVEN.tilt.damping), 0.0]
    assert found.fitted.values[1:] == pytest.approx(begun, abs=0.15)


def test_the_covariance_is_the_larger_of_two_in_every_direction() -> None:
    information, prior = np.array([[3.0, 0.0], [0.0, 2.0]]), np.array([1.0, 4.0])
    C = np.diag([1.0 / 4.0, 1.0 / 6.0])
    each = np.tile(information / 5.0, (5, 1, 1))
    quiet = np.full((5, 2), 0.01)
    np.testing.assert_allclose(_covariance(_Whitened(information, np.zeros(2), quiet, each, 0.9), prior), C, atol=1e-12)
    loud = np.array([[3.0, 0.01], [-3.0, 0.01], [2.0, -0.01], [-2.0, 0.01], [1.0, -0.01]])
    without = loud[:, 0] / (4.0 - 0.6)
    first = 0.8 * float(without @ without) + 1.0 / 16.0
    got = _covariance(_Whitened(information, np.zeros(2), loud, each, 0.9), prior)
    assert (got[0, 0], got[1, 1]) == pytest.approx((first, 1.0 / 6.0), rel=1e-3)


def test_the_jackknife_is_that_of_fits_without_one_stretch() -> None:
    # Why: scores of a few long stretches are too small by their own leverage; fits that leave one out are not.
    rng = np.random.default_rng(3)
    J, e, prior = rng.normal(size=(6, 7, 2)), 4.0 * rng.normal(size=(6, 7)), np.full(2, 1e-9)
    informations, scores = np.einsum("bik,bil->bkl", J, J), np.einsum("bik,bi->bk", J, e)
    each = []
    for left_out in range(6):
        kept = np.arange(6) != left_out
        each.append(np.linalg.lstsq(J[kept].reshape(-1, 2), e[kept].ravel(), rcond=None)[0])
    whole = np.linalg.lstsq(J.reshape(-1, 2), e.ravel(), rcond=None)[0]
    off = np.array(each) - whole
    # The scores are those at the end of a search, so that they add up to nothing.
    left = scores - np.einsum("bkl,l->bk", informations, whole)
    got = _covariance(_Whitened(informations.sum(axis=0), np.zeros(2), left, informations, 0.9), prior)
    np.testing.assert_allclose(got, 5.0 / 6.0 * off.T @ off, rtol=1e-6)


def test_scores_are_summed_over_a_stretch_of_each_axis() -> None:
    of = course(n=560, noise=0.05)
    loop = _Loop(of, _tilt_transfer(GIVEN.tilt.lag_s), of.counts[1:] & of.counts[:-1], 1.0)
    whitened = loop.whitened(np.array([0.12, math.log(5.0), math.log(0.6), 0.0]), 0.9)
    begun = len({k // 50 for k in range(WARM + 1, 559)})
    assert whitened.scores.shape == (2 * begun, 4)
    assert whitened.scores.sum(axis=0) == pytest.approx(whitened.score)
    np.testing.assert_allclose(whitened.informations.sum(axis=0), whitened.information)


def test_the_end_of_a_course_does_not_come_back_at_its_beginning() -> None:
    u = asked_tilts(8, 768)
    assert _good_size(768) == 768
    of = FlightCourse(u, answered(TRUE, u), np.ones(768, dtype=bool))
    found = fitted(of)
    assert found.fitted.residual < 1e-3
    assert found.fitted.model[:5] == pytest.approx(np.tile(u[0], (5, 1)), abs=2e-3)


def test_residuals_that_never_end_are_whitened_by_less_than_a_difference() -> None:
    drifting = FlightCourse(np.zeros((9000, 1)), 1e-3 * np.arange(9000.0)[:, None], np.ones(9000, dtype=bool))
    found = fit_climb(drifting, GIVEN.climb)
    assert found is not None
    assert found.fitted.rho == 0.999


def test_a_search_that_has_settled_ends_after_the_third_step() -> None:
    of = course(noise=0.02)
    settled = fitted(of)
    two, three, twelve = (fitted(of, settled, steps).fitted.values.tolist() for steps in (2, 3, 12))
    assert three == twelve
    assert two != twelve
