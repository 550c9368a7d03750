"""Access to the page: a new token, and the origin that a browser names, also through a reverse proxy."""

import secrets
import socket
from collections.abc import Collection, Iterator, Mapping
from urllib.parse import urlsplit

from companion.settings.links import HttpSettings, is_address

_TOKEN_BYTES = 24  # random bytes of a token


def make_token() -> str:
    """Return a random token of 192 bits, which fits into an address."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def own_names(settings: HttpSettings) -> frozenset[str]:
    """Return the names by which browsers reach the page, in small letters."""
    own = socket.gethostname().lower()
    given = (name.strip().lower().rstrip(".") for name in settings.hosts.split(","))
    return frozenset({"localhost", own, f"{own.partition('.')[0]}.local", settings.host.lower(), *given} - {""})


_DEFAULT_PORTS = {"http": 80, "https": 443}


def refused_origin(headers: Mapping[str, str], names: Collection[str]) -> str | None:
    """Return why the page that opens a connection is not our own, by the headers that a browser sets and no script can.

    A page of somebody else may have its name point to this computer after it was loaded: then both headers agree, and name a
    host that we are not. An address belongs to one computer. A proxy that has set `Host` to a name of its own gives the browser's
    in `X-Forwarded-Host`, which no script can set on a websocket either.

    Args:
        headers: those of the request, whose names are looked up in any case of letters.
        names: the result of `own_names`.

    Source: RFC 6455, section 10.2; OWASP, Cross-Site WebSocket Hijacking and DNS rebinding.
    """
    origin = headers.get("Origin", "")
    try:
        page = urlsplit(origin)
        default, own = _DEFAULT_PORTS[page.scheme], page.hostname or ""
        port = page.port or default
        asked = {(url.hostname, url.port or default) for url in map(urlsplit, _asked(headers))}
    except (ValueError, KeyError):
        return f"this connection belongs to another page (Origin: {origin[:80]!r})"
    if own and (own, port) in asked:
        known = own.rstrip(".") in names or is_address(own)
        return None if known else f"this computer does not know itself as {own[:80]!r}: name it in [expert.http] hosts"
    host = headers.get("Host", "")[:80]
    return (
        f"this connection belongs to another page: the header Origin has {origin[:80]!r} and Host has {host!r}; "
        "a reverse proxy must pass the browser's Host on with its port (nginx: proxy_set_header Host $http_host)"
    )


def _asked(headers: Mapping[str, str]) -> Iterator[str]:
    """Yield the addresses that the browser may have requested, without a scheme."""
    port = headers.get("X-Forwarded-Port", "").partition(",")[0].strip()
    for name in ("Host", "X-Forwarded-Host"):
        host = headers.get(name, "").partition(",")[0].strip()
        yield f"//{host}"
        if port and urlsplit(f"//{host}").port is None:
            yield f"//{host}:{port}"
