"""The drone's own clock: it starts when the drone boots and its crystal runs a little off ours."""

from __future__ import annotations

from dataclasses import dataclass

from estimator.contracts.time import MonoNs


@dataclass(frozen=True, slots=True)
class DroneClock:
    """Maps this host's clock to the drone's."""

    boot: MonoNs
    """Instant at which the drone's clock was zero."""
    drift_ppm: float = 0.0
    """Rate by which the drone's clock is fast, microseconds per second."""

    def microseconds(self, at: MonoNs) -> int:
        """What the drone has counted since it booted."""
        elapsed = at - self.boot
        return (elapsed + round(elapsed * self.drift_ppm * 1e-6)) // 1000

    def milliseconds(self, at: MonoNs) -> int:
        """Return the time as PaVE headers and the vision option carry it: whole milliseconds in 32 bits, which wrap."""
        return self.microseconds(at) // 1000 % 2**32
