"""Settings of other landing programs become ours: links, camera, tag; what was not taken is said, and nonsense refused."""

import json
from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main
from companion.settings.load import camera_model, load, pad_model
from drivers.mavlink.options import autopilot_of
from estimator.vision.pad.fiducial import PaintedFiducial

CONF = """[Defaults]
connect=udp:127.0.0.1:14572
markersize=0.5
sizemapping=11:0.446,16:0.204
markerdict=TAG16h5
calibration=cam.yml
fps=25
estimator=0 # 0=Raw, 1=EKF
"""
CAMERA = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix {rows: 3, cols: 3, dt: d, data: [500., 0., 320., 0., 501., 240., 0., 0., 1.]}
distortion_coefficients: !!opencv-matrix {rows: 1, cols: 5, dt: d, data: [0.1, 0., 0., 0., 0.]}
"""
VIEW = {"camera_type": "siyi-a8", "rtsp": "rtsp://192.168.144.25:8554/main.264", "horizontal_fov": 81}


def mackay(**keys: Any) -> str:
    return json.dumps({"last_used": VIEW, "apriltag": {"family": "tag25h9", "target_id": 5}, "mavlink": {"sysid": 3}} | keys)


def wingxtra(**keys: Any) -> str:
    camera = {"kind": "v4l2", "source": "/dev/video2", "fps": 20, "width": 1280} | keys
    output = {"listen_host": "127.0.0.1", "listen_port": 14771, "target_system": 7}
    return json.dumps({"schema_version": 1, "camera": camera, "output": output, "mount": {}, "startup_mode": "monitor"})


@pytest.mark.parametrize(
    ("name", "text", "vehicle", "camera", "tag", "left"),
    [
        ("v.conf", CONF, ("udpin://127.0.0.1:14572", 0), ("v4l2", "/dev/video0", 25.0), ("16h5", 11, 0.446), "of [16] is not"),
        ("m.json", mackay(), ("tcp://127.0.0.1:5777", 3), ("stream", VIEW["rtsp"], 30.0), ("25h9", 5, 0.2), "horizontal_fov"),
        ("w.json", wingxtra(kind="picamera2"), ("udpin://127.0.0.1:14771", 7), ("libcamera", "", 20.0), None, "startup_mode"),
    ],
)  # fmt: skip
def test_settings_are_ours_and_good(tmp_path: Path, capsys, name: str, text: str, vehicle, camera, tag, left: str) -> None:
    (tmp_path / name).write_text(text)
    (tmp_path / "cam.yml").write_text(CAMERA)
    more = ["--tag-mm", "200"] if name == "m.json" else []
    assert main(["config", "import", str(tmp_path / name), "--out", str(tmp_path / "rig.toml"), *more]) == 0
    assert left in capsys.readouterr().out
    assert main(["config", "check", str(tmp_path / "rig.toml")]) == 0
    made = load(tmp_path / "rig.toml")
    autopilot = autopilot_of(made.vehicle)
    assert (autopilot.links, autopilot.system_id) == vehicle
    assert (made.camera.source, made.camera.device, made.camera.rate_hz) == camera
    assert (camera_model(made).fx == 500.0) is (name == "v.conf")
    tags = [r for r in pad_model(made).regions if isinstance(r, PaintedFiducial)]
    assert [(r.dictionary, r.id, r.size_m) for r in tags] == ([(f"DICT_APRILTAG_{tag[0]}", *tag[1:])] if tag else [])


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("v.conf", "", "'Defaults'"),
        ("v.conf", "connect=1", "no section headers"),
        ("v.conf", CONF.replace("udp:", "wifi:"), "connect 'wifi:127"),
        ("v.conf", CONF.replace("0.446", "nan"), "size nan m"),
        ("v.conf", CONF.replace("25", "nan"), "rate_hz must be"),
        ("v.conf", CONF + "fps=2\n", "already exists"),
        ("v.conf", CONF.replace("TAG16h5", "CHILITAGS"), "are not read"),
        ("v.conf", CONF.replace("11:", "99:"), "id must be 0 to 29"),
        ("m.json", "{}", "'last_used'"),
        ("m.json", "[" * 100_000, "no settings that are read"),
        ("m.json", mackay(mavlink={"sysid": 3000}), "system_id must be"),
        ("m.json", mackay(last_used=3), "no settings that are read"),
        ("w.json", wingxtra(kind="carrier pigeon"), "'carrier pigeon'"),
        ("w.json", wingxtra(fps=-1), "rate_hz must be"),
    ],
)
def test_settings_that_are_none_are_refused_and_nothing_is_left(tmp_path: Path, capsys, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    more = ["--tag-mm", "200"] if name == "m.json" else []
    assert main(["config", "import", str(tmp_path / name), "--out", str(tmp_path / "rig.toml"), *more]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == [name]
