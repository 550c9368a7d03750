"""Leave out what is damaged in a ULog file, so that its reader takes the rest."""

import struct
from collections.abc import Mapping

from drivers.log_stamps import Tell

_HEAD = 16  # length of the file's header, bytes
_MESSAGE = struct.Struct("<HB")
"""Size and type of a message."""
_IN_ORDER = 3
"""Number of correct messages in a row that ends the search for the next one behind damage."""
_KINDS = frozenset(b"BFIMPQARDLCSO")


def without_damage(data: bytes, tell: Tell) -> bytes:
    """Return a log without the bytes in it that are no messages, as a card that fails leaves them.

    A data message has to be of a topic that was subscribed to, and as long as all of that topic.
    """
    sizes: dict[int, int | None] = {}
    out, at, good = bytearray(data[:_HEAD]), _HEAD, _HEAD
    while at < len(data):
        end = _end_of_message(data, at, sizes)
        if end is None:
            out += data[good:at]
            good = _next_message(data, at + 1, sizes)
            if good == len(data):
                tell(f"damaged: {good - at} bytes at its end (from byte {at}) are no message, or cut short, and were left out")
            else:
                tell(f"damaged: {good - at} bytes from byte {at} on are none of a log and were left out")
            at = good
            continue
        _note(data, at, sizes)
        at = end
    return bytes(out + data[good:at])


def _end_of_message(data: bytes, at: int, sizes: Mapping[int, int | None]) -> int | None:
    """Return where a message ends; None if there is none."""
    if at + _MESSAGE.size > len(data):
        return None
    size, kind = _MESSAGE.unpack_from(data, at)
    end: int = at + _MESSAGE.size + size
    if kind not in _KINDS or end > len(data) or size == 0:
        return None
    if kind == ord("D"):
        number = int.from_bytes(data[at + 3 : at + 5], "little")
        if number not in sizes or sizes[number] not in (None, size):
            return None
    return end


def _note(data: bytes, at: int, sizes: dict[int, int | None]) -> None:
    size, kind = _MESSAGE.unpack_from(data, at)
    if kind == ord("A") and size >= 3:
        sizes[int.from_bytes(data[at + 4 : at + 6], "little")] = None
    elif kind == ord("D"):
        sizes[int.from_bytes(data[at + 3 : at + 5], "little")] = size


def _next_message(data: bytes, at: int, sizes: Mapping[int, int | None]) -> int:
    """Return where messages go on behind damage, the end of the data if they do not."""
    for begin in range(at, len(data) - _MESSAGE.size):
        end: int | None = begin
        for _ in range(_IN_ORDER):
            end = None if end is None else end if end == len(data) else _end_of_message(data, end, sizes)
        if end is not None:
            return begin
    return len(data)
