"""Send few STATUSTEXT messages to the pilot: in order of severity, long ones in chunks, none twice in a row. No I/O."""

from collections import deque
from dataclasses import dataclass
from enum import IntEnum

from drivers.mavlink.dialect import Message, mav
from estimator.contracts.time import MonoNs, seconds_between

_CHUNK = 50
_SAID_MAX = 64


class MavSeverity(IntEnum):
    """The values of MAV_SEVERITY that are used."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


@dataclass(frozen=True, slots=True)
class _Text:
    severity: MavSeverity
    text: str


class StatusTexts:
    """A token bucket of `burst` texts that refills at `rate_hz`; excess texts wait, and the least severe is dropped first.

    Args:
        repeat_s: the time within which the same text is not sent again.
    """

    def __init__(self, *, rate_hz: float = 1.0, burst: int = 5, waiting: int = 10, repeat_s: float = 10.0) -> None:
        self._rate_hz, self._burst, self._waiting_max, self._repeat_s = rate_hz, burst, waiting, repeat_s
        self._tokens = float(burst)
        self._filled: MonoNs | None = None
        self._waiting: deque[_Text] = deque()
        self._said: dict[str, MonoNs] = {}
        self._id = 0
        self.dropped = 0
        """The number of texts that were never sent."""

    def say(self, severity: MavSeverity, text: str, now: MonoNs) -> None:
        """Queue a text unless it was queued within `repeat_s`."""
        last = self._said.get(text)
        if last is not None and seconds_between(last, now) < self._repeat_s:
            return
        if len(self._said) >= _SAID_MAX:
            self._said.clear()
        self._said = {t: at for t, at in self._said.items() if seconds_between(at, now) < self._repeat_s} | {text: now}
        self._waiting.append(_Text(severity, text))
        if len(self._waiting) > self._waiting_max:
            least = max(range(len(self._waiting)), key=lambda i: (self._waiting[i].severity, i))
            del self._waiting[least]
            self.dropped += 1

    def due(self, now: MonoNs) -> list[Message]:
        """Return the messages that may be sent now, the most severe first."""
        if self._filled is not None:
            self._tokens = min(float(self._burst), self._tokens + self._rate_hz * seconds_between(self._filled, now))
        self._filled = now
        out: list[Message] = []
        while self._waiting and self._tokens >= 1.0:
            first = min(range(len(self._waiting)), key=lambda i: (self._waiting[i].severity, i))
            text = self._waiting[first]
            del self._waiting[first]
            self._tokens -= 1.0
            out += self._chunks(text)
        return out

    def _chunks(self, text: _Text) -> list[Message]:
        data = text.text.encode("ascii", errors="replace")
        if len(data) <= _CHUNK:
            return [mav.MAVLink_statustext_message(int(text.severity), data)]
        self._id = self._id % 65535 + 1
        pieces = [data[i : i + _CHUNK] for i in range(0, len(data), _CHUNK)]
        if len(pieces[-1]) == _CHUNK:
            pieces.append(b"")  # A full last chunk would leave the receiver waiting for more.
        return [mav.MAVLink_statustext_message(int(text.severity), piece, self._id, n) for n, piece in enumerate(pieces)]
