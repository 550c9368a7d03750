"""Check readings, frames and stamps by themselves.

Check readings for impossible values, impossible steps and bit-identical repetition, and frames for the last.

A sensor's noise makes every genuine frame different from every other, so frames are compared bit by bit over a subsample of the
raw pixels. That covers a driver that returns one buffer again, a ring of buffers, and a codec that repeats a frame.

Check stamps: arrivals that differ from all others, and delays that leave their stream's own median.

This module reads no clock. One host stamps all arrivals, so the newest confirmed arrival is the time. An arrival that is more
than `clock_step_max_s` away is refused, and becomes the time only after others confirm it, as after a real pause.
"""

import math
import zlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct, structs
from numpy.typing import NDArray

from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.contracts.time import NS_PER_S, Stamp
from estimator.integrity.options import IntegrityOptions

Reading = Imu | Attitude | BodyVelocity | Range | Baro | VesselReport

_STEP_OVER_S = 0.1  # Longest time over which a step's limit grows. Without this bound, any spike would pass after a long pause.
_UNMEASURED_VAR = 1e3  # Variance above which a velocity component was not measured
_EVERY = 16  # Distance of the rows that are compared: 23 of 360, 44 kB, 0.04 ms
_KEPT = 16  # Number of frames whose digest is kept: more than the buffer ring of a capture driver holds
_FROZEN_RUN = 3  # Repeated frames in a row that show a frozen camera
_CONFIRMED_BY = 5  # Stamps of another clock that confirm it
_CONFIRMED_IN_NS = 200_000_000  # Least time that they span
_MEDIAN_STEP_S = 0.002  # Step by which a running median follows
_FIRST_FEW = 8  # Samples in which it follows faster
_STANDS_NS = 100_000_000  # Time of arrival over which the stamps of a quick stream have not gone on, after which its clock stands


class Repeat(Struct, frozen=True):
    """The newest reading, for the bitwise comparison."""

    value: bytes | float
    since: int
    """Instant when it was first read, ns."""


class Plausible(Struct, frozen=True):
    """The newest reading that passed."""

    numbers: tuple[float, ...]
    """The numbers that `_step` compares; none if no step of this kind of reading is too large."""
    at: int
    """Instant of the measurement, ns."""


class SensorWatch(Struct, frozen=True):
    """The state of one stream of readings."""

    repeat: Repeat | None = None
    frozen: bool = False
    """True if the newest reading was refused as a repetition."""
    plausible: Plausible | None = None
    refused_since: int | None = None
    """Instant of the first of an unbroken series of refused steps, ns."""


def watch_reading(state: SensorWatch, event: Reading, o: IntegrityOptions, flying: bool) -> tuple[SensorWatch, Verdict | None]:
    """Check one reading.

    Returns:
        The new state, and IMPOSSIBLE, FROZEN, or None. FROZEN applies in flight only; on the ground a velocity stays zero.
    """
    t = event.stamp.measured_at
    value, numbers, beyond, frozen_s = _READ[type(event)](event, o)
    repeat, before, refused_since = state.repeat, state.plausible, state.refused_since
    if repeat is None or repeat.value != value or t < repeat.since:
        repeat = Repeat(value, t)
    since = repeat.since
    if beyond:
        return SensorWatch(repeat, False, before, refused_since), Verdict.IMPOSSIBLE
    if flying and (t - since) * 1e-9 > frozen_s:
        return SensorWatch(repeat, True, before, refused_since), Verdict.FROZEN
    if before is not None and t > before.at and numbers and _step(event, numbers, before, o):
        since = t if refused_since is None else refused_since
        if (t - since) * 1e-9 < o.spike_s:
            return SensorWatch(repeat, False, before, since), Verdict.IMPOSSIBLE
    return SensorWatch(repeat, False, Plausible(numbers, t), None), None


_Read = tuple[bytes | float, tuple[float, ...], bool, float]
"""Fields of a reading that the checks need.

They are the part that must change, the numbers that `_step` compares, and whether a value is beyond the vehicle's abilities. The
last is the longest time without a change, s (infinity if it need not change).
"""


def _imu(event: Imu, o: IntegrityOptions) -> _Read:
    w, f = event.w_body, event.f_body
    beyond = math.hypot(*f.tolist()) > o.specific_force_max_m_s2 or math.hypot(*w.tolist()) > o.turn_rate_max_rad_s
    return (w.tobytes() + f.tobytes(), (), beyond, o.imu_frozen_s)


def _attitude(event: Attitude, o: IntegrityOptions) -> _Read:
    m = event.R_ned_body.matrix
    return (m.tobytes(), tuple(m[2].tolist()), False, o.attitude_frozen_s)


def _velocity(event: BodyVelocity, o: IntegrityOptions) -> _Read:
    v = event.v_level
    (x, y, z), ((xx, _, _), (_, yy, _), (_, _, zz)) = v.tolist(), event.cov_level.tolist()
    numbers = x if xx < _UNMEASURED_VAR else 0.0, y if yy < _UNMEASURED_VAR else 0.0, z if zz < _UNMEASURED_VAR else 0.0
    return (v.tobytes(), numbers, math.hypot(*numbers) > o.speed_max_m_s, o.velocity_frozen_s)


def _vessel(event: VesselReport, o: IntegrityOptions) -> _Read:
    v = event.v_vessel_ned
    return (b"", (), v is not None and math.hypot(*v.tolist()) > o.speed_max_m_s, math.inf)


_READ: dict[type[Reading], Callable[[Any, IntegrityOptions], _Read]] = {
    Imu: _imu,
    Attitude: _attitude,
    BodyVelocity: _velocity,
    Range: lambda event, o: (event.range_m, (), False, o.range_frozen_s),
    Baro: lambda event, o: (event.height_m, (event.height_m,), False, o.baro_frozen_s),
    VesselReport: _vessel,
}


def _step(event: Reading, numbers: tuple[float, ...], before: Plausible, o: IntegrityOptions) -> bool:
    """Return whether the step since the last plausible reading is more than the vehicle can do."""
    dt = min((event.stamp.measured_at - before.at) * 1e-9, _STEP_OVER_S)
    step = math.dist(numbers, before.numbers)
    kind = type(event)
    if kind is BodyVelocity:
        return step > o.velocity_step_m_s + o.acceleration_max_m_s2 * dt
    if kind is Attitude:
        return 2.0 * math.asin(min(1.0, 0.5 * step)) > o.tilt_step_rad + o.tilt_rate_max_rad_s * dt
    return step > o.height_step_m + o.height_rate_max_m_s * dt


class FrameWatch(NamedTuple):
    """Digests of the newest distinct frames, and the number of repeats since."""

    digests: tuple[int, ...] = ()
    run: int = 0
    """Number of repeats in a row."""
    at: int = 0
    """Arrival of the newest frame, ns."""

    @property
    def frozen(self) -> bool:
        return self.run >= _FROZEN_RUN


def digest(px: NDArray[np.uint8]) -> int:
    """Return a checksum over rows of an image (H, W, 3), spread over its height."""
    rows = px[_EVERY // 2 :: _EVERY]
    # An image that repeats one row in memory shows nothing more than that row.
    return zlib.crc32(np.ascontiguousarray(rows[:1] if rows.strides[0] == 0 else rows).data)


def watch_frame(state: FrameWatch, px: NDArray[np.uint8], at: int = 0) -> tuple[FrameWatch, bool]:
    """Process one frame that arrived at an instant, ns; return whether it repeats one of the last few."""
    this = digest(px)
    if this in state.digests:
        return FrameWatch(state.digests, state.run + 1, at), True
    return FrameWatch((*state.digests, this)[-_KEPT:], 0, at), False


class _Rival(NamedTuple):
    """A time that some arrivals report and the others do not confirm yet."""

    first: int
    last: int
    n: int
    kinds: frozenset[str]


class Delay(Struct, frozen=True):
    """The delay of one stream."""

    median_s: float
    since: int
    """Arrival of the first sample with about this delay, ns."""
    n: int = 1
    off_since: int | None = None
    """Arrival, ns, of the first of an unbroken series of samples with another delay."""
    newest: int = 0
    """The newest stamp, ns."""
    newest_at: int = 0
    """Arrival, ns, of the first sample with it."""
    at: int = 0
    """Arrival, ns, of the newest sample."""


class ClockWatch(Struct, frozen=True):
    """The arrivals and delays so far."""

    now: int | None = None
    """The newest confirmed arrival, ns."""
    rival: _Rival | None = None
    delays: Mapping[str, Delay] = MappingProxyType({})

    def off(self, kind: str) -> bool:
        """Return whether the delay of the newest sample of a kind was refused."""
        delay = self.delays.get(kind)
        return delay is not None and delay.off_since is not None

    def at(self, kind: str) -> int:
        """Return the arrival of the newest sample of a kind, ns; 0 before the first."""
        delay = self.delays.get(kind)
        return 0 if delay is None else delay.at


def watch_arrival(state: ClockWatch, kind: str, stamp: Stamp, step_max_s: float) -> tuple[ClockWatch, Verdict | None]:
    """Process an arrival; return TOO_NEW or TOO_OLD if no other arrival confirms its time."""
    received_at, now = stamp.received_at, state.now
    if now is None:
        return structs.replace(state, now=received_at), None
    step = round(step_max_s * 1e9)
    if abs(received_at - now) <= step:
        return ClockWatch(max(now, received_at), None, state.delays), None
    rival = state.rival
    rival = (
        _Rival(received_at, received_at, 1, frozenset((kind,)))
        if rival is None or not -step <= received_at - rival.last <= step
        else _Rival(rival.first, max(rival.last, received_at), rival.n + 1, rival.kinds | {kind})
    )
    lasting = rival.n >= _CONFIRMED_BY and rival.last - rival.first >= _CONFIRMED_IN_NS
    if lasting or len(rival.kinds) >= 2:
        return ClockWatch(rival.last), None
    return structs.replace(state, rival=rival), Verdict.TOO_NEW if received_at > now else Verdict.TOO_OLD


def watch_delay(
    state: ClockWatch, kind: str, stamp: Stamp, step_max_s: float, settle_s: float, keep_s: float = math.inf
) -> tuple[ClockWatch, Verdict | None]:
    """Process a delay of one stream.

    Args:
        kind: the stream's name.
        step_max_s: largest difference from the stream's running median.
        settle_s: time after which an unbroken other delay becomes the stream's own.
        keep_s: time after which the stream's delay gives way to no other.

    Returns:
        The new state, and TOO_NEW or TOO_OLD if the delay is not the stream's.
    """
    delay, verdict = delay_after(state.delays.get(kind), stamp, step_max_s, settle_s, keep_s, quick=True)
    return ClockWatch(state.now, state.rival, {**state.delays, kind: delay}), verdict


def delay_after(
    delay: Delay | None, stamp: Stamp, step_max_s: float, settle_s: float, keep_s: float = math.inf, *, quick: bool = False
) -> tuple[Delay, Verdict | None]:
    """Process a delay of one stream, as `watch_delay` does; `delay` is None before the stream's first sample.

    Args:
        quick: the stream has ten samples a second or more, so a stamp that comes again later is of a clock that stands.
    """
    received_at = stamp.received_at
    d = (received_at - stamp.measured_at) / NS_PER_S
    if delay is None:
        return Delay(d, received_at, newest=stamp.measured_at, newest_at=received_at, at=received_at), None
    median_s, n, off_since = delay.median_s, delay.n, delay.off_since
    newest, newest_at = delay.newest, delay.newest_at
    if stamp.measured_at > newest:
        newest, newest_at = stamp.measured_at, received_at
    elif quick and received_at - newest_at > _STANDS_NS:
        return structs.replace(delay, off_since=received_at if off_since is None else off_since, at=received_at), Verdict.TOO_OLD
    off_s = d - median_s
    if abs(off_s) <= step_max_s:
        # The median moves in small steps, so that an outlier has no more effect than any other sample.
        step = max(_MEDIAN_STEP_S, abs(off_s) / (n + 1)) if n < _FIRST_FEW else _MEDIAN_STEP_S
        moved_s = -step if off_s < -step else step if off_s > step else off_s
        return Delay(median_s + moved_s, delay.since, n + 1, None, newest, newest_at, received_at), None
    if n < _FIRST_FEW:
        return Delay(d, received_at, 1, None, newest, newest_at, received_at), None
    off_since = received_at if off_since is None else off_since
    if (received_at - off_since) * 1e-9 >= settle_s and (off_since - delay.since) * 1e-9 < keep_s:
        return Delay(d, received_at, 1, None, newest, newest_at, received_at), None
    kept = Delay(median_s, delay.since, n, off_since, newest, newest_at, received_at)
    return kept, Verdict.TOO_OLD if off_s > 0.0 else Verdict.TOO_NEW
