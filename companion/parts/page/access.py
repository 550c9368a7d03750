"""Who may use the page: its token, its certificate, and the origin that a browser names."""

import secrets
from collections.abc import Mapping
from types import MappingProxyType
from urllib.parse import urlsplit

from companion.settings import secret_files
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


def same_origin(origin: str | None, host: str | None) -> bool:
    """Return whether the page that opens a connection is our own, by the headers that a browser sets and no script can.

    Source: RFC 6455, section 10.2; OWASP, Cross-Site WebSocket Hijacking.
    """
    if not origin or not host:
        return False
    parts = urlsplit(origin)
    return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower()
