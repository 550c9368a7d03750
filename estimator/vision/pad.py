"""The pad as data: the regions that it is painted with, in order, their paints, and its lamps.

Everything else is derived from them: edges and coverage for registration, maps for alignment, the rendered pad, the printed one
and the overlay. Axes: x along the arrow, y to starboard of it, z into the deck; metres from the centre.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.lamp import Lamp
from estimator.vision.markings import Markings, Rgb, markings_of
from estimator.vision.pad_file import PadFile, pad_file
from estimator.vision.pad_rules import lacking_parts
from estimator.vision.regions import Region, borders_of, circle


@dataclass(frozen=True, slots=True)
class Pad:
    """A pad: its name, its paints, and its regions from the lowest to the topmost.

    Raises:
        BadInput: see `from_mapping`.
    """

    name: str
    paints: tuple[tuple[str, Rgb], ...]
    """Names and sRGB values of the paints."""
    regions: tuple[Region, ...]
    size_sigma_m: float = 0.0
    """Sigma of the painted sizes against those of the regions, m: the tolerance of print and deck."""
    lamps: tuple[Lamp, ...] = ()
    """Lamps that shine upwards; their pattern tells its heading."""
    markings: Markings = field(init=False, compare=False, repr=False)
    """The sizes of the parts that detection knows by name."""
    _hash: int = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "markings", markings_of(self.regions, dict(self.paints)))
        # A pad is the key of caches that every frame asks.
        object.__setattr__(self, "_hash", hash((self.name, self.paints, self.regions, self.size_sigma_m, self.lamps)))

    def __hash__(self) -> int:
        return self._hash

    @staticmethod
    def from_mapping(data: Mapping[str, Any], where: str = "pad") -> Pad:
        """Build a pad from the keys of a pad file (configs/pads/*.toml).

        Raises:
            BadInput: a key is missing, unknown, of the wrong type or out of range, regions cross or hide one another, or a paint
                does not stand out from the one below. The text names `where`, the key, the value and what to do.
        """
        file: PadFile = pad_file(data, where)
        paints = tuple((name, (rgb[0], rgb[1], rgb[2])) for name, rgb in file.paints.items())
        return Pad(file.name, paints, file.regions, file.size_sigma_m, file.lamps)

    @property
    def is_identifiable_by_paint(self) -> bool:
        """Whether its paint is enough to identify it among what else lies on decks; if not, only its lamps are looked for."""
        return not lacking_parts(self.regions)

    @property
    def disc_radius_m(self) -> float:
        """Radius of the disc about the centre that holds all of the pad."""
        return self.markings.outer_radius_m

    def rgb(self, region: Region) -> Rgb:
        """Return the colour of a region, sRGB 0..255."""
        return dict(self.paints)[region.paint]

    def borders(self) -> tuple[F64, ...]:
        """Return the closed lines around all that is painted or lit, (N, 3) m each."""
        lines = [line for region in self.regions for line in borders_of(region)]
        lines += [np.array(lamp.at_m) + circle(lamp.radius_m, 12) for lamp in self.lamps]
        return tuple(np.pad(line, ((0, 0), (0, 1))) for line in lines)

    def circle(self, radius_m: float, n: int = 72) -> F64:
        """Return (n, 3) m: points of a circle about the centre, clockwise seen from above, starting at the arrow."""
        return np.pad(circle(radius_m, n), ((0, 0), (0, 1)))
