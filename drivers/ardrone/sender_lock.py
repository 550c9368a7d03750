"""Make sure that one sender at a time serves a drone, and pass the drone on to a successor.

A sender listens on an abstract Unix socket that is named after user, host and port. A newcomer requests the listener to yield: a
sender whose service is gone answers with its sequence number and ends, so that the newcomer goes on counting; one whose service
is alive refuses. One that does not answer at all is stuck, and is killed. A service that flies a drone marks it as its own by a
second socket, which the kernel closes when the service dies: a newcomer leaves it time to replace a lost sender before it takes
the name. Systems without abstract sockets have no such lock.
"""

import os
import signal
import socket
import struct
import sys
import time

_ASK, _BUSY = b"yield\n", b"busy\n"
_ANSWER_S = 0.5  # time that a living sender gets to answer a successor
_BIND_S = 1.0  # time that the system gets to free a name whose process has ended
_REPLACED_S = 2.0
"""A living service replaces a sender that is lost or stuck within this time, also on a busy machine."""
_CLAIM_AGAIN_S = 0.001  # time between two attempts to take a name
_RECEIVE_TIMEOUT_S = 0.05  # time that a successor gets to send its request
_CREDENTIALS = struct.Struct("3i")
"""The layout of struct ucred: process, user, group."""


def mark(name: str) -> socket.socket | None:
    """Mark a drone as flown by this process until the socket is closed; None if another process has marked it, or none can."""
    if sys.platform != "linux":
        return None
    return _listening(name)


def claim(name: str, marked: str, *, replaces: bool) -> tuple[socket.socket | None, int] | None:
    """Become the sender of that name.

    Args:
        marked: the name of the mark of the service that flies the drone.
        replaces: whether the sender is started by that service, which has lost the one before.

    Returns:
        The listening socket (None if none can be opened) and the sequence number of the predecessor's last command, 0 if
        there was none; None instead of both if a sender with a living service has the name.
    """
    if sys.platform != "linux":
        return None, 0
    sequence, began, yielded = 0, time.monotonic(), replaces
    while True:
        waits = not yielded and time.monotonic() - began < _REPLACED_S and _is_marked(marked)
        if not waits and (listener := _listening(name)) is not None:
            return listener, sequence
        answer = _ask(name, may_kill=not waits)
        if answer == _BUSY:
            return None
        if answer.strip().isdigit():
            sequence, yielded = max(sequence, int(answer)), True
        if time.monotonic() - began > _REPLACED_S + _BIND_S:
            return None, sequence
        time.sleep(_CLAIM_AGAIN_S)


def _listening(name: str) -> socket.socket | None:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(name)
        listener.listen(4)
        listener.setblocking(False)
    except OSError:
        listener.close()
        return None
    return listener


def _is_marked(marked: str) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.setblocking(False)
        try:
            other.connect(marked)
        except BlockingIOError:
            return True  # its process does not accept, and the queue is full
        except OSError:
            return False
    return True


def _ask(name: str, *, may_kill: bool) -> bytes:
    """Ask the holder of the name to yield, and return its answer, empty if there is none."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as other:
        other.settimeout(_ANSWER_S)
        try:
            other.connect(name)
            pid, user = _peer(other)
            if user != os.getuid():
                return b""  # somebody else took the name and has no sequence number of ours
            other.sendall(_ASK)
            return other.recv(32)
        except TimeoutError:
            if may_kill and pid > 1:  # 0 is a process of another container, out of our reach
                os.kill(pid, signal.SIGKILL)
            return b""
        except OSError:
            return b""


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
