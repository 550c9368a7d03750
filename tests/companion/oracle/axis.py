"""One horizontal axis of `follow_deck`: what is observed, what is under way, and the tilt to command. Floats only, for speed."""

from __future__ import annotations

import math

from msgspec import Struct

from companion.guidance.disturbance import ObserverGains
from companion.guidance.tilt_law import TiltGains
from companion.settings.response import TiltResponse
from tests.companion.oracle import observer
from tests.companion.oracle.observer import Observed

_DISTURBANCE_MAX_M_S2 = 4.0
_GYRO_SHARE = 0.25
"""Weight of the gyro against the model in the rate of the tilt."""


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
    """What is measured on one axis in one cycle."""

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


def begun(z: AxisMeasured, n: int, before: TiltAxis | None = None) -> TiltAxis:
    """Return the memory at the first cycle, or after a silence: what was learned of the wind is kept.

    Args:
        n: number of commands to remember.
    """
    d, b = (0.0, 0.0) if before is None else (before.seen.d, before.seen.b)
    return TiltAxis(Observed(z.p, z.w, d, b), z.lean, 0.0, z.lean, (z.lean,) * n)


def observed(axis: TiltAxis, z: AxisMeasured, dt: float, gains: ObserverGains, tilt: TiltResponse, arrived: float) -> TiltAxis:
    """Return the memory after `dt` s with this cycle's measurement.

    Args:
        arrived: the commanded tilt that acts on the vehicle now, m/s^2.
    """
    seen = observer.observed(axis.seen, gains, dt, z.a_deck, 0.5 * (z.lean + axis.lean), z.p, z.w, z.a_body)
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


def reference(axis: TiltAxis, a_deck: float) -> float:
    """Return the tilt that keeps the body over the deck, m/s^2: its acceleration less the disturbance."""
    return a_deck - axis.seen.d


def command(axis: TiltAxis, gains: TiltGains, off_m: float, a_deck: float, a_deck_then: float) -> float:
    """Return the tilt to command, m/s^2, not limited yet.

    Args:
        off_m: the pad's place less the wanted one, m.
        a_deck, a_deck_then: acceleration of the deck now and when the command has taken effect.
    """
    now, then = reference(axis, a_deck), reference(axis, a_deck_then)
    under_way = axis.under_way[: len(gains.under_way)]
    return tilt_command(gains, off_m, axis.seen.w, axis.lean, axis.rate, axis.lag, under_way, now, then)


def tilt_command(
    gains: TiltGains, p: float, w: float, a: float, rate: float, lag: float, under_way: tuple[float, ...], now: float, then: float
) -> float:
    """Return the tilt to command on one axis, as an acceleration.

    Args:
        p: the pad's place less the wanted one, m.
        w: speed of the pad against the body, m/s.
        a, rate: reported tilt, m/s^2, and its rate, m/s^3.
        lag: the rotors' state, m/s^2.
        under_way: commands that have not arrived, newest first, m/s^2; as many as there are gains.
        now: tilt that holds the body over the deck now, m/s^2.
        then: the same when this command has taken effect.
    """
    off = gains.p * p + gains.w * w + gains.a * (a - now) + gains.rate * rate + gains.lag * (lag - now)
    for k, u in zip(gains.under_way, under_way, strict=True):
        off += k * (u - now)
    return then - off
