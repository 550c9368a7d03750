"""Hold the heading by the gyro while the vehicle reports one that turns otherwise: a compass beside steel, or one that drifts.

Relative to a pad only the turns of the body count, not where north is. The reported heading less what the gyro has turned is
followed at no more than a gyro's bias may amount to. Where the report is further from that than the tolerance, it is replaced;
in between it passes unchanged. A report that goes on from another heading is so taken over slowly, and no frame sees a jump.
"""

import math

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Imu
from estimator.integrity.options import IntegrityOptions

_GAP_S = 0.1
"""Time without an accepted gyro sample after which nothing says how the body turned, s."""
_CHANGED_RAD, _CHANGES = math.radians(1.0), 8
"""Least change of a correction that is kept, and the number of changes that are."""
_APART = 0.25
"""Share of the slip with which a report beyond the tolerance is followed: it is not the gyro's bias that took it there."""


class HeadingWatch(Struct, frozen=True):
    """The body's turn by the gyro, and the reported heading's offset from it."""

    turned_rad: float = 0.0
    """Turn about the vertical since the watch began."""
    turned_at: int = -1
    """Instant of the newest gyro sample, ns; -1 before the first."""
    rate_rad_s: float = 0.0
    down: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """The vertical in body axes, by the newest attitude."""
    held_rad: float | None = None
    """Reported heading less the turn, followed slowly; None while it is not known."""
    held_at: int = -1
    off_rad: float = 0.0
    """Correction of the newest reported heading, rad."""
    offs: tuple[tuple[int, float], ...] = ()
    """Instants, ns, from which corrections held, and these, rad: one for each change."""

    def off_at(self, t: int) -> float:
        """Return the correction of the heading that was reported at an instant, ns."""
        return next((off for since, off in reversed(self.offs) if since <= t), 0.0)

    def _changed(self, t: int, off_rad: float) -> tuple[tuple[int, float], ...]:
        """Return the corrections with a newest one."""
        newest = self.offs[-1][1] if self.offs else 0.0
        return self.offs if abs(off_rad - newest) <= _CHANGED_RAD else (*self.offs[1 - _CHANGES :], (t, off_rad))


def turned(watch: HeadingWatch, imu: Imu) -> HeadingWatch:
    """Add one gyro sample."""
    t, (p, q, r), (x, y, z) = imu.stamp.measured_at, imu.w_body.tolist(), watch.down
    rate = x * p + y * q + z * r
    dt = (t - watch.turned_at) * 1e-9
    if watch.turned_at < 0 or dt > _GAP_S:
        return replace(watch, turned_at=t, rate_rad_s=rate, held_rad=None)
    if dt <= 0.0:
        return watch
    turn = watch.turned_rad + 0.5 * (rate + watch.rate_rad_s) * dt
    return HeadingWatch(turn, t, rate, watch.down, watch.held_rad, watch.held_at, watch.off_rad, watch.offs)


def steadied(watch: HeadingWatch, event: Attitude, o: IntegrityOptions) -> tuple[HeadingWatch, Attitude]:
    """Return the attitude with the heading that the gyro holds, where the reported one is further off than the tolerance."""
    t, m = event.stamp.measured_at, event.R_ned_body.matrix
    (c, _, _), (s, _, _), (x, y, z) = m.tolist()
    since_s = (t - watch.turned_at) * 1e-9
    if watch.turned_at < 0 or abs(since_s) > _GAP_S:
        return replace(watch, down=(x, y, z), held_rad=None, off_rad=0.0), event
    offset = math.atan2(s, c) - watch.turned_rad - watch.rate_rad_s * since_s
    if watch.held_rad is None:
        return replace(watch, down=(x, y, z), held_rad=wrap_pi(offset), held_at=t, off_rad=0.0), event
    off = wrap_pi(offset - watch.held_rad)
    slip = 1.0 if abs(off) <= math.radians(o.heading_tolerance_deg) else _APART
    most = slip * math.radians(o.heading_slip_deg_s) * max(0.0, (t - watch.held_at) * 1e-9)
    step = min(most, max(-most, off))
    off -= step
    held = wrap_pi(watch.held_rad + step)
    if abs(off) <= math.radians(o.heading_tolerance_deg):
        offs = watch._changed(t, 0.0)
        return HeadingWatch(watch.turned_rad, watch.turned_at, watch.rate_rad_s, (x, y, z), held, t, 0.0, offs), event
    # Turning about the vertical leaves roll and pitch, and the last row, as they are.
    R = Rotation.from_rpy(0.0, 0.0, -off) @ event.R_ned_body
    offs = watch._changed(t, off)
    return replace(watch, down=(x, y, z), held_rad=held, held_at=t, off_rad=off, offs=offs), replace(event, R_ned_body=R)
