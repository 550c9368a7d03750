"""The core finds a pad's lamps as the numpy of its oracle does, and finds nothing in garbage, in bounded work."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, start_of
from estimator.vision.camera import Camera
from estimator.vision.lamp import Lamp, points_of
from estimator.vision.lamp_sighting import detect_lamps, light_address, packed_pattern
from estimator.vision.native import address, packed_camera
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import packed_prior
from tests.estimator.vision.oracle.lamps import detect as oracle
from tests.support.night_scenes import NIGHTS, NightCondition, night_scene
from tests.support.pad_scenes import load_camera, load_pad

STAMP = Stamp(MonoNs(10**9), MonoNs(10**9), 0.0, "sim")
CAMERA, LIT = load_camera("sim"), load_pad("lit")
LENS = replace(CAMERA, distortion=(-0.12, 0.05, 0.001, -0.002, -0.01))
LEVEL = Orientation(0.0, 0.0, np.eye(2) * math.radians(1.0) ** 2, math.radians(2.0), True)
FEW = Pad(LIT.name, LIT.paints, LIT.regions, 0.002, tuple(
    Lamp(at, 0.01) for at in ((0.35, 0.0), (0.06, 0.34), (-0.3, 0.18), (-0.18, -0.29), (0.12, -0.09))
))  # fmt: skip


def frame_of(px: np.ndarray) -> Frame:
    return Frame(STAMP, 0, px)


def assert_alike(ours: Sighting | None, numpys: Sighting | None) -> None:
    """Check that the core says what the oracle says: pose within 0.05 standard deviations, confidence within 0.01."""
    assert (ours is None) == (numpys is None)
    if ours is None or numpys is None:
        return
    assert ours.method == numpys.method == "lamps"
    assert abs(ours.confidence - numpys.confidence) < 0.01
    assert ours.yaw_rad is not None
    assert numpys.yaw_rad is not None
    turned = math.remainder(ours.yaw_rad - numpys.yaw_rad, math.tau)
    off = np.append(ours.d_body_pad_level - numpys.d_body_pad_level, turned)
    assert off @ np.linalg.solve(numpys.cov, off) < 0.05**2
    np.testing.assert_allclose(ours.cov, numpys.cov, rtol=0.02, atol=1e-3 * float(np.abs(np.diag(numpys.cov)).min()))
    np.testing.assert_allclose(ours.features[0].uv_px, numpys.features[0].uv_px, atol=0.01)


@pytest.mark.parametrize("condition", NIGHTS)
@pytest.mark.parametrize(("height_m", "pad", "camera"), [
    (0.45, LIT, CAMERA), (0.9, LIT, CAMERA), (1.6, LIT, LENS), (3.0, FEW, CAMERA), (6.0, LIT, CAMERA), (11.0, LIT, LENS),
    (16.0, LIT, CAMERA), (21.0, LIT, CAMERA),
])  # fmt: skip
def test_the_core_finds_and_measures_lamps_as_numpy_does(
    condition: NightCondition, height_m: float, pad: Pad, camera: Camera
) -> None:
    for n in range(2):
        rng = np.random.default_rng([43, NIGHTS.index(condition), round(10 * height_m), n])
        scene = night_scene(rng, camera, pad, height_m, condition)
        off = rng.normal(0.0, max(0.01, 0.01 * height_m), 3)
        near = PadPose(scene.truth.R_cam_pad @ Rotation.from_rpy(0.0, 0.0, 0.03), scene.truth.t_cam_pad + off)
        for expected, reach_px in ((None, 0.0), (near, 12.0)):
            ours = detect_lamps(frame_of(scene.px), camera, pad, scene.orientation, expected, reach_px)
            assert_alike(ours, oracle.detect_lamps(frame_of(scene.px), camera, pad, scene.orientation, expected, reach_px))


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40), st.floats(-0.25, 0.25), st.floats(0.5, 12.0), st.booleans())
def test_lights_anywhere_are_told_alike(seed: int, lights: int, roll_rad: float, height_m: float, lit: bool) -> None:
    rng = np.random.default_rng(seed)
    tilt = Orientation(roll_rad, 0.02, np.eye(2) * 1e-4, 0.03, True)
    down = (tilt.R_level_body.matrix @ CAMERA.T_body_cam.R.matrix).T
    pose = PadPose(Rotation(down) @ Rotation.from_rpy(0.0, 0.0, float(rng.uniform(-3.0, 3.0))), height_m * down[:, 2])
    uv = rng.uniform([0, 0], [CAMERA.width, CAMERA.height], (lights, 2))
    if lit:
        uv = np.concatenate([uv, CAMERA.project(pose.points(points_of(LIT.lamps)))])
    px = rng.integers(0, int(rng.integers(1, 12)), (CAMERA.height, CAMERA.width, 3)).astype(float)
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    for x, y in uv:
        size = rng.uniform(0.7, 3.0)
        rows, columns = (slice(max(0, int(at) - 15), max(0, int(at) + 16)) for at in (y, x))
        away2 = (u[rows, columns] - x) ** 2 + (v[rows, columns] - y) ** 2
        px[rows, columns] += (rng.uniform(40.0, 500.0) * np.exp(-0.5 * away2 / size**2))[:, :, None]
    frame = frame_of(px.clip(0, 255).astype(np.uint8))

    ours, numpys = (find(frame, CAMERA, LIT, tilt, pose if lit else None, 8.0) for find in (detect_lamps, oracle.detect_lamps))

    assert_alike(ours, numpys)


def core_answer(px: np.ndarray, spoil: tuple[str, str, float] | None = None, expected: np.ndarray | None = None) -> int:
    """Return what the core's call returns, with one number of its inputs spoilt."""
    words = {
        "camera_lens": packed_camera(CAMERA).copy(), "lamp_pattern": packed_pattern(LIT, CAMERA)[0].copy(),
        "tilt_prior": packed_prior(LEVEL),
    }  # fmt: skip
    for name, size in (("height", px.shape[0]), ("width", px.shape[1])):
        words["camera_lens"][places_of("camera_lens")[name]].view(np.int64)[:] = size
    if spoil is not None:
        words[spoil[0]][places_of(spoil[0])[spoil[1]].start] = spoil[2]
    room = CORE.function("lamps_room")(address(words["camera_lens"]))
    scratch, out = np.empty(room, np.uint32), np.empty(size_of("lamps_seen"))
    return int(CORE.function("find_lamps")(
        address(words["camera_lens"]), int(px.ctypes.data), light_address(), address(words["lamp_pattern"]),
        address(words["tilt_prior"]), None if expected is None else start_of(expected), int(scratch.ctypes.data), start_of(out),
    ))  # fmt: skip


@pytest.mark.parametrize("value", [0, 1, 128, 255])
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 40), (40, 1), (3, 2), (64, 31), (640, 360)])
def test_an_even_frame_of_any_size_has_no_lamps(value: int, width: int, height: int) -> None:
    px = np.full((height, width, 3), value, np.uint8)
    below = np.array([*CAMERA.T_body_cam.R.inv.matrix.ravel(), 0.0, 0.0, 1.0, 5.0])
    assert (core_answer(px), core_answer(px, None, below)) == (0, 0)


def test_a_frame_of_another_size_than_the_cameras_is_refused() -> None:
    with pytest.raises(ValueError, match=r"want a frame of shape \(360, 640, 3\), got \(360, 639, 3\)"):
        detect_lamps(frame_of(np.zeros((360, 639, 3), np.uint8)), CAMERA, LIT, LEVEL)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, 0.0])
@pytest.mark.parametrize(("of", "member"), [
    ("camera_lens", "fx"), ("camera_lens", "cy"), ("tilt_prior", "roll_rad"), ("tilt_prior", "sigma_deck_rad"),
    ("lamp_pattern", "x_m"), ("lamp_pattern", "radius_m"),
])  # fmt: skip
def test_numbers_that_describe_nothing_end_in_an_answer_with_finite_numbers_or_none(of: str, member: str, value: float) -> None:
    px = night_scene(np.random.default_rng([43, 1]), CAMERA, LIT, 3.0, "lamps").px
    assert core_answer(px) == 1
    assert core_answer(px, (of, member, value)) in (0, 1)
    if not math.isfinite(value) and member in ("fx", "roll_rad"):
        assert core_answer(px, (of, member, value)) == 0


def test_a_place_that_is_nowhere_is_searched_for() -> None:
    px = night_scene(np.random.default_rng([43, 1]), CAMERA, LIT, 3.0, "lamps").px
    for place in (math.nan, math.inf, -1.0, 0.0, 1e300):
        assert core_answer(px, None, np.array([*np.eye(3).ravel(), 0.0, 0.0, place, 8.0])) == 1


def test_thousands_of_lights_are_no_dark_deck_and_are_refused_before_they_are_searched() -> None:
    px = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    px[4::6, 4::6] = 255
    px[5::6, 4::6] = 200
    assert core_answer(px) == -1
    assert detect_lamps(frame_of(px), CAMERA, LIT, LEVEL) is None
