"""Sample pixels for registration by profiles: short rows of pixels across the edges of the drawing that are in view.

Pixels are used as they are, without interpolation, each with its exact position on the drawing. Their noise thus stays
independent, and no blur is added.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.camera import Camera
from estimator.vision.drawing import EdgeKind, Edges
from estimator.vision.pad import Pad
from estimator.vision.srgb import light_table
from tests.estimator.vision.oracle.state import U8, Footprint, RegistrationState, pixel_rays

KINDS = len(EdgeKind) - 1
"""Kinds of edges of the pads that the oracle knows: none has lettering of two paints."""
_IN_GROUP = 6
_MIN_SPACING_PX = 1.3


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Pixels across edges, grouped by kind and by group."""

    rays: F64
    """Rays of the pixels, (N, 2)."""
    light: F64
    """Linear light, (3, N) BGR."""
    usable: F64
    """Mask, (N,): 0 for a pixel that another profile uses too or that sees a third paint."""
    samples: int
    """Number of pixels of a profile: N = profiles * samples."""
    kind_parts: tuple[slice, slice, slice, slice]
    """Slice of the N pixels for each `EdgeKind`."""
    starts: NDArray[np.intp]
    """First pixel of each group, (G,)."""
    group_kind: NDArray[np.intp]
    """Kind of each group, (G,)."""
    of_kind: F64
    """One-hot kind of each group, (G, KINDS)."""
    groups: tuple[int, ...]
    """Number of groups of each kind, (KINDS,)."""
    group: NDArray[np.intp]
    """Group of each pixel, (N,)."""
    kind: NDArray[np.intp]
    """Kind of each pixel, (N,)."""
    in_view: F64
    """Fraction of each kind's edges within the frame, (KINDS,)."""


@lru_cache(maxsize=8)
def _table(edges: Edges) -> tuple[F64, NDArray[np.intp], F64]:
    """Return the edge points as a table: (5, M) x, y, 1 and normal, the (KINDS,) first point of each kind, and their number M."""
    rows = np.concatenate([edges.at_m.T, np.ones((1, len(edges.at_m))), edges.normal.T])
    first = np.searchsorted(edges.kind, np.arange(KINDS + 1))
    return rows, first[:-1], np.diff(first).astype(float)


def sample(
    px: U8, camera: Camera, pad: Pad, edges: Edges, state: RegistrationState, max_profiles: int, half: int, gamma: bool
) -> tuple[Profiles, Footprint] | None:
    """Return profiles of 2 * half + 1 pixels across the edges in view, and their footprint.

    None if there are too few for a fix.
    """
    rows, first, total = _table(edges)
    to_cam = np.zeros((6, 5))
    to_cam[:3, :2] = to_cam[3:, 3:] = state.R[:, :2]
    to_cam[:3, 2] = state.t
    p = to_cam @ rows
    seen = p[2] > 0.02
    if camera.distorted:
        step = 1e-4
        uv = camera.project(p[:3].T).T
        out = (camera.project((p[:3] + step * p[3:]).T).T - uv) / step
    else:
        per = 1.0 / np.maximum(p[2], 0.02)
        focal = np.array([[camera.fx], [camera.fy]])
        xy = p[:2] * per
        out = p[3:5] - xy * p[5]
        out *= focal * per
        uv = xy * focal
        uv += ((camera.cx,), (camera.cy,))
    middle = np.array([[0.5 * (camera.width - 1)], [0.5 * (camera.height - 1)]])
    # A nan, from behind a distorting lens, compares as false.
    within = np.abs(uv - middle) < middle - (half + 1.0)
    seen &= within[0]
    seen &= within[1]
    at = seen.nonzero()[0]
    if len(at) < 8:
        return None
    in_view = np.add.reduceat(seen, first, dtype=float) / total
    uv, out = uv.take(at, axis=1), out.take(at, axis=1)
    steep2 = out * out
    way_px = np.sqrt(steep2[0] + steep2[1])
    way_px *= edges.spacing_m.take(at)
    way_px = way_px.cumsum()
    spacing = max(_MIN_SPACING_PX, float(way_px[-1]) / max_profiles)
    # The last point lies at the end of the last stretch, where rounding would decide whether it begins another.
    ticks = np.minimum(way_px / spacing, max_profiles - 1.0).astype(np.intp)
    first_of_tick = np.empty(len(at), np.bool_)
    first_of_tick[0] = True
    np.not_equal(ticks[1:], ticks[:-1], out=first_of_tick[1:])
    chosen = first_of_tick.nonzero()[0]
    at, uv, out = at.take(chosen), uv.take(chosen, axis=1), out.take(chosen, axis=1)

    n = 2 * half + 1
    along = np.where(np.abs(out[1]) > np.abs(out[0]), out[1], out[0])
    out /= np.where(np.abs(along) > 1e-9, along, 1e-9)
    places = out[:, :, None] * np.arange(-half, half + 1.0)
    places += uv[:, :, None]
    pixels = np.rint(places, out=places).astype(np.intp).reshape(2, -1)
    flat = pixels[1] * camera.width
    flat += pixels[0]
    owner = np.empty(camera.width * camera.height, np.int32)
    mine = np.arange(len(flat), dtype=np.int32)
    owner[flat] = mine
    usable = (owner[flat] == mine).astype(float)
    light = light_table(gamma).take(px.reshape(-1, 3).take(flat, axis=0).T)
    rays = pixel_rays(camera, pixels[0], pixels[1])

    kind, piece = edges.kind.take(at), edges.piece.take(at)
    begin = np.searchsorted(piece, piece)
    begins = ((np.arange(len(at)) - begin) % _IN_GROUP == 0).nonzero()[0]
    borders = (np.searchsorted(kind, np.arange(KINDS + 1)) * n).tolist()
    disc, ring, arrow, h = (slice(a, b) for a, b in pairwise(borders))
    starts = begins * n
    sizes = np.empty_like(starts)
    np.subtract(starts[1:], starts[:-1], out=sizes[:-1])
    sizes[-1] = len(flat) - starts[-1]
    group_kind = kind.take(begins)
    of_kind = np.eye(KINDS).take(group_kind, axis=0)
    profiles = Profiles(
        rays, light, usable, n, (disc, ring, arrow, h), starts, group_kind, of_kind, tuple(map(int, of_kind.sum(axis=0))),
        np.repeat(np.arange(len(starts)), sizes), np.repeat(kind, n), in_view,
    )  # fmt: skip
    fp = state.footprint(rays, pad)
    usable[_foreign(state, profiles, fp, pad)] = 0.0
    return profiles, fp


def _foreign(state: RegistrationState, profiles: Profiles, fp: Footprint, pad: Pad) -> NDArray[np.bool_]:
    """Return the (N,) mask of pixels within three sigmas of an edge of another kind."""
    places = fp.places
    x, y = np.abs(places.x), np.abs(places.y)
    r = np.sqrt(x * x + y * y)
    clear = 3.0 * state.sigma_px * state.m_per_px
    field = pad.markings.field_radius_m
    out = np.empty(len(r), np.bool_)
    disc, ring, arrow, h = profiles.kind_parts
    at = r[disc]
    out[disc] = at < pad.markings.ring_outer_m + clear
    out[disc] |= (
        (places.x[disc] > 0) & (at < pad.markings.arrow_tip_m + clear) & (y[disc] < pad.markings.arrow_half_base_m + clear)
    )
    if pad.markings.rim_width_m:
        # If no pixel sees the rim alone, its inner edge cannot be separated from its outer one.
        out[disc] |= (at > pad.disc_radius_m - clear) | (pad.markings.rim_width_m < 2.0 * clear)
    out[ring] = (r[ring] > field - clear) | (
        (x[ring] < pad.markings.h_length_m / 2 + clear) & (y[ring] < pad.markings.h_width_m / 2 + clear)
    )
    out[arrow] = r[arrow] > field - clear
    out[h] = r[h] > pad.markings.ring_inner_m - clear
    return out
