"""Guidance's settings: when it begins, and the controllers' gains and limits; the mission's are in `mission`."""

import math
from typing import Annotated, Literal

from msgspec import Struct

from companion.settings.mission import ConeOptions, LandingLimits, ThesisOptions, TryOptions
from companion.settings.vessel import RendezvousOptions
from estimator.contracts.commands import LandingPlace
from estimator.contracts.geodesy import GeoPoint
from estimator.contracts.keys import CheckedOptions, choice, name, number, text

_AUTO = "auto"


class FollowDeckOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
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

    @property
    def response_by_vehicle(self) -> bool:
        """True if the kind of vehicle decides on the response."""
        return self.response == _AUTO


_TUNED = "tuned in simulation"
_Kp = Annotated[float, number("proportional gain", "1/s", 0.0, 20.0, _TUNED)]
_Ki = Annotated[float, number("integral gain", "1/s^2", 0.0, 10.0, _TUNED)]
_Kd = Annotated[float, number("derivative gain", "1", 0.0, 10.0, _TUNED)]


class HorizontalGains(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Gains from the forward and right error, m, to m/s.

    Raises:
        ValueError: a gain outside its range.
    """

    kp: _Kp = 0.9
    ki: _Ki = 0.05
    kd: _Kd = 0.1


class VerticalGains(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Gains from the height error, m, to m/s.

    Raises:
        ValueError: a gain outside its range.
    """

    kp: _Kp = 1.0
    ki: _Ki = 0.15
    kd: _Kd = 0.1


class HeadingGains(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Gains from the heading error, rad, to rad/s. There is no derivative gain because the estimate has no rate of the heading.

    Raises:
        ValueError: a gain outside its range.
    """

    kp: _Kp = 0.8
    ki: _Ki = 0.0


class PidOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The position controller: limits of what it requests, and where it is soft.

    The defaults suit a vehicle that tilts to follow a velocity command (0.2 s of dead time, then 0.4 s of lag) and is seen
    0.15 s late.
    """

    horizontal: HorizontalGains = HorizontalGains()
    vertical: VerticalGains = VerticalGains()
    heading: HeadingGains = HeadingGains()
    speed_max_m_s: Annotated[
        float, number("largest horizontal velocity; its direction is kept", "m/s", 0.05, 10.0, "1 in the thesis' code")
    ] = 1.0
    climb_max_m_s: Annotated[float, number("largest velocity upward", "m/s", 0.05, 5.0)] = 0.5
    descent_rate_max_m_s: Annotated[float, number("largest velocity downward", "m/s", 0.05, 5.0)] = 0.5
    turn_max_deg_s: Annotated[float, number("largest turn rate", "deg/s", 1.0, 360.0)] = 34.4
    integral_max_m_s: Annotated[
        float,
        number("largest velocity that the integral commands on one axis: the pad's own speed and the wind", "m/s", 0.0, 10.0),
    ] = 0.5
    soft_above_m: Annotated[
        float,
        number(
            "set points higher than this soften the horizontal gains in proportion", "m", 0.1, 100.0, "2.5 in the thesis' code"
        ),
    ] = 2.5
    soft_least: Annotated[
        float,
        number("least fraction of the horizontal gains that remains at any height", "1", 0.01, 1.0, "0.1 in the thesis' code"),
    ] = 0.1
    forget_after_s: Annotated[
        float, number("silence of the estimator after which the integrals start again from zero", "s", 0.1, 60.0)
    ] = 2.0

    @property
    def turn_max_rad_s(self) -> float:
        """The largest turn rate, rad/s."""
        return math.radians(self.turn_max_deg_s)


class ElsewhereOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The place, on land or on a ship at rest, where a drone lands that refused. It needs GNSS; another one holds.

    Raises:
        ValueError: a number outside its range.
    """

    latitude_deg: Annotated[float, number("latitude, north positive", "deg", -90.0, 90.0)] = 0.0
    longitude_deg: Annotated[float, number("longitude, east positive", "deg", -180.0, 180.0)] = 0.0
    height_m: Annotated[
        float,
        number(
            "height over the sea to which it climbs on the way, above all that stands there; it keeps a larger one", "m", 0, 5e3
        ),
    ] = 0.0
    range_max_m: Annotated[float, number("distance beyond which it does not fly there, and holds", "m", 10.0, 50_000.0)] = 1000.0

    @property
    def landing_place(self) -> LandingPlace:
        """The place as a command holds it."""
        return LandingPlace(GeoPoint.of_degrees(self.latitude_deg, self.longitude_deg, self.height_m), self.range_max_m)


class GuidanceOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Guidance: from the estimate to commands.

    Raises:
        ValueError: a number outside its range.
    """

    mission: Annotated[
        Literal["cone", "thesis"],
        choice(
            "the way down: in a cone to a gate over the deck and from there to the contact under full control; or the way points "
            "of the thesis and the vehicle's own landing from the last of them",
            public=True,
        ),
    ] = "cone"
    start: Annotated[
        Literal["automatic", "signal"],
        choice(
            "approach as soon as the vehicle flies and the pad is seen, or only after SIGUSR1 (SIGUSR2 pauses it)", public=True
        ),
    ] = "signal"
    rate_hz: Annotated[float, number("rate of guidance cycles", "Hz", 5.0, 200.0, "controller of the thesis: 100 Hz")] = 50.0
    stale_after_s: Annotated[float, number("age of the newest sighting above which the drone hovers", "s", 0.05, 10.0)] = 0.5
    land_timeout_s: Annotated[
        float,
        number("longest time from the land command to the landing; after it the drone goes around", "s", 1.0, 120.0),
    ] = 6.0
    refused: Annotated[
        Literal["hold", "return", "land elsewhere"],
        choice(
            "what a drone does that refused or gave up, once it is as high as it goes around: hold over the pad; fly back by "
            "the autopilot's own return, to home or a rally point (set one: home may be at sea); or fly to the place "
            "`elsewhere` and land there by the autopilot's own landing. An AR.Drone has neither and holds"
        ),
    ] = "hold"
    elsewhere: ElsewhereOptions = ElsewhereOptions()
    last_charge: Annotated[
        float,
        number(
            "charge at which a drone that refused or gave up and flies nowhere else lands where it is, by its own landing: a "
            "hover ends in a fall; 0 to hover on",
            "1",
            0.0,
            0.5,
        ),
    ] = 0.05
    controller: Annotated[
        str,
        name(
            "the control law: follow_deck (tilt and forecast, down to contact), pid (the thesis' position controller) or "
            "policy (a trained network); or the name that an installed package gives its own",
            64,
            public=True,
        ),
    ] = "follow_deck"
    policy_file: Annotated[
        str,
        text("what the controller policy flies by, as decklander train writes it; empty for the shipped one", 4096, shortest=0),
    ] = ""
    pid: PidOptions = PidOptions()
    follow_deck: FollowDeckOptions = FollowDeckOptions()
    cone: ConeOptions = ConeOptions()
    limits: LandingLimits = LandingLimits()
    tries: TryOptions = TryOptions()
    thesis: ThesisOptions = ThesisOptions()
    rendezvous: RendezvousOptions = RendezvousOptions()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.refused == "land elsewhere" and self.elsewhere == ElsewhereOptions():
            raise ValueError(
                'refused = "land elsewhere" needs a place: set latitude_deg, longitude_deg and height_m of elsewhere'
            )
