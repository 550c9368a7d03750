"""Know who is meant by "the autopilot", and who else is there: the one place that says it. No I/O.

Without `vehicle.system_id` the autopilot is the first that flies, armed and in the air. One that is alone is followed at
once. While it is not clear who is meant, nothing is commanded, and each case names the setting that chooses.

Autopilots that use one system id over one link, behind a router, are distinguished: their times since boot differ, and each
counts its own sequence numbers. A message without a time belongs to the autopilot whose count it continues.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.timesync import MS_WRAP_NS
from drivers.mavlink.vehicle import ARMED, is_autopilot, stack_of
from estimator.contracts.time import NS_PER_S, MonoNs, seconds_between

_log = logging.getLogger(__name__)

_ROOM_NS = NS_PER_S
"""Largest difference of a time since boot from the expected one: messages are late and overtake one another."""
_DRIFT_PPM = 200
_NEXT_WITHIN = 8
"""Sequence numbers that may be lost between two messages of one autopilot."""
_REACHED_WITHIN = 64
"""Sequence numbers that another autopilot may have used since its last message with a time."""
_HELD_S = 0.5
"""Time for which a message waits until its sender is known."""
_REBOOT_S, _REPLACED_S = 1.0, 10.0
"""Silence after which another clock is taken for the autopilot's: after a reboot, and where two ran beside one another."""
_BELIEVED = 3
_BESIDE_S = 0.5
"""Time for which two clocks must both have run on to be those of two autopilots."""
_SLOWEST = 0.2
"""Pace of a simulated autopilot's clock, as a part of ours, at which it still counts as a clock."""
_OTHERS_MAX = 4
_SEEN_MAX = 4096


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
        boot, least = self._placed(boot, at)
        return self.newest - _ROOM_NS <= boot <= at - least + _ROOM_NS

    def adds(self, boot: int, at: MonoNs, sequence: int) -> bool:
        """Take a message's time and sequence number if the time fits; return whether it does."""
        boot, least = self._placed(boot, at)
        if not self.newest - _ROOM_NS <= boot <= at - least + _ROOM_NS:
            return False
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
        """Return messages that waited for long enough: they are the autopilot's where nobody else is there."""
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


ALIVE_S = 5.0
"""Time for which a system counts as there after a HEARTBEAT."""
FIRST_S = 5.0
"""Time for which an autopilot flies alone until another that flies makes it doubtful no more who is meant."""
MOVED_S = 5.0
"""Silence of the autopilot, since it counts as lost, after which another id may be its new one."""
_UID_S, _UIDS_MAX = 15.0, 4
_NAMED_S = 10.0
_DIFFERENT, _NAMESAKES = 3, 3
_SYSTEMS_MAX = 32
_JUDGED_S, _LOGGED_S, _LOGGED_MAX = 0.2, 60.0, 64
"""Interval at which it is judged who is who; the shortest time between two log lines about one conflict; most of them."""
_IN_THE_AIR = (int(mav.MAV_STATE_ACTIVE), int(mav.MAV_STATE_CRITICAL), int(mav.MAV_STATE_EMERGENCY))


@dataclass(frozen=True, slots=True)
class IdConflict:
    """A conflict about which system is the autopilot."""

    name: str
    what: str
    fix: str
    blocks: bool = True
    """True if nothing may be commanded meanwhile."""

    def __str__(self) -> str:
        return f"{self.what}; {self.fix}"


@dataclass(slots=True)
class _Peer:
    stack: str
    at: MonoNs
    flies: bool


@dataclass(frozen=True, slots=True)
class Bound:
    """The autopilot that is listened to."""

    system: int
    silent_s: float
    """Time since its last message, s."""
    lost: bool
    commanded: bool
    """True if it was commanded and not released since."""
    several: bool
    """True if another one uses its id over the same link."""


@dataclass(slots=True)
class Roster:
    """The autopilots that were received, and other users of ids that are not theirs."""

    options: AutopilotOptions
    uids: dict[int, tuple[MonoNs, int]] = field(default_factory=dict)
    """Time of each hardware's last answer under the autopilot's system id, and the number of recent ones."""
    _peers: dict[int, _Peer] = field(default_factory=dict)
    _flies_alone_since: tuple[int, MonoNs] | None = None
    _first: int = 0
    """The system that was the first that flies; 0 while there is none."""
    _elsewhere: tuple[str, MonoNs, int] | None = None
    """Another sender of the autopilot's ids: where, when, and how often it differed."""
    _state: tuple[int, int, int] | None = None
    _namesakes: list[MonoNs] = field(default_factory=list)
    found: tuple[IdConflict, ...] = ()
    """Ambiguities about which component is the autopilot, or about our own id, as last determined."""
    _judged: MonoNs | None = None
    _logged: dict[str, MonoNs] = field(default_factory=dict)

    def on_heartbeat(self, received: ReceivedMessage) -> None:
        """Note the HEARTBEAT of any autopilot but the ship's."""
        m, now = received.message, received.received_at
        if not is_autopilot(m, received.component) or received.system == self.options.vessel_id:
            return
        if received.system not in self._peers and len(self._peers) >= _SYSTEMS_MAX:
            del self._peers[min(self._peers, key=lambda system: self._peers[system].at)]
        flies = bool(m.base_mode & ARMED) and int(m.system_status) in _IN_THE_AIR
        self._peers[received.system] = _Peer(stack_of(m).value, now, flies)
        flying = [system for system in self._alive(now) if self._peers[system].flies]
        if len(flying) != 1:
            self._flies_alone_since = None
        elif self._flies_alone_since is None or self._flies_alone_since[0] != flying[0]:
            self._flies_alone_since = flying[0], now
        elif self._first == 0 and seconds_between(self._flies_alone_since[1], now) >= FIRST_S:
            self._first = flying[0]

    def on_own_heartbeat(self, m: Message) -> None:
        """Note the state in the autopilot's own HEARTBEAT."""
        self._state = _state_of(m)

    def on_elsewhere(self, received: ReceivedMessage) -> None:
        """Note a HEARTBEAT of the autopilot's ids by another way, which is another one's where it keeps saying other things."""
        before = self._elsewhere
        differed = 0 if before is None or before[0] != received.source_text else before[2]
        differs = self._state is not None and _state_of(received.message) != self._state
        self._elsewhere = received.source_text, received.received_at, differed + 1 if differs else 0

    def note_uid(self, uid: int, now: MonoNs) -> None:
        """Note the hardware that answered under the autopilot's id; 0 is ignored."""
        self.uids = {one: known for one, known in self.uids.items() if seconds_between(known[0], now) < _UID_S}
        if uid and (uid in self.uids or len(self.uids) < _UIDS_MAX):
            self.uids[uid] = now, self.uids.get(uid, (now, 0))[1] + 1

    def on_namesake(self, now: MonoNs) -> None:
        """Note a message that another program sent under our own system and component."""
        self._namesakes = [*(at for at in self._namesakes if seconds_between(at, now) < _NAMED_S), now][-_NAMESAKES:]

    def commanded(self, system: int) -> None:
        """Note that this autopilot follows our commands: it is the one that is meant."""
        self._first = system

    def chosen(self, system: int, bound: Bound | None, now: MonoNs) -> bool:
        """Return whether a system that sent a HEARTBEAT is the autopilot to listen to."""
        if self.options.system_id:
            return system == self.options.system_id
        if bound is None or system == bound.system:
            return True
        if bound.commanded:
            return False
        if bound.lost:
            alone = [one for one in self._alive(now) if one != bound.system] == [system]
            moved = alone and bound.silent_s > self.options.silence_s + MOVED_S
            if moved:
                self._first = 0
            return moved
        here, there = self._peers.get(bound.system), self._peers.get(system)
        flies_there = there is not None and there.flies
        return self._first in (0, system) and flies_there and (here is None or not here.flies)

    @property
    def unclear(self) -> str | None:
        """Reason why nothing may be commanded; None while the autopilot is clear."""
        return next((str(conflict) for conflict in self.found if conflict.blocks), None)

    def judge(self, bound: Bound | None, ours: tuple[int, int], now: MonoNs) -> None:
        """Judge who is who some times a second, and log each conflict when it begins and when it is over."""
        if self._judged is not None and seconds_between(self._judged, now) < _JUDGED_S:
            return
        self._judged = now
        if bound is not None and bound.commanded:
            self.commanded(bound.system)
        before, self.found = self.found, self.conflicts(bound, ours, now)
        for conflict in self.found:
            last = self._logged.get(conflict.what)
            if conflict not in before and (last is None or seconds_between(last, now) >= _LOGGED_S):
                if len(self._logged) > _LOGGED_MAX:
                    self._logged.clear()
                self._logged[conflict.what] = now
                _log.warning("MAVLink: %s", conflict)
        if any(conflict.blocks for conflict in before) and self.unclear is None:
            _log.info("autopilot: it is clear again who is meant")

    def conflicts(self, bound: Bound | None, ours: tuple[int, int], now: MonoNs) -> tuple[IdConflict, ...]:
        """Return the conflicts of ids that exist now."""
        return tuple(self._conflicts(bound, ours, now))

    def _conflicts(self, bound: Bound | None, ours: tuple[int, int], now: MonoNs) -> Iterator[IdConflict]:
        own_id = "an id of its own (SYSID_THISMAV, MAV_SYSID since ArduPilot 4.7, MAV_SYS_ID of PX4)"
        if len(self._namesakes) == _NAMESAKES and seconds_between(self._namesakes[-1], now) < _NAMED_S:
            yield IdConflict(
                "component-id-twice",
                f"another program sends as system {ours[0]}, component {ours[1]}, which is ours",
                "stop the other one, or choose another vehicle.component_id",
                blocks=False,
            )
        if bound is None:
            return
        uids = sorted(uid for uid, (at, answers) in self.uids.items() if answers > 1 and seconds_between(at, now) < _UID_S)
        if bound.several or len(uids) > 1:
            known_by = f", hardware {' and '.join(f'{uid:x}' for uid in uids)}" if len(uids) > 1 else ""
            yield IdConflict(
                "autopilot-id-twice",
                f"two autopilots have one id behind one link: system {bound.system}{known_by}; nothing is commanded",
                f"give each {own_id} and choose by vehicle.system_id",
            )
        if (
            self._elsewhere is not None
            and self._elsewhere[2] >= _DIFFERENT
            and seconds_between(self._elsewhere[1], now) < ALIVE_S
        ):
            yield IdConflict(
                "autopilot-id-elsewhere",
                f"another autopilot has the same id, system {bound.system}, and is not listened to ({self._elsewhere[0]})",
                f"give each {own_id}",
                blocks=False,
            )
        yield from self._of_several(bound, now)

    def _of_several(self, bound: Bound, now: MonoNs) -> Iterator[IdConflict]:
        alive = self._alive(now)
        others = [system for system in alive if system != bound.system]
        if self.options.system_id or not others:
            return
        stacks = {system: f" ({one.stack})" for system, one in self._peers.items()}
        named = " and ".join(f"system {system}{stacks.get(system, '')}" for system in sorted({bound.system, *others}))
        flying = [system for system in alive if self._peers[system].flies]
        if bound.lost:
            yield IdConflict(
                "autopilot-id-changed",
                f"the autopilot, system {bound.system}, is silent; another is there: "
                + " and ".join(f"system {system}" for system in others),
                f"where its id was changed, set vehicle.system_id ({others[0]}) and start the service again"
                if bound.commanded or len(others) > 1
                else f"it is taken when that silence lasts {self.options.silence_s + MOVED_S:g} s",
            )
        elif self._first == bound.system or flying == [bound.system]:
            yield IdConflict(
                "several-autopilots",
                f"several autopilots send: {named}; system {bound.system} is taken, the first that flew",
                f"vehicle.system_id = {bound.system} says so for good",
                blocks=False,
            )
        else:
            state = "more than one flies" if flying else "none flies"
            yield IdConflict(
                "several-autopilots",
                f"several autopilots send: {named}; {state}, and nothing is commanded while it is not clear who is meant",
                f"choose one by vehicle.system_id ({' or '.join(map(str, sorted({bound.system, *others})))})",
            )

    def _alive(self, now: MonoNs) -> list[int]:
        return [system for system, one in self._peers.items() if seconds_between(one.at, now) <= ALIVE_S]


def _state_of(heartbeat: Message) -> tuple[int, int, int]:
    return int(heartbeat.base_mode), int(heartbeat.custom_mode), int(heartbeat.type)
