"""Find the pad in a whole frame without knowing where it is: guesses from coarse to fine, each judged by the whole drawing."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, AlignedTemplate, Pyramid, align
from estimator.vision.detect.circles import Circle, Plane, circles, tolerance_of
from estimator.vision.detect.heading import heading
from estimator.vision.detect.paint import FRESH, PaintMemory
from estimator.vision.detect.scan import Blob, Coarse, blobs, coarse, disc_regions, limits
from estimator.vision.detect.strokes import h_markings
from estimator.vision.detect.template import disc_edge_m
from estimator.vision.detect.verification import ALONE_LOG_ODDS, alone, arrow_support, confidence, features
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose

U8 = NDArray[np.uint8]

SURE, ENOUGH = 0.9, 0.5
"""Confidence at which no further hypotheses are tried, and at which no further kinds of them are."""
_MOST_LAID = 16
"""Hypotheses of one frame that the drawing is laid on before the search is given up."""
_ALIGNED, _ALIGNED_FREE, _ALIGNED_FAR = 2, 3, 6
"""Best hypotheses of one kind that the drawing is laid on: usually, with the tilt unknown, and from afar, where a hypothesis says
little by itself and laying costs little."""
_LEAST_GUESS = 0.04
"""Of the variance explained at a guess: what explains less has not been the pad in 900 frames."""
_TRIES = 2
"""Guesses tried for each that may be laid: most strangers are told at the first step and cost little."""
_SMALL_PX = 28.0
"""Radius of a disc, in pixels of the coarse frame, below which the whole frame is sampled instead."""
_STEPS, _STEPS_FREE = 4, 8
"""Of alignment, with the tilt known and without."""
_ARROW_SEEN = 0.3
"""Evidence of the arrowhead that settles the heading."""
COARSE_WIDTH_PX = 160
"""About what the first pass looks at: in it the pad is 5 px in radius from 7 m with the sim camera."""
_PLAIN = 0.5
"""Of the variance explained at a guess, from which on no further patches are looked at."""
_LEAST_FACING = math.cos(math.radians(38.0))
"""Of the pad's normal along the camera's axis when nobody knows the tilt: 25 degrees of it and some of error."""
_SPECK_RADII = (0.95, 1.5)
"""Of a speck: it is the disc, or what of it lies within the ring."""
_COVERED_ARC_RAD = 4.6
"""Of a disc's outline: less of it is the outline of a disc half covered."""
_HALVES = 6
"""Most prominent specks that are also taken for half a disc."""
_NEAR_SHARE = 0.10
"""Of the frame in the disc's colour, from which on the letter is looked for before specks are."""


@dataclass(frozen=True, slots=True, eq=False)
class PadCandidate:
    """Where the pad may be."""

    pose: PadPose
    score: float
    """0..1, calibrated: how probable it is that this is the pad and `pose` good enough to register from."""
    yaw_ambiguous: bool
    """The arrowhead does not show: the heading may as well be 180 degrees away."""
    in_view: float
    """Share of the disc inside the frame."""
    features: F64
    """What the score was made of (`verification.FEATURES`)."""
    aligned: AlignedTemplate


@dataclass(frozen=True, slots=True, eq=False)
class _Guess:
    flat: PadPose
    turn_rad: float
    """By which the pad is to be turned about its own z axis against `flat`."""
    score: float
    tilt_known: bool
    side: F64 | None = None
    """(2,) of unit length, x and y of the turned pad: the half that is to be looked at, where the other is covered."""


def acquire(
    px: U8,
    camera: Camera,
    pad: Pad,
    R_level_body: Rotation | None = None,
    memory: PaintMemory = FRESH,
    *,
    sure: float = SURE,
) -> list[PadCandidate]:
    """Candidates for the pad, best first; none where nothing resembles it.

    Args:
        px: (H, W, 3) BGR of the camera's size.
        R_level_body: roll and pitch of the body at the exposure; None when the vehicle does not say, at the price of time and
            of some reach.
        memory: of the paints, to begin with the likeliest colours; nothing depends on it.
        sure: confidence at which no further hypotheses are tried; over 1 to see them all.

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
            if len(found) >= _MOST_LAID or any(c.score >= sure for c in found):
                break
        if len(found) >= _MOST_LAID or any(c.score >= min(sure, ENOUGH) for c in found if sure <= 1.0):
            break
    return _distinct(sorted(found, key=lambda c: -c.score))


def _stages(
    pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane, memory: PaintMemory
) -> Iterator[Iterator[tuple[list[_Guess], int]]]:
    """Guesses of one kind after the other, the quick and likely ones first; and how many of them to lay the drawing on."""
    level = max(1, round(math.log2(camera.width / COARSE_WIDTH_PX)))
    most = _ALIGNED if plane.known else _ALIGNED_FREE
    image = coarse(pyramid[level], 1 << level, pad)
    yield ((guesses, most) for guesses in _from_discs(image, memory, pyramid, camera, pad, plane))
    near = image.share() > _NEAR_SHARE
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
    """The drawing laid on the best guesses of a stage, unless it was laid there before."""
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
    """The drawing laid on the frame from one rough pose, and judged; None where it does not fit at all.

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
    values = features(aligned, pad)
    return PadCandidate(
        aligned.pose, confidence(values, ALONE_LOG_ODDS * alone(values)), arrow < _ARROW_SEEN, aligned.in_view, values, aligned
    )


def _from_discs(
    image: Coarse, memory: PaintMemory, pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane
) -> Iterator[list[_Guess]]:
    """From circles in the outlines of patches of the disc's colour: its own edge, or the ring's inner or outer one.

    One list of guesses for each limit that the patches are cut at.
    """
    least = 1.2 * image.step / camera.fx
    edges = (disc_edge_m(pad), pad.ring_inner_m, pad.ring_outer_m)
    for limit in limits(image, memory.dominance(pad)):
        out: list[_Guess] = []
        for disc_region in disc_regions(image, limit):
            places = plane.places(camera, disc_region.outline_px)
            for circle in circles(places, least, tolerance_of(plane)):
                planes = [(plane, circle)]
                if not plane.known:
                    planes += _tilted(disc_region.outline_px, places, circle, camera, least)
                whole = circle.arc_rad > 5.5 and circle.share > 0.75 and not disc_region.cut
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
    """The two planes in which the outline, an ellipse, is the frame of a circle; with the circles."""
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
    """The normals (3,) in `cam`, pointing away from the lens, of the planes in which a circle looks like this ellipse.

    Args:
        centre: (2,) of the ellipse at unit depth.
        half_axes: (2,) its half axes there, the first at `angle_rad` from the x axis.

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
    """From the letter's strokes, near enough for a stroke to be a few pixels wide in the coarse frame."""
    return [_Guess(f.pose, 0.0, f.score, plane.known) for f in h_markings(pyramid[level], 1 << level, camera, pad, plane)]


def _from_blobs(pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane) -> list[_Guess]:
    """From specks of the disc's colour in the whole frame at full size: the pad from afar."""
    image = coarse(pyramid[0], 1, pad)
    out: list[_Guess] = []
    for rank, blob in enumerate(blobs(image)):
        places = plane.places(camera, blob.centre_px + np.array([[0.0, 0.0], [1.0, 0.0]]))
        if not np.isfinite(places).all():
            continue
        radius = blob.radius_px * float(np.hypot(*(places[1] - places[0])))
        poses = [plane.pose(places[0], radius * factor, disc_edge_m(pad)) for factor in _SPECK_RADII]
        guesses = [_guess(pose, plane.known, image, pyramid, camera, pad) for pose in poses]
        best = max((g for g in guesses if g is not None), key=lambda g: g.score, default=None)
        if best is not None:
            out.append(best)
        half = _half(blob, image, pyramid, camera, pad, plane) if rank < _HALVES else None
        if half is not None:
            out.append(half)
    # A few pixels of drawing say little of themselves, and prominence says little of the drawing: the best of both come first.
    by_drawing = {id(g): k for k, g in enumerate(sorted(out, key=lambda g: -g.score))}
    return [replace(g, score=1.0 / (1 + min(k, by_drawing[id(g)]))) for k, g in enumerate(out)]


def _half(blob: Blob, image: Coarse, pyramid: Pyramid, camera: Camera, pad: Pad, plane: Plane) -> _Guess | None:
    """From the arc in a speck's outline, where what is left of the disc beside something in front of it makes half a circle."""
    places = plane.places(camera, blob.outline_px)
    found = circles(places, 1.2 / camera.fx, tolerance_of(plane), 1)
    side = _side(found[0], places) if found else None
    if side is None:
        return None
    pose = plane.pose(found[0].centre, found[0].radius, disc_edge_m(pad))
    return _guess(pose, plane.known, image, pyramid, camera, pad, side)


def _side(circle: Circle, places: F64) -> F64 | None:
    """(2,) of unit length, from the circle's centre towards the outline on it, where half of the circle has none."""
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
    """The same place within a fifth of a disc."""
    return bool(np.linalg.norm(a.t_cam_pad - b.t_cam_pad) < 0.05 * b.t_cam_pad[2]) and bool(
        np.linalg.norm((a.t_cam_pad / a.t_cam_pad[2] - b.t_cam_pad / b.t_cam_pad[2])[:2]) * b.t_cam_pad[2] < 0.03
    )


def _distinct(candidates: list[PadCandidate]) -> list[PadCandidate]:
    out: list[PadCandidate] = []
    for c in candidates:
        if not any(_near(c.pose, k.pose) for k in out):
            out.append(c)
    return out
