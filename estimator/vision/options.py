"""The options of the pad tracker."""

import math
from typing import Annotated, Literal

from estimator.contracts.keys import CheckedOptions, choice, text, tuning

TrackerMethod = Literal["fused", "registration", "thesis"]
"""The methods that form the sighting: registration alone, all fused, or the thesis' three with its selection by priority."""
ColourSetName = Literal["simulator", "indoor", "outdoor"]
Learned = Literal["off", "second_opinion"]
"""Switch for the second opinion of a trained network on the finds of a search."""


class TrackerOptions(CheckedOptions, frozen=True, forbid_unknown_fields=True):
    """Options of the processing of frames.

    Raises:
        ValueError: a number outside its range, or a word that is not among the choices.
    """

    method: Annotated[
        TrackerMethod,
        choice(
            "methods of detection: registration alone; all four, fused; the thesis' three, chosen by priority",
            public=True,
            page=True,
        ),
    ] = "registration"
    colours: Annotated[
        ColourSetName,
        choice("set of colour limits by which the thesis' methods segment the pad", "thesis table 4.1", public=True, page=True),
    ] = "indoor"
    deck_tilt_sigma_deg: Annotated[
        float, tuning("standard deviation of the deck's roll and pitch", "deg", 0.0, 30.0, "supply vessel in a slight sea")
    ] = 2.0
    learned: Annotated[
        Learned,
        choice(
            "whether a trained network, which can only lower a confidence, checks what a search finds",
            "docs/vision.md",
            public=True,
            page=True,
        ),
    ] = "off"
    learned_file: Annotated[
        str, text("network that checks, an ONNX file; empty for the shipped one", 4096, shortest=0, public=True)
    ] = ""

    @property
    def deck_tilt_sigma_rad(self) -> float:
        """One standard deviation of the deck's roll and pitch, rad."""
        return math.radians(self.deck_tilt_sigma_deg)
