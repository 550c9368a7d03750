"""The navdata channel requests the stream, keeps its order, maps its clock to ours and makes samples in SI units.

Signs: theta is nose up, phi right side down, psi clockwise, accelerometer and gyro are forward-right-down (a datagram at rest
reads -942 mg downward and +80 mg forward with the nose 4.9 degrees up). Sigmas come from a flight under motion capture:
velocity reads 0.75 to 0.88 of the truth with a lag of 20 ms and 0.014 m/s of noise, height 6 mm, pitch 0.25 degrees.
"""

import math
from collections.abc import Callable
from enum import Enum
from typing import Any

from drivers.ardrone.counters import Counters, Refusal, in_words
from drivers.ardrone.navdata import Navdata, NavdataState, decode
from drivers.ardrone.options import ArDroneOptions
from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.datagrams import WaitingDatagrams, open_waiting
from estimator.contracts.errors import Recoverable
from estimator.contracts.geometry import F64, GeoPoint, Rotation, fixed_matrix, fixed_vector, height_of_pressure_m
from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import (
    UNKNOWN_VAR,
    Attitude,
    Baro,
    BodyVelocity,
    GeoFix,
    Imu,
    Range,
    Sample,
    VehicleStatus,
    known,
)
from estimator.contracts.time import NS_PER_S, Clock, MonoNs, Stamp, after, seconds_between

_M_S2_PER_MG = 1e-3 * G_M_S2  # factor from thousandths of g to m/s^2
_SATELLITES_LEAST = 5
"""Number of satellites below which a place is not taken: four give one without any check."""
_COMMAND_ACK = int(NavdataState.COMMAND_ACK)
DEFAULT = ArDroneOptions()
AS_REPORTED = ArDroneOptions(velocity_scale=1.0, sigma_velocity_fraction=0.2)
"""Options that take velocities as the drone reports them; the covariance covers the uncertainty of their scale."""
_REORDER = 64
"""A datagram this far behind the newest was not overtaken on its way: the drone has restarted."""
_LOOK_S = 0.05  # time between two checks for silence at most; a quarter of the permitted silence if that is shorter
_UNREQUESTED_S = 0.04
"""Time after which the channel itself takes datagrams that no cycle has taken."""


def _of_every_datagram(r: Navdata, stamp: Stamp, options: ArDroneOptions, attitude_cov: F64) -> list[Sample]:
    """Return the samples whose sensors are read again for every datagram."""
    out: list[Sample] = []
    imu = _imu(r, stamp)
    if imu is not None:
        out.append(imu)
    roll, pitch, yaw, vx, vy = r.phi_mdeg, r.theta_mdeg, r.psi_mdeg, r.vx_mm_s, r.vy_mm_s
    if roll is not None and pitch is not None and yaw is not None and _finite((roll, pitch, yaw)):
        angles = math.radians(roll * 1e-3), math.radians(pitch * 1e-3), math.radians(yaw * 1e-3)
        out.append(known(Attitude, stamp, Rotation.from_rpy(*angles), attitude_cov))
    if vx is not None and vy is not None and _finite((vx, vy)):
        out.append(_velocity(vx, vy, stamp, options))
    return out


def _attitude_cov(options: ArDroneOptions) -> F64:
    tilt_var, yaw_var = options.sigma_tilt_rad**2, options.sigma_yaw_rad**2
    return fixed_matrix(tilt_var, 0.0, 0.0, 0.0, tilt_var, 0.0, 0.0, 0.0, yaw_var)


class NavdataSampler:
    """Converts the datagrams of navdata to samples, without repeats.

    The drone repeats a reading in every datagram until the sensor has a new one (ultrasound 25 Hz, barometer about 100 Hz in
    200 datagrams a second). A range, height or status is returned when its source changed, or after `repeat_s`.
    """

    def __init__(self, options: ArDroneOptions = DEFAULT, repeat_s: float = 0.1) -> None:
        self._options = options
        self._attitude_cov = _attitude_cov(options)
        self._repeat_s = repeat_s
        self._given: dict[type[Any], tuple[Any, MonoNs]] = {}

    def samples(self, navdata: Navdata, stamp: Stamp) -> list[Sample]:
        """Return the samples that are new in this datagram, all with the same stamp; readings absent or not finite are left out.

        Returns:
            Imu (body), Attitude (R_ned_body, yaw from the drone's own heading), BodyVelocity (level; down has `UNKNOWN_VAR`),
            Range (along the body's down axis), Baro (height over the 1013.25 hPa level), GeoFix (by the flight
            recorder, where there is one), VehicleStatus, in this order.
        """
        out = _of_every_datagram(navdata, stamp, self._options, self._attitude_cov)
        measured_at = stamp.measured_at
        for kind, (make, source) in _REPEATED.items():
            key = source(navdata)
            if key is None:
                continue
            given = self._given.get(kind)
            if given is not None and given[0] == key and 0.0 <= (measured_at - given[1]) / NS_PER_S < self._repeat_s:
                continue
            made = make(navdata, stamp, self._options)
            if made is not None:
                self._given[kind] = key, measured_at
                out.append(made)
        return out


def _finite(values: tuple[float, ...]) -> bool:
    # A sum is finite only of finite numbers; one that is not may have overflowed.
    return math.isfinite(sum(values)) or all(map(math.isfinite, values))


def _imu(r: Navdata, stamp: Stamp) -> Imu | None:
    ax, ay, az, wx, wy, wz = r.ax_mg, r.ay_mg, r.az_mg, r.wx_deg_s, r.wy_deg_s, r.wz_deg_s
    if ax is None or ay is None or az is None or wx is None or wy is None or wz is None or not _finite((ax, ay, az, wx, wy, wz)):
        return None
    w_body = fixed_vector(math.radians(wx), math.radians(wy), math.radians(wz))
    return known(Imu, stamp, w_body, fixed_vector(ax * _M_S2_PER_MG, ay * _M_S2_PER_MG, az * _M_S2_PER_MG))


def _velocity(vx_mm_s: float, vy_mm_s: float, stamp: Stamp, options: ArDroneOptions) -> BodyVelocity:
    scale = 1e-3 / options.velocity_scale
    ahead, aside = scale * vx_mm_s, scale * vy_mm_s
    var = options.sigma_velocity_m_s**2 + (options.sigma_velocity_fraction * min(math.hypot(ahead, aside), 1e6)) ** 2
    cov = fixed_matrix(var, 0.0, 0.0, 0.0, var, 0.0, 0.0, 0.0, UNKNOWN_VAR)
    return known(BodyVelocity, stamp, fixed_vector(ahead, aside, 0.0), cov)


def _range(r: Navdata, stamp: Stamp, options: ArDroneOptions) -> Range | None:
    distance_m = _range_m(r)
    if distance_m is None:
        return None
    return Range(stamp, distance_m, math.hypot(options.sigma_range_m, options.sigma_range_fraction * distance_m))


def _baro(r: Navdata, stamp: Stamp, options: ArDroneOptions) -> Baro | None:
    if r.pressure_pa is None or r.pressure_pa <= 0:
        return None
    return Baro(stamp, height_of_pressure_m(r.pressure_pa), options.sigma_baro_m)


def _range_m(r: Navdata) -> float | None:
    """Return the ultrasound's own reading, metres; in demo mode, the drone's height rotated back to the body's down axis."""
    if r.state & NavdataState.ULTRASOUND_DEAF:
        return None
    if r.altitude_raw_mm is not None:
        return r.altitude_raw_mm * 1e-3 if r.altitude_raw_mm > 0 else None
    roll, pitch, altitude_mm = r.phi_mdeg, r.theta_mdeg, r.altitude_mm
    if roll is None or pitch is None or altitude_mm is None or altitude_mm <= 0 or not _finite((roll, pitch)):
        return None
    upright = math.cos(math.radians(roll * 1e-3)) * math.cos(math.radians(pitch * 1e-3))
    return altitude_mm * 1e-3 / upright if upright > 0.5 else None


def _range_key(r: Navdata) -> tuple[Any, ...]:
    if r.altitude_raw_mm is None:
        return (_range_m(r),)
    return (r.altitude_raw_mm, r.nb_echo, r.sum_echo)


def _status(r: Navdata, stamp: Stamp, options: ArDroneOptions) -> VehicleStatus:
    mode = r.control_state
    return VehicleStatus(
        stamp,
        flying=bool(r.state & NavdataState.FLYING),
        mode="unknown" if mode is None else mode.name.lower(),
        battery_fraction=min(1.0, r.battery_percent / 100.0) if r.battery_percent is not None else None,
        emergency=bool(r.state & NavdataState.EMERGENCY),
        link_ok=not r.state & (NavdataState.COM_WATCHDOG | NavdataState.COMMUNICATION_LOST),
    )


def _fix(r: Navdata, stamp: Stamp, options: ArDroneOptions) -> GeoFix | None:
    """Return the place by the flight recorder; None without one, before its first fix, and for a place that cannot be."""
    if not r.gps_plugged or not r.data_available or (r.nb_satellites or 0) < _SATELLITES_LEAST:
        return None
    latitude, longitude, height, hdop = r.lat_deg, r.lon_deg, r.elevation_m, r.hdop
    if latitude is None or longitude is None or hdop is None or latitude == longitude == 0.0:
        return None
    if not _finite((latitude, longitude, hdop)) or hdop <= 0.0:
        return None
    try:
        place = GeoPoint.reported(latitude, longitude, height)
    except ValueError:
        return None
    return GeoFix(stamp, "vehicle", place, max(1.0, hdop) * options.sigma_fix_m)


def _fix_key(r: Navdata) -> tuple[Any, ...] | None:
    if not r.gps_plugged:
        return None
    return (r.lat_deg, r.lon_deg, r.elevation_m, r.hdop, r.data_available, r.nb_satellites, r.last_frame_timestamp)


_Maker = Callable[[Navdata, Stamp, ArDroneOptions], Sample | None]
_REPEATED: dict[type[Sample], tuple[_Maker, Callable[[Navdata], Any]]] = {
    Range: (_range, _range_key),
    Baro: (_baro, lambda r: None if r.pressure_pa is None else (r.up, r.ut, r.temperature_dc, r.pressure_pa)),
    GeoFix: (_fix, _fix_key),
    VehicleStatus: (_status, lambda r: (r.state & ~_COMMAND_ACK, r.control_state)),
}
"""Makers of samples for sensors that are slower than the datagrams, in the order of their samples.

Each has a key that changes when the sensor has a new reading; None where the datagram holds no reading of it.
"""


class SequencePlace(Enum):
    """The place of a datagram in its stream."""

    NEXT = "next"
    """It is newer than all before it."""
    OLD = "old"
    """It was overtaken, or arrived a second time."""
    RESTARTED = "restarted"
    """It is the first one of a drone that has restarted."""


class NavdataOrder:
    """Tells where each datagram belongs; only `OLD` ones are to be left out."""

    def __init__(self) -> None:
        self._newest: int | None = None
        self._silent = False

    def place(self, sequence: int) -> SequencePlace:
        """Return the place of a datagram that has arrived."""
        newest, silent = self._newest, self._silent
        place = SequencePlace.NEXT
        if newest is not None and sequence < newest:
            if sequence != 1 and not silent and newest - sequence < _REORDER:
                return SequencePlace.OLD
            place = SequencePlace.RESTARTED
        elif sequence == newest and not silent:
            return SequencePlace.OLD
        self._newest, self._silent = sequence, False
        return place

    def silence(self) -> None:
        """Note that the stream was silent and has been requested again: nothing was overtaken by what comes next."""
        self._silent = True


OPENING = b"\x01\x00\x00\x00"
"""The datagram that requests the unicast stream."""


class NavdataChannel:
    """One navdata stream.

    Args:
        received: is called with every datagram, in order, and the samples made from it.
        restarted: is called when the drone has restarted and has lost the configuration that it was sent.
    """

    def __init__(
        self,
        options: ArDroneOptions,
        clock: Clock,
        counters: Counters,
        received: Callable[[Navdata, list[Sample], MonoNs], None],
        restarted: Callable[[], None],
    ) -> None:
        self._o = options
        self._clock = clock
        self._counters = counters
        self._received = received
        self._restarted = restarted
        self._sampler = NavdataSampler(options)
        self._map = ClockMap(
            ClockMapOptions(
                wrap_ns=2048 * 1_000_000_000,
                floor_s=options.navdata_delay_s,
                floor_sigma_s=options.navdata_delay_sigma_s,
                name="the drone's navdata",
            )
        )
        self._order = NavdataOrder()
        self.received_at: MonoNs | None = None
        """The instant at which the newest good datagram was received; None before the first."""
        self._socket: WaitingDatagrams | None = None
        self.newest: Navdata | None = None

    def take_waiting(self) -> None:
        """Process the datagrams that wait in the socket. Guidance, vision and the commands request them just before they decide.

        Most of the time that a datagram takes by itself is spent on waking for it, 200 times a second. Never raises.
        """
        if self._socket is not None:
            self._socket.take()

    async def run(self) -> None:
        """Receive until the stream is silent for `reopen_after_s`.

        Raises:
            Recoverable: the stream is silent, or the socket is broken.
        """
        async with open_waiting(self._o.host, self._o.navdata_port, self._clock, self.take) as self._socket:
            try:
                await self._watch(self._socket)
            finally:
                self._socket = None

    async def _watch(self, socket: WaitingDatagrams) -> None:
        """Take datagrams that no cycle has taken, and request the stream again when it is silent; as `run`."""
        opened = asked = good_at = self._clock.now()
        before = self._counters.navdata_refused.copy()
        socket.send(OPENING)
        while True:
            await self._clock.sleep(min(_LOOK_S, self._o.navdata_silence_s / 4))
            now = self._clock.now()
            if seconds_between(socket.taken_at, now) >= _UNREQUESTED_S:
                socket.take()
            socket.check()
            received_at = max(opened, self.received_at or opened)
            if received_at > good_at:
                good_at, before = received_at, self._counters.navdata_refused.copy()
            if seconds_between(received_at, now) > self._o.reopen_after_s:
                refused = in_words(self._counters.navdata_refused - before)
                raise Recoverable(f"no navdata for {self._o.reopen_after_s} s" + (f": {refused}" if refused else ""))
            if seconds_between(max(received_at, asked), now) > self._o.navdata_silence_s:
                self._counters.navdata_silences += 1
                self._order.silence()
                socket.send(OPENING)
                asked = now

    def take(self, datagram: bytes, received_at: MonoNs) -> None:
        """Process one received datagram. Never raises on any bytes."""
        navdata = decode(datagram)
        if isinstance(navdata, Refusal):
            self._counters.navdata_refused[navdata.value] += 1
            return
        if not self._in_order(navdata.sequence):
            return
        self.newest, self.received_at = navdata, received_at
        samples = self._sampler.samples(navdata, self._stamp(navdata, received_at)) if navdata.options else []
        self._counters.samples += len(samples)
        self._received(navdata, samples, received_at)

    def _in_order(self, sequence: int) -> bool:
        place = self._order.place(sequence)
        if place is SequencePlace.RESTARTED:
            self._counters.navdata_restarts += 1
            self._map.reset()
            self._restarted()
        return place is not SequencePlace.OLD

    def _stamp(self, navdata: Navdata, received_at: MonoNs) -> Stamp:
        drone_us = navdata.time_us
        if drone_us is not None:
            return self._map.stamp(drone_us * 1000, received_at)
        return Stamp(after(received_at, -self._o.navdata_delay_s), received_at, self._o.arrival_sigma_s, "arrival")
