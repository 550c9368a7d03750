"""Faults of the vehicle's sensors, one kind a sensor, and the readings that they make of the true ones.

A reading may be frozen, delayed, dropped, scaled, offset, drifting, noisy or clipped, in this order when several are given.
Offsets and the like carry the unit of the sensor in their name. The vehicle's own loops go on with the true readings.
"""

import math
from collections import deque
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, get_args

import numpy as np

from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.keys import choice, number
from estimator.contracts.time import MonoNs, after
from sitl.faults.corrupted import Corruptions, Signal
from sitl.faults.fault import Fault, FaultTimer

ReadingName = Literal["f_body", "w_body", "rpy_rad", "v_level_m_s", "ultrasound_m", "pressure_pa", "magnetometer"]
READINGS: tuple[ReadingName, ...] = get_args(ReadingName)
"""The readings by the names of `sitl.sensors.sensors.Readings`, with its axes and units."""

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

    READING: ClassVar[ReadingName]
    """The reading that it acts on."""
    MAY_FAIL: ClassVar[bool] = False
    """True if the sensor says nothing where a reading is dropped; others repeat the one before."""
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

    def on_begin(self, world: Any) -> None:
        if self.frozen:
            world.hold(self)

    def on_reading(self, name: ReadingName, value: F64 | None, since_s: float, now: "Sampled") -> F64 | None:
        """Return the (N,) values of a reading with this fault; None where the sensor says nothing."""
        if name != self.READING:
            return value
        errors, rng, reported = self.errors, np.random.default_rng(now.seed), now.reported
        mine = np.array(errors.axes)
        if self.delay_s > 0.0 or self.frozen:
            other = now.held.setdefault(id(self), value) if self.frozen else now.earlier(self.delay_s)
            value = None if value is None or other is None else np.where(mine, other, value)
        if self.dropped_fraction > 0.0 and rng.random() < self.dropped_fraction:
            value = None if self.MAY_FAIL else reported.get(id(self), value)
        elif self.dropped_fraction > 0.0:
            reported[id(self)] = value
        if value is None:
            return None
        added = np.array(errors.offset) + since_s * np.array(errors.drift)
        if errors.noise > 0.0:
            added = added + mine * errors.noise * rng.standard_normal(len(value))
        value = np.where(mine, self.scale * value, value) + added
        return np.where(mine, np.clip(value, -errors.limit, errors.limit), value)


class Accelerometer(SensorFault, frozen=True, tag="accelerometer"):
    """The accelerometer; a spike where the fault lasts for milliseconds."""

    READING = "f_body"
    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_m_s2: Annotated[float, number(_OFFSET, "m/s^2", -1e6, 1e6)] = 0.0
    drift_m_s3: Annotated[float, number(_DRIFT, "m/s^3", -1e3, 1e3)] = 0.0
    noise_m_s2: Annotated[float, number(_NOISE, "m/s^2", 0.0, 1e3)] = 0.0
    limit_m_s2: Annotated[float, number(_LIMIT, "m/s^2", 0.0, 1e3)] | None = None


class Gyro(SensorFault, frozen=True, tag="gyro"):
    """The gyro."""

    READING = "w_body"
    UNIT = math.radians(1.0)
    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_deg_s: Annotated[float, number(_OFFSET, "deg/s", -1e5, 1e5)] = 0.0
    drift_deg_s2: Annotated[float, number(_DRIFT, "deg/s^2", -1e3, 1e3)] = 0.0
    noise_deg_s: Annotated[float, number(_NOISE, "deg/s", 0.0, 1e4)] = 0.0
    limit_deg_s: Annotated[float, number(_LIMIT, "deg/s", 0.0, 1e4)] | None = None


class AttitudeReading(SensorFault, frozen=True, tag="attitude"):
    """The reported roll and pitch; the vehicle's own loops go on with the right ones."""

    READING = "rpy_rad"
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

    READING = "rpy_rad"
    UNIT = math.radians(1.0)
    offset_deg: Annotated[float, number("added heading, clockwise", "deg", -180.0, 180.0)] = 0.0
    drift_deg_s: Annotated[float, number("added heading for each second since the fault began", "deg/s", -90.0, 90.0)] = 0.0
    noise_deg: Annotated[float, number(_NOISE, "deg", 0.0, 180.0)] = 0.0

    @property
    def axes(self) -> tuple[bool, ...]:
        return (False, False, True)

    def on_reading(self, name: ReadingName, value: F64 | None, since_s: float, now: "Sampled") -> F64 | None:
        value = super().on_reading(name, value, since_s, now)
        if value is None:
            return None
        if name == "rpy_rad":
            value[2] = wrap_pi(float(value[2]))
        elif name == "magnetometer" and (by_rad := self.errors.offset[2] + since_s * self.errors.drift[2]):
            c, s = math.cos(by_rad), math.sin(by_rad)
            value = np.array([c * value[0] + s * value[1], c * value[1] - s * value[0], value[2]])
        return value


class VelocityReading(SensorFault, frozen=True, tag="velocity"):
    """The velocity that the vehicle reports; its own loops go on with the right one."""

    READING = "v_level_m_s"
    AXES = "xy"
    axis: Annotated[Literal["x", "y", "all"], choice("affected axis: x forward, y right")] = "all"
    offset_m_s: Annotated[float, number(_OFFSET, "m/s", -20.0, 20.0)] = 0.0
    drift_m_s2: Annotated[float, number(_DRIFT, "m/s^2", -10.0, 10.0)] = 0.0
    noise_m_s: Annotated[float, number(_NOISE, "m/s", 0.0, 20.0)] = 0.0
    limit_m_s: Annotated[float, number(_LIMIT, "m/s", 0.0, 20.0)] | None = None


class Ultrasound(SensorFault, frozen=True, tag="ultrasound"):
    """The ultrasound."""

    READING = "ultrasound_m"
    MAY_FAIL = True
    offset_m: Annotated[float, number(_OFFSET, "m", -6.0, 6.0)] = 0.0
    drift_m_s: Annotated[float, number(_DRIFT, "m/s", -2.0, 2.0)] = 0.0
    noise_m: Annotated[float, number(_NOISE, "m", 0.0, 6.0)] = 0.0
    limit_m: Annotated[float, number(_LIMIT, "m", 0.0, 20.0)] | None = None

    def on_reading(self, name: ReadingName, value: F64 | None, since_s: float, now: "Sampled") -> F64 | None:
        value = super().on_reading(name, value, since_s, now)
        return value if value is None or name != self.READING else np.maximum(value, 0.0)


class Barometer(SensorFault, frozen=True, tag="barometer"):
    """The barometer; 12 Pa more are one metre less of height."""

    READING = "pressure_pa"
    offset_pa: Annotated[float, number(_OFFSET, "Pa", -2000.0, 2000.0)] = 0.0
    drift_pa_s: Annotated[float, number(_DRIFT, "Pa/s", -200.0, 200.0)] = 0.0
    noise_pa: Annotated[float, number(_NOISE, "Pa", 0.0, 2000.0)] = 0.0


class Magnetometer(SensorFault, frozen=True, tag="magnetometer"):
    """The magnetometer."""

    READING = "magnetometer"
    MAY_FAIL = True
    UNIT = 1e-6
    AXES = "xyz"
    axis: Annotated[Axis, choice(_AXIS)] = "all"
    offset_ut: Annotated[float, number(_OFFSET, "uT", -200.0, 200.0)] = 0.0
    drift_ut_s: Annotated[float, number(_DRIFT, "uT/s", -50.0, 50.0)] = 0.0
    noise_ut: Annotated[float, number(_NOISE, "uT", 0.0, 200.0)] = 0.0


class NavdataMisstamped(Fault, frozen=True, tag="navdata_misstamped"):
    """Samples carry a wrong stamp: with a negative error they claim to be older than they are."""

    by_s: Annotated[float, number("stamp minus the true instant of the sample", "s", -3600.0, 3600.0)]


_SIGNALS: dict[ReadingName, dict[Signal, slice]] = {
    "f_body": {"accelerometer": slice(3)},
    "w_body": {"gyro": slice(3)},
    "rpy_rad": {"attitude": slice(2), "heading": slice(2, 3)},
    "v_level_m_s": {"velocity": slice(2)},
    "ultrasound_m": {"range": slice(1)},
    "pressure_pa": {"barometer": slice(1)},
}
"""The signals of each reading, and their parts of it."""


class Sampled(NamedTuple):
    """One sample of a reading, with what the sensor said before."""

    held: dict[int, F64 | None]
    """The true reading at the beginning of each frozen sensor's fault."""
    reported: dict[int, F64 | None]
    """The newest value that each sensor with dropped readings has reported."""
    past: deque[tuple[MonoNs, F64 | None]]
    """The true readings, the newest last."""
    seed: list[int]

    def earlier(self, by_s: float) -> F64 | None:
        """Return the true reading that was the newest some time ago; the oldest known if none is as old."""
        at = after(self.past[-1][0], -by_s)
        return next((value for when, value in reversed(self.past) if when <= at), self.past[0][1])


class FaultyReadings:
    """Turns true readings into those of faulty sensors. One call for each sample of a reading, in order of time.

    Args:
        faults: which faults are active.
        seed: seed of dropped readings and of noise.
        corruptions: what the signals say instead of what was measured.
    """

    def __init__(self, faults: FaultTimer, seed: int, corruptions: Corruptions) -> None:
        self._faults, self._seed, self._corruptions = faults, seed, corruptions
        self.held: dict[int, F64 | None] = {}
        """See `Sampled`."""
        self._reported: dict[int, F64 | None] = {}
        listed = faults.listed(SensorFault)
        turned = any(isinstance(fault, HeadingReading) for fault in listed)
        wrong = {
            *(fault.READING for fault in listed),
            *(name for name, parts in _SIGNALS.items() if corruptions.signals & parts.keys()),
            *(("magnetometer",) if turned else ()),
        }
        self.names = tuple(name for name in READINGS if name in wrong)
        """The readings that are ever wrong."""
        self._past: dict[ReadingName, deque[tuple[MonoNs, F64 | None]]] = {
            fault.READING: deque() for fault in listed if fault.delay_s > 0.0
        }

    def of(self, name: ReadingName, true: F64 | None, at: MonoNs) -> F64 | None:
        """Return the (N,) values of a reading as the sensor gives them, the same array where nothing is wrong; None for none."""
        past = self._past.get(name, deque())
        past.append((at, true))
        while past[0][0] < after(at, -MOST_DELAY_S - 0.1):
            past.popleft()
        value, active = true, self._faults.on(SensorFault)
        if self.held:
            self.held = {each: kept for each, kept in self.held.items() if any(each == id(fault) for fault, _ in active)}
        for n, (fault, since_s) in enumerate(active):
            seed = [self._seed, at // 1_000_000, n]
            value = fault.on_reading(name, value, since_s, Sampled(self.held, self._reported, past, seed))
        for signal, part in _SIGNALS.get(name, {}).items():
            if value is None or signal not in self._corruptions.signals:
                continue
            before = tuple(value[part].tolist())
            if (wrong := self._corruptions.of(signal, before, at)) is not before:
                value = value.copy()
                value[part] = wrong
                value = np.maximum(value, 0.0) if signal == "range" else value
        return value

    def stamp(self, at: MonoNs) -> MonoNs:
        """Return the instant that the samples of an instant claim."""
        (stamp_s,) = self._corruptions.of("sample_stamps", ((at_s := at * 1e-9),), at)
        out = at if stamp_s == at_s else after(at, stamp_s - at_s)
        return after(out, sum(fault.by_s for fault, _ in self._faults.on(NavdataMisstamped)))
