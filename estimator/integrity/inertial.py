"""Judge gyro and accelerometer apart, name the one that lies, and let the estimator fly on without it.

A half that repeats itself is lost at once and back at once. One that moves and lies is found by parity (`parity.py`) and has to
agree for two seconds before it counts again. What the estimator believed with it is worth nothing: it starts again.
"""

import math
from itertools import pairwise
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.motion import G_M_S2
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu
from estimator.integrity import halves, parity
from estimator.integrity.halves import Half, TurnByAttitude
from estimator.integrity.options import IntegrityOptions
from estimator.integrity.parity import Bin, Parity, Slope, Vec3

_PERSISTS, _PERSISTS_ALONE = 3, 12
"""Number of bins in a row that accuse, before a sensor is named; of a sole witness, which stands on the moving deck."""
_WELL = 20
_GYRO_RAD_S, _GYRO_YAW_RAD_S = math.radians(3.0), math.radians(5.0)
"""Least steady difference of gyro and attitude: more than any gyro's bias, and than attitudes err by within the window."""
_GYRO_BINS = (10, 20)
_STEADY = 0.8
_ACCEL_M_S2, _ACCEL_ALONE_M_S2, _ACCEL_SIDE_M_S2 = 1.5, 2.4, 1.3
"""Least difference of the accelerometer: a filter takes less for its bias. A deck in a high sea accelerates by 2 m/s^2."""
_SIGMAS = 5.0
_GROUND_SIGMA_M_S2, _VELOCITY_SIGMA_M_S2 = 0.25, 0.2
"""What the residuals of a window do not show: a barometer in gusts, a velocity that lags."""
_INFLATED = 2.0
"""Residuals of neighbouring bins are alike."""
_SHARE = 0.4
_PLACE_S, _VELOCITY_S = 2.0, 1.2
_PLACES, _VELOCITIES = 14, 8


class Fault(Struct, frozen=True):
    """A sensor that the estimator does without."""

    sensor: Literal["accelerometer", "gyro"]
    what: str
    """What it does, in words."""
    well: int = 0
    """Number of bins in a row in which it agreed again."""

    @property
    def text(self) -> str:
        """Return the sentence for the operator."""
        return f"the {self.sensor} {self.what}; flying without it"


class Inertial(Struct, frozen=True):
    """The state of both halves of the IMU."""

    gyro: Half = Half()
    accel: Half = Half()
    turn: TurnByAttitude = TurnByAttitude()
    parity: Parity = Parity()
    gyro_fault: Fault | None = None
    """What parity says of it."""
    accel_fault: Fault | None = None
    accel_against: int = 0
    """Number of bins in a row that accused the accelerometer."""
    named: int = 0
    """How often parity has named a sensor."""

    @property
    def lost(self) -> tuple[str, ...]:
        """The sensors that the estimator does without, in words."""
        found = []
        for name, half, fault in (("accelerometer", self.accel, self.accel_fault), ("gyro", self.gyro, self.gyro_fault)):
            if half.frozen:
                found.append(f"the {name} repeats its readings; flying without it")
            elif fault is not None:
                found.append(fault.text)
        return tuple(found)


def felt(state: Inertial, imu: Imu, o: IntegrityOptions, flying: bool) -> tuple[Inertial, Imu | None]:
    """Process an IMU sample.

    Returns:
        The next state, and the sample without its lost halves; None if nothing is left of it.
    """
    t = imu.stamp.measured_at
    gyro = halves.read(state.gyro, imu.w_body.tobytes(), t, o.imu_frozen_s, flying)
    accel = halves.read(state.accel, imu.f_body.tobytes(), t, o.imu_frozen_s, flying)
    frozen = gyro.frozen or accel.frozen
    checked = parity.felt(state.parity, imu) if flying and not frozen else Parity()
    after = Inertial(gyro, accel, state.turn, checked, state.gyro_fault, state.accel_fault, state.accel_against, state.named)
    if not frozen and state.gyro_fault is None and state.accel_fault is None:
        return after, imu
    gyro_s = _lost_s(state.gyro, gyro, state.gyro_fault is not None)
    accel_s = _lost_s(state.accel, accel, state.accel_fault is not None)
    return after, halves.replaced(imu, gyro_s, accel_s, state.turn)


def levelled(state: Inertial, attitude: Attitude, flying: bool) -> Inertial:
    """Process an attitude as the vehicle reports it."""
    checked, ended = parity.levelled(state.parity, attitude)
    after = replace(state, turn=state.turn.after(attitude), parity=checked)
    return _judged(after) if ended and flying else after


def weighed(state: Inertial, event: Baro) -> Inertial:
    """Process a height."""
    return replace(state, parity=parity.weighed(state.parity, event))


def moved(state: Inertial, event: BodyVelocity) -> Inertial:
    """Process a velocity."""
    return replace(state, parity=parity.moved(state.parity, event))


def sighted(state: Inertial, t: int, d_fixed: Vec3, yaw_rad: float | None) -> Inertial:
    """Process a sighting that the estimator took, in axes of fixed heading."""
    return replace(state, parity=parity.sighted(state.parity, t, d_fixed, yaw_rad))


def _lost_s(before: Half, now: Half, named: bool) -> float:
    """Return the time up to the newest sample in which a half measured nothing, s; 0 if it measures."""
    if now.frozen:
        # What was used until it was found was wrong as well.
        return (now.last - (before.last if before.frozen else now.since)) * 1e-9
    return max(1e-6, min(0.05, (now.last - before.last) * 1e-9)) if named else 0.0


def _judged(state: Inertial) -> Inertial:
    """Judge both halves by the bins so far."""
    return _judged_accel(_judged_gyro(state))


def _judged_gyro(state: Inertial) -> Inertial:
    bins, fault = state.parity.bins, state.gyro_fault
    if fault is not None:
        off = [math.hypot(*b.off) for b in bins[-1:]]
        well = fault.well + 1 if off and off[0] < _GYRO_RAD_S else 0
        return replace(state, gyro_fault=None if well >= _WELL else replace(fault, well=well))
    for n in _GYRO_BINS:
        what = _gyro_lies(state.parity, bins[-n:]) if len(bins) >= n else ""
        if what:
            return replace(state, gyro_fault=Fault("gyro", what), named=state.named + 1)
    return state


def _gyro_lies(p: Parity, bins: tuple[Bin, ...]) -> str:
    """Return what the gyro does where it and not the attitude lies about a steady turn; empty if neither does, or it is open."""
    n, span_s = len(bins), math.fsum(b.span_s for b in bins)
    off = [math.fsum(b.off[i] for b in bins) / n for i in range(3)]
    steady = [sum(b.off[i] * off[i] > off[i] * off[i] / 3.0 for b in bins) >= _STEADY * n for i in range(3)]
    x, y = (off[i] if steady[i] else 0.0 for i in range(2))
    if math.hypot(x, y) > _GYRO_RAD_S:
        # The one that says that the body leans more and more lies: it would fly away.
        along, aside, _ = bins[-1].up
        by_gyro, by_attitude = math.hypot(along - y * span_s, aside + x * span_s), math.hypot(along, aside)
        if by_gyro > by_attitude + 0.5 * span_s * math.hypot(x, y):
            axis, value = ("roll", x) if abs(x) > abs(y) else ("pitch", y)
            return f"turns {abs(math.degrees(value)):.0f} deg/s too {'much' if value > 0 else 'little'} in {axis}"
    if steady[2] and abs(off[2]) > _GYRO_YAW_RAD_S:
        seen = _turn_seen(p, bins[0].t)
        gyro = math.fsum(b.rate_down for b in bins) / n
        if seen is not None and abs(seen - gyro) > 0.6 * abs(off[2]) and abs(seen - gyro + off[2]) < _SHARE * abs(off[2]):
            return f"turns {abs(math.degrees(off[2])):.0f} deg/s too {'much' if off[2] > 0 else 'little'} in yaw"
    return ""


def _turn_seen(p: Parity, since: int) -> float | None:
    """Return the rate of turn against the pad since an instant, rad/s; None where too little was seen."""
    taken = [(t, yaw) for t, yaw in p.yaw if t >= since]
    span_s = (taken[-1][0] - taken[0][0]) * 1e-9 if taken else 0.0
    if span_s < 0.5:
        return None
    return math.fsum(math.remainder(b[1] - a[1], math.tau) for a, b in pairwise(taken)) / span_s


def _judged_accel(state: Inertial) -> Inertial:
    p, fault = state.parity, state.accel_fault
    if not p.bins or state.gyro_fault is not None:
        return replace(state, accel_against=0) if state.accel_against else state
    if fault is not None:
        well = fault.well + 1 if _accel_agrees(p) else 0
        return replace(state, accel_fault=None if well >= _WELL else replace(fault, well=well))
    what, needed = _accel_lies(p)
    against = state.accel_against + 1 if what else 0
    if against < needed or not what:
        return state if against == state.accel_against else replace(state, accel_against=against)
    return replace(state, accel_against=0, accel_fault=Fault("accelerometer", what), named=state.named + 1)


def _witnesses(p: Parity) -> tuple[Slope | None, Slope | None]:
    """Return what a witness on the ground and one on the deck say of the vertical."""
    end = p.bins[-1].t + round(p.bins[-1].span_s * 1e9)
    since = end - round(_PLACE_S * 1e9)
    baro = _widened(parity.curvature(p.baro, 2, since, _PLACES), _GROUND_SIGMA_M_S2)
    flow = _widened(parity.slope(p.flow, 2, end - round(_VELOCITY_S * 1e9), _VELOCITIES), _VELOCITY_SIGMA_M_S2)
    ground = baro if flow is None or (baro is not None and baro.var < flow.var) else flow
    return ground, parity.curvature(p.sight, 2, since, _PLACES)


def _widened(found: Slope | None, sigma: float) -> Slope | None:
    return None if found is None else Slope(found.value, _INFLATED * found.var + sigma * sigma)


def _accel_lies(p: Parity) -> tuple[str, int]:
    """Return what the accelerometer does, empty if it is not accused; and how many bins in a row have to say so."""
    ground, deck = _witnesses(p)
    f, up = p.bins[-1].f, p.bins[-1].up
    if ground is not None:
        a = ground.value
        agrees = deck is None or (deck.value * a > 0.0 and abs(deck.value) > _SHARE * abs(a))
        if abs(a) > _ACCEL_M_S2 and a * a > _SIGMAS**2 * ground.var and agrees:
            return _along_down(f[2], a / max(0.5, up[2])), _PERSISTS
    elif deck is not None and abs(deck.value) > _ACCEL_ALONE_M_S2:
        return _along_down(f[2], deck.value / max(0.5, up[2])), _PERSISTS_ALONE
    return _accel_aside(p), _PERSISTS


def _accel_aside(p: Parity) -> str:
    """Return what the accelerometer does across the vertical, where velocity and sightings agree against it."""
    end = p.bins[-1].t + round(p.bins[-1].span_s * 1e9)
    off = [0.0, 0.0]
    for axis in range(2):
        flow = parity.slope(p.flow, axis, end - round(_VELOCITY_S * 1e9), _VELOCITIES)
        deck = parity.curvature(p.sight, axis, end - round(_PLACE_S * 1e9), _PLACES)
        if flow is None or deck is None:
            return ""
        if flow.value * deck.value > 0.0 and abs(flow.value - deck.value) < 0.6 * max(abs(flow.value), abs(deck.value)):
            off[axis] = 0.5 * (flow.value + deck.value)
    size = math.hypot(*off)
    f = p.bins[-1].f
    # A multirotor is pushed along its vertical axis alone. One that feels nothing across it is not the one that lies.
    if size < _ACCEL_SIDE_M_S2 or math.hypot(f[0], f[1]) < 0.6 * size:
        return ""
    return f"is off by {size:.1f} m/s^2 across the vertical"


def _along_down(f_down: float, off: float) -> str:
    """Return how far the accelerometer is off along the body's down axis; `off` is true less measured, m/s^2."""
    true = f_down + off
    if abs(true) < 0.5 * G_M_S2:
        return f"is off by {abs(off):.1f} m/s^2 along the vertical"
    percent = 100.0 * (f_down / true - 1.0)
    return f"reads {abs(percent):.0f} % too {'much' if percent > 0 else 'little'}"


def _accel_agrees(p: Parity) -> bool:
    ground, deck = _witnesses(p)
    if ground is None and deck is None:
        return False
    side = _accel_aside(p)
    deck_agrees = deck is None or abs(deck.value) < 0.7 * _ACCEL_ALONE_M_S2
    return not side and deck_agrees and (ground is None or abs(ground.value) < 0.6 * _ACCEL_M_S2)
