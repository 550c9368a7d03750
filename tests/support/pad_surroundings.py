"""Views of the pad in named surroundings, with an attitude whose errors are drawn from what is said of them."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera import Camera
from estimator.vision.pad import Pad
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import I16, U16, Light, Sensor
from sitl.camera.projection import F32
from sitl.camera.render.deck import Tile
from sitl.camera.surroundings import Deck, Surroundings
from sitl.sea.sea import SEA_STATES, Waves
from tests.support.pad_scenes import truth_of
from tests.support.pad_views import PLAIN
from tests.support.plain_light import FLAT

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
        sun_elevation_rad=float(rng.uniform(0.5, 1.5)), sun_azimuth_rad=float(rng.uniform(0.0, math.tau)),
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
    assert deck is not None
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
