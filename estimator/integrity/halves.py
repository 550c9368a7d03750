"""Tell a frozen half of an IMU, gyro or accelerometer, and put what else is known in its place."""

import math

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.geometry import F64, fixed_vector
from estimator.contracts.samples import Attitude, Imu

_LONGEST = 3.0
"""Factor on the time limit for a sensor of coarse steps that repeated itself in flight."""
_MOST_S = 1.0
_TURN_S = 0.02
"""Least time between the two attitudes whose difference is a rate."""
_OLD_S = 0.1
"""Age of an attitude from which it says nothing of the present turn."""


class Half(Struct, frozen=True):
    """Repetition of one half of a sample: unchanged values."""

    since: int = -1
    """Instant at which the value was first read that it repeats, ns; -1 while it changes."""
    longest_s: float = 0.0
    """The longest time for which it has repeated itself in flight and then gone on."""
    frozen: bool = False


def read(half: Half, before: int | None, t: int, frozen_s: float, flying: bool) -> Half:
    """Process one reading.

    Args:
        before: instant of the reading before, ns, if this one is the same to the bit; None if it differs.
        t: instant of this one, ns.
    """
    since, longest_s = half.since, half.longest_s
    if before is None:
        if since < 0:
            return half
        return half if t < since else Half(-1, longest_s if half.frozen or not flying else max(longest_s, (t - since) * 1e-9))
    since = before if since < 0 else since
    after_s = max(frozen_s, min(_LONGEST * longest_s, _MOST_S))
    return Half(since, longest_s, flying and (t - since) * 1e-9 > after_s)


class TurnByAttitude(Struct, frozen=True):
    """The two newest attitudes that are at least `_TURN_S` apart."""

    before: Attitude | None = None
    now: Attitude | None = None

    def after(self, attitude: Attitude) -> "TurnByAttitude":
        """Return it with one attitude more."""
        now = self.now
        if now is not None and attitude.stamp.measured_at - now.stamp.measured_at < _TURN_S * 1e9:
            return self
        return TurnByAttitude(now, attitude)

    def rate(self, at: int) -> F64 | None:
        """Return the body's rate, rad/s, about an instant, ns; None if the attitudes do not say."""
        a, b = self.before, self.now
        if a is None or b is None:
            return None
        dt = (b.stamp.measured_at - a.stamp.measured_at) * 1e-9
        if not 0.0 < dt <= 2.0 * _OLD_S or abs(at - b.stamp.measured_at) > _OLD_S * 1e9:
            return None
        return fixed_vector(*(x / dt for x in turn_between(a, b)))


def turn_between(a: Attitude, b: Attitude) -> tuple[float, float, float]:
    """Return the rotation vector, rad in `body`, that takes one attitude to another less than half a turn away."""
    (a0, a1, a2), (a3, a4, a5), (a6, a7, a8) = a.R_ned_body.matrix.tolist()
    (b0, b1, b2), (b3, b4, b5), (b6, b7, b8) = b.R_ned_body.matrix.tolist()
    x = (a2 * b1 + a5 * b4 + a8 * b7) - (a1 * b2 + a4 * b5 + a7 * b8)
    y = (a0 * b2 + a3 * b5 + a6 * b8) - (a2 * b0 + a5 * b3 + a8 * b6)
    z = (a1 * b0 + a4 * b3 + a7 * b6) - (a0 * b1 + a3 * b4 + a6 * b7)
    twice_sine = math.sqrt(x * x + y * y + z * z)
    trace = a0 * b0 + a3 * b3 + a6 * b6 + a1 * b1 + a4 * b4 + a7 * b7 + a2 * b2 + a5 * b5 + a8 * b8
    k = 0.5 if twice_sine < 1e-9 else math.atan2(twice_sine, trace - 1.0) / twice_sine
    return k * x, k * y, k * z


def replaced(imu: Imu, gyro_lost_s: float, accel_lost_s: float, turn: TurnByAttitude) -> Imu | None:
    """Return a sample without its lost halves; None if nothing else says how the body turns.

    Args:
        gyro_lost_s: time up to this sample in which the gyro was lost; 0 if it measures.
        accel_lost_s: the same for the accelerometer.
    """
    w = imu.w_body
    if gyro_lost_s > 0.0:
        rate = turn.rate(imu.stamp.measured_at)
        if rate is None:
            return None
        w = rate
    return replace(imu, w_body=w, gyro_lost_s=gyro_lost_s, accel_lost_s=accel_lost_s)
