"""The section [page] of the settings."""

from typing import Annotated, Literal

from msgspec import Struct

from companion.settings.addresses import on_loopback
from estimator.contracts.keys import choice, number, text


class PageSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The operator page (docs/page.md): live picture, state, health and orders in a browser. Whoever has the token commands.

    Raises:
        ValueError: there is no token; others could read it on its way; or a certificate is missing.
    """

    endpoint: Annotated[
        Literal["off", "http", "https"],
        choice(
            "whether there is one; https needs certificate_file and key_file, and is the only one beyond loopback", public=True
        ),
    ] = "off"
    host: Annotated[str, text("address to listen on", 253, public=True)] = "127.0.0.1"
    port: Annotated[int, number("port to listen on", "port", 1, 65535, public=True)] = 8480
    token_file: Annotated[
        str,
        text(
            "file with the token that a person enters (decklander keys token): a path relative to the settings file, or "
            '"credential:NAME" for a systemd credential',
            4096,
            shortest=0,
            public=True,
        ),
    ] = ""
    certificate_file: Annotated[
        str, text("file with the page's own TLS certificate (PEM), and the chain that issued it", 4096, shortest=0, public=True)
    ] = ""
    key_file: Annotated[str, text("file with the private key of the certificate (PEM)", 4096, shortest=0, public=True)] = ""
    hosts: Annotated[
        str,
        text(
            "further names by which browsers reach the page, separated by commas; addresses, localhost and this computer's own "
            "name are known",
            1000,
            shortest=0,
        ),
    ] = ""
    viewers_max: Annotated[int, number("browsers that may watch at a time", "1", 1, 16)] = 4
    picture_rate_hz: Annotated[float, number("largest rate of the live picture", "Hz", 1.0, 60.0)] = 15.0
    picture_codec: Annotated[
        Literal["h264", "jpeg"],
        choice("how the live picture is sent; a browser that cannot decode H.264 gets JPEG, and so does a camera of odd size"),
    ] = "h264"
    bitrate_kbit_s: Annotated[
        int, number("largest rate of the live picture as H.264, if it had 30 pictures a second", "kbit/s", 100, 20_000)
    ] = 2000
    jpeg_quality: Annotated[int, number("quality of the live picture as JPEG", "1", 10, 95)] = 70

    def __post_init__(self) -> None:
        if self.endpoint == "off":
            return
        if not self.token_file:
            raise ValueError("token_file is needed: whoever opens the page could command the vehicle")
        if self.endpoint == "http" and not on_loopback(self.host):
            raise ValueError(f'endpoint must be "https" because others could read the token on its way to host ({self.host})')
        if self.endpoint == "https" and not (self.certificate_file and self.key_file):
            raise ValueError('certificate_file and key_file are needed because endpoint is "https"')
