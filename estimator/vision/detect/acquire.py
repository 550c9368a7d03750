"""Find the pad in a whole frame without a prior: hypotheses from coarse to fine, each verified with the whole drawing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, AlignedTemplate, align
from estimator.vision.detect.circles import Circle, Plane, circles, tolerance_of
from estimator.vision.detect.heading import heading
from estimator.vision.detect.paint import FRESH, PaintMemory
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.detect.scan import Blob, Coarse, blobs, coarse, disc_regions, limits
from estimator.vision.detect.strokes import h_markings
from estimator.vision.detect.template import disc_edge_m
from estimator.vision.detect.verification import ALONE_LOG_ODDS, alone, arrow_support, confidence
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

U8 = NDArray[np.uint8]

SURE, ENOUGH = 0.9, 0.5
"""Confidence at which no further hypotheses are tried, and confidence at which no further kinds of hypotheses are tried."""
_MOST_ALIGNED = 16
"""Largest number of hypotheses of one frame that the drawing is aligned at before the search is given up."""
_ALIGNED, _ALIGNED_FREE, _ALIGNED_FAR = 2, 3, 6
"""Numbers of the best hypotheses of one kind that the drawing is aligned at: usually, with the tilt unknown, and from afar. From
afar a hypothesis by itself is weak evidence and an alignment is cheap.
"""
_LEAST_GUESS = 0.04
"""Smallest fraction of the variance that a guess must explain. No guess with less was the pad in 900 frames."""
_TRIES = 2
"""Guesses tried for each candidate that may be kept. Most false candidates are refused at the first step and cost little."""
_SMALL_PX = 28.0
"""Radius of a disc, in pixels of the coarse frame, below which the full-size frame is sampled instead."""
_STEPS, _STEPS_FREE = 4, 8
"""Gauss-Newton steps of alignment, with the tilt known and unknown."""
_ARROW_SEEN = 0.3
"""Support of the arrowhead at which the heading is unambiguous."""
COARSE_WIDTH_PX = 160
"""Approximate width of the frame in the first pass. At this width the pad has a radius of 5 px from 7 m with the sim camera."""
_PLAIN = 0.5
"""Fraction of the variance explained by a guess at which no further regions are searched."""
_LEAST_FACING = math.cos(math.radians(38.0))
"""Smallest cosine between the pad's normal and the camera's axis when the tilt is unknown: 25 degrees of tilt plus an error."""
_BLOB_RADII = (0.95, 1.5)
"""Factors from a blob's radius to the disc's: the blob is the disc, or the part of it inside the ring."""
_COVERED_ARC_RAD = 4.6
"""Arc of a disc's outline below which the disc is taken to be half covered."""
_HALVES = 6
"""Number of the most prominent blobs that are also tried as half a disc."""
_NEAR_FRACTION = 0.10
"""Fraction of the frame in the disc's colour above which the H is searched before blobs are."""


@dataclass(frozen=True, slots=True, eq=False)
class PadCandidate:
    """A hypothesis for the pad's pose, aligned and verified."""

    pose: PadPose
    score: float
    """Calibrated probability, 0..1, that this is the pad and that `pose` is good enough to start registration."""
    yaw_ambiguous: bool
    """True if the arrowhead does not show: the heading may be 180 degrees off."""
    in_view: float
    """Fraction of the disc inside the frame."""
    features: F64
    """Inputs of the classifier that gave the score (`verification.FEATURES`)."""
    aligned: AlignedTemplate


@dataclass(frozen=True, slots=True, eq=False)
class _Guess:
    flat: PadPose
    turn_rad: float
    """Angle by which the pad is to be turned about its own z axis relative to `flat`."""
    score: float
    tilt_known: bool
    side: F64 | None = None
    """Unit direction, (2,), in x and y of the turned pad: only the half of the disc on this side is used, as the other is
    covered.
    """


def acquire(
    px: U8,
    camera: Camera,
    pad: Pad,
    R_level_body: Rotation | None = None,
    memory: PaintMemory = FRESH,
    *,
    sure: float = SURE,
) -> list[PadCandidate]:
    """Search a frame for the pad and return the candidates, best first; the list is empty if nothing resembles the pad.

    Args:
        px: (H, W, 3) BGR of the camera's size.
        R_level_body: roll and pitch of the body at the exposure. None if the vehicle does not report them, which costs time
            and some range.
        memory: learned paints. They only order the search, so that the likeliest colours come first; no result depends on them.
        sure: confidence at which no further hypotheses are tried; a value over 1 gives all candidates.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    if px.shape[:2] != (camera.height, camera.width):
        raise ValueError(f"the frame is {px.shape[1]}x{px.shape[0]} px, the camera's are {camera.width}x{camera.height}")
    pyramid = Pyramid(px)
    plane = Plane.of(camera, R_level_body)
    found: list[PadCandidate] = []
    for stage in _stages(pyramid, camera, pad, plane, memory):
        for guesses, most in stage:
            found += _align(guesses, found, most, pyramid, camera, pad, sure)
            if len(found) >= _MOST_ALIGNED or any(c.score >= sure for c in found):
                break
        if len(found) >= _MOST_ALIGNED or any(c.score >= min(sure, ENOUGH) for c in found if sure <= 1.0):
            break
    return _distinct(sorted(found, key=lambda c: -c.score))


def _stages(
    pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane, memory: PaintMemory
) -> Iterator[Iterator[tuple[list[_Guess], int]]]:
    """Yield guesses of one kind after the other, quick and likely kinds first, with the number of them to align."""
    level = max(1, round(math.log2(camera.width / COARSE_WIDTH_PX)))
    most = _ALIGNED if plane.known else _ALIGNED_FREE
    image = coarse(pyramid[level], 1 << level, pad)
    yield ((guesses, most) for guesses in _from_discs(image, memory, pyramid, camera, pad, plane))
    near = image.fraction() > _NEAR_FRACTION
    if near:
        yield iter([(_from_strokes(pyramid, level, camera, pad, plane), most)])
    yield iter([(_from_blobs(pyramid, camera, pad, plane), _ALIGNED_FAR)])
    finer = coarse(pyramid[level - 1], 1 << (level - 1), pad)
    yield ((guesses, most) for guesses in _from_discs(finer, memory, pyramid, camera, pad, plane))
    if not near:
        yield iter([(_from_strokes(pyramid, level, camera, pad, plane), most)])


def _align(
    guesses: list[_Guess], tried: list[PadCandidate], most: int, pyramid: Pyramid, camera: Camera, pad: Pad, sure: float
) -> list[PadCandidate]:
    """Align the drawing at the best guesses of a stage, except where it was aligned before."""
    out: list[PadCandidate] = []
    aligned = 0
    for guess in sorted(guesses, key=lambda g: -g.score):
        if guess.score < _LEAST_GUESS or aligned == _TRIES * most:
            break
        if any(_near(guess.flat, c.pose) for c in (*tried, *out)):
            continue
        aligned += 1
        candidate = align_at(guess.flat.turned(guess.turn_rad), guess.tilt_known, pyramid, camera, pad, guess.side)
        if candidate is not None:
            out.append(candidate)
            if candidate.score >= sure:
                break
        if len(out) >= most:
            break
    return out


def align_at(
    pose: PadPose, tilt_known: bool, pyramid: Pyramid, camera: Camera, pad: Pad, side: F64 | None = None
) -> PadCandidate | None:
    """Align the drawing from one rough pose and verify it; return None if it does not fit at all.

    Args:
        side: as for `align`.
    """
    sigma, steps = (SIGMA_TILT_RAD, _STEPS) if tilt_known else (SIGMA_TILT_FREE_RAD, _STEPS_FREE)
    aligned = align(pyramid, camera, pad, pose, sigma, steps, local=True, side=side)
    if aligned is None:
        return None
    arrow = arrow_support(aligned)
    if arrow < -0.5 * _ARROW_SEEN:
        turned = align(
            pyramid, camera, pad, aligned.pose.turned(math.pi), sigma, 2, local=True, side=None if side is None else -side
        )
        if turned is not None:
            aligned, arrow = turned, arrow_support(turned)
    values = aligned.features
    return PadCandidate(
        aligned.pose, confidence(values, ALONE_LOG_ODDS * alone(values)), arrow < _ARROW_SEEN, aligned.in_view, values, aligned
    )


def _from_discs(
    image: Coarse, memory: PaintMemory, pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane
) -> Iterator[list[_Guess]]:
    """Yield guesses from circles in the outlines of regions in the disc's colour; one list for each colour limit.

    A circle may be the disc's own edge, or the ring's inner or outer edge.
    """
    least = 1.2 * image.step / camera.fx
    edges = [radius_m for radius_m in (disc_edge_m(pad), pad.markings.ring_inner_m, pad.markings.ring_outer_m) if radius_m]
    for limit in limits(image, memory.dominance(pad)):
        out: list[_Guess] = []
        for disc_region in disc_regions(image, limit):
            places = plane.places(camera, disc_region.outline_px)
            for circle in circles(places, least, tolerance_of(plane)):
                planes = [(plane, circle)]
                if not plane.known:
                    planes += _tilted(disc_region.outline_px, places, circle, camera, least)
                whole = circle.arc_rad > 5.5 and circle.fraction > 0.75 and not disc_region.cut
                for stand, seen in planes:
                    for radius_m in edges[:1] if whole else edges:
                        guess = _guess(stand.pose(seen.centre, seen.radius, radius_m), stand.known, image, pyramid, camera, pad)
                        if guess is not None:
                            out.append(guess)
            if any(g.score > _PLAIN for g in out):
                break
        yield out


def _guess(
    pose: PadPose,
    tilt_known: bool,
    image: Coarse,
    pyramid: Pyramid,
    camera: Camera,
    pad: Pad,
    side: F64 | None = None,
) -> _Guess | None:
    radius_px = camera.fx * pad.disc_radius_m / float(pose.t_cam_pad[2])
    small, step = (image.px, image.step) if radius_px > _SMALL_PX * image.step else (pyramid[0], 1)
    best = heading(small, step, camera, pad, pose, side)
    if best is None:
        return None
    if side is not None:
        c, s = math.cos(best.turn_rad), math.sin(best.turn_rad)
        side = np.array([c * side[0] + s * side[1], c * side[1] - s * side[0]])
    return _Guess(pose, best.turn_rad, best.score, tilt_known, side)


def _tilted(outline_px: F64, places: F64, circle: Circle, camera: Camera, least: float) -> list[tuple[Plane, Circle]]:
    """Return the two planes in which the outline, an ellipse, is the projection of a circle; with the circles."""
    ok = np.isfinite(places).all(axis=1)
    xy = places[ok]
    d = np.hypot(xy[:, 0] - circle.centre[0], xy[:, 1] - circle.centre[1])
    on = np.abs(d - circle.radius) < 0.14 * circle.radius
    if circle.arc_rad < 3.0 or on.sum() < 12:
        return []
    (cx, cy), (d1, d2), angle = cv2.fitEllipseDirect((xy[on] * 1e3).astype(np.float32))
    if not (math.isfinite(d1 + d2 + cx + cy) and 0 < min(d1, d2) <= max(d1, d2) < 3.0 * min(d1, d2)):
        return []
    out = []
    for normal in circle_normals(np.array([cx, cy]) * 1e-3, np.array([d1, d2]) * 0.5e-3, math.radians(angle)):
        if normal[2] < _LEAST_FACING:
            continue
        plane = Plane.facing(normal)
        at = plane.places(camera, outline_px[ok][on])
        for fitted in circles(at, least, 0.03, 1):
            out.append((plane, fitted))
    return out


def circle_normals(centre: F64, half_axes: F64, angle_rad: float) -> list[F64]:
    """Return the (3,) normals in `cam`, away from the lens, of the planes in which a circle projects to this ellipse.

    Args:
        centre: (2,) centre of the ellipse at unit depth.
        half_axes: (2,) half axes there; the first lies at `angle_rad` from the x axis.

    Source: Kanatani and Liu, 3D interpretation of conics and orthogonality, CVGIP 58 (1993), eq. 19.
    """
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    rot = np.array([[c, -s], [s, c]])
    A = rot @ np.diag(half_axes**-2.0) @ rot.T
    b = -A @ centre
    Q = np.block([[A, b[:, None]], [b[None, :], np.array([[centre @ A @ centre - 1.0]])]])
    values, vectors = np.linalg.eigh(Q)
    l3, l2, l1 = values
    if not l3 < 0.0 < l2 <= l1:
        return []
    out = []
    for sign in (1.0, -1.0) if l1 - l2 > 1e-9 * l1 else (1.0,):
        n = math.sqrt((l1 - l2) / (l1 - l3)) * sign * vectors[:, 2] + math.sqrt((l2 - l3) / (l1 - l3)) * vectors[:, 0]
        out.append(np.asarray(n if n[2] > 0 else -n))
    return out


def _from_strokes(pyramid: Pyramid, level: int, camera: Camera, pad: Pad, plane: Plane) -> list[_Guess]:
    """Return guesses from the H's strokes.

    The camera must be near enough for a stroke to be a few pixels wide in the coarse frame.
    """
    found = h_markings(pyramid[level], 1 << level, camera, pad, plane) if pad.markings.is_h else []
    return [_Guess(f.pose, 0.0, f.score, plane.known) for f in found]


def _from_blobs(pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane) -> list[_Guess]:
    """Return guesses from blobs of the disc's colour in the frame at full size: the pad from afar."""
    image = coarse(pyramid[0], 1, pad)
    out: list[_Guess] = []
    for rank, blob in enumerate(blobs(image)):
        places = plane.places(camera, blob.centre_px + np.array([[0.0, 0.0], [1.0, 0.0]]))
        if not np.isfinite(places).all():
            continue
        radius = blob.radius_px * float(np.hypot(*(places[1] - places[0])))
        poses = [plane.pose(places[0], radius * factor, disc_edge_m(pad)) for factor in _BLOB_RADII]
        guesses = [_guess(pose, plane.known, image, pyramid, camera, pad) for pose in poses]
        best = max((g for g in guesses if g is not None), key=lambda g: g.score, default=None)
        if best is not None:
            out.append(best)
        half = _half(blob, image, pyramid, camera, pad, plane) if rank < _HALVES else None
        if half is not None:
            out.append(half)
    # A few pixels of drawing are weak evidence, and so is prominence alone. The best guesses by either criterion come first.
    by_drawing = {id(g): k for k, g in enumerate(sorted(out, key=lambda g: -g.score))}
    return [replace(g, score=1.0 / (1 + min(k, by_drawing[id(g)]))) for k, g in enumerate(out)]


def _half(blob: Blob, image: Coarse, pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane) -> _Guess | None:
    """Return a guess from the arc in a blob's outline, if the visible part of a partly covered disc is half a circle."""
    places = plane.places(camera, blob.outline_px)
    found = circles(places, 1.2 / camera.fx, tolerance_of(plane), 1)
    side = _side(found[0], places) if found else None
    if side is None:
        return None
    pose = plane.pose(found[0].centre, found[0].radius, disc_edge_m(pad))
    return _guess(pose, plane.known, image, pyramid, camera, pad, side)


def _side(circle: Circle, places: F64) -> F64 | None:
    """Return the (2,) unit direction from the circle's centre to its visible outline if half of the outline is missing."""
    if circle.arc_rad > _COVERED_ARC_RAD:
        return None
    from_centre = places[np.isfinite(places).all(axis=1)] - circle.centre
    on = np.abs(np.hypot(from_centre[:, 0], from_centre[:, 1]) - circle.radius) < 0.15 * circle.radius
    if not on.any():
        return None
    toward = from_centre[on].mean(axis=0)
    length = float(np.hypot(toward[0], toward[1]))
    return toward / length if length > 0.1 * circle.radius else None


def _near(a: PadPose, b: PadPose) -> bool:
    """Return whether two poses are the same place to within a fifth of a disc."""
    return bool(np.linalg.norm(a.t_cam_pad - b.t_cam_pad) < 0.05 * b.t_cam_pad[2]) and bool(
        np.linalg.norm((a.t_cam_pad / a.t_cam_pad[2] - b.t_cam_pad / b.t_cam_pad[2])[:2]) * b.t_cam_pad[2] < 0.03
    )


def _distinct(candidates: list[PadCandidate]) -> list[PadCandidate]:
    out: list[PadCandidate] = []
    for c in candidates:
        if not any(_near(c.pose, k.pose) for k in out):
            out.append(c)
    return out
