"""Flight after the outcome: where the vehicle stands on the deck, and how one that is still in the air behaves.

The contact is not the end: feet slide, and a deck that rolls carries a vehicle off. A refused vehicle is in the air, in the wind
that it was refused for, over a ship that goes on.
"""

import math
from typing import Any

import numpy as np
from msgspec import Struct, field

from estimator.contracts.time import MonoNs, after, seconds_between
from sitl.flight.referee import Referee
from sitl.vehicle.airframe import Feet
from sitl.vehicle.vehicle import VehiclePhase
from sitl.world.truth import Truth

STANDS_AFTER_S = 5.0
"""Time after the contact at which the place of a vehicle on the deck is measured."""
WATCHED_S = 60.0
"""Time for which a vehicle is watched that is still in the air."""
_ON_DECK = (VehiclePhase.LANDED, VehiclePhase.EMERGENCY)


class Standing(Struct, frozen=True):
    """The place of a vehicle on the deck some seconds after its contact."""

    after_s: float
    """Time since the contact."""
    on_pad: bool
    """True if all feet are over the pad's disc."""
    centre_on_pad: bool
    """True if the body's origin is."""
    lateral_m: float
    """Distance of the body's origin from the pad's centre, along the deck."""
    p_pad_m: tuple[float, float]
    """Position on the pad: along the arrow, and to starboard of it."""
    yaw_rad: float
    """Heading against the arrow, clockwise from above."""
    slid_m: float
    """Distance from the place of the contact."""

    def as_json(self) -> dict[str, Any]:
        """Return plain values: m, degrees, s."""
        return {
            "on_pad": self.on_pad,
            "centre_on_pad": self.centre_on_pad,
            "lateral_m": round(self.lateral_m, 4),
            "p_pad_m": [round(x, 4) for x in self.p_pad_m],
            "yaw_deg": round(math.degrees(self.yaw_rad), 2),
            "slid_m": round(self.slid_m, 4),
            "after_s": round(self.after_s, 2),
        }

    def in_words(self) -> str:
        """Return one line for people."""
        beside = "" if self.on_pad else ", a foot over the rim" if self.centre_on_pad else ", off the pad"
        return f"stands {100 * self.lateral_m:.1f} cm from the pad's centre, {100 * self.slid_m:.1f} cm from its contact{beside}"


class Aftermath(Struct, frozen=True):
    """Flight of a vehicle that was in the air at the outcome."""

    watched_s: float
    phase: str | None
    """Phase of guidance at the end; None without a service."""
    vehicle_phase: str
    lowest_m: float
    """Lowest height over the pad."""
    highest_m: float
    farthest_m: float
    """Largest horizontal distance from the pad's centre, and that at the end."""
    end_m: float
    contacts: int
    """Number of contacts, with deck or water."""
    in_water: bool
    unsafe: tuple[str, ...]
    """Unsafe events after the outcome, one line each."""
    at_most_m: float = -math.inf
    """Highest height over the pad of the whole flight, as the referee measures it."""
    counts: dict[str, list[float]] = field(default_factory=dict)
    """Counts of the referee over the whole flight."""

    def as_json(self) -> dict[str, Any]:
        """Return plain values: m and s."""
        lengths = {name: round(getattr(self, name), 2) for name in ("lowest_m", "highest_m", "farthest_m", "end_m")}
        return {
            "watched_s": round(self.watched_s, 2),
            "phase": self.phase,
            "vehicle_phase": self.vehicle_phase,
            **lengths,
            "contacts": self.contacts,
            "in_water": self.in_water,
            "unsafe": list(self.unsafe),
        }

    def in_words(self) -> str:
        """Return one line for people."""
        touched = "in the water" if self.in_water else f"{self.contacts} contacts" if self.contacts else "no contact"
        return (
            f"{self.watched_s:.0f} s later: {self.vehicle_phase}, {self.end_m:.1f} m from the pad "
            f"({self.farthest_m:.1f} m at most), {self.lowest_m:.1f} m over it at the lowest, {touched}"
        )


def standing_of(truth: Truth, disc_radius_m: float, feet: Feet) -> Standing | None:
    """Return where a vehicle stands; None where it does not stand on the deck.

    Args:
        truth: the true state, `STANDS_AFTER_S` after the newest contact or later.
        disc_radius_m: radius of the pad.
        feet: the vehicle's.
    """
    touch = truth.touchdown
    if touch is None or touch.surface == "water" or truth.phase not in _ON_DECK:
        return None
    R = truth.R_ned_pad.matrix
    d = R.T @ (truth.p_body_ned - truth.p_pad_ned)
    if float(np.linalg.norm(d - touch.p_body_pad)) > 1e2 or d[2] > 1.0:
        return None
    forward, starboard = float(d[0]), float(d[1])
    lateral_m = math.hypot(forward, starboard)
    slid_m = math.hypot(forward - touch.p_body_pad[0], starboard - touch.p_body_pad[1])
    since_s = seconds_between(touch.at, truth.at)
    at_m = d + feet.corners_m @ (R.T @ truth.R_ned_body.matrix).T
    on_pad = bool(np.hypot(at_m[:, 0], at_m[:, 1]).max() <= disc_radius_m)
    return Standing(since_s, on_pad, lateral_m <= disc_radius_m, lateral_m, (forward, starboard), truth.yaw_rad, slid_m)


class AftermathWatch:
    """Watches a vehicle that is in the air at the outcome.

    Args:
        truth: its state then.
        outcome: in words.
        referee: goes on counting, stepped by its owner.
    """

    def __init__(self, truth: Truth, outcome: str, referee: Referee) -> None:
        self._began, self._known, self._outcome = truth.at, len(truth.contacts), outcome
        self._referee = referee
        self._before = {name for name, count in referee.counts.items() if count.over}
        self._lowest_m, self._highest_m, self._farthest_m = math.inf, -math.inf, 0.0
        self.step(truth)

    @property
    def ends(self) -> MonoNs:
        """Instant at which the watch ends."""
        return after(self._began, WATCHED_S)

    def step(self, truth: Truth) -> None:
        """Note the true state at an instant; call it in order of time."""
        d = truth.d_body_pad_level
        self._lowest_m, self._highest_m = min(self._lowest_m, float(d[2])), max(self._highest_m, float(d[2]))
        self._farthest_m = max(self._farthest_m, float(np.hypot(d[0], d[1])))

    def result(self, truth: Truth, phase: str | None) -> Aftermath:
        """Return what became of it; `phase` is that of guidance, None without a service."""
        self.step(truth)
        new = truth.contacts[self._known :]
        water = any(contact.surface == "water" for contact in new)
        over = {name: count for name, count in self._referee.counts.items() if count.over and name not in self._before}
        d = truth.d_body_pad_level
        return Aftermath(
            seconds_between(self._began, truth.at),
            phase,
            truth.phase.name.lower(),
            self._lowest_m,
            self._highest_m,
            self._farthest_m,
            float(np.hypot(d[0], d[1])),
            len(new),
            water,
            tuple(f"{self._outcome}, and then {count.in_words()}" for count in over.values()),
            self._referee.highest_m,
            self._referee.as_json(),
        )
