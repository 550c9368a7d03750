"""Solve for the camera from views of the board: bundle adjustment, choice of the lens, rejection of bad views, covariance.

The covariance does not depend on the unit of the board: each view's pose is eliminated, and the camera's columns are scaled to
unit length before anything is inverted. It is the larger one, direction by direction, of what the residuals' size implies and of
what a bootstrap over the views shows; the spread of the lens models that explain the views about as well is added.

Source: Zhang, A flexible new technique for camera calibration, PAMI 2000; Brown 1971 and Kannala and Brandt 2006 for the lens;
Schwarz, Estimating the dimension of a model, 1978, for how many of its terms the views support, and Raftery, Bayesian model
selection, 1995, for the spread; Rubin, The Bayesian bootstrap, 1981.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from companion.tools.calibrate.board import Board, BoardView
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.vision.camera.camera import Camera

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
_FISHEYES = {
    "fisheye k1": cv2.fisheye.CALIB_FIX_K2 | cv2.fisheye.CALIB_FIX_K3 | cv2.fisheye.CALIB_FIX_K4,
    "fisheye k1 k2": cv2.fisheye.CALIB_FIX_K3 | cv2.fisheye.CALIB_FIX_K4,
    "fisheye k1 k2 k3": cv2.fisheye.CALIB_FIX_K4,
    "fisheye k1 k2 k3 k4": 0,
}
_TERMS = {name: len(name.removeprefix("fisheye ").split()) for name in (*_MODELS, *_FISHEYES)}
"""Terms of the distortion that a model estimates: the first ones of its coefficients."""
LensChoice = Literal["auto", "brown", "fisheye"]
_STRONG = 10.0
"""Least advantage of a fisheye's criterion over that of Brown's lens: very strong evidence in Raftery's table."""
_DRAWS = 400
"""Draws of the bootstrap."""
_CONDITION = 1e-10
"""Least eigenvalue of the scaled information, whose largest is about 1, at which the views determine a camera at all."""
_AIM = 0.15
"""Radius of the disc that distances are measured by, over the distance."""


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
    cov: F64
    """Covariance of fx, fy, cx, cy (px) and of the distortion's terms, (9, 9); 0 for a term that was not estimated."""
    model: str
    """Terms of the distortion that were estimated."""
    fits: tuple[Fit, ...]
    left_out: tuple[Fit, ...]

    @property
    def sigma(self) -> F64:
        """The standard deviations of fx, fy, cx, cy (px) and of the distortion's terms, (9,)."""
        return np.asarray(np.sqrt(np.diag(self.cov)))

    @property
    def distance_sigma(self) -> float:
        """The standard deviation of distances as a share of them, the largest of `distance_slopes`."""
        return float(self._distance_sigmas.max())

    @property
    def worst_place(self) -> int:
        """The row of `distance_slopes` that `distance_sigma` is of."""
        return int(self._distance_sigmas.argmax())

    @property
    def _distance_sigmas(self) -> F64:
        slopes = distance_slopes(self.camera)
        return np.asarray(np.sqrt(np.maximum(0.0, np.einsum("ki,ij,kj->k", slopes, self.cov, slopes))))

    @property
    def distances_right_to(self) -> float:
        """Relative error of distances that 95 of 100 sets of views stay below: Student's quantile for the number of views."""
        dof = max(1, len(self.fits) - 2)
        return _student(dof) * self.distance_sigma

    @property
    def rms_px(self) -> float:
        """The root mean square length of all residuals of the used views, px."""
        return float(np.sqrt(np.mean(np.concatenate([np.sum(f.residual_px**2, axis=1) for f in self.fits]))))


def solve(
    views: Sequence[BoardView], board: Board, size: tuple[int, int], mount: Transform | None = None, lens: LensChoice = "auto"
) -> Solution:
    """Return the camera that fits the views best.

    Args:
        size: (width, height) px of the images.
        mount: `T_body_cam` of the camera; None means straight down with the nose at the top of the image.
        lens: model of the lens; "auto" takes a fisheye where the views favour it strongly.

    Raises:
        BadInput: there are too few views, or no camera fits them (because of the wrong board, for example).
    """
    used = list(views)
    rejected: list[BoardView] = []
    for _ in range(4):
        if len(used) < LEAST_VIEWS:
            raise BadInput(f"only {len(used)} usable views of the board; at least {LEAST_VIEWS} are needed to begin with")
        camera, cov, model, poses = _best_model(used, board, size, mount, lens)
        fits = [_fit(v, board, camera, *pose) for v, pose in zip(used, poses, strict=True)]
        limit = max(_OUTLIER_PX, _OUTLIER * float(np.median([f.rms_px for f in fits])))
        bad = {id(f.view) for f in fits if f.rms_px > limit}
        if not bad or len(used) - len(bad) < LEAST_VIEWS:
            break
        rejected += [v for v in used if id(v) in bad]
        used = [v for v in used if id(v) not in bad]
    out = [_fit(v, board, camera, *_pose(v, board, camera)) for v in rejected]
    solved = Solution(camera, cov, model, tuple(fits), tuple(out))
    return replace(solved, camera=replace(camera, focal_sigma=min(0.2, solved.distance_sigma)))


_Solved = tuple[Camera, F64, str, list[tuple[F64, F64]]]


class _Candidate(NamedTuple):
    """One lens model, fitted to the views."""

    camera: Camera
    poses: list[tuple[F64, F64]]
    model: str
    criterion: float
    """Bayesian information criterion."""


def _best_model(
    views: Sequence[BoardView], board: Board, size: tuple[int, int], mount: Transform | None, lens: LensChoice
) -> _Solved:
    """Return the model with the lowest Bayesian information criterion, with its covariance and that of its peers."""
    mounted = mount or Transform(Rotation.from_rpy(0.0, 0.0, np.pi / 2), np.zeros(3))
    tried = [] if lens == "fisheye" else [_fitted(views, board, size, mounted, name) for name in _MODELS]
    found = [one for one in tried if one is not None]
    best = min(found, key=lambda one: one.criterion, default=None)
    if lens != "brown":
        bent = [one for one in (_fitted(views, board, size, mounted, name) for name in _FISHEYES) if one is not None]
        of_bent = min(bent, key=lambda one: one.criterion, default=None)
        if of_bent is not None and (best is None or of_bent.criterion < best.criterion - _STRONG):
            best, found = of_bent, bent
    if best is None:
        raise BadInput("no camera explains these views; is it the board that was named, with squares counted rightly?")
    return best.camera, _covariance(best, found, views, board), best.model, best.poses


def _fitted(views: Sequence[BoardView], board: Board, size: tuple[int, int], mounted: Transform, name: str) -> _Candidate | None:
    """Return a fitted model; None if it folds the image: an ill-posed set fits best with such a lens."""
    points, criteria = board.corners_m, (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-10)
    bent = name in _FISHEYES
    try:
        if bent:
            flags = cv2.fisheye.CALIB_RECOMPUTE_EXTRINSIC | cv2.fisheye.CALIB_FIX_SKEW | _FISHEYES[name]
            rms, K, D, rvecs, tvecs = cv2.fisheye.calibrate(
                [points[v.ids][None] for v in views], [v.uv_px[None] for v in views], size, np.eye(3), np.zeros((4, 1)),
                flags=flags, criteria=criteria,
            )  # fmt: skip
        else:
            rms, K, D, rvecs, tvecs = cv2.calibrateCamera(
                [points[v.ids].astype(np.float32) for v in views], [v.uv_px.astype(np.float32) for v in views], size, np.eye(3),
                np.zeros(5), flags=_MODELS[name], criteria=criteria,
            )  # fmt: skip
        terms = _flat(D)[: 4 if bent else 5]
        camera = Camera(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], terms, mounted, lens="fisheye" if bent else "brown")
    except (cv2.error, ValueError):
        return None
    poses = [(_flat(r), _flat(t)) for r, t in zip(rvecs, tvecs, strict=True)]
    n = 2 * sum(len(v.ids) for v in views)
    criterion = n / _CORRELATED * np.log(max(rms**2 / 2, 1e-12)) + (4 + _TERMS[name] + 6 * len(views)) * np.log(n)
    return _Candidate(camera, poses, name, float(criterion)) if _one_to_one(camera) else None


def _covariance(best: _Candidate, peers: Sequence[_Candidate], views: Sequence[BoardView], board: Board) -> F64:
    """Return the covariance of the best model's numbers, (9, 9), its peers' spread by their weights included."""
    least = min(one.criterion for one in peers)
    weights = np.array([math.exp(-0.5 * (one.criterion - least)) for one in peers])
    weights /= weights.sum()
    out = np.zeros((9, 9))
    for one, weight in zip(peers, weights, strict=True):
        if weight > 1e-3 or one is best:
            off = _numbers(one.camera) - _numbers(best.camera)
            out += weight * (_own_covariance(one, views, board) + np.outer(off, off))
    return out


def _numbers(camera: Camera) -> F64:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion, 0.0][:9], float)


def _own_covariance(one: _Candidate, views: Sequence[BoardView], board: Board) -> F64:
    """Return the covariance of a model's numbers, (9, 9), as if no other model could be right; inf if the views leave it open."""
    free = 4 + _TERMS[one.model]
    normals, gradients = np.zeros((len(views), free, free)), np.zeros((len(views), free))
    squares = count = 0.0
    for k, (view, (rvec, tvec)) in enumerate(zip(views, one.poses, strict=True)):
        uv, by_pose, by_camera = _projected(board.corners_m[view.ids], rvec, tvec, one.camera)
        left, by_camera = (view.uv_px - uv).ravel(), by_camera[:, :free]
        # The pose is eliminated by a projection orthogonal to its columns.
        basis = np.linalg.qr(by_pose / np.linalg.norm(by_pose, axis=0))[0]
        by_camera = by_camera - basis @ (basis.T @ by_camera)
        normals[k], gradients[k] = by_camera.T @ by_camera, by_camera.T @ left
        squares, count = squares + float(left @ left), count + len(left) - 6
    information = normals.sum(axis=0)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    out = np.zeros((9, 9))
    if np.linalg.eigvalsh(scaled)[0] < _CONDITION:
        out[:free, :free] = np.diag((1e6 * np.ones(free)) ** 2)
        return out
    var = _CORRELATED * squares / max(1.0, count - free)
    of_residuals = var * np.linalg.inv(scaled)
    weights = np.random.default_rng(1).exponential(size=(_DRAWS, len(views)))
    drawn = np.einsum("dv,vij->dij", weights, normals * np.outer(scale, scale))
    steps = np.linalg.solve(drawn, (weights @ (gradients * scale))[..., None])[..., 0]
    of_views = steps.T @ steps / _DRAWS * len(views) / max(1, len(views) - 1)
    # Both in units of the first: a direction in which the views differ more than the residuals say has the views' variance.
    L = np.linalg.cholesky(of_residuals)
    sizes, axes = np.linalg.eigh(np.linalg.solve(L, np.linalg.solve(L, of_views).T))
    larger = L @ (axes * np.maximum(sizes, 1.0)) @ axes.T @ L.T
    out[:free, :free] = larger * np.outer(scale, scale)
    return out


def _projected(points_m: F64, rvec: F64, tvec: F64, camera: Camera) -> tuple[F64, F64, F64]:
    """Return (n, 2) px, and their change by rotation and place, (2 n, 6), and by the camera's numbers, (2 n, 8 or 9)."""
    if camera.lens == "fisheye":
        uv, J = cv2.fisheye.projectPoints(points_m[None], rvec, tvec, camera.K, camera.distortion)
        return np.asarray(uv, float).reshape(-1, 2), np.asarray(J[:, 8:14]), np.asarray(J[:, :8])
    uv, J = cv2.projectPoints(points_m, rvec, tvec, camera.K, camera.distortion)
    return np.asarray(uv, float).reshape(-1, 2), np.asarray(J[:, :6]), np.asarray(J[:, 6:15])


def distance_slopes(camera: Camera) -> F64:
    """Return the relative change of a level pad's measured distance by the camera's numbers, (5, 9).

    The pad lies in the middle of the image and halfway to each of its corners.
    """
    out = np.zeros((5, 9))
    for k, p_m in enumerate(_pads(camera)):
        by_camera = _projected(p_m, np.zeros(3), np.zeros(3), camera)[2]
        out[k, : by_camera.shape[1]] = -_distance_change(p_m, camera, by_camera)
    return out


def distance_errors(camera: Camera, true: Camera) -> F64:
    """Return how much too far, as a share, a camera measures the pads of `distance_slopes` that another one sees, (5,)."""
    return np.array([_distance_change(p, camera, (true.project(p) - camera.project(p)).reshape(-1, 1))[0] for p in _pads(camera)])


def _pads(camera: Camera) -> list[F64]:
    """Return discs at unit distance from the lens plane, (24, 3) m in `cam`: in the middle and halfway to each corner."""
    halves = [(0.5, 0.5), (0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    disc = _AIM * np.stack([np.cos(angles), np.sin(angles), np.zeros(24)], axis=1)
    middles = camera.rays(np.array(halves) * (camera.width - 1, camera.height - 1))
    return [disc + np.append(middle, 1.0) for middle in middles]


def _distance_change(p_m: F64, camera: Camera, moved_px: F64) -> F64:
    """Return by what share a disc's measured distance changes as its pixels move by columns of (2 n, m) px, (m,)."""
    middle = p_m.mean(axis=0)
    by_pose = _projected(p_m - middle, np.zeros(3), middle, camera)[1]
    # The attitude gives the tilt: heading and place are free.
    fitted = np.linalg.lstsq(by_pose[:, 2:], moved_px, rcond=None)[0]
    return np.asarray(middle @ fitted[1:] / (middle @ middle))


def _student(dof: int) -> float:
    """Return Student's two-sided 95 % quantile (Hill's expansion about the normal one; within 1 % from three degrees on)."""
    z, n = 1.959964, float(dof)
    terms = (
        (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96, (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
    )  # fmt: skip
    return z + sum(term / n**k for k, term in enumerate(terms, start=1))


def _one_to_one(camera: Camera) -> bool:
    """Return whether the distorted radius grows with the angle over the whole image."""
    w, h = camera.width, camera.height
    edge = np.array([(u, v) for u in (0, w / 2, w - 1) for v in (0, h / 2, h - 1)], dtype=float)
    reach = float(np.linalg.norm((edge - (camera.cx, camera.cy)) / (camera.fx, camera.fy), axis=1).max())
    if camera.lens == "fisheye":
        ideal = np.tan(np.linspace(0.0, 1.5, 400))
    else:
        ideal = np.linspace(0.0, 2.0 * reach, 400)
    radial = camera if camera.lens == "fisheye" else replace(camera, distortion=camera.distortion * (1, 1, 0, 0, 1))
    bent = radial.distort(np.stack([ideal, 0.0 * ideal], axis=1))[:, 0]
    rising = np.concatenate([[True], np.diff(bent) > 0])
    first_fall = len(ideal) if rising.all() else int(np.argmin(rising))
    seen_whole = camera.lens == "fisheye" and bool(rising.all())
    return seen_whole or bool(bent[:first_fall].max() >= reach)


def _pose(view: BoardView, board: Board, camera: Camera) -> tuple[F64, F64]:
    _, rvec, tvec = cv2.solvePnP(board.corners_m[view.ids], camera.rays(view.uv_px), np.eye(3), np.zeros(5))
    return _flat(rvec), _flat(tvec)


def _flat(column: ArrayLike) -> F64:
    return np.array(column, dtype=float).ravel()


def _fit(view: BoardView, board: Board, camera: Camera, rvec: F64, tvec: F64) -> Fit:
    R = Rotation.from_rotvec(rvec).matrix
    p_cam = board.corners_m[view.ids] @ R.T + tvec
    normal = R[:, 2] * np.sign(R[2, 2])
    tilt = (float(np.degrees(np.arctan2(-normal[1], normal[2]))), float(np.degrees(np.arctan2(normal[0], normal[2]))))
    return Fit(view, view.uv_px - camera.project(p_cam), tilt, float(p_cam[:, 2].mean()))
