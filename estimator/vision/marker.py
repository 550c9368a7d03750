"""Detect square markers (AprilTag, ArUco) with `cv2.aruco`, as an alternative to the painted pad, and return the same sighting.

Several markers of any sizes may lie on one deck, for example a small one inside a large one for the last metres. All visible
markers are solved together. The pose minimises the reprojection error of the corners and, weakly, the tilt of a deck that is
assumed level. A single square allows two poses; the one with the lower total cost is kept.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Feature, Pose6, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera import Camera
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import SIGMA_DECK_RAD, Orientation

_FAMILIES = {name.removeprefix("DICT_").lower(): getattr(cv2.aruco, name) for name in dir(cv2.aruco) if name.startswith("DICT_")}
SIGMA_CORNER_PX = 0.25
"""Standard deviation of a corner that `cv2.cornerSubPix` refined at good contrast: noise and discretisation together."""
_LEAST_SIDE_PX = 8.0
_LARGEST_RMS_PX = 2.0
_STEPS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """One square marker on the deck."""

    family: str
    id: int
    size_m: float
    """Side of the black square."""
    centre_m: tuple[float, float]
    """Position of the marker's centre: along the pad's x axis, and to starboard of it."""
    yaw_rad: float
    """Rotation of the marker's upright direction from the pad's x axis, clockwise from above."""

    def corners(self) -> F64:
        """Return (4, 3) m in `pad`: the marker's top left, top right, bottom right and bottom left corners."""
        h = self.size_m / 2
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        xy = np.array([(h, -h), (h, h), (-h, h), (-h, -h)]) @ np.array([[c, s], [-s, c]]) + self.centre_m
        return np.concatenate([xy, np.zeros((4, 1))], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class MarkerBoard:
    """All markers of one landing place. Its origin is the point to land on."""

    name: str
    markers: tuple[Marker, ...]

    @staticmethod
    def from_mapping(data: Mapping[str, Any], where: str = "markers") -> MarkerBoard:
        """Build a board from a file's `name` and its list `marker` of tables.

        Each table holds `family`, `id` and `size_m`. It also holds `centre_m` and `yaw_deg` unless the marker lies in the middle
        and points along the pad's x axis.

        Raises:
            BadInput: a key is missing, unknown, of the wrong type or out of range; the text names `where` and the key.
        """
        if unknown := sorted(set(data) - {"name", "marker"}):
            raise BadInput(f"{where}: unknown key {unknown[0]!r}; known are marker, name")
        tables = data.get("marker")
        if not isinstance(tables, list) or not tables:
            raise BadInput(f"{where}: needs at least one [[marker]]")
        name = data.get("name", "markers")
        if not isinstance(name, str):
            raise BadInput(f"{where}: name must be text, got {name!r}")
        markers = tuple(_marker(t, f"{where}: marker {i + 1}") for i, t in enumerate(tables))
        seen = [(m.family, m.id) for m in markers]
        if len(set(seen)) != len(seen):
            raise BadInput(f"{where}: the same family and id twice; markers of one board must differ")
        return MarkerBoard(name, markers)


def _marker(data: object, where: str) -> Marker:
    if not isinstance(data, Mapping):
        raise BadInput(f"{where}: must be a table")
    known = {"family", "id", "size_m", "centre_m", "yaw_deg"}
    if unknown := sorted(set(data) - known):
        raise BadInput(f"{where}: unknown key {unknown[0]!r}; known are {', '.join(sorted(known))}")
    if missing := sorted({"family", "id", "size_m"} - set(data)):
        raise BadInput(f"{where}: key {missing[0]!r} is missing")

    def number(value: object, key: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise BadInput(f"{where}: {key} must be a finite number, got {value!r}")
        return float(value)

    family = data["family"]
    if family not in _FAMILIES:
        raise BadInput(f"{where}: family must be one of {', '.join(sorted(_FAMILIES))}, got {family!r}")
    count = len(_dictionary(family).bytesList)
    if isinstance(data["id"], bool) or not isinstance(data["id"], int) or not 0 <= data["id"] < count:
        raise BadInput(f"{where}: id must be a whole number 0..{count - 1}, got {data['id']!r}")
    size = number(data["size_m"], "size_m")
    if not size > 0:
        raise BadInput(f"{where}: size_m must be positive, got {size!r}")
    centre = data.get("centre_m", [0.0, 0.0])
    if not isinstance(centre, list) or len(centre) != 2:
        raise BadInput(f"{where}: centre_m must be a list of two lengths, got {centre!r}")
    at = (number(centre[0], "centre_m"), number(centre[1], "centre_m"))
    return Marker(family, data["id"], size, at, math.radians(number(data.get("yaw_deg", 0.0), "yaw_deg")))


def find_markers(
    frame: Frame, attitude: Attitude | None, camera: Camera, board: MarkerBoard, *, sigma_deck_rad: float = SIGMA_DECK_RAD
) -> Sighting | None:
    """Detect the landing place by its markers; return None if no marker is visible or the fit is poor.

    Args:
        attitude: the vehicle's attitude at the exposure. With None the vehicle is assumed level, and the covariance grows
            accordingly.
        sigma_deck_rad: one standard deviation of the roll and pitch of the deck, which is assumed level.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    if frame.px.shape[:2] != (camera.height, camera.width):
        h, w = frame.px.shape[:2]
        raise ValueError(f"the frame is {w}x{h} px, the camera's are {camera.width}x{camera.height}")
    corners_px, places = _seen(np.asarray(cv2.cvtColor(frame.px, cv2.COLOR_BGR2GRAY), np.uint8), board)
    if not len(corners_px):
        return None
    orientation = Orientation.of(attitude, sigma_deck_rad)
    R_level_cam = orientation.R_level_body.matrix @ camera.T_body_cam.R.matrix
    sigma_tilt = math.hypot(sigma_deck_rad, math.sqrt(float(np.diag(orientation.cov_tilt).max())))
    solved = _solve(corners_px, places, camera, R_level_cam, sigma_tilt)
    if solved is None:
        return None
    pose, cov, rms_px = solved
    if rms_px > _LARGEST_RMS_PX:
        return None
    side = math.sqrt(max(1.0, cv2.contourArea(corners_px[:4].astype(np.float32))))
    return _sighting(frame, camera, orientation, pose, cov * max(1.0, (rms_px / SIGMA_CORNER_PX) ** 2), rms_px, side, corners_px)


def _seen(gray: NDArray[np.uint8], board: MarkerBoard) -> tuple[F64, F64]:
    """Return (4 n, 2) px of all detected corners and their (4 n, 3) m places on the deck; the largest marker comes first."""
    found: list[tuple[float, F64, F64]] = []
    for family in sorted({m.family for m in board.markers}):
        corners, ids, _ = _detector(family).detectMarkers(gray)
        if not len(corners):
            continue
        known = {m.id: m for m in board.markers if m.family == family}
        for quad, number in zip(corners, np.ravel(ids), strict=True):
            uv = quad.reshape(4, 2).astype(float)
            area = float(cv2.contourArea(quad.astype(np.float32)))
            if int(number) in known and area > _LEAST_SIDE_PX**2:
                found.append((area, uv, known[int(number)].corners()))
    found.sort(key=lambda f: -f[0])
    if not found:
        return np.empty((0, 2)), np.empty((0, 3))
    return np.concatenate([f[1] for f in found]), np.concatenate([f[2] for f in found])


def _solve(uv_px: F64, places: F64, camera: Camera, R_level_cam: F64, sigma_tilt: float) -> tuple[PadPose, F64, float] | None:
    """Return the pose, its (6, 6) covariance and the residuals' root mean square, px.

    The covariance is of the pad's rotation, then of the translation, both in `cam`.
    """
    rays = camera.rays(uv_px)
    ok, rvecs, tvecs, _ = cv2.solvePnPGeneric(places, rays[:, None, :], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not ok:
        return None
    down = R_level_cam[2]
    sigma_ray = SIGMA_CORNER_PX / camera.fx
    best: tuple[float, F64, F64, F64, float] | None = None
    for rvec, tvec in zip(rvecs, tvecs, strict=True):
        R, t = _turn(rvec), np.asarray(tvec, float).ravel()
        cost, M, rms = math.inf, np.eye(6), math.inf
        for _ in range(_STEPS):
            p = places @ R.T + t
            if np.any(p[:, 2] < 0.02):
                break
            e = (rays - p[:, :2] / p[:, 2:]) / sigma_ray
            tilt = np.cross(R[:, 2], down) / sigma_tilt
            J, Jt = _jacobians(p, t, R, down, sigma_ray, sigma_tilt)
            M = J.T @ J + Jt.T @ Jt
            cost = float((e**2).sum() + tilt @ tilt)
            rms = float(np.sqrt((e**2).sum(axis=1).mean())) * SIGMA_CORNER_PX
            step = np.linalg.solve(M, J.T @ e.ravel() - Jt.T @ tilt)
            R, t = _turn(step[:3]) @ R, t + step[3:]
            if float(np.abs(step).max()) < 1e-9:
                break
        if math.isfinite(cost) and (best is None or cost < best[0]):
            best = (cost, R, t, M, rms)
    if best is None:
        return None
    _, R, t, M, rms = best
    U, _, Vt = np.linalg.svd(R)
    return PadPose(Rotation(U @ Vt), t), np.asarray(np.linalg.inv(M), float), rms


def _turn(rotvec: NDArray[Any]) -> F64:
    return np.asarray(cv2.Rodrigues(np.asarray(rotvec, float))[0], float)


def _jacobians(p: F64, t: F64, R: F64, down: F64, sigma_ray: float, sigma_tilt: float) -> tuple[F64, F64]:
    """Return the Jacobians of the rays over sigma (2 n, 6) and of the tilt over sigma (3, 6).

    The columns are a rotation of the pad about its centre and a translation, both in `cam`.
    """
    x, y, z = p.T
    zero = np.zeros_like(x)
    D = np.stack([np.stack([1 / z, zero, -x / z**2], axis=1), np.stack([zero, 1 / z, -y / z**2], axis=1)], axis=1) / sigma_ray
    arm = p - t
    turn = np.zeros((len(p), 3, 3))
    turn[:, 0, 1], turn[:, 0, 2] = arm[:, 2], -arm[:, 1]
    turn[:, 1, 0], turn[:, 1, 2] = -arm[:, 2], arm[:, 0]
    turn[:, 2, 0], turn[:, 2, 1] = arm[:, 1], -arm[:, 0]
    J = np.concatenate([D @ turn, D], axis=2).reshape(-1, 6)
    n = R[:, 2]
    # The derivative follows from (w x n) x down = n (w . down) - w (n . down).
    Jt = np.zeros((3, 6))
    Jt[:, :3] = (np.outer(n, down) - np.eye(3) * float(n @ down)) / sigma_tilt
    return J, Jt


def _sighting(
    frame: Frame,
    camera: Camera,
    orientation: Orientation,
    pose: PadPose,
    cov: F64,
    rms_px: float,
    side_px: float,
    corners_px: F64,
) -> Sighting:
    R_level_body = orientation.R_level_body.matrix
    R_level_cam = R_level_body @ camera.T_body_cam.R.matrix
    d = R_level_body @ (camera.T_body_cam.R.matrix @ pose.t_cam_pad + camera.T_body_cam.t)
    R_level_pad = R_level_cam @ pose.R_cam_pad.matrix
    # Map translation and rotation to `level`, and add the effect of an error of the vehicle's roll and pitch on both.
    A = np.zeros((6, 6))
    A[:3, 3:] = A[3:, :3] = R_level_cam
    h = 1e-5
    tilt = np.zeros((6, 2))
    for k, (roll, pitch) in enumerate(((h, 0.0), (0.0, h))):
        moved = Rotation.from_rpy(orientation.roll_rad + roll, orientation.pitch_rad + pitch, 0.0).matrix
        turn = (Rotation(moved) @ Rotation(R_level_body.T)).rotvec_rad / h
        tilt[:3, k], tilt[3:, k] = np.cross(turn, d), turn
    cov6 = A @ cov @ A.T + tilt @ orientation.cov_tilt @ tilt.T
    cov6 = 0.5 * (cov6 + cov6.T)
    x = R_level_pad[:, 0]
    yaw = -math.atan2(x[1], x[0])
    # A small rotation w of the pad moves the arrow's direction x by w x x; this is its effect on the heading.
    flat = x[0] ** 2 + x[1] ** 2
    by_turn = np.array([x[0] * x[2], x[1] * x[2], -flat]) / flat
    to4 = np.zeros((4, 6))
    to4[:3, :3] = np.eye(3)
    to4[3, 3:] = by_turn
    cov4 = to4 @ cov6 @ to4.T
    confidence = 0.99 / (1.0 + math.exp(-(side_px - 10.0) / 1.5)) / (1.0 + (rms_px / 1.0) ** 4)
    features = tuple(Feature("outline", "marker", quad) for quad in corners_px.reshape(-1, 4, 2))
    return Sighting(
        frame.stamp, frame.seq, "marker", d, wrap_pi(yaw), False, 0.5 * (cov4 + cov4.T), confidence,
        Pose6(d, Rotation(_orthonormal(R_level_pad)), cov6), features,
    )  # fmt: skip


def _orthonormal(m: F64) -> F64:
    U, _, Vt = np.linalg.svd(m)
    return np.asarray(U @ Vt)


@lru_cache(maxsize=8)
def _dictionary(family: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(_FAMILIES[family])


@lru_cache(maxsize=8)
def _detector(family: str) -> cv2.aruco.ArucoDetector:
    options = cv2.aruco.DetectorParameters()
    options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    options.minMarkerPerimeterRate = 0.02
    return cv2.aruco.ArucoDetector(_dictionary(family), options)
