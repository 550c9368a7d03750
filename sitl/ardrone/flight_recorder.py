"""The AR.Drone's flight recorder: a GPS receiver on its USB port, whose readings the drone sends as navdata option 27."""

from __future__ import annotations

import math

from drivers.ardrone.navdata import Gps
from estimator.contracts.time import after
from sitl.sensors.gnss import GnssErrors
from sitl.world.world import World

_HDOP = 0.6
_SATELLITES = 9


class FlightRecorder:
    """The receiver of one flight; without one (`vehicle.gnss_hz` is 0) its option is all zero."""

    def __init__(self, world: World) -> None:
        rate_hz = world.scenario.vehicle.gnss_hz
        self._period_s = 1.0 / rate_hz if rate_hz > 0.0 else None
        self._receiver = GnssErrors([world.seed, 0x6E57])
        self._due = world.now
        self.newest = Gps()

    def tick(self, world: World) -> None:
        """Read the receiver when its next reading is due."""
        if self._period_s is None or world.now < self._due:
            return
        self._due = after(self._due, self._period_s)
        place = self._receiver.place(world.truth().p_body_ned, world.now)
        self.newest = Gps(
            lat_deg=math.degrees(place.latitude_rad),
            lon_deg=math.degrees(place.longitude_rad),
            elevation_m=0.0 if place.height_m is None else place.height_m,
            hdop=_HDOP,
            data_available=1,
            gps_state=1,
            nb_satellites=_SATELLITES,
            gps_plugged=1,
            last_frame_timestamp=int(world.now // 1_000_000) & 0xFFFFFFFF,
        )
