"""The Foxglove messages that this recorder writes: images, annotations, calibration, transforms, poses, log lines, the 3D scene.

Field names and meanings are those of the published `foxglove.*` schemas. Axes are converted so that a viewer shows
up as up: the fixed frame is `deck` (x along the arrow, y to port, z up), with `pad`, `level`, `body` and `cam` of
docs/conventions.md below it.
"""

import math
from collections.abc import Iterable
from itertools import pairwise, starmap

import numpy as np
from msgspec import Struct

from companion.recording.palette import colour
from estimator.contracts.estimates import Feature, RelativeState
from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.geometry import convex_pieces_of, is_slanted, sides_of
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shapes import PaintedArrowhead, PaintedDisc, PaintedRing, Region, borders_of

NS = 1_000_000_000
POINTS, LINE_LOOP, LINE_STRIP = 1, 2, 3
INFO, WARNING, ERROR = 2, 3, 4
R_DECK_PAD = Rotation.from_rotvec([math.pi, 0.0, 0.0])
"""The rotation from `pad` to `deck`, half a turn about the arrow: down becomes up, starboard becomes port."""


class Time(Struct, frozen=True):
    """A time as Foxglove writes it: seconds and nanoseconds since the viewer's epoch."""

    sec: int
    nsec: int


class Vector3(Struct, frozen=True):
    """The schema `foxglove.Vector3`."""

    x: float
    y: float
    z: float


class Quaternion(Struct, frozen=True):
    """The schema `foxglove.Quaternion`."""

    x: float
    y: float
    z: float
    w: float


class Pose(Struct, frozen=True):
    """The schema `foxglove.Pose`."""

    position: Vector3
    orientation: Quaternion


class PoseInFrame(Struct, frozen=True):
    """The schema `foxglove.PoseInFrame`."""

    timestamp: Time
    frame_id: str
    pose: Pose


class FrameTransform(Struct, frozen=True):
    """The schema `foxglove.FrameTransform`."""

    timestamp: Time
    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


class FrameTransforms(Struct, frozen=True):
    """The schema `foxglove.FrameTransforms`."""

    transforms: list[FrameTransform]


class CompressedImage(Struct, frozen=True):
    """The schema `foxglove.CompressedImage`."""

    timestamp: Time
    frame_id: str
    data: bytes
    format: str


class CompressedVideo(Struct, frozen=True):
    """The schema `foxglove.CompressedVideo`: one access unit."""

    timestamp: Time
    frame_id: str
    data: bytes
    format: str


class CameraCalibration(Struct, frozen=True):
    """The schema `foxglove.CameraCalibration`."""

    timestamp: Time
    frame_id: str
    width: int
    height: int
    distortion_model: str
    D: list[float]
    K: list[float]
    R: list[float]
    P: list[float]


class Color(Struct, frozen=True):
    """The schema `foxglove.Color`."""

    r: float
    g: float
    b: float
    a: float


class Point2(Struct, frozen=True):
    """The schema `foxglove.Point2`."""

    x: float
    y: float


class KeyValuePair(Struct, frozen=True):
    """The schema `foxglove.KeyValuePair`."""

    key: str
    value: str


class CircleAnnotation(Struct, frozen=True):
    """The schema `foxglove.CircleAnnotation`."""

    timestamp: Time
    position: Point2
    diameter: float
    thickness: float
    fill_color: Color
    outline_color: Color


class PointsAnnotation(Struct, frozen=True):
    """The schema `foxglove.PointsAnnotation`."""

    timestamp: Time
    type: int
    points: list[Point2]
    outline_color: Color
    outline_colors: list[Color]
    fill_color: Color
    thickness: float
    metadata: list[KeyValuePair]


class TextAnnotation(Struct, frozen=True):
    """The schema `foxglove.TextAnnotation`."""

    timestamp: Time
    position: Point2
    text: str
    font_size: float
    text_color: Color
    background_color: Color


class ImageAnnotations(Struct, frozen=True):
    """The schema `foxglove.ImageAnnotations`."""

    timestamp: Time
    circles: list[CircleAnnotation]
    points: list[PointsAnnotation]
    texts: list[TextAnnotation]


class Log(Struct, frozen=True):
    """The schema `foxglove.Log`."""

    timestamp: Time
    level: int
    message: str
    name: str
    file: str
    line: int


_CLEAR = Color(0.0, 0.0, 0.0, 0.0)
_POINT_TYPES = {"point": POINTS, "line": LINE_STRIP, "ellipse": LINE_LOOP, "outline": LINE_LOOP}


def time_of(at_ns: int) -> Time:
    """Return the time of a non-negative number of nanoseconds since the viewer's epoch."""
    return Time(*divmod(max(0, at_ns), NS))


def vector(v: F64) -> Vector3:
    """Return the message of a vector (3,)."""
    return Vector3(float(v[0]), float(v[1]), float(v[2]))


def quaternion(R: Rotation) -> Quaternion:
    """Return the message of a rotation."""
    w, x, y, z = (float(q) for q in R.quat_wxyz)
    return Quaternion(x, y, z, w)


def compressed_image(at_ns: int, data: bytes, form: str) -> CompressedImage:
    """Return the message of an encoded image; `form` is "jpeg" or "png"."""
    return CompressedImage(time_of(at_ns), "cam", data, form)


def calibration(at_ns: int, camera: Camera) -> CameraCalibration:
    """Return the camera's calibration; viewers call Brown-Conrady distortion "plumb_bob"."""
    K = camera.K
    P = np.hstack([K, np.zeros((3, 1))])
    return CameraCalibration(
        time_of(at_ns), "cam", camera.width, camera.height, "plumb_bob",
        camera.distortion.tolist(), K.ravel().tolist(), np.eye(3).ravel().tolist(), P.ravel().tolist(),
    )  # fmt: skip


def fixed_transforms(at_ns: int, camera: Camera | None) -> FrameTransforms:
    """Return the transforms that never change: the deck's own axes and the camera's mount.

    Args:
        camera: None if a gimbal turns it.
    """
    t = time_of(at_ns)
    transforms = [FrameTransform(t, "deck", "pad", Vector3(0.0, 0.0, 0.0), quaternion(R_DECK_PAD))]
    if camera is not None:
        transforms.append(FrameTransform(t, "body", "cam", vector(camera.T_body_cam.t), quaternion(camera.T_body_cam.R)))
    return FrameTransforms(transforms)


def camera_transform(at_ns: int, p_body_cam: F64, R_body_cam: Rotation) -> FrameTransforms:
    """Return the transform of a camera that a gimbal turns, in `body`; its place is (3,) m."""
    return FrameTransforms([FrameTransform(time_of(at_ns), "body", "cam", vector(p_body_cam), quaternion(R_body_cam))])


def _level_in_pad(d_body_pad_level: F64, yaw_rad: float) -> tuple[Vector3, Quaternion]:
    """Return the position and heading of `level` in `pad`, from the (3,) m vector to the pad and the heading from the arrow."""
    R_pad_level = Rotation.from_rpy(0.0, 0.0, yaw_rad)
    return vector(R_pad_level @ -d_body_pad_level), quaternion(R_pad_level)


def belief_transform(at_ns: int, belief: RelativeState) -> FrameTransforms | None:
    """Return the transform of `level` in `pad`, or None while the heading is not known."""
    if belief.yaw_rad is None:
        return None
    p, q = _level_in_pad(belief.d_body_pad_level, belief.yaw_rad)
    return FrameTransforms([FrameTransform(time_of(at_ns), "pad", "level", p, q)])


def attitude_transform(at_ns: int, R_ned_body: Rotation) -> FrameTransforms:
    """Return the transform of `body` in `level`."""
    q = quaternion(R_ned_body.without_heading())
    return FrameTransforms([FrameTransform(time_of(at_ns), "level", "body", Vector3(0.0, 0.0, 0.0), q)])


def pose_in_pad(at_ns: int, d_body_pad_level: F64, yaw_rad: float | None) -> PoseInFrame | None:
    """Return the pose of the levelled body in `pad`, or None while the heading is not known."""
    if yaw_rad is None:
        return None
    p, q = _level_in_pad(d_body_pad_level, yaw_rad)
    return PoseInFrame(time_of(at_ns), "pad", Pose(p, q))


def image_annotations(at_ns: int, features: Iterable[tuple[str, Feature]], caption: str) -> ImageAnnotations:
    """Return the features of each method and one line of text. A viewer's pixel (0, 0) is the corner of ours."""
    t = time_of(at_ns)
    points = []
    for method, feature in features:
        value = int(colour(method)[1:], 16)
        ink = Color((value >> 16 & 255) / 255.0, (value >> 8 & 255) / 255.0, (value & 255) / 255.0, 1.0)
        # Tenths of a pixel are what an eye sees; every further digit is stored and cannot be packed.
        known = feature.uv_px[np.isfinite(feature.uv_px).all(axis=1)]
        uv = list(starmap(Point2, np.round(known + 0.5, 1).tolist()))
        notes = [KeyValuePair("method", method), KeyValuePair("kind", feature.kind), KeyValuePair("label", feature.label)]
        points.append(PointsAnnotation(t, _POINT_TYPES[feature.kind], uv, ink, [], _CLEAR, 2.0, notes))
    text = TextAnnotation(t, Point2(8.0, 20.0), caption, 14.0, Color(1.0, 1.0, 1.0, 1.0), Color(0.0, 0.0, 0.0, 0.5))
    return ImageAnnotations(t, [], points, [text])


def log_line(at_ns: int, level: int, name: str, message: str) -> Log:
    """Return the message of a log line; `level` is `INFO`, `WARNING` or `ERROR`."""
    return Log(time_of(at_ns), level, message, name, "", 0)


SIGMAS = 2.0
"""The half axes of the ellipsoid, in standard deviations."""
_DECK_RADII = 2.2
_LAYER_M = 0.002
"""The height of each region over the one below, so that a viewer does not mix their pixels."""
_SIDES = 36
"""The corners of a circle."""
_ARM_M, _ROTOR_M = 0.18, 0.1


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
    points: list[Vector3]
    color: Color
    colors: list[Color]
    indices: list[int]


class TriangleListPrimitive(Struct, frozen=True):
    """The schema `foxglove.TriangleListPrimitive`."""

    pose: Pose
    points: list[Vector3]
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
    lifetime: Time = Time(0, 0)
    frame_locked: bool = True
    metadata: list[KeyValuePair] = []
    arrows: list[ArrowPrimitive] = []
    cubes: list[CubePrimitive] = []
    spheres: list[CubePrimitive] = []
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
    sphere = CubePrimitive(Pose(Vector3(0.0, 0.0, 0.0), quaternion(Rotation(axes))), size, ink)
    t = time_of(at_ns)
    return SceneUpdate(
        [], [SceneEntity(timestamp=t, frame_id="level", id="error", lifetime=Time(0, 500_000_000), spheres=[sphere])]
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
        points = [Vector3(round(float(x), 4), round(float(y), 4), -_LAYER_M * (k + 1)) for x, y in corners]
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
        LinePrimitive(0, _at(0, 0, 0), 0.03, False, [Vector3(-x, -y, 0.0), Vector3(x, y, 0.0)], dark, [], []) for x, y in arms[:2]
    ]
    rotors = [
        CylinderPrimitive(_at(x, y, -0.03), Vector3(2 * _ROTOR_M, 2 * _ROTOR_M, 0.01), 1.0, 1.0, front if x > 0 else dark)
        for x, y in arms
    ]
    nose = ArrowPrimitive(_at(0, 0, 0), 0.22, 0.02, 0.08, 0.06, front)
    return SceneEntity(timestamp=t, frame_id="body", id="drone", lines=lines, cylinders=rotors, arrows=[nose])
