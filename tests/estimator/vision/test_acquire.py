"""Acquisition from whole frames: any height, light and heading, partly hidden; and not a pad where there is none."""

import itertools
import math

import cv2
import numpy as np
import pytest

from estimator.vision.camera import Camera
from estimator.vision.detect.acquire import PadCandidate
from estimator.vision.pad import Pad
from sitl.camera.light import Light
from sitl.camera.surroundings import Decal
from tests.support.deck_images import covered, disc_of, keeps_claim, shown
from tests.support.pad_scenes import acquire, no_pads, photographs
from tests.support.shipped import shipped_camera, shipped_pad


def best_of(candidates: list[PadCandidate]) -> PadCandidate:
    assert candidates, "nothing at all was found"
    assert all(a.score >= b.score for a, b in itertools.pairwise(candidates))
    return candidates[0]


@pytest.mark.parametrize(
    ("height_m", "aside"),
    [
        (0.3, (0.0, -0.1)), (0.5, (0.3, 0.0)), (0.8, (-0.2, 0.1)), (1.5, (0.4, -0.2)), (3.0, (-0.6, 0.3)),
        (6.0, (0.2, 0.2)), (10.0, (0.0, 0.0)), (15.0, (0.3, -0.1)), (20.0, (-0.1, 0.2)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("known", [True, False], ids=["attitude", "no attitude"])
def test_found_from_near_and_far(camera: Camera, pad: Pad, height_m: float, aside: tuple[float, float], known: bool) -> None:
    seen = shown(camera, pad, height_m, aside=aside, yaw_rad=2.2, tilt_rad=(0.12, -0.08))
    best = best_of(acquire(seen.px, camera, pad, seen.R_level_body if known else None))
    assert best.score > 0.5
    assert keeps_claim(best.pose, seen.truth, camera, pad, best.yaw_ambiguous)


def test_a_piece_of_the_letter_gives_a_pose_to_start_from_but_no_certainty(camera: Camera, pad: Pad) -> None:
    for yaw in (0.3, 1.4, -2.0):
        seen = shown(camera, pad, 0.2, aside=(0.1, 0.05), yaw_rad=yaw, tilt_rad=(0.12, -0.08))
        candidates = acquire(seen.px, camera, pad, seen.R_level_body)
        assert best_of(candidates).score < 0.5, "it may as well be another helipad's H"
        piece = next(c for c in candidates[:2] if c.aligned.in_view < 0.25)
        assert piece.yaw_ambiguous
        assert keeps_claim(piece.pose, seen.truth, camera, pad, True)


LIGHTS = {
    "3000 K, dark": Light(3000.0, exposure_ev=-2.0),
    "3000 K, bright": Light(3000.0, exposure_ev=1.5),
    "9000 K, bright": Light(9000.0, exposure_ev=2.0),
    "white balance 20 % to magenta": Light(white_balance=(1.2, 0.8, 1.2)),
    "white balance 20 % to blue": Light(white_balance=(0.8, 1.0, 1.2)),
    "glare": Light(glare=0.8, glare_centre_m=(0.1, 0.15)),
    "wet": Light(wetness=0.8),
    "own shadow": Light(drone_shadow=0.7, sun_elevation_rad=1.3),
}


@pytest.mark.parametrize("name", LIGHTS)
@pytest.mark.parametrize("height_m", [0.5, 4.0])
def test_found_in_any_light(camera: Camera, pad: Pad, name: str, height_m: float) -> None:
    seen = shown(camera, pad, height_m, aside=(-0.1, 0.15), yaw_rad=-1.1, light=LIGHTS[name])
    best = best_of(acquire(seen.px, camera, pad, seen.R_level_body))
    assert best.score > 0.5
    assert keeps_claim(best.pose, seen.truth, camera, pad, best.yaw_ambiguous)


@pytest.mark.parametrize("yaw_deg", range(-165, 181, 69))
def test_found_tilted_by_25_degrees_at_any_heading(camera: Camera, pad: Pad, yaw_deg: int) -> None:
    tilt = math.radians(25.0)
    seen = shown(camera, pad, 2.5, aside=(0.05, 0.15), yaw_rad=math.radians(yaw_deg), tilt_rad=(tilt * 0.6, -tilt * 0.8))
    for R in (seen.R_level_body, None):
        best = best_of(acquire(seen.px, camera, pad, R))
        assert best.score > 0.5
        assert not best.yaw_ambiguous
        assert keeps_claim(best.pose, seen.truth, camera, pad, False)


def test_without_the_arrow_the_heading_is_reported_to_be_ambiguous(camera: Camera, pad: Pad) -> None:
    seen = shown(camera, pad, 1.2)
    green = seen.px[tuple(np.rint(camera.project(seen.truth.points(np.array([[0.0, 0.18, 0.0]])))[0]).astype(int)[::-1])]
    tip = disc_of(0.06, (pad.markings.arrow_tip_m - 0.01, 0.0))
    hidden = covered(seen, camera, tip, (int(green[0]), int(green[1]), int(green[2])))
    reported, untold = (best_of(acquire(px, camera, pad, seen.R_level_body)) for px in (seen.px, hidden))
    assert not reported.yaw_ambiguous
    assert untold.yaw_ambiguous
    assert keeps_claim(untold.pose, seen.truth, camera, pad, True)


@pytest.mark.parametrize("kind", ["raft", "awning", "helipad", "bare_h", "green_disc", "ring", "lifebuoy", "towel"])
@pytest.mark.parametrize("height_m", [0.6, 5.0])
def test_nothing_else_is_taken_for_it(camera: Camera, pad: Pad, kind: str, height_m: float) -> None:
    size = 0.78 if height_m < 5 else 1.5
    decal = Decal(kind, (0.05, -0.03), size, 0.5, "deck")  # type: ignore[arg-type]
    seen = shown(camera, None, height_m, decals=(decal,))
    R = seen.R_level_body if height_m < 1.0 else None
    assert all(c.score < 0.5 for c in acquire(seen.px, camera, pad, R))


def test_bare_deck_black_white_and_noise_hold_no_pad(camera: Camera, pad: Pad) -> None:
    rng = np.random.default_rng(3)
    shape = (camera.height, camera.width, 3)
    images = [
        shown(camera, None, 1.0).px, np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8),
        np.full(shape, (30, 120, 20), np.uint8), rng.integers(0, 256, shape, dtype=np.uint8),
        cv2.GaussianBlur(rng.integers(0, 256, shape, dtype=np.uint8), (0, 0), 9.0),
    ]  # fmt: skip
    for px in images:
        assert all(c.score < 0.5 for c in acquire(np.asarray(px, np.uint8), camera, pad))


def test_same_image_same_answer_and_the_image_stays_as_it_was(camera: Camera, pad: Pad) -> None:
    seen = shown(camera, pad, 2.0)
    kept = seen.px.copy()
    a, b = (acquire(seen.px, camera, pad, seen.R_level_body) for _ in range(2))
    assert np.array_equal(seen.px, kept)
    assert [c.score for c in a] == [c.score for c in b]
    assert np.array_equal(a[0].pose.t_cam_pad, b[0].pose.t_cam_pad)
    with pytest.raises(ValueError, match="the camera's are 640x360"):
        acquire(kept[:300], camera, pad)


def test_photographs_of_the_printed_pad() -> None:
    camera, pad = shipped_camera("photos"), shipped_pad("printed")
    half_in_view = found = 0
    for _, px, truth in photographs():
        uv = camera.project(truth.points(np.concatenate([pad.circle(r, 60) for r in (0.1, 0.2, 0.28, 0.34, 0.39)])))
        if np.mean((uv > 0).all(axis=1) & (uv[:, 0] < 639) & (uv[:, 1] < 359)) >= 0.5:
            half_in_view += 1
            best = next(iter(acquire(px, camera, pad)), None)
            if best is not None and best.score > 0.5:
                found += keeps_claim(best.pose, truth, camera, pad, best.yaw_ambiguous)
    assert half_in_view > 70
    assert found >= 0.98 * half_in_view


def test_no_pad_on_images_of_the_sea_and_of_other_things() -> None:
    pad, seen = shipped_pad("thesis"), 0
    for name, px, camera in no_pads():
        seen += 1
        assert all(c.score < 0.5 for c in acquire(px, camera, pad)), name
    assert seen > 35
