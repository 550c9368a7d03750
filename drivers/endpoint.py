"""Parse the address of a MAVLink link from its URL.

udpin://0.0.0.0:14550            listen; whoever sends is a peer and is answered
udpout://192.168.1.10:14550      send there from a port of our own
tcp://127.0.0.1:5760             connect there
serial:///dev/ttyAMA0:921600     a serial port and its speed
"""

import re
from typing import Literal, get_args

from msgspec import Struct

from estimator.contracts.errors import BadInput

Address = tuple[str, int]
"""A socket's host and port."""
Scheme = Literal["udpin", "udpout", "tcp", "serial"]
_NET = re.compile(r"^(\[[0-9A-Fa-f:.%\w]+\]|[^\[\]:/?#@]+):(\d{1,5})/?$")
_LOOPBACK = ("127.0.0.1", "::1", "localhost")
_SERIAL = re.compile(r"^(/[^:?#]+):(\d{1,8})$")
_HOW = "udpin://ADDRESS:PORT, udpout://HOST:PORT, tcp://HOST:PORT or serial:///dev/NAME:BAUD"


class Endpoint(Struct, frozen=True):
    """One link's address."""

    scheme: Scheme
    host: str
    """The host, or the device file of a serial port."""
    port: int
    """The port, or the speed of a serial port, bit/s."""

    @property
    def is_private(self) -> bool:
        """True if nobody but this computer, or the far end of a cable, can reach it."""
        return self.scheme == "serial" or self.host in _LOOPBACK

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


def parse_endpoint(url: str) -> Endpoint:
    """Return the endpoint that a URL means.

    Raises:
        BadInput: it is not an endpoint; the text names the fault and how one is written.
    """
    scheme, separator, rest = url.strip().partition("://")
    known: tuple[Scheme, ...] = get_args(Scheme)
    found = next((s for s in known if s == scheme), None)
    if not separator or found is None:
        raise BadInput(f"MAVLink link {url!r}: write {_HOW}")
    match = (_SERIAL if found == "serial" else _NET).match(rest)
    if match is None:
        raise BadInput(f"MAVLink link {url!r}: {rest!r} should be {'/dev/NAME:BAUD' if found == 'serial' else 'HOST:PORT'}")
    port = int(match[2])
    if found == "serial":
        if not 1200 <= port <= 12_500_000:
            raise BadInput(f"MAVLink link {url!r}: a speed of {port} bit/s is out of range")
    elif port > 65535 or (port == 0 and found != "udpin"):
        raise BadInput(f"MAVLink link {url!r}: port {port} is out of range")
    return Endpoint(found, match[1].strip("[]"), port)
