"""Open Linux input devices and query the kernel about them; no other module knows its calls.

Source: linux/input.h (the EVIOC requests), asm-generic/ioctl.h (how a request is numbered; x86, ARM and RISC-V share it).
"""

import array
import fcntl
import os
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, Protocol

from drivers.gamepad.events import AXES, BUTTONS, EV_ABS, EV_KEY, EVENT
from estimator.contracts.errors import SetupImpossible

FOLDER = Path("/dev/input")
_READ_EVENTS = 64
_KEYS_BYTES, _AXES_BYTES, _NAME_BYTES = 96, 8, 256
"""Sizes of the kernel's bit sets: KEY_CNT / 8 and ABS_CNT / 8."""


class AxisRange(NamedTuple):
    """`struct input_absinfo`: the present value of an axis, its range, and the kernel's own filter."""

    value: int
    minimum: int
    maximum: int
    fuzz: int = 0
    flat: int = 0
    resolution: int = 0


class InputDevice(Protocol):
    """The interface of an open device that the driver uses."""

    path: str
    name: str
    axes: frozenset[int]
    buttons: frozenset[int]

    def fileno(self) -> int: ...

    def read(self) -> bytes:
        """Return the events that wait, as bytes; empty if none waits.

        Raises:
            OSError: the device is gone.
        """
        ...

    def axis(self, code: int) -> AxisRange:
        """Return the range and the present value of an axis.

        Raises:
            OSError: the device is gone or has no such axis.
        """
        ...

    def close(self) -> None: ...


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
        try:
            data = os.read(self._file, _READ_EVENTS * EVENT.size)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError(f"{self.path} has ended")
        return data

    def axis(self, code: int) -> AxisRange:
        return AxisRange(*struct.unpack("6i", self._ask(eviocgabs(code), struct.calcsize("6i"))))

    def close(self) -> None:
        os.close(self._file)

    def _ask(self, request: int, size: int) -> bytes:
        answer = array.array("B", bytes(size))
        fcntl.ioctl(self._file, request, answer)
        return answer.tobytes()


def is_gamepad(device: InputDevice) -> bool:
    """Return whether the device has two axes and a button of a gamepad or joystick."""
    return len(device.axes & {AXES["ABS_X"], AXES["ABS_Y"]}) == 2 and bool(device.buttons & set(BUTTONS.values()))


def gamepads(folder: Path = FOLDER) -> Iterator[EventDevice]:
    """Yield each gamepad that is plugged in, open; whoever takes one closes it.

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
        if is_gamepad(device):
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
