"""A remote clock on ours: minimum-delay filter with drift allowance.

A message stamped `remote` by its sender and heard here at `heard` gives `heard - remote = offset + delay`. Delays are never
negative and now and then hardly more than their floor, so the least difference of the last seconds is the offset plus the floor.
The two crystals drift against each other, so an old least difference is allowed to have grown by `drift_ppm` since.

Source: Mills, RFC 5905 section 10 (clock filter by minimum delay); Moon, Skelly and Towsley, Estimation and removal of clock skew
from network delay measurements, INFOCOM 1999 (the lower envelope).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from estimator.contracts.time import NS_PER_S, MonoNs, Stamp

_SIGMA_MAX_S = 0.999
_MEMORY = 200
"""Messages over which the usual delay above the floor is averaged."""
_FADE = 0.95
"""Of the map's recent moves, per message."""
_PRIOR = 5
"""Messages that `unknown_s` weighs as much as."""


@dataclass(frozen=True, slots=True)
class ClockMapOptions:
    """What is known of the remote clock and the way from it.

    Raises:
        ValueError: a number out of range.
    """

    wrap_ns: int | None = None
    """The remote counter begins again after this much; None for never."""
    resolution_s: float = 0.0
    """Least step of the remote counter."""
    floor_s: float = 0.0
    """The least possible delay from the stamped instant to hearing of it; it cannot be seen from here."""
    floor_sigma_s: float = 0.001
    """How well the floor is known."""
    window_s: float = 10.0
    """How long a least difference counts; a path whose floor has grown is believed after this."""
    drift_ppm: int = 100
    """Most the two clocks run apart; two ordinary crystals stay within this."""
    jump_s: float = 0.5
    """A remote clock that steps back further than this, or ahead of the map by more, was set anew."""
    unknown_s: float = 0.02
    """Delay above the floor to reckon with before any was seen."""

    def __post_init__(self) -> None:
        for name in ("resolution_s", "floor_s", "floor_sigma_s", "window_s", "drift_ppm", "jump_s", "unknown_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} must be zero or more, got {value!r}")
        if self.wrap_ns is not None and self.wrap_ns <= 4 * self.jump_s * NS_PER_S:
            raise ValueError(f"wrap_ns must be well above jump_s, got {self.wrap_ns!r}")


class ClockMap:
    """Feed it every stamped message in the order heard; it answers with the message's instant on our clock.

    The answers never lie after `heard`, and never run backwards while the remote counter does not: a new least difference puts
    its own message the floor before now, later than any answer so far, and without one the map only moves forward. The sigma
    holds the floor's doubt, the counter's step, the drift since the least difference, the doubt of few messages, and that of a
    map that moves.
    """

    def __init__(self, options: ClockMapOptions) -> None:
        self._o = options
        self._least: deque[tuple[int, int]] = deque()
        """(heard, difference less the drift allowed up to then), ascending in both: the front is the least of the window."""
        self._newest_remote: int | None = None
        self._received_at = 0
        self._count = 0
        self._excess_s = options.unknown_s
        self._fell_s = 0.0
        self.restarts = 0
        """Times the remote clock was seen to be set anew."""

    def reset(self) -> None:
        """Forget the remote clock: the sender is known to have restarted."""
        self._least.clear()
        self._newest_remote = None
        self._count = 0
        self._excess_s = self._o.unknown_s
        self._fell_s = 0.0

    def stamp(self, remote_ns: int, received_at: MonoNs) -> Stamp:
        """When `remote_ns` was on our clock. Never raises on any remote value; `heard` counts as not before the last."""
        now = self._received_at = max(received_at, self._received_at)
        remote = self._unwrapped(remote_ns, now)
        if self._newest_remote is not None and self._set_anew(remote, now):
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
        """The counter without its wraps: the value nearest to what the time since the last message leads to expect."""
        wrap = self._o.wrap_ns
        if wrap is None or self._newest_remote is None:
            return remote_ns
        expected = self._newest_remote + now - self._newest_received()
        return expected + (remote_ns - expected + wrap // 2) % wrap - wrap // 2

    def _newest_received(self) -> int:
        return self._least[-1][0]

    def _set_anew(self, remote: int, now: int) -> bool:
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
