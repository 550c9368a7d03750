"""Run all methods of the thesis on one frame, and select one of their sightings."""

import math
from collections.abc import Mapping
from types import MappingProxyType

from msgspec.structs import replace

from estimator.contracts.estimates import Feature, Method, Sighting
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera import Camera
from estimator.vision.detection import Detection
from estimator.vision.pad import Pad
from estimator.vision.pose import SIGMA_DECK_RAD, Marks, Orientation, OrientedCamera, sighting, solve
from estimator.vision.thesis.arrow import find_arrow
from estimator.vision.thesis.corners import find_corners
from estimator.vision.thesis.ellipse import find_disc
from estimator.vision.thesis.segmentation import ColourSet, segment


def choose(methods: Mapping[Method, Sighting | None], disc_cut: bool) -> Method | None:
    """Choose by the thesis' priorities (section 4.1.5): corners if the disc reaches the frame's edge, else arrow, else ellipse.

    If only the corners have an estimate, it is used even if the whole disc shows; the thesis returned zeros there.

    Args:
        disc_cut: the disc reaches the frame's edge.
    """
    order: tuple[Method, ...] = ("corners", "arrow", "ellipse") if disc_cut else ("arrow", "ellipse", "corners")
    return next((m for m in order if methods.get(m) is not None), None)


def with_heading_of(sighting: Sighting, arrow: Sighting | None) -> Sighting:
    """Resolve a heading that is ambiguous by 180 degrees with an arrow in the same frame; without one return it unchanged.

    The arrow only selects one of the two headings; the two must agree to 20 degrees.
    """
    if not sighting.yaw_ambiguous or sighting.yaw_rad is None or arrow is None or arrow.yaw_rad is None:
        return sighting
    for yaw_rad in (sighting.yaw_rad, wrap_pi(sighting.yaw_rad + math.pi)):
        if abs(wrap_pi(yaw_rad - arrow.yaw_rad)) < math.radians(20.0):
            return replace(sighting, yaw_rad=yaw_rad, yaw_ambiguous=False)
    return sighting


def detect(
    frame: Frame,
    attitude: Attitude | None,
    camera: Camera,
    pad: Pad,
    colours: ColourSet,
    *,
    sigma_deck_rad: float = SIGMA_DECK_RAD,
) -> Detection:
    """Run all methods on one frame. This is a pure function.

    The methods measure the thesis' markings, so on a pad without all of them they find nothing.

    Args:
        attitude: the attitude at the frame's exposure. None assumes a level vehicle, with a wide covariance.
        sigma_deck_rad: one standard deviation of the roll and pitch of the deck, which is assumed level.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    if frame.px.shape[:2] != (camera.height, camera.width):
        h, w = frame.px.shape[:2]
        raise ValueError(f"the frame is {w}x{h} px, the camera's are {camera.width}x{camera.height}")
    view = OrientedCamera(camera, Orientation.of(attitude, sigma_deck_rad))
    seg = segment(frame.px, colours) if pad.markings.is_whole else None
    if seg is None:
        return Detection(None, None, MappingProxyType({"ellipse": None, "arrow": None, "corners": None}))
    disc = find_disc(seg, view, pad)
    arrow = find_arrow(seg, view, pad, seg.orangeness())
    corners = find_corners(seg, view, pad)

    def sighted(method: Method, marks: Marks, confidence: float, features: tuple[Feature, ...]) -> Sighting | None:
        fix = solve(marks, view)
        return None if fix is None else sighting(frame, method, marks, fix, confidence, features)

    methods: dict[Method, Sighting | None] = {
        "ellipse": None if disc is None else sighted("ellipse", disc.marks, disc.confidence, disc.features),
        "arrow": None if arrow is None else sighted("arrow", arrow.marks, arrow.confidence, arrow.features),
        "corners": None if corners is None else sighted("corners", corners.marks, corners.confidence, corners.features),
    }
    chosen = choose(methods, seg.touches_border)
    best = methods[chosen] if chosen is not None else None
    if best is not None:
        best = replace(with_heading_of(best, methods["arrow"]), method="selected")
    return Detection(best, chosen, MappingProxyType(methods))
