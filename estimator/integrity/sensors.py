"""Check readings of the vehicle's sensors for impossible values, impossible steps, and bit-identical repetition."""

from __future__ import annotations

import math
from typing import NamedTuple

from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range, VesselReport
from estimator.integrity.options import IntegrityOptions

Reading = Imu | Attitude | BodyVelocity | Range | Baro | VesselReport

_STEP_OVER_S = 0.1
"""Longest time over which a step's limit grows. Without this bound, any spike would pass after a long pause."""
_UNMEASURED_VAR = 1e3
"""Variance above which a velocity component was not measured."""


class Repeat(NamedTuple):
    """The newest reading, for the bitwise comparison."""

    value: bytes | float
    since: int
    """Instant when it was first read, ns."""


class Plausible(NamedTuple):
    """The newest reading that passed."""

    numbers: tuple[float, ...]
    """The numbers that `_step` compares; none if no step of this kind of reading is too large."""
    at: int
    """Instant of the measurement, ns."""


class SensorWatch(NamedTuple):
    """The state of one stream of readings."""

    repeat: Repeat | None = None
    frozen: bool = False
    """True if the newest reading was refused as a repetition."""
    plausible: Plausible | None = None
    refused_since: int | None = None
    """Instant of the first of an unbroken series of refused steps, ns."""


def watch(state: SensorWatch, event: Reading, o: IntegrityOptions, flying: bool) -> tuple[SensorWatch, Verdict | None]:
    """Check one reading.

    Returns:
        The new state, and IMPOSSIBLE, FROZEN, or None. FROZEN applies in flight only; on the ground a velocity stays zero.
    """
    t = event.stamp.measured_at
    value, frozen_s = _bits(event, o)
    repeat = Repeat(value, t)
    if state.repeat is not None and state.repeat.value == value:
        repeat = Repeat(value, min(state.repeat.since, t))
    before, refused_since = state.plausible, state.refused_since
    if _beyond(event, o):
        return SensorWatch(repeat, False, before, refused_since), Verdict.IMPOSSIBLE
    if flying and (t - repeat.since) * 1e-9 > frozen_s:
        return SensorWatch(repeat, True, before, refused_since), Verdict.FROZEN
    numbers = _numbers(event)
    if before is not None and t > before.at and numbers and _step(event, numbers, before, o):
        since = t if refused_since is None else refused_since
        if (t - since) * 1e-9 < o.spike_s:
            return SensorWatch(repeat, False, before, since), Verdict.IMPOSSIBLE
    return SensorWatch(repeat, False, Plausible(numbers, t), None), None


def _bits(event: Reading, o: IntegrityOptions) -> tuple[bytes | float, float]:
    """Return the value that must change, and the longest time without a change; infinity if it need not."""
    match event:
        case Imu():
            return event.w_body.tobytes() + event.f_body.tobytes(), o.imu_frozen_s
        case Attitude():
            return event.R_ned_body.matrix.tobytes(), o.attitude_frozen_s
        case BodyVelocity():
            return event.v_level.tobytes(), o.velocity_frozen_s
        case Range():
            return event.range_m, o.range_frozen_s
        case Baro():
            return event.height_m, o.baro_frozen_s
        case VesselReport():
            return b"", math.inf


def _beyond(event: Reading, o: IntegrityOptions) -> bool:
    match event:
        case Imu():
            f, w = _size(event.f_body.tolist()), _size(event.w_body.tolist())
            return f > o.specific_force_max_m_s2 or w > o.turn_rate_max_rad_s
        case BodyVelocity():
            return _size(_numbers(event)) > o.speed_max_m_s
        case VesselReport():
            return event.v_vessel_ned is not None and _size(event.v_vessel_ned.tolist()) > o.speed_max_m_s
        case _:
            return False


def _numbers(event: Reading) -> tuple[float, ...]:
    match event:
        case BodyVelocity():
            var = event.cov_level.diagonal().tolist()
            return tuple([v if of < _UNMEASURED_VAR else 0.0 for v, of in zip(event.v_level.tolist(), var, strict=True)])
        case Attitude():
            return tuple(event.R_ned_body.matrix[2].tolist())
        case Baro():
            return (event.height_m,)
        case _:
            return ()


def _step(event: Reading, numbers: tuple[float, ...], before: Plausible, o: IntegrityOptions) -> bool:
    """Return whether the step since the last plausible reading is more than the vehicle can do."""
    dt = min((event.stamp.measured_at - before.at) * 1e-9, _STEP_OVER_S)
    step = math.dist(numbers, before.numbers)
    match event:
        case BodyVelocity():
            return step > o.velocity_step_m_s + o.acceleration_max_m_s2 * dt
        case Attitude():
            return 2.0 * math.asin(min(1.0, 0.5 * step)) > o.tilt_step_rad + o.tilt_rate_max_rad_s * dt
        case _:
            return step > o.height_step_m + o.height_rate_max_m_s * dt


def _size(v: list[float] | tuple[float, ...]) -> float:
    return math.hypot(*v)
