"""The baselines of a simulated pair of receivers, as the service gets them."""

import math
from collections import deque

import numpy as np
from msgspec.structs import replace

from drivers.relpos import FLOOR_M
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.samples import Baseline, VesselReport
from estimator.contracts.time import MonoNs, Stamp, after
from sitl.faults.fault import RtkSolution
from sitl.flight.grader import GradedWorld
from sitl.flight.ship_sensors import ShipAt
from sitl.sensors.rtk import RtkErrors

_HEADING_BIAS_RAD, _HEADING_SIGMA_RAD, _HEADING_CLAIMED_RAD = (math.radians(x) for x in (0.3, 0.3, 0.36))
"""Error of the antennas' mounting, noise of an epoch, and what a driver claims of both (antennas a metre apart; assumed)."""
_STAMP_SIGMA_S, _JITTER_S = 0.02, 0.04
"""Error of the latency that the service assumes, one for the flight, and the longest further delay of an arrival (assumed)."""


class RtkPair:
    """Makes the baselines that reach the service."""

    def __init__(self, world: GradedWorld) -> None:
        self._world, self._of = world, world.scenario.rtk
        self._ship = ShipAt(world)
        self._errors = RtkErrors(self._of, [world.seed, 0x6E60])
        self._rng = np.random.default_rng([world.seed, 0x6E61])
        self._late_s = _STAMP_SIGMA_S * float(self._rng.standard_normal())
        self._bias_rad = _HEADING_BIAS_RAD * float(self._rng.standard_normal())
        self._due = self._heading_due = world.now
        self._under_way: deque[tuple[MonoNs, Baseline | VesselReport, MonoNs | None]] = deque()
        self.located: MonoNs | None = None
        """Instant of the newest epoch that has arrived and is fixed rightly."""

    def arrived(self, now: MonoNs) -> tuple[Baseline | VesselReport, ...]:
        """Return the baselines and headings that arrive now."""
        if now >= self._due:
            self._due = after(self._due, 1.0 / self._of.rate_hz)
            self._measure()
        if self._of.heading_hz and now >= self._heading_due:
            self._heading_due = after(self._heading_due, 1.0 / self._of.heading_hz)
            self._turn()
        out: tuple[Baseline | VesselReport, ...] = ()
        while self._under_way and self._under_way[0][0] <= now:
            _, found, located = self._under_way.popleft()
            self.located = located or self.located
            stamp = Stamp(min(found.stamp.measured_at, now), now, found.stamp.sigma_s, "sim")
            out = (*out, replace(found, stamp=stamp))
        return out

    def _stamp(self) -> tuple[MonoNs, Stamp]:
        """Return when a message of this instant arrives, and its stamp."""
        arrives = after(self._world.at, self._of.latency_s + _JITTER_S * float(self._rng.random()))
        at = max(self._world.started, after(self._world.at, self._late_s))
        return arrives, Stamp(at, max(arrives, at), _STAMP_SIGMA_S, "sim")

    def _turn(self) -> None:
        heading_rad = self._ship.rpy_rad[2] + self._bias_rad + _HEADING_SIGMA_RAD * float(self._rng.standard_normal())
        arrives, stamp = self._stamp()
        self._under_way.append((arrives, VesselReport(stamp, None, None, wrap_pi(heading_rad), _HEADING_CLAIMED_RAD), None))

    def _measure(self) -> None:
        active = {fault.solution for fault, _ in self._world.faults.on(RtkSolution)}
        epoch = self._errors.epoch(wrong="wrong" in active, floating="float" in active)
        if epoch is None or "silent" in active:
            return
        truth, of = self._world.truth(), self._of
        drone, ship = np.array(of.antenna_m), np.array(of.ship_antenna_m)
        antenna = truth.p_body_ned + truth.R_ned_body.matrix @ drone
        d = antenna - self._ship.place(of.ship_antenna_m)[0] + epoch.error_m
        cov = np.diag(np.hypot(epoch.claimed_m, FLOOR_M[epoch.fix]) ** 2)
        arrives, stamp = self._stamp()
        found = Baseline(stamp, epoch.fix, d, cov, drone, ship, of.alone)
        self._under_way.append((arrives, found, self._world.at if epoch.right else None))
