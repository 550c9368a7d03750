"""Faults of the vehicle's sensors as data: one kind a sensor, with what it does to the readings.

A reading may be frozen, delayed, dropped, scaled, offset, drifting, noisy or clipped, in this order when several are given.
Offsets and the like carry the unit of the sensor in their name.
"""

import math
from typing import Annotated, ClassVar, Literal, NamedTuple

from estimator.contracts.keys import choice, number
from sitl.faults.fault import Fault

_OFFSET, _DRIFT = "added to the true value", "added for each second since the fault began"
_NOISE, _LIMIT = "standard deviation of added white noise", "largest magnitude that the sensor can tell"
_AXIS = "affected axis of the body: x forward, y right, z down"
Axis = Literal["x", "y", "z", "all"]
MOST_DELAY_S = 2.0


class ReadingErrors(NamedTuple):
    """Errors of a sensor's values, in SI units and radians."""

    offset: tuple[float, ...] = (0.0,)
    drift: tuple[float, ...] = (0.0,)
    noise: float = 0.0
    limit: float = math.inf
    axes: tuple[bool, ...] = (True,)
    """The values of the reading that noise, scale and limit act on."""


class SensorFault(Fault, frozen=True):
    """A fault of one sensor. The numbers of a kind have the names of `ERRORS`, with the kind's own unit."""

    ERRORS: ClassVar[tuple[str, ...]] = ("offset", "drift", "noise", "limit")
    UNIT: ClassVar[float] = 1.0
    """One such unit, in SI units or radians."""
    AXES: ClassVar[str] = ""
    """Names of the values of a reading that has several."""
    frozen: Annotated[bool, choice("whether the reading at the beginning is repeated")] = False
    delay_s: Annotated[float, number("time by which readings are older than they claim", "s", 0.0, MOST_DELAY_S)] = 0.0
    dropped_fraction: Annotated[
        float,
        number(
            "fraction of the readings that fail, drawn by the seed: no echo or field, else the one before again", "1", 0.0, 1.0
        ),
    ] = 0.0
    scale: Annotated[float, number("reported value over the true value", "1", -10.0, 10.0)] = 1.0

    @property
    def axes(self) -> tuple[bool, ...]:
        """The values of the reading that the fault acts on."""
        return tuple(getattr(self, "axis", "all") in (name, "all") for name in self.AXES) or (True,)

    @property
    def errors(self) -> ReadingErrors:
        """The numbers of this kind in SI units."""
        numbers = [(name.partition("_")[0], getattr(self, name)) for name in self.__struct_fields__]
        given = {name: self.UNIT * value for name, value in numbers if name in self.ERRORS and value is not None}
        offset, drift = (tuple(given[name] if on else 0.0 for on in self.axes) for name in ("offset", "drift"))
        return ReadingErrors(offset, drift, given["noise"], given.get("limit", math.inf), self.axes)

    def check(self) -> None:
        """Refuse a fault without an effect; raises ValueError."""
        e = self.errors
        values = (self.frozen, self.delay_s, self.dropped_fraction, self.scale - 1.0, *e.offset, *e.drift, e.noise)
        if not any(values) and math.isinf(e.limit):
            raise ValueError("nothing says what is wrong with the sensor: give frozen, delay_s, scale or another effect")


class Accelerometer(SensorFault, frozen=True, tag="accelerometer"):
    """The accelerometer; a spike where the fault lasts for milliseconds."""

    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_m_s2: Annotated[float, number(_OFFSET, "m/s^2", -1e6, 1e6)] = 0.0
    drift_m_s3: Annotated[float, number(_DRIFT, "m/s^3", -1e3, 1e3)] = 0.0
    noise_m_s2: Annotated[float, number(_NOISE, "m/s^2", 0.0, 1e3)] = 0.0
    limit_m_s2: Annotated[float, number(_LIMIT, "m/s^2", 0.0, 1e3)] | None = None


class Gyro(SensorFault, frozen=True, tag="gyro"):
    """The gyro."""

    UNIT = math.radians(1.0)
    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_deg_s: Annotated[float, number(_OFFSET, "deg/s", -1e5, 1e5)] = 0.0
    drift_deg_s2: Annotated[float, number(_DRIFT, "deg/s^2", -1e3, 1e3)] = 0.0
    noise_deg_s: Annotated[float, number(_NOISE, "deg/s", 0.0, 1e4)] = 0.0
    limit_deg_s: Annotated[float, number(_LIMIT, "deg/s", 0.0, 1e4)] | None = None


class AttitudeReading(SensorFault, frozen=True, tag="attitude"):
    """The reported roll and pitch; the vehicle's own loops go on with the right ones."""

    roll_deg: Annotated[float, number("added roll, right side down", "deg", -45.0, 45.0)] = 0.0
    pitch_deg: Annotated[float, number("added pitch, nose up", "deg", -45.0, 45.0)] = 0.0
    roll_drift_deg_s: Annotated[float, number("added roll for each second since the fault began", "deg/s", -30.0, 30.0)] = 0.0
    pitch_drift_deg_s: Annotated[float, number("added pitch for each second since the fault began", "deg/s", -30.0, 30.0)] = 0.0
    noise_deg: Annotated[float, number(_NOISE, "deg", 0.0, 45.0)] = 0.0
    limit_deg: Annotated[float, number(_LIMIT, "deg", 0.0, 90.0)] | None = None

    @property
    def errors(self) -> ReadingErrors:
        limit = math.inf if self.limit_deg is None else math.radians(self.limit_deg)
        offset = (math.radians(self.roll_deg), math.radians(self.pitch_deg), 0.0)
        drift = (math.radians(self.roll_drift_deg_s), math.radians(self.pitch_drift_deg_s), 0.0)
        return ReadingErrors(offset, drift, math.radians(self.noise_deg), limit, (True, True, False))


class HeadingReading(SensorFault, frozen=True, tag="heading"):
    """The reported heading; the magnetic field turns with an offset or a drift, as beside steel."""

    UNIT = math.radians(1.0)
    offset_deg: Annotated[float, number("added heading, clockwise", "deg", -180.0, 180.0)] = 0.0
    drift_deg_s: Annotated[float, number("added heading for each second since the fault began", "deg/s", -90.0, 90.0)] = 0.0
    noise_deg: Annotated[float, number(_NOISE, "deg", 0.0, 180.0)] = 0.0

    @property
    def axes(self) -> tuple[bool, ...]:
        return (False, False, True)


class VelocityReading(SensorFault, frozen=True, tag="velocity"):
    """The velocity that the vehicle reports; its own loops go on with the right one."""

    AXES = "xy"
    axis: Annotated[Literal["x", "y", "all"], choice("affected axis: x forward, y right")] = "all"
    offset_m_s: Annotated[float, number(_OFFSET, "m/s", -20.0, 20.0)] = 0.0
    drift_m_s2: Annotated[float, number(_DRIFT, "m/s^2", -10.0, 10.0)] = 0.0
    noise_m_s: Annotated[float, number(_NOISE, "m/s", 0.0, 20.0)] = 0.0
    limit_m_s: Annotated[float, number(_LIMIT, "m/s", 0.0, 20.0)] | None = None


class Ultrasound(SensorFault, frozen=True, tag="ultrasound"):
    """The ultrasound."""

    offset_m: Annotated[float, number(_OFFSET, "m", -6.0, 6.0)] = 0.0
    drift_m_s: Annotated[float, number(_DRIFT, "m/s", -2.0, 2.0)] = 0.0
    noise_m: Annotated[float, number(_NOISE, "m", 0.0, 6.0)] = 0.0
    limit_m: Annotated[float, number(_LIMIT, "m", 0.0, 20.0)] | None = None


class Barometer(SensorFault, frozen=True, tag="barometer"):
    """The barometer; 12 Pa more are one metre less of height."""

    offset_pa: Annotated[float, number(_OFFSET, "Pa", -2000.0, 2000.0)] = 0.0
    drift_pa_s: Annotated[float, number(_DRIFT, "Pa/s", -200.0, 200.0)] = 0.0
    noise_pa: Annotated[float, number(_NOISE, "Pa", 0.0, 2000.0)] = 0.0


class Magnetometer(SensorFault, frozen=True, tag="magnetometer"):
    """The magnetometer."""

    UNIT = 1e-6
    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_ut: Annotated[float, number(_OFFSET, "uT", -200.0, 200.0)] = 0.0
    drift_ut_s: Annotated[float, number(_DRIFT, "uT/s", -50.0, 50.0)] = 0.0
    noise_ut: Annotated[float, number(_NOISE, "uT", 0.0, 200.0)] = 0.0
