"""Contact with the deck as an event: an upward push that no rotor gives. Height never makes one.

A deck that is met at v m/s takes away v m/s of velocity within some hundredths of a second; rotors need tenths. So the specific
force upward beyond its own recent mean is summed over short times, and the sum is the velocity that something took away.
Blind on the deck a filter's height drifts, and a drone that believed it would fly again: that is why height has no say here.
"""

import math

from msgspec import Struct
from msgspec.structs import replace

from companion.guidance.controller import Impact
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs, seconds_between

MEAN_S = 0.15
"""Time constant of the mean that stands for flight without contact, s."""
LEAST_M_S2 = 3.0
"""Push beyond the mean that counts, m/s^2; gusts and commanded climbs stay below."""
LEAST_M_S = 0.1
"""Velocity that the push must have taken away, m/s."""
WITHIN_S = 0.08
"""Longest time over which one push is summed, s."""
QUIET_S = 0.3
"""Time after a contact in which its own rebounds make no further event, s."""


class ContactWatch(Struct, frozen=True):
    """The detector's memory."""

    at: MonoNs | None = None
    mean_m_s2: float = 0.0
    """Mean of the upward specific force, m/s^2."""
    since: MonoNs | None = None
    """Start of the push under way."""
    taken_m_s: float = 0.0
    """Velocity that it has taken away so far, m/s."""
    peak_m_s2: float = 0.0
    newest: Impact | None = None


def watched(watch: ContactWatch, imu: Imu) -> ContactWatch:
    """Return the memory after one IMU sample; `newest` is the newest contact."""
    now, up, before = imu.stamp.measured_at, -imu.f_body.item(2), watch.at
    dt = 0.0 if before is None else seconds_between(before, now)
    if not 0.0 < dt <= MEAN_S:
        return ContactWatch(now, up, newest=watch.newest)
    push = up - watch.mean_m_s2
    if push <= LEAST_M_S2:
        mean = watch.mean_m_s2 + (1.0 - math.exp(-dt / MEAN_S)) * push
        return ContactWatch(now, mean, newest=watch.newest)
    # The mean waits while something pushes: it stands for flight.
    since = now if watch.since is None else watch.since
    if seconds_between(since, now) > WITHIN_S:
        # A push that lasts is no contact: the weight or the sensor changed.
        return ContactWatch(now, up, newest=watch.newest)
    watch = replace(watch, at=now, since=since, taken_m_s=watch.taken_m_s + push * dt, peak_m_s2=max(watch.peak_m_s2, push))
    quiet = watch.newest is None or seconds_between(watch.newest.at, now) > QUIET_S
    if watch.taken_m_s >= LEAST_M_S and quiet:
        return replace(watch, newest=Impact(now, "accelerometer", watch.peak_m_s2))
    return watch
