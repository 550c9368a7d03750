"""Cause of a landing and its cancellation at each edge: gaps, ages, heights, and fields missing from a report."""

import pytest

from drivers.ardrone.landing_watch import Cause, DroneReport, LandingWatch
from drivers.ardrone.navdata import ControlState, NavdataState
from estimator.contracts.time import MonoNs

UNHEARD = NavdataState.FLYING | NavdataState.COM_WATCHDOG


def ms(t: int) -> MonoNs:
    return MonoNs(5_000_000_000 + t * 1_000_000)


def landing(altitude_m: float | None = 1.0, *, state: int = UNHEARD) -> DroneReport:
    return DroneReport(state, ControlState.LANDING, altitude_m)


def for_silence() -> LandingWatch:
    """Return a watch whose first navdata reports a landing for lack of commands."""
    watch = LandingWatch()
    watch.on_report(landing(), ms(0), ordered=False)
    return watch


def test_a_report_without_the_control_state_does_not_end_a_landing() -> None:
    watch = for_silence()
    watch.on_report(DroneReport(UNHEARD, None, 0.9), ms(100), ordered=False)
    assert watch.cause is Cause.SILENCE
    watch.on_report(landing(0.8), ms(200), ordered=False)
    assert watch.calls_off(ms(200)), "nobody else began it meanwhile"


@pytest.mark.parametrize(("age_ms", "calls_off"), [(200, True), (201, False)])
def test_a_landing_is_called_off_on_a_fresh_report_alone(age_ms: int, calls_off: bool) -> None:
    assert for_silence().calls_off(ms(age_ms)) is calls_off


@pytest.mark.parametrize(("altitude_m", "calls_off"), [(0.5, True), (0.499, False), (0.0, False), (None, False)])
def test_a_landing_is_called_off_from_its_height_up(altitude_m: float | None, calls_off: bool) -> None:
    watch = for_silence()
    watch.on_report(landing(altitude_m), ms(100), ordered=False)
    assert watch.calls_off(ms(100)) is calls_off
    assert watch.calls_off(ms(100), 0.15) is (calls_off or altitude_m == 0.499)
