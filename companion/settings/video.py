"""The section [video_stream] of the settings."""

from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import check_ranges, choice, number, text


class VideoStreamOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The picture for a ground station: H.264 by RTP over UDP (docs/mavlink.md). Whoever is on the way of the packets can watch.

    Raises:
        ValueError: a number is outside its range, or `to` is no address and port.
    """

    to: Annotated[
        str,
        text(
            "ADDRESS:PORT that it is sent to, such as 192.168.1.20:5600 (QGroundControl listens on 5600); empty for no stream",
            253,
            shortest=0,
            public=True,
        ),
    ] = ""
    rate_hz: Annotated[float, number("largest rate of the pictures", "Hz", 1.0, 60.0, public=True)] = 15.0
    bitrate_kbit_s: Annotated[int, number("largest bit rate", "kbit/s", 50, 20_000, public=True)] = 1000
    drawn: Annotated[bool, choice("whether the pad and the features that were found are drawn over the picture", public=True)] = (
        True
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.to:
            host, colon, port = self.to.rpartition(":")
            if not (colon and host and port.isdigit() and 1 <= int(port) <= 65535):
                raise ValueError(f"to must be ADDRESS:PORT, such as 192.168.1.20:5600, got {self.to!r}")

    @property
    def port(self) -> int:
        """The port that a ground station listens on; of no meaning without `to`."""
        return int(self.to.rpartition(":")[2] or 0)
