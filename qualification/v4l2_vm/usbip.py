"""A USB device in software: Linux' virtual host controller (vhci-hcd) asks it over a socket, as if it were plugged in.

Wire: Linux Documentation/usb/usbip_protocol.rst. Integers are big-endian there, setup packets little-endian as on the bus.
"""

import errno
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
_HIGH_SPEED = 3
_SUBMIT, _UNLINK, _RET_SUBMIT, _RET_UNLINK = 1, 2, 3, 4
_HEADER = struct.Struct(">5I28s")
_STALL = -errno.EPIPE


class Function(Protocol):
    """USB function behind the bus."""

    def control(self, setup: bytes, data: bytes) -> bytes | None:
        """Answer to a request on endpoint 0; None stalls it."""
        ...


class Plug:
    """One device on the controller's port `port`, from plugging in to `pull`."""

    def __init__(self, function: Function, port: int = 0) -> None:
        self._function = function
        self._ours, theirs = socket.socketpair()
        self._lock = threading.Lock()
        self._asked: deque[tuple[int, int]] = deque()
        """(sequence number, bytes wanted) of bulk reads that wait for a frame."""
        self._more = threading.Condition(self._lock)
        self.gone = False
        (CONTROLLER / "attach").write_text(f"{port} {theirs.fileno()} 1 {_HIGH_SPEED}")
        theirs.close()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def pull(self) -> None:
        """Off the bus, in whatever it was doing."""
        with self._lock:
            self.gone = True
            self._more.notify_all()
        self._ours.shutdown(socket.SHUT_RDWR)
        self._thread.join(5.0)
        self._ours.close()

    def send(self, payload: bytes, still: Callable[[], bool], timeout_s: float = 1.0) -> bool:
        """One bulk transfer, as soon as the host requests one.

        False when it does not, when the device is off the bus, or when by then `still` is no more true.
        """
        with self._more:
            if not self._more.wait_for(lambda: self._asked or self.gone, timeout_s) or self.gone or not still():
                return False
            seq, wanted = self._asked.popleft()
            if len(payload) > wanted:
                raise ValueError(f"{len(payload)} bytes for a transfer of {wanted}")
            self._answer(seq, 0, payload)
        return True

    def _serve(self) -> None:
        try:
            while True:
                self._one()
        except OSError:
            pass
        finally:
            with self._lock:
                self.gone = True
                self._more.notify_all()

    def _one(self) -> None:
        command, seq, _, to_host, endpoint, rest = _HEADER.unpack(self._read(_HEADER.size))
        if command == _UNLINK:
            victim = int.from_bytes(rest[:4], "big")
            with self._lock:
                waiting = next((a for a in self._asked if a[0] == victim), None)
                if waiting is not None:
                    self._asked.remove(waiting)
                status = -errno.ECONNRESET if waiting else 0
                self._ours.sendall(_HEADER.pack(_RET_UNLINK, seq, 0, 0, 0, struct.pack(">i24x", status)))
            return
        if command != _SUBMIT:
            raise OSError(errno.EPROTO, f"command {command}")
        _, length, _, _, _, setup = struct.unpack(">I4i8s", rest)
        data = b"" if to_host else self._read(length)
        if endpoint == 0:
            output = self._function.control(setup, data)
            with self._lock:
                self._answer(seq, _STALL if output is None else 0, b"" if output is None else output[:length], len(data))
        else:
            with self._more:
                self._asked.append((seq, length))
                self._more.notify_all()

    def _answer(self, seq: int, status: int, data: bytes, measured_at: int = 0) -> None:
        tail = struct.pack(">5i8x", status, len(data) or measured_at, 0, 0, 0)
        self._ours.sendall(_HEADER.pack(_RET_SUBMIT, seq, 0, 0, 0, tail) + data)

    def _read(self, size: int) -> bytes:
        out = b""
        while len(out) < size:
            part = self._ours.recv(size - len(out))
            if not part:
                raise OSError(errno.ENODEV, "the controller hung up")
            out += part
        return out
