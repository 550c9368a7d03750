"""The result of one of the thesis' methods in a frame."""

from msgspec import Struct

from estimator.contracts.estimates import Feature
from estimator.vision.camera.pose import Marks


class Cue(Struct, frozen=True, eq=False):
    """The result of one method."""

    marks: Marks
    confidence: float
    features: tuple[Feature, ...]
