"""The fixed inputs of vision, apart from vision itself: the service reads them before it loads what looks at frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING, Protocol

from estimator.contracts.errors import BadInput
from estimator.integrity.options import IntegrityOptions
from estimator.vision.camera.camera import Camera
from estimator.vision.options import TrackerOptions
from estimator.vision.pad.pad import Pad

if TYPE_CHECKING:
    from estimator.contracts.geometry import F64
    from estimator.vision.camera.pose import PadPose
    from estimator.vision.camera.rolling import CameraMotion
    from estimator.vision.detect.pyramid import Pyramid

THESIS = "estimator.vision.track.by_thesis"
"""The module of the thesis' methods, which can be taken off; loaded where the options want them."""
FRAME_WORK = 14.0
"""Work in one frame of a flight, in floors, at which its search goes on with the next frame.

The unit is the time of one BGR to HSV conversion and one inRange of a frame of 640x360, as the core counts it. What Python does
besides takes a third as long.
"""
IMAGE_WORK = 36.0
"""Work in an image on its own, in floors, at which its search ends."""


class SecondOpinion(Protocol):
    """The port of the trained network (`estimator.vision.learned.second_opinion`)."""

    def log_odds(self, pyramid: Pyramid, camera: Camera, pad: Pad, pose: PadPose, cut: F64 | None = None) -> float | None:
        """Return the log-odds that the pad is at a pose; None if hardly any of it is in view.

        Args:
            cut: the line beyond which something covers the pad, (3,); see `alignment.UNCUT`.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class TrackerConfig:
    """The fixed inputs of vision.

    Raises:
        BadInput: the options want the thesis' methods, which are not installed; the message says what to install.
    """

    camera: Camera
    pad: Pad
    options: TrackerOptions = field(default_factory=TrackerOptions)
    search_work: float = IMAGE_WORK
    """Work in one frame at which a search goes on with the next one. In flight it is `FRAME_WORK`; inf searches each frame to the
    end."""
    motion: CameraMotion | None = None
    """Motion of the camera in this frame; None if unknown, or if all rows are exposed at once."""
    second_opinion: SecondOpinion | None = None
    """The trained network for a second opinion on what a search finds; None for no second opinion."""
    watches: bool = True
    """Look for things on the pad and about it; what was seen before is forgotten where that ends."""
    integrity: IntegrityOptions = field(default_factory=IntegrityOptions)
    """The guard's limits, by which a belief excludes a place."""

    def __post_init__(self) -> None:
        if (method := self.options.method) != "registration" and find_spec(THESIS) is None:
            raise BadInput(
                f"the method {method} needs the thesis' methods, which are not installed: install the extra decklander[compare]"
            )
