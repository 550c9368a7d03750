"""Check stamps: arrivals that differ from all others, and delays that leave their stream's own median.

This module reads no clock. One host stamps all arrivals, so the newest confirmed arrival is the time. An arrival that is more
than `clock_step_max_s` away is refused, and becomes the time only after others confirm it, as after a real pause.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.estimates import Verdict
from estimator.contracts.time import NS_PER_S, Stamp

_CONFIRMED_BY = 5
_CONFIRMED_IN_NS = 200_000_000
_MEDIAN_STEP_S = 0.002
_FIRST_FEW = 8
_STANDS_NS = 100_000_000
"""Time of arrival over which the stamps of a quick stream have not gone on, after which its clock stands."""


class _Rival(NamedTuple):
    """A time that some arrivals report and the others do not confirm yet."""

    first: int
    last: int
    n: int
    kinds: frozenset[str]


class Delay(Struct, frozen=True):
    """The delay of one stream."""

    median_s: float
    since: int
    """Arrival of the first sample with about this delay, ns."""
    n: int = 1
    off_since: int | None = None
    """Arrival, ns, of the first of an unbroken series of samples with another delay."""
    newest: int = 0
    """The newest stamp, ns."""
    newest_at: int = 0
    """Arrival, ns, of the first sample with it."""
    at: int = 0
    """Arrival, ns, of the newest sample."""


class ClockWatch(Struct, frozen=True):
    """The arrivals and delays so far."""

    now: int | None = None
    """The newest confirmed arrival, ns."""
    rival: _Rival | None = None
    delays: Mapping[str, Delay] = MappingProxyType({})

    def off(self, kind: str) -> bool:
        """Return whether the delay of the newest sample of a kind was refused."""
        delay = self.delays.get(kind)
        return delay is not None and delay.off_since is not None

    def at(self, kind: str) -> int:
        """Return the arrival of the newest sample of a kind, ns; 0 before the first."""
        delay = self.delays.get(kind)
        return 0 if delay is None else delay.at


def watch_arrival(state: ClockWatch, kind: str, stamp: Stamp, step_max_s: float) -> tuple[ClockWatch, Verdict | None]:
    """Process an arrival; return TOO_NEW or TOO_OLD if no other arrival confirms its time."""
    received_at, now = stamp.received_at, state.now
    if now is None:
        return replace(state, now=received_at), None
    step = round(step_max_s * 1e9)
    if abs(received_at - now) <= step:
        return ClockWatch(max(now, received_at), None, state.delays), None
    rival = state.rival
    rival = (
        _Rival(received_at, received_at, 1, frozenset((kind,)))
        if rival is None or not -step <= received_at - rival.last <= step
        else _Rival(rival.first, max(rival.last, received_at), rival.n + 1, rival.kinds | {kind})
    )
    lasting = rival.n >= _CONFIRMED_BY and rival.last - rival.first >= _CONFIRMED_IN_NS
    if lasting or len(rival.kinds) >= 2:
        return ClockWatch(rival.last), None
    return replace(state, rival=rival), Verdict.TOO_NEW if received_at > now else Verdict.TOO_OLD


def watch_delay(
    state: ClockWatch, kind: str, stamp: Stamp, step_max_s: float, settle_s: float, keep_s: float = math.inf
) -> tuple[ClockWatch, Verdict | None]:
    """Process a delay of one stream.

    Args:
        kind: the stream's name.
        step_max_s: largest difference from the stream's running median.
        settle_s: time after which an unbroken other delay becomes the stream's own.
        keep_s: time after which the stream's delay gives way to no other.

    Returns:
        The new state, and TOO_NEW or TOO_OLD if the delay is not the stream's.
    """
    delay, verdict = delay_after(state.delays.get(kind), stamp, step_max_s, settle_s, keep_s, quick=True)
    return ClockWatch(state.now, state.rival, {**state.delays, kind: delay}), verdict


def delay_after(
    delay: Delay | None, stamp: Stamp, step_max_s: float, settle_s: float, keep_s: float = math.inf, *, quick: bool = False
) -> tuple[Delay, Verdict | None]:
    """Process a delay of one stream, as `watch_delay` does; `delay` is None before the stream's first sample.

    Args:
        quick: the stream has ten samples a second or more, so a stamp that comes again later is of a clock that stands.
    """
    received_at = stamp.received_at
    d = (received_at - stamp.measured_at) / NS_PER_S
    if delay is None:
        return Delay(d, received_at, newest=stamp.measured_at, newest_at=received_at, at=received_at), None
    median_s, n, off_since = delay.median_s, delay.n, delay.off_since
    newest, newest_at = delay.newest, delay.newest_at
    if stamp.measured_at > newest:
        newest, newest_at = stamp.measured_at, received_at
    elif quick and received_at - newest_at > _STANDS_NS:
        return replace(delay, off_since=received_at if off_since is None else off_since, at=received_at), Verdict.TOO_OLD
    off_s = d - median_s
    if abs(off_s) <= step_max_s:
        # The median moves in small steps, so that an outlier has no more effect than any other sample.
        step = max(_MEDIAN_STEP_S, abs(off_s) / (n + 1)) if n < _FIRST_FEW else _MEDIAN_STEP_S
        moved_s = -step if off_s < -step else step if off_s > step else off_s
        return Delay(median_s + moved_s, delay.since, n + 1, None, newest, newest_at, received_at), None
    if n < _FIRST_FEW:
        return Delay(d, received_at, 1, None, newest, newest_at, received_at), None
    off_since = received_at if off_since is None else off_since
    if (received_at - off_since) * 1e-9 >= settle_s and (off_since - delay.since) * 1e-9 < keep_s:
        return Delay(d, received_at, 1, None, newest, newest_at, received_at), None
    kept = Delay(median_s, delay.since, n, off_since, newest, newest_at, received_at)
    return kept, Verdict.TOO_OLD if off_s > 0.0 else Verdict.TOO_NEW
