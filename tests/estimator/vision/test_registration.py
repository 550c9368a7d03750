"""Registration: accuracy, covariance that holds, blur, occlusion, codecs, photographs, and whatever surrounds the pad."""

import csv
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import chdtri

from drivers.ardrone.pave import unit_decoder
from estimator.contracts.estimates import UNKNOWN_YAW_VAR
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Frame
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.pad.drawing import EdgeKind
from estimator.vision.pad.pad import Pad
from estimator.vision.register.registration import Registration, RegistrationOptions, register
from estimator.vision.register.sighting import sighting_of
from estimator.vision.register.verified import CODED_PX
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import I16, U16, Light, Sensor
from sitl.camera.projection import F32
from sitl.camera.render.deck import Tile
from sitl.camera.surroundings import Deck, Surroundings
from sitl.emulators.ardrone.wire_pictures import Encoder
from sitl.sea.sea import SEA_STATES, Waves
from tests.support.pad_images import STAMP
from tests.support.pad_scenes import DATA, photographs, truth_of
from tests.support.pad_views import PLAIN, RenderedView, Stage, error, pad_error
from tests.support.plain_light import FLAT
from tests.support.shipped import shipped_camera, shipped_pad

SURROUNDINGS = ("even", "patchy", "wet", "edge of the deck", "asphalt", "sea")
SIGMA_ATTITUDE_RAD, SIGMA_DECK_RAD = math.radians(0.5), math.radians(1.0)
_EDGES_M = (0.48, 0.62)
"""Distances of the deck's edge from the pad's centre; the disc ends at 0.39 m."""
_TILE_M = 1.15
"""Half of the length after which wear repeats itself."""
_STONE_M, _STONES, _STAINS = 0.008, 0.55, 0.15
"""Size of asphalt's stones, and standard deviations of its light over their size and over patches of decimetres: five photographs
of asphalt have 0.47 to 0.65 of the mean light from pixel to pixel and 0.10 to 0.29 in squares of 64 pixels, some two stones wide.
"""


@dataclass(frozen=True, eq=False)
class SurroundedView:
    """One frame, what is true of it, and what a vehicle would know beside it."""

    px: NDArray[np.uint8]
    truth: PadPose
    prior: Orientation
    """The attitude with its errors."""
    start: PadPose
    """The truth, half a pixel off in place, size and heading at one sigma."""


class _Asphalt(Renderer):
    """Draws asphalt in place of the deck; the pad on it is what it was."""

    around_from_pad: F64
    """Homography (3, 3) from the pad's plane to the asphalt's."""

    def _scenery(self, shot: Exposure, R_cam_pad: F64, t_cam_pad: F64) -> tuple[U16, I16, F32 | None]:
        scene, gain, added = super()._scenery(shot, R_cam_pad, t_cam_pad)
        plane = self._lens.plane_from_ray(np.stack([R_cam_pad[:, 0], R_cam_pad[:, 1], t_cam_pad], axis=1))
        if plane is not None:
            plane = self.around_from_pad @ plane
            whole = slice(0, self.camera.height), slice(0, self.camera.width)
            places, px_m = self._lens.meet(plane, whole), float(R_cam_pad[:, 2] @ t_cam_pad) / self.camera.fx
            light = 1.0 + _STONES * _STONE_TILE.read(places, px_m) + _STAINS * _STAIN_TILE.read(places, px_m)
            scene = np.round(np.clip(scene[..., :3] * light[..., None], 0.0, 60000.0)).astype(np.uint16)
            scene = np.concatenate([scene, self._scene[..., 3:]], axis=-1)
        return scene, gain, added


def _noise_tile(seed: int, texel_m: float) -> Tile:
    texels = np.random.default_rng([seed, 0xA5F]).standard_normal((512, 512))
    return Tile(np.asarray(np.clip(texels, -1.7, 2.5), np.float32), 512 * texel_m)


_STONE_TILE, _STAIN_TILE = _noise_tile(1, _STONE_M), _noise_tile(2, 0.2)


def _light(rng: np.random.Generator, wetness: float = 0.0, wear: float = 0.06) -> Light:
    return Light(
        sun_elevation_deg=math.degrees(rng.uniform(0.5, 1.5)), sun_azimuth_deg=math.degrees(rng.uniform(0.0, math.tau)),
        drone_shadow=0.0, wetness=wetness, wear=wear,
    )  # fmt: skip


def _moved(rng: np.random.Generator, turn_rad: float, most_m: tuple[float, float]) -> F64:
    """Return a homography (3, 3) from the pad's plane to another place on what lies around it."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    x, y = (float(rng.uniform(-most, most)) for most in most_m)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def _somewhere(renderer: Renderer, deck_from_pad: F64) -> Renderer:
    """Put the pad elsewhere on the deck: decks are drawn once, and their wear would be the same on all pads."""
    deck = renderer._deck
    deck._R_deck_pad = deck_from_pad
    deck.rim_pad = (deck._rim - [*deck_from_pad[:2, 2], 0.0]) @ np.block(
        [[deck_from_pad[:2, :2], np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]]
    )
    return renderer


def _renderer(rng: np.random.Generator, camera: Camera, pad: Pad, name: str) -> Renderer:
    """Return what draws a pad in these surroundings; where deck edge, sun, wear and puddles lie is drawn by chance."""
    sensor = Sensor(0.0, float(rng.uniform(0.5, 0.9)))
    deck = Deck(26.0, 20.0, seed=int(rng.integers(2)))
    if name == "even":
        return Renderer(camera, pad, PLAIN, FLAT, sensor)
    if name == "asphalt":
        floor = Surroundings(Deck(26.0, 20.0, paint=(128, 126, 126), seed=1))
        asphalt = _Asphalt(camera, pad, floor, _light(rng), sensor)
        asphalt.around_from_pad = _moved(rng, float(rng.uniform(0.0, math.tau)), (50.0, 50.0))
        return _somewhere(asphalt, _moved(rng, float(rng.uniform(0.0, math.tau)), (_TILE_M, _TILE_M)))
    if name == "sea":
        waves = Waves.draw(SEA_STATES[int(rng.integers(2, 6))], int(rng.integers(6)))
        return Renderer(camera, pad, Surroundings(None, waves), _light(rng, wear=0.0), sensor)
    if name == "edge of the deck":
        edge_m, side = float(rng.choice(_EDGES_M)), float(rng.choice([-1.0, 1.0]))
        waves = Waves.draw(SEA_STATES[3], int(rng.integers(6)))
        deck = Deck(8.0, 3.0, (0.0, side * (1.5 - edge_m)))
        return _somewhere(Renderer(camera, pad, Surroundings(deck, waves), _light(rng), sensor), _moved(rng, 0.0, (_TILE_M, 0.0)))
    light = {"patchy": _light(rng, wear=0.10), "wet": _light(rng, wetness=float(rng.uniform(0.4, 1.0)))}[name]
    renderer = Renderer(camera, pad, Surroundings(deck), light, sensor)
    return _somewhere(renderer, _moved(rng, float(rng.uniform(0.0, math.tau)), (_TILE_M, _TILE_M)))


def _off(rng: np.random.Generator, camera: Camera, pad: Pad, truth: PadPose, off_px: float) -> PadPose:
    t = truth.t_cam_pad
    m_per_px, reach = float(t[2]) / camera.fx, min(pad.disc_radius_m, 0.6 * float(t[2]))
    aside = np.array([*rng.normal(0.0, off_px, 2), 0.0]) * m_per_px
    nearer, turn = rng.normal(0.0, off_px, 2) * m_per_px / reach
    return PadPose(truth.R_cam_pad @ Rotation.from_rpy(0.0, 0.0, float(turn)), t * (1.0 + nearer) + aside)


def surrounded_view(
    rng: np.random.Generator, camera: Camera, pad: Pad, name: str, height_m: float, tilt_rad: float
) -> SurroundedView:
    """Return a view of the pad, which lies in the middle half of the frame.

    Args:
        name: one of `SURROUNDINGS`.
        height_m: of the camera over the pad's plane.
        tilt_rad: of the vehicle, to any side.
    """
    renderer, way = _renderer(rng, camera, pad, name), float(rng.uniform(0.0, math.tau))
    tilt = Rotation.from_rotvec([tilt_rad * math.cos(way), tilt_rad * math.sin(way), 0.0])
    R_ned_body = Rotation.from_rpy(0.0, 0.0, float(rng.uniform(-math.pi, math.pi))) @ tilt
    deck_roll, deck_pitch = rng.normal(0.0, SIGMA_DECK_RAD, 2).tolist()
    R_ned_pad = Rotation.from_rpy(deck_roll, deck_pitch, float(rng.uniform(-math.pi, math.pi)))
    mount = camera.T_body_cam
    R_ned_cam = R_ned_body @ mount.R
    n = R_ned_cam.matrix.T @ R_ned_pad.matrix[:, 2]
    at = rng.uniform(0.3, 0.7, 2) if height_m > 1.0 else rng.uniform(0.42, 0.58, 2)
    ray = np.append(camera.rays(at[None] * [camera.width, camera.height])[0], 1.0)
    p_pad = np.array([*rng.uniform(-20.0, 20.0, 2), -0.6])
    p_body = p_pad - R_ned_cam @ (ray * (height_m / (ray @ n))) - R_ned_body @ mount.t
    shot = Exposure(float(rng.uniform(0.0, 100.0)), R_ned_body, p_body, R_ned_pad, p_pad)
    px, truth = renderer.render(shot, rng), truth_of(shot, camera)
    level = R_ned_body.without_heading()
    roll, pitch, _ = level.rpy_rad
    off = rng.normal(0.0, SIGMA_ATTITUDE_RAD, 2)
    prior = Orientation(roll + float(off[0]), pitch + float(off[1]), np.eye(2) * SIGMA_ATTITUDE_RAD**2, SIGMA_DECK_RAD, True)
    return SurroundedView(px, truth, prior, _off(rng, camera, pad, truth, 0.5))


TRACK = RegistrationOptions(coarse=False)


def nees(found: Registration, view: RenderedView) -> float:
    e = error(found.pose, view.pose)
    return float(e @ np.linalg.solve(found.cov, e))


@pytest.mark.parametrize(
    ("height_m", "lateral_mm", "range_mm", "bias_mm", "heading_deg"),
    [(0.3, 0.03, 0.05, 0.05, 0.01), (1.0, 0.05, 0.1, 0.2, 0.02), (5.0, 0.15, 2.0, 2.0, 0.1), (10.0, 0.5, 10.0, 8.0, 0.4)],
)
def test_accuracy_and_covariance(camera, pad, height_m, lateral_mm, range_mm, bias_mm, heading_deg):
    stage = Stage(camera, pad)
    off, turn, squares = [], [], []
    for _ in range(24):
        view = stage.view(height_m)
        found = register(view.px, camera, pad, stage.start(view, 0.5), view.orientation(), TRACK)
        d, angle = pad_error(found.pose, view.pose)
        off.append(d * 1e3)
        turn.append(math.degrees(angle))
        squares.append(nees(found, view))
    std, mean = np.std(off, axis=0), np.mean(off, axis=0)
    assert std[:2].max() < lateral_mm
    assert std[2] < range_mm
    assert abs(mean[2]) < bias_mm
    assert float(np.std(turn)) < heading_deg
    # Never overconfident; the floor under edges' places makes it modest where noise hardly matters.
    assert 0.4 < float(np.mean(squares)) < chdtri(6 * len(squares), 0.001) / len(squares)


@pytest.mark.parametrize("height_m", [20.0, 30.0])
def test_the_distant_disc(camera: Camera, pad: Pad, height_m: float) -> None:
    stage = Stage(camera, pad)
    squares, away = [], []
    for _ in range(20):
        view = stage.view(height_m)
        found = register(view.px, camera, pad, stage.start(view, 0.3), view.orientation(), TRACK)
        squares.append(nees(found, view))
        away.append(error(found.pose, view.pose)[2] / height_m)
    assert float(np.mean(squares)) < 14.0
    assert abs(float(np.mean(away))) < 0.01
    assert float(np.std(away)) < 0.012


@pytest.mark.parametrize("height_m", [1.0, 3.0, 6.0])
def test_blur_does_not_bias_range(camera: Camera, pad: Pad, height_m: float) -> None:
    for blur_px in (0.3, 1.0, 2.0, 3.0):
        stage = Stage(camera, pad, sensor=Sensor(exposure_s=0.0, psf_sigma_px=blur_px))
        away, blur = [], []
        for _ in range(5):
            view = stage.view(height_m)
            found = register(view.px, camera, pad, stage.start(view, 0.3), view.orientation(), TRACK)
            away.append(pad_error(found.pose, view.pose)[0][2] / height_m)
            blur.append(found.blur_px)
        # A hundredth of a pixel in the disc's radius, or less.
        assert abs(float(np.mean(away))) < (4e-4 if blur_px < 3.0 else 1.2e-3), f"blur {blur_px} px"
        if blur_px > 0.5:
            assert float(np.mean(blur)) == pytest.approx(blur_px, rel=0.08)


def test_motion_blur_is_seen_in_its_direction(camera: Camera, pad: Pad) -> None:
    stage = Stage(camera, pad, sensor=Sensor(exposure_s=0.02))
    view = stage.view(2.0, tilt_rad=0.0, yaw_rad=0.0, v_body_ned=(0.0, 1.0, 0.0))
    found = register(view.px, camera, pad, stage.start(view, 0.5), view.orientation(), TRACK)
    travel_px = 1.0 * 0.02 * camera.fx / 2.0
    # The nose is at the top of the frame, so flying to the right smears along u; a box of that length has this variance.
    assert found.blur_px2[0] - found.blur_px2[2] == pytest.approx(travel_px**2 / 12.0, rel=0.3)
    assert np.abs(pad_error(found.pose, view.pose)[0]).max() < 1e-3


def test_a_tilted_deck_is_measured(camera: Camera, pad: Pad) -> None:
    stage = Stage(camera, pad)
    for _ in range(6):
        view = stage.view(2.0, deck_rad=math.radians(3.0))
        # Attitude known, deck taken as level to 4 degrees.
        prior = view.orientation(math.radians(0.05), math.radians(4.0))
        found = register(view.px, camera, pad, stage.start(view, 0.5), prior, TRACK)
        assert math.degrees(np.abs(error(found.pose, view.pose)[3:]).max()) < 0.2
        assert nees(found, view) < chdtri(6, 0.0001)


def half_hidden(view: RenderedView, pad: Pad, camera: Camera, towards_rad: float) -> NDArray[np.uint8]:
    """Return a grey tarpaulin over one half of the pad, its edge through a point beside the centre."""
    out = np.array([math.cos(towards_rad), math.sin(towards_rad)])
    side = np.array([-out[1], out[0]])
    corners = np.array([0.03 * out + side, 0.03 * out - side, 1.5 * out - side, 1.5 * out + side])
    uv = camera.project(view.pose.points(np.c_[corners, np.zeros(4)]))
    px = view.px.copy()
    cv2.fillPoly(px, [np.round(uv * 16).astype(np.int32)], (90, 90, 90), cv2.LINE_AA, 4)
    return px


@pytest.mark.parametrize("height_m", [0.8, 3.0, 6.0, 10.0, 14.0])
def test_half_of_the_pad_hidden(camera: Camera, pad: Pad, height_m: float) -> None:
    """Half a distant disc, whose edges merge, looks like a smaller one, and the covariance includes it."""
    stage = Stage(camera, pad)
    for n in range(6):
        view = stage.view(height_m, lateral=0.02)
        px = half_hidden(view, pad, camera, n * math.tau / 6)
        found = register(px, camera, pad, stage.start(view, 0.5), view.orientation(), TRACK)
        if found.dense:
            assert nees(found, view) < chdtri(6, 0.0001)
            assert found.inliers < 0.6
            continue
        d, _ = pad_error(found.pose, view.pose)
        assert np.abs(d[:2]).max() < 2e-3 * max(1.0, height_m / 3)
        assert abs(d[2]) < 6e-3 * height_m
        assert found.inliers < 0.9


@pytest.mark.parametrize("height_m", [10.0, 15.0, 20.0])
def test_a_reflection_on_the_distant_pad_moves_it_less_than_half_a_pixel(camera: Camera, pad: Pad, height_m: float) -> None:
    for n in range(6):
        a = n * math.tau / 6
        light = Light(glare=0.4 + 0.15 * n, glare_centre_m=(0.2 * math.cos(a), 0.2 * math.sin(a)))
        stage = Stage(camera, pad, light=light, seed=n)
        view = stage.view(height_m, lateral=0.02)
        found = register(view.px, camera, pad, stage.start(view, 0.4), view.orientation(), TRACK)
        d, _ = pad_error(found.pose, view.pose)
        assert np.hypot(*d[:2]) < 0.5 * height_m / camera.fx
        assert abs(d[2]) < 0.08 * height_m


def test_what_the_edges_do_not_fix_is_uncertain(camera: Camera, pad: Pad) -> None:
    stage = Stage(camera, pad)
    view = stage.view(1.0, lateral=0.0)
    # Nothing but the disc: its heading could be anything.
    px = view.px.copy()
    uv = camera.project(view.pose.points(pad.circle(0.33)))
    cv2.fillPoly(px, [np.round(uv * 16).astype(np.int32)], (0, 102, 0), cv2.LINE_AA, 4)
    found = register(px, camera, pad, view.pose, view.orientation(), TRACK)
    assert found.yaw_ambiguous
    R = found.pose.R_cam_pad.matrix
    var = np.diag(R.T @ found.cov[3:, 3:] @ R)
    assert math.sqrt(var[2]) > 0.5
    assert np.abs(pad_error(found.pose, view.pose)[0]).max() < 1e-3
    assert not found.edges[EdgeKind.H].seen
    assert found.edges[EdgeKind.DISC].seen
    seen = sighting_of(view.frame(), found.pose, found.cov, camera, view.orientation(), found.yaw_ambiguous, 0.5)
    assert (seen.yaw_rad, seen.yaw_ambiguous, seen.cov[3, 3]) == (None, False, UNKNOWN_YAW_VAR)


def test_one_end_of_an_h_leg(camera: Camera, pad: Pad) -> None:
    """Only a piece of the H is in the frame at 12 cm: resolved parameters are right, unresolved ones are marked."""
    stage = Stage(camera, pad)
    squares = []
    for _ in range(12):
        view = stage.view(0.12, lateral=0.3)
        found = register(view.px, camera, pad, stage.start(view, 0.7), view.orientation(), TRACK)
        squares.append(nees(found, view))
    assert float(np.median(squares)) < chdtri(6, 0.05)
    assert max(squares) < 60.0


def test_the_arrow_shows_the_heading(camera: Camera, pad: Pad) -> None:
    stage = Stage(camera, pad)
    for height_m in (1.0, 5.0, 10.0):
        view = stage.view(height_m, lateral=0.02)
        opposite = PadPose(view.pose.R_cam_pad @ Rotation.from_rpy(0.0, 0.0, math.pi), view.pose.t_cam_pad)
        found = register(view.px, camera, pad, opposite, view.orientation())
        assert not found.yaw_ambiguous
        assert abs(pad_error(found.pose, view.pose)[1]) < 0.01


def test_refusals(camera: Camera, pad: Pad) -> None:
    stage = Stage(camera, pad)
    view = stage.view(2.0)
    aside = PadPose(view.pose.R_cam_pad, view.pose.t_cam_pad + np.array([9.0, 0.0, 0.0]))
    behind = PadPose(view.pose.R_cam_pad, -view.pose.t_cam_pad)
    for start in (aside, behind):
        for options in (TRACK, RegistrationOptions()):
            assert register(view.px, camera, pad, start, None, options) is None
    with pytest.raises(ValueError, match="shape"):
        register(view.px[:100], camera, pad, view.pose)
    grey = np.full_like(view.px, 120)
    found = register(grey, camera, pad, view.pose, view.orientation(), TRACK)
    assert found is None or not any(e.seen for e in found.edges.values())


def test_the_corners_of_the_h_in_photographs() -> None:
    camera, pad = shipped_camera("photos"), shipped_pad("printed")
    found, median, aside, headings = 0, [], [], 0
    all_of = list(photographs(2))
    with (DATA / "pad_photos" / "corner_labels.csv").open() as file:
        labels = {row[0]: np.array([float(cell) for cell in row[1:25]]) for row in list(csv.reader(file))[1:]}
    for name, px, truth in all_of:
        # From a start that is wrong by several pixels in place, size and heading.
        start = PadPose(truth.turned(0.06).R_cam_pad, truth.t_cam_pad * 1.04)
        result = register(px, camera, pad, start, None, RegistrationOptions())
        if result is None or result.inliers < 0.5:
            continue
        found += 1
        headings += not result.yaw_ambiguous
        # The labels go round the H the other way.
        off = camera.project(result.pose.points(pad.markings.h_corners())) - labels[name].reshape(12, 2)[::-1]
        median.append(float(np.median(np.hypot(*off.T))))
        aside.append(np.median(off, axis=0))
    assert found >= 0.98 * len(all_of)
    assert headings >= 0.95 * len(all_of)
    assert float(np.median(median)) < 1.0
    # Half of that is the labels' own: they sit to the right of and below the paint's edges, alike in all photographs.
    assert np.median(aside, axis=0) == pytest.approx([-0.42, -0.66], abs=0.25)


def surrounded_errors(camera: Camera, pad: Pad, name: str, height_m: float, tilt_deg: float, frames: int) -> tuple[F64, F64]:
    """Return the errors along the pad's axes, (frames, 6) in m and rad, and the covariances, (frames, 6, 6)."""
    off, cov = [], []
    for k in range(frames):
        rng = np.random.default_rng([67, SURROUNDINGS.index(name), round(10 * height_m), round(tilt_deg), k])
        view = surrounded_view(rng, camera, pad, name, height_m, math.radians(tilt_deg))
        found = register(view.px, camera, pad, view.start, view.prior, TRACK)
        T = np.kron(np.eye(2), view.truth.R_cam_pad.matrix.T)
        off.append(T @ error(found.pose, view.truth))
        cov.append(T @ found.cov @ T.T)
    return np.array(off), np.array(cov)


@pytest.mark.parametrize(("height_m", "most_deg"), [(5.0, 0.15), (10.0, 0.3)])
def test_a_blur_that_a_tilt_slants_does_not_turn_the_pad(camera: Camera, pad: Pad, height_m: float, most_deg: float) -> None:
    """Seen obliquely a round blur is an ellipse on the deck, which an H that it merges would follow."""
    off, _ = surrounded_errors(camera, pad, "even", height_m, 25.0, 14)
    assert math.degrees(math.sqrt(float((off[:, 5] ** 2).mean()))) < most_deg


@pytest.mark.parametrize("name", ["asphalt", "wet", "patchy"])
def test_what_all_channels_see_is_one_witness_and_wider_than_a_pixel(camera: Camera, pad: Pad, name: str) -> None:
    """Stones, puddles and wear darken blue, green and red together, and pass through the lens, as a sensor's noise does not."""
    off, cov = surrounded_errors(camera, pad, name, 10.0, 12.0, 24)
    squares = np.array([e @ np.linalg.solve(c, e) for e, c in zip(off, cov, strict=True)]) / 6.0
    assert 0.5 < float(squares.mean()) < 1.6


@pytest.mark.parametrize("name", ["asphalt", "edge of the deck", "sea"])
def test_what_lies_around_a_pad_does_not_have_it_rejected(camera: Camera, pad: Pad, name: str) -> None:
    """A doubted registration says half a metre at 10 m, and no heading."""
    sigmas, known = [], 0
    for k in range(10):
        rng = np.random.default_rng([83, SURROUNDINGS.index(name), 100, 12, k])
        view = surrounded_view(rng, camera, pad, name, 10.0, math.radians(12.0))
        found = register(view.px, camera, pad, view.start, view.prior, TRACK)
        sight = view.truth.t_cam_pad / view.truth.range_m
        sigmas.append(math.sqrt(float(sight @ found.cov[:3, :3] @ sight)))
        known += not found.yaw_ambiguous
    assert np.median(sigmas) < 0.05
    assert known >= 9


@pytest.mark.parametrize(("height_m", "least"), [(1.0, 0.0015), (12.0, 0.003)])
def test_a_pad_painted_to_a_tolerance_is_at_a_range_of_that_tolerance(camera, pad, height_m, least):
    """Two millimetres of a disc of 390 are half a percent of the range; its lettering and ring say the range, too."""
    view = surrounded_view(np.random.default_rng([67, round(height_m)]), camera, pad, "even", height_m, 0.0)
    rough = replace(pad, size_sigma_m=0.002)
    sigmas = []
    for drawn in (pad, rough):
        found = register(view.px, camera, drawn, view.start, view.prior, TRACK)
        sigmas.append(math.sqrt(found.cov[2, 2]) / height_m)
    assert sigmas[0] < least < sigmas[1] < 0.0075


def coded_views(camera: Camera, pad: Pad, height_m: float, frames: int) -> list[RenderedView]:
    """Frames of a vehicle that hovers, after an encoder as that of the simulated AR.Drone; the first of them is not predicted."""
    stage, encoder, decoder = Stage(camera, pad, seed=3), Encoder(camera.width, camera.height, 30.0, 4000.0), unit_decoder()
    views = []
    for k in range(frames):
        t = k / 30.0
        rpy = (0.01 * math.sin(2.1 * t), 0.012 * math.sin(1.7 * t + 1.0), 0.3 + 0.02 * math.sin(0.6 * t))
        aside = 0.1 * height_m * np.array([math.sin(0.5 * t), math.cos(0.4 * t)])
        view = stage.view_from(height_m * (1.0 + 0.01 * math.sin(0.7 * t)), aside, rpy)
        (image,) = decoder.decode(encoder.encode(view.px).data)
        px = np.asarray(image.to_ndarray(format="bgr24"), np.uint8)
        views.append(replace(view, px=px))
    return views


@pytest.mark.parametrize("height_m", [1.5, 4.0, 12.0])
def test_the_covariance_has_what_the_codec_moved(camera: Camera, pad: Pad, height_m: float) -> None:
    as_if_plain, coded = list[float](), list[float]()
    for view in coded_views(camera, pad, height_m, 40)[1:]:
        for coded_px, into in ((0.0, as_if_plain), (CODED_PX, coded)):
            found = register(view.px, camera, pad, view.pose, None, RegistrationOptions(coarse=False, coded_px=coded_px))
            into.append(nees(found, view))
    assert 1.0 < np.mean(coded) < 9.0
    assert np.mean(coded) < 0.7 * np.mean(as_if_plain)


def test_only_predicted_frames_are_downgraded(camera: Camera, pad: Pad) -> None:
    view = coded_views(camera, pad, 4.0, 2)[1]
    seen = [
        track(TrackerConfig(camera, pad), TrackerMemory(), Frame(STAMP, 0, view.px, coded=coded), None)[0]
        for coded in (False, True)
    ]
    plain, suspect = (look.selected for look in seen)
    assert np.all(plain.d_body_pad_level == suspect.d_body_pad_level)
    assert np.linalg.eigvalsh(suspect.cov[:3, :3] - plain.cov[:3, :3]).min() > 0.0
