"""The events of a Linux input device as the kernel writes them: `struct input_event`, and the codes of gamepads. No I/O.

Source: linux/input.h and linux/input-event-codes.h; the buttons are named by the kernel's gamepad document.
"""

import struct
from typing import NamedTuple

EVENT = struct.Struct("llHHi")
"""Seconds, microseconds, type, code, value; the first two have the size of the kernel's long."""

EV_SYN, EV_KEY, EV_ABS = 0x00, 0x01, 0x03
SYN_REPORT, SYN_DROPPED = 0, 3

AXES: dict[str, int] = {
    "ABS_X": 0x00, "ABS_Y": 0x01, "ABS_Z": 0x02, "ABS_RX": 0x03, "ABS_RY": 0x04, "ABS_RZ": 0x05,
    "ABS_THROTTLE": 0x06, "ABS_RUDDER": 0x07, "ABS_HAT0X": 0x10, "ABS_HAT0Y": 0x11,
}  # fmt: skip
BUTTONS: dict[str, int] = {
    "BTN_SOUTH": 0x130, "BTN_EAST": 0x131, "BTN_NORTH": 0x133, "BTN_WEST": 0x134, "BTN_TL": 0x136, "BTN_TR": 0x137,
    "BTN_TL2": 0x138, "BTN_TR2": 0x139, "BTN_SELECT": 0x13A, "BTN_START": 0x13B, "BTN_MODE": 0x13C, "BTN_THUMBL": 0x13D,
    "BTN_THUMBR": 0x13E, "BTN_DPAD_UP": 0x220, "BTN_DPAD_DOWN": 0x221, "BTN_DPAD_LEFT": 0x222, "BTN_DPAD_RIGHT": 0x223,
    "BTN_TRIGGER": 0x120, "BTN_THUMB": 0x121, "BTN_THUMB2": 0x122, "BTN_TOP": 0x123, "BTN_TOP2": 0x124, "BTN_PINKIE": 0x125,
    "BTN_BASE": 0x126, "BTN_BASE2": 0x127, "BTN_BASE3": 0x128, "BTN_BASE4": 0x129, "BTN_BASE5": 0x12A, "BTN_BASE6": 0x12B,
}  # fmt: skip
_NAMES = {EV_ABS: {code: name for name, code in AXES.items()}, EV_KEY: {code: name for name, code in BUTTONS.items()}}


class InputEvent(NamedTuple):
    """One event of a device."""

    kind: int
    code: int
    value: int

    @property
    def name(self) -> str:
        """The name of the axis or button, or its numbers if it has none here."""
        return _NAMES.get(self.kind, {}).get(self.code, f"{self.kind:#x}/{self.code:#x}")


def events_in(data: bytes) -> tuple[list[InputEvent], bytes]:
    """Return the events in what a device delivered, and the bytes of an event that is not complete yet."""
    whole = len(data) - len(data) % EVENT.size
    return [InputEvent(*fields[2:]) for fields in EVENT.iter_unpack(data[:whole])], data[whole:]
