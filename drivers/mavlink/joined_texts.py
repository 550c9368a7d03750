"""Join the chunks of long status texts: STATUSTEXT holds 50 characters, MAVLink 2 sends longer texts in several. No I/O.

Source: mavlink.io, STATUSTEXT: `id` is the same in all chunks of a text and 0 in a text of one message; `chunk_seq` counts from
0; a chunk that is not full is the last.
"""

from typing import NamedTuple

from drivers.mavlink.dialect import Message

CHUNK = 50
"""Characters in a full chunk."""
_CHUNKS_MAX = 20
LOST = "..."
"""Placeholder for a chunk that did not arrive."""


class _Begun(NamedTuple):
    """A text with some chunks received."""

    number: int
    severity: int
    chunks: dict[int, str]

    def whole(self, last: int) -> str:
        return "".join(self.chunks.get(k, LOST) for k in range(last + 1))


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
