"""Map an autopilot's times since boot to this host's monotonic clock."""

import math
from typing import NewType

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.mavlink.timesync import TimeSync
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp

BootNs = NewType("BootNs", int)
"""Nanoseconds since the autopilot booted."""
MS_WRAP_NS = 2**32 * 1_000_000
"""Period of a time since boot in milliseconds, u32."""
_STEP_SIGMA_S = 0.001 / math.sqrt(12.0)
"""The standard deviation that the stamps' millisecond adds."""
_LATE_MAX_S = 2.0
"""A message that is older than this by TIMESYNC was not stamped by the clock that TIMESYNC measures."""


def boot_ms(time_boot_ms: int) -> BootNs:
    """Convert a 32-bit millisecond stamp; its fraction was cut off, so the result is the middle of the millisecond."""
    return BootNs(time_boot_ms * 1_000_000 + 500_000)


def boot_us(time_usec: int) -> BootNs:
    """Convert a 64-bit microsecond stamp."""
    return BootNs(time_usec * 1_000)


class BootClock:
    """Stamps messages. It must be given every stamped message in the order received."""

    def __init__(self, sync: TimeSync) -> None:
        self._sync = sync
        known = ClockMapOptions(
            MS_WRAP_NS, resolution_s=0.001, floor_s=0.001, floor_sigma_s=0.002, doubted=True, name="the autopilot"
        )
        self._map = ClockMap(known)
        self._newest: int | None = None
        self.restarts = 0
        """Times the autopilot was seen to have booted."""

    def stamp(self, boot: BootNs, received_at: MonoNs) -> Stamp:
        """Return the instant of `boot` on our clock; it is never later than `received_at`."""
        if self._newest is not None and boot < self._newest - NS_PER_S and self._newest - boot < MS_WRAP_NS // 2:
            self.restarts += 1
            self._newest = None
            self._map.reset()
            self._sync.reset()
        self._newest = boot if self._newest is None else max(boot, self._newest)
        self._map.note(boot, received_at)
        found = self._sync.offset_ns(received_at)
        if found is None:
            return self._map.newest
        offset, sigma_s = found
        expected = received_at + offset
        unwrapped = expected + (boot - expected + MS_WRAP_NS // 2) % MS_WRAP_NS - MS_WRAP_NS // 2
        measured_at = unwrapped - offset
        if not -0.02 * NS_PER_S <= received_at - measured_at <= _LATE_MAX_S * NS_PER_S:
            return self._map.newest
        return Stamp(MonoNs(min(measured_at, received_at)), received_at, math.hypot(sigma_s, _STEP_SIGMA_S), "synced")
