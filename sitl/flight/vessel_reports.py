"""The ship's own reports to the service: velocity, heading and place by her GNSS and compass, as they come over a radio link."""

import math
from collections import deque

import numpy as np
from msgspec.structs import replace

from estimator.contracts.geodesy import moved
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.samples import GeoFix, VesselReport
from estimator.contracts.time import MonoNs, Stamp, after
from sitl.faults.kinds import VesselReports
from sitl.flight.grader import GradedWorld
from sitl.sensors.sensors import SIGMA_M, GnssErrors

_DELAY_S = 0.2
"""Delay from the ship's receiver to the service (assumed)."""
_SIGMA_M_S, _SIGMA_HEADING_RAD = 0.1, math.radians(1.0)
"""A GNSS receiver's velocity and a ship's compass (assumed); the report claims the same."""

Reports = tuple[VesselReport | GeoFix, ...]


class VesselReporter:
    """Makes the reports that reach the service; none where the scenario's ship sends none."""

    def __init__(self, world: GradedWorld) -> None:
        self._world = world
        self._period_s = 1.0 / world.scenario.vessel.reports_hz if world.scenario.vessel.reports_hz > 0.0 else None
        self._rng = np.random.default_rng([world.seed, 0x6E55])
        self._receiver = GnssErrors([world.seed, 0x6E56])
        self._due = world.now
        self._frozen: tuple[np.ndarray, float] | None = None
        self._under_way: deque[tuple[MonoNs, Reports]] = deque()

    def reports(self, now: MonoNs) -> Reports:
        """Return the reports that arrive at this instant."""
        if self._period_s is not None and now >= self._due:
            self._due = after(self._due, self._period_s)
            self._make(now)
        if not self._under_way:
            return ()
        faults = [fault for fault, _ in self._world.faults.on(VesselReports)]
        late_s = max((fault.late_s for fault in faults), default=0.0)
        newest: Reports = ()
        while self._under_way and after(self._under_way[0][0], late_s) <= now:
            newest = self._under_way.popleft()[1]
        return tuple(replace(report, stamp=replace(report.stamp, received_at=now)) for report in newest)

    def _make(self, now: MonoNs) -> None:
        """Send one report."""
        truth, noise = self._world.truth(), self._rng.standard_normal(4)
        pad_yaw = math.radians(self._world.scenario.vessel.pad_yaw_deg)
        velocity = truth.v_pad_ned + _SIGMA_M_S * noise[:3]
        heading = truth.R_ned_pad.rpy_rad[2] - pad_yaw + _SIGMA_HEADING_RAD * noise[3]
        corrupted = self._world.corruptions.of
        x, y, z = truth.p_pad_ned.tolist()
        place = self._receiver.place(np.array(corrupted("ship_place", (x, y, z), now)), now)
        north, east, down = velocity.tolist()
        velocity = np.array(corrupted("ship_velocity", (north, east, down), now))
        (heading,) = corrupted("ship_heading", (float(heading),), now)
        faults = [fault for fault, _ in self._world.faults.on(VesselReports)]
        if any(fault.silent for fault in faults):
            return
        if any(fault.frozen for fault in faults):
            self._frozen = self._frozen or (velocity, heading)
            velocity, heading = self._frozen
        else:
            self._frozen = None
        for fault in faults:
            velocity = velocity + np.array([fault.north_m_s, fault.east_m_s, 0.0])
            heading += math.radians(fault.heading_deg)
            place = moved(place, np.array([fault.place_north_m, fault.place_east_m, 0.0]))
        stamp = Stamp(max(self._world.started, after(self._world.at, -_DELAY_S)), now, 0.05, "sim")
        cov = _SIGMA_M_S**2 * np.eye(3)
        made: Reports = (VesselReport(stamp, velocity, cov, wrap_pi(heading), _SIGMA_HEADING_RAD),)
        if self._world.scenario.vessel.reports_place:
            made = (*made, GeoFix(stamp, "vessel", place, SIGMA_M, velocity))
        self._under_way.append((now, made))
