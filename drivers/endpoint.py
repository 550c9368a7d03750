"""Parse the address of a MAVLink link from its URL.

udpin://0.0.0.0:14550            listen; each sender is a peer and is answered
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
_GROUP = re.compile(r"255\.255\.255\.255$|(?:22[4-9]|23\d)\.\d+\.\d+\.\d+$|\[[Ff][Ff]")
ONE_PEER = "name its own address, or listen with udpin://0.0.0.0:PORT where it sends by itself"
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
        """True if only this computer, or the far end of a cable, can reach it."""
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
    elif _GROUP.match(match[1]):
        raise BadInput(f"MAVLink link {url!r}: that is a broadcast or multicast address, and a link has one peer: {ONE_PEER}")
    elif port > 65535 or (port == 0 and found != "udpin"):
        raise BadInput(f"MAVLink link {url!r}: port {port} is out of range")
    return Endpoint(found, match[1].strip("[]"), port)


_CAN = re.compile(r"can://(?:([a-z_0-9]+):)?([\w./-]+)")
_BUS_HOW = "can://INTERFACE, tcp://HOST:PORT, serial:///dev/NAME:BAUD or signalk://HOST:PORT"


class BusAddress(Struct, frozen=True):
    """Address of a ship's network.

    can://can0                       an interface of Linux (SocketCAN); can://slcan:/dev/ttyACM0 is another one of python-can
    tcp://192.168.1.6:1457           a gateway, canboat's n2kd, or the TCP stream of Signal K
    serial:///dev/ttyUSB0:115200     an Actisense NGT-1, or a gateway that sends lines
    signalk://192.168.1.7:3000       a Signal K server, by WebSocket
    """

    text: str
    can: tuple[str, str] | None = None
    """Name of python-can's interface, and the channel."""
    wire: Endpoint | None = None
    signalk: Endpoint | None = None


def parse_bus(url: str) -> BusAddress:
    """Return the address that a setting means.

    Raises:
        ValueError: it is none; the text says how one is written.
    """
    if (found := _CAN.fullmatch(url)) is not None:
        return BusAddress(url, can=(found[1] or "socketcan", found[2]))
    scheme, _, rest = url.partition("://")
    try:
        if scheme not in ("tcp", "serial", "signalk"):
            raise BadInput(url)
        endpoint = parse_endpoint(f"{'tcp' if scheme == 'signalk' else scheme}://{rest}")
    except BadInput:
        raise ValueError(f"bus must be {_BUS_HOW}, found {url!r}") from None
    return BusAddress(url, signalk=endpoint) if scheme == "signalk" else BusAddress(url, wire=endpoint)
