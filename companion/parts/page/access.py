"""Access to the page: a new token, and the origin that a browser names."""

import secrets
import socket
from collections.abc import Collection
from urllib.parse import urlsplit

from companion.settings.links import HttpSettings, is_address

_TOKEN_BYTES = 24


def make_token() -> str:
    """Return a random token of 192 bits, which fits into an address."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def own_names(settings: HttpSettings) -> frozenset[str]:
    """Return the names by which browsers reach the page, in small letters."""
    own = socket.gethostname().lower()
    given = (name.strip().lower().rstrip(".") for name in settings.hosts.split(","))
    return frozenset({"localhost", own, f"{own.partition('.')[0]}.local", settings.host.lower(), *given} - {""})


def refused_origin(origin: str | None, host: str | None, names: Collection[str]) -> str | None:
    """Return why the page that opens a connection is not our own, by the headers that a browser sets and no script can.

    A page of somebody else may have its name point to this computer after it was loaded: then both headers agree, and name a
    host that we are not. An address is nobody else's.

    Args:
        names: the result of `own_names`.

    Source: RFC 6455, section 10.2; OWASP, Cross-Site WebSocket Hijacking and DNS rebinding.
    """
    try:
        parts, called = urlsplit(origin or ""), urlsplit(f"//{host or ''}").hostname
    except ValueError:
        return "this connection belongs to another page"
    if called is None or parts.scheme not in ("http", "https") or parts.netloc.lower() != (host or "").lower():
        return "this connection belongs to another page"
    if called.rstrip(".") in names or is_address(called):
        return None
    return f"this computer does not know itself as {called[:80]!r}: name it in [expert.http] hosts"
