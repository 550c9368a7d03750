"""Know who is meant by "the autopilot", and who else is there. No I/O.

Without `vehicle.system_id` the autopilot is the first that flies, armed and in the air. One that is alone is followed at
once. While it is not clear who is meant, nothing is commanded, and each case names the setting that chooses.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field

from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import ReceivedMessage
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.origins import ALIVE_S
from drivers.mavlink.vehicle import ARMED, is_autopilot, stack_of
from estimator.contracts.time import MonoNs, seconds_between

_log = logging.getLogger(__name__)

FIRST_S = 5.0
"""Time for which an autopilot flies alone until another that flies makes it doubtful no more who is meant."""
MOVED_S = 5.0
"""Silence of the autopilot, since it counts as lost, after which another id may be its new one."""
_UID_S = 15.0  # time for which an answer about the hardware counts
_UIDS_MAX = 4  # serial numbers of hardware that are kept
_NAMED_S = 10.0  # time within which messages under our own id show another program that has it
_DIFFERENT = 3  # HEARTBEATs of another state from which one id is that of two systems
_NAMESAKES = 3  # messages under our own id from which another program has it
_SYSTEMS_MAX = 32  # systems that are kept
_CHECKED_S = 0.2  # interval at which conflicts of ids are looked for
_LOGGED_S = 60.0  # shortest time between two log lines about one conflict
_LOGGED_MAX = 64  # conflicts whose log lines are remembered


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
        if self._judged is not None and seconds_between(self._judged, now) < _CHECKED_S:
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
