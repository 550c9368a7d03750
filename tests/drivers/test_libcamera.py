"""A Raspberry Pi's camera behind the camera's door: a stand-in of picamera2 that is held against the real one's signatures."""

import ast
import asyncio
import json
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.camera import camera_process
from drivers.camera.camera_process import libcamera_models
from drivers.camera.exposure_law import ExposureGovernor
from drivers.camera.open_camera import open_camera
from drivers.camera.options import CameraOptions, ExposureOptions
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput, SetupImpossible
from estimator.contracts.samples import Frame
from tests.support.waiting import until

STAND_INS = Path(__file__).parents[1] / "support/stand_in_pi"
WHEEL = Path(__file__).parents[3] / "shared/data/picamera2/picamera2-0.3.38-py3-none-any.whl"
SIZE = (66, 48)  # rows of 198 bytes, which are padded by 58
CLOCK = SystemClock()


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a function that puts the stand-in into the system's Python."""
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nshift\nPYTHONPATH={STAND_INS} exec {sys.executable} "$@"\n')
    python.chmod(0o755)

    def put(**differs: Any) -> None:
        monkeypatch.setattr(camera_process, "PYTHONS", (sys.executable, str(python)))
        monkeypatch.setenv("STAND_IN", json.dumps(differs))

    return put


def pi_camera(**more: Any) -> CameraOptions:
    usual: dict[str, Any] = {"silence_s": 5.0, "reconnect_first_s": 0.01, "reconnect_most_s": 0.02}
    return CameraOptions(source="libcamera", **(usual | more))


async def frames_of(o: CameraOptions, count: int, governed: bool = False) -> list[Frame]:
    async with asyncio.timeout(60), open_camera(o, SIZE, CLOCK) as camera:
        governor = ExposureGovernor(o.exposure, camera.exposure) if governed and camera.exposure is not None else None
        frames: list[Frame] = []
        while len(frames) < count:
            frames.append(frame := await camera.frames.get())
            if governor is not None:
                governor.on_frame(frame, np.array([[10, 10], [60, 10], [60, 40], [10, 40]], float), 0.0)
        assert camera.counters.stamps_refused == 0
        return frames


@pytest.mark.parametrize("asleep_s", [0.0, 3600.0])
async def test_a_frame_is_stamped_in_the_middle_of_its_exposure_by_the_sensor(world: Any, asleep_s: float) -> None:
    world(light=0.02, asleep_s=asleep_s)
    frames = await frames_of(pi_camera(exposure_s=0.004), 8)
    for frame in frames:
        true_ns = int(frame.px[0].reshape(-1)[:8].view(np.int64)[0])
        assert abs(frame.stamp.measured_at - true_ns) < 500_000, "half of the blanking that is taken for read-out"
        assert frame.stamp.source == "kernel"
        assert frame.exposure_s == pytest.approx(0.004, abs=2e-5)
    blue, green, red = frames[-1].px[20, 30].tolist()
    assert blue == green // 2
    assert red == green // 3
    assert frames[-1].px.shape == (48, 66, 3)
    assert frames[-1].px[1].reshape(-1)[:8].view(np.int32).tolist() == [1640, 1232], "all of the sensor, at 30 Hz"


@pytest.mark.parametrize("light", [2.0, 0.1, 0.02])
async def test_the_light_on_the_pad_drives_exposure_and_gain(world: Any, light: float) -> None:
    world(light=light)
    driven = pi_camera(exposure=ExposureOptions(mode="pad", longest_s=0.005))
    frames = await frames_of(driven, 60, governed=True)
    last = frames[-1]
    assert 160 <= last.px[20, 30].max() <= 230
    assert last.exposure_s <= 0.0051
    assert (last.gain > 1.5) == (light == 0.02)
    for frame in frames:
        exposed = min(1.0, light * 1e3 * frame.exposure_s * frame.gain)
        grey = 255 * (1.055 * exposed ** (1 / 2.4) - 0.055)
        assert frame.px[20, 30].max() == pytest.approx(grey, abs=2), "each frame has the exposure that it was taken with"


@pytest.mark.parametrize(
    ("differs", "more", "words"),
    [
        ({}, {"rate_hz": 300.0}, "no mode of 300 Hz; it has 640x480 at 206.65 Hz, 1640x1232"),
        ({}, {"controls": "LensPosition=1.5"}, "no control LensPosition; it has AeEnable, AnalogueGain"),
        ({"models": ["imx219", "imx296"]}, {}, "may be any of 0 imx219 .* 1 imx296"),
    ],
)
async def test_settings_that_the_camera_cannot_do_are_one_clear_error(world: Any, differs: Any, more: Any, words: str) -> None:
    world(**differs)
    with pytest.raises(BadInput, match=words):
        await frames_of(pi_camera(**more), 1)


@pytest.mark.parametrize(
    ("differs", "device", "reason", "words"),
    [
        ({"models": []}, "", "absent", "no CSI camera ''; libcamera lists none at all"),
        ({}, "imx708", "absent", "lists 0 imx219"),
        ({"busy": True}, "", "failed", "resource busy (another program holds the camera"),
    ],
)
async def test_a_camera_that_is_absent_or_busy_is_tried_again(world, differs, device, reason, words):
    world(**differs)
    async with asyncio.timeout(60), open_camera(pi_camera(device=device), SIZE, CLOCK) as camera:
        await until(lambda: camera.counters.restarts[reason] >= 2)
        assert words in str(camera.down)
        world()
        if not device:
            await camera.frames.get()


async def test_without_picamera2_the_error_names_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_process, "PYTHONS", (sys.executable,))
    assert libcamera_models() == []
    with pytest.raises(SetupImpossible, match="has picamera2: install python3-picamera2"):
        await frames_of(pi_camera(), 1)


def test_the_cameras_are_listed_without_those_of_usb(world: Any) -> None:
    world(models=["imx708_wide", "imx296"])
    assert libcamera_models() == ["imx708_wide", "imx296"]


def signatures(source: str) -> dict[str, list[str]]:
    """Return the parameters of each method, in order and with an = behind those that may be left out."""
    found = {}
    for of in ast.parse(source).body:
        if isinstance(of, ast.ClassDef) and of.name in ("Picamera2", "CompletedRequest", "MappedArray"):
            for method in of.body:
                if isinstance(method, ast.FunctionDef):
                    names = [a.arg for a in method.args.args]
                    least = len(names) - len(method.args.defaults)
                    found[f"{of.name}.{method.name}"] = names[:least] + [f"{name}=" for name in names[least:]]
    return found


@pytest.mark.skipif(
    not WHEEL.is_file(), reason="picamera2's wheel is not on this machine (pip download --no-deps picamera2==0.3.38)"
)
def test_the_stand_in_takes_what_picamera2_takes() -> None:
    real: dict[str, list[str]] = {}
    with zipfile.ZipFile(WHEEL) as wheel:
        for name in ("picamera2", "request"):
            real |= signatures(wheel.read(f"picamera2/{name}.py").decode())
    ours = signatures((STAND_INS / "picamera2.py").read_text())
    assert len(ours) > 10
    assert ours == {name: real.get(name) for name in ours}
