"""Guidance's settings: when it begins, the vehicle's response, the controllers' gains and limits; the mission's are in `mission`.

A vehicle's response to commands is the delay and course of its tilt, the delay and lag of its climb, and its limits. A tilt
command acts after `delay_s` through a lag (rotors) on a damped oscillator (the attitude loop):

    lag f' = u - f,   a'' = frequency^2 (f - a) - 2 damping frequency a'

with u, f, a as accelerations g tan(tilt). A commanded vertical speed acts after its own delay through a first-order lag.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr

from companion.settings.mission import ConeOptions, LandingLimits, ThesisOptions, TryOptions
from companion.settings.vessel import RendezvousOptions
from estimator.contracts.commands import LandingPlace
from estimator.contracts.errors import refused
from estimator.contracts.geometry import F64, GeoPoint
from estimator.contracts.keys import CheckedOptions, choice, name, number, text, tuning
from estimator.contracts.motion import G_M_S2

_AGREE = 0.02
"""A standard deviation may differ from the covariance's by this much of itself: files round."""
_SYMMETRIC = 1e-3
_LEAST_SIZE = 1e-6
"""Least eigenvalue of the correlation matrix."""
_CURE = "write it as `decklander calibrate vehicle --out` does, or leave it out"
Row2 = tuple[float, float]
Row3 = tuple[float, float, float]


_FREQUENCY_RAD_S, _DAMPING = (1.0, 60.0), (0.2, 3.0)


def within(frequency_rad_s: float, damping: float) -> Row2:
    """Return frequency and damping of a tilt, moved into the limits of a response."""
    (slowest, fastest), (least, most) = _FREQUENCY_RAD_S, _DAMPING
    return min(fastest, max(slowest, frequency_rad_s)), min(most, max(least, damping))


class TiltResponse(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Response of roll and pitch to their commands."""

    delay_s: Annotated[float, number("delay from guidance's command to its first effect", "s", 0.0, 0.6)]
    frequency_rad_s: Annotated[float, number("natural frequency of the attitude loop", "rad/s", *_FREQUENCY_RAD_S)]
    damping: Annotated[float, number("its damping ratio", "1", *_DAMPING)]
    lag_s: Annotated[float, number("first-order lag before it: rotors", "s", 0.0, 0.5)] = 0.0
    max_deg: Annotated[float, number("largest tilt that a controller may ask for", "deg", 2.0, 45.0)] = 20.0
    jerk_max_m_s3: (
        Annotated[
            float,
            number(
                "largest rate of change of the tilt, as an acceleration, that the vehicle follows; left out if it has no limit",
                "m/s^3",
                0.5,
                1000.0,
            ),
        ]
        | None
    ) = None
    drag_1_s: Annotated[
        float, number("deceleration by the air for each m/s through it; it turns a lean into a wind speed", "1/s", 0.02, 3.0)
    ] = 0.35
    delay_sigma_s: Annotated[float, number("standard deviation of delay_s; left out if it is assumed", "s", 0.0, 0.6)] | None = (
        None
    )
    frequency_sigma_rad_s: Annotated[float, number("standard deviation of frequency_rad_s", "rad/s", 0.0, 60.0)] | None = None
    damping_sigma: Annotated[float, number("standard deviation of damping", "1", 0.0, 3.0)] | None = None
    cov_delay_frequency_damping: tuple[Row3, Row3, Row3] | None = None
    """Their covariance, in s, rad/s and 1; it gives the standard deviations that are left out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cov_delay_frequency_damping is not None:
            keys = ("delay_sigma_s", "frequency_sigma_rad_s", "damping_sigma")
            _take_sigmas(self, "cov_delay_frequency_damping", keys, (0.6, 60.0, 3.0))

    @property
    def max_m_s2(self) -> float:
        """The largest tilt as an acceleration."""
        return G_M_S2 * math.tan(math.radians(self.max_deg))

    @property
    def slowness_s(self) -> float:
        """Lag of a slowly changing tilt behind its command: delay, lag and course together."""
        return self.delay_s + self.lag_s + 2.0 * self.damping / self.frequency_rad_s


class ClimbResponse(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Response of the vertical speed to its command."""

    delay_s: Annotated[float, number("delay from guidance's command to its first effect", "s", 0.0, 0.6)]
    lag_s: Annotated[float, number("time constant with which the speed follows", "s", 0.02, 3.0)]
    max_m_s: Annotated[float, number("largest vertical speed that a controller may ask for", "m/s", 0.1, 5.0)] = 1.0
    delay_sigma_s: Annotated[float, number("standard deviation of delay_s; left out if it is assumed", "s", 0.0, 0.6)] | None = (
        None
    )
    lag_sigma_s: Annotated[float, number("standard deviation of lag_s", "s", 0.0, 3.0)] | None = None
    cov_delay_lag: tuple[Row2, Row2] | None = None
    """Covariance of delay_s and lag_s, s^2; it gives the standard deviations that are left out."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.cov_delay_lag is not None:
            _take_sigmas(self, "cov_delay_lag", ("delay_sigma_s", "lag_sigma_s"), (0.6, 3.0))


def _take_sigmas(of: TiltResponse | ClimbResponse, key: str, names: tuple[str, ...], largest: tuple[float, ...]) -> None:
    for member, sigma in zip(names, _checked(key, getattr(of, key), {n: getattr(of, n) for n in names}, largest), strict=True):
        if getattr(of, member) is None:
            force_setattr(of, member, sigma)


class Response(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Response of one kind of vehicle to commands."""

    tilt: TiltResponse
    climb: ClimbResponse


def response_from_mapping(table: dict[str, Any], where: str) -> Response:
    """Return the response that the content of a file describes; `where` begins the error.

    Raises:
        BadInput: a key is missing, unknown, of the wrong type or out of range.
    """
    with refused(where, msgspec.ValidationError, ValueError):
        return msgspec.convert(table, Response)


def _checked(key: str, rows: Sequence[Sequence[float]], given: dict[str, float | None], largest: Sequence[float]) -> list[float]:
    """Return the standard deviations of a covariance, in the order of its rows.

    Args:
        key: the covariance's key in its table.
        rows: the covariance, square.
        given: standard deviations by their keys, in the order of the rows; None where the file gives none.
        largest: largest standard deviation of each.

    Raises:
        ValueError: it is no covariance, or contradicts a given standard deviation.
    """
    cov = np.array(rows, dtype=float)
    _check_numbers(key, cov)
    for k, (variance, most) in enumerate(zip(np.diagonal(cov).tolist(), largest, strict=True)):
        if not 0.0 < variance <= most * most:
            raise ValueError(
                f"{key}: the variance in row {k + 1} must be above 0 and at most {most * most:g}, got {variance:g}; {_CURE}"
            )
    sigma = np.sqrt(np.diagonal(cov))
    _check_correlation(key, cov, cov / np.outer(sigma, sigma))
    for k, (member, value) in enumerate(given.items()):
        if value is not None and abs(value - sigma[k]) > _AGREE * sigma[k]:
            raise ValueError(
                f"{member} is {value:g}, but {key} says {sigma[k]:.4g}, the root of {cov[k, k]:g} in row {k + 1}; leave one out"
            )
    return [float(one) for one in sigma]


def _check_numbers(key: str, cov: F64) -> None:
    for (row, column), value in np.ndenumerate(cov):
        if not math.isfinite(value):
            raise ValueError(f"{key}: row {row + 1}, column {column + 1} must be a finite number, got {value:g}; {_CURE}")


def _check_correlation(key: str, cov: F64, correlation: F64) -> None:
    row, column = (int(i) for i in np.unravel_index(np.abs(correlation - correlation.T).argmax(), cov.shape))
    if abs(correlation[row, column] - correlation[column, row]) > _SYMMETRIC:
        raise ValueError(
            f"{key} must be symmetric: row {row + 1}, column {column + 1} is {cov[row, column]:g} and row {column + 1}, column "
            f"{row + 1} is {cov[column, row]:g}; {_CURE}"
        )
    if float(np.linalg.eigvalsh(0.5 * (correlation + correlation.T)).min()) < _LEAST_SIZE:
        raise ValueError(
            f"{key} must be positive definite: its correlations contradict each other or reach 1, so that a sum of its values "
            f"would have a variance of 0 or less; {_CURE}"
        )


_AUTO = "auto"


class FollowDeckOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The controller that follows the deck."""

    response: Annotated[
        str,
        text(
            'file of the vehicle\'s response: the name of a shipped one, or a path; "auto" takes that of the kind of vehicle',
            4096,
            public=True,
        ),
    ] = _AUTO
    identify: Annotated[
        bool,
        choice(
            "whether the response is identified in flight: softer gains until the delay is known, which replaces the file's if "
            "they contradict",
            public=True,
            page=True,
        ),
    ] = True
    delay_known_s: ClassVar[float] = 0.04
    """Standard deviation up to which the delay of the tilt counts as known."""
    keep_in_view: Annotated[
        bool, choice("whether the lean is cut so that the pad stays in the picture", public=True, page=True)
    ] = True
    tilt_max_deg: Annotated[
        float, tuning("largest tilt; the response's own limit where that is smaller", "deg", 2.0, 45.0, public=True)
    ] = 45.0
    climb_max_m_s: Annotated[
        float, tuning("largest vertical speed; the response's own limit where that is smaller", "m/s", 0.1, 5.0, public=True)
    ] = 5.0

    @property
    def response_by_vehicle(self) -> bool:
        """True if the kind of vehicle decides on the response."""
        return self.response == _AUTO


_TUNED = "tuned in simulation"
_Kp = Annotated[float, tuning("proportional gain", "1/s", 0.0, 20.0, _TUNED)]
_Ki = Annotated[float, tuning("integral gain", "1/s^2", 0.0, 10.0, _TUNED)]
_Kd = Annotated[float, tuning("derivative gain", "1", 0.0, 10.0, _TUNED)]


class HorizontalGains(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Gains from the forward and right error, m, to m/s."""

    kp: _Kp = 0.9
    ki: _Ki = 0.05
    kd: _Kd = 0.1


class VerticalGains(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Gains from the height error, m, to m/s."""

    kp: _Kp = 1.0
    ki: _Ki = 0.15
    kd: _Kd = 0.1


class HeadingGains(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Gains from the heading error, rad, to rad/s. There is no derivative gain: the estimate has no rate of the heading."""

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
        float, tuning("largest horizontal velocity; its direction is kept", "m/s", 0.05, 10.0, "1 in the thesis' code")
    ] = 1.0
    climb_max_m_s: Annotated[float, tuning("largest velocity upward", "m/s", 0.05, 5.0)] = 0.5
    descent_rate_max_m_s: Annotated[float, tuning("largest velocity downward", "m/s", 0.05, 5.0)] = 0.5
    turn_max_deg_s: Annotated[float, tuning("largest turn rate", "deg/s", 1.0, 360.0)] = 34.4
    integral_max_m_s: Annotated[
        float,
        tuning("largest velocity that the integral commands on one axis: the pad's own speed and the wind", "m/s", 0.0, 10.0),
    ] = 0.5
    soft_above_m: ClassVar[float] = 2.5
    """Set points higher than this soften the horizontal gains in proportion (2.5 in the thesis' code)."""
    soft_least: ClassVar[float] = 0.1
    """Least fraction of the horizontal gains that remains at any height (0.1 in the thesis' code)."""
    forget_after_s: ClassVar[float] = 2.0
    """Silence of the estimator after which the integrals start again from zero."""


class ElsewhereOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The place, on land or on a ship at rest, where a drone lands that refused. It needs GNSS; another one holds."""

    latitude_deg: Annotated[float, number("latitude, north positive", "deg", -90.0, 90.0)] = 0.0
    longitude_deg: Annotated[float, number("longitude, east positive", "deg", -180.0, 180.0)] = 0.0
    height_m: Annotated[
        float,
        number(
            "height over the sea to which it climbs on the way, above the ship's masts and all that stands there; it keeps a "
            "larger one; must be given",
            "m",
            0.0,
            5000.0,
        ),
    ] = 0.0
    range_max_m: Annotated[float, number("distance beyond which it does not fly there, and holds", "m", 10.0, 50_000.0)] = 1000.0

    @property
    def landing_place(self) -> LandingPlace:
        """The place as a command holds it."""
        return LandingPlace(GeoPoint.of_degrees(self.latitude_deg, self.longitude_deg, self.height_m), self.range_max_m)


class GuidanceOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Guidance: from the estimate to commands."""

    mission: Annotated[
        Literal["cone", "thesis", "targets"],
        choice(
            "the way down: in a cone to a gate over the deck and on to the contact; the way points of the thesis, then the "
            "vehicle's own landing; or the autopilot's precision landing, led by LANDING_TARGETs alone",
            public=True,
            page=True,
        ),
    ] = "cone"
    mode_changes: Annotated[
        bool,
        choice(
            "whether the mission targets may set the autopilot's modes, landing and hold; otherwise the pilot does", public=True
        ),
    ] = False
    start: Annotated[
        Literal["automatic", "signal"],
        choice("approach once an AR.Drone flies and the pad is seen, or after an order to begin", public=True),
    ] = "signal"
    rate_hz: Annotated[float, tuning("rate of guidance cycles", "Hz", 5.0, 200.0, "controller of the thesis: 100 Hz")] = 50.0
    stale_after_s: Annotated[float, tuning("age of the newest sighting above which the drone hovers", "s", 0.05, 10.0)] = 0.5
    stay_height_m: Annotated[
        float, tuning("height over the pad at which it waits by the order stay", "m", 0.5, 30.0, public=True)
    ] = 3.0
    stay_s: Annotated[float, tuning("longest wait there; after it the drone holds where it is", "s", 1.0, 36000.0)] = 600.0
    land_timeout_s: Annotated[
        float, tuning("longest time from the land command to the landing; after it the drone goes around", "s", 1.0, 120.0)
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
        tuning(
            "charge at which a drone that refused or gave up and flies nowhere else lands where it is, by its own landing: a "
            "hover ends in a fall; 0 to hover on",
            "1",
            0.0,
            0.5,
        ),
    ] = 0.05
    held_ends: Annotated[
        Literal["hold", "land", "return"],
        choice(
            "the end of a drone that a person holds, has aborted or has not sent to the pad yet: land, from limits.battery on "
            "upon a pad in sight, and at last_charge where it is; hold on as ordered, and fall; or return, at last_charge by the "
            "autopilot's own. It is shown in time, and any order calls it off for the flight",
            public=True,
        ),
    ] = "land"
    controller: Annotated[
        str,
        name(
            "the control law: follow_deck (tilt and forecast, down to contact), pid (the thesis'), policy (a trained network), "
            "or the name of one in an installed package",
            64,
            public=True,
            page=True,
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
        if self.mission == "targets" and (self.refused == "land elsewhere" or self.rendezvous.enabled):
            raise ValueError('mission = "targets" flies nowhere: refused = "land elsewhere" and rendezvous need another mission')
        there = self.elsewhere
        if self.refused == "land elsewhere" and not ((there.latitude_deg or there.longitude_deg) and there.height_m):
            raise ValueError(
                'refused = "land elsewhere" needs a place: set latitude_deg, longitude_deg and height_m of elsewhere'
            )
