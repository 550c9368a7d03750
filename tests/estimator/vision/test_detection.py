"""One look: what is chosen, what is none, and that neither tilt nor the mount nor the light deceives it.

Cues that agree are fused without false certainty, one that does not is left out, none moves the result by a step.
"""

import csv
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, Method, Sighting
from estimator.contracts.geometry import Rotation, wrap_pi
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera import Camera
from estimator.vision.detection import fuse
from estimator.vision.pad import Pad
from estimator.vision.thesis.detection import choose, detect, with_heading_of
from estimator.vision.thesis.segmentation import COLOUR_SETS, INDOOR, SIMULATOR, HsvRange, segment
from tests.support.pad_images import STAMP, PadPlacement, errors, image, sim_camera
from tests.support.shipped import shipped_camera, shipped_pad

DATA = Path(__file__).parents[3] / "../shared/data"


def test_each_height_has_its_method(camera: Camera, pad: Pad) -> None:
    chosen = []
    for height_m in (0.4, 1.5, 8.0):
        scene = PadPlacement((0.15, 0.0, height_m), 0.5)
        seen = detect(image(scene, camera, pad, blur_px=0.6, noise=1.5), scene.attitude(), camera, pad, SIMULATOR)
        chosen.append(seen.chosen)
        assert seen.selected is not None
        assert seen.selected.method == "selected"
        assert np.linalg.norm(errors(seen.selected, scene)[0]) < 0.004 * height_m
    assert chosen == ["corners", "arrow", "ellipse"]


def test_from_a_hand_above_the_deck_to_thirty_metres(camera: Camera, pad: Pad) -> None:
    for height_m in (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0):
        scene = PadPlacement((0.15, 0.02, height_m), -1.1)
        seen = detect(image(scene, camera, pad, blur_px=0.6, noise=1.5), scene.attitude(), camera, pad, SIMULATOR)
        assert seen.selected is not None, height_m
        d = errors(seen.selected, scene)[0]
        assert np.linalg.norm(d[:2]) < 0.002 * height_m
        assert abs(d[2]) < (0.005 if height_m <= 10.0 else 0.05) * height_m


@pytest.mark.parametrize("method", ["ellipse", "arrow", "corners"])
def test_tilt_and_forward_offset_are_put_in(method: Method, pad: Pad) -> None:
    """Rolled and pitched by 8 degrees, with the camera 15 cm ahead: taken as level the pad would be a third of a metre off."""
    camera = sim_camera((0.15, 0.0, 0.04))
    scene = PadPlacement((0.4, -0.25, 1.7), 0.8, math.radians(8.0), math.radians(8.0))
    frame = image(scene, camera, pad, blur_px=0.6)
    s = detect(frame, scene.attitude(), camera, pad, SIMULATOR).methods[method]
    assert s is not None
    assert np.linalg.norm(errors(s, scene)[0]) < 0.01
    level = detect(frame, None, camera, pad, SIMULATOR).methods[method]
    assert level is not None
    off = errors(level, scene)[0]
    assert np.linalg.norm(off) > 0.3
    # What was not known is said: the error lies within four sigmas.
    assert off @ np.linalg.solve(level.cov[:3, :3], off) < 16.0


def test_the_covariance_holds_over_many_frames(camera: Camera, pad: Pad) -> None:
    """Images with noise, an attitude with error, a deck that is not level: no method claims more than it knows."""
    rng = np.random.default_rng(7)
    sigma_tilt, sigma_deck = math.radians(0.3), math.radians(1.0)
    nees: dict[str, list[float]] = {"ellipse": [], "arrow": [], "corners": []}
    for i in range(24):
        z = float(rng.uniform(0.9, 2.2))
        at = (0.15 + rng.uniform(-0.1, 0.1) * z, rng.uniform(-0.1, 0.1) * z, z)
        scene = PadPlacement(at, rng.uniform(-3, 3), *rng.normal(0, 0.05, 2), *rng.normal(0, sigma_deck, 2))
        reported = Rotation.from_rpy(scene.roll_rad, scene.pitch_rad, 0.0) @ Rotation.from_rotvec(rng.normal(0, sigma_tilt, 3))
        attitude = Attitude(STAMP, reported, np.eye(3) * sigma_tilt**2)
        frame = image(scene, camera, pad, samples=3, blur_px=0.6, noise=2.0, seed=i)
        seen = detect(frame, attitude, camera, pad, SIMULATOR, sigma_deck_rad=sigma_deck)
        for name, values in nees.items():
            s = seen.methods[name]  # type: ignore[index]
            if s is not None:
                d, _ = errors(s, scene)
                values.append(float(d @ np.linalg.solve(s.cov[:3, :3], d)))
    for name, values in nees.items():
        assert len(values) >= 10, name
        # Mean of n chi-square(3) divided by n: 99.9 % lie below this for n = 10; a cautious covariance lies below 3.
        assert np.mean(values) < 6.0, name
        assert np.mean(values) > 0.2, name


def test_an_empty_image_is_no_estimate() -> None:
    camera, pad = sim_camera(), shipped_pad("thesis")
    for grey in (0, 90, 255):
        frame = Frame(STAMP, 0, np.full((360, 640, 3), grey, np.uint8))
        for colours in COLOUR_SETS.values():
            seen = detect(frame, None, camera, pad, colours)
            assert seen.selected is None
            assert seen.chosen is None
            assert set(seen.methods.values()) == {None}


def test_noise_and_one_colour_raise_nothing() -> None:
    camera, pad = sim_camera(), shipped_pad("thesis")
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (360, 640, 3), dtype=np.uint8) for _ in range(3)]
    images += [np.full((360, 640, 3), paint, np.uint8) for paint in ((0, 102, 0), (0, 149, 255))]
    half = np.zeros((360, 640, 3), np.uint8)
    half[:180] = (0, 102, 0)
    for px in [*images, half]:
        for colours in COLOUR_SETS.values():
            assert detect(Frame(STAMP, 0, px), None, camera, pad, colours).selected is None


def test_green_things_elsewhere_are_not_the_pad(camera: Camera, pad: Pad) -> None:
    """A large green sheet and a green box beside the pad: the blob with ring and H is taken."""
    scene = PadPlacement((0.15, -0.35, 2.0), 0.3)
    px = image(scene, camera, pad).px.copy()
    px[0:150, 430:640] = (0, 102, 0)
    px[250:330, 480:560] = (0, 102, 0)
    seen = detect(Frame(STAMP, 0, px), scene.attitude(), camera, pad, SIMULATOR)
    assert seen.chosen == "arrow"
    assert seen.selected is not None
    assert np.linalg.norm(errors(seen.selected, scene)[0]) < 0.01


def test_the_edge_of_a_shadow_across_the_h_moves_little(camera: Camera, pad: Pad) -> None:
    """Half of the light gone on one side: half of the paint is then another grey there, and the darker side weighs no less."""
    scene = PadPlacement((0.16, 0.01, 0.8), 0.5)
    px = image(scene, camera, pad, blur_px=0.6).px.copy()
    shade = np.triu(np.ones((360, 640)), 140) > 0
    px[shade] = np.rint(px[shade] * 0.74).astype(np.uint8)
    seen = detect(Frame(STAMP, 0, px), scene.attitude(), camera, pad, SIMULATOR)
    methods: tuple[Method, ...] = ("arrow", "corners")
    for name in methods:
        s = seen.methods[name]
        assert s is not None
        d, yaw = errors(s, scene)
        assert np.linalg.norm(d) < 0.002
        assert abs(math.degrees(yaw)) < 0.2


def test_an_image_of_another_size_is_refused(camera: Camera, pad: Pad) -> None:
    with pytest.raises(ValueError, match="320x180 px, the camera's are 640x360"):
        detect(Frame(STAMP, 0, np.zeros((180, 320, 3), np.uint8)), None, camera, pad, SIMULATOR)


def sighting(method: Method, yaw_rad: float | None = 0.0, ambiguous: bool = False) -> Sighting:
    return Sighting(STAMP, 0, method, np.array([0.0, 0.0, 1.0]), yaw_rad, ambiguous, np.eye(4), 0.5)


def test_priorities_of_the_thesis() -> None:
    e, a, c = sighting("ellipse"), sighting("arrow"), sighting("corners")
    for cut, methods, expected in (
        (True, {"ellipse": None, "arrow": a, "corners": c}, "corners"),
        (False, {"ellipse": e, "arrow": a, "corners": c}, "arrow"),
        (False, {"ellipse": e, "arrow": None, "corners": None}, "ellipse"),
        (True, {"ellipse": None, "arrow": a, "corners": None}, "arrow"),
        (False, {"ellipse": None, "arrow": None, "corners": c}, "corners"),
        (True, {"ellipse": None, "arrow": None, "corners": None}, None),
    ):
        assert choose(methods, cut) == expected  # type: ignore[arg-type]


def test_an_arrow_settles_which_way_round_the_h_is() -> None:
    settled = with_heading_of(sighting("corners", 0.2, True), sighting("arrow", wrap_pi(0.21 + math.pi)))
    assert settled.yaw_rad == pytest.approx(0.2 - math.pi)
    assert not settled.yaw_ambiguous
    unsettled = with_heading_of(sighting("corners", 0.2, True), sighting("arrow", 0.2 + math.pi / 2))
    assert unsettled.yaw_ambiguous
    assert with_heading_of(sighting("corners", 0.2, True), None).yaw_rad == 0.2


def test_limits_of_the_thesis_in_whole_numbers() -> None:
    assert SIMULATOR.green == HsvRange((52, 217, 38), (68, 255, 153))
    px = np.zeros((60, 60, 3), np.uint8)
    assert segment(px, INDOOR) is None
    one = cv2.cvtColor(np.array([[[52, 217, 38], [51, 217, 38], [68, 255, 154]]], np.uint8), cv2.COLOR_HSV2BGR)
    assert one.shape == (1, 3, 3)
    inside = SIMULATOR.green.mask(np.array([[[52, 217, 38], [68, 255, 153], [51, 217, 38], [68, 255, 154]]], np.uint8))
    assert inside.tolist() == [[255, 255, 0, 0]]
    with pytest.raises(ValueError, match="HSV range"):
        HsvRange((10, 0, 0), (5, 255, 255))


@pytest.mark.skipif(not (DATA / "pad_photos").is_dir(), reason="the photographs of the pad are not here")
def test_photographs_of_the_real_pad() -> None:
    """The limits are the thesis' own for indoors. Its code: 81 % found, 32 % of range off in the median."""
    camera, pad = shipped_camera("photos"), shipped_pad("printed")
    with (DATA / "pad_photos" / "pose.csv").open() as text:
        rows = list(csv.DictReader(text))[::3]
    off = []
    for row in rows:
        R = Rotation.from_rotvec([float(row[f"rvec_{k}"]) for k in "xyz"])
        t = np.array([float(row[f"t_cam_{k}_m"]) for k in "xyz"])
        roll, pitch, _ = (R.inv @ camera.T_body_cam.R.inv).rpy_rad
        R_level_body = Rotation.from_rpy(roll, pitch, 0.0)
        px = np.asarray(cv2.imread(str(DATA / "pad_photos" / "images" / row["frame"])), np.uint8)
        attitude = Attitude(STAMP, R_level_body, np.eye(3) * math.radians(0.3) ** 2)
        s = detect(Frame(STAMP, 0, px), attitude, camera, pad, INDOOR).selected
        if s is not None:
            true = (R_level_body @ camera.T_body_cam.R) @ t
            off.append(float(np.linalg.norm(s.d_body_pad_level - true) / np.linalg.norm(true)))
    assert len(off) >= 0.88 * len(rows)
    assert np.median(off) < 0.008
    assert np.percentile(off, 95) < 0.04


@pytest.mark.skipif(not (DATA / "not_pads").is_dir(), reason="the images without a pad are not here")
def test_what_is_no_pad_is_none() -> None:
    """Grass, other helipads, tags, a white H on orange, the sea: nothing in any of them by any set of limits."""
    pad = shipped_pad("printed")
    for file in sorted([*(DATA / "not_pads").iterdir(), *(DATA / "sea").iterdir()])[::2]:
        px = cv2.imread(str(file))
        if px is None:
            continue
        h, w = px.shape[:2]
        if w > 1000:
            px = cv2.resize(px, (w // 2, h // 2), interpolation=cv2.INTER_AREA)
            h, w = px.shape[:2]
        camera = Camera(w, h, 0.6 * w, 0.6 * w, (w - 1) / 2, (h - 1) / 2, np.zeros(5), sim_camera().T_body_cam)
        for colours in COLOUR_SETS.values():
            assert detect(Frame(STAMP, 0, np.asarray(px, np.uint8)), None, camera, pad, colours).selected is None, file.name


NOW = Stamp(MonoNs(0), MonoNs(0), 0.001, "sim")
TRUTH = np.array([0.4, -0.3, 2.0])


def cue(
    method: Method, sigma_m: float, offset: tuple[float, float, float] = (0, 0, 0), yaw: float | None = 0.5,
    ambiguous: bool = False, sigma_yaw: float = 0.01, confidence: float = 0.9,
) -> Sighting:  # fmt: skip
    cov = np.diag([sigma_m**2, sigma_m**2, (2 * sigma_m) ** 2, UNKNOWN_YAW_VAR if yaw is None else sigma_yaw**2])
    return Sighting(NOW, 1, method, TRUTH + np.array(offset), yaw, ambiguous, cov, confidence)


def test_nothing_from_nothing_and_one_from_one() -> None:
    assert fuse([]) is None
    only = cue("arrow", 0.01)
    fused = fuse([only])
    assert fused is not None
    assert np.allclose(fused.sighting.d_body_pad_level, only.d_body_pad_level)
    assert np.allclose(fused.sighting.cov, only.cov)
    assert fused.sighting.yaw_rad == pytest.approx(only.yaw_rad)
    assert fused.sighting.method == "fused"


@settings(max_examples=100)
@given(sigmas=st.lists(st.floats(1e-4, 0.1), min_size=2, max_size=4), shared=st.floats(-2, 2), seed=st.integers(0, 10**6))
def test_the_covariance_holds_even_for_cues_that_err_together(sigmas: list[float], shared: float, seed: int) -> None:
    """Every cue errs by the same number of its own sigmas: the fused error must not exceed that number of the fused sigma."""
    methods: list[Method] = ["registration", "ellipse", "arrow", "corners"]
    fused = fuse([cue(m, s, (shared * s, 0, 0)) for m, s in zip(methods, sigmas, strict=False)])
    assert fused is not None
    assert fused.outliers == ()
    error = abs(fused.sighting.d_body_pad_level[0] - TRUTH[0])
    assert error <= abs(shared) * math.sqrt(fused.sighting.cov[0, 0]) + 1e-12
    assert fused.sighting.cov[0, 0] >= min(sigmas) ** 2 * (1 - 1e-9)
    assert np.linalg.eigvalsh(fused.sighting.cov).min() > 0


@pytest.mark.parametrize("wrong", ["registration", "ellipse", "arrow", "corners"])
def test_the_odd_one_out_is_left_out(wrong: str) -> None:
    methods: tuple[Method, ...] = ("registration", "ellipse", "arrow", "corners")
    cues = [cue(m, 0.01, (0.5, 0, 0) if m == wrong else (0, 0, 0)) for m in methods]
    fused = fuse(cues)
    assert fused is not None
    assert fused.outliers == (wrong,)
    assert np.allclose(fused.sighting.d_body_pad_level, TRUTH, atol=1e-9)
    assert fused.sighting.confidence < 0.9


@settings(max_examples=100)
@given(st.lists(st.floats(0.0005, 0.01), min_size=2, max_size=4), st.integers(0, 10**6))
def test_a_cue_that_comes_or_goes_moves_the_result_less_than_three_centimetres(sigmas: list[float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    methods: list[Method] = ["registration", "ellipse", "arrow", "corners"]
    cues = [cue(m, s, tuple(rng.normal(0, s, 3).clip(-2 * s, 2 * s))) for m, s in zip(methods, sigmas, strict=False)]
    cues.sort(key=lambda c: float(c.cov[0, 0]))
    whole = fuse(cues)
    without = fuse(cues[:-1])
    assert whole is not None
    assert without is not None
    assert np.linalg.norm(whole.sighting.d_body_pad_level - without.sighting.d_body_pad_level) < 0.03


@settings(max_examples=100)
@given(yaw=st.floats(-math.pi, math.pi), flipped=st.booleans())
def test_an_ambiguous_heading_follows_the_sure_one(yaw: float, flipped: bool) -> None:
    other = math.remainder(yaw + (math.pi if flipped else 0.0), math.tau)
    alone = fuse([cue("corners", 0.002, yaw=other, ambiguous=True)])
    assert alone is not None
    assert alone.sighting.yaw_ambiguous
    both = fuse([cue("corners", 0.002, yaw=other, ambiguous=True), cue("arrow", 0.01, yaw=yaw)])
    assert both is not None
    assert both.outliers == ()
    assert not both.sighting.yaw_ambiguous
    assert both.sighting.yaw_rad is not None
    assert abs(math.remainder(both.sighting.yaw_rad - yaw, math.tau)) < 1e-6


def test_a_heading_nobody_reports_stays_unknown() -> None:
    fused = fuse([cue("ellipse", 0.01, yaw=None), cue("registration", 0.005, yaw=None)])
    assert fused is not None
    assert fused.sighting.yaw_rad is None
    assert fused.sighting.cov[3, 3] == UNKNOWN_YAW_VAR
    one = fuse([cue("ellipse", 0.01, yaw=None), cue("arrow", 0.02)])
    assert one is not None
    assert one.sighting.yaw_rad == pytest.approx(0.5)
