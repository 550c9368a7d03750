"""Random frames with a pad and with things that only look like one, in any light: what the vision benches draw from."""

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from estimator.contracts.geometry import F64, Rotation
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import PadPose
from estimator.vision.detect.acquire import SURE, PadCandidate, search
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT
from sitl.camera.camera import Exposure, Renderer
from sitl.camera.light import Light, Sensor
from sitl.camera.surroundings import RGB, Decal, Deck, Surroundings
from sitl.sea.sea import SEA_STATES, Waves
from tests.support.shipped import shipped_camera, shipped_pad

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / ".." / "shared" / "data"
DECK_PAINTS: tuple[RGB, ...] = ((112, 118, 122), (150, 152, 150), (78, 84, 90), (120, 96, 84))
CONDITIONS = ("plain", "light", "glare", "wet", "shadow", "cut", "occluded")


load_camera, load_pad = lru_cache(shipped_camera), lru_cache(shipped_pad)


def acquire(
    px: NDArray[np.uint8], camera: Camera, pad: Pad, R_level_body: Rotation | None = None, *, sure: float = SURE
) -> list[PadCandidate]:
    """Search a whole frame for the pad, however long it takes, and return the candidates, best first."""
    return search(FrameView(Pyramid(px), camera, pad), R_level_body, sure=sure).candidates


@dataclass(frozen=True, eq=False)
class PadScene:
    """One frame, what is true of it, and what a vehicle would know beside it."""

    px: NDArray[np.uint8]
    truth: PadPose | None
    """None where there is no pad."""
    R_level_body: Rotation | None
    """The measured attitude, with an error of one degree at one sigma; None if the vehicle sends none."""
    height_m: float
    visible: float
    """Share of the disc inside the frame and not occluded."""
    condition: str


@lru_cache(maxsize=8)
def _deck(i: int, yaw_rad: float) -> Deck:
    big = i % 2 == 1
    return Deck(26.0 if big else 5.0, 9.0 if big else 2.8, (0.6, 0.0), yaw_rad, paint=DECK_PAINTS[i % len(DECK_PAINTS)], seed=i)


def random_light(rng: np.random.Generator, condition: str) -> Light:
    """3000 to 9000 K, two stops either way and 20 % of white balance unless the condition is "plain"."""
    if condition == "plain":
        return Light()
    kelvin = float(1e6 / rng.uniform(1e6 / 9000, 1e6 / 3000))
    gains = tuple(float(g) for g in rng.uniform(0.8, 1.2, 3))
    angle, out = rng.uniform(0, math.tau), 0.25 * math.sqrt(rng.uniform())
    kelvin = kelvin if condition == "light" else float(rng.uniform(4500, 7500))
    return Light(
        kelvin,
        balanced_for_k=6500.0 if rng.uniform() < 0.7 else kelvin,
        white_balance=(gains[0], gains[1], gains[2]),
        exposure_ev=float(rng.uniform(-2, 2)) if condition == "light" else float(rng.uniform(-1, 1)),
        sun_elevation_deg=math.degrees(rng.uniform(0.5, 1.5)),
        sun_azimuth_deg=math.degrees(rng.uniform(0, math.tau)),
        drone_shadow=0.7 if condition == "shadow" else float(rng.choice([0.0, 0.45])),
        glare=float(rng.uniform(0.3, 1.2)) if condition == "glare" else 0.0,
        glare_centre_m=(out * math.cos(angle), out * math.sin(angle)),
        wetness=float(rng.uniform(0.4, 1.0)) if condition == "wet" else 0.0,
    )


def _sensor(rng: np.random.Generator) -> Sensor:
    return Sensor(float(rng.choice([0.002, 0.008])), float(rng.uniform(0.5, 1.0)))


def _surroundings(rng: np.random.Generator, with_deck: bool, decals: tuple[Decal, ...]) -> Surroundings:
    deck = _deck(int(rng.integers(4)), float(rng.integers(2)) * 0.7) if with_deck else None
    waves = Waves.draw(SEA_STATES[int(rng.integers(2, 6))], int(rng.integers(6))) if rng.uniform() < 0.7 else None
    water = ((16, 52, 66), (18, 70, 62), (40, 60, 50), (8, 34, 60))[int(rng.integers(4))]
    wake = float(rng.uniform(1, 6)) if rng.uniform() < 0.4 else 0.0
    return Surroundings(deck, waves, decals, water, wake, int(rng.integers(4)))


def _decals(rng: np.random.Generator, n: int, on_deck_at: tuple[float, float] | None, reach_m: float) -> list[Decal]:
    """Rafts, awnings, other helipads, an H without its ring, a ring without its H, scattered; some in the pad's own colours."""
    out: list[Decal] = []
    for _ in range(n):
        deck = on_deck_at is not None and rng.uniform() < 0.5
        low = 1.0 if deck and on_deck_at == (0.0, 0.0) else 0.0
        reach = max(2.0, reach_m)
        p = np.array(on_deck_at if deck and on_deck_at else (0.0, 0.0)) + rng.uniform(-1, 1, 2) * reach
        if deck and np.hypot(*p) < low:
            p = p / max(np.hypot(*p), 1e-3) * (low + 0.2)
        out += cluster(rng, (float(p[0]), float(p[1])), float(rng.uniform(0.3, 2.5)), deck)
    return out


GREEN, ORANGE = (0, 102, 0), (255, 149, 0)


_LIKE_PADS = (
    "raft", "awning", "helipad", "green_helipad", "bare_h", "h_no_ring", "ring_no_h", "green_disc", "ring", "lifebuoy", "towel",
)  # fmt: skip


def cluster(
    rng: np.random.Generator, at: tuple[float, float], size_m: float, on_deck: bool, kinds: Sequence[str] = _LIKE_PADS
) -> list[Decal]:
    """One thing that resembles the pad, of one or several decals on top of each other."""
    on = "deck" if on_deck else "sea"
    yaw = float(rng.uniform(0, math.tau))
    kind = str(rng.choice(kinds))
    green = tuple(int(c) for c in np.clip(np.array(GREEN) + rng.integers(-25, 26, 3), 0, 255))

    def one(name: str, scale: float = 1.0, colour: RGB | None = None) -> Decal:
        return Decal(name, at, size_m * scale, yaw, on, colour)  # type: ignore[arg-type]

    colour = (green[0], green[1], green[2])
    if kind == "green_helipad":
        return [one("helipad", colour=colour)]
    if kind == "h_no_ring":
        return [one("green_disc", colour=colour), one("bare_h", 0.683, colour)]
    if kind == "ring_no_h":
        return [one("green_disc", colour=colour), one("ring", 0.669, ORANGE), one("green_disc", 0.623, colour)]
    return [one(kind)]


def truth_of(shot: Exposure, camera: Camera) -> PadPose:
    R_ned_cam = shot.R_ned_body.matrix @ camera.T_body_cam.R.matrix
    p_cam = shot.p_body_ned + shot.R_ned_body.matrix @ camera.T_body_cam.t
    return PadPose(Rotation(R_ned_cam.T @ shot.R_ned_pad.matrix), R_ned_cam.T @ (shot.p_pad_ned - p_cam))


def visible_fraction(pose: PadPose, camera: Camera, pad: Pad, covered: NDArray[np.uint8] | None = None) -> float:
    """Share of the disc's area inside the frame and not under the mask `covered`."""
    r = pad.disc_radius_m * np.sqrt((np.arange(400) + 0.5) / 400)
    a = np.arange(400) * 2.399963
    uv = camera.project(pose.points(np.stack([r * np.cos(a), r * np.sin(a), 0 * a], axis=1)))
    with np.errstate(invalid="ignore"):
        ok = (uv[:, 0] > -0.5) & (uv[:, 0] < camera.width - 0.5) & (uv[:, 1] > -0.5) & (uv[:, 1] < camera.height - 0.5)
    if covered is not None:
        i = np.rint(uv[ok]).astype(int)
        ok[np.nonzero(ok)[0][covered[i[:, 1], i[:, 0]] > 0]] = False
    return float(ok.mean())


def _attitude(rng: np.random.Generator, tilt_rad: float) -> Rotation:
    way = rng.uniform(0, math.tau)
    tilt = Rotation.from_rotvec([tilt_rad * math.cos(way), tilt_rad * math.sin(way), 0.0])
    return Rotation.from_rpy(0.0, 0.0, float(rng.uniform(-math.pi, math.pi))) @ tilt


def _measured(rng: np.random.Generator, R_ned_body: Rotation) -> Rotation | None:
    if rng.uniform() < 0.35:
        return None
    return R_ned_body.without_heading() @ Rotation.from_rotvec(np.append(rng.normal(0, math.radians(1.0), 2), 0.0))


def _aim(rng: np.random.Generator, camera: Camera, height_m: float, condition: str) -> F64:
    """Return where in the frame the pad's centre shall be, (1, 2) px."""
    size = np.array([[camera.width, camera.height]])
    if condition == "half cut":
        at = rng.uniform(0.1, 0.9, 2)
        at[int(rng.integers(2))] = float(rng.integers(2))
        return np.asarray(at * size)
    edge = 1.05 if condition == "cut" else 0.92
    u, v = rng.uniform(-edge, edge), rng.uniform(-edge, edge)
    uv = np.array([[camera.width * (0.5 + 0.5 * u), camera.height * (0.5 + 0.5 * v)]])
    return np.asarray(uv * 0.5 + size * 0.25 if height_m < 0.8 and condition != "cut" else uv)


def _half_plane(
    rng: np.random.Generator, camera: Camera, pad: Pad, truth: PadPose, off_radii: tuple[float, float]
) -> NDArray[np.uint8]:
    """Return a mask of what lies beyond a straight line so far from the centre, in radii of the disc."""
    covered = np.zeros((camera.height, camera.width), np.uint8)
    a = rng.uniform(0, math.tau)
    side, up = np.array([math.cos(a), math.sin(a)]), np.array([-math.sin(a), math.cos(a)])
    r, off = pad.disc_radius_m, float(rng.uniform(*off_radii)) * pad.disc_radius_m
    corners = np.array([off * side - 2 * r * up, off * side + 2 * r * up, 2 * r * (side + up), 2 * r * (side - up)])
    cam = truth.points(np.c_[corners, np.zeros(4)])
    if np.all(cam[:, 2] > 0.02):
        quad = np.clip(camera.project(cam), -8000, 8000).astype(np.int32)
        cv2.fillPoly(covered, [quad], 255)
    return covered


def _shaded(rng: np.random.Generator, px: NDArray[np.uint8], covered: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the frame with a tenth to a third of the light where the mask is, and a border of one to four pixels."""
    share = cv2.GaussianBlur(covered.astype(np.float32) / 255.0, (0, 0), float(rng.uniform(0.5, 2.0)))[:, :, None]
    light = 1.0 - share * (1.0 - rng.uniform(0.1, 0.35))
    values = np.interp(LINEAR_LIGHT[px] * light, LINEAR_LIGHT, np.arange(256.0))
    return np.asarray(np.rint(values + rng.normal(0.0, 1.0, px.shape)).clip(0, 255), np.uint8)


def pad_scene(
    rng: np.random.Generator, camera: Camera, pad: Pad, height_m: float, condition: str, tilt_rad: float | None = None,
    light: Light | None = None, sensor: Sensor | None = None,
) -> PadScene:  # fmt: skip
    """Return the pad on a deck, camera `height_m` over its plane; from close by at least some of ring or H is in view.

    Args:
        light, sensor: in place of random ones.
    """
    R_ned_body = _attitude(rng, math.radians(float(rng.uniform(0, 25))) if tilt_rad is None else tilt_rad)
    roll, pitch = rng.normal(0, math.radians(2.0), 2)
    R_ned_pad = Rotation.from_rpy(float(roll), float(pitch), float(rng.uniform(-math.pi, math.pi)))
    p_pad = np.array([rng.uniform(-20, 20), rng.uniform(-20, 20), -0.6])
    R_ned_cam = Rotation(R_ned_body.matrix @ camera.T_body_cam.R.matrix)
    need = {"cut": 0.35, "half cut": 0.0}.get(condition, 0.9)
    best: tuple[float, F64, F64] | None = None
    for _ in range(60):
        uv = _aim(rng, camera, height_m, condition)
        ray = np.append(camera.rays(uv)[0], 1.0)
        n = R_ned_cam.matrix.T @ R_ned_pad.matrix[:, 2]
        if ray @ n < 0.3:
            continue
        d_cam = ray * (height_m / (ray @ n))
        pose = PadPose(Rotation(R_ned_cam.matrix.T @ R_ned_pad.matrix), d_cam)
        share = visible_fraction(pose, camera, pad)
        if best is None or share > best[0]:
            best = (share, d_cam, uv)
        if share >= need:
            break
    p_body = p_pad - R_ned_cam @ best[1] - R_ned_body @ camera.T_body_cam.t
    v = rng.normal(0, 0.4, 3) * min(1.0, height_m)
    shot = Exposure(float(rng.uniform(0, 100)), R_ned_body, p_body, R_ned_pad, p_pad, v, rng.normal(0, 0.1, 3))
    decals = tuple(_decals(rng, int(rng.integers(0, 4)), (0.0, 0.0), height_m)) if condition != "plain" else ()
    decals = tuple(d for d in decals if not (d.on == "deck" and math.hypot(*d.centre_m) < 0.45 + 0.75 * d.size_m))
    renderer = Renderer(
        camera, pad, _surroundings(rng, True, decals), light or random_light(rng, condition), sensor or _sensor(rng)
    )
    px = renderer.render(shot, rng)
    truth = truth_of(shot, camera)
    covered = None
    if condition in ("occluded", "half covered", "half shaded"):
        covered = _half_plane(rng, camera, pad, truth, (0.0, 0.25) if condition == "occluded" else (-0.05, 0.05))
    if covered is not None and covered.any() and condition != "half shaded":
        shade = rng.integers(20, 160, 3)
        px = np.where(covered[:, :, None] > 0, shade + rng.normal(0, 6, px.shape), px).clip(0, 255).astype(np.uint8)
    elif covered is not None and condition == "half shaded":
        px = _shaded(rng, px, covered)
    return PadScene(px, truth, _measured(rng, R_ned_body), height_m, visible_fraction(truth, camera, pad, covered), condition)


def empty_scene(rng: np.random.Generator, camera: Camera, height_m: float) -> PadScene:
    """No pad: sea or deck, rafts, awnings, other helipads, an H alone, a ring alone, right below or scattered."""
    condition = str(rng.choice(["plain", "light", "glare", "wet", "shadow"]))
    R_ned_body = _attitude(rng, math.radians(float(rng.uniform(0, 25))))
    roll, pitch = rng.normal(0, math.radians(2.0), 2)
    R_ned_pad = Rotation.from_rpy(float(roll), float(pitch), float(rng.uniform(-math.pi, math.pi)))
    with_deck = rng.uniform() < 0.5
    p_pad = np.array([0.0, 0.0, -0.6 if with_deck else 0.0])
    shot = _exposure(rng, R_ned_body, R_ned_pad, p_pad, height_m, 0.3 * height_m + 0.2)
    decals: list[Decal] = []
    if rng.uniform() < 0.85:
        decals += _decals(rng, int(rng.integers(0, 6)), (0.0, 0.0) if with_deck else None, 0.8 * height_m)
        size = float(np.exp(rng.uniform(math.log(0.25), math.log(1.5)))) * max(0.5, min(height_m, 4.0))
        decals += cluster(rng, (float(rng.normal(0, 0.1)), float(rng.normal(0, 0.1))), size, with_deck)
    renderer = Renderer(camera, None, _surroundings(rng, with_deck, tuple(decals)), random_light(rng, condition), _sensor(rng))
    return PadScene(renderer.render(shot, rng), None, _measured(rng, R_ned_body), height_m, 0.0, condition)


def ring_scene(rng: np.random.Generator, camera: Camera, height_m: float) -> PadScene:
    """No pad: a green disc with the pad's ring and without its H on a deck, in most frames with glare on it."""
    condition = str(rng.choice(["glare", "glare", "glare", "light"]))
    R_ned_body = _attitude(rng, math.radians(float(rng.uniform(0, 25))))
    roll, pitch = rng.normal(0, math.radians(2.0), 2)
    R_ned_pad = Rotation.from_rpy(float(roll), float(pitch), float(rng.uniform(-math.pi, math.pi)))
    shot = _exposure(rng, R_ned_body, R_ned_pad, np.array([0.0, 0.0, -0.6]), height_m, 0.15 * height_m)
    at, size_m = rng.normal(0, 0.05, 2), float(np.exp(rng.uniform(math.log(0.5), math.log(2.0))))
    decals = cluster(rng, (float(at[0]), float(at[1])), size_m, True, ["ring_no_h"])
    renderer = Renderer(camera, None, _surroundings(rng, True, tuple(decals)), random_light(rng, condition), _sensor(rng))
    return PadScene(renderer.render(shot, rng), None, _measured(rng, R_ned_body), height_m, 0.0, condition)


def _exposure(
    rng: np.random.Generator, R_ned_body: Rotation, R_ned_pad: Rotation, p_pad: F64, height_m: float, aside_m: float
) -> Exposure:
    """Return an exposure over a place, aside of it by this much at one sigma, in motion."""
    aim = rng.normal(0, aside_m, 2)
    p_body = p_pad + np.array([aim[0], aim[1], -height_m])
    v = rng.normal(0, 0.4, 3) * min(1.0, height_m)
    return Exposure(float(rng.uniform(0, 100)), R_ned_body, p_body, R_ned_pad, p_pad, v, rng.normal(0, 0.1, 3))


def photographs(every: int = 1) -> Iterator[tuple[str, NDArray[np.uint8], PadPose]]:
    """Yield name, image and hand-labelled pose of the photographs of the printed pad; skip the test if they are not here."""
    folder = DATA / "pad_photos"
    if not folder.is_dir():
        pytest.skip("the photographs of the pad are not on this machine")
    with (folder / "pose.csv").open() as file:
        rows = list(csv.DictReader(file))[::every]
    for row in rows:
        t, rotvec = (np.array([float(row[key.format(a)]) for a in "xyz"]) for key in ("t_cam_{}_m", "rvec_{}"))
        px = cv2.imread(str(folder / "images" / row["frame"]))
        assert px is not None
        yield row["frame"], np.asarray(px, np.uint8), PadPose(Rotation.from_rotvec(rotvec), t)


def no_pads(every: int = 1) -> Iterator[tuple[str, NDArray[np.uint8], Camera]]:
    """Yield name and image, 640 px wide, of other things, and a camera for it; skip the test if they are not here."""
    paths = sorted([*(DATA / "sea").glob("*.jpg"), *(DATA / "not_pads").glob("*.jpg")])[::every]
    if not paths:
        pytest.skip("the images without a pad are not on this machine")
    for path in paths:
        px = np.asarray(cv2.imread(str(path)), np.uint8)
        h = round(640 * px.shape[0] / px.shape[1])
        px = np.asarray(cv2.resize(px, (640, h), interpolation=cv2.INTER_AREA), np.uint8)
        yield path.name, px, Camera(640, h, 512.0, 512.0, 319.5, (h - 1) / 2, np.zeros(5), load_camera("sim").T_body_cam)
