"""The section [metrics] of the settings."""

from typing import Annotated, Literal

from msgspec import Struct

from companion.settings.addresses import on_loopback
from estimator.contracts.keys import choice, number, text


class MetricsSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Health over HTTP: /metrics for Prometheus, /health for anything that wants a yes or no."""

    endpoint: Annotated[Literal["off", "http"], choice("whether there is one", public=True)] = "off"
    host: Annotated[str, text("address to listen on; one other than loopback needs a token_file", 253, public=True)] = "127.0.0.1"
    port: Annotated[int, number("port to listen on", "port", 1, 65535, public=True)] = 9464
    token_file: Annotated[
        str,
        text(
            "file with the bearer token that a request for /metrics must carry: a path relative to the settings file, or "
            '"credential:NAME" for a systemd credential; empty for no token, on loopback alone',
            4096,
            shortest=0,
            public=True,
        ),
    ] = ""

    def __post_init__(self) -> None:
        if self.endpoint != "off" and not self.token_file and not on_loopback(self.host):
            raise ValueError(f"token_file is needed because host ({self.host}) is not a loopback address: others can reach it")
