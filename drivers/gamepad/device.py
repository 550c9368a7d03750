"""Open Linux input devices and query the kernel about them; no other module knows its calls.

Source: linux/input.h (the EVIOC requests, `struct input_event`), linux/input-event-codes.h (the codes; buttons are named by the
kernel's gamepad document), asm-generic/ioctl.h (how a request is numbered; x86, ARM and RISC-V share it).
"""

import array
import fcntl
import os
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from estimator.contracts.errors import SetupImpossible

EVENT = struct.Struct("llHHi")
"""Seconds, microseconds, type, code, value; the first two have the size of the kernel's long."""

EV_SYN = 0x00
"""Kind of an event that ends or interrupts a report (input-event-codes.h)."""
EV_KEY = 0x01
"""Kind of an event of a button."""
EV_ABS = 0x03
"""Kind of an event of an axis."""
SYN_REPORT = 0
"""Code of an EV_SYN that ends a report."""
SYN_DROPPED = 3
"""Code of an EV_SYN after which events are missing."""

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
_READ_EVENTS = 64  # events that are read at once
_KEYS_BYTES = 96  # size of the kernel's bit set of buttons, KEY_CNT / 8
_AXES_BYTES = 8  # size of the kernel's bit set of axes, ABS_CNT / 8
_NAME_BYTES = 256  # longest name of a device that is read


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


FOLDER = Path("/dev/input")


class AxisRange(NamedTuple):
    """`struct input_absinfo`: the present value of an axis, its range, and the kernel's own filter."""

    value: int
    minimum: int
    maximum: int
    fuzz: int = 0
    flat: int = 0
    resolution: int = 0


class EventDevice:
    """An open event device.

    Raises:
        OSError: it cannot be opened or is no event device.
        SetupImpossible: permission is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = str(path)
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except PermissionError as why:
            raise SetupImpossible(
                f"gamepad {path}: no permission; the user must be in the group that owns it (usually input)"
            ) from why
        try:
            self.name = self._ask(eviocgname(_NAME_BYTES), _NAME_BYTES).split(b"\0")[0].decode(errors="replace")
            self.axes = _bits(self._ask(eviocgbit(EV_ABS, _AXES_BYTES), _AXES_BYTES))
            self.buttons = _bits(self._ask(eviocgbit(EV_KEY, _KEYS_BYTES), _KEYS_BYTES))
            with suppress(OSError):
                fcntl.ioctl(self._file, EVIOCSCLOCKID, struct.pack("i", time.CLOCK_MONOTONIC))
        except BaseException:
            os.close(self._file)
            raise

    def fileno(self) -> int:
        return self._file

    def read(self) -> bytes:
        """Return the events that wait, as bytes; empty if none waits.

        Raises:
            OSError: the device is gone.
        """
        try:
            data = os.read(self._file, _READ_EVENTS * EVENT.size)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(f"{self.path} has ended")
        return data

    def axis(self, code: int) -> AxisRange:
        """Return the range and the present value of an axis.

        Raises:
            OSError: the device is gone or has no such axis.
        """
        return AxisRange(*struct.unpack("6i", self._ask(eviocgabs(code), struct.calcsize("6i"))))

    def close(self) -> None:
        os.close(self._file)

    def _ask(self, request: int, size: int) -> bytes:
        answer = array.array("B", bytes(size))
        fcntl.ioctl(self._file, request, answer)
        return answer.tobytes()


def gamepads(folder: Path = FOLDER) -> Iterator[EventDevice]:
    """Yield each gamepad that is plugged in, open; the caller closes it.

    Raises:
        SetupImpossible: permission is missing for every device there is.
    """
    refused: SetupImpossible | None = None
    opened = 0
    for path in sorted(folder.glob("event*"), key=lambda p: (len(p.name), p.name)):
        try:
            device = EventDevice(path)
        except SetupImpossible as why:
            refused = why
            continue
        except OSError:
            continue
        opened += 1
        # Two axes and a button of a gamepad or joystick.
        if {AXES["ABS_X"], AXES["ABS_Y"]} <= device.axes and device.buttons & set(BUTTONS.values()):
            yield device
        else:
            device.close()
    if refused is not None and not opened:
        raise refused


def _request(direction: int, number: int, size: int) -> int:
    return direction << 30 | size << 16 | ord("E") << 8 | number


def eviocgname(size: int) -> int:
    """Return the request for the device's name."""
    return _request(2, 0x06, size)


def eviocgbit(kind: int, size: int) -> int:
    """Return the request for the codes that the device has of one event type."""
    return _request(2, 0x20 + kind, size)


def eviocgabs(axis: int) -> int:
    """Return the request for the range and the value of an axis."""
    return _request(2, 0x40 + axis, struct.calcsize("6i"))


EVIOCSCLOCKID = _request(1, 0xA0, struct.calcsize("i"))


def _bits(data: bytes) -> frozenset[int]:
    return frozenset(8 * n + bit for n, byte in enumerate(data) for bit in range(8) if byte >> bit & 1)
