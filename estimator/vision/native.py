"""The native core's tracker of a pad in the frames of a camera: cameras, frames, poses and drawings as the core takes them."""

import threading
from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.core.abi import DL_TEMPLATE_BLURS, DL_WRONG_SIZE
from estimator.core.library import CORE
from estimator.vision.camera.camera import Camera, ray_map
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detect.colour import disc_has_colour
from estimator.vision.detect.template import polar_drawing, template
from estimator.vision.detect.verification import COEFFICIENTS, TRACKED
from estimator.vision.detect.verification import SEARCHED as SEARCHED
from estimator.vision.pad.drawing import EdgeKind, edges_of
from estimator.vision.pad.pad import Pad
from estimator.vision.pad.shape import pad_shape
from estimator.vision.srgb import LINEAR_LIGHT, light_of_tone

FLOOR = 0.01
"""Light, as a fraction of full scale, below which there is only noise."""
_KEPT = 6  # Number of trackers that a thread keeps
_OUTLINE_STEP = 4  # Every so many points of the edges are in an outline
_STROKES_MARGIN_M = 0.035  # Width of the disc around the H that counts
_LEAST_SPAN = 0.05  # Least difference of H and disc in a channel, linear light, for measuring the ring's place between them


class _OfThread(threading.local):
    """Trackers and counted work of one thread: one at a time may use a tracker, which holds all memory that it works in."""

    def __init__(self) -> None:
        self.trackers = lru_cache(maxsize=_KEPT)(_made)
        self.work = CORE.ffi.new("int64_t *")


def tracker_of(camera: Camera, pad: Pad | None = None) -> Any:
    """Return this thread's native tracker of a pad, or of none where the drawing does not matter; the result is cached."""
    return _OF_THREAD.trackers(CORE.lib, camera, pad)


def work_done() -> int:
    """Return the work that the core has done for this thread, millionths of a floor.

    A floor is one BGR to HSV conversion and one inRange of a frame of 640x360. Work is counted and not timed, so that the same
    frames give the same results.
    """
    return int(_OF_THREAD.work[0])


def count_work(more: int) -> None:
    """Count work on frames that is not done by the core."""
    _OF_THREAD.work[0] += more


def _made(lib: Any, camera: Camera, pad: Pad | None) -> Any:
    arrays: list[Any] = [CORE.array("dl_camera", native_camera(camera)), CORE.ffi.NULL]
    if camera.distorted:
        arrays[1] = CORE.array("double", ray_map(camera.optics), 2 * camera.width * camera.height)
    if pad is None:
        arrays += [CORE.ffi.NULL] * 5
    else:
        drawn, edges = template(pad), edge_points(pad)
        cells = 4 * DL_TEMPLATE_BLURS * len(drawn.coverage[0]) ** 2
        arrays += [
            CORE.array("dl_pad", CORE.record("dl_pad", **_drawing(pad, len(edges.at)))),
            CORE.array("int16_t", drawn.coverage, cells), CORE.array("int16_t", drawn.local, cells),
            CORE.array("double", edges.at, 5 * len(edges.at)), CORE.array("int32_t", edges.of, 2 * len(edges.at)),
        ]  # fmt: skip
    made = lib.dl_tracker_new(*arrays, _OF_THREAD.work)
    if not made:
        raise MemoryError(f"the core cannot track a pad in frames of {camera.width}x{camera.height} px")
    # The tracker reads the arrays as long as it lives.
    return CORE.ffi.gc(made, lambda tracker, kept=(arrays, _OF_THREAD.work): lib.dl_tracker_free(tracker))


_OF_THREAD = _OfThread()


def native_camera(camera: Camera) -> NDArray[Any]:
    """Return the core's `dl_camera`."""
    light, made = light_of_tone(camera.tone), CORE.record("dl_camera", t_body_cam=camera.T_body_cam.t)
    made["lens"], made["light"], made["log_light"] = native_lens(camera), light, np.log1p(light / FLOOR)
    return made


@lru_cache(maxsize=8)
def native_lens(camera: Camera) -> NDArray[Any]:
    """Return the core's `dl_lens`; the result is cached."""
    return CORE.record(
        "dl_lens", width=camera.width, height=camera.height, distorted=camera.distorted, fisheye=camera.lens == "fisheye",
        fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, distortion=[*camera.distortion, 0.0][:5],
        focal_sigma=camera.focal_sigma, R_body_cam=camera.T_body_cam.R.matrix,
    )  # fmt: skip


def _drawing(pad: Pad, edge_points: int) -> Mapping[str, Any]:
    """Return the core's `dl_pad`."""
    marks = pad.markings
    return {
        "shape": pad_shape(pad), "drawn": template(pad).lengths, "verification": _verification(pad), "polar": polar_drawing(pad),
        "size_sigma_m": pad.size_sigma_m, "edge_points": edge_points,
        "strokes": {
            "length_m": marks.h_length_m, "width_m": marks.h_width_m, "leg_m": marks.leg_width_m, "bar_m": marks.bar_width_m,
            "margin_m": _STROKES_MARGIN_M,
        },
    }  # fmt: skip


def _verification(pad: Pad) -> Mapping[str, Any]:
    """Return the core's `dl_pad_verification`."""
    marks = pad.markings
    ring, h_marking, disc = (LINEAR_LIGHT[list(rgb[::-1])] for rgb in (marks.colours.ring, marks.colours.h, marks.colours.disc))
    side = np.where(h_marking - disc <= -_LEAST_SPAN, -1.0, 1.0)
    return {
        "has_field": bool(marks.field_radius_m), "has_ring": bool(marks.ring_outer_m), "has_letters": bool(marks.letters),
        "has_fiducials": bool(marks.fiducials), "disc_has_colour": disc_has_colour(pad), "orange_side": side,
        "orange_place": side * (ring - disc) / np.maximum(side * (h_marking - disc), _LEAST_SPAN),
        "template_weights": COEFFICIENTS, "searched": SEARCHED, "tracked": TRACKED,
    }  # fmt: skip


class EdgePoints(NamedTuple):
    """The points of a pad's edges as the core reads them."""

    at: F64
    """Place, normal and distance to the next, (M, 5) m."""
    of: NDArray[np.int32]
    """Kind and piece, (M, 2)."""
    shown: tuple[slice, ...]
    """Places of each kind's outline among the points that the core returns."""


@lru_cache(maxsize=8)
def edge_points(pad: Pad) -> EdgePoints:
    """Return the points of a pad's edges; the result is cached."""
    edges = edges_of(pad)
    at = np.ascontiguousarray(np.c_[edges.at_m, edges.normal, edges.spacing_m])
    of = np.ascontiguousarray(np.c_[edges.kind, edges.piece], np.int32)
    borders = np.searchsorted(edges.kind[::_OUTLINE_STEP], np.arange(len(EdgeKind) + 1)).tolist()
    return EdgePoints(at, of, tuple(slice(a, b) for a, b in pairwise(borders)))


def image_of(px: NDArray[np.uint8]) -> Any:
    """Return an image, (h, w, 3) BGR or (h, w), as the core takes it, for as long as the array lives.

    Raises:
        TypeError: the pixels of a row are not whole bytes, one after the other.
    """
    made = CORE.ffi.new("dl_image *")
    put_image(px, made)
    return made


def put_image(px: NDArray[np.uint8], place: Any) -> None:
    """Write an image to a place of the core's `dl_image`; arguments and errors as for `image_of`."""
    channels = 1 if px.ndim == 2 else px.shape[2]
    if px.dtype != np.uint8 or px.ndim not in (2, 3) or px.strides[1:] != ((1,) if px.ndim == 2 else (channels, 1)):
        raise TypeError(f"the core takes bytes in rows of pixels, not {px.dtype} of shape {px.shape} and strides {px.strides}")
    place.height, place.width, place.channels, place.stride = px.shape[0], px.shape[1], channels, px.strides[0]
    place.px = CORE.ffi.cast("const uint8_t *", px.__array_interface__["data"][0])


def checked(count: int) -> int:
    """Return a count of the core.

    Raises:
        ValueError: the core refused the size of an argument.
    """
    if count == DL_WRONG_SIZE:
        raise ValueError("the core refuses an argument's size: the tracker is made for another one")
    return count


def native_pose(pose: PadPose) -> Any:
    """Return a pose as the core's `dl_pad_pose`."""
    return CORE.ffi.new("dl_pad_pose *", (pose.R_cam_pad.matrix.ravel().tolist(), pose.t_cam_pad.tolist()))


def pose_of(made: Any) -> PadPose:
    """Return the core's `dl_pad_pose`."""
    return PadPose(Rotation(np.array(CORE.ffi.unpack(made.R, 9)).reshape(3, 3)), np.array(CORE.ffi.unpack(made.t, 3)))


def native_prior(prior: Orientation | None) -> tuple[Any, ...]:
    """Return the members of the core's `dl_tilt_prior`, which says whether there is one."""
    if prior is None:
        return (0, 0.0, 0.0, (0.0,) * 4, 0.0)
    return (1, prior.roll_rad, prior.pitch_rad, prior.cov_tilt.ravel().tolist(), prior.sigma_deck_rad)
