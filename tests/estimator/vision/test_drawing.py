"""The drawing's blurred shares against brute force, their derivatives against differences, and its edges."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from estimator.contracts.geometry import Rotation
from estimator.vision.drawing import EdgeKind, edges_of
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from tests.estimator.vision.oracle.blurred import Blurred, Coverage
from tests.estimator.vision.oracle.state import RegistrationState
from tests.support.pad_images import _paint
from tests.support.shipped import shipped_camera, shipped_pad

PADS = [shipped_pad("thesis"), shipped_pad("printed")]


@pytest.mark.parametrize("pad", PADS, ids=lambda p: p.name)
@pytest.mark.parametrize("sigma_m", [0.012, 0.018, 0.036])
def test_shares_are_the_blurred_drawing(pad: Pad, sigma_m: float) -> None:
    step = 0.001
    axis = np.arange(-0.55, 0.55, step) + step / 2
    x, y = np.meshgrid(axis, axis, indexing="ij")
    paint = _paint(x, y, pad)
    orange, white = (gaussian_filter((paint == code).astype(float), sigma_m / step) for code in (3, 4))
    disc = gaussian_filter((paint > 0).astype(float), sigma_m / step)
    pick = (slice(3, None, 7), slice(3, None, 7))
    at = x[pick].ravel().astype(np.float32), y[pick].ravel().astype(np.float32)
    b = Blurred(pad, *at, (sigma_m**2, 0.0, sigma_m**2), np.ones(len(at[0]), np.float32))
    # A raster of a millimetre is itself wrong by half of one here and there, not in the sum.
    for share, true in ((b.circles(pad.disc_radius_m)[0][0], disc), (b.h()[0], white)):
        assert share == pytest.approx(true[pick].ravel(), abs=0.015)
        assert float(share.sum()) == pytest.approx(float(true[pick].sum()), rel=0.002)
    small = ring(b)[0] + b.arrow_small()[0]
    assert small == pytest.approx(orange[pick].ravel(), abs=0.025)
    assert float(small.sum()) == pytest.approx(float(orange[pick].sum()), rel=0.004)


def test_sharp_orange_is_the_drawing_too() -> None:
    pad, sigma_m, step = PADS[0], 0.003, 0.0005
    axis = np.arange(0.15, 0.35, step) + step / 2
    x, y = np.meshgrid(axis, axis - 0.25, indexing="ij")
    orange = gaussian_filter((_paint(x, y, pad) == 3).astype(float), sigma_m / step)
    pick = (slice(30, -30, 5), slice(30, -30, 5))
    at = x[pick].ravel().astype(np.float32), y[pick].ravel().astype(np.float32)
    b = Blurred(pad, *at, (sigma_m**2, 0.0, sigma_m**2), np.ones(len(at[0]), np.float32))
    away = np.abs(orange_of(b)[0] - orange[pick].ravel())
    assert np.percentile(away, 98) < 0.02
    assert away.max() < 0.2, "where ring and arrowhead meet at an angle"


def ring(b: Blurred) -> Coverage:
    outer, inner = b.circles(b.pad.markings.ring_outer_m, b.pad.markings.ring_inner_m)
    return outer[0] - inner[0], outer[1] - inner[1]


def orange_of(b: Blurred) -> Coverage:
    outer, inner = b.circles(b.pad.markings.ring_outer_m, b.pad.markings.ring_inner_m)
    head, d_head = b.arrow(outer)
    return outer[0] - inner[0] + head, outer[1] - inner[1] + d_head


def test_circles_of_points_own_radii_are_circles() -> None:
    x, y = (np.linspace(a, 0.4, 9, dtype=np.float32) for a in (0.1, -0.2))
    b = Blurred(PADS[0], x, y, (1e-4, 2e-5, 2e-4), np.linspace(0.8, 1.2, 9, dtype=np.float32))
    radii = np.where(np.arange(9) % 2 == 0, np.float32(0.3), np.float32(0.25))
    (own,) = b.circles(radii)
    even, odd = b.circles(0.3, 0.25)
    for k in range(2):
        assert np.array_equal(own[k][..., ::2], even[k][..., ::2])
        assert np.array_equal(own[k][..., 1::2], odd[k][..., 1::2])


@pytest.mark.parametrize("pad", PADS, ids=lambda p: p.name)
def test_edges_shares_together_are_those_of_each_by_itself(pad: Pad) -> None:
    rng = np.random.default_rng(3)
    edges = edges_of(pad)
    near = (edges.at_m[::7] + rng.normal(0.0, 0.003, edges.at_m[::7].shape)).astype(np.float32)
    borders = np.searchsorted(edges.kind[::7], np.arange(EdgeKind.UPPER + 1)).tolist()
    disc, ring_, arrow, h = (slice(a, b) for a, b in itertools.pairwise(borders))
    b = Blurred(pad, near[:, 0], near[:, 1], (9e-6, 2e-6, 7e-6), np.linspace(0.8, 1.2, len(near), dtype=np.float32))
    share, d, head = b.edge_coverages(disc, ring_, arrow, h)
    field = pad.markings.field_radius_m
    for part, shape in ((disc, lambda b: b.circles(field)[0]), (ring_, ring), (arrow, orange_of), (h, lambda b: b.h())):
        alone = shape(b.part(part))
        assert share[part] == pytest.approx(alone[0], abs=1e-6)
        assert d[:, part] == pytest.approx(alone[1], rel=1e-4, abs=0.02)
    assert head == pytest.approx(share[arrow] - ring(b.part(arrow))[0], abs=1e-6)


@settings(max_examples=25)
@given(
    st.floats(0.2, 20.0), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-math.pi, math.pi), st.integers(0, 1000),
)  # fmt: skip
def test_derivatives_by_pose_and_blur(height: float, roll: float, pitch: float, yaw: float, seed: int) -> None:
    camera, pad = shipped_camera("sim"), PADS[seed % 2]
    rng = np.random.default_rng(seed)
    pose = PadPose(Rotation.from_rpy(roll, pitch, yaw), np.array([*rng.uniform(-0.1, 0.1, 2) * height, height]))
    state = RegistrationState.of(pose, camera, 0.8, height)
    # Places within three sigmas of edges, where shares change.
    edges = edges_of(pad)
    near = edges.at_m[rng.integers(len(edges.at_m), size=60)] + rng.normal(0.0, 1.0, (60, 2)) * state.m_per_px
    p = np.c_[near, np.zeros(60)] @ state.R.T + state.t
    p = p[p[:, 2] > 0.05]
    rays = p[:, :2] / p[:, 2:]
    shapes = [
        lambda b: b.circles(pad.disc_radius_m)[0], ring, lambda b: b.h(), orange_of,
        lambda b: b.arrow_small(),
    ]  # fmt: skip
    fp = state.footprint(rays, pad)
    scale = np.array([*[state.m_per_px] * 3, *[state.m_per_px / pad.disc_radius_m] * 3, 1.0, 1.0, 1.0])
    for shape in shapes:
        J = fp.jacobian(shape(fp.places)[1]) * scale[:, None]
        for i in range(9):
            h = np.zeros(9)
            h[i] = 0.02 * scale[i]
            plus, minus = (state.moved(sign * h).footprint(rays, pad).places for sign in (1.0, -1.0))
            # The pixel's scale is held within one linearisation, and does not turn with the blur.
            plus, minus = (Blurred(pad, b.x, b.y, b.blur_m2, fp.places.scale2) for b in (plus, minus))
            difference = (shape(plus)[0] - shape(minus)[0]) / 0.04
            assert J[i] == pytest.approx(difference, abs=0.012), f"derivative {i}"


def test_edges_lie_between_the_two_paints() -> None:
    for pad in PADS:
        e = edges_of(pad)
        inside, outside = (_paint(at[:, 0], at[:, 1], pad) for at in (e.at_m - 1e-3 * e.normal, e.at_m + 1e-3 * e.normal))
        for kind, paints in ((EdgeKind.RING, (3, 2)), (EdgeKind.ARROW, (3, 2)), (EdgeKind.H, (4, 2))):
            of = e.kind == kind
            assert set(inside[of]) == {paints[0]}
            assert set(outside[of]) == {paints[1]}
        of = e.kind == EdgeKind.DISC
        assert set(inside[of]) == {2}
        assert set(outside[of]) == ({1} if pad.markings.rim_width_m else {0})
        assert np.all(np.diff(e.kind) >= 0)
        assert np.all(np.diff(e.piece) >= 0)
