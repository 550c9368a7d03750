"""The verification: confidence falls with every missing part, and the same scene seen in another way has the same answer."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation, Transform
from estimator.contracts.samples import Attitude, Frame
from estimator.vision import native
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detect.acquire import search
from estimator.vision.detect.alignment import SIGMA_TILT_RAD, AlignedTemplate, align
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.template import FRESH, PaintMemory, fade
from estimator.vision.detect.verification import SEARCHED, calibrate, confidence, log_odds
from estimator.vision.pad.pad import Pad
from estimator.vision.register.registration import Registration, RegistrationOptions, look, register
from estimator.vision.register.sighting import sighting_of, sighting_of_look
from sitl.camera.light import Light
from tests.support.deck_images import covered, disc_of, keeps_claim, shown
from tests.support.pad_images import STAMP, sim_camera
from tests.support.pad_scenes import CONDITIONS, load_pad, pad_scene


def align_at(px: np.ndarray, camera: Camera, pad: Pad, pose: PadPose) -> AlignedTemplate:
    aligned = align(FrameView(Pyramid(np.asarray(px, np.uint8)), camera, pad), pose, SIGMA_TILT_RAD, 0)
    assert aligned is not None
    return aligned


def test_confidence_falls_with_every_part_that_is_missing(camera: Camera, pad: Pad) -> None:
    seen = shown(camera, pad, 1.2)
    paint = (0, 95, 0)
    band = np.concatenate([disc_of(0.31), disc_of(0.31)[:1], disc_of(0.225)[:1], disc_of(0.225)[::-1]])
    images = [
        seen.px,
        covered(seen, camera, disc_of(0.2), paint),
        covered(seen, camera, band, paint),
        covered(seen, camera, disc_of(0.31), paint),
    ]
    values = [confidence(log_odds(align_at(px, camera, pad, seen.truth).features)) for px in images]
    assert values[0] > 0.9
    assert max(values[1:]) < 0.5
    shifted = PadPose(seen.truth.R_cam_pad, seen.truth.t_cam_pad + np.array([0.05, 0.0, 0.0]))
    assert confidence(log_odds(align_at(seen.px, camera, pad, shifted).features)) < 0.5


def test_features_are_finite_on_anything(camera: Camera, pad: Pad) -> None:
    rng = np.random.default_rng(1)
    shape = (camera.height, camera.width, 3)
    pose = shown(camera, pad, 1.0).truth
    for px in (np.zeros(shape), np.full(shape, 255), rng.integers(0, 256, shape)):
        values = align_at(px.astype(np.uint8), camera, pad, pose).features
        assert np.all(np.isfinite(values))
        assert confidence(log_odds(values)) < 0.2


CLOSE = RegistrationOptions(coarse=False)


FRAME = Frame(STAMP, 0, np.zeros((2, 2, 3), np.uint8))


def looked(px: NDArray[np.uint8], camera: Camera, pad: Pad, start: PadPose, R_level_body: Rotation | None) -> Registration | None:
    attitude = None if R_level_body is None else Attitude(STAMP, R_level_body, 1e-6 * np.eye(3))
    return look(FrameView(Pyramid(px), camera, pad), start, Orientation.of(attitude), CLOSE)


def test_a_look_is_a_registration_an_alignment_and_their_evidence(camera: Camera) -> None:
    """One call of the core gives what the parts give one by one."""
    rng, compared = np.random.default_rng(8), 0
    for k in range(40):
        pad = load_pad(("thesis", "printed", "icao", "h")[k % 4])
        height_m = math.exp(rng.uniform(math.log(0.25), math.log(20.0)))
        scene = pad_scene(rng, camera, pad, height_m, CONDITIONS[k % len(CONDITIONS)])
        pyramid = Pyramid(scene.px)
        found = looked(scene.px, camera, pad, scene.truth, scene.R_level_body)
        one = register(scene.px, camera, pad, scene.truth, None if found is None else found.prior, CLOSE)
        if found is None or one is None:
            continue
        compared += 1
        other = align(FrameView(pyramid, camera, pad), one.pose, SIGMA_TILT_RAD, 0)
        assert np.array_equal(found.cov, one.cov)
        assert np.array_equal(found.pose.t_cam_pad, one.pose.t_cam_pad)
        assert found.record["aligned"]["features"] == pytest.approx(other.features, abs=1e-9)
        assert found.log_odds == pytest.approx(float(found.evidence @ SEARCHED), abs=1e-9)
        level = sighting_of(FRAME, one.pose, one.cov, camera, found.prior, one.yaw_ambiguous, 0.5)
        assert np.array_equal(sighting_of_look(FRAME, found, 0.5).cov, level.cov)
    assert compared > 30


def test_evidence_that_is_no_number_is_no_pad(camera: Camera, pad: Pad, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = shown(camera, pad, 1.0)
    assert looked(seen.px, camera, pad, seen.truth, seen.R_level_body) is not None
    weights = native.SEARCHED.copy()
    weights[-1] = math.nan
    monkeypatch.setattr(native, "SEARCHED", weights)
    # The drawing that is tracked is made from the weights once: another name makes it again.
    pad = replace(pad, name="again")
    assert looked(seen.px, camera, pad, seen.truth, seen.R_level_body) is None


def test_what_is_sure_is_called_surer_and_nothing_else_is_sure() -> None:
    said = [calibrate(own) for own in np.linspace(0.0, 1.0, 1001)]
    assert said == sorted(said)
    assert said[:501] == pytest.approx(np.linspace(0.0, 0.5, 501))
    assert said[560] > 0.8
    assert 0.93 < said[620] < said[-1] <= 1.0


Teach = Callable[[PaintMemory], PaintMemory]


def view(camera: Camera, pad: Pad, light: Light, seed: int = 0) -> Teach:
    """Return what one frame makes of a memory."""
    seen = shown(camera, pad, 1.5, light=light, seed=seed)
    pyramid, orientation = Pyramid(seen.px), Orientation.of(Attitude(STAMP, seen.R_level_body, 1e-6 * np.eye(3)))

    def teach(memory: PaintMemory) -> PaintMemory:
        found = look(FrameView(pyramid, camera, pad), seen.truth, orientation, RegistrationOptions(coarse=False), paint=memory)
        return found.paint()

    return teach


def taught(frames: int, one: Teach, start: PaintMemory = FRESH) -> PaintMemory:
    for _ in range(frames):
        start = one(start)
    return start


def test_three_confident_frames_make_it_trusted_and_doubtful_ones_teach_nothing(camera: Camera, pad: Pad) -> None:
    one = view(camera, pad, Light())
    assert taught(2, one).dominance(pad) is None
    learned = taught(3, one).dominance(pad)
    disc, around = learned
    assert disc > around + 1.0, "the disc is green and the deck is not"
    assert abs(around) < 0.25


def test_without_the_pad_it_fades_back_to_knowing_nothing(camera: Camera, pad: Pad) -> None:
    memory = taught(200, view(camera, pad, Light()))
    trusts = []
    for _ in range(60):
        memory = fade(memory)
        trusts.append(memory.trust)
    assert memory is FRESH
    assert all(a >= b for a, b in itertools.pairwise(trusts))
    used = sum(t >= 0.1 for t in trusts)
    assert 20 < used < 40, "a second or so at 30 frames a second"
    assert fade(FRESH) is FRESH


@pytest.mark.parametrize("height_m", [0.4, 1.5, 6.0])
def test_a_memory_of_the_wrong_colours_hinders_nothing(camera: Camera, pad: Pad, height_m: float) -> None:
    good = taught(50, view(camera, pad, Light()))
    swapped = PaintMemory(good.mean[[3, 1, 0, 2]], good.var, good.trust)
    upside_down = PaintMemory(good.mean[:, [2, 0, 1]] + 2.0, good.var, good.trust)
    seen = shown(camera, pad, height_m, aside=(0.1, -0.1))
    for memory in (FRESH, good, swapped, upside_down):
        best = search(FrameView(Pyramid(seen.px), camera, pad), seen.R_level_body, memory).candidates[0]
        assert best.score > 0.5
        assert keeps_claim(best.pose, seen.truth, camera, pad, best.yaw_ambiguous)


TRACK = RegistrationOptions(coarse=False)
BENT = sim_camera((0.1, -0.05, 0.02), (-0.2, 0.06, 0.002, -0.001, -0.01))
ACROSS = np.diag([1.0, -1.0, 1.0])
"""Turns starboard to port: of body, level and pad."""
UPSIDE_DOWN, LEFT_RIGHT, TOP_DOWN = (np.diag([x, y, 1.0]) for x, y in ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0)))
"""Turn the camera's axes."""


class Aimed(NamedTuple):
    """A frame, the camera that took it, what is known of its attitude, and where the pad is about."""

    px: NDArray[np.uint8]
    camera: Camera
    orientation: Orientation
    start: PadPose

    def seen(self, pad: Pad) -> Registration | None:
        return look(FrameView(Pyramid(np.ascontiguousarray(self.px)), self.camera, pad), self.start, self.orientation, TRACK)


def level_numbers(level: NDArray[Any]) -> F64:
    """Return the numbers of the core's `dl_level_sighting`."""
    return np.atleast_1d(level).view(np.float64)


def mirrored(view: Aimed, in_cam: F64, in_body: F64) -> Aimed:
    """Return the view with axes of the camera, of the body and of the pad turned round: of the frame, those of the camera."""
    c = view.camera
    x, y, _ = np.diag(in_cam)
    k1, k2, p1, p2, k3 = c.distortion.tolist()
    mount = Transform(Rotation(in_body @ c.T_body_cam.R.matrix @ in_cam), in_body @ c.T_body_cam.t)
    camera = replace(
        c, cx=c.cx if x > 0 else c.width - 1 - c.cx, cy=c.cy if y > 0 else c.height - 1 - c.cy,
        distortion=np.array([k1, k2, y * p1, x * p2, k3]), T_body_cam=mount,
    )  # fmt: skip
    o, side = view.orientation, in_body[1, 1]
    cov = np.diag([side, 1.0]) @ o.cov_tilt @ np.diag([side, 1.0])
    orientation = Orientation(side * o.roll_rad, o.pitch_rad, cov, o.sigma_deck_rad, o.measured)
    start = PadPose(Rotation(in_cam @ view.start.R_cam_pad.matrix @ in_body), in_cam @ view.start.t_cam_pad)
    return Aimed(view.px[:: int(y), :: int(x)], camera, orientation, start)


def elsewhere(view: Aimed) -> Aimed:
    """Return the view in a larger frame, which goes on as its border is."""
    c = view.camera
    px = np.pad(view.px, ((32, 16), (48, 16), (0, 0)), mode="edge")
    return view._replace(px=px, camera=replace(c, width=c.width + 64, height=c.height + 48, cx=c.cx + 48, cy=c.cy + 32))


@lru_cache(maxsize=32)
def seen_at(k: int, pad_name: str) -> tuple[Pad, Aimed, Registration]:
    """Return one of some frames from 0.3 to 9 m in all conditions, half through a bent lens, and what is seen."""
    pad, camera = load_pad(pad_name), BENT if k % 2 else sim_camera()
    scene = pad_scene(np.random.default_rng(k), camera, pad, 0.3 * 1.45**k, CONDITIONS[k % len(CONDITIONS)])
    roll, pitch, _ = (scene.R_level_body or Rotation.identity()).rpy_rad
    orientation = Orientation(roll, pitch, np.array([[3e-4, 1e-4], [1e-4, 2e-4]]), 0.02, True)
    view = Aimed(scene.px, camera, orientation, scene.truth)
    found = view.seen(pad)
    assert found is not None
    return pad, view, found


def sigmas(found: Registration, other: Registration | None, in_cam: F64, in_pad: F64) -> float:
    """Return how far the pose of the other view lies from that of the first, its axes turned back, in standard deviations."""
    R = Rotation(in_cam @ other.pose.R_cam_pad.matrix @ in_pad) @ found.pose.R_cam_pad.inv
    e = np.append(in_cam @ other.pose.t_cam_pad - found.pose.t_cam_pad, R.rotvec_rad)
    return math.sqrt(e @ np.linalg.solve(found.cov, e))


@pytest.mark.parametrize("pad_name", ["thesis", "printed", "icao"])
@pytest.mark.parametrize("k", [0, 1, 2, 3, 4, 5, 6, 7, 9])
def test_a_frame_upside_down_has_the_same_pose_covariance_and_sighting(k: int, pad_name: str) -> None:
    pad, view, found = seen_at(k, pad_name)
    other = mirrored(view, UPSIDE_DOWN, np.eye(3)).seen(pad)
    assert sigmas(found, other, UPSIDE_DOWN, np.eye(3)) < 0.01
    turn = np.kron(np.eye(2), UPSIDE_DOWN)
    scale = np.sqrt(np.outer(np.diag(found.cov), np.diag(found.cov)))
    assert np.abs((turn @ other.cov @ turn - found.cov) / scale).max() < 0.01
    # Body and deck are the same, so that nothing turns in level; the words are place, rotation and their covariances.
    assert level_numbers(other.in_level) == pytest.approx(level_numbers(found.in_level), rel=0.02, abs=1e-5)
    assert (other.dense, other.yaw_ambiguous) == (found.dense, found.yaw_ambiguous)
    for kind, edges in found.edges.items():
        assert other.edges[kind].inliers == pytest.approx(edges.inliers, abs=2e-3)
    if view.start.px_of(pad.disc_radius_m, view.camera) < 0.3 * view.camera.height:
        assert other.evidence == pytest.approx(found.evidence, abs=1e-3)
        assert other.log_odds == pytest.approx(found.log_odds, abs=2e-3)


@pytest.mark.parametrize("pad_name", ["thesis", "printed", "icao"])
@pytest.mark.parametrize(("in_cam", "k"), [(LEFT_RIGHT, 9), (TOP_DOWN, 9), (LEFT_RIGHT, 10), (TOP_DOWN, 10)])
def test_a_distant_pad_in_a_mirror_has_the_mirrored_pose(k: int, pad_name: str, in_cam: F64) -> None:
    # Left and right of the arrow, the drawing is its own mirror image. The places near by where edges are sampled are not.
    pad, view, found = seen_at(k, pad_name)
    other = mirrored(view, in_cam, ACROSS).seen(pad)
    assert sigmas(found, other, in_cam, ACROSS) < 0.05
    assert other.evidence == pytest.approx(found.evidence, abs=2e-3)
    across = np.array([1.0, -1.0, 1.0])
    assert level_numbers(other.in_level)[:3] * across == pytest.approx(level_numbers(found.in_level)[:3], abs=1e-4)


@pytest.mark.parametrize("pad_name", ["thesis", "printed", "icao"])
@pytest.mark.parametrize("k", [7, 9])
def test_a_pad_elsewhere_in_a_larger_frame_is_the_same_pad(k: int, pad_name: str) -> None:
    pad, view, found = seen_at(k, pad_name)
    other = elsewhere(view).seen(pad)
    assert sigmas(found, other, np.eye(3), np.eye(3)) < 1e-9
    assert other.evidence == pytest.approx(found.evidence, abs=1e-9)
