"""Pads of other shapes than the thesis' and with fiducials, and any pad acquired from whole frames."""

import copy
import itertools
import math
import re
import tomllib
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import F64, Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detect.acquire import PadCandidate
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.verification import confidence
from estimator.vision.options import TrackerOptions
from estimator.vision.pad.drawing import EdgeKind
from estimator.vision.pad.fiducial import PaintedFiducial, dictionary_of
from estimator.vision.pad.geometry import depth_in, outlines_of, rectangles_of
from estimator.vision.pad.information import alike_headings, confusable_turns, paint_at
from estimator.vision.pad.pad import Pad
from estimator.vision.register.doubts import cells_log_odds
from estimator.vision.register.headings import heading_z_scores
from estimator.vision.register.registration import RegistrationOptions, look, register
from estimator.vision.register.verified import verify
from estimator.vision.track import register as tracking
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from sitl.camera.camera import Renderer
from sitl.camera.light import Light
from sitl.camera.surroundings import Decal
from tests.sitl.images import PLAIN, pad_pose, shot
from tests.support.deck_images import covered, disc_of, keeps_claim, shown
from tests.support.pad_images import STAMP
from tests.support.pad_scenes import acquire, no_pads, photographs
from tests.support.shipped import CONFIGS, shipped_camera, shipped_pad

NAMES = ("h", "helideck", "hospital", "icao", "x")


@pytest.mark.parametrize("name", [*NAMES, "faa_triangle"])
@pytest.mark.parametrize("height_m", [0.6, 2.0, 6.0, 10.0])
def test_a_pad_of_any_shape_is_registered_and_verified(name: str, height_m: float) -> None:
    pad, camera, exposure = shipped_pad(name), PLAIN, shot(height_m, (0.05, -0.05))
    px = Renderer(camera, pad).render(exposure, np.random.default_rng(1))
    truth = pad_pose(exposure, camera)
    off = np.array([0.5, -0.5, 0.0]) * height_m / camera.fx + np.array([0.0, 0.0, 0.002 * height_m])
    start = PadPose(truth.R_cam_pad @ Rotation.from_rpy(0.01, 0.01, 0.02), truth.t_cam_pad + off)
    found = register(px, camera, pad, start, None, RegistrationOptions(coarse=False))
    error, sigma = found.pose.t_cam_pad - truth.t_cam_pad, np.sqrt(np.diag(found.cov)[:3])
    assert np.all(np.abs(error) < 4.0 * sigma + 1e-5)
    assert abs(error[2]) < 0.005 * height_m
    assert found.yaw_ambiguous == (name != "faa_triangle"), "no other has an arrowhead or a triangle"
    lacking = [
        kind
        for kind, has in ((EdgeKind.DISC, pad.markings.field_radius_m), (EdgeKind.RING, pad.markings.ring_outer_m))
        if not has
    ]
    assert all(found.edges[kind].in_view == 0.0 for kind in lacking)
    seen = look(FrameView(Pyramid(px), camera, pad), found.pose, Orientation.of(None), RegistrationOptions(coarse=False))
    assert confidence(seen.log_odds) > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_a_pad_of_several_headings_is_followed_without_a_search(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The filter takes no ambiguous heading, so the tracker goes by that of the last frame."""
    pad, exposure = shipped_pad(name), shot(2.0, (0.02, 0.03), (0.08, -0.05, 0.3))
    px = Renderer(PLAIN, pad).render(exposure, np.random.default_rng(3))
    config = TrackerConfig(PLAIN, pad, TrackerOptions(method="registration"))
    attitude = Attitude(STAMP, exposure.R_ned_body, 1e-6 * np.eye(3))
    seen, memory = track(config, TrackerMemory(), Frame(STAMP, 0, px), attitude)
    assert seen.selected.yaw_ambiguous
    d, cov = seen.selected.d_body_pad_level, np.diag([1e-4] * 6 + [3.0])
    belief = RelativeState(STAMP.measured_at, "ekf", d, np.zeros(3), None, cov, STAMP.measured_at, True)
    monkeypatch.setattr(tracking, "search", None)
    again = track(config, memory, Frame(STAMP, 0, px), attitude, belief)[0].selected
    assert again.yaw_rad == pytest.approx(seen.selected.yaw_rad, abs=0.01)
    assert again.confidence > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_a_pad_is_not_seen_in_another_one(name: str) -> None:
    """The thesis' pad, registered as if it were another, is doubted."""
    pad, exposure = shipped_pad(name), shot(2.0)
    px = Renderer(PLAIN, shipped_pad("thesis")).render(exposure, np.random.default_rng(2))
    options = RegistrationOptions(coarse=False)
    found = look(FrameView(Pyramid(px), PLAIN, pad), pad_pose(exposure, PLAIN), Orientation.of(None), options)
    sure = 0.0 if found is None else confidence(found.log_odds)
    # The plain H is the thesis' H: on a green disc it is the same marking.
    assert sure < 0.5 or name == "h"


@pytest.mark.parametrize(("name", "turns_deg"), [("hospital", [90]), ("faa_triangle", [-120, 120]), ("icao", []), ("thesis", [])])
@pytest.mark.parametrize("height_m", [0.9, 3.0, 9.0])
def test_a_heading_that_the_drawing_hardly_shows_is_put_right(name: str, turns_deg: list[int], height_m: float) -> None:
    """A cross looks the same after a quarter turn, a triangle after a third: the H within them tells."""
    pad, exposure = shipped_pad(name), shot(height_m, (0.02, 0.03), (0.05, -0.02, 0.0))
    assert sorted(round(math.degrees(turn)) for turn in confusable_turns(pad)) == turns_deg
    px = Renderer(PLAIN, pad).render(exposure, np.random.default_rng(5))
    truth, orientation = pad_pose(exposure, PLAIN), Orientation.of(Attitude(STAMP, exposure.R_ned_body, 1e-4 * np.eye(3)))
    for turn in confusable_turns(pad):
        assert heading_z_scores(px, PLAIN, pad, truth, [turn])[turn] > 4.0
        assert heading_z_scores(px, PLAIN, pad, truth.turned(turn), [-turn])[-turn] < -4.0
        seen = verify(FrameView(Pyramid(px), PLAIN, pad), truth.turned(turn), orientation)
        assert seen.confidence > 0.5
        off = abs((truth.R_cam_pad.inv @ seen.found.pose.R_cam_pad).rpy_rad[2])
        assert min(off, math.pi - off if seen.found.yaw_ambiguous else off) < 0.02


@pytest.mark.parametrize(
    ("name", "count"),
    [("thesis", 1), ("printed", 1), ("icao", 2), ("helideck", 2), ("h", 2), ("x", 4), ("hospital", 2), ("faa_triangle", 1)],
)
def test_headings_that_look_alike_are_counted(name: str, count: int) -> None:
    assert alike_headings(shipped_pad(name)) == count


NEST = tomllib.loads((CONFIGS / "pads" / "apriltag_nest.toml").read_text())
FIDUCIALS = ("apriltag_nest", "aruco_board")


def alter(region: int, **keys: Any) -> dict[str, Any]:
    data = copy.deepcopy(NEST)
    data["regions"][region] |= keys
    return data


def beside(**region: Any) -> dict[str, Any]:
    data = copy.deepcopy(NEST)
    data["regions"].append({"shape": "fiducial", "paint": "black", "dictionary": "DICT_APRILTAG_25h9"} | region)
    return data


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (alter(1, dictionary="apriltag_25h9"), "regions[1].dictionary 'apriltag_25h9' is none of OpenCV's aruco module"),
        (alter(1, id=35), "regions[1].id must be 0 to 34, the ids of DICT_APRILTAG_25h9, got 35"),
        (alter(1, turn_deg=45), "regions[1].turn_deg must be 0, 90, 180 or 270, got 45"),
        (alter(1, size_m=700), "regions[1].size_m must be 0.001 to 20 m, got 700.0: is it in millimetres? Write metres, 0.7"),
        (alter(1, at_m=[120, 0]), "regions[1].at_m must be at most 20 m from the centre, got (120.0, 0.0): is it in mill"),
        (alter(1, size_m=0.8), "needs a border of one cell (0.1143 m) on the panel and lacks 0.0909 m: make the panel larger"),
        (alter(2, id=1), "regions[2] is DICT_APRILTAG_25h9 1, which is there already as regions[1]: give each"),
        (alter(2, size_m=0.07), "at most 0.6 of it"),
        (alter(2, at_m=[0.0, 0.1]), "regions[1]: regions[2] reaches into the fiducial or its border of light, one"),
        (beside(id=3, size_m=0.05, at_m=[0.36, 0.0]), "reaches into the fiducial or its border of light"),
        (beside(id=0, size_m=0.04, at_m=[-0.2, 0.0], dictionary="DICT_5X5_50"), "regions[3]"),
        ({**NEST, "paints": NEST["paints"] | {"black": [240, 240, 240]}}, "of luminance darker than 'white' below it"),
        ({**NEST, "regions": NEST["regions"][1:]}, "regions[0] (fiducial) lies on the bare deck"),
        ({**NEST, "regions": [*NEST["regions"], {"shape": "disc", "paint": "white", "radius_m": 0.6}]}, 'write ground = "white"'),
        (alter(0, length_m=900), "regions[0].length_m must be 0.001 to 20 m, got 900.0: is it in millimetres?"),
    ],
)  # fmt: skip
def test_a_fiducial_that_cannot_be_read_is_refused_with_path_value_and_cure(data: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput, match=rf"\Amine\.toml: [^\n]*{re.escape(said)}[^\n]*\Z"):
        Pad.from_mapping(data, "mine.toml")


MARKERS = st.sampled_from(
    ("DICT_4X4_50", "DICT_5X5_100", "DICT_7X7_50", "DICT_APRILTAG_16h5", "DICT_APRILTAG_36h11", "DICT_ARUCO_ORIGINAL")
)


@settings(max_examples=30, deadline=None)
@given(MARKERS, st.integers(0, 29), st.sampled_from((0.0, 90.0, 180.0, 270.0)), st.floats(-0.1, 0.1))
def test_a_fiducial_is_read_by_the_detector_where_and_as_it_is_painted(name: str, number: int, turn: float, x: float) -> None:
    fiducial = PaintedFiducial("black", name, number, 0.3, (x, -0.05), turn)
    ground = {"shape": "panel", "paint": "white", "length_m": 0.8, "width_m": 0.8}
    keys = {"dictionary": name, "id": number, "size_m": 0.3, "at_m": [x, -0.05], "turn_deg": turn}
    pad = Pad.from_mapping(
        {
            "name": "one", "paints": {"white": [250, 250, 250], "black": [10, 10, 10]},
            "regions": [ground, {"shape": "fiducial", "paint": "black", **keys}],
        }
    )  # fmt: skip
    # Seen from above, 2 mm a pixel, the arrow up.
    v, u = np.meshgrid(np.arange(400), np.arange(400), indexing="ij")
    xy = np.stack([0.4 - 0.002 * (v.ravel() + 0.5), 0.002 * (u.ravel() + 0.5) - 0.4], axis=1)
    px = np.asarray(255.0 * paint_at(pad, xy, np.full(3, 0.2)).mean(axis=1), np.uint8).reshape(400, 400)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary_of(name)).detectMarkers(px)
    assert ids.ravel().tolist() == [number]
    want = np.stack([(fiducial.corners_read()[:, 1] + 0.4) / 0.002, (0.4 - fiducial.corners_read()[:, 0]) / 0.002], axis=1) - 0.5
    assert np.abs(np.asarray(corners[0])[0] - want).max() < 1.5


@pytest.mark.parametrize("name", FIDUCIALS)
def test_lines_rectangles_and_cells_of_a_fiducial_are_one_shape(name: str) -> None:
    at = np.random.default_rng(1).uniform(-0.4, 0.4, (3000, 2))
    for fiducial in shipped_pad(name).markings.fiducials:
        inside = fiducial.covers(at)
        assert np.array_equal(depth_in(fiducial, at) > 0.0, inside)
        covered = sum(
            ((at[:, 0] > x0) & (at[:, 0] < x1) & (at[:, 1] > y0) & (at[:, 1] < y1)).astype(int)
            for x0, x1, y0, y1 in rectangles_of([fiducial])
        )
        assert np.array_equal(np.asarray(covered), inside.astype(int))
        area = sum(
            0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) for x, y in (line.T for line in outlines_of(fiducial))
        )
        assert area == pytest.approx(fiducial.cells().sum() * fiducial.cell_m**2, abs=1e-6)


def tracker(pad: Pad) -> TrackerConfig:
    return TrackerConfig(PLAIN, pad, TrackerOptions(method="registration"))


def seen_from(
    pad: Pad, height_m: float, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0), noise: int = 1
) -> tuple[Sighting | None, F64]:
    """Return the sighting of a search of one frame, and the true vector from body to pad in level axes."""
    exposure = shot(height_m, (0.03, -0.02), rpy)
    px = Renderer(PLAIN, pad).render(exposure, np.random.default_rng(1))
    attitude = Attitude(STAMP, exposure.R_ned_body, 1e-6 * np.eye(3))
    seen = track(tracker(pad), TrackerMemory(), Frame(STAMP, 0, px), attitude)[0].selected
    R_level_ned = Rotation.from_rpy(0.0, 0.0, rpy[2]).inv
    return seen, R_level_ned @ (exposure.p_pad_ned - exposure.p_body_ned)


@settings(max_examples=12, deadline=None)
@given(
    st.sampled_from(FIDUCIALS),
    st.floats(math.log(0.2), math.log(7.0)),
    st.floats(-0.35, 0.35),
    st.floats(-0.35, 0.35),
    st.floats(-3.1, 3.1),
)
@seed(17)
def test_a_pad_of_fiducials_is_found_from_cold_and_measured(name, log_m, roll, pitch, yaw):
    height_m = math.exp(log_m)
    seen, true = seen_from(shipped_pad(name), height_m, (roll, pitch, yaw))
    assert seen.confidence > 0.9
    assert not seen.yaw_ambiguous
    assert abs(wrap_pi(seen.yaw_rad - (yaw - 0.7))) < math.radians(1.5)
    # The detector's own corners are 1 to 8 % off in range.
    assert float(np.linalg.norm(seen.d_body_pad_level - true)) < 2e-4 + 0.003 * height_m


@pytest.mark.parametrize("name", FIDUCIALS)
def test_a_pad_of_fiducials_is_not_seen_a_cell_aside_or_a_quarter_turn_off(name: str) -> None:
    """Most edges lie on edges again there: the cells refute it."""
    pad, exposure = shipped_pad(name), shot(2.0)
    px, pose = Renderer(PLAIN, pad).render(exposure, np.random.default_rng(4)), pad_pose(exposure, PLAIN)
    for aside_m, turn_rad in ((0.0, 0.0), (0.1, 0.0), (0.0, math.pi / 2), (0.0, math.pi)):
        start = PadPose(pose.turned(turn_rad).R_cam_pad, pose.points(np.array([[aside_m, 0.0, 0.0]]))[0])
        found = register(px, PLAIN, pad, start, None, RegistrationOptions(coarse=False))
        right = float(np.linalg.norm(found.pose.t_cam_pad - pose.t_cam_pad)) < 0.01 and turn_rad == 0.0
        assert right or (aside_m, turn_rad) != (0.0, 0.0)
        assert (cells_log_odds(px, PLAIN, pad, found) > -1.0) == right


def test_a_pad_is_not_seen_where_another_ones_fiducials_lie() -> None:
    exposure = shot(2.0)
    px = Renderer(PLAIN, shipped_pad("aruco_board")).render(exposure, np.random.default_rng(5))
    attitude = Attitude(STAMP, exposure.R_ned_body, 1e-6 * np.eye(3))
    seen = track(tracker(shipped_pad("apriltag_nest")), TrackerMemory(), Frame(STAMP, 0, px), attitude)[0].selected
    assert seen is None or seen.confidence < 0.01


def test_a_fiducial_in_a_ring_is_found_beyond_its_own_reach_by_the_ring() -> None:
    data = {
        "name": "ring", "paints": {"white": [245, 245, 245], "black": [20, 20, 20], "orange": [255, 149, 0]},
        "regions": [
            {"shape": "disc", "paint": "white", "radius_m": 0.39},
            {"shape": "ring", "paint": "orange", "inner_m": 0.30, "outer_m": 0.33},
            {"shape": "fiducial", "paint": "black", "dictionary": "DICT_4X4_50", "id": 3, "size_m": 0.27},
        ],
    }  # fmt: skip
    pad = Pad.from_mapping(data)
    assert pad.has_known_parts
    for height_m in (1.0, 3.0, 12.0):
        seen, true = seen_from(pad, height_m)
        assert seen.confidence > 0.5
        assert abs(seen.d_body_pad_level[2] - true[2]) < 0.005 * height_m


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
    "own shadow": Light(drone_shadow=0.7, sun_elevation_deg=74.5),
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
