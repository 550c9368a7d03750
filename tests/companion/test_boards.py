"""Boards of other programs: read by their own rules, found where these see them, and refused by what is wrong."""

import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from companion.cli.main import main
from companion.settings.load import pad_of_file
from estimator.contracts.estimates import Sighting
from estimator.contracts.samples import Attitude, Frame
from estimator.vision.options import TrackerOptions
from estimator.vision.pad.pad import Pad
from estimator.vision.track.config import TrackerConfig
from estimator.vision.track.memory import TrackerMemory
from estimator.vision.track.tracker import track
from sitl.camera.camera import Exposure, Renderer
from tests.sitl.images import PLAIN, shot
from tests.support.pad_images import STAMP

K = np.array([(PLAIN.fx, 0.0, PLAIN.cx), (0.0, PLAIN.fy, PLAIN.cy), (0.0, 0.0, 1.0)])
PLACES = [(3, 0.15, 0.12, 0.20, 0), (8, -0.20, 0.15, 0.16, 90), (21, -0.05, -0.20, 0.25, 0), (14, 0.20, -0.10, 0.08, 180)]
"""Id, middle to the right and up, side, turn against the clock."""

PEER = """
import cv2, json, os, pupil_apriltags, sys
tags = pupil_apriltags.Detector(families=sys.argv[1], quad_decimate=1.0).detect(cv2.imread(sys.argv[2], cv2.IMREAD_GRAYSCALE))
print(json.dumps({tag.tag_id: tag.corners.tolist() for tag in tags}), flush=True)
os._exit(0)
"""
"""AprilTag's library in a process of its own: when its detector ends, it frees its families twice."""


def corners_of(x: float, y: float, size: float, turn_deg: float) -> np.ndarray:
    """Return a tag's corners (4, 3) m in its board's frame, from its own lower left one against the clock."""
    turn = np.exp(1j * math.radians(turn_deg)) * 0.5 * size * np.array([-1 - 1j, 1 - 1j, 1 + 1j, -1 + 1j])
    return np.stack([x + turn.real, y + turn.imag, np.zeros(4)], axis=1)


def tags_yaml(tags: str = "", rest: str = "") -> str:
    turns = [(*at, math.radians(turn) / 2) for *at, turn in PLACES]
    layout = [f"{{id: {i}, size: {m}, x: {x}, y: {y}, qw: {math.cos(a)}, qz: {math.sin(a)}}}" for i, x, y, m, a in turns]
    return f"tag_bundles:\n  [{{name: deck, layout: [{tags or ', '.join(layout)}]}}]\n{rest}"


def landmark(y_up: float = 1.0, **keys: Any) -> str:
    """Return a file in Landmark's form: corners from the upper left one clockwise."""
    made = [(i, corners_of(x, y, size, turn)[::-1] * (1.0, y_up, 1.0)) for i, x, y, size, turn in PLACES]
    markers = [{"family": "tag36h11", "id": i, "size_mm": 1.0, "object_points": at.tolist()} for i, at in made]
    markers[1] |= keys
    return json.dumps({"target_num": 0, "markers": markers})


def imported(folder: Path, name: str, text: str, *more: str) -> Pad:
    (folder / name).write_text(text)
    assert main(["pad", "import", str(folder / name), "--out", str(folder / "pad.toml"), *more]) == 0
    return pad_of_file(folder / "pad.toml")


def picture(pad: Pad) -> tuple[Exposure, np.ndarray]:
    exposure = shot(1.2, (0.03, -0.02), (0.1, -0.12, 0.6))
    return exposure, Renderer(PLAIN, pad).render(exposure, np.random.default_rng(1))


def found(pad: Pad, exposure: Exposure, px: np.ndarray) -> Sighting:
    attitude = Attitude(STAMP, exposure.R_ned_body, 1e-6 * np.eye(3))
    config = TrackerConfig(PLAIN, pad, TrackerOptions(method="registration"))
    seen = track(config, TrackerMemory(), Frame(STAMP, 0, px), attitude)[0].selected
    assert seen is not None
    assert seen.confidence > 0.9
    return seen


def by_points(board: list[np.ndarray], seen: list[np.ndarray]) -> tuple[np.ndarray, float]:
    """Return a board's origin in the camera's frame by its joint pose, as its own program works it out, and the worst pixel."""
    at, uv = np.concatenate(board), np.concatenate(seen).astype(float)
    ok, rvec, tvec = cv2.solvePnP(at, uv, K, PLAIN.distortion, flags=cv2.SOLVEPNP_IPPE)
    assert ok
    return tvec.ravel(), float(np.linalg.norm(cv2.projectPoints(at, rvec, tvec, K, PLAIN.distortion)[0][:, 0] - uv, axis=1).max())


def check_same(pad: Pad, exposure: Exposure, px: np.ndarray, board: list[np.ndarray], seen: list[np.ndarray]) -> None:
    origin, worst_px = by_points(board, seen)
    ours = found(pad, exposure, px)
    d_ned = exposure.p_pad_ned - exposure.p_body_ned
    centre = PLAIN.T_body_cam.inv @ (exposure.R_ned_body.inv @ d_ned)
    assert worst_px < 2.0  # a tag that lies half a turn round is 20 px off or more
    assert origin == pytest.approx(centre, abs=0.02)
    assert math.hypot(*ours.d_body_pad_level) == pytest.approx(math.hypot(*d_ned), abs=0.002)


@pytest.mark.parametrize("family", ["tag36h11", "tag25h9", "tag16h5"])
def test_a_bundle_lies_where_apriltag_s_own_library_sees_it(tmp_path, family, capsys):
    """The library of apriltag_ros reads the painted pad; its bundle's pose is of the corners that tags.yaml itself says."""
    text = tags_yaml(rest="standalone_tags: [{id: 90, size: 0.3}]\n")
    pad = imported(tmp_path, "tags.yaml", text, "--target", "deck", "--family", family, "--size-mm", "900x950")
    assert "only 'deck' is taken" in capsys.readouterr().out
    exposure, px = picture(pad)
    cv2.imwrite(str(tmp_path / "seen.png"), px)
    done = subprocess.run([sys.executable, "-c", PEER, family, tmp_path / "seen.png"], check=True, capture_output=True)
    read = {int(i): np.array(at) for i, at in json.loads(done.stdout).items()}
    check_same(pad, exposure, px, [corners_of(*at) for _, *at in PLACES], [read[i] for i, *_ in PLACES])


@pytest.mark.parametrize("y_up", [1.0, -1.0])
def test_a_landmark_board_lies_where_opencv_reads_it(tmp_path: Path, y_up: float, capsys: pytest.CaptureFixture[str]) -> None:
    pad = imported(tmp_path, "landing-target.json", landmark(y_up))
    assert "0.9 x 1.0" in capsys.readouterr().out
    exposure, px = picture(pad)
    corners, ids, _ = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)).detectMarkers(px)
    read = {int(i): at[0] for i, at in zip(ids.ravel(), corners, strict=True)}
    check_same(pad, exposure, px, [corners_of(*at)[::-1] for _, *at in PLACES], [read[i] for i, *_ in PLACES])


def test_a_node_of_ros_2_is_one_tag_and_a_board_is_turned_as_it_was_painted(tmp_path: Path) -> None:
    node = "/**:\n  ros__parameters:\n    family: 16h5\n    size: 0.2\n    tag: {ids: [4, 9], sizes: [0.3, 0.1]}\n"
    for target, more, wanted in (("tag_9", (), (9, 0.1, 180.0)), ("tag_4", ("--tags-turned",), (4, 0.3, 0.0))):
        tag = imported(tmp_path, "node.yaml", node, "--target", target, *more, "--force").regions[1]
        assert (tag.dictionary, tag.id, tag.size_m, tag.turn_deg) == ("DICT_APRILTAG_16h5", *wanted)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.json", "", "it is empty"),
        ("a.json", "[" * 100_000, "no landing-target.json"),
        ("a.json", '{"markers": []}', "it has no tags"),
        ("a.json", landmark().replace("0.25", "NaN").replace("0.075", "NaN"), "no landing-target.json"),
        ("a.json", landmark(id=3), "there already"),
        ("a.json", landmark(id=900), "id must be 0 to 586"),
        ("a.json", landmark(family="tagStandard41h12"), "are not read: OpenCV has"),
        ("a.json", landmark(object_points=[[0, 0, 0.1]] * 4), "off the plane"),
        ("a.json", landmark(object_points=[[0, 0, 0]] * 3), "four corners"),
        ("a.json", landmark(object_points=[[1e300, 0, 0]] * 4), "up to 20 m"),
        ("a.json", landmark(object_points=[[0, 0, 0], [1, 0, 0], [0, -1, 0], [1, -1, 0]]), "no square's corners"),
        ("a.json", landmark(object_points=[[0, 0, 0], [0, -0.1, 0], [0.1, -0.1, 0], [0.1, 0, 0]]), "mirror"),
        ("a.yaml", "", "it is empty"),
        ("a.yaml", "standalone_tags: [{id: 1, size: 0.1}", "no YAML"),
        ("a.yaml", "a: &a [*a]", "no YAML"),
        ("a.yaml", "standalone_tags: [{id: 1}]", "missing required field `size`"),
        ("a.yaml", "standalone_tags: [{id: 1, size: 0.1}, {id: 1, size: 0.2}]", "one name"),
        ("a.yaml", "standalone_tags: [{id: 1, size: 0.1}, {id: 2, size: 0.2}]", "--target"),
        ("a.yaml", tags_yaml("{id: 1, size: .nan}"), "size nan m"),
        ("a.yaml", tags_yaml("{id: 1, size: -0.2}"), "size -0.2 m"),
        ("a.yaml", tags_yaml("{id: 1, size: 200}"), "size 200 m"),
        ("a.yaml", tags_yaml("{id: 1, size: 0.2, y: .inf}"), "at (0, inf) m"),
        ("a.yaml", tags_yaml("{id: 1, size: 0.2}, {id: 2, size: 0.2, x: 0.1}"), "move them apart"),
        ("a.yaml", tags_yaml("{id: 1, size: 0.2, z: 0.05}"), "z is 0.05 m, off the plane"),
        ("a.yaml", tags_yaml("{id: 1, size: 0.2, qx: 0.1}"), "tilted by 11.4 degrees"),
        ("a.yaml", tags_yaml("{id: 1, size: 0.2, qz: 0.1}"), "quarter turns alone"),
        ("a.yaml", tags_yaml("{id: 1, size: 0.2, qw: 0}"), "its quaternion is none"),
        ("a.yaml", "/**: {ros__parameters: {family: 36h11, size: 1, tag: {ids: [1, 2], sizes: [1]}}}", "no tags.yaml"),
    ],
)  # fmt: skip
def test_a_board_that_is_wrong_is_refused_in_one_line(tmp_path, name, text, said, capsys):
    (tmp_path / name).write_text(text)
    assert main(["pad", "import", str(tmp_path / name), "--out", str(tmp_path / "pad.toml")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "pad.toml").exists()
