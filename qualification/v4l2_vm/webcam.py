"""A USB camera as most people have it, in software: YUYV, MJPG and H.264 with exposure, brightness, gain and white balance.

Source: USB Device Class Definition for Video Devices 1.1 (descriptors: section 3, requests: 4, payload headers: 2.4.3.3) and its
payload documents for uncompressed, MJPEG and frame-based video. Frames go by a bulk endpoint, two bytes of header a transfer.
"""

import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from qualification.v4l2_vm.usbip import Plug

CARD = "Decklander Webcam"
INTERVAL = 333_333
"""Frame interval, in 100 ns."""
TRANSFER = 16384
"""Bytes of one bulk transfer: what uvcvideo asks at once from an endpoint of 512 (UVC_MAX_PACKETS)."""
_GUID_TAIL = bytes.fromhex("000010008000 00aa00389b71".replace(" ", ""))
_FRAME = {"YUYV": 5, "MJPG": 7, "H264": 0x11}
"""Subtype of a frame size's descriptor."""
_PROBE = struct.Struct("<HBBIHHHHHIIIBBBB")
"""Probe and commit, table 4-47."""
MANUAL, APERTURE_PRIORITY = 1, 8
_CAMERA, _PROCESSING, _OUTPUT = 1, 2, 3


Image = Callable[[str, tuple[int, int], int], tuple[bytes, bool] | None]


@dataclass(frozen=True, slots=True)
class Format:
    """Format that the camera offers; its place in the list is its index, from 1, and so are those of its sizes."""

    fourcc: str
    sizes: tuple[tuple[int, int], ...]


@dataclass(slots=True)
class Control:
    """One number that the host may read and set."""

    size: int
    low: int
    high: int
    now: int

    def bytes_of(self, value: int) -> bytes:
        return value.to_bytes(self.size, "little", signed=self.low < 0)


class Webcam:
    """Webcam on the bus from `plug` to `unplug`.

    `frame(fourcc, size, n)` makes the n-th frame's bytes and whether the camera marks it as damaged; None leaves it out.
    """

    def __init__(self, formats: tuple[Format, ...], image: Image) -> None:
        self.formats = formats
        self._image = image
        self.mode = Control(1, MANUAL, APERTURE_PRIORITY, APERTURE_PRIORITY)
        self.exposure = Control(4, 1, 5000, 156)
        self.gain = Control(2, 0, 255, 16)
        self.balance, self.auto_balance = Control(2, 2800, 6500, 4000), Control(1, 0, 1, 1)
        self._controls = {
            (_CAMERA, 0x02): self.mode,
            (_CAMERA, 0x04): self.exposure,
            (_PROCESSING, 0x02): Control(2, -64, 64, 0),
            (_PROCESSING, 0x04): self.gain,
            (_PROCESSING, 0x0A): self.balance,
            (_PROCESSING, 0x0B): self.auto_balance,
        }
        self.stubborn = False
        """True if it refuses a new exposure time."""
        self._probe = self._offer(1, 1)
        self._chosen: tuple[str, tuple[int, int]] | None = None
        self._plug: Plug | None = None
        self._feeder: threading.Thread | None = None

    def plug(self) -> None:
        self._chosen = None
        self._plug = Plug(self)
        self._feeder = threading.Thread(target=self._feed, args=(self._plug,), daemon=True)
        self._feeder.start()

    def unplug(self) -> None:
        if self._plug is not None and self._feeder is not None:
            self._plug.pull()
            self._feeder.join(5.0)
            self._plug = None

    def reset(self) -> None:
        """Reset the camera to its state after a power-on."""
        self.mode.now, self.exposure.now = APERTURE_PRIORITY, 156

    def control(self, setup: bytes, data: bytes) -> bytes | None:
        kind, request, value, index, _ = struct.unpack("<BBHHH", setup)
        if kind & 0x60 == 0x20:
            return self._class_request(request, value >> 8, index & 0xFF, index >> 8, data)
        if (kind, request) == (0x80, 6):
            return self._descriptor(value >> 8, value & 0xFF)
        if (kind & 0x7F, request) in ((0, 9), (1, 11), (2, 1)):  # set configuration, set interface, clear halt
            return b""
        return bytes(2) if request == 0 else None

    def _class_request(self, request: int, selector: int, interface: int, entity: int, data: bytes) -> bytes | None:
        if interface == 1:
            return self._stream_request(request, selector, data)
        if (entity, selector) == (0, 2):
            return b"\x02"  # request error code: wrong state
        control = self._controls.get((entity, selector))
        if control is None:
            return None
        if request == 0x01:
            value = int.from_bytes(data, "little", signed=control.low < 0)
            if control is self.exposure and (self.stubborn or self.mode.now != MANUAL):
                return None
            control.now = value
            return b""
        step = MANUAL | APERTURE_PRIORITY if control is self.mode else 1
        answers = {0x81: control.now, 0x82: control.low, 0x83: control.high, 0x84: step, 0x87: control.low}
        if request in answers:
            return control.bytes_of(answers[request])
        return {0x85: struct.pack("<H", control.size), 0x86: b"\x03"}.get(request)

    def _stream_request(self, request: int, selector: int, data: bytes) -> bytes | None:
        if selector not in (1, 2):
            return None
        if request == 0x01:
            asked = _PROBE.unpack(data)
            self._probe = self._offer(asked[1], asked[2])
            if selector == 2:
                chosen = self.formats[self._probe[1] - 1]
                self._chosen = chosen.fourcc, chosen.sizes[self._probe[2] - 1]
            return b""
        if request in (0x81, 0x82, 0x83, 0x87):
            return _PROBE.pack(*self._probe)
        return {0x85: struct.pack("<H", _PROBE.size), 0x86: b"\x03"}.get(request)

    def _offer(self, number: int, size: int) -> tuple[int, ...]:
        """Return the nearest setting to the request."""
        number = min(max(number, 1), len(self.formats))
        sizes = self.formats[number - 1].sizes
        size = min(max(size, 1), len(sizes))
        width, height = sizes[size - 1]
        return (0, number, size, INTERVAL, 0, 0, 0, 0, 0, 2 * width * height, TRANSFER, 48_000_000, 3, 1, 1, 1)

    def _feed(self, plug: Plug) -> None:
        """Frames at the chosen rate, each by as many transfers as it takes; the first bit of the header turns with each."""
        n = 0
        while not plug.gone:
            chosen = self._chosen
            if chosen is None:
                time.sleep(0.01)
                continue
            due = time.monotonic() + 1e-7 * INTERVAL
            made = self._image(*chosen, n)
            if made is not None:
                self._send(plug, *made, n, chosen)
            n += 1
            time.sleep(max(0.0, due - time.monotonic()))

    def _send(self, plug: Plug, data: bytes, marked: bool, n: int, chosen: tuple[str, tuple[int, int]]) -> None:
        flags = 0x80 | n & 1 | 0x40 * marked
        for at in range(0, len(data), TRANSFER - 2):
            last = at + TRANSFER - 2 >= len(data)
            payload = bytes((2, flags | 2 * last)) + data[at : at + TRANSFER - 2]
            # A stream that is begun again begins with a whole frame, not with the rest of this one.
            if not plug.send(payload, lambda: self._chosen is chosen):
                return

    def _descriptor(self, kind: int, number: int) -> bytes | None:
        if kind == 1:
            # A device of several functions (EF 02 01), of a made-up maker.
            return struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0200, 0xEF, 2, 1, 64, 0x1209, 0xDEC4, 0x0100, 1, 2, 3, 1)
        if kind == 2:
            return self._configuration()
        if kind == 3:
            words = [b"\x09\x04", *(text.encode("utf-16-le") for text in ("Decklander", CARD, "0001"))]
            return bytes((len(words[number]) + 2, 3)) + words[number] if number < len(words) else None
        return None

    def _configuration(self) -> bytes:
        header = struct.pack("<BBBHHIBB", 13, 0x24, 1, 0x0110, 0, 48_000_000, 1, 1)
        camera = struct.pack("<BBBBHBBHHHB3s", 18, 0x24, 2, _CAMERA, 0x0201, 0, 0, 0, 0, 0, 3, b"\x0a\0\0")
        processing = struct.pack("<BBBBBHBHBB", 12, 0x24, 5, _PROCESSING, _CAMERA, 0, 2, 0x1241, 0, 0)
        output = struct.pack("<BBBBHBBB", 9, 0x24, 3, _OUTPUT, 0x0101, 0, _PROCESSING, 0)
        units = _with_total(header + camera + processing + output, 5)
        formats = b"".join(_format(number, f) for number, f in enumerate(self.formats, 1))
        count = len(self.formats)
        head = struct.pack("<BBBBHBBBBBBB", 13 + count, 0x24, 1, count, 0, 0x81, 0, _OUTPUT, 0, 0, 0, 1) + bytes(count)
        stream = _with_total(head + formats, 4)
        body = (
            bytes((8, 11, 0, 2, 0x0E, 3, 0, 0))  # both interfaces are one function
            + bytes((9, 4, 0, 0, 0, 0x0E, 1, 0, 0))
            + units
            + bytes((9, 4, 1, 0, 1, 0x0E, 2, 0, 0))
            + stream
            + struct.pack("<BBBBHB", 7, 5, 0x81, 2, 512, 0)
        )
        return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 2, 1, 0, 0x80, 250) + body


def _with_total(descriptors: bytes, at: int) -> bytes:
    return descriptors[:at] + struct.pack("<H", len(descriptors)) + descriptors[at + 2 :]


def _format(number: int, f: Format) -> bytes:
    """Return a format and its frame sizes: payload documents, tables 3-1 and 3-2 of each."""
    count = len(f.sizes)
    if f.fourcc == "H264":
        out = struct.pack("<BBBBB16sBBBBBBB", 28, 0x24, 0x10, number, count, b"H264" + _GUID_TAIL, 0, 1, 0, 0, 0, 0, 1)
    elif f.fourcc == "MJPG":
        out = struct.pack("<11B", 11, 0x24, 6, number, count, 0, 1, 0, 0, 0, 0)
    else:
        out = struct.pack("<BBBBB16s6B", 27, 0x24, 4, number, count, b"YUY2" + _GUID_TAIL, 16, 1, 0, 0, 0, 0)
    for index, (width, height) in enumerate(f.sizes, 1):
        size, bits = 2 * width * height, 16 * width * height * 10_000_000 // INTERVAL
        head = struct.pack("<BBBBBHHII", 30, 0x24, _FRAME[f.fourcc], index, 0, width, height, bits, bits)
        if f.fourcc == "H264":
            out += head + struct.pack("<IBII", INTERVAL, 1, 0, INTERVAL)
        else:
            out += head + struct.pack("<IIBI", size, INTERVAL, 1, INTERVAL)
    return out
