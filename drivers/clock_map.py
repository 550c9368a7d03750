"""Map a remote clock to this host's clock: a minimum-delay filter with a drift allowance.

A message stamped `remote` by its sender and received here at `received_at` gives `received_at - remote = offset + delay`. Delays
are never negative and sometimes hardly more than their floor, so the least difference of the last seconds is the offset plus the
floor. The two crystals drift against each other, so an old least difference is allowed to have grown by `drift_ppm` since.

Source: Mills, RFC 5905 section 10 (clock filter by minimum delay); Moon, Skelly and Towsley, Estimation and removal of clock skew
from network delay measurements, INFOCOM 1999 (the lower envelope).

A map trusts its source only as far as arrivals confirm it. Where the source's stamps go back and stay back, its clock was set:
the map begins again. Where they run at another rate than ours, they are invented or of another clock: the samples are stamped by
arrival until the rates agree again. Both are logged. The times of a source that may invent them (`claimed`) count only after the
rates have agreed for two seconds; where its samples begin to come late all together, a slow clock and a queue look alike, and
the stamp is the middle of the two.
"""

import logging
import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, StampSource

_SIGMA_MAX_S = 0.999  # largest standard deviation of a stamp; samples refuse one of a second
_MEMORY = 200
"""The number of messages over which the usual delay above the floor is averaged."""
_FADE = 0.95
"""The factor by which the memory of the map's recent moves decays with each message."""
_PRIOR = 5
"""The number of messages whose weight `unknown_s` has."""
_BACK_S = 0.02
"""The step back from which a clock may have been set; stamps of several sensors in one stream are out of order by less."""
_BACK_FOR = 5  # messages whose stamps stay back before the clock counts as set: one late datagram is no step
_BACK_FOR_S = 2.0  # time for which they do
_BLOCK_S = 0.5  # length of a block, of which the least difference counts
_BLOCKS = 8
"""Steps that give a rate and have to agree. A link whose queue fills looks like a slow clock for a while, and its stamps are
right; no queue fills evenly for so long (docs/decisions/time.md)."""
_LONG = 4  # blocks in each of these steps; a claimed rate is refused by steps of one block, too (docs/decisions/time.md)
_BLOCK_NS = round(_BLOCK_S * NS_PER_S)
_PROOF = 5
"""The blocks whose least differences have to be alike before a claimed rate counts."""
_RATE_OFF = 0.01  # disagreement of the rates from which a source is not trusted. Crystals differ by 1e-4
_RATE_AGREES = 0.003  # disagreement of the rates below which a source is trusted again

log = logging.getLogger(__name__)


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
    claimed: bool = False
    """True if the source may have invented its times: arrival stamps its samples until the rates are seen to agree."""
    doubted: bool = False
    """True if the source may run slower than we do, as a simulator: what its newest messages are late by widens the sigma."""
    name: str = "a source"
    """The name of the source in the log."""

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
        self._least = _Least(options.window_s, options.drift_ppm)
        self._near = _Least(_BLOCK_S, options.drift_ppm)
        self._newest_remote: int | None = None
        self._received_at = self._measured_at = 0
        self._jump_ns = round(options.jump_s * NS_PER_S)
        self._floor_ns = round(options.floor_s * NS_PER_S)
        self._back_ns = max(_BACK_S, options.resolution_s) * NS_PER_S
        self._count = 0
        self._excess_s = options.unknown_s
        self._fell_s = 0.0
        self._before: tuple[int, int] | None = None
        """The (unwrapped remote, difference) of the last message."""
        self._back: _StepBack | None = None
        self._mapped_at, self._late_s, self._known = 0, 0.0, False
        self._rate = _RateWatch(options)
        self.restarts = 0
        """The number of times that the remote clock was reset."""

    def reset(self) -> None:
        """Forget the remote clock, because the sender is known to have restarted."""
        self._least.clear()
        self._near.clear()
        self._before = self._back = None
        self._rate.forget()
        self._newest_remote = None
        self._count = 0
        self._excess_s = self._o.unknown_s
        self._fell_s = 0.0

    def stamp(self, remote_ns: int, received_at: MonoNs) -> Stamp:
        """Return the instant of `remote_ns` on this host's clock. Never raises on any remote value.

        A `received_at` before that of the last message counts as equal to it.
        """
        self.note(remote_ns, received_at)
        return self.newest

    def note(self, remote_ns: int, received_at: MonoNs) -> None:
        """Take the stamp of a message as `stamp` does, whose result is `newest`; many messages need it only in case."""
        now = self._received_at = max(received_at, self._received_at)
        remote = self._unwrap(remote_ns, now)
        difference = now - remote
        known = self._newest_remote
        if known is not None:
            restarted = remote < known - self._jump_ns or difference < self._least.at(now) - self._jump_ns
            may_be_set_back = remote < known or self._back is not None
            if restarted or (may_be_set_back and self._set_back(remote, now)):
                self.restarts += 1
                self.reset()
        self._before = remote, difference
        before, offset = self._least.enter(difference, now)
        # A slow clock, or a queue before the line: all of the last messages were late by this.
        near = self._near.enter(difference, now)[1] if self._o.claimed or self._o.doubted else offset
        self._late_s = (near - offset) / NS_PER_S
        late_s = self._late_s if self._o.claimed else 0.0
        self._fell_s = _FADE * self._fell_s + abs(before - offset) / NS_PER_S
        self._count = min(self._count + 1, _MEMORY)
        self._excess_s += ((difference - offset) / NS_PER_S - self._excess_s) / (self._count + _PRIOR)
        self._known = not self._rate.disagrees(remote, now) and (self._rate.proven or not self._o.claimed)
        # Without a map it is unknown how late a message is: then it is stamped by arrival.
        measured_at = (remote + offset + round(late_s / 2 * NS_PER_S) if self._known else now) - self._floor_ns
        if self._newest_remote is None or remote >= self._newest_remote:
            self._newest_remote = remote
            self._measured_at = measured_at = max(measured_at, self._measured_at)
        self._mapped_at = measured_at

    @property
    def newest(self) -> Stamp:
        """The instant of the newest message on this host's clock."""
        now = self._received_at
        if self._known:
            late_s = self._late_s
            sigma_s = math.hypot(
                self._o.floor_sigma_s,
                self._o.resolution_s / math.sqrt(12.0),
                self._o.drift_ppm * 1e-6 * (now - self._least.since) / NS_PER_S,
                # The least of n independent delays is off by 1/n of their mean, but neighbouring delays are alike.
                self._excess_s / math.sqrt(self._count),
                # A map that has moved lately may move as far again: the messages so far were all late.
                self._fell_s,
                late_s / math.sqrt(12.0),
            )
        else:
            assert self._before is not None
            # The delay that was measured before the clocks parted is the best there is.
            own_s = 0.0 if self._rate.error is not None else (self._before[1] - self._near.at(now)) / NS_PER_S
            sigma_s = math.hypot(self._o.floor_sigma_s, self._o.unknown_s, own_s)
        source: StampSource = "synced" if self._known else "arrival"
        return Stamp(MonoNs(self._mapped_at), MonoNs(now), min(sigma_s, _SIGMA_MAX_S), source)

    def _unwrap(self, remote_ns: int, now: int) -> int:
        """Return the counter without its wraps: the value nearest to the one expected from the time since the last message."""
        wrap = self._o.wrap_ns
        if wrap is None or self._newest_remote is None:
            return remote_ns
        expected = self._newest_remote + now - self._least.newest
        return expected + (remote_ns - expected + wrap // 2) % wrap - wrap // 2

    def _set_back(self, remote: int, now: int) -> bool:
        """Return whether the stamps went back a while ago, and none of those since fits the clock before."""
        assert self._before is not None
        difference, before = now - remote, self._before
        if remote < before[0] - self._back_ns:
            self._back = _StepBack(now, (before[1] + difference) // 2, 0)
        if self._back is None:
            return False
        if difference < self._back.least:
            self._back = None
            return False
        self._back.count += 1
        if self._back.count < _BACK_FOR or now - self._back.since < _BACK_FOR_S * NS_PER_S:
            return False
        late_s = (difference - self._least.at(now)) / NS_PER_S
        log.warning("the clock of %s was set back by about %.2f s: its samples are mapped again", self._o.name, late_s)
        return True


class _Least:
    """The least difference of the messages of a window, with the drift allowed since."""

    def __init__(self, window_s: float, drift_ppm: int) -> None:
        self._window, self._ppm = round(window_s * NS_PER_S), drift_ppm
        self._kept: deque[tuple[int, int]] = deque()
        """Pairs (received_at, difference less the drift allowed until then), ascending in both: the front holds the least."""

    @property
    def since(self) -> int:
        """Return when the least difference was received."""
        return self._kept[0][0]

    @property
    def newest(self) -> int:
        """Return when the last message was received."""
        return self._kept[-1][0]

    def clear(self) -> None:
        self._kept.clear()

    def enter(self, difference: int, now: int) -> tuple[int, int]:
        """Take the difference of a message; return the least one before it and with it, as `at` does."""
        kept, allowed = self._kept, now * self._ppm // 1_000_000
        level = difference - allowed
        before = kept[0][1] if kept else level
        while kept and kept[-1][1] >= level:
            kept.pop()
        kept.append((now, level))
        while now - kept[0][0] > self._window:
            kept.popleft()
        return before + allowed, kept[0][1] + allowed

    def at(self, now: int) -> int:
        """Return the least difference, which may have grown until `now`."""
        return self._kept[0][1] + now * self._ppm // 1_000_000


@dataclass(slots=True)
class _StepBack:
    """A step back of the remote clock that is not accepted yet."""

    since: int
    least: int
    """A difference below this one fits the clock before the step, ns."""
    count: int


class _RateWatch:
    """Compares the rate of the remote clock with ours by the least difference of each block of time."""

    def __init__(self, options: ClockMapOptions) -> None:
        self._o = options
        self._least: deque[tuple[int, int]] = deque(maxlen=_BLOCKS * _LONG)
        """Pairs (received_at, difference) of the least difference in each block, the last one unfinished."""
        self._block_begin: int | None = None
        self.error: float | None = None
        """The fraction by which the remote clock is faster; None while the rates agree."""
        self.proven = False
        """True once the rates have been seen to agree."""

    def forget(self) -> None:
        """Begin again after a restart of the remote clock; a source that was not trusted stays so until it is measured."""
        self._least.clear()
        self._block_begin = None
        self.proven = False

    def disagrees(self, remote: int, now: int) -> bool:
        """Note one message, and return whether its source is not trusted."""
        if self._block_begin is None or now - self._block_begin >= _BLOCK_NS:
            self._judge()
            self._block_begin = now
            self._least.append((now, now - remote))
        elif now - remote < self._least[-1][1]:
            self._least[-1] = (now, now - remote)
        return self.error is not None

    def _judge(self) -> None:
        if len(self._least) >= _PROOF and not self.proven:
            of_proof = [difference for _, difference in list(self._least)[-_PROOF:]]
            self.proven = max(of_proof) - min(of_proof) < _RATE_OFF * (_PROOF - 1) * _BLOCK_S * NS_PER_S
        coarse, agrees = self._o.resolution_s / _BLOCK_S, []
        for blocks in (1, _LONG) if self._o.claimed else (_LONG,):
            if not (steps := self._steps(blocks)):
                return
            error = steps[len(steps) // 2]
            if self.error is None and abs(error) > _RATE_OFF + coarse / blocks and steps[-1] - steps[0] < abs(error):
                self.error = error
                text = "the clock of %s runs at %.3f of ours: its samples are stamped by arrival"
                log.warning(text, self._o.name, 1.0 + error)
            agrees.append(abs(error) < _RATE_AGREES + coarse / blocks)
        if self.error is not None and all(agrees):
            self.error = None
            log.info("the clock of %s runs like ours again", self._o.name)

    def _steps(self, blocks: int) -> list[float]:
        """Return the slopes between the least differences of so many blocks each, ascending; none while they are too few."""
        kept = list(self._least)[-_BLOCKS * blocks :]
        if len(kept) < _BLOCKS * blocks or kept[-1][0] - kept[0][0] > 3 * _BLOCKS * blocks * _BLOCK_S * NS_PER_S:
            return []
        least = [min(kept[n : n + blocks], key=lambda pair: pair[1]) for n in range(0, len(kept), blocks)]
        return sorted((a[1] - b[1]) / (b[0] - a[0]) for a, b in pairwise(least))
