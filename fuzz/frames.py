"""Fuzz the conversion of camera buffers to images, and vision with any image."""

import struct
from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import cv2
import msgspec
import numpy as np

from companion.guidance.pilot import tracker
from companion.settings.load import load, read_toml
from decklander.place import SHIPPED
from drivers.camera.v4l2_frames import FrameLayout, H264Decoder, to_bgr
from estimator.contracts.estimates import RelativeState, Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.camera.camera import Camera
from estimator.vision.camera.pose import Orientation, PadPose
from estimator.vision.detection import Detection
from estimator.vision.options import TrackerMethod
from estimator.vision.pad.lamps import places_of
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.lamps import detect_lamps
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from fuzz.target import Choices, Target, block
from sitl.emulators.ardrone.wire_pictures import Encoder
from sitl.scenario.scenario import load as load_scenario
from sitl.world.world import World

_FORMATS = ("MJPG", "YUYV", "NV12", "GREY")
WIDTH, HEIGHT = 96, 72
_AT = Stamp(MonoNs(1_000_000_000), MonoNs(1_040_000_000), 0.001, "synced")


def run_v4l2(data: bytes) -> None:
    """Convert buffers of any format and content: the result is an image of the announced size, or none."""
    choices = Choices(data)
    how = choices.number(1)
    width, height = 2 * (1 + choices.number(1) % 40), 2 * (1 + choices.number(1) % 40)
    kind = _FORMATS[how % 4]
    stride = {"MJPG": 0, "YUYV": 2 * width}.get(kind, width) + (choices.number(1) if kind != "MJPG" else 0)
    layout, decoder = FrameLayout(kind, width, height, stride), H264Decoder()
    while choices:
        buffer = choices.block()
        px = decoder.decode(buffer, layout) if how & 0x80 else to_bgr(buffer, layout)
        assert px is None or (px.shape == (height, width, 3) and px.dtype == np.uint8)


def v4l2_seeds() -> Iterator[bytes]:
    """Yield a buffer of each format, whole and truncated, and two encoded units."""
    rng = np.random.default_rng(2)
    image = rng.integers(0, 255, (24, 32, 3), np.uint8)
    size = bytes([15, 11])
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    yield b"\0" + size + block(jpeg) + block(jpeg + bytes(9)) + block(jpeg[:100] + b"\xff\xd9")
    yield b"\0" + size + block(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes())
    for number, length in ((1, 2 * 32 * 24), (2, 32 * 36), (3, 32 * 24)):
        yield bytes([number]) + size + b"\0" + block(bytes(length)) + block(bytes(length - 1))
    encoder = Encoder(32, 24, 30.0, 1000.0)
    yield b"\x80" + size + b"".join(block(encoder.encode(image).data) for _ in range(2))


def run_vision(data: bytes) -> None:
    """Process any image, attitude and belief: vision must answer, with finite numbers."""
    choices = Choices(data)
    how = choices.number(1)
    t = _AT
    roll, pitch, height_m = ((choices.number(1) - 128) * 0.01 for _ in range(3))
    attitude = Attitude(t, Rotation.from_rpy(roll, pitch, 0.3), np.diag([1e-4, 1e-4, 1e-2])) if how & 1 else None
    belief = None
    if how & 2:
        d = np.array([(choices.number(1) - 128) * 0.01, 0.1, 0.05 + abs(height_m) * 4])
        cov = np.eye(7) * 10.0 ** (choices.number(1) % 6 - 4)
        belief = RelativeState(t.measured_at, "ekf", d, np.zeros(3), choices.number(1) * 0.02, cov, t.measured_at, True)
    tracker, memory = _tracker("registration" if how & 4 else "fused"), TrackerMemory()
    for _ in range(1 + (how >> 3 & 1)):
        seen, memory = track(tracker, memory, Frame(t, 1, _image(choices, how >> 4), 0.001), attitude, belief)
        _check(seen)


def _image(choices: Choices, how: int) -> np.ndarray:
    """Return the bytes as an image: as they come, flat, tiled, as noise, or over a part of a frame of the pad."""
    rest = choices.take(512 if how & 8 else 1 << 14)
    if how & 7 < 5:
        px = _views()[how & 3].copy()
        if rest:
            patch = np.resize(np.frombuffer(rest, np.uint8), (1 + len(rest) // 48, 16, 3))[:HEIGHT]
            y, x = rest[0] % (HEIGHT - len(patch) + 1), rest[-1] % (WIDTH - 16)
            px[y : y + len(patch), x : x + 16] = patch
        return px
    if how & 7 == 5:
        return np.full((HEIGHT, WIDTH, 3), rest[:3].ljust(3, b"\0")[0], np.uint8)
    if how & 7 == 6:
        return np.resize(np.frombuffer(rest or b"\0", np.uint8), (HEIGHT, WIDTH, 3))
    seed = int.from_bytes(rest[:4], "little")
    return np.random.default_rng(seed).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)


def _check(seen: Detection) -> None:
    for sighting in (seen.selected, seen.elsewhere, *seen.methods.values()):
        if sighting is not None:
            _check_sighting(sighting)


def _check_sighting(sighting: Sighting) -> None:
    assert np.all(np.isfinite(sighting.d_body_pad_level))
    assert np.all(np.isfinite(sighting.cov))
    assert 0.0 <= sighting.confidence <= 1.0


def run_lamps(data: bytes) -> None:
    """Look for a lit pad among lights anywhere, from any attitude and expected place: an answer has finite numbers."""
    choices = Choices(data)
    how = choices.number(1)
    roll, pitch = ((choices.number(1) - 128) * 0.01 for _ in range(2))
    tilt = Orientation(roll, pitch, np.eye(2) * 10.0 ** (choices.number(1) % 9 - 7), 0.03, bool(how & 1))
    expected = None
    if how & 2:
        place = np.array([choices.real() if how & 4 else choices.signed(2) * 1e-3 for _ in range(3)])
        if np.all(np.isfinite(place)):
            expected = PadPose(Rotation.from_rpy(*((choices.number(1) - 128) * 0.02 for _ in range(3))), place)
    reach_px = choices.number(1) * 0.5
    px = np.full((HEIGHT, WIDTH, 3), choices.number(1) if how & 8 else 0, np.uint8)
    if how & 16 and expected is not None:
        _light(px, _camera().project(expected.points(np.pad(places_of(_lit().lamps), ((0, 0), (0, 1))))), 255)
    while choices:
        _light(px, np.array([[choices.number(1) % WIDTH, choices.number(1) % HEIGHT]]), choices.number(1))
    seen = detect_lamps(Frame(_AT, 1, px), _camera(), _lit(), tilt, expected, reach_px)
    if seen is not None:
        _check_sighting(seen)


def _light(px: np.ndarray, uv: np.ndarray, value: int) -> None:
    """Shine at places, as far as they are in the image, over two by two pixels."""
    inside = np.all((uv >= 0.0) & (uv < [WIDTH - 1, HEIGHT - 1]), axis=1)
    for u, v in uv[inside].astype(int):
        px[v : v + 2, u : u + 2] = value


@cache
def _lit() -> Pad:
    return Pad.from_mapping(read_toml(SHIPPED / "pads" / "lit.toml"))


def lamps_seeds() -> Iterator[bytes]:
    """Yield a lit pad straight below from three heights, with and without other lights, and lights alone."""
    for height_mm in (400, 900, 2500):
        place = struct.pack("<hhh", 0, 0, height_mm)
        for how in (0x12, 0x13, 0x1B):
            even = b"\x08" * (how >> 3 & 1)
            yield bytes([how, 128, 128, 4]) + place + bytes([128, 128, 160, 16]) + even + bytes(range(40, 64))
    yield bytes([1, 130, 120, 3]) + bytes(range(200))


@cache
def _camera() -> Camera:
    return Camera.from_mapping(
        {"width": WIDTH, "height": HEIGHT, "fx": 56.0, "fy": 56.0, "cx": 47.5, "cy": 35.5, "distortion": [0.0] * 5,
         "p_body_cam_m": [0.0, 0.0, 0.0], "rpy_body_cam_deg": [0.0, 0.0, 90.0]}
    )  # fmt: skip


@cache
def _tracker(speaks: str) -> TrackerConfig:
    made = tracker(load("sim"))
    method: TrackerMethod = "registration" if speaks == "registration" else "fused"
    return replace(made, camera=_camera(), options=msgspec.structs.replace(made.options, method=method))


@cache
def _views() -> tuple[np.ndarray, ...]:
    """Return the simulated camera's own frames of the pad from four heights, reduced in size."""
    scenario = load_scenario("calm")
    out = []
    for height_m in (0.6, 1.2, 2.5, 4.0):
        start = msgspec.structs.replace(scenario.start, height_m=height_m)
        px = World(msgspec.structs.replace(scenario, start=start), 1).render().px
        out.append(np.ascontiguousarray(cv2.resize(px, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)))
    return tuple(out)


def vision_seeds() -> Iterator[bytes]:
    """Yield views of the pad with and without attitude and belief, and images that show none."""
    for how in range(16):
        yield bytes([(how & 3) << 4 | how, 128 + how, 120, 150, 130, 3, 9]) + bytes(range(how * 16))
    for kind in (5, 6, 7):
        yield bytes([kind << 4 | 1, 128, 128, 150]) + bytes(range(1, 60))


TARGETS = {
    "v4l2": Target(run_v4l2, v4l2_seeds, 8192),
    "vision": Target(run_vision, vision_seeds, 4096),
    "lamps": Target(run_lamps, lamps_seeds),
}
