"""Solve for the camera from views of the board: bundle adjustment, choice of distortion terms, rejection of bad views.

Source: Zhang, A flexible new technique for camera calibration, PAMI 2000; Brown 1971 for the distortion; Schwarz, Estimating the
dimension of a model, 1978, for how many of its terms the views support.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from companion.tools.calibrate.board import Board
from companion.tools.calibrate.views import BoardView
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.vision.camera import Camera

LEAST_VIEWS = 4
"""Fewest views that can be solved."""
_OUTLIER = 3.0
"""Multiple of the median view's error beyond which a view is rejected."""
_OUTLIER_PX = 0.3
"""Error up to which a view is never rejected, px."""
_CORRELATED = 1.5
"""Errors of one view's corners correlate (blur, light, paper), so they inform this many times less than independent ones."""
_MODELS = {
    "k1": cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3,
    "k1 k2": cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3,
    "k1 k2 p1 p2": cv2.CALIB_FIX_K3,
    "k1 k2 p1 p2 k3": 0,
}


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """One view's fit to the camera."""

    view: BoardView
    residual_px: F64
    """Measured minus predicted corners, (n, 2) px."""
    tilt_deg: tuple[float, float]
    """Tilt of the board relative to the image plane, about the image's x and y."""
    distance_m: float

    @property
    def rms_px(self) -> float:
        """The root mean square length of the residuals, px."""
        return float(np.sqrt(np.mean(np.sum(self.residual_px**2, axis=1))))


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A camera and the views that it was solved from."""

    camera: Camera
    sigma: F64
    """Standard deviations of fx, fy, cx, cy (px), k1, k2, p1, p2, k3, (9,); 0 for a term that was not estimated."""
    model: str
    """Terms of the distortion that were estimated."""
    fits: tuple[Fit, ...]
    left_out: tuple[Fit, ...]

    @property
    def rms_px(self) -> float:
        """The root mean square length of all residuals of the used views, px."""
        return float(np.sqrt(np.mean(np.concatenate([np.sum(f.residual_px**2, axis=1) for f in self.fits]))))


def solve(views: Sequence[BoardView], board: Board, size: tuple[int, int], mount: Transform | None = None) -> Solution:
    """Return the camera that fits the views best.

    Args:
        size: (width, height) px of the images.
        mount: `T_body_cam` of the camera; None means straight down with the nose at the top of the image.

    Raises:
        BadInput: there are too few views, or no camera fits them (because of the wrong board, for example).
    """
    used = list(views)
    rejected: list[BoardView] = []
    for _ in range(4):
        if len(used) < LEAST_VIEWS:
            raise BadInput(f"only {len(used)} usable views of the board; at least {LEAST_VIEWS} are needed to begin with")
        camera, sigma, model, poses = _best_model(used, board, size, mount)
        fits = [_fit(v, board, camera, *pose) for v, pose in zip(used, poses, strict=True)]
        limit = max(_OUTLIER_PX, _OUTLIER * float(np.median([f.rms_px for f in fits])))
        bad = {id(f.view) for f in fits if f.rms_px > limit}
        if not bad or len(used) - len(bad) < LEAST_VIEWS:
            break
        rejected += [v for v in used if id(v) in bad]
        used = [v for v in used if id(v) not in bad]
    out = [_fit(v, board, camera, *_pose(v, board, camera)) for v in rejected]
    return Solution(camera, sigma, model, tuple(fits), tuple(out))


_Solved = tuple[Camera, F64, str, list[tuple[F64, F64]]]


def _best_model(views: Sequence[BoardView], board: Board, size: tuple[int, int], mount: Transform | None) -> _Solved:
    """Return the model with the lowest Bayesian information criterion."""
    points = board.corners_m
    object_points = [points[v.ids].astype(np.float32) for v in views]
    image_points = [v.uv_px.astype(np.float32) for v in views]
    n = 2 * sum(len(v.ids) for v in views)
    best: tuple[float, _Solved] | None = None
    for terms, (name, flags) in enumerate(_MODELS.items()):
        try:
            rms, K, D, rvecs, tvecs, sigma, _, _ = cv2.calibrateCameraExtended(
                object_points, image_points, size, np.eye(3), np.zeros(5), flags=flags,
                criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10),
            )  # fmt: skip
            mounted = mount or Transform(Rotation.from_rpy(0.0, 0.0, np.pi / 2), np.zeros(3))
            camera = Camera(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], np.array(D, dtype=float).ravel()[:5], mounted)
        except (cv2.error, ValueError):
            continue
        parameters = 5 + [0, 1, 3, 4][terms] + 6 * len(views)
        criterion = n / _CORRELATED * np.log(max(rms**2 / 2, 1e-12)) + parameters * np.log(n)
        # Without this check an ill-posed set fits best with an unusably distorted lens.
        if _one_to_one(camera) and (best is None or criterion < best[0]):
            poses = [(_three(r), _three(t)) for r, t in zip(rvecs, tvecs, strict=True)]
            best = float(criterion), (camera, np.array(sigma, dtype=float).ravel()[:9], name, poses)
    if best is None:
        raise BadInput("no camera explains these views; is it the board that was named, with squares counted rightly?")
    return best[1]


def _one_to_one(camera: Camera) -> bool:
    """Return whether the distorted radius grows with the angle over the whole image."""
    w, h = camera.width, camera.height
    edge = np.array([(u, v) for u in (0, w / 2, w - 1) for v in (0, h / 2, h - 1)], dtype=float)
    reach = float(np.linalg.norm((edge - (camera.cx, camera.cy)) / (camera.fx, camera.fy), axis=1).max())
    k1, k2, _, _, k3 = camera.distortion
    ideal = np.linspace(0.0, 2.0 * reach, 400)
    bent = ideal * (1 + k1 * ideal**2 + k2 * ideal**4 + k3 * ideal**6)
    rising = np.concatenate([[True], np.diff(bent) > 0])
    first_fall = len(ideal) if rising.all() else int(np.argmin(rising))
    return bool(bent[:first_fall].max() >= reach)


def _pose(view: BoardView, board: Board, camera: Camera) -> tuple[F64, F64]:
    _, rvec, tvec = cv2.solvePnP(board.corners_m[view.ids], view.uv_px, camera.K, camera.distortion)
    return _three(rvec), _three(tvec)


def _three(column: ArrayLike) -> F64:
    return np.array(column, dtype=float).ravel()


def _fit(view: BoardView, board: Board, camera: Camera, rvec: F64, tvec: F64) -> Fit:
    R = Rotation.from_rotvec(rvec).matrix
    p_cam = board.corners_m[view.ids] @ R.T + tvec
    normal = R[:, 2] * np.sign(R[2, 2])
    tilt = (float(np.degrees(np.arctan2(-normal[1], normal[2]))), float(np.degrees(np.arctan2(normal[0], normal[2]))))
    return Fit(view, view.uv_px - camera.project(p_cam), tilt, float(p_cam[:, 2].mean()))
