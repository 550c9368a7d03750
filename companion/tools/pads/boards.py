"""Read boards of fiducials as other programs describe them into the keys of a pad file.

Landmark's landing-target.json gives the corners of each dark square, metres, from its upper left one clockwise; Landmark and the
BlueOS extensions that read it take the corners as OpenCV's detector does. apriltag_ros' tags.yaml gives the pose of each tag in
its bundle's frame, x to the right, y up and z out of the board, and the tag as AprilTag draws it, which is OpenCV's drawing after
half a turn. Up is along the arrow, and the origin is the pad's centre.

Source: AprilRobotics/apriltag_ros, config/tags.yaml and common_functions.cpp; christianrauch/apriltag_ros, README;
Wingxtra-Aerospace/wingxtra-de-precision-landing, landing_target_layout.py (the form of Landmark's file).
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from companion.tools.pads import foreign
from companion.tools.tag_pad import FAMILY, TURN_DEG, Board, fiducial, painted
from drivers.confined import in_child
from estimator.contracts.errors import BadInput, refused
from estimator.vision.camera.camera import shown
from estimator.vision.pad.fiducial import PaintedFiducial
from estimator.vision.pad.file import LARGEST_M

BOARD_FILES = (".json", ".yaml", ".yml")
_FLAT_M = 0.001  # distance of a tag from the board's plane
_SQUARE = 0.01  # fault of a square, as a share of its size


class _Marker(Struct):
    """A marker of Landmark's."""

    family: str
    id: int
    object_points: list[tuple[float, float, float]]


class _Landmark(Struct):
    markers: list[_Marker]


class _Member(Struct):
    """A tag of apriltag_ros in its bundle; of a tag that stands alone the pose is left out."""

    id: int
    size: float
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    qw: float = 1.0
    qx: float = 0.0
    qy: float = 0.0
    qz: float = 0.0
    name: str = ""


class _Bundle(Struct):
    layout: list[_Member]
    name: str = ""


class _Tags(Struct):
    standalone_tags: list[_Member] = []
    tag_bundles: list[_Bundle] = []


class _Lists(Struct):
    ids: list[int]
    frames: list[str] = []
    sizes: list[float] = []


class _Node(Struct):
    """Parameters of the node of ROS 2."""

    family: str
    size: float
    tag: _Lists


def board(
    text: str, name: str, where: str, sheet_m: tuple[float, float] | None = None, family: str | None = None,
    target: str | None = None, *, turned: bool = False,
) -> Board:  # fmt: skip
    """Return the pad of a board's file.

    Args:
        text: of Landmark's JSON, or of apriltag_ros' YAML.
        name: of the pad.
        where: name of the file, for errors.
        sheet_m: width and length of the sheet that the tags are on, about the centre; None if it is not known.
        family: of the tags, where the file does not say it; None for tag36h11.
        target: the bundle or tag that is the pad, where the file has several.
        turned: whether each tag was painted half a turn round from how the file has it.

    Raises:
        BadInput: it is neither, a tag is off the plane, or turned by what is no quarter, or is of a family that is not read. YAML
            is read by the library ruamel.yaml of the extra ros2.
    """
    half = 180.0 if turned else 0.0
    if where.lower().endswith(".json"):
        with refused(f"{where}: no landing-target.json of Landmark", msgspec.MsgspecError, RecursionError):
            found = msgspec.json.decode(text, type=_Landmark).markers
        regions = [*_by_corners(found, half, where)]
        remarks = [
            "object_points alone are taken, which are the dark squares; target_num, size_mm, position_mm and the like are not",
            "its corners are taken as OpenCV orders them: if pad check --picture finds no pad, import with --tags-turned",
        ]
    else:
        regions, remarks = _by_poses(text, where, family, target, half)
    return painted(regions, name, where, sheet_m, remarks)


def _by_corners(markers: Sequence[_Marker], half_deg: float, where: str) -> Iterator[PaintedFiducial]:
    """Yield Landmark's tags. Its file's y is up or down; the corners go clockwise on the printed face, which tells."""
    down = None
    for i, marker in enumerate(markers):
        named = f"{where}: markers[{i}] (id {marker.id})"
        at = np.array(marker.object_points, float)
        if at.shape != (4, 3) or not np.abs(at).max() <= LARGEST_M:
            raise BadInput(f"{named}: object_points must be four corners of three numbers up to {LARGEST_M:g} m")
        if np.abs(at[:, 2]).max() > _FLAT_M:
            raise BadInput(f"{named}: it is {1e3 * np.abs(at[:, 2]).max():.0f} mm off the plane of the board: a pad is flat")
        across, along = at[1, :2] - at[0, :2], at[2, :2] - at[1, :2]
        size_m, turn = math.hypot(*across), across[0] * along[1] - across[1] * along[0]
        right_angled = np.array([-across[1], across[0]]) * (1.0 if turn > 0.0 else -1.0)
        if not math.hypot(*(along - right_angled), *(at[3] - at[2] + at[1] - at[0])) <= _SQUARE * size_m:
            raise BadInput(f"{named}: its object_points are no square's corners in order")
        if (turn > 0.0) != (down := turn > 0.0 if down is None else down):
            raise BadInput(f"{named}: its corners go round the other way than those of markers[0], as in a mirror")
        flip = -1.0 if down else 1.0
        x, y = at[:, :2].mean(axis=0).tolist()
        clockwise_deg = -math.degrees(math.atan2(flip * across[1], across[0]))
        yield fiducial(marker.family, marker.id, size_m, named, (x, flip * y), clockwise_deg + half_deg)


def _by_poses(
    text: str, where: str, family: str | None, target: str | None, half_deg: float
) -> tuple[list[PaintedFiducial], list[str]]:
    """Return the tags of the target of apriltag_ros, and what was not taken."""
    data = _yaml(text, where)
    node = next((v["ros__parameters"] for v in data.values() if isinstance(v, Mapping) and "ros__parameters" in v), None)
    remarks: list[str] = []
    with refused(f"{where}: no tags.yaml of apriltag_ros", msgspec.MsgspecError, RecursionError, IndexError):
        if node is not None:
            of = msgspec.convert(node, _Node)
            family = family or of.family
            named = {f"tag_{n}": [_Member(n, of.tag.sizes[i] if of.tag.sizes else of.size)] for i, n in enumerate(of.tag.ids)}
        else:
            tags = msgspec.convert(data, _Tags)
            targets = [(bundle.name or f"bundle_{i}", bundle.layout) for i, bundle in enumerate(tags.tag_bundles)]
            targets += [(tag.name or f"tag_{tag.id}", [tag]) for tag in tags.standalone_tags]
            if len(named := dict(targets)) < len(targets):
                raise BadInput(f"{where}: two of its {len(targets)} targets have one name")
            if left := [shown(key) for key in data if key not in _Tags.__struct_fields__]:
                remarks.append(f"the keys {', '.join(left[:6])} say nothing of the board")
    if family is None:
        family = FAMILY
        remarks.append(f"the family is in settings.yaml: {FAMILY} is taken; --family names another")
    names = ", ".join(map(shown, [*named][:9]))
    if not named:
        raise BadInput(f"{where}: it has neither standalone_tags nor tag_bundles")
    if (target or next(iter(named))) not in named or (target is None and len(named) > 1):
        raise BadInput(f"{where}: it has {names}, each with a centre of its own: choose one with --target")
    target = target or next(iter(named))
    if len(named) > 1:
        remarks.append(f"of {names} only {shown(target)} is taken: the others have centres of their own")
    return [
        _of_pose(tag, family, half_deg, f"{where}: {target}[{i}] (id {tag.id})") for i, tag in enumerate(named[target])
    ], remarks


def _yaml(text: str, where: str) -> dict[str, Any]:
    data = json.loads(in_child(foreign.__name__, "yaml", text.encode(), where))
    if not isinstance(data, dict):
        raise BadInput(f"{where}: it has neither standalone_tags nor tag_bundles")
    return data


def _of_pose(tag: _Member, family: str, half_deg: float, where: str) -> PaintedFiducial:
    q = np.array([tag.qw, tag.qx, tag.qy, tag.qz])
    norm = float(np.linalg.norm(q))
    if not (0.0 < norm < math.inf):
        raise BadInput(f"{where}: its quaternion is none: qw, qx, qy, qz are {q.tolist()}")
    w, x, y, z = (q / norm).tolist()
    if not math.hypot(x, y) <= math.sin(0.5 * math.radians(TURN_DEG)):
        tilt_deg = 2.0 * math.degrees(math.asin(min(1.0, math.hypot(x, y))))
        raise BadInput(f"{where}: it is tilted by {tilt_deg:.1f} degrees out of the plane of the board: a pad is flat")
    if not abs(tag.z) <= _FLAT_M:
        raise BadInput(f"{where}: its z is {tag.z:g} m, off the plane of the bundle's origin: a pad is flat")
    clockwise_deg = -2.0 * math.degrees(math.atan2(z, w))
    return fiducial(family, tag.id, tag.size, where, (tag.x, tag.y), clockwise_deg + 180.0 + half_deg)
