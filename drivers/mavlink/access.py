"""Access control for MAVLink links: whose messages are read, who is sent telemetry, who may command. No I/O.

MAVLink's ids prove nothing, so an id counts only together with the link and the peer that it comes from:

- the autopilot is one (link, peer, system, component); what comes over its peer, a router's included, may command;
- a system that the settings name is held to the first peer that uses its id, until that one falls silent;
- a sender that signs with the link's key may command;
- an address that the settings connect to is sent telemetry, and may not command;
- every other sender is unknown: only its HEARTBEATs are read, to find the autopilot, and nothing is sent to it.
"""

import logging
from collections import Counter
from enum import IntEnum

from msgspec import Struct, field

from drivers.endpoint import Address
from estimator.contracts.errors import BadInput
from estimator.contracts.time import MonoNs, seconds_between

_log = logging.getLogger(__name__)

Source = tuple[int, Address | None]
"""Number of a link, and the peer on it; None where the link has only one."""

_UNKNOWN_MAX = 64  # unknown senders that are remembered
_UNKNOWN_AFTER_S = 3.0
"""A sender that is unknown for this long is logged: an autopilot becomes known with its first HEARTBEAT."""


class AccessLevel(IntEnum):
    """The rights of a message's sender; a higher level includes the lower ones."""

    UNKNOWN = 0
    """Only its HEARTBEATs are read."""
    REPORTER = 1
    """It is a ship that the settings name, and its messages are read."""
    PEER = 2
    """It is at an address that the settings connect to; its messages are read and it is sent telemetry."""
    OPERATOR = 3
    """It may command."""


class Named(Struct, frozen=True):
    """A system that may command, or one component of it."""

    system: int
    component: int | None = None

    def __str__(self) -> str:
        return str(self.system) if self.component is None else f"{self.system}/{self.component}"


def parse_operators(text: str) -> tuple[Named, ...]:
    """Return the systems that a text like "255, 245/190" names.

    Raises:
        BadInput: one of them is none.
    """
    out = []
    for word in text.split(",") if text.strip() else ():
        system, slash, component = word.strip().partition("/")
        numbers = [system, component] if slash else [system]
        if not all(n.isascii() and n.isdigit() and len(n) <= 3 and 1 <= int(n) <= 255 for n in numbers):
            raise BadInput(f"operator {word.strip()!r}: write SYSTEM or SYSTEM/COMPONENT, each 1 to 255")
        out.append(Named(int(system), int(component) if slash else None))
    return tuple(out)


class NamedSenders(Struct, frozen=True):
    """The senders that the settings name.

    Attributes:
        operators: systems that may command though they do not sign.
        reporters: systems that are listened to: ships.
        everybody: every sender may command and is answered; for a simulated station, never for a drone.
        silence_s: a named system not received for this long may come from another peer.
    """

    operators: tuple[Named, ...] = ()
    reporters: frozenset[int] = frozenset()
    everybody: bool = False
    silence_s: float = 30.0


class _UnknownSender(Struct):
    since: MonoNs
    logged: bool = False


class Access(Struct):
    """The senders known so far. There is one instance for all links of a service."""

    options: NamedSenders
    autopilot: tuple[Source, tuple[int, int]] | None = None
    """The autopilot's peer and its (system, component)."""
    refused: Counter[str] = field(default_factory=Counter)
    """The number of messages that were refused, by reason: impostor, unknown."""
    _held: dict[int, tuple[Source, MonoNs]] = field(default_factory=dict)
    """The last place and time of each named system."""
    _unknown_senders: dict[tuple[int, int], _UnknownSender] = field(default_factory=dict)

    def level(self, source: Source, ids: tuple[int, int], now: MonoNs, *, asked_for: bool, signed: bool) -> AccessLevel:
        """Return the access level of a message's sender.

        Args:
            source: where it came from.
            ids: its (system, component).
            asked_for: the link leads to an address of the settings, or is a cable.
            signed: the link takes nothing that is not signed with its key.
        """
        system, component = ids
        if self.options.everybody:
            return AccessLevel.OPERATOR
        if self.autopilot is not None:
            if source == self.autopilot[0]:
                return AccessLevel.OPERATOR
            if ids == self.autopilot[1]:
                self.refused["impostor"] += 1
                return AccessLevel.UNKNOWN
        if signed:
            return AccessLevel.OPERATOR
        commands = any(n.system == system and n.component in (None, component) for n in self.options.operators)
        if commands or system in self.options.reporters:
            if not self._holds(system, source, now):
                self.refused["impostor"] += 1
                return AccessLevel.UNKNOWN
            return (
                AccessLevel.OPERATOR
                if commands
                else max(AccessLevel.REPORTER, AccessLevel.PEER if asked_for else AccessLevel.UNKNOWN)
            )
        return AccessLevel.PEER if asked_for else AccessLevel.UNKNOWN

    def _holds(self, system: int, source: Source, now: MonoNs) -> bool:
        held = self._held.get(system)
        if held is not None and held[0] != source and seconds_between(held[1], now) <= self.options.silence_s:
            return False
        self._held[system] = source, now  # as many as the settings name
        return True

    def refuse_unknown(self, ids: tuple[int, int], peer: Address | None, now: MonoNs) -> None:
        """Count a message that was ignored, and log once for each sender what would make it known."""
        self.refused["unknown"] += 1
        if peer is None:
            return  # the autopilot once more, over another link
        sender = self._unknown_senders.get(ids)
        if sender is None:
            if len(self._unknown_senders) < _UNKNOWN_MAX:
                self._unknown_senders[ids] = _UnknownSender(now)
        elif not sender.logged and seconds_between(sender.since, now) >= _UNKNOWN_AFTER_S:
            sender.logged = True
            _log.warning(
                "MAVLink: system %d, component %d at %s:%d is unknown or uses another's ids: it gets no messages and may not "
                "command; name its system in `operators`, or sign the link (decklander keys)",
                *ids,
                *peer,
            )
