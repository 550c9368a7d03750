"""Look at where the pad may lie: register the drawing from a start pose, verify it there, and bring it to level.

The native core does all of it in one call (`estimator/core/vision/look/look.c`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from estimator.contracts.geometry import F64, Rotation
from estimator.core.abi import FINAL_SAMPLES, FIT_ROWS, FRAME_LEVELS, LOCAL_MAX, SAMPLE_LANES, SCRATCH_ROWS
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, address, start_of
from estimator.core.records import record
from estimator.vision.camera import Camera
from estimator.vision.detect import verification
from estimator.vision.detect.alignment import SIGMA_TILT_FREE_RAD, SIGMA_TILT_RAD, UNCUT, drawing_addresses
from estimator.vision.detect.colour import disc_has_colour
from estimator.vision.detect.paint import FRESH, PaintMemory
from estimator.vision.detect.pyramid import Pyramid
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.fit_verification import SEARCHED, TRACKED
from estimator.vision.register.registration import (
    EdgeSupport,
    Registration,
    RegistrationOptions,
    edge_points,
    fit_options,
    is_ambiguous,
    light_address,
    packed_lens,
    packed_prior,
    registration_of,
    scratch_room,
    supports,
)
from estimator.vision.register.shape import pad_shape
from estimator.vision.srgb import light_table

_LOOK = CORE.function("look_at_pad")
_AT, _WORDS = places_of("looked_pad"), size_of("looked_pad")
_FOUND, _SEEN, _EVIDENCE = (_AT[name] for name in ("found", "seen", "evidence"))
_LOG_ODDS = _AT["log_odds"].start


def _within(part: str, struct: str, member: str) -> slice:
    """Return where a member of a part of `looked_pad` is, in words."""
    start, at = _AT[part].start, places_of(struct)[member]
    return slice(start + at.start, start + at.stop)


_R, _T = (_within("found", "registration", name) for name in ("R", "t"))
_MEAN, _VAR, _TRUST = (_within("paint", "pad_paint", name) for name in ("mean", "var", "trust"))


@dataclass(frozen=True, slots=True, eq=False)
class Looked:
    """What a look found: a registration, the evidence that it is the pad, and its sighting in level."""

    words: F64
    """The core's `looked_pad`."""
    outline: F64
    """Pixels of the outline's points, (N, 2)."""
    pad: Pad
    orientation: Orientation

    @property
    def log_odds(self) -> float:
        """Log-odds that this is the pad, from the frame alone."""
        return self.words.item(_LOG_ODDS)

    @property
    def evidence(self) -> F64:
        """The inputs of the verification, in the order of `look_evidence` in the core's header."""
        return self.words[_EVIDENCE]

    @property
    def pose(self) -> PadPose:
        """The pad's pose in `cam`."""
        return PadPose(Rotation(self.words[_R].reshape(3, 3)), self.words[_T])

    @property
    def range_m(self) -> float:
        """Distance from the lens to the pad's centre, m."""
        return math.hypot(*self.words[_T].tolist())

    @property
    def in_level(self) -> F64:
        """The core's `level_sighting`."""
        return self.words[_SEEN]

    @property
    def edges(self) -> Mapping[EdgeKind, EdgeSupport]:
        """The support of the frame for each kind of edge."""
        return supports(self.words[_FOUND])

    @property
    def yaw_ambiguous(self) -> bool:
        """Whether neither an arrowhead nor a fiducial resolved the headings."""
        return is_ambiguous(self.words[_FOUND], self.pad)

    @property
    def outlines(self) -> tuple[F64, ...]:
        """The outline by kind of edge, (N, 2) px each, of the points that the lens projects."""
        each = tuple(self.outline[part] for part in edge_points(self.pad).shown)
        ok = np.isfinite(self.outline)
        return each if ok.all() else tuple(uv[np.isfinite(uv).all(axis=1)] for uv in each)

    def paint(self) -> PaintMemory:
        """Return what is known of the paints if this is the pad."""
        mean, var = (self.words[at].reshape(4, 3) for at in (_MEAN, _VAR))
        return PaintMemory(mean, var, self.words.item(_TRUST.start))

    def registration(self) -> Registration:
        """Return the registration."""
        return registration_of(self.words[_FOUND], self.pad, self.orientation)


def look(
    pyramid: Pyramid,
    camera: Camera,
    pad: Pad,
    start: PadPose,
    orientation: Orientation,
    options: RegistrationOptions,
    *,
    tracked: bool = False,
    cut: F64 = UNCUT,
    paint: PaintMemory = FRESH,
) -> Looked | None:
    """Register the drawing from a start pose and verify it there; return None if nothing of it is found.

    Args:
        pad: as the frame's camera sees it, see `Pyramid.as_seen`.
        start: as for `registration.register`.
        orientation: the attitude at the exposure and the deck's expected tilt.
        tracked: whether a track has confirmed the pad there before.
        cut: the line beyond which something covers the pad, (3,); see `alignment.UNCUT`.
        paint: what is known of the paints.

    Raises:
        ValueError: the frame is not of the camera's size.
    """
    px = pyramid[0]
    if px.shape != (camera.height, camera.width, 3):
        raise ValueError(f"want a frame of shape {(camera.height, camera.width, 3)}, got {px.shape}")
    px = np.ascontiguousarray(px, np.uint8)
    edges = edge_points(pad)
    out, outline = np.empty(_WORDS), np.empty((edges.shown[-1].stop, 2))
    prior, fit = packed_prior(orientation), fit_options(options, pad.size_sigma_m, cut, pyramid.noise)
    how, judge = _options(options.coarse, orientation.measured, camera), _judge(pad, tracked)
    known = np.concatenate([paint.mean.ravel(), paint.var.ravel(), [paint.trust]])
    pose = np.concatenate([start.R_cam_pad.matrix.ravel(), start.t_cam_pad])
    room = scratch_room(options, edges)
    scratch, parts = np.empty(_floats(camera, room), np.float32), np.empty(_parts_bytes(camera), np.uint8)
    drawn = drawing_addresses(camera, pad)
    if not _LOOK(
        *packed_lens(camera).addresses, int(px.ctypes.data), light_address(options.gamma), drawn.light, address(pad_shape(pad)),
        *edges.addresses, drawn.template, drawn.coverage, drawn.local, address(judge), address(prior), address(fit),
        start_of(pyramid.quality), address(how), start_of(known), start_of(pose), room, int(scratch.ctypes.data),
        int(parts.ctypes.data), start_of(out), start_of(outline),
    ):  # fmt: skip
        return None
    out.setflags(write=False)
    outline.setflags(write=False)
    return Looked(out, outline, pad, orientation)


def _floats(camera: Camera, room: int) -> int:
    """Return how many floats registration and alignment work on."""
    # A part of a level has at most so many pixels, but for one more row and column at either end.
    most = max(FINAL_SAMPLES, camera.width * camera.height >> 2 * FRAME_LEVELS) + 2 * (camera.width + camera.height) + 4
    return max(FIT_ROWS * room, SCRATCH_ROWS * (most + SAMPLE_LANES) + camera.width + 2 * LOCAL_MAX)


def _parts_bytes(camera: Camera) -> int:
    """Return how many bytes the parts of reduced frames take."""
    return 2 * (3 * camera.width * camera.height // 4) + 24 * camera.width


@lru_cache(maxsize=8)
def _options(coarse: bool, measured: bool, camera: Camera) -> F64:
    sigma = SIGMA_TILT_RAD if measured else SIGMA_TILT_FREE_RAD
    return record("look_options", {"coarse": coarse, "sigma_tilt_rad": sigma, "t_body_cam": camera.T_body_cam.t})


@lru_cache(maxsize=8)
def _judge(pad: Pad, tracked: bool) -> F64:
    """Return the core's `pad_judge`."""
    marks, table = pad.markings, light_table(True)
    ring, h_marking, disc = (table[list(rgb[::-1])] for rgb in (marks.colours.ring, marks.colours.h, marks.colours.disc))
    side = np.where(h_marking - disc <= -0.05, -1.0, 1.0)
    place = side * (ring - disc) / np.maximum(side * (h_marking - disc), 0.05)
    return record("pad_judge", {
        "has_field": bool(marks.field_radius_m), "has_ring": bool(marks.ring_outer_m), "has_letters": bool(marks.letters),
        "has_fiducials": bool(marks.fiducials), "disc_has_colour": disc_has_colour(pad),
        "orange_side": side, "orange_place": place, "template_weights": verification.COEFFICIENTS,
        "weights": TRACKED if tracked else SEARCHED,
    })  # fmt: skip
