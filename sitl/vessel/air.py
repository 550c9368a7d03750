"""The air over a ship: wind that grows with height, Dryden's turbulence, discrete gusts, and the wake of the superstructure.

The formulae and their sources are the core's, `sitl/core/physics/air.c`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from sitl.core.abi import GUSTS_MAX
from sitl.native import Packed, write
from sitl.vessel.seakeeping import Superstructure

_DECK_TIME_S = 5.0
"""The ship's own velocity is that of the deck, smoothed over this time: waves do not move the wake."""


@dataclass(frozen=True, slots=True)
class GustOnce:
    """A discrete gust: "1 - cosine" up, some time at its full speed, and down again (MIL-F-8785C, 3.7.1.3)."""

    at_s: float
    rise_s: float
    hold_s: float
    v_ned: tuple[float, float]
    """m/s north and east, on top of the wind."""


@dataclass(frozen=True, slots=True)
class AirModel:
    """What the air is like."""

    speed_m_s: float
    """Mean wind 10 m over the water."""
    towards_rad: float
    """Where it blows to, clockwise from north."""
    logarithmic: bool = False
    """Whether the mean follows the logarithmic profile; else it is the same at all heights."""
    roughness_m: float = 0.0002
    dryden: bool = False
    gusts: tuple[GustOnce, ...] = ()
    wake: Superstructure | None = None
    pad_m: tuple[float, float] = (0.0, 0.0)
    """The pad's centre forward and to starboard of amidships."""
    pad_yaw_rad: float = 0.0

    def packed(self, step_s: float) -> Packed:
        """Return the core's `air_params`.

        Raises:
            ValueError: there are more gusts than the core takes.
        """
        if len(self.gusts) > GUSTS_MAX:
            raise ValueError(f"the air takes {GUSTS_MAX} single gusts, got {len(self.gusts)}")
        gusts = [x for g in self.gusts for x in (g.at_s, g.rise_s, g.hold_s, *g.v_ned)]
        made = Packed(
            "air_params",
            on=1, logarithmic=self.logarithmic, dryden=self.dryden, wake=self.wake is not None, gusts=len(self.gusts),
            speed_m_s=self.speed_m_s, along=(math.cos(self.towards_rad), math.sin(self.towards_rad)),
            roughness_m=self.roughness_m, log10m=math.log(10.0 / self.roughness_m), keep_ship=step_s / _DECK_TIME_S,
            pad_yaw=(math.cos(self.pad_yaw_rad), math.sin(self.pad_yaw_rad)),
            gust=gusts + [0.0] * (5 * GUSTS_MAX - len(gusts)),
        )  # fmt: skip
        block = self.wake
        if block is not None:
            write(
                made.words, "air_params",
                block_m=(self.pad_m[0] - block.forward_m, self.pad_m[1] - block.starboard_m),
                block_size=(block.length_m, block.width_m, block.height_m),
                wake_decay=0.32 / math.log(block.height_m / self.roughness_m),
            )  # fmt: skip
        return made
