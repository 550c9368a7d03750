"""Random frames of a dark deck: a pad's lamps, and lights that are none of them."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.pad.lamps import places_of
from estimator.vision.pad.pad import Pad
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light, Sensor
from sitl.camera.settings import LampSettings
from sitl.camera.surroundings import Deck, Surroundings
from tests.support.pad_scenes import truth_of

ATTITUDE_SIGMA_RAD, DECK_SIGMA_RAD = math.radians(1.0), math.radians(2.0)


@dataclass(frozen=True, eq=False)
class NightScene:
    """One frame at night, what is true of it, and the attitude that a vehicle would measure."""

    px: NDArray[np.uint8]
    truth: PadPose
    is_lit: bool
    R_level_body: Rotation
    measured: Rotation
    """`R_level_body` as measured, with an error of one degree at one sigma."""
    shown: float
    """Part of the lamps within the frame."""

    @property
    def orientation(self) -> Orientation:
        """Attitude that vision receives."""
        roll, pitch, _ = self.measured.rpy_rad
        return Orientation(roll, pitch, np.eye(2) * ATTITUDE_SIGMA_RAD**2, DECK_SIGMA_RAD, True)


NightCondition = Literal["lamps", "other lights", "lamps out", "bright", "amplified"]
NIGHTS: tuple[NightCondition, ...] = ("lamps", "other lights", "lamps out", "bright", "amplified")


def night_scene(
    rng: np.random.Generator, camera: Camera, pad: Pad, height_m: float, condition: NightCondition, *, lit: bool = True
) -> NightScene:
    """Return a frame of the pad at night from a height over it, near the middle of the frame.

    Args:
        condition: "other lights" puts up to ten lights anywhere, "lamps out" breaks two of the pad's, "bright" has them outshine
            the camera, "amplified" has an amplified and noisy one.
        lit: whether the pad's lamps are on. If not, there are other lights in any case.
    """
    way = rng.uniform(0, math.tau)
    tilt = math.radians(float(rng.uniform(0, 15)))
    R_ned_body = Rotation.from_rpy(0.0, 0.0, float(rng.uniform(-math.pi, math.pi))) @ Rotation.from_rotvec(
        [tilt * math.cos(way), tilt * math.sin(way), 0.0]
    )
    roll, pitch = rng.normal(0, DECK_SIGMA_RAD, 2)
    R_ned_pad = Rotation.from_rpy(float(roll), float(pitch), float(rng.uniform(-math.pi, math.pi)))
    R_ned_cam = Rotation(R_ned_body.matrix @ camera.T_body_cam.R.matrix)
    spread = 0.25 if height_m < 1.0 else 0.7
    uv = (0.5 + 0.5 * spread * rng.uniform(-1, 1, (1, 2))) * np.array([[camera.width, camera.height]])
    ray = np.append(camera.rays(uv)[0], 1.0)
    d_cam = ray * (height_m / float(ray @ (R_ned_cam.matrix.T @ R_ned_pad.matrix[:, 2])))
    p_pad = np.array([0.0, 0.0, -0.6])
    p_body = p_pad - R_ned_cam @ d_cam - R_ned_body @ camera.T_body_cam.t
    shot = Exposure(
        float(rng.uniform(0, 100)), R_ned_body, p_body, R_ned_pad, p_pad, rng.normal(0, 0.2, 3), rng.normal(0, 0.05, 3)
    )
    stops = float(rng.uniform(2.0, 5.0)) if condition == "amplified" else 0.0
    light = Light(exposure_ev=stops, daylight_ev=float(rng.uniform(-13.0, -8.0)), drone_shadow=0.0)
    level = (float(rng.uniform(20.0, 50.0)) if condition == "bright" else float(rng.uniform(2.0, 8.0))) * 2.0**-stops
    sensor = Sensor(exposure_s=0.01, full_well_e=8000.0 * 2.0**-stops)
    broken = _broken(rng, pad) if condition == "lamps out" else pad
    deck = Surroundings(deck=Deck(8.0, 4.0))
    px = Renderer(camera, broken, deck, light, sensor, LampSettings(own_level=level if lit else 0.0)).render(shot, rng)
    if condition == "other lights" or not lit:
        px = _with_lights(rng, px, int(rng.integers(3, 11)) if lit else int(rng.integers(4, 26)))
    tilt_error = Rotation.from_rotvec(np.append(rng.normal(0, ATTITUDE_SIGMA_RAD, 2), 0.0))
    truth, level = truth_of(shot, camera), R_ned_body.without_heading()
    return NightScene(px, truth, lit, level, level @ tilt_error, _in_view(truth, camera, pad))


def _broken(rng: np.random.Generator, pad: Pad) -> Pad:
    out = set(rng.choice(len(pad.lamps), 2, replace=False).tolist())
    lamps = tuple(lamp for i, lamp in enumerate(pad.lamps) if i not in out)
    return Pad(pad.name, pad.paints, pad.regions, pad.size_sigma_m, lamps)


def _in_view(truth: PadPose, camera: Camera, pad: Pad) -> float:
    uv = camera.project(truth.points(np.pad(places_of(pad.lamps), ((0, 0), (0, 1)))))
    return float(np.mean(np.all((uv > 0) & (uv < [camera.width, camera.height]), axis=1)))


def _with_lights(rng: np.random.Generator, px: NDArray[np.uint8], n: int) -> NDArray[np.uint8]:
    """Return the frame with lights of any size and colour: scattered, or in a row as along a rail."""
    h, w = px.shape[:2]
    out = px.astype(float)
    places: F64 = rng.uniform(0, 1, (n, 2)) * [w, h]
    if rng.uniform() < 0.4:
        along = rng.uniform(-1, 1, 2)
        places = rng.uniform(0.2, 0.8, 2) * [w, h] + np.arange(n)[:, None] * rng.uniform(12, 60) * along / np.linalg.norm(along)
    for x, y in places:
        size, level = rng.uniform(0.7, 3.5), rng.uniform(60, 900)
        across, down = (np.exp(-0.5 * ((np.arange(n) - at) / size) ** 2) for n, at in ((w, x), (h, y)))
        rows, columns = np.flatnonzero(down > 1e-6), np.flatnonzero(across > 1e-6)
        light = level * np.outer(down[rows], across[columns])
        out[np.ix_(rows, columns)] += light[:, :, None] * rng.uniform(0.5, 1.0, 3)
    return np.asarray(out.clip(0, 255), np.uint8)
