"""One horizontal axis of `follow_deck` in plain Python: what it observes, what is under way, and the tilt that it commands."""

import math

from msgspec import Struct

from companion.guidance.law.gains import ObserverGains, TiltGains
from companion.settings.response import TiltResponse

_DISTURBANCE_MAX_M_S2 = 4.0
_GYRO_SHARE = 0.25
"""Weight of the gyro against the model in the rate of the tilt."""


class Observed(Struct, frozen=True):
    """The state of one axis."""

    p: float
    w: float
    d: float
    b: float


def _pushed(
    x: Observed, gains: ObserverGains, dt: float, a_deck: float, a_lean: float, p: float, w: float, a_body: float | None
) -> Observed:
    """Return the state of one axis after `dt` s.

    Args:
        a_deck: acceleration of the deck, m/s^2.
        a_lean: reported tilt as an acceleration, mean over the step.
        p, w: place and speed of the pad against the body by the filter, m and m/s.
        a_body: levelled acceleration of the body; None if it is not known now.
    """
    push = a_deck - a_lean - x.d
    p1, w1 = x.p + dt * x.w + 0.5 * dt * dt * push, x.w + dt * push
    ep, ew = p - p1, w - w1
    ea = 0.0 if a_body is None else a_body - a_lean - x.d - x.b
    (pp, pw, pa), (wp, ww, wa), (dp, dw, da), (bp, bw, ba) = gains.rows
    return Observed(
        p1 + pp * ep + pw * ew + pa * ea,
        w1 + wp * ep + ww * ew + wa * ea,
        x.d + dp * ep + dw * ew + da * ea,
        x.b + bp * ep + bw * ew + ba * ea,
    )


class TiltAxis(Struct, frozen=True):
    """The memory of one axis."""

    seen: Observed
    lean: float
    """Reported tilt, m/s^2."""
    rate: float
    """Its rate, m/s^3."""
    lag: float
    """The rotors' state, m/s^2."""
    under_way: tuple[float, ...]
    """Commanded tilt, newest first, m/s^2."""


class AxisMeasured(Struct, frozen=True):
    """Measurements of one axis in one cycle."""

    p: float
    """The pad against the body by the filter, m."""
    w: float
    """Its rate, m/s."""
    lean: float
    """Reported tilt, m/s^2."""
    rate: float
    """Its rate by the gyro, m/s^3."""
    a_body: float
    """Levelled acceleration of the body, m/s^2."""
    a_deck: float = 0.0
    """Acceleration of the deck, m/s^2."""


def begun(z: AxisMeasured, n: int) -> TiltAxis:
    """Return the memory at the first cycle, with room for this many commands."""
    return TiltAxis(Observed(z.p, z.w, 0.0, 0.0), z.lean, 0.0, z.lean, (z.lean,) * n)


def observed(axis: TiltAxis, z: AxisMeasured, dt: float, gains: ObserverGains, tilt: TiltResponse, arrived: float) -> TiltAxis:
    """Return the memory after `dt` s with this cycle's measurement.

    Args:
        arrived: the commanded tilt that acts on the vehicle now, m/s^2.
    """
    seen = _pushed(axis.seen, gains, dt, z.a_deck, 0.5 * (z.lean + axis.lean), z.p, z.w, z.a_body)
    d = min(_DISTURBANCE_MAX_M_S2, max(-_DISTURBANCE_MAX_M_S2, seen.d))
    keep = math.exp(-dt / tilt.lag_s) if tilt.lag_s > 1e-4 else 0.0
    lag = keep * axis.lag + (1.0 - keep) * arrived
    w = tilt.frequency_rad_s
    rate = axis.rate + dt * (w * w * (axis.lag - axis.lean) - 2.0 * tilt.damping * w * axis.rate)
    rate += _GYRO_SHARE * (z.rate - rate)
    return TiltAxis(Observed(seen.p, seen.w, d, seen.b), z.lean, rate, lag, axis.under_way)


def commanded(axis: TiltAxis, u: float) -> TiltAxis:
    """Return the memory with another command under way."""
    return TiltAxis(axis.seen, axis.lean, axis.rate, axis.lag, (u, *axis.under_way[:-1]))


def tilt_command(axis: TiltAxis, gains: TiltGains, off_m: float) -> float:
    """Return the tilt to command over a deck that does not accelerate, m/s^2, not limited yet.

    Args:
        off_m: the pad's place less the wanted one.
    """
    held = -axis.seen.d
    off = gains.p * off_m + gains.w * axis.seen.w + gains.a * (axis.lean - held) + gains.rate * axis.rate
    off += gains.lag * (axis.lag - held)
    for k, u in zip(gains.under_way, axis.under_way, strict=False):
        off += k * (u - held)
    return held - off
