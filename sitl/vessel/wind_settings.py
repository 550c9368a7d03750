"""The table `[wind]` of a scenario, and the air that follows from it."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta, Struct

from estimator.contracts.keys import choice, number
from sitl.vessel.air import AirModel, GustOnce
from sitl.vessel.seakeeping import Hull

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
        Literal["gauss_markov", "dryden"],
        choice("turbulence: of a given strength everywhere, or MIL-F-8785C's at low altitude, by wind and height"),
    ] = "gauss_markov"
    gust_sigma_m_s: (
        Annotated[
            float, number("standard deviation of each horizontal component about the mean, 0.4 unless said", "m/s", 0.0, 8.0)
        ]
        | None
    ) = None
    gust_time_s: Annotated[float, number("correlation time of the gusts, 2 unless said", "s", 0.1, 60.0)] | None = None
    profile: Annotated[
        Literal["uniform", "logarithmic"], choice("the mean is the same at all heights, or grows with the height over the water")
    ] = "uniform"
    roughness_m: Annotated[
        float, number("roughness of the sea's surface, for the profile", "m", 1e-5, 0.05, "open sea, DNV-RP-C205")
    ] = 0.0002
    wake: Annotated[bool, choice("whether the vessel's superstructure slows and stirs the air behind it")] = False
    gusts: Annotated[tuple[DiscreteGust, ...], Meta(max_length=100, description="single gusts, in any order")] = ()

    def __post_init__(self) -> None:
        if self.model == "dryden":
            for name in ("gust_sigma_m_s", "gust_time_s"):
                if getattr(self, name) is not None:
                    raise ValueError(f"{name} belongs to the model gauss_markov: dryden's gusts follow from wind and height")
        if self.profile == "uniform" and self.roughness_m != 0.0002:
            raise ValueError("roughness_m belongs to the logarithmic profile; the profile is uniform")

    @property
    def sigma_m_s(self) -> float:
        """Standard deviation of the Gauss-Markov gusts, which the other model does not have."""
        if self.model == "dryden":
            return 0.0
        return 0.4 if self.gust_sigma_m_s is None else self.gust_sigma_m_s

    @property
    def time_s(self) -> float:
        """Correlation time of the Gauss-Markov gusts."""
        return 2.0 if self.gust_time_s is None else self.gust_time_s

    def air(self, hull: Hull, pad_yaw_rad: float) -> AirModel | None:
        """Return what the air does beyond a uniform wind with Gauss-Markov gusts; None if it does nothing."""
        if self.model == "gauss_markov" and self.profile == "uniform" and not self.wake and not self.gusts:
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
            dryden=self.model == "dryden",
            gusts=gusts,
            wake=hull.superstructure if self.wake else None,
            pad_m=hull.d_vessel_pad_m,
            pad_yaw_rad=pad_yaw_rad,
        )
