"""The section [http] of the settings."""

from typing import Annotated, Literal

from msgspec import Struct

from companion.settings.addresses import on_loopback
from estimator.contracts.keys import choice, number, text


class HttpSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """One port for browsers and programs: the operator page, `/metrics` for Prometheus, `/health`, and Foxglove's live data.

    Whoever has the token watches, and commands if there is a page (docs/page.md).

    Raises:
        ValueError: there is no token; others could read it on its way; or a certificate is missing.
    """

    endpoint: Annotated[
        Literal["off", "http", "https"],
        choice(
            "whether there is one; https needs certificate_file and key_file, and the page beyond loopback needs https",
            public=True,
        ),
    ] = "off"
    host: Annotated[str, text("address to listen on; one other than loopback needs a token_file", 253, public=True)] = "127.0.0.1"
    port: Annotated[int, number("port to listen on", "port", 1, 65535, public=True)] = 8480
    token_file: Annotated[
        str,
        text(
            "file with the token that a person enters and a program sends as bearer (decklander keys token): a path relative to "
            'the settings file, or "credential:NAME" for a systemd credential; empty for no token, on loopback without a page',
            4096,
            shortest=0,
            public=True,
        ),
    ] = ""
    certificate_file: Annotated[
        str, text("file with the TLS certificate (PEM), and the chain that issued it", 4096, shortest=0, public=True)
    ] = ""
    key_file: Annotated[str, text("file with the private key of the certificate (PEM)", 4096, shortest=0, public=True)] = ""
    page: Annotated[bool, choice("whether the operator page is served, by which the token commands", public=True)] = True
    foxglove: Annotated[
        bool, choice("whether Foxglove and Lichtblick may watch the flight live, at /live (docs/recordings.md)", public=True)
    ] = False
    hosts: Annotated[
        str,
        text(
            "further names by which browsers reach the page, separated by commas; addresses, localhost and this computer's own "
            "name are known",
            1000,
            shortest=0,
        ),
    ] = ""
    origins: Annotated[
        str,
        text(
            "pages that may watch at /live without a token from a browser on this machine, by origin, separated by commas; "
            "programs that are no browser name none",
            4096,
            shortest=0,
        ),
    ] = "https://app.foxglove.dev, file://"
    viewers_max: Annotated[int, number("browsers and programs that may watch at a time", "1", 1, 32)] = 8
    picture_rate_hz: Annotated[float, number("largest rate of the live picture", "Hz", 1.0, 60.0)] = 15.0
    picture_codec: Annotated[
        Literal["h264", "jpeg"],
        choice("how the page's picture is sent; a browser that cannot decode H.264 gets JPEG, and so does a camera of odd size"),
    ] = "h264"
    bitrate_kbit_s: Annotated[
        int, number("largest rate of the page's picture as H.264, if it had 30 pictures a second", "kbit/s", 100, 20_000)
    ] = 2000
    jpeg_quality: Annotated[int, number("quality of the live picture as JPEG", "1", 10, 95)] = 70
    foxglove_frames: Annotated[
        Literal["jpeg", "h264", "none"],
        choice("how /live sends the picture: as images; as a video, which takes about a tenth of that; or not at all"),
    ] = "jpeg"

    def __post_init__(self) -> None:
        if self.endpoint == "off":
            return
        if self.page and not self.token_file:
            raise ValueError("token_file is needed: whoever opens the page could command the vehicle (or set page = false)")
        if not self.token_file and not on_loopback(self.host):
            raise ValueError(f"token_file is needed because host ({self.host}) is not a loopback address: others can reach it")
        if self.page and self.endpoint == "http" and not on_loopback(self.host):
            raise ValueError(f'endpoint must be "https" because others could read the token on its way to host ({self.host})')
        if self.endpoint == "https" and not (self.certificate_file and self.key_file):
            raise ValueError('certificate_file and key_file are needed because endpoint is "https"')
