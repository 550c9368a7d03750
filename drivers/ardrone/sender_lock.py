"""Make sure that one sender at a time serves a drone, and pass the drone on to a successor.

A sender listens on an abstract Unix socket that is named after user, host and port. A newcomer asks the listener to yield: a
sender whose service is gone answers with its sequence number and ends, so that the newcomer goes on counting; one whose service
is alive refuses. One that does not answer at all is stuck, and is killed. Systems without abstract sockets have no such lock.
"""

from __future__ import annotations

import os
import signal
import socket
import struct
import sys
import time

_ASK, _BUSY = b"yield\n", b"busy\n"
_ANSWER_S = 0.5
_BIND_S = 1.0
_RECEIVE_TIMEOUT_S = 0.05
_CREDENTIALS = struct.Struct("3i")
"""The layout of struct ucred: process, user, group."""


def claim(name: str) -> tuple[socket.socket | None, int] | None:
    """Become the sender of that name.

    Returns:
        The listening socket (None if none can be opened) and the sequence number of the predecessor's last command, 0 if
        there was none; None instead of both if a sender with a living service has the name.
    """
    if sys.platform != "linux":
        return None, 0
    sequence, deadline = 0, time.monotonic() + _BIND_S
    while True:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            listener.bind(name)
            listener.listen(4)
            listener.setblocking(False)
            return listener, sequence
        except OSError:
            listener.close()
        answer = _ask(name)
        if answer is None:
            return None
        sequence = max(sequence, answer)
        if time.monotonic() > deadline:
            return None, sequence
        time.sleep(0.001)


def _ask(name: str) -> int | None:
    """Ask the holder of the name to yield; return its sequence number, 0 if it sent none, None if it refuses."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.settimeout(_ANSWER_S)
        try:
            other.connect(name)
            pid, user = _peer(other)
            if user != os.getuid():
                return 0  # somebody else took the name and has no sequence number of ours
            other.sendall(_ASK)
            answer = other.recv(32)
        except TimeoutError:
            if pid > 1:  # 0 is a process of another container, out of our reach
                os.kill(pid, signal.SIGKILL)
            return 0
        except OSError:
            return 0
    if answer == _BUSY:
        return None
    return int(answer) if answer.strip().isdigit() else 0


def yield_to(listener: socket.socket, sequence: int | None) -> bool:
    """Answer one newcomer: with the sequence number, after which this sender ends, or with a refusal if it is None.

    Returns:
        Whether this sender yielded.
    """
    try:
        other, _ = listener.accept()
    except OSError:
        return False
    with other:
        other.settimeout(_RECEIVE_TIMEOUT_S)
        try:
            if _peer(other)[1] != os.getuid() or other.recv(32) != _ASK:
                return False
            other.sendall(_BUSY if sequence is None else b"%d\n" % sequence)
        except OSError:
            return False
    return sequence is not None


def _peer(end: socket.socket) -> tuple[int, int]:
    """Return the process id and the user id at the other end."""
    pid, user, _ = _CREDENTIALS.unpack(end.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
    return pid, user
