"""The options of the controller `follow_deck`: the vehicle's response, and the parts of the law that may be left out."""

from typing import Annotated

from msgspec import Struct

from estimator.contracts.keys import check_ranges, choice, number, text

_AUTO = "auto"


class FollowDeckOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The controller that follows the deck.

    Raises:
        ValueError: a number outside its range.
    """

    response: Annotated[
        str,
        text(
            'file of the vehicle\'s response: the name of a shipped one, or a path relative to the settings file; "auto" '
            "takes the one of the kind of vehicle",
            4096,
            public=True,
        ),
    ] = _AUTO
    identify: Annotated[
        bool,
        choice(
            "whether the response is identified in flight: the gains are softer until the delay is known, and a delay that "
            "contradicts the file takes its place",
            public=True,
        ),
    ] = True
    delay_known_s: Annotated[
        float, number("standard deviation up to which the delay of the tilt counts as known", "s", 0.005, 0.2)
    ] = 0.04
    accelerometer: Annotated[
        bool, choice("whether gusts are felt by the accelerometer; without it they show a second later in place and speed")
    ] = True
    delay_line: Annotated[bool, choice("whether commands under way are taken into account")] = True
    forecast: Annotated[bool, choice("whether the deck's motion is followed ahead of time")] = True
    keep_in_view: Annotated[bool, choice("whether the lean is cut so that the pad stays in the picture", public=True)] = True
    tilt_max_deg: Annotated[
        float, number("largest tilt; the response's own limit where that is smaller", "deg", 2.0, 45.0, public=True)
    ] = 45.0
    climb_max_m_s: Annotated[
        float, number("largest vertical speed; the response's own limit where that is smaller", "m/s", 0.1, 5.0, public=True)
    ] = 5.0

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def response_by_vehicle(self) -> bool:
        """True if the kind of vehicle decides on the response."""
        return self.response == _AUTO
