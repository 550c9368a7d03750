"""Reach of the hosts in the settings: this computer, a private network or everywhere."""

import ipaddress


def is_address(host: str) -> bool:
    """Return whether `host` is an address, and no name."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def on_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`. A name other than localhost may mean any address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
