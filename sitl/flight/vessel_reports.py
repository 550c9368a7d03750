"""Reports of a ship to the service over a radio link: her GNSS, compass and RTK pair, and what `ship_sensors` adds."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np
from msgspec.structs import replace

from drivers.ship_reports import FLOOR_M
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.samples import Baseline, GeoFix, OfVessel, VesselReport
from estimator.contracts.time import MonoNs, Stamp, after
from sitl.faults.kinds import RtkSolution, VesselReports
from sitl.flight.ship_sensors import Anemometer, MotionSensor, ShipAt, TurnSensor
from sitl.sensors.rtk import RtkErrors
from sitl.sensors.sensors import SIGMA_M, GnssErrors
from sitl.world.world import World

_DELAY_S, _WIND_DELAY_S = 0.2, 1.0
"""Delays from the ship's receiver and anemometer to the service (assumed)."""
_SIGMA_M_S, _SIGMA_HEADING_RAD = 0.1, math.radians(1.0)
"""A GNSS receiver's velocity and a ship's compass (assumed); the report claims the same."""
_HEADING_BIAS_RAD, _HEADING_SIGMA_RAD, _HEADING_CLAIMED_RAD = (math.radians(x) for x in (0.3, 0.3, 0.36))
"""Error of the antennas' mounting, noise of an epoch, and what a driver claims of both (antennas a metre apart; assumed)."""
_STAMP_SIGMA_S, _JITTER_S = 0.02, 0.04
"""Error of the latency that the service assumes, one for the flight, and the longest further delay of an arrival (assumed)."""

Reports = tuple[OfVessel | GeoFix | Baseline, ...]


class _Stream:
    """The reports of one instrument on their way.

    Args:
        measure: returns what it measures at an instant, stamped with it; nothing where it is silent.
        rate_hz: how often.
        delay_s: time until it arrives.
        arrival: whether the service stamps it by its arrival; else the stamp is true.
    """

    def __init__(self, measure: Callable[[MonoNs], Reports], rate_hz: float, delay_s: float, *, arrival: bool = True) -> None:
        self._measure, self._period_s, self._delay_s, self._arrival = measure, 1.0 / rate_hz, delay_s, arrival
        self._due = MonoNs(0)
        self._under_way: deque[tuple[MonoNs, Reports]] = deque()

    def arrived(self, now: MonoNs, late_s: float) -> Reports:
        """Return the newest of what arrives now, `late_s` later than usual."""
        if now >= self._due:
            self._due = after(max(self._due, after(now, -self._period_s)), self._period_s)
            if made := self._measure(now):
                self._under_way.append((now, made))
        newest: Reports = ()
        while self._under_way and after(self._under_way[0][0], self._delay_s + late_s) <= now:
            newest = self._under_way.popleft()[1]
        stamped = (replace(r.stamp, received_at=now, **({"measured_at": now} if self._arrival else {})) for r in newest)
        return tuple(replace(report, stamp=stamp) for report, stamp in zip(newest, stamped, strict=True))


class RtkPair:
    """Makes the baselines that reach the service."""

    def __init__(self, world: World) -> None:
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


class VesselReporter:
    """Makes the reports that reach the service; none where the scenario's ship sends none."""

    def __init__(self, world: World) -> None:
        self._world, ship = world, world.scenario.vessel
        self._ship = ShipAt(world)
        self._rng = np.random.default_rng([world.seed, 0x6E55])
        self._receiver = GnssErrors([world.seed, 0x6E56])
        self._frozen: tuple[np.ndarray, float] | None = None
        self._of_receiver = _Stream(self._make, ship.reports_hz, _DELAY_S, arrival=False) if ship.reports_hz else None
        self._others: list[_Stream] = []
        self._rtk = RtkPair(world) if world.scenario.rtk.rate_hz else None
        self._motion = MotionSensor(world) if ship.motion_hz else None
        if self._motion is not None:
            self._others.append(_Stream(self._motion.measured, ship.motion_hz, ship.motion_delay_s))
        if ship.turn_hz:
            self._others.append(_Stream(TurnSensor(world).measured, ship.turn_hz, ship.turn_delay_s))
        if ship.wind_hz:
            self._others.append(_Stream(Anemometer(world).measured, ship.wind_hz, _WIND_DELAY_S))

    @property
    def located(self) -> MonoNs | None:
        """Instant of the newest true baseline that has arrived; None before one."""
        return None if self._rtk is None else self._rtk.located

    def reports(self, now: MonoNs) -> Reports:
        """Return the reports that arrive at this instant."""
        out: Reports = ()
        if self._of_receiver is not None:
            late_s = max((fault.late_s for fault, _ in self._world.faults.on(VesselReports)), default=0.0)
            out = self._of_receiver.arrived(now, late_s)
        if self._motion is not None:
            self._motion.follow(now)
        for stream in self._others:
            out += stream.arrived(now, 0.0)
        return out if self._rtk is None else (*out, *self._rtk.arrived(now))

    def _make(self, now: MonoNs) -> Reports:
        """Return the receiver's report."""
        noise, corrupted = self._rng.standard_normal(4), self._world.corruptions.of
        true_place, velocity = self._ship.place(self._world.scenario.vessel.reports_at_m)
        velocity = velocity + _SIGMA_M_S * noise[:3]
        heading = self._ship.rpy_rad[2] + _SIGMA_HEADING_RAD * noise[3]
        x, y, z = true_place.tolist()
        place = self._receiver.place(np.array(corrupted("ship_place", (x, y, z), now)), now)
        north, east, down = velocity.tolist()
        velocity = np.array(corrupted("ship_velocity", (north, east, down), now))
        (heading,) = corrupted("ship_heading", (float(heading),), now)
        faults = [fault for fault, _ in self._world.faults.on(VesselReports)]
        if any(fault.silent for fault in faults):
            return ()
        if any(fault.frozen for fault in faults):
            self._frozen = self._frozen or (velocity, heading)
            velocity, heading = self._frozen
        else:
            self._frozen = None
        for fault in faults:
            velocity, heading, place = fault.on_report(velocity, heading, place)
        stamp = Stamp(self._world.at, now, 0.05, "sim")
        cov = _SIGMA_M_S**2 * np.eye(3)
        made: Reports = (VesselReport(stamp, velocity, cov, wrap_pi(heading), _SIGMA_HEADING_RAD),)
        if self._world.scenario.vessel.reports_place:
            made = (*made, GeoFix(stamp, "vessel", place, SIGMA_M, velocity))
        return made
