"""The 3D scene for viewers: the pad with its paints, the deck, the drone, and the error ellipsoid, as `foxglove.SceneUpdate`.

Field names and meanings are those of the published schemas. Entities stand in the frames of `companion.recording.foxglove`.
"""

import math
from itertools import pairwise

import numpy as np
from msgspec import Struct

from companion.recording.foxglove import Color, KeyValuePair, Pose, Quaternion, Time, Vector3, quaternion, time_of
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.vision.pad import Pad
from estimator.vision.regions import (
    PaintedArrowhead,
    PaintedDisc,
    PaintedRing,
    Region,
    borders_of,
    convex_pieces_of,
    is_slanted,
    sides_of,
)

SIGMAS = 2.0
"""The half axes of the ellipsoid, in standard deviations."""
_DECK_RADII = 2.2
_LAYER_M = 0.002
"""The height of each region over the one below, so that a viewer does not mix their pixels."""
_SIDES = 36
"""The corners of a circle."""
_ARM_M, _ROTOR_M = 0.18, 0.1


class Duration(Struct, frozen=True):
    """The schema `foxglove.Duration`."""

    sec: int
    nsec: int


class Point3(Struct, frozen=True):
    """The schema `foxglove.Point3`."""

    x: float
    y: float
    z: float


class ArrowPrimitive(Struct, frozen=True):
    """The schema `foxglove.ArrowPrimitive`."""

    pose: Pose
    shaft_length: float
    shaft_diameter: float
    head_length: float
    head_diameter: float
    color: Color


class CubePrimitive(Struct, frozen=True):
    """The schema `foxglove.CubePrimitive`."""

    pose: Pose
    size: Vector3
    color: Color


class SpherePrimitive(Struct, frozen=True):
    """The schema `foxglove.SpherePrimitive`: an ellipsoid with the axes of its pose."""

    pose: Pose
    size: Vector3
    color: Color


class CylinderPrimitive(Struct, frozen=True):
    """The schema `foxglove.CylinderPrimitive`: about the z axis of its pose."""

    pose: Pose
    size: Vector3
    bottom_scale: float
    top_scale: float
    color: Color


class LinePrimitive(Struct, frozen=True):
    """The schema `foxglove.LinePrimitive`."""

    type: int
    pose: Pose
    thickness: float
    scale_invariant: bool
    points: list[Point3]
    color: Color
    colors: list[Color]
    indices: list[int]


class TriangleListPrimitive(Struct, frozen=True):
    """The schema `foxglove.TriangleListPrimitive`."""

    pose: Pose
    points: list[Point3]
    color: Color
    colors: list[Color]
    indices: list[int]


class TextPrimitive(Struct, frozen=True):
    """The schema `foxglove.TextPrimitive`."""

    pose: Pose
    billboard: bool
    font_size: float
    scale_invariant: bool
    color: Color
    text: str


class ModelPrimitive(Struct, frozen=True):
    """The schema `foxglove.ModelPrimitive`."""

    pose: Pose
    scale: Vector3
    color: Color
    override_color: bool
    url: str
    media_type: str
    data: bytes


class SceneEntity(Struct, frozen=True, kw_only=True):
    """The schema `foxglove.SceneEntity`."""

    timestamp: Time
    frame_id: str
    id: str
    lifetime: Duration = Duration(0, 0)
    frame_locked: bool = True
    metadata: list[KeyValuePair] = []
    arrows: list[ArrowPrimitive] = []
    cubes: list[CubePrimitive] = []
    spheres: list[SpherePrimitive] = []
    cylinders: list[CylinderPrimitive] = []
    lines: list[LinePrimitive] = []
    triangles: list[TriangleListPrimitive] = []
    texts: list[TextPrimitive] = []
    models: list[ModelPrimitive] = []


class SceneEntityDeletion(Struct, frozen=True):
    """The schema `foxglove.SceneEntityDeletion`."""

    timestamp: Time
    type: int
    id: str


class SceneUpdate(Struct, frozen=True):
    """The schema `foxglove.SceneUpdate`."""

    deletions: list[SceneEntityDeletion]
    entities: list[SceneEntity]


def fixed_scene(at_ns: int, pad: Pad | None) -> SceneUpdate:
    """Return the deck, the pad and the drone, which move with their frames."""
    t = time_of(at_ns)
    entities = [_drone(t)]
    if pad is not None:
        entities += [_deck(t, pad), _pad(t, pad)]
    return SceneUpdate([], entities)


def error_ellipsoid(at_ns: int, belief: RelativeState) -> SceneUpdate:
    """Return the ellipsoid of two sigma about the drone, where the estimate may be wrong by as much."""
    variances, axes = np.linalg.eigh(belief.cov[:3, :3])
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] = -axes[:, 0]
    size = Vector3(*(2.0 * SIGMAS * math.sqrt(max(float(v), 0.0)) for v in variances))
    ink = Color(1.0, 0.44, 0.24, 0.35) if belief.consistent else Color(0.9, 0.1, 0.1, 0.5)
    sphere = SpherePrimitive(Pose(Vector3(0.0, 0.0, 0.0), quaternion(Rotation(axes))), size, ink)
    t = time_of(at_ns)
    return SceneUpdate(
        [], [SceneEntity(timestamp=t, frame_id="level", id="error", lifetime=Duration(0, 500_000_000), spheres=[sphere])]
    )


def _at(x: float, y: float, z: float) -> Pose:
    return Pose(Vector3(x, y, z), Quaternion(0.0, 0.0, 0.0, 1.0))


def _deck(t: Time, pad: Pad) -> SceneEntity:
    wide = 2.0 * _DECK_RADII * pad.disc_radius_m
    plate = CubePrimitive(_at(0.0, 0.0, 0.03), Vector3(wide, wide, 0.05), Color(0.45, 0.48, 0.5, 1.0))
    return SceneEntity(timestamp=t, frame_id="pad", id="deck", cubes=[plate])


def _pad(t: Time, pad: Pad) -> SceneEntity:
    triangles = []
    for k, region in enumerate(pad.regions):
        r, g, b = pad.rgb(region)
        corners, faces = filled(region)
        points = [Point3(round(float(x), 4), round(float(y), 4), -_LAYER_M * (k + 1)) for x, y in corners]
        both = [i for a, b, c in faces for i in (a, b, c, a, c, b)]
        triangles.append(TriangleListPrimitive(_at(0, 0, 0), points, Color(r / 255.0, g / 255.0, b / 255.0, 1.0), [], both))
    return SceneEntity(timestamp=t, frame_id="pad", id="pad", triangles=triangles)


def filled(region: Region) -> tuple[F64, list[tuple[int, int, int]]]:
    """Return the points (n, 2) m of triangles that fill a region, and each triangle's points by their numbers."""
    match region:
        case PaintedDisc() | PaintedArrowhead():
            (line,) = borders_of(region, _SIDES)
            return line, [(0, k, k + 1) for k in range(1, len(line) - 1)]
        case PaintedRing():
            outer, inner = borders_of(region, _SIDES)
            n = len(outer)
            faces = [face for k in range(n) for face in ((k, (k + 1) % n, n + k), (n + k, (k + 1) % n, n + (k + 1) % n))]
            return np.vstack([outer, inner]), faces
        case _ if is_slanted(region):
            return _fans(convex_pieces_of(region))
        case _:
            return _fans(_slabs(*sides_of(region)))


def _fans(pieces: list[F64]) -> tuple[F64, list[tuple[int, int, int]]]:
    """Return the points (n, 2) of convex polygons, and triangles that fill them, each from a polygon's first point."""
    first = np.cumsum([0, *[len(piece) for piece in pieces]]).tolist()
    return np.vstack(pieces), [
        (f, f + k, f + k + 1) for f, piece in zip(first, pieces, strict=False) for k in range(1, len(piece) - 1)
    ]


def _slabs(corners: F64, ends: F64) -> list[F64]:
    """Return the rectangles (4, 2) that make up what lies inside of sides (N, 2) along x or y."""
    out = []
    xs = np.unique(np.round(corners[:, 0], 9))
    for x0, x1 in pairwise(xs.tolist()):
        middle = 0.5 * (x0 + x1)
        crossed = (np.minimum(corners[:, 0], ends[:, 0]) < middle) & (np.maximum(corners[:, 0], ends[:, 0]) > middle)
        ys = np.sort(corners[crossed, 1])
        out += [np.array([(x0, a), (x1, a), (x1, b), (x0, b)]) for a, b in zip(ys[::2], ys[1::2], strict=True)]
    return out


def _drone(t: Time) -> SceneEntity:
    dark, front = Color(0.12, 0.14, 0.16, 1.0), Color(0.04, 0.42, 0.39, 1.0)
    arms = [(s * _ARM_M, u * _ARM_M) for s in (1, -1) for u in (1, -1)]
    lines = [
        LinePrimitive(0, _at(0, 0, 0), 0.03, False, [Point3(-x, -y, 0.0), Point3(x, y, 0.0)], dark, [], []) for x, y in arms[:2]
    ]
    rotors = [
        CylinderPrimitive(_at(x, y, -0.03), Vector3(2 * _ROTOR_M, 2 * _ROTOR_M, 0.01), 1.0, 1.0, front if x > 0 else dark)
        for x, y in arms
    ]
    nose = ArrowPrimitive(_at(0, 0, 0), 0.22, 0.02, 0.08, 0.06, front)
    return SceneEntity(timestamp=t, frame_id="body", id="drone", lines=lines, cylinders=rotors, arrows=[nose])
