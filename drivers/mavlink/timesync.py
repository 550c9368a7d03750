"""TIMESYNC, both ways: where the autopilot's clock stands against ours, and answers to requests for ours. No I/O.

A request carries our time in ts1; the answer mirrors it and adds the remote time tc1. The remote clock was read between the two,
so half the round trip bounds the error; the shortest recent round trip counts. Source: mavlink.io, "Time
Synchronization Protocol v2"; Mills, RFC 5905 section 10 (least delay wins).
`BootClock` maps the autopilot's time since boot to our clock: by TIMESYNC once that is locked, by the least delay until then.
"""

import math
from collections import deque

from msgspec import Struct

from drivers.mavlink.dialect import Message, TimeSyncV2
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between

_PERIOD_S = 1.0  # interval between time requests
_FIRST_PERIOD_S = 0.1  # the same until the offset of the clocks is known
_WINDOW_S = 10.0  # time for which an answer is used
_ROUND_TRIP_MAX_S = 0.25  # longest round trip of an answer that is used
_DRIFT_PPM = 50.0  # largest drift between the two clocks
_LOCKED_AFTER = 5  # answers that agree from which the clocks are compared
_JUMPS_TO_BELIEVE = 3  # answers in a row that disagree from which the autopilot's clock was set
_SLACK_S = 0.002  # disagreement that answers may have beside what delay and drift explain


class _Answer(Struct, frozen=True):
    received_at: MonoNs
    offset_ns: int
    round_trip_ns: int


class TimeSync:
    """Feed it TIMESYNC messages; it maps remote instants to our clock."""

    def __init__(self) -> None:
        self._answers: deque[_Answer] = deque(maxlen=256)
        self._best: _Answer | None = None
        """The answer that says most of the offset, since the newest one and until the next: all of them age alike."""
        self._drift = 0.0
        """The relative rate of the remote clock that the answers of the window prove: a simulator's may run slower than ours."""
        self.round_trip_s: float | None = None
        """The shortest round trip of the window."""
        self._asked: deque[int] = deque(maxlen=64)
        self._next = MonoNs(0)
        self._odd = 0
        self.answers = 0
        """The number of accepted answers."""
        self.refused = 0
        """Answers too slow, impossible, or to no request."""
        self.jumps = 0
        """The number of times that the remote clock was reset."""
        self.jumped_s = 0.0
        """The largest of these jumps: a simulated clock falls behind by less on a busy machine."""

    @property
    def locked(self) -> bool:
        """True if enough answers agree."""
        return len(self._answers) >= _LOCKED_AFTER

    def offset_ns(self, now: MonoNs) -> tuple[int, float] | None:
        """Return the offset (remote minus ours, ns) and its standard deviation (s), None until locked.

        The true offset is uniform within half the round trip at worst; drift since then is added.
        """
        best = self._best
        if best is None or not self.locked:
            return None
        return best.offset_ns, self._uncertainty_s(best, now) / math.sqrt(3.0)

    def reset(self) -> None:
        """Forget the remote clock."""
        self._answers.clear()
        self._best = self.round_trip_s = None
        self._asked.clear()
        self._odd = 0
        self._next = MonoNs(0)

    def due(self, now: MonoNs, target: tuple[int, int]) -> list[Message]:
        """Return the request to send now, if one is due."""
        if now < self._next:
            return []
        self._next = MonoNs(now + round((_PERIOD_S if self.locked else _FIRST_PERIOD_S) * NS_PER_S))
        self._asked.append(now)
        return [TimeSyncV2(0, now, *target)]

    def on_message(self, message: Message, received_at: MonoNs) -> None:
        """Process an answer to one of our requests; refuse and count everything else."""
        if message.ts1 not in self._asked:
            self.refused += message.tc1 != 0
            return
        self._asked.remove(message.ts1)
        round_trip_ns = received_at - message.ts1
        if not 0 <= round_trip_ns <= _ROUND_TRIP_MAX_S * NS_PER_S or message.tc1 <= 0:
            self.refused += 1
            return
        answer = _Answer(received_at, message.tc1 - (message.ts1 + received_at) // 2, round_trip_ns)
        if not self._agrees(answer):
            self._odd += 1
            if self._odd < _JUMPS_TO_BELIEVE:
                self.refused += 1
                return
            self.jumps += 1
            if self._best is not None:
                self.jumped_s = max(self.jumped_s, abs(answer.offset_ns - self._best.offset_ns) / NS_PER_S)
            self._answers.clear()
        self._odd = 0
        self._answers.append(answer)
        while seconds_between(self._answers[0].received_at, received_at) > _WINDOW_S:
            self._answers.popleft()
        first, lasted_ns = self._answers[0], max(1, received_at - self._answers[0].received_at)
        proven_ns = abs(answer.offset_ns - first.offset_ns) - (answer.round_trip_ns + first.round_trip_ns) // 2
        self._drift = max(0.0, proven_ns / lasted_ns)
        self._best = min(self._answers, key=lambda a: self._uncertainty_s(a, received_at))
        self.round_trip_s = min(a.round_trip_ns for a in self._answers) / NS_PER_S
        self.answers += 1

    def _agrees(self, answer: _Answer) -> bool:
        best = self._best
        if best is None:
            return True
        room_s = self._uncertainty_s(best, answer.received_at) + 0.5 * answer.round_trip_ns / NS_PER_S + _SLACK_S
        return abs(answer.offset_ns - best.offset_ns) <= room_s * NS_PER_S

    def _uncertainty_s(self, answer: _Answer, now: MonoNs) -> float:
        drift = max(1e-6 * _DRIFT_PPM, self._drift)
        return 0.5 * answer.round_trip_ns / NS_PER_S + drift * abs(seconds_between(answer.received_at, now))


def answer_to(message: Message, now: MonoNs, asker: tuple[int, int], us: tuple[int, int]) -> Message | None:
    """Return the answer to a TIMESYNC request, or None for one that is itself an answer or is for another system."""
    if message.tc1 != 0:
        return None
    target = (getattr(message, "target_system", 0), getattr(message, "target_component", 0))
    if target[0] not in (0, us[0]) or target[1] not in (0, us[1]):
        return None
    return TimeSyncV2(now, message.ts1, *asker)
