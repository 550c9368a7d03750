"""The ship's own reports to the service: velocity and heading by her GNSS and compass, as they come over a radio link."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.geometry import wrap_pi
from estimator.contracts.samples import VesselReport
from estimator.contracts.time import MonoNs, Stamp, after
from sitl.report_faults import VesselReports
from sitl.world import World

_DELAY_S = 0.2
"""From the ship's receiver to the service (assumed)."""
_SIGMA_M_S, _SIGMA_HEADING_RAD = 0.1, math.radians(1.0)
"""A GNSS receiver's velocity and a ship's compass (assumed); the report claims the same."""


class VesselReporter:
    """Makes the reports that reach the service; none where the scenario's ship sends none."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._period_s = 1.0 / world.scenario.vessel.reports_hz if world.scenario.vessel.reports_hz > 0.0 else None
        self._rng = np.random.default_rng([world.seed, 0x6E55])
        self._due = world.now
        self._frozen: tuple[np.ndarray, float] | None = None

    def report(self, now: MonoNs) -> VesselReport | None:
        """Return the report that arrives at this instant, if any."""
        if self._period_s is None or now < self._due:
            return None
        self._due = after(self._due, self._period_s)
        truth, noise = self._world.truth(), self._rng.standard_normal(4)
        pad_yaw = math.radians(self._world.scenario.vessel.pad_yaw_deg)
        velocity = truth.v_pad_ned + _SIGMA_M_S * noise[:3]
        heading = truth.R_ned_pad.rpy_rad[2] - pad_yaw + _SIGMA_HEADING_RAD * noise[3]
        faults = [fault for fault, _ in self._world.faults.on(VesselReports)]
        if any(fault.silent for fault in faults):
            return None
        if any(fault.frozen for fault in faults):
            self._frozen = self._frozen or (velocity, heading)
            velocity, heading = self._frozen
        else:
            self._frozen = None
        for fault in faults:
            velocity = velocity + np.array([fault.north_m_s, fault.east_m_s, 0.0])
            heading += math.radians(fault.heading_deg)
        stamp = Stamp(max(self._world.started, after(self._world.at, -_DELAY_S)), now, 0.05, "sim")
        cov = _SIGMA_M_S**2 * np.eye(3)
        return VesselReport(stamp, velocity, cov, wrap_pi(heading), _SIGMA_HEADING_RAD)
