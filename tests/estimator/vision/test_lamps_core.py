"""The core finds no lamps in garbage, in bounded work."""

import math

import numpy as np
import pytest

from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.core.abi import DL_WRONG_SIZE
from estimator.core.library import CORE
from estimator.vision.lamp_sighting import detect_lamps, pattern_of
from estimator.vision.native import image_of, native_camera, native_prior
from estimator.vision.pose import Orientation
from tests.support.night_scenes import night_scene
from tests.support.pad_scenes import load_camera, load_pad

STAMP = Stamp(MonoNs(10**9), MonoNs(10**9), 0.0, "sim")
CAMERA, LIT = load_camera("sim"), load_pad("lit")
LEVEL = Orientation(0.0, 0.0, np.eye(2) * math.radians(1.0) ** 2, math.radians(2.0), True)


def frame_of(px: np.ndarray) -> Frame:
    return Frame(STAMP, 0, px)


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
        CORE.lib.dl_tracker_new(CORE.array("dl_camera", camera), *[CORE.ffi.NULL] * 6), CORE.lib.dl_tracker_free
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


def test_a_frame_of_another_size_than_the_cameras_is_refused() -> None:
    with pytest.raises(ValueError, match=r"want a frame of shape \(360, 640, 3\), got \(360, 639, 3\)"):
        detect_lamps(frame_of(np.zeros((360, 639, 3), np.uint8)), CAMERA, LIT, LEVEL)


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


def test_a_place_that_is_nowhere_is_searched_for() -> None:
    px = night_scene(np.random.default_rng([43, 1]), CAMERA, LIT, 3.0, "lamps").px
    for place in (math.nan, math.inf, -1.0, 0.0, 1e300):
        assert core_answer(px, None, (*np.eye(3).ravel().tolist(), 0.0, 0.0, place, 8.0)) == 1


def test_thousands_of_lights_are_no_dark_deck_and_are_refused_before_they_are_searched() -> None:
    px = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    px[4::6, 4::6] = 255
    px[5::6, 4::6] = 200
    assert core_answer(px) == -1
    assert detect_lamps(frame_of(px), CAMERA, LIT, LEVEL) is None


@pytest.mark.parametrize(("member", "value"), [("lamps", 41), ("lamps", -1), ("pairs", 21), ("pair", 40), ("pair", -1)])
def test_a_pattern_larger_than_the_core_holds_is_refused(member: str, value: int) -> None:
    px = np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8)
    assert core_answer(px, ("dl_lamp_pattern", member, value)) == DL_WRONG_SIZE
