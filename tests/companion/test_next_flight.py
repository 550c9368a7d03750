"""A flight that ended in any way is followed by a new one, once the vehicle has stood and flies again; not before."""

import pytest

from companion.base.mission import FlightOutcome
from companion.guidance.make_pilot import make_pilot
from companion.settings.load import load
from estimator.contracts.commands import Hover
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, Stamp


def status(at_s: float, flying: bool, emergency: bool = False) -> VehicleStatus:
    at = MonoNs(round(at_s * 1e9))
    return VehicleStatus(Stamp(at, at, 0.001, "sim"), flying, "hovering" if flying else "landed", 0.8, emergency, True)


@pytest.mark.parametrize("outcome", [FlightOutcome.ABORTED, FlightOutcome.EMERGENCY, FlightOutcome.LANDED_BY_OTHERS])
def test_the_next_flight_begins_when_it_flies_after_having_stood(outcome: FlightOutcome) -> None:
    pilot = make_pilot(load("sim"))
    pilot.on_sample(status(0.0, True))
    pilot.decide(MonoNs(0))
    if outcome is FlightOutcome.ABORTED:
        pilot.abort()
    else:
        pilot.on_sample(status(0.1, outcome is FlightOutcome.EMERGENCY, emergency=outcome is FlightOutcome.EMERGENCY))
        pilot.decide(MonoNs(100_000_000))
    assert pilot.outcome is outcome
    if outcome is not FlightOutcome.LANDED_BY_OTHERS:
        pilot.on_sample(status(1.0, True))
        assert pilot.outcome is outcome, "still the same flight: nothing begins anew in the air"
        if outcome is FlightOutcome.ABORTED:
            assert pilot.decide(MonoNs(1_000_000_000)).command == Hover()
    pilot.on_sample(status(2.0, False))
    assert pilot.outcome is outcome
    pilot.on_sample(status(3.0, True))
    assert pilot.outcome is None
    assert pilot.decide(MonoNs(3_000_000_000)).phase != outcome.value
