"""The settings of live data for Foxglove: keys of the table [http]."""

from typing import Annotated, Literal

from companion.settings.links import HttpSettings
from estimator.contracts.keys import choice, text


class LiveHttp(HttpSettings, frozen=True, forbid_unknown_fields=True):
    """One port for browsers and programs: the operator page, `/metrics` for Prometheus, `/health`, and Foxglove's live data.

    Whoever has the token watches, and commands if there is a page (docs/page.md).
    """

    foxglove: Annotated[
        bool, choice("whether Foxglove and Lichtblick may watch the flight live, at /live (docs/recordings.md)", public=True)
    ] = False
    origins: Annotated[
        str,
        text(
            "pages that may watch at /live without a token from a browser on this machine, by origin, separated by commas; "
            "programs that are no browser name none",
            4096,
            shortest=0,
        ),
    ] = "https://app.foxglove.dev, file://"
    foxglove_frames: Annotated[
        Literal["jpeg", "h264", "none"],
        choice("how /live sends the picture: as images; as a video, which takes about a tenth of that; or not at all"),
    ] = "jpeg"
