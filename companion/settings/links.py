"""The settings of the service's links: the tables [http], [video_stream] and [landing_target]."""

import ipaddress
from typing import Annotated, ClassVar, Literal

from msgspec import Struct

from estimator.contracts.keys import CheckedOptions, choice, number, text, tuning


def is_address(host: str) -> bool:
    """Return whether `host` is an address, and no name."""
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def on_loopback(host: str) -> bool:
    """Return whether only this machine can reach `host`. A name other than localhost may mean any address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class HttpSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """One port for browsers and programs: the operator page, `/metrics` for Prometheus, and `/health`.

    Whoever has the token watches, and commands if there is a page (docs/page.md).

    Raises:
        ValueError: there is no token; others could read it on its way; or a certificate is missing.
    """

    endpoint: Annotated[
        Literal["off", "http", "https"],
        choice(
            "whether there is one; https needs certificate_file and key_file; beyond loopback the page needs https", public=True
        ),
    ] = "off"
    host: Annotated[str, text("address to listen on; one other than loopback needs a token_file", 253, public=True)] = "127.0.0.1"
    port: Annotated[int, number("port to listen on", "port", 1, 65535, public=True)] = 8480
    token_file: Annotated[
        str,
        text(
            "token that a person enters and a program sends as bearer (decklander keys token): a path or "
            '"credential:NAME"; empty for no token, on loopback without a page',
            4096,
            shortest=0,
            public=True,
        ),
    ] = ""
    certificate_file: Annotated[
        str, text("file with the TLS certificate (PEM), and the chain that issued it", 4096, shortest=0, public=True)
    ] = ""
    key_file: Annotated[str, text("file with the private key of the certificate (PEM)", 4096, shortest=0, public=True)] = ""
    page: Annotated[bool, choice("whether the operator page is served", public=True)] = True
    hosts: Annotated[
        str,
        text(
            "further names by which browsers reach the page, separated by commas; addresses, localhost and this computer's own "
            "name are known",
            1000,
            shortest=0,
        ),
    ] = ""
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


class VideoStreamOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The picture for a ground station: H.264 by RTP over UDP (docs/mavlink.md). Whoever is on the way of the packets can watch.

    Raises:
        ValueError: a number is outside its range, or `to` is no address and port.
    """

    to: Annotated[
        str,
        text(
            "receiver, such as 192.168.1.20:5600 (QGroundControl listens on 5600); empty for no stream",
            253,
            shortest=0,
            public=True,
        ),
    ] = ""
    rate_hz: Annotated[float, tuning("largest rate of the pictures", "Hz", 1.0, 60.0, public=True)] = 15.0
    bitrate_kbit_s: Annotated[int, tuning("largest bit rate", "kbit/s", 50, 20_000, public=True)] = 1000
    drawn: Annotated[
        bool, choice("whether the pad and the features that were found are drawn over the picture", public=True, page=True)
    ] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.to:
            host, colon, port = self.to.rpartition(":")
            if not (colon and host and port.isdigit() and 1 <= int(port) <= 65535):
                raise ValueError(f"to must be ADDRESS:PORT, such as 192.168.1.20:5600, got {self.to!r}")

    @property
    def port(self) -> int:
        """The port that a ground station listens on; of no meaning without `to`."""
        return int(self.to.rpartition(":")[2] or 0)


class OutputOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The pad in messages to an autopilot: LANDING_TARGET, TARGET_RELATIVE and DISTANCE_SENSOR (docs/mavlink.md)."""

    rate_hz: Annotated[
        float, tuning("LANDING_TARGET messages a second, at least", "Hz", 1.0, 50.0, "10 to 50 suit ArduPilot", public=True)
    ] = 25.0
    receiver_s: ClassVar[float] = 0.00125
    """Time from a message's arrival until the autopilot uses it (half a period of ArduPilot's 400 Hz)."""
    vision_target_estimator: Annotated[
        bool, choice("whether PX4 runs its vision target estimator, which needs TARGET_RELATIVE too", public=True, page=True)
    ] = False
    ranges: Annotated[
        Literal["auto", "on", "off"],
        choice("whether to send DISTANCE_SENSOR; auto: if ArduPilot's rangefinder is a MAVLink one", public=True, page=True),
    ] = "auto"
    range_rate_hz: Annotated[float, tuning("DISTANCE_SENSOR messages a second", "Hz", 1.0, 50.0)] = 20.0
    range_id: Annotated[int, number("id of the sensor in DISTANCE_SENSOR", "id", 0, 255)] = 0
    ground_clearance_m: Annotated[
        float,
        tuning("reading of a rangefinder while the vehicle is on the ground; ArduPilot does not arm without it", "m", 0.02, 2.0),
    ] = 0.1
