"""The ship's reports: as often as she sends them, true except for their noise, and wrong as a fault says."""

import math

import msgspec
import numpy as np
import pytest

from estimator.contracts.errors import BadInput
from estimator.contracts.samples import VesselReport
from estimator.contracts.time import after
from sitl.faults.fault import Fault
from sitl.faults.kinds import VesselReports
from sitl.flight.vessel_reports import VesselReporter
from sitl.scenario.scenario import from_mapping
from sitl.vessel.file import VesselSettings
from sitl.world.world import World
from tests.sitl.test_faults import CALM

SHIP = VesselSettings(moored=False, speed_m_s=3.0, heading_deg=40.0, reports_hz=5.0)


def reports(*faults: Fault, ship: VesselSettings = SHIP, until_s: float = 4.0) -> list[VesselReport]:
    world = World(msgspec.structs.replace(CALM, vessel=ship, faults=faults), 1)
    reporter, out = VesselReporter(world), []
    for n in range(1, round(until_s / 0.01) + 1):
        world.advance(after(world.started, 0.01 * n))
        out += [report for report in reporter.reports(world.now) if isinstance(report, VesselReport)]
    return out


def velocities(made: list[VesselReport]) -> np.ndarray:  # type: ignore[type-arg]
    return np.array([r.v_vessel_ned for r in made])


def test_reports_are_true_but_for_their_noise_and_come_as_often_as_they_should() -> None:
    made = reports()
    assert len(made) == pytest.approx(20, abs=1)
    along = 3.0 * np.array([math.cos(math.radians(40.0)), math.sin(math.radians(40.0)), 0.0])
    assert np.abs(velocities(made) - along).max() < 0.5
    assert np.degrees([r.heading_rad for r in made]) == pytest.approx([40.0] * len(made), abs=4.0)
    assert all(r.stamp.received_at > r.stamp.measured_at for r in made[2:])
    assert reports(ship=VesselSettings(moored=False, speed_m_s=3.0)) == []
    assert np.array_equal(velocities(made), velocities(reports()))


def test_a_jump_a_frozen_and_a_silent_receiver() -> None:
    true = reports()
    jump = reports(VesselReports(at_s=1.0, for_s=1.0, east_m_s=5.0, heading_deg=10.0))
    off = velocities(jump)[:, 1] - velocities(true)[:, 1]
    assert off == pytest.approx([5.0 if 1.0 <= 0.2 * n < 2.0 else 0.0 for n in range(len(off))])
    turned = np.degrees([j.heading_rad - t.heading_rad for j, t in zip(jump, true, strict=True)])  # type: ignore[operator]
    assert turned[7] == pytest.approx(10.0)
    frozen = velocities(reports(VesselReports(at_s=1.0, for_s=1.0, frozen=True)))
    assert len({tuple(v) for v in frozen[5:10]}) == 1
    assert len({tuple(v) for v in frozen[10:]}) > 5
    assert len(reports(VesselReports(at_s=1.0, silent=True))) == pytest.approx(5, abs=1)


def test_a_ship_that_does_not_report_cannot_report_wrongly() -> None:
    data = {"title": "x", "faults": [{"kind": "vessel_reports", "at_s": 1.0, "silent": True}]}
    with pytest.raises(
        BadInput, match=r"faults\[0\]: vessel_reports is of a ship that reports, .*vessel.reports_hz must be more than 0"
    ):
        from_mapping(data, "mine.toml")
    with pytest.raises(ValueError, match="nothing says what is wrong with the reports"):
        VesselReports(at_s=1.0)
