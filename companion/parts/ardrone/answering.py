"""The AR.Drones that `decklander start` knows: whether one answers, and what stands in its settings."""

import shlex
import socket
import sys
from contextlib import suppress

from drivers.ardrone.navdata import Navdata, decode
from drivers.ardrone.navdata_channel import OPENING
from drivers.ardrone.options import ArDroneOptions
from drivers.vehicle import AnsweringVehicle

_NAVDATA_S = 1.5
"""Time in which an AR.Drone that is in reach answers, s."""
_JOIN = "join the AR.Drone's Wi-Fi: no navdata comes from {}".format
_HOST, _PORT = ArDroneOptions().host, ArDroneOptions().navdata_port


def sends_navdata(host: str) -> bool:
    """Return whether a datagram of navdata comes from an AR.Drone's address: routers have it too, and answer on any port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, suppress(OSError):
        probe.settimeout(_NAVDATA_S)
        probe.connect((host, _PORT))
        probe.send(OPENING)
        return isinstance(decode(probe.recv(4096)), Navdata)
    return False


VEHICLES = (
    AnsweringVehicle(
        "sim",
        "the simulated AR.Drone of this machine (python -m sitl.emulators.ardrone.serve demo)",
        "ardrone",
        "127.0.0.1",
        "sim",
        sends_navdata,
        lambda _: f"start the simulated drone: {shlex.quote(sys.executable)} -m sitl.emulators.ardrone.serve demo",
        simulated=True,
    ),
    AnsweringVehicle(
        "ardrone1",
        "an AR.Drone 1.0, over its Wi-Fi",
        "ardrone",
        _HOST,
        "ardrone1_bottom",
        sends_navdata,
        _JOIN,
        ('model = "1.0"',),
    ),
    AnsweringVehicle(
        "ardrone2",
        "an AR.Drone 2.0, over its Wi-Fi",
        "ardrone",
        _HOST,
        "ardrone2_bottom",
        sends_navdata,
        _JOIN,
        searched=True,
    ),
)
