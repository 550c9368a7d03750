"""What a host in the settings can be reached from."""

import ipaddress


def on_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`. A name other than localhost may mean any address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
