"""Distinguish autopilots that use one system id over one link, behind a router. No I/O.

Their times since boot differ, and each counts its own sequence numbers. A message without a time belongs to the autopilot whose
count it continues.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from drivers.mavlink.boot_clock import MS_WRAP_NS
from drivers.mavlink.dialect import Message
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between

_ROOM_NS = NS_PER_S
"""Largest difference of a time since boot from the expected one: messages are late and overtake one another."""
_DRIFT_PPM = 200  # rate at which the least delay of an autopilot's clock may change, parts per million
_NEXT_WITHIN = 8
"""Sequence numbers that may be lost between two messages of one autopilot."""
_REACHED_WITHIN = 64
"""Sequence numbers that another autopilot may have used since its last message with a time."""
_HELD_S = 0.5
"""Time for which a message waits until its sender is known."""
_REBOOT_S = 1.0  # silence after which another clock is taken for the autopilot's, because it rebooted
_REPLACED_S = 10.0  # silence after which it is, where two autopilots ran beside one another
_BELIEVED = 3  # messages or HEARTBEATs in order from which a clock counts as an autopilot's
_BESIDE_S = 0.5
"""Time for which two clocks must both have run on to be those of two autopilots."""
_SLOWEST = 0.2
"""Pace of a simulated autopilot's clock, as a part of ours, at which it still counts as a clock."""
_OTHERS_MAX = 4  # other clocks under one id that are kept
_SEEN_MAX = 4096  # messages that are kept to recognize those that come over a second link
ALIVE_S = 5.0
"""Time for which a system counts as there after a HEARTBEAT."""


@dataclass(slots=True)
class _Origin:
    """One clock: the newest time since boot, the least difference to ours, and the newest sequence number."""

    newest: int
    least: int
    at: MonoNs
    sequence: int
    first: tuple[int, MonoNs]
    """The first time since boot, and when it came."""
    messages: int = 1

    @staticmethod
    def of(boot: int, at: MonoNs, sequence: int) -> _Origin:
        return _Origin(boot, at - boot, at, sequence, (boot, at))

    @property
    def runs(self) -> bool:
        """True if it runs as a clock does; made-up values do not."""
        boot_s, lasted_s = (self.newest - self.first[0]) / NS_PER_S, seconds_between(self.first[1], self.at)
        return lasted_s >= _BESIDE_S and _SLOWEST * lasted_s <= boot_s <= lasted_s / _SLOWEST

    def alive(self, now: MonoNs) -> bool:
        return seconds_between(self.at, now) <= (ALIVE_S if self.messages >= _BELIEVED else _HELD_S)

    def fits(self, boot: int, at: MonoNs) -> bool:
        """Return whether a time since boot may be this clock's."""
        boot, least = self._placed(boot, at)
        return self.newest - _ROOM_NS <= boot <= at - least + _ROOM_NS

    def adds(self, boot: int, at: MonoNs, sequence: int) -> bool:
        """Take a message's time and sequence number if the time fits; return whether it does."""
        if not self.fits(boot, at):
            return False
        boot, least = self._placed(boot, at)
        self.least = min(least, at - boot)
        self.newest = max(self.newest, boot)
        self.at, self.sequence = at, sequence
        self.messages += 1
        return True

    def continued_by(self, sequence: int) -> int:
        """Return by how much a sequence number is ahead."""
        return (sequence - self.sequence) % 256

    def apart_from(self, sequence: int) -> bool:
        """Return whether a sequence number cannot have been reached with messages without a time."""
        return _REACHED_WITHIN < self.continued_by(sequence) < 256 - _NEXT_WITHIN

    def _placed(self, boot: int, at: MonoNs) -> tuple[int, int]:
        """Return a time since boot without its wraps, and the least difference to ours, which may have grown until `at`."""
        unwrapped = boot + MS_WRAP_NS * round((self.newest - boot) / MS_WRAP_NS)
        return unwrapped, self.least + (at - self.at) * _DRIFT_PPM // 1_000_000


class Origins:
    """Passes the messages of one autopilot and leaves out those of others with its ids."""

    def __init__(self) -> None:
        self._main: _Origin | None = None
        self._others: list[_Origin] = []
        self._held: deque[tuple[MonoNs, Message]] = deque()
        """Messages that wait for the autopilot's next message with a time, which identifies their sender."""
        self._beats: tuple[int, int, MonoNs] | None = None
        """HEARTBEATs of another autopilot, each with the next count: their number, the newest count, and its time."""
        self._beaten: MonoNs | None = None
        """Time of the newest of enough such HEARTBEATs; a lost message ends a row, and not its result."""
        self._seen: set[tuple[str, int, int]] = set()
        self._seen_order: deque[tuple[str, int, int]] = deque()
        self.changes = 0
        """The number of times that the autopilot was taken to have another clock: it booted, or it was replaced."""

    def several(self, now: MonoNs) -> bool:
        """Return whether another autopilot runs beside the one whose messages are passed."""
        main = self._main
        if main is None:
            return False
        beats = self._beaten is not None and seconds_between(self._beaten, now) <= ALIVE_S
        return beats or any(_beside(main, one) for one in self._alive(now))

    def continues(self, message: Message, at: MonoNs) -> bool:
        """Return whether a message with a time is the next of the autopilot, by its clock and by its count."""
        boot_ms, main = getattr(message, "time_boot_ms", 0), self._main
        if main is None or not boot_ms or self._alive(at):
            return False
        return main.fits(boot_ms * 1_000_000, at) and 0 < main.continued_by(int(message.get_seq())) <= _REACHED_WITHIN

    def sort(self, message: Message, at: MonoNs) -> list[Message]:
        """Return the messages that are known to be the autopilot's now, in the order in which they came."""
        sequence = int(message.get_seq())
        boot_ms = getattr(message, "time_boot_ms", 0)
        if not boot_ms:
            return self._without_time(message, at, sequence)
        if self._came_before((message.get_type(), boot_ms, sequence)):
            return [message] if not self._others else []  # by another path; the sampler counts it
        boot = boot_ms * 1_000_000
        main = self._main
        if main is None:
            self._main = _Origin.of(boot, at, sequence)
            return [message]
        if main.adds(boot, at, sequence):
            return [*self._decide(sequence, at), message] if self._held else [message]
        return self._of_another(message, boot, at, sequence)

    def due(self, now: MonoNs) -> list[Message]:
        """Return messages that waited for long enough: they are the autopilot's where no other one is there."""
        out = []
        while self._held and seconds_between(self._held[0][0], now) > _HELD_S:
            _, message = self._held.popleft()
            if self._alive(now):
                self._leave_out(message, now)
                continue
            if self._main is not None:
                self._main.sequence = int(message.get_seq())
            out.append(message)
        return out

    def _leave_out(self, message: Message, now: MonoNs) -> None:
        if message.get_type() == "HEARTBEAT":
            sequence, before = int(message.get_seq()), self._beats
            follows = before is not None and 0 < (sequence - before[1]) % 256 <= _NEXT_WITHIN
            self._beats = before[0] + 1 if before is not None and follows else 1, sequence, now
            if self._beats[0] >= _BELIEVED:
                self._beaten = now

    def _of_another(self, message: Message, boot: int, at: MonoNs, sequence: int) -> list[Message]:
        main, other = self._main, next((one for one in self._others if one.adds(boot, at, sequence)), None)
        assert main is not None
        if other is None:
            other = _Origin.of(boot, at, sequence)
            self._others = [*self._alive(at)[-_OTHERS_MAX + 1 :], other]
        held, self._held = self._held, deque()
        for one in held:
            if _near(one[1], sequence) and not _near(one[1], main.sequence):
                self._leave_out(one[1], at)
            else:
                self._held.append(one)
        silence_s = _REPLACED_S if _beside(main, other) else _REBOOT_S
        if other.messages < _BELIEVED or seconds_between(main.at, at) < silence_s:
            return []
        self._main = other
        self._others = [one for one in self._others if one is not other]
        self.changes += 1
        return [message]

    def _without_time(self, message: Message, at: MonoNs, sequence: int) -> list[Message]:
        main = self._main
        if main is None:
            return [message]
        others = self._alive(at)
        if main.continued_by(sequence) <= _NEXT_WITHIN and (not others or all(one.apart_from(sequence) for one in others)):
            main.sequence = sequence
            return [message]
        its_own = next((one for one in others if one.continued_by(sequence) <= _NEXT_WITHIN), None)
        if its_own is not None and main.apart_from(sequence):
            its_own.sequence = sequence
            self._leave_out(message, at)
        else:
            self._held.append((at, message))
        return []

    def _decide(self, sequence: int, at: MonoNs) -> list[Message]:
        """Return the waiting messages that are the autopilot's, now that one of its own has come: its count is near theirs."""
        held, self._held = self._held, deque()
        others, out = self._alive(at), []
        for _, message in held:
            if _near(message, sequence) and all(one.apart_from(int(message.get_seq())) for one in others):
                out.append(message)
            else:
                self._leave_out(message, at)
        return out

    def _came_before(self, key: tuple[str, int, int]) -> bool:
        if key in self._seen:
            return True
        self._seen.add(key)
        self._seen_order.append(key)
        if len(self._seen_order) > _SEEN_MAX:
            self._seen.remove(self._seen_order.popleft())
        return False

    def _alive(self, now: MonoNs) -> list[_Origin]:
        return [one for one in self._others if one.alive(now)]


def _near(message: Message, sequence: int) -> bool:
    """Return whether a message may be of the autopilot that counted so far."""
    return min((sequence - int(message.get_seq())) % 256, (int(message.get_seq()) - sequence) % 256) <= _NEXT_WITHIN


def _beside(main: _Origin, other: _Origin) -> bool:
    """Return whether two clocks ran on beside one another: then the other is no reboot of the first."""
    both_s = seconds_between(other.first[1], MonoNs(min(main.at, other.at)))
    return main.runs and other.runs and both_s >= _BESIDE_S
