"""The response identified in flight at each of its edges: what counts as a report, when a fit is due, and what it decides."""

import numpy as np
import pytest
from msgspec import structs

from companion.base.response_in_use import ResponseInUse, ResponseState
from companion.guidance.law.response_fit import Fitted, TiltFit, fit_tilt
from companion.guidance.law.response_watch import ResponseWatch, asked, begun, judged, landed, reported
from companion.settings.load import shipped_response
from estimator.contracts.time import MonoNs, Stamp
from tests.companion.test_identify import flown

TILT = structs.replace(shipped_response("ardrone2").tilt, delay_s=0.05, delay_sigma_s=None)
KNOWN_S = 0.04
ASSUMED = ResponseInUse(ResponseState.ASSUMED, 0.05, None)
KNOWN = ResponseInUse(ResponseState.KNOWN, 0.05, 0.02)
IDENTIFIED = ResponseInUse(ResponseState.IDENTIFIED, 0.2, 0.02, 0.15)
FIRST = begun(TILT, KNOWN_S)


def ns(seconds: float) -> MonoNs:
    return MonoNs(round(1e9 * seconds))


def told(watch: ResponseWatch, t: float, late_s: float = 0.0) -> ResponseWatch:
    return reported(watch, Stamp(ns(t), ns(t + late_s), 0.003, "synced"), (0.1, 0.2))


@pytest.mark.parametrize(
    ("sigma_s", "state"),
    [(None, ResponseState.ASSUMED), (0.04, ResponseState.KNOWN), (0.0401, ResponseState.ASSUMED), (0.0, ResponseState.KNOWN)],
)
def test_a_file_says_how_well_its_delay_is_known(sigma_s: float | None, state: ResponseState) -> None:
    watch = begun(structs.replace(TILT, delay_sigma_s=sigma_s), KNOWN_S)
    assert watch.in_use == ResponseInUse(state, 0.05, sigma_s)
    assert (watch.in_use.longer_s, watch.due, watch.stamp_sigma_s) == (0.0, 0, 0.0)


@pytest.mark.parametrize(
    ("in_use", "text"),
    [
        (ASSUMED, "the vehicle's response is assumed: delay 50 ms, softer gains"),
        (KNOWN, "the vehicle's response is known: delay 50 ms (sigma 20)"),
        (ResponseInUse(ResponseState.KNOWN, 0.05, None), "the vehicle's response is known: delay 50 ms (sigma 0)"),
        (IDENTIFIED, "the vehicle answers 150 ms longer than its response file says: 200 ms (sigma 20) is flown with"),
    ],
)
def test_the_operator_reads_the_state_in_milliseconds(in_use: ResponseInUse, text: str) -> None:
    assert in_use.text == text


def test_a_report_is_kept_with_its_instant_and_how_well_it_is_known() -> None:
    watch = told(FIRST, 2.0)
    assert watch.reported == ((2.0, 0.1, 0.2),)
    assert watch.stamp_sigma_s == 0.003


def test_another_flight_begins_with_what_is_known_and_without_the_courses() -> None:
    watch = asked(told(told(FIRST, 1.0), 2.0), ns(2.0), None, KNOWN_S)
    watch = told(structs.replace(watch, in_use=KNOWN, doubt=IDENTIFIED, asked=((2.5, 0.0, 0.0),)), 3.0)
    after = landed(watch)
    assert (after.in_use, after.due) == (KNOWN, watch.due)
    assert (after.doubt, after.asked, after.reported, after.asked_before, after.reported_before) == (None, (), (), None, None)


# What a fit decides


def fit(
    delay_s: float, sigma_s: float = 0.01, *, gain: float = 1.0, frequency: float | None = None, residual: float = 0.0
) -> TiltFit:
    """Return a fit with these values, otherwise the file's; its offset is a tenth."""
    response = structs.replace(TILT, delay_s=delay_s, frequency_rad_s=TILT.frequency_rad_s if frequency is None else frequency)
    cov, offset = np.diag([sigma_s**2, 1.0, 1.0, 1.0]), np.full((100, 2), 0.1)
    return TiltFit(response, gain, Fitted(np.zeros(4), cov, np.zeros((100, 2)), offset, residual, 0.9, 2.0))


@pytest.mark.parametrize(
    ("in_use", "delay_s", "sigma_s", "said"),
    [
        (ASSUMED, 0.05, 0.0401, ASSUMED),
        (ASSUMED, 0.05, 0.04, ResponseInUse(ResponseState.KNOWN, 0.05, 0.04)),
        (ASSUMED, 0.0899, 0.04, ResponseInUse(ResponseState.KNOWN, 0.05, 0.04)),
        (ASSUMED, 0.0901, 0.04, ASSUMED),
        (ASSUMED, 0.0901, 0.01, ResponseInUse(ResponseState.IDENTIFIED, 0.0901, 0.01, 0.0901 - 0.05)),
        (KNOWN, 0.0899, 0.01, KNOWN),
        (KNOWN, 0.1101, 0.02, ResponseInUse(ResponseState.IDENTIFIED, 0.1101, 0.02, 0.1101 - 0.05)),
        (KNOWN, 0.1099, 0.02, KNOWN),
        (IDENTIFIED, 0.2399, 0.01, IDENTIFIED),
        (IDENTIFIED, 0.2401, 0.01, ResponseInUse(ResponseState.IDENTIFIED, 0.2401, 0.01, 0.2401 - 0.05)),
        (IDENTIFIED, 0.0899, 0.01, ResponseInUse(ResponseState.KNOWN, 0.05, 0.01)),
        (IDENTIFIED, 0.0101, 0.01, ResponseInUse(ResponseState.KNOWN, 0.05, 0.01)),
        (IDENTIFIED, 0.0901, 0.01, ResponseInUse(ResponseState.IDENTIFIED, 0.0901, 0.01, 0.0901 - 0.05)),
    ],
)
def test_a_fit_decides_by_how_sure_it_is_and_how_far_off(in_use, delay_s, sigma_s, said):
    found = judged(in_use, TILT, fit(delay_s, sigma_s), KNOWN_S)
    assert (found.state, found.delay_s, found.longer_s) == (said.state, said.delay_s, said.longer_s)
    assert found.sigma_s == pytest.approx(said.sigma_s)
    if said is in_use:
        assert found is in_use


def test_no_delay_shorter_than_the_files_is_flown_with() -> None:
    """The file's gains stand every shorter delay; gains for one that the vehicle does not have hardly stand the vehicle."""
    late = structs.replace(TILT, delay_s=0.1)
    for state in (ResponseState.ASSUMED, ResponseState.KNOWN):
        in_use = ResponseInUse(state, 0.1, 0.03)
        assert judged(in_use, late, fit(0.013), KNOWN_S) is in_use
    output = judged(ResponseInUse(ResponseState.IDENTIFIED, 0.2, 0.02, 0.1), late, fit(0.013), KNOWN_S)
    assert output == ResponseInUse(ResponseState.ASSUMED, 0.1, None), "what was longer is in doubt, and the gains are soft"


def test_a_search_is_settled_at_its_end_and_not_on_its_way() -> None:
    course = flown(1, 0.5)[1]
    far = structs.replace(TILT, delay_s=0.3, frequency_rad_s=14.0, damping=0.4)
    first = fit_tilt(course, far, steps=1)
    assert first is not None
    assert not first.fitted.settled
    for _ in range(12):
        first = fit_tilt(course, far, begin=first, steps=1)
        assert first is not None
    assert first.fitted.settled
    whole = fit_tilt(course, far)
    assert whole is not None
    assert whole.fitted.settled
