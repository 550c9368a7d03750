"""A pad that is found and measured by its lamps: rules of its file, its bound, night frames, other lights."""

import math
import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from companion.tools.calibrate.flight_views import camera_pose
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.core.abi import DL_WRONG_SIZE
from estimator.core.library import CORE
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.native import image_of, native_camera, native_prior
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.lamps import detect_lamps, pattern_of
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from tests.support.night_scenes import NIGHTS, NightCondition, NightScene, night_scene
from tests.support.pad_scenes import ROOT, load_camera, load_pad, pad_scene

STAMP = Stamp(MonoNs(10**9), MonoNs(10**9), 0.0, "sim")
CAMERA, LIT = load_camera("sim"), load_pad("lit")
LEVEL = Orientation(0.0, 0.0, np.eye(2) * math.radians(1.0) ** 2, math.radians(2.0), True)
SHAPE = [(0.3, 0.0), (0.1, 0.3), (-0.2, 0.25), (-0.3, -0.1), (0.05, -0.3)]


def file_with(lamps: list[dict[str, Any]]) -> dict[str, Any]:
    data = tomllib.loads((ROOT / "configs" / "pads" / "thesis.toml").read_text())
    return {**data, "lamps": lamps}


def lamps_at(places: list[tuple[float, float]]) -> list[dict[str, Any]]:
    return [{"at_m": list(place)} for place in places]


def seen_in(scene: NightScene, pad: Pad = LIT) -> Any:
    return detect_lamps(Frame(STAMP, 0, scene.px), CAMERA, pad, scene.orientation)


@pytest.mark.parametrize(
    ("lamps", "said"),
    [
        (lamps_at(SHAPE[:4]), "lamps has 4: fewer than 5"),
        (lamps_at([*SHAPE, (0.3, 0.01)]), r"lamps\[5\] at \[0.3, 0.01\] touches lamps\[0\]"),
        (lamps_at([(0.1 * i, 0.01 * (i % 2)) for i in range(6)]), "the lamps lie in a line"),
        (lamps_at([(0.3 * math.cos(a), 0.3 * math.sin(a)) for a in np.arange(6) * math.tau / 6]), "after a turn by 180 degrees"),
        (lamps_at([*SHAPE, (300.0, 0.0)]), r"lamps\[5\].at_m must be at most 20 m .*millimetres"),
        ([*lamps_at(SHAPE), {"at_m": [0.0, 0.0], "colour": "red"}], r"lamps\[5\]: Object contains unknown field `colour`"),
        ([*lamps_at(SHAPE), {"at_m": [0.0, 0.0], "radius_m": 12.0}], r"lamps\[5\].radius_m"),
    ],
)
def test_lamps_that_tell_no_heading_or_are_in_millimetres_are_refused_by_path_and_cure(lamps, said):
    with pytest.raises(BadInput, match=said):
        Pad.from_mapping(file_with(lamps), "mine.toml")


def test_lamps_make_up_for_paint_with_too_little_support_and_then_the_paint_is_not_looked_for():
    data = file_with(lamps_at(SHAPE))
    disc = Pad.from_mapping({**data, "regions": data["regions"][:1]})
    often = {"least_support": 5.0, "chance": 0.02, "drawing": disc.fingerprint}
    bare = Pad.from_mapping({**data, "regions": data["regions"][:1], "lamps": [], "calibration": often})

    assert not disc.is_identifiable_by_paint
    disc.check_for_detection("mine.toml")
    with pytest.raises(BadInput, match="accept_false_pads"):
        bare.check_for_detection("mine.toml")
    replace(bare, accept_false_pads=True).check_for_detection("mine.toml")
    scene = pad_scene(np.random.default_rng(3), CAMERA, disc, 2.0, "plain", 0.1)
    seen, _ = track(TrackerConfig(CAMERA, disc), TrackerMemory(), Frame(STAMP, 0, scene.px), None)
    assert seen.selected is None or seen.chosen == "lamps"


@pytest.mark.parametrize("condition", NIGHTS)
@pytest.mark.parametrize("height_m", [0.5, 1.0, 3.0, 9.0])
def test_a_lit_pad_is_found_from_cold_within_its_covariance(condition: NightCondition, height_m: float):
    kind = NIGHTS.index(condition)
    scenes = [night_scene(np.random.default_rng([31, kind, n]), CAMERA, LIT, height_m, condition) for n in range(2)]
    seen = [(s, seen_in(s)) for s in scenes if s.shown > 0.6]

    for scene, found in seen:
        assert found.confidence > 0.5
        assert found.method == "lamps"
        by_camera = camera_pose(found, CAMERA, scene.orientation)
        turned = (Rotation(by_camera.R_cam_pad) @ scene.truth.R_cam_pad.inv).rotvec_rad
        off = np.append(by_camera.t_cam_pad - scene.truth.t_cam_pad, turned)
        assert off @ np.linalg.solve(by_camera.cov, off) < 35.0  # 99.9995 % of six numbers


def test_other_lights_are_not_a_pad():
    for n in range(60):
        rng = np.random.default_rng([17, n])
        scene = night_scene(rng, CAMERA, LIT, float(rng.uniform(0.5, 20.0)), "other lights", lit=False)
        found = seen_in(scene)
        assert found is None or found.confidence < 0.2


def ring(centre: np.ndarray, lights: int, radius_px: float, turned_rad: float) -> np.ndarray:
    angles = turned_rad + math.tau / lights * np.arange(lights)
    return np.asarray(centre + radius_px * np.stack([np.cos(angles), np.sin(angles)], axis=1))


def test_even_rings_of_lights_like_those_of_other_pads_are_not_this_pad():
    for n in range(120):
        rng = np.random.default_rng([19, n])
        centre, radius_px = rng.uniform([160, 90], [480, 270]), float(rng.uniform(6.0, 160.0))
        outer = ring(centre, int(rng.integers(4, 13)), radius_px, float(rng.uniform(0.0, 6.0)))
        inner = ring(centre, int(rng.integers(3, 8)), 0.34 * radius_px, float(rng.uniform(0.0, 6.0)))
        px = rng.integers(0, 8, (CAMERA.height, CAMERA.width, 3)).astype(float)
        v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
        for x, y in np.concatenate([outer, inner] if n % 2 else [outer]):
            rows, columns = (slice(max(0, int(at) - 8), max(0, int(at) + 9)) for at in (y, x))
            away2 = (u[rows, columns] - x) ** 2 + (v[rows, columns] - y) ** 2
            px[rows, columns] += (rng.uniform(60.0, 600.0) * np.exp(-0.5 * away2 / rng.uniform(0.7, 2.0) ** 2))[:, :, None]
        found = detect_lamps(Frame(STAMP, 0, px.clip(0, 255).astype(np.uint8)), CAMERA, LIT, LEVEL)
        assert found is None or found.confidence < 0.2


@pytest.mark.parametrize("height_m", [1.0, 4.0, 10.0, 18.0])
def test_lamps_are_distinguished_although_the_pad_is_expected_farther_off_than_they_are_from_each_other(height_m: float):
    scene = night_scene(np.random.default_rng([31, 0, 4]), CAMERA, LIT, height_m, "lamps")
    for way in np.arange(6) * math.tau / 6:
        off_m = 12.0 * height_m / CAMERA.fx * np.array([math.cos(way), math.sin(way), 0.0])
        expected = PadPose(scene.truth.R_cam_pad, scene.truth.t_cam_pad + off_m)
        found = detect_lamps(Frame(STAMP, 0, scene.px), CAMERA, LIT, scene.orientation, expected, 16.0)
        assert found.confidence > 0.99
        by_camera = camera_pose(found, CAMERA, scene.orientation)
        assert np.linalg.norm(by_camera.t_cam_pad - scene.truth.t_cam_pad) < 0.05 * height_m


def test_a_track_goes_from_paint_to_lamps_when_night_falls_and_back():
    config, memory = TrackerConfig(CAMERA, LIT), TrackerMemory()
    day = pad_scene(np.random.default_rng(8), CAMERA, LIT, 3.0, "plain", 0.0)
    night = night_scene(np.random.default_rng([31, 0, 1]), CAMERA, LIT, 3.0, "lamps")
    measured = Attitude(STAMP, night.measured, np.eye(3) * math.radians(1.0) ** 2)
    chosen = []
    for px, attitude in ((day.px, None), (night.px, measured), (night.px, measured), (day.px, None)):
        seen, memory = track(config, memory, Frame(STAMP, 0, px), attitude)
        chosen.append((seen.chosen, memory.lit))

    assert [lit for _, lit in chosen] == [False, True, True, False]
    assert [by == "lamps" for by, _ in chosen] == [False, True, True, False]


def test_another_lit_pad_does_not_take_the_tracked_ones_place_but_is_reported():
    night = night_scene(np.random.default_rng([31, 0, 1]), CAMERA, LIT, 3.0, "lamps")
    measured = Attitude(STAMP, night.measured, np.eye(3) * math.radians(1.0) ** 2)
    frame, config = Frame(STAMP, 0, night.px), TrackerConfig(CAMERA, LIT)
    cold, memory = track(config, TrackerMemory(), frame, measured)
    place = cold.selected.d_body_pad_level
    for aside_m, is_tracked in ((0.0, True), (1.6, False)):
        d = place + np.array([aside_m, 0.0, 0.0])
        belief = RelativeState(
            STAMP.measured_at, "ekf", d, np.zeros(3), cold.selected.yaw_rad, 1e-4 * np.eye(7), STAMP.measured_at, True
        )
        seen, left = track(config, memory, frame, measured, belief)
        at, other = (seen.selected, seen.elsewhere) if is_tracked else (seen.elsewhere, seen.selected)
        assert other is None
        assert np.linalg.norm(at.d_body_pad_level - place) < 0.05
        assert left.lit


def core_answer(px: np.ndarray, spoil: tuple[str, str, float] | None = None, expected: tuple[float, ...] | None = None) -> int:
    """Return what the core's entry returns, with one number of its inputs spoilt."""
    of, member, value = spoil or ("", "", 0.0)
    camera = native_camera(CAMERA)
    camera["lens"]["height"], camera["lens"]["width"] = px.shape[:2]
    if of == "camera":
        camera["lens"][member] = value
    pattern, prior = pattern_of(LIT).copy(), CORE.ffi.new("dl_tilt_prior *", native_prior(LEVEL))
    if of == "dl_lamp_pattern":
        pattern[member].flat[0] = value
    if of == "dl_tilt_prior":
        setattr(prior, member, value)
    at, out = CORE.ffi.NULL, CORE.record("dl_found_lamps")
    if expected is not None:
        at = CORE.ffi.new("dl_expected_lamps *", ((list(expected[:9]), list(expected[9:12])), expected[12]))
    tracker = CORE.ffi.gc(
        CORE.lib.dl_tracker_new(CORE.array("dl_camera", camera), *[CORE.ffi.NULL] * 7), CORE.lib.dl_tracker_free
    )
    return int(CORE.lib.dl_find_lamps(
        tracker, image_of(px), CORE.array("dl_lamp_pattern", pattern), prior, at, CORE.array("dl_found_lamps", out)
    ))  # fmt: skip


@pytest.mark.parametrize("value", [0, 1, 128, 255])
@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 40), (40, 1), (3, 2), (64, 31), (640, 360)])
def test_an_even_frame_of_any_size_has_no_lamps(value: int, width: int, height: int) -> None:
    px = np.full((height, width, 3), value, np.uint8)
    below = (*CAMERA.T_body_cam.R.inv.matrix.ravel().tolist(), 0.0, 0.0, 1.0, 5.0)
    assert (core_answer(px), core_answer(px, None, below)) == (0, 0)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, 0.0])
@pytest.mark.parametrize(("of", "member"), [
    ("camera", "fx"), ("camera", "cy"), ("dl_tilt_prior", "roll_rad"), ("dl_tilt_prior", "sigma_deck_rad"),
    ("dl_lamp_pattern", "x_m"), ("dl_lamp_pattern", "radius_m"),
])  # fmt: skip
def test_numbers_that_describe_nothing_end_in_an_answer_with_finite_numbers_or_none(of: str, member: str, value: float) -> None:
    px = night_scene(np.random.default_rng([43, 1]), CAMERA, LIT, 3.0, "lamps").px
    assert core_answer(px) == 1
    assert core_answer(px, (of, member, value)) in (0, 1)
    if not math.isfinite(value) and member in ("fx", "roll_rad"):
        assert core_answer(px, (of, member, value)) == 0


def test_thousands_of_lights_are_no_dark_deck_and_are_refused_before_they_are_searched() -> None:
    px = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    px[4::6, 4::6] = 255
    px[5::6, 4::6] = 200
    assert core_answer(px) == -1
    assert detect_lamps(Frame(STAMP, 0, px), CAMERA, LIT, LEVEL) is None


@pytest.mark.parametrize(("member", "value"), [("lamps", 41), ("lamps", -1), ("pairs", 21), ("pair", 40), ("pair", -1)])
def test_a_pattern_larger_than_the_core_holds_is_refused(member: str, value: int) -> None:
    px = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    assert core_answer(px, ("dl_lamp_pattern", member, value)) == DL_WRONG_SIZE
