"""Guidance's options: when it begins, the position controller's gains and limits, the planner's way down."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Struct

from companion.guidance.follow_deck_options import FollowDeckOptions
from estimator.contracts.keys import check_ranges, choice, name, number

_TUNED = "tuned in simulation"
_Kp = Annotated[float, number("proportional gain", "1/s", 0.0, 20.0, _TUNED)]
_Ki = Annotated[float, number("integral gain", "1/s^2", 0.0, 10.0, _TUNED)]
_Kd = Annotated[float, number("derivative gain", "1", 0.0, 10.0, _TUNED)]


class HorizontalGains(Struct, frozen=True, forbid_unknown_fields=True):
    """Gains from the forward and right error, m, to m/s.

    Raises:
        ValueError: a gain outside its range.
    """

    kp: _Kp = 0.9
    ki: _Ki = 0.05
    kd: _Kd = 0.1

    def __post_init__(self) -> None:
        check_ranges(self)


class VerticalGains(Struct, frozen=True, forbid_unknown_fields=True):
    """Gains from the height error, m, to m/s.

    Raises:
        ValueError: a gain outside its range.
    """

    kp: _Kp = 1.0
    ki: _Ki = 0.15
    kd: _Kd = 0.1

    def __post_init__(self) -> None:
        check_ranges(self)


class HeadingGains(Struct, frozen=True, forbid_unknown_fields=True):
    """Gains from the heading error, rad, to rad/s. There is no derivative gain because the estimate has no rate of the heading.

    Raises:
        ValueError: a gain outside its range.
    """

    kp: _Kp = 0.8
    ki: _Ki = 0.0

    def __post_init__(self) -> None:
        check_ranges(self)


class PidOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The position controller: limits of what it asks for, and where it is soft.

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


class PlannerOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """The way down: to a point above the pad, straight down from there, then land. Without sight it never descends.

    Raises:
        ValueError: a number outside its range, or two that do not go together.
    """

    speed_m_s: Annotated[float, number("speed of the set point along the way", "m/s", 0.05, 5.0, "thesis section 4.6")] = 0.4
    slow_radius_m: Annotated[
        float,
        number("within this distance of a way point the set point slows down", "m", 0.01, 20.0, "thesis section 4.6"),
    ] = 1.0
    slow_floor: Annotated[
        float,
        number("fraction of the speed that remains at the way point itself", "1", 0.01, 1.0, "0.1 in the thesis' code"),
    ] = 0.1
    lead_m: Annotated[float, number("the set point waits for a drone that is farther behind than this", "m", 0.05, 20.0)] = 0.8
    heading: Annotated[
        Literal["keep", "align"], choice("leave the heading alone, or turn until the nose points along the arrow")
    ] = "keep"
    pad_ahead_m: Annotated[
        float, number("how far ahead of the body the pad is kept, for a camera mounted at the nose", "m", 0.0, 2.0)
    ] = 0.0
    approach_height_m: Annotated[
        float, number("height over the pad of the first way point", "m", 0.3, 50.0, "thesis section 4.6")
    ] = 2.0
    approach_reached_m: Annotated[
        float, number("horizontal distance at which the drone itself counts as there", "m", 0.01, 2.0)
    ] = 0.25
    approach_reached_height_m: Annotated[float, number("and the difference in height", "m", 0.01, 2.0)] = 0.25
    approach_dwell_s: Annotated[float, number("time for which the drone must stay that near", "s", 0.0, 60.0)] = 0.3
    final_height_m: Annotated[
        float, number("height over the pad from which the drone lands by itself", "m", 0.05, 5.0, "thesis section 4.6")
    ] = 0.3
    final_reached_m: Annotated[
        float,
        number(
            "the same for the last way point",
            "m",
            0.01,
            2.0,
            "0.01 in the thesis, where it held for the set point, not the drone",
        ),
    ] = 0.12
    final_reached_height_m: Annotated[float, number("and the difference in height", "m", 0.01, 2.0)] = 0.12
    final_dwell_s: Annotated[float, number("time for which the drone must stay that near", "s", 0.0, 60.0)] = 0.2
    sigma_land_m: Annotated[
        float,
        number("largest horizontal standard deviation of the estimate at which the drone lands", "m", 0.01, 2.0),
    ] = 0.15
    blind_s: Annotated[
        float,
        number(
            "time after the last sight for which the drone may fly level towards the pad by dead reckoning; 0 to hover at once",
            "s",
            0.0,
            30.0,
        ),
    ] = 4.0
    blind_sigma_m: Annotated[
        float,
        number("horizontal standard deviation of the estimate above which the drone hovers without sight", "m", 0.01, 100.0),
    ] = 1.0
    touchdown_s: Annotated[
        float,
        number("time ahead at which the drone must still be near the last way point, at its present velocity", "s", 0.0, 5.0),
    ] = 0.6
    climb_after_s: Annotated[float, number("time without sight of the pad after which the drone climbs", "s", 0.1, 60.0)] = 1.5
    climb_m_s: Annotated[float, number("climb rate after that", "m/s", 0.05, 2.0)] = 0.3
    safe_height_m: Annotated[float, number("height over the pad at which it stops climbing", "m", 0.5, 50.0)] = 2.0
    give_up_after_s: Annotated[
        float,
        number(
            "total time without sight after which the drone hovers and waits for the operator; 5 s of sight reset it",
            "s",
            0.5,
            600.0,
        ),
    ] = 20.0
    try_s: Annotated[
        float, number("longest time of an attempt from the first sight; after it the drone goes around", "s", 5.0, 3600.0)
    ] = 120.0
    descend_s: Annotated[float, number("the same for its last leg, straight down", "s", 2.0, 600.0)] = 45.0
    losses_max: Annotated[int, number("largest number of losses of sight on the last leg of one attempt", "1", 0, 1000)] = 8
    blind_descent_max_m: Annotated[float, number("largest total descent of one attempt without sight", "m", 0.05, 10.0)] = 0.5
    go_arounds_max: Annotated[
        int, number("number of go-arounds after which the drone hovers and waits for the operator", "1", 0, 100)
    ] = 3
    another_pad: Annotated[
        Literal["operator", "automatic"],
        choice(
            "who decides when the pad is suddenly seen in a place that no motion explains: the operator, by beginning again; or, "
            "once a flight and only above safe_height_m, another_pad_s of unbroken sight of one pad alone"
        ),
    ] = "operator"
    another_pad_s: Annotated[float, number("that sight", "s", 1.0, 120.0)] = 5.0
    operator_wait_s: Annotated[
        float,
        number(
            "time for which the drone waits for the operator's decision about another pad before it gives up", "s", 1.0, 3600.0
        ),
    ] = 60.0

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.final_height_m >= self.approach_height_m:
            raise ValueError(
                f"final_height_m ({self.final_height_m:g} m) must be below approach_height_m ({self.approach_height_m:g} m)"
            )
        if self.climb_after_s >= self.give_up_after_s:
            raise ValueError(
                f"climb_after_s ({self.climb_after_s:g} s) must be shorter than give_up_after_s ({self.give_up_after_s:g} s)"
            )


class GuidanceOptions(Struct, frozen=True, forbid_unknown_fields=True):
    """Guidance: from the estimate to commands.

    Raises:
        ValueError: a number outside its range.
    """

    start: Annotated[
        Literal["automatic", "signal"],
        choice("approach as soon as the vehicle flies and the pad is seen, or only after SIGUSR1 (SIGUSR2 pauses it)"),
    ] = "signal"
    rate_hz: Annotated[float, number("rate of guidance cycles", "Hz", 5.0, 200.0, "controller of the thesis: 100 Hz")] = 50.0
    stale_after_s: Annotated[float, number("age of the newest sighting above which the drone hovers", "s", 0.05, 10.0)] = 0.5
    land_timeout_s: Annotated[
        float,
        number("longest time from the land command to the landing; after it the drone goes around", "s", 1.0, 120.0),
    ] = 6.0
    controller: Annotated[
        str,
        name(
            "the control law: follow_deck (tilt and forecast, down to contact), pid (the thesis' position controller), or the "
            "name under which an installed package offers one",
            64,
        ),
    ] = "pid"
    pid: PidOptions = PidOptions()
    follow_deck: FollowDeckOptions = FollowDeckOptions()
    planner: PlannerOptions = PlannerOptions()

    def __post_init__(self) -> None:
        check_ranges(self)
