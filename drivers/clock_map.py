"""Map a remote clock to this host's clock: a minimum-delay filter with a drift allowance.

A message stamped `remote` by its sender and received here at `received_at` gives `received_at - remote = offset + delay`. Delays
are never negative and sometimes hardly more than their floor, so the least difference of the last seconds is the offset plus the
floor. The two crystals drift against each other, so an old least difference is allowed to have grown by `drift_ppm` since.

Source: Mills, RFC 5905 section 10 (clock filter by minimum delay); Moon, Skelly and Towsley, Estimation and removal of clock skew
from network delay measurements, INFOCOM 1999 (the lower envelope).
"""

import math
from collections import deque
from dataclasses import dataclass

from estimator.contracts.time import NS_PER_S, MonoNs, Stamp

_SIGMA_MAX_S = 0.999
_MEMORY = 200
"""The number of messages over which the usual delay above the floor is averaged."""
_FADE = 0.95
"""The factor by which the memory of the map's recent moves decays with each message."""
_PRIOR = 5
"""The number of messages whose weight `unknown_s` has."""


@dataclass(frozen=True, slots=True)
class ClockMapOptions:
    """The known properties of the remote clock and of the path from it.

    Raises:
        ValueError: a number is out of range.
    """

    wrap_ns: int | None = None
    """The period after which the remote counter wraps, ns; None if it never wraps."""
    resolution_s: float = 0.0
    """The least step of the remote counter."""
    floor_s: float = 0.0
    """The least possible delay from the stamped instant to the message's arrival; it cannot be measured from this side."""
    floor_sigma_s: float = 0.001
    """The standard deviation of the floor."""
    window_s: float = 10.0
    """The time for which a least difference counts; a floor that has grown is accepted after this."""
    drift_ppm: int = 100
    """The largest drift between the two clocks; two ordinary crystals stay within this."""
    jump_s: float = 0.5
    """A remote clock that steps back further than this, or ahead of the map by more, counts as reset."""
    unknown_s: float = 0.02
    """The delay above the floor that is assumed before any was measured."""

    def __post_init__(self) -> None:
        for name in ("resolution_s", "floor_s", "floor_sigma_s", "window_s", "drift_ppm", "jump_s", "unknown_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or more, got {value!r}")
        if self.wrap_ns is not None and self.wrap_ns <= 4 * self.jump_s * NS_PER_S:
            raise ValueError(f"wrap_ns must be well above jump_s, got {self.wrap_ns!r}")


class ClockMap:
    """Maps the stamp of each message, given in the order received, to an instant of this host's clock.

    The instants never lie after `received_at`, and never run backwards while the remote counter does not: a new least difference
    puts its own message the floor before now, later than any instant so far, and without one the map only moves forward. The
    sigma covers the uncertainty of the floor, the counter's step, the drift since the least difference, the uncertainty from few
    messages, and that of a map that moves.
    """

    def __init__(self, options: ClockMapOptions) -> None:
        self._o = options
        self._least: deque[tuple[int, int]] = deque()
        """Pairs (received_at, difference less the drift allowed until then), ascending in both: the front holds the least."""
        self._newest_remote: int | None = None
        self._received_at = 0
        self._count = 0
        self._excess_s = options.unknown_s
        self._fell_s = 0.0
        self.restarts = 0
        """The number of times that the remote clock was reset."""

    def reset(self) -> None:
        """Forget the remote clock, because the sender is known to have restarted."""
        self._least.clear()
        self._newest_remote = None
        self._count = 0
        self._excess_s = self._o.unknown_s
        self._fell_s = 0.0

    def stamp(self, remote_ns: int, received_at: MonoNs) -> Stamp:
        """Return the instant of `remote_ns` on this host's clock. Never raises on any remote value.

        A `received_at` before that of the last message counts as equal to it.
        """
        now = self._received_at = max(received_at, self._received_at)
        remote = self._unwrapped(remote_ns, now)
        if self._newest_remote is not None and self._reset_if_restarted(remote, now):
            self.restarts += 1
            self.reset()
        difference = now - remote
        before = self._offset(now) if self._least else difference
        self._enter(difference, now)
        offset = self._offset(now)
        self._fell_s = _FADE * self._fell_s + abs(before - offset) / NS_PER_S
        self._count = min(self._count + 1, _MEMORY)
        self._excess_s += ((difference - offset) / NS_PER_S - self._excess_s) / (self._count + _PRIOR)
        measured_at = remote + offset - round(self._o.floor_s * NS_PER_S)
        self._newest_remote = remote if self._newest_remote is None else max(remote, self._newest_remote)
        sigma_s = math.hypot(
            self._o.floor_sigma_s,
            self._o.resolution_s / math.sqrt(12.0),
            self._o.drift_ppm * 1e-6 * (now - self._least[0][0]) / NS_PER_S,
            # The least of n independent delays is off by 1/n of their mean, but neighbouring delays are alike.
            self._excess_s / math.sqrt(self._count),
            # A map that has moved lately may move as far again: the messages so far were all late.
            self._fell_s,
        )
        return Stamp(MonoNs(measured_at), MonoNs(now), min(sigma_s, _SIGMA_MAX_S), "synced")

    def _unwrapped(self, remote_ns: int, now: int) -> int:
        """Return the counter without its wraps: the value nearest to the one expected from the time since the last message."""
        wrap = self._o.wrap_ns
        if wrap is None or self._newest_remote is None:
            return remote_ns
        expected = self._newest_remote + now - self._newest_received()
        return expected + (remote_ns - expected + wrap // 2) % wrap - wrap // 2

    def _newest_received(self) -> int:
        return self._least[-1][0]

    def _reset_if_restarted(self, remote: int, now: int) -> bool:
        jump = round(self._o.jump_s * NS_PER_S)
        assert self._newest_remote is not None
        return remote < self._newest_remote - jump or now - remote < self._offset(now) - jump

    def _allowed(self, now: int) -> int:
        return now * self._o.drift_ppm // 1_000_000

    def _enter(self, difference: int, now: int) -> None:
        level = difference - self._allowed(now)
        while self._least and self._least[-1][1] >= level:
            self._least.pop()
        self._least.append((now, level))
        while now - self._least[0][0] > self._o.window_s * NS_PER_S:
            self._least.popleft()

    def _offset(self, now: int) -> int:
        return self._least[0][1] + self._allowed(now)
