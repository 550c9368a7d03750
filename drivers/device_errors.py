"""The system's errors in the words of the device that gave them: one number means another thing of a camera than of a file."""

import errno
import socket
from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal

Device = Literal["camera", "serial port", "network", "broker"]

_ANOTHER = "another program has it (fuser -v names it): end that one"
_USB = "the USB transfer fails: look at the cable, the hub and its power"
DEVICE_ERRORS: Mapping[Device, Mapping[int, str]] = MappingProxyType(
    {
        "camera": {
            errno.ENOSPC: 'the USB bus has no bandwidth left for it beside other devices: take camera.format = "MJPG", '
            "a smaller picture, or a port of another bus",
            errno.EBUSY: _ANOTHER,
            errno.EACCES: "this user may not use cameras: add it to the group video",
            errno.EPERM: "this user may not use cameras: add it to the group video, or give the container the device",
            errno.ENODEV: "it was unplugged, or lost its power",
            errno.ENXIO: "it was unplugged, or lost its power",
            errno.EIO: _USB,
            errno.EPROTO: _USB,
            errno.EPIPE: _USB,
            errno.EILSEQ: _USB,
            errno.ENOMEM: "the kernel has no memory for its pictures: take a smaller one, or fewer camera.buffers",
        },
        "serial port": {
            errno.EACCES: "this user may not use serial ports: add it to the group (usermod -aG dialout USER), and log in again",
            errno.EPERM: "this user may not use serial ports: add it to the group dialout, or give the container the device",
            errno.EBUSY: _ANOTHER,
            errno.EAGAIN: _ANOTHER,
            errno.ENODEV: "it was unplugged, or lost its power",
            errno.ENXIO: "it was unplugged, or lost its power",
            errno.EIO: "it was unplugged, or lost its power",
            errno.EPROTO: _USB,
            errno.EPIPE: _USB,
            errno.ENOENT: "there is no such device: look at the cable, and in /dev/serial/by-id for its name",
        },
        "network": {
            errno.ENOBUFS: "the network device takes no more: its radio is too slow, or out of reach",
            errno.ENETUNREACH: "no network leads there: is the Wi-Fi or the cable connected?",
            errno.EHOSTUNREACH: "the other computer does not answer on the network: is it on, and its address right?",
            errno.ENETDOWN: "the network device is down",
            errno.ENODEV: "the network device is gone",
            errno.EPERM: "a firewall of this computer forbids it",
            errno.EACCES: "a broadcast address, or a port that this user may not use",
            errno.EMSGSIZE: "larger than the network takes",
            errno.EADDRINUSE: "another program listens on that port: stop it, or choose another port",
            errno.EADDRNOTAVAIL: "this computer has no such address: listen on 0.0.0.0, or on one that it has",
            errno.ECONNREFUSED: "nothing listens there: start it, or check address and port",
            socket.EAI_NONAME: "there is no host of that name: write its address",
        },
        "broker": {
            errno.ECONNRESET: "it hung up: perhaps one end speaks TLS and the other plain TCP "
            '(--plain-tcp; mqtt.transport = "tcp" or "tls")',
        },
    }
)
"""The words and the cure of each error. Source: errno(3); V4L2 and USB: linux/Documentation/driver-api/usb/error-codes.rst."""


def device_fault(why: OSError, device: Device) -> str:
    """Return an error in one line: what it means of this device, with its cure; else the system's words."""
    number, own = why.errno or 0, DEVICE_ERRORS[device]
    fault = own.get(number) or (DEVICE_ERRORS["network"].get(number) if device == "broker" else None)
    return fault or why.strerror or str(why)
