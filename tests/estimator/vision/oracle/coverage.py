"""Handle an occluder: choose the half of the disc to trust first when the paints are estimated from the frame.

An occluder that covers a half and has its own light biases every paint, and then nothing fits. The other half alone gives the
pad's paints, and the occluder shows as residuals against them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.pad_pose import PadPose
from tests.estimator.vision.oracle.template import F32

_SECTORS = 8
_ENOUGH = 650
"""Number of samples that suffice for the choice."""
_MUCH = 0.4
"""A half is trusted first if its unexplained fraction of the light's variation is below this multiple of the whole's."""


def uncovered(light: F32, coverage: F32, xy_m: F32) -> F32:
    """Return (n,) initial weights: 1, or a small value on one half if the other half alone is explained much better.

    Args:
        light: (n, 3) light of the samples.
        coverage: (n, 4) coverage of the samples by the paints.
        xy_m: (n, 2) positions on the pad.
    """
    even = np.ones(len(light), np.float32)
    some = slice(None, None, max(1, len(light) // _ENOUGH))
    light, coverage, sector = light[some], coverage[some], _sector(xy_m[some])
    one = np.ones((len(light), 1), np.float32)
    of = np.zeros((_SECTORS, len(light)), np.float32)
    of[sector, np.arange(len(light))] = 1.0
    both = np.concatenate([coverage, light, one], axis=1)
    products = (of @ (both[:, :, None] * both[:, None, :]).reshape(len(light), -1)).reshape(_SECTORS, 8, 8).astype(float)
    around = np.concatenate([products, products[: _SECTORS // 2 - 1]])
    halves = np.stack([around[k : k + _SECTORS // 2].sum(axis=0) for k in range(_SECTORS)])
    unexplained = _unexplained(halves)
    best = int(np.argmin(unexplained))
    if not unexplained[best] < _MUCH * float(_unexplained(products.sum(axis=0)[None])[0]):
        return even
    return np.where((_sector(xy_m) - best) % _SECTORS < _SECTORS // 2, even, np.float32(1e-3))


def _sector(xy_m: F32) -> NDArray[np.intp]:
    around = np.arctan2(xy_m[:, 1], xy_m[:, 0]) + np.float32(math.pi)
    return np.asarray((around * np.float32(_SECTORS / math.tau)).astype(np.intp) % _SECTORS)


def on_side(rays: F32, pose: PadPose, side: F64) -> NDArray[np.intp]:
    """Return the indices of the rays (3, n) that meet the pad's plane beyond its centre in a direction (2,) on it."""
    across = pose.R_cam_pad.matrix[:, :2] @ side
    normal = pose.R_cam_pad.matrix[:, 2]
    t = pose.t_cam_pad
    # A ray's position on the pad is r (n t) / (n r) - t. Both sides are multiplied by n r, which is positive.
    over = (across * float(normal @ t) - normal * float(across @ t)).astype(np.float32) @ rays
    return np.nonzero(over > 0.0)[0]


def _unexplained(products: F64) -> F64:
    """Return the (m,) fraction of the light's variation that least-squares paints leave; 1 if there are few samples.

    Args:
        products: (m, 8, 8) sums of products of coverage (4), light (3) and one.
    """
    n = products[:, 7, 7]
    A = products[:, :4, :4] + 1e-4 * np.maximum(n, 1.0)[:, None, None] * np.eye(4)
    b = products[:, :4, 4:7]
    squares = np.trace(products[:, 4:7, 4:7], axis1=1, axis2=2)
    left = squares - (b * np.linalg.solve(A, b)).sum(axis=(1, 2))
    total = squares - (products[:, 7, 4:7] ** 2).sum(axis=1) / np.maximum(n, 1.0)
    return np.asarray(np.where(n > 30.0, np.maximum(left, 1e-9) / np.maximum(total, 1e-6), 1.0))
