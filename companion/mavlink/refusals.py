"""Commands and parameter writes of those who may not: answered where we speak to them, counted, and told once. No I/O."""

from __future__ import annotations

import logging
from collections import Counter

from companion.mavlink.commands import DENIED
from drivers.mavlink.access import Standing
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import Links, ReceivedMessage

_log = logging.getLogger(__name__)

_TOLD_MAX = 32
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")


class Refusals:
    """Decides for one component of ours whether a message is obeyed.

    Args:
        setting: the key of the settings that names who may command, for the log.
    """

    def __init__(self, setting: str) -> None:
        self._setting = setting
        self._told: set[tuple[int, int]] = set()
        self.counts: Counter[str] = Counter()
        """Messages that were refused, by name."""

    def refuses(self, received: ReceivedMessage, us: tuple[int, int]) -> bool:
        """Return whether this message asks us (system, component) for something that its sender may not have."""
        message, name = received.message, received.message.get_type()
        if received.standing >= Standing.OPERATOR or name not in (*_COMMANDS, "PARAM_SET"):
            return False
        if (message.target_system, message.target_component) != us:
            return False
        self.counts[name] += 1
        return True

    def answer(self, received: ReceivedMessage) -> list[Message]:
        """Return the answer to a command that was refused; a parameter's is its value in force."""
        if received.standing < Standing.PEER or received.message.get_type() not in _COMMANDS:
            return []
        return [mav.MAVLink_command_ack_message(received.message.command, DENIED, 0, 0, received.system, received.component)]

    def news(self, received: ReceivedMessage) -> str | None:
        """Return what a pilot is to be told, None where that sender was told of before; it is logged too, with the cure."""
        sender = (received.system, received.component)
        if sender in self._told or len(self._told) >= _TOLD_MAX:
            return None
        self._told.add(sender)
        _log.warning(
            "MAVLink: %s of %s refused: it is no operator; name its system in %s, or sign the link (decklander keys)",
            received.message.get_type(),
            received.source_text,
            self._setting,
        )
        return f"system {received.system} may not command"


def link_counters(links: Links, refusals: Refusals) -> dict[str, float]:
    """Return what health tells of all links together: their counters, and what was refused, held and not sent."""
    out: dict[str, float] = {}
    for link in links.all:
        for name, n in link.counters.as_dict().items():
            out[name] = out.get(name, 0) + n
    out |= {"peers": sum(link.peers for link in links.all), "impostors": links.access.refused["impostor"]}
    return out | {"refused": refusals.counts.total(), "faults": links.contained.total, "unfit": links.unfit.total()}
