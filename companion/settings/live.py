"""The section [foxglove] of the settings."""

from typing import Annotated, Literal

from msgspec import Struct

from companion.settings.addresses import on_loopback
from estimator.contracts.keys import choice, number, text


class FoxgloveSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The flight live in Foxglove or Lichtblick (docs/recordings.md): the channels of a recording, to watch and not to command.

    Raises:
        ValueError: others could watch without a token.
    """

    endpoint: Annotated[Literal["off", "websocket"], choice("whether there is one", public=True)] = "off"
    host: Annotated[str, text("address to listen on; one other than loopback needs a token_file", 253, public=True)] = "127.0.0.1"
    port: Annotated[int, number("port to listen on", "port", 1, 65535, public=True)] = 8765
    token_file: Annotated[
        str,
        text(
            "file with the token that a viewer names in its address, ws://HOST:PORT/?token=...: a path relative to the settings "
            'file, or "credential:NAME" for a systemd credential; empty for no token, on loopback alone',
            4096,
            shortest=0,
            public=True,
        ),
    ] = ""
    origins: Annotated[
        str,
        text(
            "pages that may connect without a token from a browser on this machine, by origin, separated by commas; programs "
            "that are no browser name none",
            4096,
            shortest=0,
        ),
    ] = "https://app.foxglove.dev, file://"
    viewers_max: Annotated[int, number("viewers at a time", "1", 1, 16)] = 4
    frames: Annotated[
        Literal["jpeg", "h264", "none"],
        choice("how the picture is sent: as images; as a video, which takes about a tenth of that; or not at all"),
    ] = "jpeg"
    frame_rate_hz: Annotated[float, number("largest rate of the picture", "Hz", 1.0, 60.0)] = 15.0
    jpeg_quality: Annotated[int, number("JPEG quality of the picture", "1", 50, 95)] = 70

    def __post_init__(self) -> None:
        if self.endpoint != "off" and not self.token_file and not on_loopback(self.host):
            raise ValueError(f"token_file is needed because host ({self.host}) is not a loopback address: others can reach it")
