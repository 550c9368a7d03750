"""Access to the page: its token, its certificate, and the origin that a browser names."""

import secrets
import socket
from collections.abc import Collection, Mapping
from types import MappingProxyType
from urllib.parse import urlsplit

from companion.settings import secret_files
from companion.settings.addresses import is_address
from companion.settings.page import PageSettings
from estimator.contracts.errors import BadInput

HEADERS: Mapping[str, str] = MappingProxyType(
    {
        "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
        "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        "Server": "decklander",
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
        "Referrer-Policy": "no-referrer",
        "Cross-Origin-Opener-Policy": "same-origin",
        "Cross-Origin-Embedder-Policy": "require-corp",
        "Cross-Origin-Resource-Policy": "same-origin",
        "Permissions-Policy": "camera=(), microphone=(), geolocation=(), usb=(), serial=(), gamepad=(self)",
        "Cache-Control": "no-store",
    }
)
"""The headers of every answer: nothing of another host is loaded, and no other page may frame, read or script this one."""
_TOKEN_BYTES = 24


def make_token() -> str:
    """Return a random token of 192 bits, which fits into an address."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def token_of(settings: PageSettings) -> bytes:
    """Return the page's token.

    Raises:
        BadInput: the file cannot be read, or holds no token.
    """
    token = secret_files.token(settings.token_file, "page", "token_file")
    if token is None:
        raise BadInput("page.token_file: is not set")
    return token


def own_names(settings: PageSettings) -> frozenset[str]:
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
    return f"this computer does not know itself as {called[:80]!r}: name it in [expert.page] hosts"
