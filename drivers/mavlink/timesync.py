"""TIMESYNC, both ways: where the autopilot's clock stands against ours, and answers to whoever requests ours. No I/O.

A request carries our time in ts1; the answer mirrors it and adds the remote time tc1. The remote clock was read between the two,
so half the round trip bounds the error; the shortest recent round trip counts. Source: mavlink.io, "Time
Synchronization Protocol v2"; Mills, RFC 5905 section 10 (least delay wins).
"""

import math
from collections import deque
from dataclasses import dataclass

from drivers.mavlink.dialect import Message, TimeSyncV2
from drivers.mavlink.options import TimeSyncOptions
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between

_LOCKED_AFTER = 5
_JUMPS_TO_BELIEVE = 3
_SLACK_S = 0.002


@dataclass(frozen=True, slots=True)
class _Answer:
    received_at: MonoNs
    offset_ns: int
    round_trip_ns: int


class TimeSync:
    """Feed it TIMESYNC messages; it maps remote instants to our clock."""

    def __init__(self, options: TimeSyncOptions | None = None) -> None:
        self._o = options or TimeSyncOptions()
        self._answers: deque[_Answer] = deque(maxlen=256)
        self._asked: deque[int] = deque(maxlen=64)
        self._next = MonoNs(0)
        self._odd = 0
        self.answers = 0
        """The number of accepted answers."""
        self.refused = 0
        """Answers too slow, impossible, or not asked for."""
        self.jumps = 0
        """The number of times that the remote clock was reset."""
        self.jitter_s = 0.0
        """Running deviation of the round trip."""

    @property
    def locked(self) -> bool:
        """True if enough answers agree."""
        return len(self._answers) >= _LOCKED_AFTER

    @property
    def round_trip_s(self) -> float | None:
        """The shortest round trip of the window."""
        return min(a.round_trip_ns for a in self._answers) / NS_PER_S if self._answers else None

    def offset_ns(self, now: MonoNs) -> tuple[int, float] | None:
        """Return the offset (remote minus ours, ns) and its standard deviation (s), None until locked.

        The true offset is uniform within half the round trip at worst; drift since then is added.
        """
        if not self.locked:
            return None
        best = min(self._answers, key=lambda a: self._uncertainty_s(a, now))
        return best.offset_ns, self._uncertainty_s(best, now) / math.sqrt(3.0)

    def reset(self) -> None:
        """Forget the remote clock."""
        self._answers.clear()
        self._asked.clear()
        self._odd = 0
        self._next = MonoNs(0)

    def due(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        """Return the request to send now, if one is due."""
        if now < self._next:
            return []
        self._next = MonoNs(now + round((self._o.period_s if self.locked else self._o.first_period_s) * NS_PER_S))
        self._asked.append(now)
        return [TimeSyncV2(0, now, *target)]

    def on_message(self, message: Message, received_at: MonoNs) -> None:
        """Process an answer to one of our requests; refuse and count everything else."""
        if message.ts1 not in self._asked:
            self.refused += message.tc1 != 0
            return
        self._asked.remove(message.ts1)
        round_trip_ns = received_at - message.ts1
        if not 0 <= round_trip_ns <= self._o.round_trip_max_s * NS_PER_S or message.tc1 <= 0:
            self.refused += 1
            return
        answer = _Answer(received_at, message.tc1 - (message.ts1 + received_at) // 2, round_trip_ns)
        if not self._agrees(answer):
            self._odd += 1
            if self._odd < _JUMPS_TO_BELIEVE:
                self.refused += 1
                return
            self.jumps += 1
            self._answers.clear()
        self._odd = 0
        if self._answers:
            change_s = abs(round_trip_ns - self._answers[-1].round_trip_ns) / NS_PER_S
            self.jitter_s += (change_s - self.jitter_s) / 16.0
        self._answers.append(answer)
        while seconds_between(self._answers[0].received_at, received_at) > self._o.window_s:
            self._answers.popleft()
        self.answers += 1

    def _agrees(self, answer: _Answer) -> bool:
        if not self._answers:
            return True
        best = min(self._answers, key=lambda a: self._uncertainty_s(a, answer.received_at))
        room_s = self._uncertainty_s(best, answer.received_at) + 0.5 * answer.round_trip_ns / NS_PER_S + _SLACK_S
        return abs(answer.offset_ns - best.offset_ns) <= room_s * NS_PER_S

    def _uncertainty_s(self, answer: _Answer, now: MonoNs) -> float:
        return 0.5 * answer.round_trip_ns / NS_PER_S + 1e-6 * self._o.drift_ppm * abs(seconds_between(answer.received_at, now))


def answer_to(message: Message, now: MonoNs, asker: tuple[int, int], us: tuple[int, int]) -> Message | None:
    """Return the answer to a TIMESYNC request, or None for one that is itself an answer or is for another system."""
    if message.tc1 != 0:
        return None
    target = (getattr(message, "target_system", 0), getattr(message, "target_component", 0))
    if target[0] not in (0, us[0]) or target[1] not in (0, us[1]):
        return None
    return TimeSyncV2(now, message.ts1, *asker)
