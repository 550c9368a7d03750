"""Join the chunks of an autopilot's long texts. No I/O."""

import re
from typing import NamedTuple

from drivers.mavlink.dialect import Message

CHUNK = 50
"""Characters in a full chunk."""
_CHUNKS_MAX = 20  # chunks of the longest text
LOST = "..."
"""Placeholder for a chunk that did not arrive."""


class _Begun(NamedTuple):
    """A text with some chunks received."""

    number: int
    severity: int
    chunks: dict[int, str]

    def whole(self, last: int) -> str:
        return "".join(self.chunks.get(k, LOST) for k in range(last + 1))


ARMING_REFUSAL = re.compile(r"^(?:\[[^\]]*\]\s*)?(?:PreArm|Arm|Preflight Fail|Arming denied)[:!]\s*(.+)$", re.IGNORECASE)
"""A STATUSTEXT of either stack that says why it does not arm."""


class JoinedTexts:
    """Joins the texts of any number of senders; each has at most one text that is not complete."""

    def __init__(self) -> None:
        self._begun: dict[tuple[int, int], _Begun] = {}

    def on_message(self, message: Message, sender: tuple[int, int]) -> list[tuple[int, str]]:
        """Take a STATUSTEXT; return the texts that it completes, each as (severity, text).

        A text whose last chunk was lost is returned with what has come of it when its sender begins another one.

        Args:
            sender: system and component.
        """
        text, number, at = str(message.text), int(getattr(message, "id", 0)), int(getattr(message, "chunk_seq", 0))
        begun = self._begun.pop(sender, None)
        out = []
        if begun is not None and begun.number != number:
            out.append((begun.severity, begun.whole(max(begun.chunks)) + LOST))
            begun = None
        if number == 0 or at >= _CHUNKS_MAX:
            return [*out, (int(message.severity), text)]
        begun = begun or _Begun(number, int(message.severity), {})
        begun.chunks[at] = text
        if len(text) < CHUNK:
            return [*out, (begun.severity, begun.whole(at))]
        self._begun[sender] = begun
        return out
