"""`decklander detect` on images, folders and videos; what it prints and what it refuses."""

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from companion.cli.main import main
from companion.recording.palette import bgr, colour
from companion.recording.reading import RecordedFrame, open_recording
from estimator.vision.track.tracker import PadTracker
from sitl.camera.camera import Renderer
from tests.sitl.images import PLAIN, shot
from tests.support.image_files import claiming, film
from tests.support.pad_images import PadPlacement, image, project
from tests.support.shipped import shipped_camera, shipped_pad

KEYS = ["source", "index", "found", "confidence", "d_body_pad_level_m", "yaw_deg", "yaw_ambiguous", "cov", "method", "methods"]
SCENE = PadPlacement((0.35, -0.15, 1.4), math.radians(40.0), math.radians(3.0), math.radians(-2.0))
GOLDEN = Path(__file__).parents[1] / "golden/frames.mcap"


@pytest.fixture(scope="module")
def album(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with two images of the pad, one of nothing, and a note that is no image."""
    folder = tmp_path_factory.mktemp("album")
    camera, pad = shipped_camera("sim"), shipped_pad("thesis")
    cv2.imwrite(str(folder / "a.png"), image(SCENE, camera, pad, blur_px=0.6, noise=1.5).px)
    cv2.imwrite(str(folder / "b.png"), image(PadPlacement((0.15, 0.0, 0.5)), camera, pad, blur_px=0.6).px)
    cv2.imwrite(str(folder / "c.png"), np.full((360, 640, 3), 80, np.uint8))
    (folder / "notes.txt").write_text("no image\n")
    return folder


def detect(*words: str | Path) -> int:
    return main(["detect", *map(str, words)])


def records(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_one_object_a_frame_with_the_promised_keys(album: Path, capsys: pytest.CaptureFixture[str]) -> None:
    thesis = ("--method", "fused", "--colours", "simulator")
    assert detect(album, "--camera", "sim", "--pad", "thesis", *thesis, "--json") == 0
    a, b, c = records(capsys)
    for record in (a, b, c):
        assert [key for key in record if key in (*KEYS, "elapsed_ms")] == [*KEYS, "elapsed_ms"]
        assert list(record["methods"]) == ["ellipse", "arrow", "corners", "registration"]
        assert float(record["elapsed_ms"]) > 0
    assert [Path(str(r["source"])).name for r in (a, b, c)] == ["a.png", "b.png", "c.png"]
    assert [r["found"] for r in (a, b, c)] == [True, True, False]
    assert a["method"] == b["method"] == "fused"
    assert all(a["methods"][name] is not None for name in ("arrow", "registration"))
    assert a["yaw_deg"] == pytest.approx(40.0, abs=4.0)
    assert len(a["cov"]) == 16
    assert np.allclose(np.reshape(a["cov"], (4, 4)), np.reshape(a["cov"], (4, 4)).T)
    assert a["methods"]["ellipse"]["yaw_deg"] is None
    assert np.ptp([a["methods"][name]["centre_px"] for name in ("ellipse", "arrow", "registration")], axis=0).max() < 2.0
    assert b["methods"]["corners"]["yaw_ambiguous"] is True
    assert (c["d_body_pad_level_m"], c["yaw_deg"], c["cov"], c["method"], c["confidence"]) == (None, None, None, None, 0.0)
    assert set(c["methods"].values()) == {None}


def test_by_default_it_runs_what_flies(album: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The sighting is the tracker's own, to the last digit printed; the thesis' methods did not run.

    The centre and the outlines lie where the image shows them, although the tilt, which moves the pad by 24 px, is not known.
    """
    assert detect(album / "a.png", "--camera", "sim", "--draw", tmp_path / "drawn.png", "--json") == 0
    (shown,) = records(capsys)
    px, inked = (np.asarray(cv2.imread(str(path)), np.uint8) for path in (album / "a.png", tmp_path / "drawn.png"))
    camera, pad = shipped_camera("sim"), shipped_pad("thesis")
    flown = PadTracker(camera, pad).track(px)
    assert shown["d_body_pad_level_m"] == [round(v, 6) for v in flown.d_body_pad_level.tolist()]
    assert shown["cov"] == flown.cov.ravel().tolist()
    assert (shown["method"], shown["colours"]) == ("registration", None)
    assert [name for name, of in shown["methods"].items() if of is not None] == ["registration"]
    centre, *disc = project(np.r_[np.zeros((1, 3)), pad.circle(pad.disc_radius_m, 720)], SCENE, camera)
    assert shown["centre_px"] == pytest.approx(centre, abs=0.5)
    outline = next(np.array(part["uv_px"]) for part in shown["outline_px"] if part["label"] == "disc")
    assert np.linalg.norm(outline[:, None] - disc, axis=2).min(axis=1).max() < 1.0
    for u, v in np.rint(2.0 * np.array([centre, disc[0], disc[360]]) + 0.5).astype(int):
        assert np.abs(inked[v - 2 : v + 3, u - 2 : u + 3] - np.array(bgr(colour("registration")))).max(axis=2).min() < 70


def test_a_recording_brings_its_camera_its_pad_and_its_attitudes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = [e for e in open_recording([GOLDEN]).events() if isinstance(e, RecordedFrame) and e.image is not None]
    assert detect(GOLDEN, "--json") == 0
    found = records(capsys)
    assert len(found) == len(kept) > 3
    assert all(r["found"] for r in found)
    first, d = kept[0].record.selected, found[0]["d_body_pad_level_m"]
    assert d == pytest.approx(first.d_body_pad_level, abs=0.03)
    assert detect(GOLDEN, "--camera", "sim", "--draw", tmp_path / "seen") == 0
    assert (tmp_path / "seen/frames_00000.png").is_file()
    bare = tmp_path / "bare.mcap"
    assert main(["record", "cut", str(GOLDEN), "--no-frames", "--output", str(bare)]) == 0
    capsys.readouterr()
    assert detect(bare) == 2
    assert "but none of their images" in capsys.readouterr().err


def test_attitudes_take_the_tilt_out(album: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """3 and 2 degrees move the pad by 9 cm at 1.4 m. Without attitude the drawing's slant tells most; the covariance holds."""
    table = tmp_path / "attitude.csv"
    table.write_text("source,roll_deg,pitch_deg\na.png, 3.0, -2.0\n")
    common = (album / "a.png", "--camera", "sim", "--json")
    assert detect(*common, "--attitude", table, "--attitude-sigma-deg", "0.1") == 0
    assert detect(*common) == 0
    reported, assumed = records(capsys)
    true = np.array(SCENE.d_body_pad_level)
    d_told, d_assumed = np.array(reported["d_body_pad_level_m"]), np.array(assumed["d_body_pad_level_m"])
    assert np.linalg.norm(d_told - true) < 0.006 < np.linalg.norm(d_assumed - true) < 0.09
    cov = np.reshape(assumed["cov"], (4, 4))[:3, :3]
    assert (d_assumed - true) @ np.linalg.solve(cov, d_assumed - true) < 11.3
    assert detect(album / "b.png", *common, "--attitude", table) == 0
    assert f"{table} has no row for 1 of 2 frames, taken as level: " in capsys.readouterr().err


def test_a_video_is_read_frame_by_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera, pad = shipped_camera("sim"), shipped_pad("thesis")
    heights = [1.5, 1.4, 1.3, 1.2]
    views = [image(PadPlacement((0.15, 0.0, z), 0.4), camera, pad, blur_px=0.6).px for z in heights]
    path = film(tmp_path / "flight.mp4", views, rate=30, crf="16", preset="ultrafast")
    assert detect(path, "--camera", "sim", "--json") == 0
    seen = records(capsys)
    assert [r["index"] for r in seen] == [0, 1, 2, 3]
    down = [r["d_body_pad_level_m"][2] for r in seen if r["found"]]
    assert down == pytest.approx(heights, rel=0.02)


def test_lines_for_people_and_images_of_what_was_seen(album: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawn = tmp_path / "drawn" / "here"
    assert detect(album, "--camera", "sim", "--draw", drawn) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [lines[n].split()[:2] for n in (0, 1, 3)] == [["source", "method"], ["a.png", "registration"], ["c.png", "nothing"]]
    assert lines[-1] == "found in 2 of 3 frames"
    assert detect(album / "c.png", "--camera", "sim") == 1
    assert sorted(p.name for p in drawn.iterdir()) == ["a_00000.png", "b_00000.png", "c_00000.png"]
    (twice := tmp_path / "twice").mkdir()
    for name in ("a.jpg", "a.png", "a10.png", "a9.png"):
        cv2.imwrite(str(twice / name), cv2.imread(str(album / "a.png")))
    assert detect(twice, "--camera", "sim", "--draw", twice / "drawn") == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[-5:-1]] == ["a.jpg", "a.png", "a9.png", "a10.png"]
    assert {"a.jpg_00000.png", "a.png_00000.png", "a9_00000.png"} < {p.name for p in (twice / "drawn").iterdir()}
    for paths, place, said in (
        ([album], tmp_path / "one.png", "one.png: an image file takes one image only: name a folder"),
        ([album / "a.png"], album / "a.png", "which is read"),
        ([album], album, "none of them is overwritten"),
        ([album / "b.png"], drawn, "b_00000.png: there is a file of that name already: --force replaces it"),
        ([album / "a.png", twice / "a.png"], drawn, "two files to search differ in their folder only"),
    ):
        assert detect(*paths, "--camera", "sim", "--draw", place) == 2
        assert said in capsys.readouterr().err


def test_a_mirrored_camera_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    px = Renderer(PLAIN, shipped_pad("aruco_board")).render(shot(1.2), np.random.default_rng(3))
    for name, seen in (("plain", px), ("mirrored", px[:, ::-1])):
        cv2.imwrite(str(tmp_path / f"{name}.png"), seen)
        detect(tmp_path / f"{name}.png", "--camera", "sim", "--pad", "aruco_board", "--json")
        out, err = capsys.readouterr()
        assert (json.loads(out)["confidence"] >= 0.5) == (name == "plain")
        assert ("mirror" in err) == (name == "mirrored")


def test_a_broken_image_is_named_and_the_others_are_done(album: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / "torn.jpg"
    broken.write_bytes(b"\xff\xd8\xff\xe0 torn")
    assert detect(broken, album / "a.png", "--camera", "sim", "--json") == 2
    out, err = capsys.readouterr()
    assert (len(out.splitlines()), len(err.splitlines())) == (1, 1)
    assert "torn.jpg" in err


def test_what_flight_refuses_is_not_found_and_another_size_ends_nothing(album, tmp_path, capsys):
    whole = cv2.imread(str(album / "a.png"))
    for name, px in (("crop", whole[:200]), ("whole", whole), ("blurred", cv2.blur(whole, (1, 31)))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), px)
    assert detect(tmp_path, "--camera", "sim", "--json") == 2
    out, err = capsys.readouterr()
    found = {Path(one["source"]).stem: one for one in map(json.loads, out.splitlines())}
    assert list(found) == ["blurred", "whole"]
    assert "crop.png: 640x200 px" in err
    assert found["whole"]["found"]
    assert all(one["found"] == (one["confidence"] >= 0.2) for one in found.values())


def test_both_opinions_are_printed_where_a_second_one_is_used(album: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = (album / "a.png", "--camera", "sim")
    assert detect(*asked, "--json") == detect(*asked, "--second-opinion", "--json") == 0
    alone, both = records(capsys)
    assert alone["opinions"] is None
    assert both["opinions"]["verified"] > 0.9
    assert both["opinions"]["learned"] > 0.9
    assert detect(*asked, "--second-opinion") == 0
    assert "  verified 1.00, learned " in capsys.readouterr().out
    assert detect(*asked, "--second-opinion", "none.onnx") == 2
    assert capsys.readouterr().err.startswith("decklander: --second-opinion: none.onnx: No such file or directory: name a file")


@pytest.fixture
def no_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object) -> None:
        raise AssertionError("the decoder was asked")

    monkeypatch.setattr(cv2, "imdecode", never)
    monkeypatch.setattr(cv2, "imread", never)


@pytest.mark.usefixtures("no_decoder")
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_detect_and_calibrate_name_the_image_and_its_claim(tmp_path, capsys, suffix):
    side, path = 30000, tmp_path / f"bomb{suffix}"
    path.write_bytes(claiming(suffix, side, side))
    assert path.stat().st_size < 1000
    for words, output in (
        (["detect", str(path), "--camera", "sim"], f"{side}x{side} px, but"),
        (
            ["calibrate", "camera", str(path), "--out", str(tmp_path / "camera.toml")],
            f"{side}x{side} px, expected at most 67 million pixels",
        ),
    ):
        assert main(words) == 2
        err = capsys.readouterr().err.strip().splitlines()
        assert len([line for line in err if "bomb" in line]) == 1
        assert output in "".join(err)
        assert "Traceback" not in "".join(err)


@pytest.mark.usefixtures("no_decoder")
def test_a_recorded_image_of_another_size_than_the_camera_s_is_not_decoded() -> None:
    recorded = next(e for e in open_recording([GOLDEN]).events() if isinstance(e, RecordedFrame) and e.image is not None)
    bomb = RecordedFrame(recorded.record, claiming(".png", 30000, 30000))
    assert bomb.frame((640, 360)) is None
