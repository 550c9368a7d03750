"""Let one service at a time have a vehicle, and a broker know one service by a name, on this computer.

A service holds each of them by a Unix socket of the abstract kind, which no folder, user or private /tmp divides and which the
kernel closes with its process, however that ends. A second socket's name says who holds it: it can be read of a process that
stands still too. Processes in network namespaces of their own, as most containers, do not meet here.
"""

import hashlib
import os
import re
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import chain
from pathlib import Path

from companion.settings.model import Settings
from drivers.vehicle import Claim
from estimator.contracts.errors import BadInput

_SOCKETS = Path("/proc/net/unix")
_NAME_MAX = 100
"""The longest name of an abstract socket is 107 bytes."""
_DIGITS = 20
_HELD = re.compile(rf"@(decklander [0-9a-f]{{{_DIGITS}}})(?: (\d+) (.*))?$")
_SOMEBODY = "another service"


def claims(settings: Settings) -> list[Claim]:
    """Return what a service of these settings has for itself, as its vehicle by each of its links, or its name at a broker."""
    return [*settings.vehicle.claims(), *chain.from_iterable(table.claims() for table in settings.part_tables())]


@contextmanager
def sole_service(settings: Settings, file: Path) -> Iterator[None]:
    """Hold the vehicle and the broker's name until the block ends; enter it before anything of them is opened.

    Args:
        file: the settings, as another service is to name them.

    Raises:
        BadInput: another living service holds one of them.
    """
    with ExitStack() as held:
        for claim in claims(settings) if sys.platform == "linux" else ():
            own = _name(claim.key)
            free = _bind(held, own)
            if free:
                _bind(held, _label(own, file))
            holders = _holders()
            if free:
                holders.pop(own, None)
            else:
                holders.setdefault(own, _SOMEBODY)
            for name in (own, *map(_name, claim.rivals)):
                if (other := holders.get(name)) is not None:
                    raise BadInput(
                        f"{other} has {claim.what}: end that one first, or {claim.fix}; this one opened nothing, and ends"
                    )
        yield


def _name(key: str) -> str:
    return f"\0decklander {hashlib.sha256(key.encode()).hexdigest()[:_DIGITS]}"


def _label(name: str, file: Path) -> str:
    start, path = f"{name} {os.getpid()} ", os.fsencode(file.resolve())
    room = _NAME_MAX - len(start)
    kept = path if len(path) <= room else b"..." + path[len(path) - room + 3 :]
    return start + kept.decode(errors="ignore")


def _bind(held: ExitStack, name: str) -> bool:
    """Hold an abstract name, and return whether nobody else does."""
    one = held.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    try:
        one.bind(name)
    except OSError:
        return False
    return True


def _holders() -> dict[str, str]:
    """Return who holds what, in words, by the names that are held on this computer."""
    found = dict[str, str]()
    try:
        lines = _SOCKETS.read_text(errors="replace").splitlines()
    except OSError:
        return found
    for line in lines:
        if match := _HELD.search(line):
            name, pid, file = match.groups()
            found[f"\0{name}"] = f"another service, process {pid} with {file}," if pid else found.get(f"\0{name}", _SOMEBODY)
    return found
