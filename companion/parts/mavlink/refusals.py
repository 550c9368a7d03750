"""Refuse commands and parameter writes of unauthorized senders: answer those that are peers, count all, report once. No I/O."""

import logging
from collections import Counter

from companion.parts.mavlink.commands import DENIED
from drivers.mavlink.access import AccessLevel
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.links import Links, ReceivedMessage

_log = logging.getLogger(__name__)

_REPORTED_MAX = 32
_COMMANDS = ("COMMAND_LONG", "COMMAND_INT")


class Refusals:
    """Decides for one component of ours whether a message is obeyed.

    Args:
        setting: the key of the setting that names the operators, for the log.
    """

    def __init__(self, setting: str) -> None:
        self._setting = setting
        self._reported: set[tuple[int, int]] = set()
        self.counts: Counter[str] = Counter()
        """The numbers of refused messages, by message name."""

    def refuses(self, received: ReceivedMessage, us: tuple[int, int]) -> bool:
        """Return whether this message requests something of us (system, component) that its sender is not allowed."""
        message, name = received.message, received.message.get_type()
        if received.access_level >= AccessLevel.OPERATOR or name not in (*_COMMANDS, "PARAM_SET"):
            return False
        if (message.target_system, message.target_component) != us:
            return False
        self.counts[name] += 1
        return True

    def answer(self, received: ReceivedMessage) -> list[Message]:
        """Return the answer to a refused command; a refused parameter is answered elsewhere, with its value in force."""
        if received.access_level < AccessLevel.PEER or received.message.get_type() not in _COMMANDS:
            return []
        return [mav.MAVLink_command_ack_message(received.message.command, DENIED, 0, 0, received.system, received.component)]

    def text_for(self, received: ReceivedMessage) -> str | None:
        """Return the text for the pilot, or None if that sender was reported before; log the refusal together with its fix."""
        sender = (received.system, received.component)
        if sender in self._reported or len(self._reported) >= _REPORTED_MAX:
            return None
        self._reported.add(sender)
        _log.warning(
            "MAVLink: %s of %s refused: it is no operator; name its system in %s, or sign the link (decklander keys)",
            received.message.get_type(),
            received.source_text,
            self._setting,
        )
        return f"system {received.system} may not command"


def link_counters(links: Links, refusals: Refusals) -> dict[str, float]:
    """Return the counters of all links together for health, and the numbers of refusals, contained faults, unsent messages."""
    out: dict[str, float] = {}
    for link in links.all:
        for name, n in link.counters.as_dict().items():
            out[name] = out.get(name, 0) + n
    out |= {"peers": sum(link.peers for link in links.all), "impostors": links.access.refused["impostor"]}
    return out | {"refused": refusals.counts.total(), "faults": links.contained.total, "unfit": links.unfit.total()}
