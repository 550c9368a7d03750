"""Measure the support of the frame for each kind of edge at the registered pose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from estimator.contracts.geometry import F64
from estimator.vision.drawing import EdgeKind
from estimator.vision.pad import Pad
from estimator.vision.register.registration import EdgeSupport
from estimator.vision.srgb import light_table
from tests.estimator.vision.oracle import dense
from tests.estimator.vision.oracle import profiles as profiles_
from tests.estimator.vision.oracle.sampling import KINDS, Profiles


def profile_support(
    fit: profiles_.ProfileFit, measured_at: Profiles, mix: profiles_.Channels, noise: F64
) -> tuple[dict[EdgeKind, EdgeSupport], float]:
    """Return the support of every kind of edge from profiles, and the fraction of all pixels that agree."""
    out: dict[EdgeKind, EdgeSupport] = {}
    pixels, agree = np.add.reduceat(np.stack([measured_at.usable, fit.weight]), measured_at.starts, axis=1)
    enough = pixels > 8
    # The mean of Tukey's weights under Gaussian noise is 0.9.
    counted, agreed = (np.stack([pixels * enough, agree * enough]) @ measured_at.of_kind).tolist()
    for kind, var in zip(tuple(EdgeKind)[:KINDS], noise[:, 2].tolist(), strict=True):
        in_view = float(measured_at.in_view[kind])
        if not counted[kind]:
            out[kind] = EdgeSupport(np.zeros(3), 0.0, in_view, 0.0)
            continue
        contrast = dense.median(fit.contrast[enough & (measured_at.group_kind == kind)])
        snr = contrast / math.sqrt(var) if var < 0.5 else 0.0
        out[kind] = EdgeSupport(mix.contrast[kind] * contrast, snr, in_view, min(1.0, agreed[kind] / (0.9 * counted[kind])))
    return out, min(1.0, float(agree.sum()) / max(1.0, 0.9 * float(pixels.sum())))


def dense_support(fit: dense.DenseFit, arrow: tuple[float, float, float] | None) -> tuple[dict[EdgeKind, EdgeSupport], float]:
    """Return the same from a dense fit; `arrow` is the result of `arrow_amplitudes`."""
    weight = fit.weight.mean(axis=0)
    out: dict[EdgeKind, EdgeSupport] = {}
    for kind, row in ((EdgeKind.DISC, 3), (EdgeKind.RING, 4), (EdgeKind.H, 5)):
        coverage = fit.values[row]
        edge = coverage * (1.0 - coverage)
        total = float(edge.sum())
        snr = math.sqrt(float((fit.paints[row] ** 2 / np.maximum(fit.cov_paints[row], 1e-12)).sum()))
        inliers = min(1.0, float(edge @ weight) / (0.9 * total)) if total > 1e-6 else 0.0
        out[kind] = EdgeSupport(fit.paints[row], snr, 1.0, inliers)
    if arrow is None:
        out[EdgeKind.ARROW] = EdgeSupport(np.zeros(3), 0.0, 0.0, 0.0)
    else:
        out[EdgeKind.ARROW] = arrow_support(arrow[0], arrow[2], fit.paints[4], 1.0)
    return out, min(1.0, float(weight.mean()) / 0.9)


def arrow_support(amplitude: float, sigma: float, contrast: F64, in_view: float) -> EdgeSupport:
    """Return the support of an arrowhead with this amplitude; 1 is nominal."""
    agree = min(1.0, max(0.0, 1.0 - abs(amplitude - 1.0)))
    return EdgeSupport(contrast * amplitude, max(0.0, amplitude) / max(sigma, 1e-6), in_view, agree)


def beside(support: EdgeSupport, kind: EdgeKind, pad: Pad) -> EdgeSupport:
    """Return a copy with the likeness to the paints of the pad file."""
    nominal = _contrasts(pad).get(kind)
    size = math.sqrt(float(support.contrast_bgr @ support.contrast_bgr))
    like = 1.0 if nominal is None or size < 1e-6 else float(nominal @ support.contrast_bgr) / size
    return EdgeSupport(support.contrast_bgr, support.snr, support.in_view, support.inliers, like)


@lru_cache(maxsize=8)
def _contrasts(pad: Pad) -> Mapping[EdgeKind, F64]:
    """Return the (3,) BGR unit vectors from the disc's paint to the others of the pad file."""
    table, paints = light_table(True), pad.markings.colours
    ways = {kind: table[list(rgb[::-1])] - table[list(paints.disc[::-1])] for kind, rgb in (
        (EdgeKind.RING, paints.ring), (EdgeKind.ARROW, paints.ring), (EdgeKind.H, paints.h),
    )}  # fmt: skip
    return MappingProxyType({kind: way / max(float(np.linalg.norm(way)), 1e-6) for kind, way in ways.items()})
