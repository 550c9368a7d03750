"""The pad as data: the regions that it is painted with, in order, their paints, and its lamps.

Everything else is derived from them: edges and coverage for registration, maps for alignment, the rendered pad, the printed one
and the overlay. Axes: x along the arrow, y to starboard of it, z into the deck; metres from the centre.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64
from estimator.vision.pad.file import Calibration, PadFile, pad_file
from estimator.vision.pad.geometry import sheet_of
from estimator.vision.pad.lamps import Lamp
from estimator.vision.pad.markings import Markings, Rgb, markings_of
from estimator.vision.pad.shapes import Region, borders_of, circle

SUPPORT_BY_PARTS = 0.3
"""Least support of drawings with disc, ring and lettering, whose parts distinguish them."""
SUPPORT = 5.0
"""Least support of other drawings."""
RARE = 1e-4
"""Chance of a false pad in a frame of a search above which a pad is not flown to."""


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
    """Lamps that shine upwards; their pattern shows its heading."""
    ground: str = ""
    """The paint of the sheet or the deck around; empty where it is not known."""
    calibration: Calibration | None = None
    """Rate at which clutter is taken for it; None if unknown."""
    accept_false_pads: bool = False
    """True if it is flown to although clutter is taken for it too often."""
    reversible: bool = False
    """True if its light may be reversed, as a thermal camera shows it."""
    sheet: Region | None = None
    """The region of the file that is the ground of all others; None if the file has none."""
    markings: Markings = field(init=False, compare=False, repr=False)
    """The sizes of the parts that detection knows by name."""
    _hash: int = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "markings", markings_of(self.regions, dict(self.paints), self.ground))
        # A pad is the key of caches that every frame uses.
        drawn = self.name, self.paints, self.regions, self.size_sigma_m, self.lamps, self.ground
        object.__setattr__(self, "_hash", hash((*drawn, self.calibration)))

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
        sheet = sheet_of(file.regions)
        regions, ground = (file.regions, file.ground) if sheet is None else (file.regions[1:], sheet.paint)
        known = file.calibration, file.accept_false_pads, file.polarity == "any", sheet
        return Pad(file.name, paints, regions, file.size_sigma_m, file.lamps, ground, *known)

    @property
    def fingerprint(self) -> str:
        """Fingerprint of this drawing, 12 hexadecimal digits."""
        drawn = msgspec.json.encode((self.paints, self.regions, self.ground))
        return hashlib.sha256(drawn).hexdigest()[:12]

    @property
    def least_support(self) -> float:
        """Support at which a find is as likely to be clutter: by its calibration, otherwise as for pads of its kind."""
        if self.calibration is not None:
            return self.calibration.least_support
        return SUPPORT_BY_PARTS if self.markings.is_searched_by_parts else SUPPORT

    @property
    def clutter_log_odds(self) -> float:
        """Log-odds against a find of a drawing that clutter is taken for too often to be flown to; 0 where that is accepted."""
        if self.calibration is None or self.accept_false_pads:
            return 0.0
        return math.log(max(1.0, self.calibration.chance / RARE))

    @property
    def is_calibrated(self) -> bool:
        """True if it is known how often clutter is taken for this drawing."""
        return self.calibration is not None and self.calibration.drawing == self.fingerprint

    @property
    def is_identifiable_by_paint(self) -> bool:
        """True if its paint is enough to identify it among other things on decks; if not, only its lamps are searched."""
        if self.accept_false_pads or not self.is_calibrated or self.calibration is None:
            return self.accept_false_pads or self.has_known_parts or not self.lamps
        return self.calibration.chance <= RARE

    @property
    def has_known_parts(self) -> bool:
        """True if it is of the kinds that verification was fitted to: disc, ring and lettering, fiducials, an H or X alone."""
        return self.markings.is_searched_by_parts or bool(self.markings.fiducials) or self.markings.is_letter_alone

    def check_for_detection(self, where: str) -> None:
        """Check that clutter is rarely taken for this pad, or that it has lamps.

        Raises:
            BadInput: its calibration says that it is taken too often, and its file does not accept that.
        """
        if not self.lamps and not self.is_identifiable_by_paint and self.calibration is not None:
            raise BadInput(
                f"{where}: clutter is taken for this pad in {1000.0 * self.calibration.chance:.3g} of 1,000 frames that are "
                f"searched (limit for flight: {1000.0 * RARE:g}): paint a disc or a frame around it, a ring, or more parts that "
                "differ, then decklander pad check; or set accept_false_pads = true"
            )

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
