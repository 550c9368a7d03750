"""Camera files and tables of a rig: formats of others, sizes that images claim, keys that do not go together."""

import asyncio
from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.service.vehicle_parts import with_camera
from companion.settings.load import lens_assumed, load, mount_assumed, read_camera
from companion.settings.remarks import remarks
from companion.tools.calibrate.camera_file import FOREIGN, foreign
from companion.tools.doctor.gather_service import files_of
from decklander.place import SHIPPED
from drivers.camera.options import CameraOptions
from drivers.clock import SystemClock
from estimator.contracts.commands import Hover
from estimator.contracts.errors import BadInput
from estimator.contracts.geometry import Rotation, Transform
from estimator.contracts.samples import Range
from estimator.vision.camera.camera import Camera
from tests.companion.test_daemon import FakeVehicle
from tests.make import range_down
from tests.support.image_files import film

DOWN = Transform(Rotation.from_rpy(0.0, 0.0, np.pi / 2), np.zeros(3))
BENT = (-0.21, 0.06, 0.0011, -0.0007, 0.0)
CAMERA = Camera(640, 480, 510.25, 511.5, 318.75, 243.125, np.array(BENT), DOWN)
FISHEYE = Camera(640, 480, 210.25, 211.5, 318.75, 243.125, np.array([-0.02, 0.004, -0.001, 0.0002]), DOWN, lens="fisheye")
KALIBR = "cam0:\n  camera_model: {model}\n  intrinsics: [500.0, 501.0, 320.0, 240.0]\n  distortion_model: {lens}\n"
KALIBR += "  distortion_coeffs: {k}\n  resolution: {size}\n"


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE])
@pytest.mark.parametrize("kind", FOREIGN)
def test_what_is_exported_reads_back_as_the_same_camera(kind: str, camera: Camera, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(foreign(camera, kind))
    assert read_camera(path) == camera


def test_a_lens_with_k3_does_not_fit_kalibr() -> None:
    bent = Camera(640, 480, 510.0, 510.0, 320.0, 240.0, np.array([-0.2, 0.1, 0.0, 0.0, 0.02]), DOWN)
    assert "0.02" in foreign(bent, "ros")
    with pytest.raises(BadInput, match="no k3"):
        foreign(bent, "kalibr")


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_opencv_s_own_files_are_read(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"camera.{suffix}"
    store = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    store.write("image_width", 640)
    store.write("image_height", 480)
    store.write("camera_matrix", np.array([[510.25, 0, 318.75], [0, 511.5, 243.125], [0, 0, 1]]))
    store.write("distortion_coefficients", np.array(BENT)[:, None])
    store.release()
    assert read_camera(path) == CAMERA


PRINTED = """header:
  stamp:
    sec: 0
height: 480
width: 640
distortion_model: plumb_bob
{d}: {coefficients}
{k}: [510.25, 0.0, 318.75, 0.0, 511.5, 243.125, 0.0, 0.0, 1.0]
binning_x: {binned}
---
"""


def test_a_camera_info_is_read_as_ros_prints_its_message(tmp_path: Path) -> None:
    path, lines = tmp_path / "camera.yaml", "".join(f"\n- {k}" for k in BENT)
    path.write_text(2 * PRINTED.format(d="d", coefficients=lines, k="k", binned=0))
    assert read_camera(path) == CAMERA
    assert ["it has no mount" in line for line in mount_assumed(path)] == [True]
    path.write_text(PRINTED.format(d="D", coefficients=list(BENT), k="K", binned=0))
    assert read_camera(path) == CAMERA
    path.write_text(PRINTED.format(d="D", coefficients=list(BENT), k="K", binned=2))
    with pytest.raises(BadInput, match="binned"):
        read_camera(path)


@pytest.mark.parametrize("lens", ["equidistant", "rational_polynomial"])
def test_another_lens_is_read_or_fitted_to_half_a_pixel(lens: str, tmp_path: Path) -> None:
    k = [-0.012, 0.004, -0.001, 0.0002] if lens == "equidistant" else [0.1, 0.02, 0.0004, -0.0003, 0.01, 0.3, 0.02, 0.01]
    path = tmp_path / "camera.yaml"
    path.write_text(KALIBR.format(model="pinhole", lens=lens, k=k, size="[640, 480]"))
    camera = read_camera(path)
    matrix = np.array([[500.0, 0, 320.0], [0, 501.0, 240.0], [0, 0, 1]])
    uv = np.stack(np.meshgrid(np.linspace(5, 634, 9), np.linspace(5, 474, 7)), axis=2).reshape(-1, 1, 2)
    end, eye = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-9), np.eye(3)
    if lens == "equidistant":
        rays = cv2.fisheye.undistortPoints(uv, matrix, np.array(k)).reshape(-1, 2)
    else:
        rays = cv2.undistortPointsIter(uv, matrix, np.array(k), eye, eye, end).reshape(-1, 2)
    assert np.abs(camera.rays(uv.reshape(-1, 2)) - rays).max() * 500.0 < (1e-6 if lens == "equidistant" else 1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (KALIBR.format(model="pinhole", lens="equidistant", k=[-0.5, 0.0, 0.0, 0.0], size="[640, 480]"), "folds the image"),
        (KALIBR.format(model="pinhole", lens="equidistant", k=[0.1, 0.0, 0.0, 0.0, 0.2], size="[640, 480]"), "four coefficients"),
        (KALIBR.format(model="omni", lens="radtan", k=[0, 0, 0, 0], size="[640, 480]"), "camera_model 'omni' is not read"),
        (KALIBR.format(model="pinhole", lens="fov", k=[0.9], size="[640, 480]"), "distortion_model 'fov' is not read"),
        (KALIBR.format(model="pinhole", lens="radtan", k=[0.0, 0.0, 0.0, 0.0], size="[]"), "size of the frames"),
        ("image_width: 640\nimage_height: 480\n", "no camera matrix"),
        ("width: 640\nheight: 480\nK: [500.0, 501.0, 320.0, 240.0]\nD: [0.02, -0.03, 0.01, 0.002]\n", "may be a fisheye's"),
        (PRINTED.format(d="d", coefficients=[0.0] * 5, k="k", binned=0).replace("---", "roi:\n  x_offset: 32\n---"), "a part of"),
        (KALIBR.format(model="pinhole", lens="radtan", k=[0, 0, 0, 0], size="[640, 480]").replace("[500.0", "[.nan"), "camera"),
        ("a: [1, 2\n", "camera"),
        ("# oST version 5.0 parameters\n\n[image]\n\nwidth\n640\n", "give the YAML file"),
    ],
)  # fmt: skip
def test_what_is_lacking_is_named(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(BadInput, match=said):
        read_camera(path)


def test_controls_are_numbers_truth_values_or_labels() -> None:
    text = " a=1 , b = true,c=false, d=-5, e=60 Hz "
    assert CameraOptions(controls=text).control_values() == {"a": 1, "b": True, "c": False, "d": -5, "e": "60 Hz"}
    assert CameraOptions().control_values() == {}


async def test_frames_are_the_cameras_and_the_rest_is_the_vehicles(tmp_path: Path) -> None:
    path = film(tmp_path / "deck.mp4", 10 * [np.full((48, 64, 3), 90, np.uint8)], rate=50)
    vehicle = FakeVehicle()
    options = CameraOptions(source="stream", device=str(path))
    async with asyncio.timeout(60), with_camera(vehicle.open, options, (64, 48), SystemClock())() as link:
        frame = await link.frames.get()
        assert frame.px.shape == (48, 64, 3)
        vehicle.samples.offer(range_down(1.0, 2.0))
        sample = await link.samples.get()
        assert isinstance(sample, Range)
        link.command(Hover())
    assert vehicle.commands == [Hover()]
    assert vehicle.left_hovering == 1


@pytest.mark.parametrize("missing", ["rpy_body_cam_deg", "fx"])
def test_a_camera_without_its_turn_on_the_body_is_refused(missing: str) -> None:
    keys = {"width": 640, "height": 480, "fx": 510.0, "fy": 510.0, "cx": 319.5, "cy": 239.5, "rpy_body_cam_deg": [0.0, 0.0, 90.0]}
    assert Camera.from_mapping(keys).T_body_cam.R.matrix == pytest.approx(DOWN.R.matrix)
    with pytest.raises(BadInput, match=f"key '{missing}' is missing" + (r"; \[0.0, 0.0, 90.0\]" if missing[0] == "r" else "$")):
        Camera.from_mapping({key: value for key, value in keys.items() if key != missing})


def test_a_lens_that_nobody_measured_is_named() -> None:
    settings, shipped = load("raspberry_ardupilot"), SHIPPED / "cameras/usb_640x480.toml"
    line = "distances may be 5 % off: decklander calibrate camera"
    assert [line in said for said in lens_assumed(read_camera(shipped))] == [True]
    assert any(line in said for said in remarks(settings))
    assert any(line in said for said in files_of(settings).lens_assumed)
    assert lens_assumed(CAMERA) == ()
