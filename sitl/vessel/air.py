"""The air over a ship: wind that grows with height, Dryden's or Kaimal's turbulence, gusts, wakes of superstructure and hull.

The formulae and their sources are the core's, `sitl/core/physics/air.c`.

A scenario's table `[wind]` chooses it.
"""

import math
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from estimator.contracts.keys import choice, number
from sitl.core.abi import DL_GUSTS_MAX
from sitl.core.library import SIM
from sitl.vessel.seakeeping import Hull, Superstructure

_EDGE_SHARE = 0.4
"""Height of the separated flow over the windward edge by that of the hull's side (assumed, see `physics/air.c`)."""
_DECK_TIME_S = 5.0
"""The ship's own velocity is that of the deck, smoothed over this time: waves do not move the wake."""


class GustOnce(Struct, frozen=True):
    """A discrete gust: "1 - cosine" up, some time at its full speed, and down again (MIL-F-8785C, 3.7.1.3)."""

    at_s: float
    rise_s: float
    hold_s: float
    v_ned: tuple[float, float]
    """m/s north and east, on top of the wind."""


class WakingHull(Struct, frozen=True):
    """The side of a hull over which the air separates."""

    freeboard_m: float
    edges_m: tuple[float, float, float, float]
    """Distances of the deck's fore, aft, port and starboard edge from the pad's centre."""


class AirModel(Struct, frozen=True):
    """Model of the air."""

    speed_m_s: float
    """Mean wind 10 m over the water."""
    towards_rad: float
    """Direction to which it blows, clockwise from north."""
    logarithmic: bool = False
    """True if the mean follows the logarithmic profile; otherwise it is the same at all heights."""
    roughness_m: float = 0.0002
    turbulence: Literal["none", "dryden", "kaimal"] = "none"
    gusts: tuple[GustOnce, ...] = ()
    wake: Superstructure | None = None
    hull: WakingHull | None = None
    """The hull that separates the air, None where it does not."""
    pad_m: tuple[float, float] = (0.0, 0.0)
    """The pad's centre forward and to starboard of amidships."""
    pad_yaw_rad: float = 0.0

    def packed(self, step_s: float) -> Any:
        """Return the core's `dl_sim_air_params`.

        Raises:
            ValueError: there are more gusts than the core takes.
        """
        if len(self.gusts) > DL_GUSTS_MAX:
            raise ValueError(f"the air takes {DL_GUSTS_MAX} single gusts, got {len(self.gusts)}")
        made = SIM.new(
            "dl_sim_air_params",
            on=1, logarithmic=self.logarithmic, dryden=self.turbulence == "dryden", kaimal=self.turbulence == "kaimal",
            wake=self.wake is not None, hull_wake=self.hull is not None, gusts=len(self.gusts),
            speed_m_s=self.speed_m_s, along=(math.cos(self.towards_rad), math.sin(self.towards_rad)),
            roughness_m=self.roughness_m, log10m=math.log(10.0 / self.roughness_m), keep_ship=step_s / _DECK_TIME_S,
            pad_yaw=(math.cos(self.pad_yaw_rad), math.sin(self.pad_yaw_rad)),
        )  # fmt: skip
        for place, gust in zip(made.gust, self.gusts, strict=False):
            place.at_s, place.rise_s, place.hold_s, place.v = gust.at_s, gust.rise_s, gust.hold_s, gust.v_ned
        block = self.wake
        if block is not None:
            SIM.fill(
                made,
                block_m=(self.pad_m[0] - block.forward_m, self.pad_m[1] - block.starboard_m),
                block_size=(block.length_m, block.width_m, block.height_m),
                wake_decay=0.32 / math.log(block.height_m / self.roughness_m),
            )  # fmt: skip
        if self.hull is not None:
            edge_m = _EDGE_SHARE * self.hull.freeboard_m
            decay = 0.32 / math.log(max(10.0, edge_m / self.roughness_m))
            SIM.fill(made, deck_m=self.hull.edges_m, edge_m=edge_m, edge_decay=decay)
        return made


EXCLUDES: dict[str, tuple[str, ...]] = {"model": ("gust_sigma_m_s", "gust_time_s")}
"""Keys that take the place of those of a base when a scenario that is built on it says them."""


class DiscreteGust(Struct, frozen=True, forbid_unknown_fields=True):
    """One gust that rises, stays and goes."""

    at_s: Annotated[float, number("time at which the gust begins", "s", 0.0, 36000.0)]
    speed_m_s: Annotated[float, number("speed at its height, in addition to the wind", "m/s", 0.1, 30.0)]
    from_deg: Annotated[float, number("direction from which it blows, clockwise from north", "deg", -360.0, 360.0)]
    rise_s: Annotated[float, number("time of its rise, and of its fall", "s", 0.05, 60.0)] = 1.0
    hold_s: Annotated[float, number("time for which it stays at its height", "s", 0.0, 600.0)] = 2.0


class WindSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """The air around the vehicle."""

    speed_m_s: Annotated[float, number("mean speed 10 m over the water", "m/s", 0.0, 25.0)] = 2.0
    from_deg: Annotated[float, number("direction from which it blows, clockwise from north", "deg", -360.0, 360.0)] = 0.0
    model: Annotated[
        Literal["gauss_markov", "dryden", "kaimal"],
        choice(
            "turbulence: of a given strength everywhere, MIL-F-8785C's at low altitude by wind and height, or Kaimal's over the "
            "roughness of the sea"
        ),
    ] = "gauss_markov"
    gust_sigma_m_s: (
        Annotated[
            float, number("standard deviation of each horizontal component about the mean, 0.4 by default", "m/s", 0.0, 8.0)
        ]
        | None
    ) = None
    gust_time_s: Annotated[float, number("correlation time of the gusts, 2 by default", "s", 0.1, 60.0)] | None = None
    profile: Annotated[
        Literal["uniform", "logarithmic"], choice("the mean is the same at all heights, or grows with the height over the water")
    ] = "uniform"
    roughness_m: Annotated[
        float, number("roughness of the sea's surface, for the profile", "m", 1e-5, 0.05, "open sea, DNV-RP-C205")
    ] = 0.0002
    wake: Annotated[bool, choice("whether the vessel's superstructure slows and stirs the air behind it")] = False
    hull_wake: Annotated[bool, choice("whether the hull's windward edge slows and stirs the air over the deck")] = False
    gusts: Annotated[tuple[DiscreteGust, ...], Meta(max_length=100, description="single gusts, in any order")] = ()

    def __post_init__(self) -> None:
        if self.model != "gauss_markov":
            for name in ("gust_sigma_m_s", "gust_time_s"):
                if getattr(self, name) is not None:
                    raise ValueError(
                        f"{name} belongs to the model gauss_markov: {self.model}'s gusts follow from wind and height"
                    )
        if self.model == "kaimal" and self.profile == "uniform":
            raise ValueError("the model kaimal needs the logarithmic profile, whose roughness its gusts follow")
        if self.profile == "uniform" and self.roughness_m != 0.0002:
            raise ValueError("roughness_m belongs to the logarithmic profile; the profile is uniform")

    @property
    def sigma_m_s(self) -> float:
        """Standard deviation of the Gauss-Markov gusts, which the other model does not have."""
        if self.model != "gauss_markov":
            return 0.0
        return 0.4 if self.gust_sigma_m_s is None else self.gust_sigma_m_s

    @property
    def time_s(self) -> float:
        """Correlation time of the Gauss-Markov gusts."""
        return 2.0 if self.gust_time_s is None else self.gust_time_s

    def air(self, hull: Hull, pad_yaw_rad: float) -> AirModel | None:
        """Return what the air does beyond a uniform wind with Gauss-Markov gusts; None if it does nothing."""
        plain = self.model == "gauss_markov" and self.profile == "uniform"
        if plain and not self.wake and not self.hull_wake and not self.gusts:
            return None
        gusts = tuple(
            GustOnce(
                g.at_s,
                g.rise_s,
                g.hold_s,
                (-g.speed_m_s * math.cos(math.radians(g.from_deg)), -g.speed_m_s * math.sin(math.radians(g.from_deg))),
            )
            for g in self.gusts
        )
        return AirModel(
            self.speed_m_s,
            math.radians(self.from_deg) + math.pi,
            logarithmic=self.profile == "logarithmic",
            roughness_m=self.roughness_m,
            turbulence="none" if self.model == "gauss_markov" else self.model,
            gusts=gusts,
            wake=hull.superstructure if self.wake else None,
            hull=WakingHull(hull.freeboard_m, _edges_m(hull)) if self.hull_wake else None,
            pad_m=hull.d_vessel_pad_m,
            pad_yaw_rad=pad_yaw_rad,
        )


def _edges_m(hull: Hull) -> tuple[float, float, float, float]:
    """Return the distances of the deck's fore, aft, port and starboard edge from the pad's centre, m."""
    forward, starboard = hull.d_vessel_pad_m
    length, beam = (0.5 * size for size in hull.deck_m)
    return length - forward, length + forward, beam + starboard, beam - starboard
