"""The mission's options: the cone, the limits of gate and commit, the attempts, and the way points of the thesis."""

import math
from typing import Annotated, ClassVar, Literal

from estimator.contracts.keys import CheckedOptions, choice, tuning


class ConeOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The way down of the mission "cone": in a cone over the pad to a gate just over the deck, then to the deck.

    Raises:
        ValueError: a number outside its range, or two that do not go together.
    """

    intercept_speed_m_s: Annotated[float, tuning("largest speed with which it flies over the pad", "m/s", 0.1, 10.0)] = 1.5
    descent_rate_m_s: Annotated[float, tuning("rate against the deck on the cone's axis", "m/s", 0.05, 3.0, public=True)] = 0.7
    slope: Annotated[
        float, tuning("radius of the cone over the height; at 1.1 times the radius the drone does not descend", "1", 0.02, 1.0)
    ] = 0.22
    feet_below_m: Annotated[
        float, tuning("distance of the vehicle's feet below the body's origin; 0.045 on an AR.Drone", "m", 0.0, 1.0, public=True)
    ] = 0.045
    feet_aside_m: Annotated[
        float, tuning("distance of the vehicle's feet ahead and aside of the body's origin", "m", 0.0, 1.0, "an AR.Drone's")
    ] = 0.13
    gate_height_m: Annotated[
        float, tuning("height of the feet over the deck at which it waits until every limit holds", "m", 0.1, 3.0, public=True)
    ] = 0.25
    gate_dwell_s: ClassVar[float] = 0.1  # Time for which every limit must have held
    gate_s: ClassVar[float] = 20.0  # Longest wait there in one try; after it the drone goes around
    commit_rate_m_s: Annotated[float, tuning("rate against the deck from the gate to the contact", "m/s", 0.1, 2.0)] = 0.4
    commit_s: Annotated[
        float, tuning("longest time from the gate to a felt contact; after it the drone goes around", "s", 0.5, 30.0)
    ] = 3.0
    no_return_s: ClassVar[float] = 0.3
    """Time to the contact below which neither a tilted deck nor a contradicting sighting ends the commit: a climb would begin
    after the contact; without a fit estimate it stays that long without descending, and goes around if it feels no contact; a
    delay that is identified in flight adds to it."""
    press_s: ClassVar[float] = 0.4
    """Time for which it presses on level after the contact before the motors stop."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.commit_s * self.commit_rate_m_s < 1.5 * self.gate_height_m:
            raise ValueError(
                f"commit_s ({self.commit_s:g} s) is too short for gate_height_m ({self.gate_height_m:g} m) "
                f"at commit_rate_m_s ({self.commit_rate_m_s:g} m/s)"
            )

    @property
    def gate_m(self) -> float:
        """Height of the body's origin over the deck at the gate, m."""
        return self.feet_below_m + self.gate_height_m


class LandingLimits(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Limits for a landing. The gate waits for them; a breach during the commit ends the attempt."""

    error_m: Annotated[
        float,
        tuning(
            "largest distance from the pad's axis at the gate, and with 2 sigma at the contact to come",
            "m",
            0.01,
            2.0,
            public=True,
        ),
    ] = 0.08
    commit_error_m: Annotated[float, tuning("the same in the commit", "m", 0.02, 2.0)] = 0.25
    relative_speed_m_s: Annotated[
        float, tuning("largest speed along the deck expected at the contact, at the gate", "m/s", 0.02, 5.0)
    ] = 0.2
    sigma_m: Annotated[float, tuning("largest horizontal standard deviation of the estimate at the gate", "m", 0.01, 2.0)] = 0.15
    sighting_age_s: ClassVar[float] = 0.3  # Largest age of the newest sighting at the gate beyond the camera's own delay
    commit_sighting_age_s: Annotated[
        float, tuning("the same in the commit, where the pad leaves the camera's view", "s", 0.1, 5.0)
    ] = 1.5
    deck_tilt_gate_deg: Annotated[float, tuning("largest tilt of the deck at the gate", "deg", 0.1, 45.0, public=True)] = 2.5
    deck_tilt_commit_deg: Annotated[
        float, tuning("largest tilt of the deck that is forecast for the contact", "deg", 0.1, 45.0)
    ] = 1.5
    deck_rate_m_s: Annotated[float, tuning("largest vertical speed of the deck at the gate", "m/s", 0.05, 10.0)] = 1.2
    deck_rise_m: Annotated[
        float,
        tuning(
            "how far at most the deck is forecast to rise above a drone that climbs as fast as it can, at the gate", "m", 0.0, 5.0
        ),
    ] = 0.1
    deck_fall_m_s: Annotated[
        float,
        tuning(
            "largest speed at which the deck is forecast to fall between contact and stop of the motors, at the gate: on a "
            "deck that falls nearly as fast as it can descend the drone hardly presses, slides, and is in the air again",
            "m/s",
            0.05,
            10.0,
        ),
    ] = 0.5
    normalized_nis: Annotated[
        float,
        tuning("largest recent mean of the sightings' innovations over their claimed variance, at the gate", "1", 1.0, 100.0),
    ] = 4.0
    time_sigma_s: ClassVar[float] = 0.03  # Largest standard deviation of the frames' time stamps at the gate
    heading_deg: Annotated[
        float, tuning('largest heading off the arrow at the gate if heading is "align"', "deg", 1.0, 180.0, public=True)
    ] = 12.0
    on_pad_s: Annotated[
        float,
        tuning(
            "time for which something that was seen on the pad bars the landing after the pad left the view; 0 to land whatever "
            "lies there",
            "s",
            0.0,
            60.0,
        ),
    ] = 10.0
    wind_wait_s: ClassVar[float] = 20.0
    """Time for which it waits over the pad in a wind that the vehicle's tilt cannot fly (limit less 2.5 standard deviations of
    the gusts); after it the landing is refused."""
    battery: Annotated[
        float,
        tuning(
            "least charge with which a landing begins; one that has begun goes on, after a go-around too",
            "1",
            0.0,
            1.0,
            public=True,
        ),
    ] = 0.1

    @property
    def heading_rad(self) -> float:
        """The largest heading off the arrow, rad."""
        return math.radians(self.heading_deg)


class TryOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Landing attempts: the time of each, the number of go-arounds, and the behaviour without sight.

    Raises:
        ValueError: a number outside its range, or two that do not go together.
    """

    heading: Annotated[
        Literal["keep", "align", "across"],
        choice(
            "keep the heading; turn the nose along the arrow; or turn only in wind, until the lean against it is in the wider "
            "side of the camera's field",
            public=True,
            page=True,
        ),
    ] = "across"
    search_s: Annotated[
        float, tuning("time without any sight of the pad after which it gives up", "s", 1.0, 3600.0, public=True)
    ] = 300.0
    leg_s: Annotated[
        float,
        tuning(
            "longest time of one try over the pad at height, and in the descent, all visits together; after it the drone goes "
            "around",
            "s",
            2.0,
            600.0,
        ),
    ] = 45.0
    try_s: ClassVar[float] = 120.0  # Longest time of a try from the first sight; after it the drone goes around
    landing_s: Annotated[
        float,
        tuning(
            "longest time of the whole landing from the first sight of the pad, all tries together; after it the drone climbs "
            "and gives up, unless it is on its way from the gate to the deck",
            "s",
            5.0,
            36000.0,
        ),
    ] = 180.0
    losses_max: Annotated[int, tuning("largest number of losses of sight below the safe height in one try", "1", 0, 1000)] = 8
    blind_descent_max_m: ClassVar[float] = 0.5  # Largest total descent of one try without sight
    go_arounds_max: Annotated[
        int, tuning("number of go-arounds; after them the drone holds and waits", "1", 0, 100, public=True)
    ] = 5
    safe_height_m: Annotated[float, tuning("height over the pad to which it climbs", "m", 0.5, 50.0, public=True)] = 2.0
    climb_m_s: Annotated[float, tuning("rate against the deck with which it climbs", "m/s", 0.05, 2.0)] = 0.5
    clear_side_deg: Annotated[
        float,
        tuning(
            "the side on which nothing stands, clockwise from the pad's arrow; the drone goes around on it",
            "deg",
            -180.0,
            180.0,
            public=True,
        ),
    ] = 180.0
    clear_side_m: ClassVar[float] = 0.3
    """Distance to that side; the pad has to stay in view from the safe height."""
    blind_s: Annotated[
        float, tuning("time after the newest sight for which it flies over the pad by dead reckoning", "s", 0.0, 30.0)
    ] = 10.0
    blind_sigma_m: Annotated[
        float, tuning("horizontal standard deviation of the estimate above which it no longer flies by it", "m", 0.01, 100.0)
    ] = 1.0
    climb_after_s: Annotated[
        float, tuning("time without sight of the pad, below the safe height, after which it goes around", "s", 0.1, 60.0)
    ] = 1.5
    give_up_after_s: Annotated[
        float, tuning("total time without sight after which it gives up; 5 s of sight reset it", "s", 0.5, 600.0, public=True)
    ] = 20.0
    another_pad: Annotated[
        Literal["operator", "automatic"],
        choice(
            "who decides when the pad is seen in a place that no motion explains: the operator, by beginning again; or, once a "
            "flight and only above safe_height_m, 5 s of unbroken sight of one pad alone",
            public=True,
        ),
    ] = "operator"
    another_pad_s: ClassVar[float] = 5.0
    """Unbroken sight of one pad alone after which another one is taken, if another_pad is "automatic"."""
    operator_wait_s: Annotated[
        float, tuning("longest wait for the operator's decision about another pad", "s", 1.0, 3600.0, public=True)
    ] = 60.0

    ORDER = ("climb_after_s < give_up_after_s",)


class ThesisOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """The way down of the mission "thesis": to a point above the pad, straight down to another, then the vehicle's own landing.

    Raises:
        ValueError: a number outside its range, or two that do not go together.
    """

    speed_m_s: Annotated[float, tuning("speed along the way", "m/s", 0.05, 5.0, "thesis section 4.6")] = 0.4
    pad_ahead_m: Annotated[
        float, tuning("how far ahead of the body the pad is kept, for a camera mounted at the nose", "m", 0.0, 2.0)
    ] = 0.0
    approach_height_m: Annotated[
        float, tuning("height over the pad of the first way point", "m", 0.3, 50.0, "thesis section 4.6")
    ] = 2.0
    approach_reached_m: ClassVar[float] = 0.25
    """Distance, aside and in height, at which the drone itself counts as there."""
    final_height_m: Annotated[
        float, tuning("height over the pad from which the vehicle lands by itself", "m", 0.05, 5.0, "thesis section 4.6")
    ] = 0.3
    final_reached_m: ClassVar[float] = 0.12
    """Such a distance from the last way point (0.01 in the thesis, where it held for the set point)."""
    final_dwell_s: ClassVar[float] = 0.2
    """Time for which the drone must stay that near."""
    touchdown_s: ClassVar[float] = 0.6
    """Time ahead at which the drone must still be near the last way point, at its present velocity."""

    ORDER = ("final_height_m < approach_height_m",)
