"""Run all methods of the thesis on one frame, and select one of their sightings.

The ellipse method: the outline of the disc, the only mark visible from afar. It gives the position but not the heading.

Edge points are measured between pixels, across the outline, from the local colours. They are mapped to the level plane, where the
outline of a level disc is a circle whose centre is the disc's centre (in the frame itself the centre of the ellipse is not the
image of the disc's centre). An ellipse is fitted there.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
from msgspec.structs import replace

from estimator.contracts.estimates import CENTRE, Feature, Method, Sighting
from estimator.contracts.geometry import F64, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import SIGMA_DECK_RAD, Marks, Orientation, OrientedCamera, sighting, solve
from estimator.vision.detection import Detection
from estimator.vision.pad.pad import Pad
from estimator.vision.thesis.arrow import find_arrow
from estimator.vision.thesis.corners import find_corners
from estimator.vision.thesis.cue import Cue
from estimator.vision.thesis.segmentation import ColourSet, Segmentation, segment

_POINTS = 120  # Points of the outline that are measured
_MIN_RADIUS_PX = 3.0  # Least semi-axis of an ellipse that is taken for the disc
_SIGMA_EDGE_PX = 0.06  # Error that all edge points may have in common (blur, tone curve, paint), so that it does not average out
_BLUR_PX2 = 0.8  # Half-way points of a curved, blurred edge are displaced by about the blur's variance over the radius
_CORRELATED = 4.0  # Number of neighbouring edge points that count as one, because they share pixels and so errors


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Centre, semi-axes (the longer first) and direction of the longer, in the units of the fitted points."""

    x: float
    y: float
    a: float
    b: float
    angle_rad: float

    def points(self, n: int, scale: float = 1.0) -> F64:
        """Return (n, 2) points on the outline, `scale` times its size."""
        t = np.linspace(0.0, math.tau, n, endpoint=False)
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        e, f = scale * self.a * np.cos(t), scale * self.b * np.sin(t)
        return np.stack([self.x + e * c - f * s, self.y + e * s + f * c], axis=1)

    def normals(self, n: int) -> F64:
        """Return (n, 2) outward unit normals of the outline at `points(n)`."""
        t = np.linspace(0.0, math.tau, n, endpoint=False)
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        e, f = self.b * np.cos(t), self.a * np.sin(t)
        out = np.stack([e * c - f * s, e * s + f * c], axis=1)
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))

    def residuals(self, xy: F64) -> F64:
        """Return (N,) signed distances from the outline along the ray from the centre, scaled to the normal."""
        c, s = math.cos(self.angle_rad), math.sin(self.angle_rad)
        dx, dy = xy[:, 0] - self.x, xy[:, 1] - self.y
        e, f = (dx * c + dy * s) / self.a, (dy * c - dx * s) / self.b
        rho = np.hypot(e, f)
        slope = np.hypot(e / self.a, f / self.b)
        return np.asarray((rho - 1.0) * rho / np.maximum(slope, 1e-12))


def fit_ellipse(xy: F64) -> Ellipse | None:
    """Fit an ellipse to (N, 2) points, N >= 6, by direct least squares; return None if they determine none.

    Points are centred and scaled first; otherwise the scatter matrix mixes numbers of size 1 and 1e11. Of the three eigenvectors
    the one with 4ac - b^2 > 0 is the ellipse; there is exactly one.

    Source: Halir and Flusser, Numerically stable direct least squares fitting of ellipses, 1998, section 3.
    """
    if len(xy) < 6 or not np.all(np.isfinite(xy)):
        return None
    mean = xy.mean(axis=0)
    size = float(np.sqrt(np.mean((xy - mean) ** 2)))
    if size <= 0.0:
        return None
    x, y = ((xy - mean) / size).T
    D1, D2 = np.stack([x * x, x * y, y * y], axis=1), np.stack([x, y, np.ones_like(x)], axis=1)
    S1, S2, S3 = D1.T @ D1, D1.T @ D2, D2.T @ D2
    try:
        T = -np.linalg.solve(S3, S2.T)
    except np.linalg.LinAlgError:
        return None
    M = S1 + S2 @ T
    _, vectors = np.linalg.eig(np.array([M[2] / 2.0, -M[1], M[0] / 2.0]))
    vectors = np.real(vectors)
    discriminant = 4.0 * vectors[0] * vectors[2] - vectors[1] ** 2
    k = int(np.argmax(discriminant))
    if discriminant[k] <= 1e-9:
        return None
    A, B, C = vectors[:, k]
    D, E, F = T @ vectors[:, k]
    # The centre is where the gradient vanishes; the semi-axes follow from the eigenvalues of the quadratic part about it.
    det = 4.0 * A * C - B * B
    cx, cy = (B * E - 2.0 * C * D) / det, (B * D - 2.0 * A * E) / det
    level = -(A * cx * cx + B * cx * cy + C * cy * cy + D * cx + E * cy + F)
    values, axes = np.linalg.eigh(np.array([[A, B / 2.0], [B / 2.0, C]]))
    squares = level / values
    if np.any(squares <= 0.0) or not np.all(np.isfinite(squares)):
        return None
    semi = np.sqrt(squares)
    i = int(np.argmax(semi))
    return Ellipse(
        float(cx * size + mean[0]), float(cy * size + mean[1]), float(semi[i] * size), float(semi[1 - i] * size),
        math.atan2(float(axes[1, i]), float(axes[0, i])),
    )  # fmt: skip


def find_disc(seg: Segmentation, view: OrientedCamera, pad: Pad) -> Cue | None:
    """Return the disc's outline; None if it leaves the frame, is too small, or is no ellipse."""
    if seg.touches_border:
        return None
    coarse = fit_ellipse(_resampled(seg.hull_px))
    if coarse is None or coarse.b < max(_MIN_RADIUS_PX, 0.4 * coarse.a):
        return None
    radius_m = pad.markings.field_radius_m
    search = min(0.13 * coarse.b, 20.0) + 1.0
    axis = _rim_axis(pad)
    edges = _edges(seg, coarse, search, axis, _POINTS // 2)
    found = _robust_fit(edges)
    if found is None or found[0].b < _MIN_RADIUS_PX:
        return None
    outline = found[0]
    edges = _edges(seg, outline, min(4.0, max(2.0, 0.2 * outline.b)), axis)
    if len(edges) < 0.6 * _POINTS or _goes_on_outside(seg, outline):
        return None
    plane = view.plane(edges)
    if (found := _robust_fit(plane)) is None:
        return None
    ellipse, inside = found
    radius_px = math.sqrt(outline.a * outline.b)
    px_of = radius_px / math.sqrt(ellipse.a * ellipse.b)
    rms_px = float(np.sqrt(np.mean(ellipse.residuals(plane[inside]) ** 2))) * px_of
    roundness = ellipse.b / ellipse.a
    least_round = 0.9 if view.orientation.measured else 0.8
    fraction = float(np.mean(inside)) * len(edges) / _POINTS
    if rms_px > max(0.5, 0.02 * radius_px) or roundness < least_round - 0.6 / radius_px or fraction < 0.55:
        return None

    # An unknown tilt shortens one axis only, and noise alone lengthens the longer one, so the mean is right if the tilt is known.
    radius = math.sqrt(ellipse.a * ellipse.b) if view.orientation.measured else ellipse.a
    angles = np.linspace(0.0, math.tau, 8, endpoint=False)
    unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    uv = view.pixels(np.array([ellipse.x, ellipse.y]) + radius * unit)
    centre_uv = view.pixels(np.array([[ellipse.x, ellipse.y]]))
    if not np.all(np.isfinite(uv)):
        return None
    n = max(1.0, min(float(inside.sum()), math.tau * radius_px) / _CORRELATED)
    sigma_centre, sigma_radius = rms_px * math.sqrt(2.0 / n), rms_px / math.sqrt(n)
    out = (uv - centre_uv) / np.linalg.norm(uv - centre_uv, axis=1, keepdims=True)
    modes = np.zeros((3, 8, 2))
    modes[0, :, 0] = modes[1, :, 1] = math.hypot(sigma_centre, 0.3 * _SIGMA_EDGE_PX)
    modes[2] = out * math.hypot(sigma_radius, _SIGMA_EDGE_PX, _BLUR_PX2 / radius_px)
    confidence = fraction * roundness * math.exp(-((rms_px / max(0.7, 0.015 * radius_px)) ** 2)) * (0.4 + 0.6 * seg.plausibility)
    features = (Feature("ellipse", "disc", view.pixels(ellipse.points(72))), Feature("point", "centre", centre_uv))
    return Cue(Marks(uv, radius_m * unit, modes, yaw_known=False), confidence, features)


def _goes_on_outside(seg: Segmentation, outline: Ellipse) -> bool:
    """Return whether the disc's colour continues a little outside: then this is the inner disc, and its edge is the ring's."""
    light = []
    for scale in (0.85, 1.15):
        at = (outline.points(_POINTS, scale) - seg.origin_px).astype(np.float32)
        light.append(cv2.remap(seg.light, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[:, 0])
    inner, outer = light
    alike = np.abs(outer - inner).sum(axis=1) < 0.25 * np.maximum(inner.sum(axis=1), 15.0)
    return bool(np.mean(alike) > 0.6)


def _resampled(hull: F64) -> F64:
    """Resample the closed hull at equal steps; its vertices alone would overweight the curved parts."""
    closed = np.concatenate([hull, hull[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], 90, endpoint=False)
    return np.stack([np.interp(at, along, closed[:, 0]), np.interp(at, along, closed[:, 1])], axis=1)


def _rim_axis(pad: Pad) -> F64 | None:
    """Return the (3,) blue, green, red direction from the disc's paint to its rim's, without grey; None for a pad without rim."""
    if pad.markings.colours.rim is None or pad.markings.rim_width_m <= 0.0:
        return None
    step = np.array(pad.markings.colours.rim[::-1], dtype=float) - pad.markings.colours.disc[::-1]
    return np.asarray(step - step.mean())


def _edges(seg: Segmentation, ellipse: Ellipse, reach_px: float, rim_axis: F64 | None, n: int = _POINTS) -> F64:
    """Return (N, 2) px where the colour along the normals of the ellipse is half-way from inside to outside, N <= n.

    The reference colours are local: the step from the mean colour well inside to the mean well outside is cut at its half. A
    search (reach over 4 px) takes the first point where the colour differs from the inside's by half of its largest difference.
    Towards a rim, the component along `rim_axis` counts, up to its largest value; what lies beyond a rim only a pixel or two wide
    is then ignored.
    """
    step = 0.5 if reach_px <= 6.0 else 1.0
    s = np.arange(-reach_px, reach_px + 1e-9, step)
    points, normals = ellipse.points(n), ellipse.normals(n)
    at = points[:, None, :] + s[None, :, None] * normals[:, None, :]
    in_roi = (at - seg.origin_px).astype(np.float32)
    sampled = cv2.remap(seg.light, in_roi[:, :, 0], in_roi[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = np.asarray(sampled, np.float32)
    away = colours - colours[:, s <= -0.45 * reach_px].mean(axis=1, keepdims=True)
    if rim_axis is not None:
        along = away @ rim_axis.astype(np.float32)
        level = along / np.maximum(along.max(axis=1, keepdims=True), 10.0 * float(np.linalg.norm(rim_axis)))
    elif reach_px > 4.0:
        apart = np.abs(away).sum(axis=2)
        level = apart / np.maximum(apart.max(axis=1, keepdims=True), 15.0)
    else:
        whole = away[:, s >= 0.45 * reach_px].mean(axis=1, keepdims=True)
        level = np.sum(away * whole, axis=2) / np.maximum(np.sum(whole**2, axis=2), 50.0)
    over = level >= 0.5
    over[:, s <= -0.45 * reach_px] = False
    k = np.argmax(over, axis=1)
    ok = over.any(axis=1) & (k > 0)
    i = np.flatnonzero(ok)
    low, high = level[i, k[i] - 1], level[i, k[i]]
    where = s[k[i] - 1] + step * np.clip((0.5 - low) / np.maximum(high - low, 1e-6), 0.0, 1.0)
    width, height = seg.size_px
    out = points[i] + where[:, None] * normals[i]
    within = (out[:, 0] >= 0) & (out[:, 1] >= 0) & (out[:, 0] <= width - 1) & (out[:, 1] <= height - 1)
    return np.asarray(out[within])


def _robust_fit(xy: F64) -> tuple[Ellipse, np.ndarray[tuple[int], np.dtype[np.bool_]]] | None:
    """Fit an ellipse and return it with the mask of its inliers; the second fit leaves out the outliers of the first."""
    inside = np.all(np.isfinite(xy), axis=1)
    ellipse = None
    for _ in range(2):
        if inside.sum() < 20:
            return None
        ellipse = fit_ellipse(xy[inside])
        if ellipse is None:
            return None
        away = np.abs(ellipse.residuals(np.where(np.isfinite(xy), xy, 1e3)))
        spread = 1.4826 * float(np.median(away[inside]))
        inside = away <= max(3.0 * spread, 1e-3 * ellipse.b)
    return None if ellipse is None else (ellipse, np.asarray(inside))


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
    cues: dict[Method, Cue | None] = {
        "ellipse": find_disc(seg, view, pad),
        "arrow": find_arrow(seg, view, pad),
        "corners": find_corners(seg, view, pad),
    }
    methods: dict[Method, Sighting | None] = dict.fromkeys(cues)
    R_body_level = view.orientation.R_level_body.inv
    for method, cue in cues.items():
        fix = None if cue is None else solve(cue.marks, view)
        if cue is not None and fix is not None:
            centre = camera.project((camera.T_body_cam.inv @ (R_body_level @ fix.d_body_pad_level))[None])
            features = *cue.features, Feature("point", CENTRE, centre)
            methods[method] = sighting(frame, method, cue.marks, fix, cue.confidence, features)
    chosen = choose(methods, seg.touches_border)
    best = methods[chosen] if chosen is not None else None
    if best is not None:
        best = replace(with_heading_of(best, methods["arrow"]), method="selected")
    return Detection(best, chosen, MappingProxyType(methods))
