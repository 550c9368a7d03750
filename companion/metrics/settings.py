"""The section [metrics] of the settings."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Struct

from companion.settings_keys import choice, number, text


class MetricsSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Health over HTTP: /metrics for Prometheus, /health for anything that wants a yes or no. It has no password."""

    endpoint: Annotated[Literal["off", "http"], choice("whether there is one")] = "off"
    host: Annotated[str, text("address to listen on; other than loopback it is open to whoever can reach it", 253)] = "127.0.0.1"
    port: Annotated[int, number("where to listen", "port", 1, 65535)] = 9464
