"""Shapes with slanted sides: their blurred coverage is the integral of the normal distribution, and their pieces cover them."""

import ctypes
import math

import numpy as np
import pytest
from scipy.special import ndtr

from estimator.contracts.geometry import F64
from estimator.core.library import CORE, FILE
from estimator.vision.native import pad_shape
from estimator.vision.pad import Pad
from estimator.vision.regions import (
    PaintedPolygon,
    PaintedStroke,
    PaintedTriangle,
    Region,
    convex_pieces_of,
    covers,
    is_slanted,
    rectangles_of,
    sides_of,
    slanted_sides_of,
)

STROKE = PaintedStroke("white", (-0.2, -0.1), (0.2, 0.15), 0.05)
HOOK = PaintedPolygon("white", ((-0.3, -0.2), (0.3, -0.25), (0.1, 0.0), (0.28, 0.3), (-0.1, 0.1)))
TRIANGLE = PaintedTriangle("white", 0.7, 0.05)
SHAPES: tuple[Region, ...] = (STROKE, HOOK, TRIANGLE)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(160)


class _Footprint(ctypes.Structure):
    """The core's `footprint`."""

    _fields_ = [
        ("n", ctypes.c_int),
        *((name, ctypes.c_void_p) for name in ("x", "y", "k1", "k2", "m")),
        ("blur_m2", ctypes.c_double * 3),
        ("m2_per_px2", ctypes.c_double),
    ]


class _Round(ctypes.Structure):
    """The core's `round_points`; lettering has no circles."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("seen", "per", "per_sigma", "m_cc", "m_cs", "m_ss")]


class _Stretch(ctypes.Structure):
    """The core's `stretch`."""

    _fields_ = [("f", ctypes.c_void_p), ("round", ctypes.c_void_p), ("begin", ctypes.c_int), ("count", ctypes.c_int)]


def blurred(region: Region, blur_m2: tuple[float, float, float], at: F64, m: F64) -> tuple[F64, F64]:
    """Return the coverage (N,) that the core computes, and its derivatives (5, N) by x, y and the blur."""
    shape = CORE.record("dl_pad_shape", **pad_shape(Pad("one", (("white", (255, 255, 255)),), (region,))))
    n = len(at)
    x, y, ratio = (np.ascontiguousarray(row, np.float32) for row in (at[:, 0], at[:, 1], m))
    value, d, spare = np.zeros(n, np.float32), np.zeros((5, n), np.float32), np.zeros((2, n), np.float32)
    points = _Footprint(n, x.ctypes.data, y.ctypes.data, None, None, ratio.ctypes.data, (ctypes.c_double * 3)(*blur_m2), 0.0)
    kinds = shape["kinds"][3:].ctypes.data
    rows, free = ((ctypes.c_void_p * len(a))(*(row.ctypes.data for row in a)) for a in (d, spare))
    circles = _Round()
    part = _Stretch(ctypes.addressof(points), ctypes.addressof(circles), 0, n)
    ctypes.CDLL(FILE).cover(
        ctypes.c_void_p(shape.ctypes.data),
        ctypes.c_void_p(kinds),
        ctypes.byref(part),
        ctypes.c_void_p(value.ctypes.data),
        rows,
        free,
    )
    return value.astype(float), d.astype(float)


def integrated(region: Region, blur_m2: tuple[float, float, float], at: F64, m: F64) -> F64:
    """Return the coverage (N,) by Green's theorem: along each side, the density of one axis times the integral of the other."""
    xx, xy, yy = blur_m2
    L = np.linalg.inv(np.linalg.cholesky(np.array([[xx, xy], [xy, yy]])))
    start, end = (((line[None] - at[:, None]) @ L.T) / np.sqrt(m)[:, None, None] for line in sides_of(region))
    low, high = np.clip(start[..., 1], -9.0, 9.0), np.clip(end[..., 1], -9.0, 9.0)
    y = 0.5 * (high - low)[..., None] * NODES + 0.5 * (high + low)[..., None]
    rise = end[..., 1] - start[..., 1]
    x = (
        start[..., 0, None]
        + (y - start[..., 1, None]) * ((end[..., 0] - start[..., 0]) / np.where(rise == 0.0, 1.0, rise))[..., None]
    )
    density = np.exp(-0.5 * y * y) / math.sqrt(math.tau)
    return np.asarray((0.5 * (high - low)[..., None] * WEIGHTS * density * ndtr(x)).sum(axis=(1, 2)))


@pytest.mark.parametrize("region", SHAPES, ids=lambda r: type(r).__name__)
@pytest.mark.parametrize("sigma_m", [0.005, 0.03, 0.15])
@pytest.mark.parametrize(("slant", "longer"), [(0.0, 1.0), (0.6, 1.4), (-0.7, 0.8)])
def test_slanted_sides_are_blurred_exactly(region: Region, sigma_m: float, slant: float, longer: float) -> None:
    """The comparison covers corners and sides, round and slanted blur, far smaller and larger than the shape."""
    rng = np.random.default_rng(4)
    blur = (sigma_m**2, slant * longer * sigma_m**2, (longer * sigma_m) ** 2)
    start, end = sides_of(region)
    side, along = rng.integers(len(start), size=64), rng.choice([0.0, 1.0, 0.3, 0.7], size=(64, 1))
    at = start[side] * (1.0 - along) + end[side] * along + rng.normal(0.0, 1.5 * sigma_m, (64, 2))
    m = rng.uniform(0.8, 1.25, 64)
    # The core's points are in single precision.
    at, m = at.astype(np.float32).astype(float), m.astype(np.float32).astype(float)
    value, d = blurred(region, blur, at, m)
    assert value == pytest.approx(integrated(region, blur, at, m), abs=2e-5)

    def change(k: int) -> F64:
        if k < 2:
            step = np.eye(2)[k] * 2e-3 * sigma_m
            return np.asarray(
                (integrated(region, blur, at + step, m) - integrated(region, blur, at - step, m)) / (4e-3 * sigma_m)
            )
        more, less = (tuple(b + s * 1e-3 * sigma_m**2 * (i == k - 2) for i, b in enumerate(blur)) for s in (1.0, -1.0))
        return np.asarray((integrated(region, more, at, m) - integrated(region, less, at, m)) / (2e-3 * sigma_m**2))  # type: ignore[arg-type]

    for k in range(5):
        right = change(k)
        assert d[k] == pytest.approx(right, abs=2e-3 * np.abs(right).max())


@pytest.mark.parametrize("region", SHAPES, ids=lambda r: type(r).__name__)
def test_convex_pieces_cover_a_shape_once(region: Region) -> None:
    assert is_slanted(region)
    at = np.random.default_rng(2).uniform(-0.5, 0.5, (4000, 2))
    times = np.zeros(len(at), int)
    for piece in convex_pieces_of(region):
        assert len(piece) in (3, 4)
        way = np.roll(piece, -1, axis=0) - piece
        to = at[:, None, :] - piece[None]
        times += np.all(way[None, :, 0] * to[..., 1] - way[None, :, 1] * to[..., 0] > 0.0, axis=1)
    assert np.array_equal(times, covers(region, at).astype(int))


def test_upright_shapes_stay_rectangles() -> None:
    upright = PaintedStroke("white", (0.0, -0.2), (0.0, 0.2), 0.05)
    assert not is_slanted(upright)
    assert len(rectangles_of([upright, STROKE])) == 1
    assert len(slanted_sides_of([upright, STROKE])[0]) == 4
