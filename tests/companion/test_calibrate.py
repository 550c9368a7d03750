"""Calibration on images rendered by a known camera: what is recovered, what is refused and in which words."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from companion.cli.main import main
from companion.tools.calibrate import assess
from companion.tools.calibrate.board import Board
from companion.tools.calibrate.guide import Guide, GuideState, add_file, watch
from companion.tools.calibrate.solve import distance_errors, solve
from companion.tools.calibrate.views import BoardView, Collection
from drivers.camera.options import CameraOptions
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.geometry import Rotation
from estimator.vision.camera import Camera
from tests.support.calibration_images import Studio, good_round, lens

CHARUCO = Board()
CHESSBOARD = Board("chessboard", 8, 5, 0.025)
APRILGRID = Board("aprilgrid", 4, 3, 0.052, 0.04)
BENT = lens(480, 320, 350.0, (-0.14, 0.07, 0.0009, -0.0006, 0.0))
STRAIGHT = lens(480, 320, 390.0, (0.0, 0.0, 0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Images of a good round, by board."""
    out: dict[str, Path] = {}
    for board, camera, distance_m, inset, middle in (
        (CHARUCO, BENT, 0.30, (0.14, 0.2), 0.65),
        (CHESSBOARD, STRAIGHT, 0.70, (0.15, 0.22), 0.5),
        (APRILGRID, BENT, 0.30, (0.14, 0.2), 0.65),
    ):
        folder = out[board.kind] = tmp_path_factory.mktemp(board.kind)
        for i, px in enumerate(good_round(Studio(camera, board), distance_m, inset, middle)):
            cv2.imwrite(str(folder / f"{i:02d}.png"), px)
    return out


def worst_px(found: Camera, true: Camera) -> float:
    """Largest distance between where both see the same directions, all over the image."""
    u, v = np.meshgrid(np.linspace(0, true.width - 1, 25), np.linspace(0, true.height - 1, 17))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = np.concatenate([true.rays(uv), np.ones((len(uv), 1))], axis=1)
    return float(np.linalg.norm(found.project(rays) - uv, axis=1).max())


@pytest.mark.parametrize(
    ("kind", "true", "more"),
    [
        ("charuco", BENT, []),
        ("chessboard", STRAIGHT, ["--board", "chessboard", "--squares", "8x5"]),
        ("aprilgrid", BENT, ["--board", "aprilgrid", "--squares", "4x3", "--square-mm", "52", "--marker-mm", "40"]),
    ],
)
def test_a_known_camera_is_recovered(folders, tmp_path, capsys, kind, true, more):
    out = tmp_path / "camera.toml"
    figures = tmp_path / "figures"
    code = main(
        ["calibrate", "camera", str(folders[kind]), "--out", str(out), "--figures", str(figures), "--json",
         "--position-m", "0.1,0,0.02", *more]
    )  # fmt: skip
    output = json.loads(capsys.readouterr().out)
    assert output["missing"] == []
    assert (code, output["good"], output["views"]) == (0, True, 15)
    found = Camera.from_mapping(tomllib.loads(out.read_text()))
    assert (found.width, found.height) == (true.width, true.height)
    assert found.fx == pytest.approx(true.fx, rel=3e-3)
    assert found.fy == pytest.approx(true.fy, rel=3e-3)
    assert abs(found.cx - true.cx) < 1.5
    assert abs(found.cy - true.cy) < 1.5
    for value, truth, sigma in zip((found.fx, found.fy), (true.fx, true.fy), output["sigma_fx_fy_cx_cy"][:2], strict=True):
        assert abs(value - truth) < 6 * sigma
    assert worst_px(found, true) < 1.0
    assert output["rms_px"] < 0.15
    assert np.allclose(found.T_body_cam.t, (0.1, 0.0, 0.02))
    for name in ("coverage.png", "residuals.png"):
        assert cv2.imread(str(figures / name)) is not None


def test_a_poor_set_is_refused_and_its_lacks_are_reported(folders, tmp_path, capsys):
    out = tmp_path / "camera.toml"
    few = [str(folders["charuco"] / f"{i:02d}.png") for i in (0, 1, 2, 3, 4, 5)]
    assert main(["calibrate", "camera", *few, "--out", str(out)]) == 1
    output = capsys.readouterr().out
    assert "4 more views (6 of 10)" in output
    assert "the board closer into the bottom right corner" in output
    assert "the board closer into the top left corner" not in output
    assert not out.exists()


def test_views_without_tilt_are_refused_for_it() -> None:
    studio = Studio(STRAIGHT, CHARUCO)
    collection = Collection(CHARUCO, moving=False)
    for i, (x, y) in enumerate([(0.5, 0.5), (0.2, 0.3), (0.8, 0.3), (0.2, 0.7), (0.8, 0.7)]):
        collection.add(f"{i}", studio.aim((x * 480, y * 320), 0.35 + 0.01 * i, (0.0, 2.0, 9.0 * i)))
    assert collection.size == (480, 320)
    found = assess.assess(solve(collection.views, CHARUCO, collection.size), collection.size)
    assert sum("tilted by 15 degrees" in lack for lack in found.uncovered) == 2
    assert found.grade == "poor"
    assert "flat ones cannot tell the focal length" in found.imprecise[0]


def held(camera: Camera, board: Board, tilt_deg: float, seed: int, reach: float = 0.2) -> list[BoardView]:
    """Corners of a board, with a tenth of a pixel of noise, tilted each time by up to some angle to either side."""
    rng, out = np.random.default_rng(seed), []
    middle = np.array([board.columns, board.rows, 0.0]) * board.square_m / 2
    for k in range(12):
        R = Rotation.from_rpy(*np.radians([*rng.uniform(-tilt_deg, tilt_deg, 2), rng.uniform(-60, 60)])).matrix
        ray = np.append(camera.rays(rng.uniform(0.5 - reach, 0.5 + reach, (1, 2)) * (camera.width, camera.height))[0], 1.0)
        uv = camera.project(board.corners_m @ R.T + 12.0 * board.square_m * rng.uniform(1.0, 1.6) * ray - R @ middle)
        out.append(BoardView(str(k), np.arange(len(uv)), uv + rng.normal(0.0, 0.1, uv.shape)))
    return out


@pytest.mark.hazard("H12")
@pytest.mark.parametrize("tilt_deg", [0.6, 30.0])
def test_what_a_calibration_says_of_itself_is_the_same_in_any_unit_and_true(tilt_deg: float) -> None:
    views = held(BENT, CHARUCO, tilt_deg, 5)
    one, large = (solve(views, Board(square_m=s, marker_m=0.7 * s), (480, 320)) for s in (0.025, 0.8))
    assert np.allclose(one.sigma, large.sigma, rtol=0.05)
    off = np.abs(distance_errors(one.camera, BENT))
    assert off.max() < one.distances_right_to * 1.5
    assert (one.distances_right_to < 0.006) == (tilt_deg > 1.0)
    assert (assess.assess(one, (480, 320)).grade == "poor") == (tilt_deg < 1.0)


@pytest.mark.hazard("H12")
def test_a_flat_set_is_written_by_force_alone_and_its_cost_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    studio, out = Studio(STRAIGHT, CHESSBOARD), tmp_path / "camera.toml"
    for i in range(4):
        px = studio.aim((200.0 + 15 * i, 180.0 - 8 * i), 0.55 + 0.02 * i, (0.6, -0.6, 7.0 * i))
        cv2.imwrite(str(tmp_path / f"{i}.png"), px)
    words = ["calibrate", "camera", str(tmp_path), "--board", "chessboard", "--squares", "8x5", "--out", str(out)]
    assert main([*words, "--accept", "fair"]) == 1
    assert "(--force writes it all the same)" in capsys.readouterr().out
    assert not out.exists()
    assert main([*words, "--force"]) == 0
    output = capsys.readouterr().out
    assert "at touchdown" in output or "Distances are not known" in output
    assert Camera.from_mapping(tomllib.loads(out.read_text())).focal_sigma > 0.02


def test_a_fisheye_is_recognized_and_recovered() -> None:
    straight = lens(480, 320, 220.0, (0.0,) * 5)
    k = np.array([-0.02, 0.004, -0.001, 0.0002])
    true = replace(straight, lens="fisheye", distortion=k)
    views = held(true, CHARUCO, 35.0, 7, 0.36)
    found = solve(views, CHARUCO, (480, 320), STRAIGHT.T_body_cam)
    assert found.model.startswith("fisheye")
    assert np.abs(distance_errors(found.camera, true)).max() < 1.5 * found.distances_right_to < 0.02


def test_a_set_that_only_lacks_a_corner_is_fair_and_written_when_that_is_accepted(folders, tmp_path, capsys):
    out = tmp_path / "camera.toml"
    size = (480, 320)
    kept = []
    for file in sorted(folders["charuco"].iterdir()):
        collection = Collection(CHARUCO, moving=False)
        collection.add(file.name, cv2.imread(str(file)))
        if not any("bottom right" in lack for lack in assess.missing_before(collection.views, size)):
            continue  # the only images that reach into that corner
        kept.append(str(file))
    assert len(kept) >= 10
    arguments = ["calibrate", "camera", *kept, "--out", str(out), "--json"]
    assert main(arguments) == 1
    refused = json.loads(capsys.readouterr().out)
    assert (refused["grade"], refused["good"], refused["file"]) == ("fair", False, None)
    assert refused["missing"] == ["the board closer into the bottom right corner"]
    assert not out.exists()
    assert main([*arguments, "--accept", "fair"]) == 0
    accepted = json.loads(capsys.readouterr().out)
    assert (accepted["grade"], accepted["file"]) == ("fair", str(out))
    assert Camera.from_mapping(tomllib.loads(out.read_text())).fx == pytest.approx(BENT.fx, rel=3e-3)


def test_a_view_that_contradicts_the_others_is_left_out(folders: dict[str, Path]) -> None:
    collection = Collection(CHARUCO, moving=False)
    for file in sorted(folders["charuco"].iterdir()):
        collection.add(file.name, cv2.imread(str(file)))
    views = list(collection.views)
    bent = views[4]
    wave = np.stack([4 * np.sin(bent.uv_px[:, 1] / 9), np.zeros(len(bent.ids))], axis=1)
    views[4] = BoardView(bent.name, bent.ids, bent.uv_px + wave)
    solution = solve(views, CHARUCO, (480, 320))
    assert [f.view.name for f in solution.left_out] == [bent.name]
    assert worst_px(solution.camera, BENT) < 1.0


def test_of_a_video_only_still_and_new_views_are_taken(tmp_path: Path) -> None:
    studio = Studio(STRAIGHT, CHARUCO)
    still = [studio.aim((x, 160), 0.35, (10.0, 20.0, 0.0)) for x in (160.0, 300.0)]
    moving = [studio.aim((x, 160), 0.35, (10.0, 20.0, 0.0)) for x in (200.0, 230.0, 265.0)]
    path = tmp_path / "board.mkv"
    with av.open(str(path), "w") as out:
        stream = out.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = 480, 320, "gray"
        for px in [*[still[0]] * 5, *moving, *[still[1]] * 5]:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(px, format="gray")))
        out.mux(stream.encode(None))
    collection = Collection(CHARUCO, moving=True)
    add_file(path, collection, lambda c: None)
    assert (collection.image_count, len(collection.views)) == (13, 2)
    assert collection.repeated == 11


def board_images(print_px: np.ndarray, size_m: tuple[float, float], count: int = 12) -> list[np.ndarray]:
    """Look at a printed board from as many poses by a pinhole camera of 400x300 px, fx 320."""
    rng, (h, w) = np.random.default_rng(3), print_px.shape
    K = np.array([[320.0, 0, 199.5], [0, 320.0, 149.5], [0, 0, 1]])
    corners = np.array([(0, 0), (size_m[0], 0), size_m, (0, size_m[1])], float) - np.array(size_m) / 2
    out = []
    for _ in range(count):
        R = cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3) * (1, 1, 0.3))[0]
        xyz = np.c_[corners, np.zeros(4)] @ R.T + (rng.uniform(-0.04, 0.04), rng.uniform(-0.03, 0.03), rng.uniform(0.3, 0.4))
        uv = (xyz @ K.T)[:, :2] / xyz[:, 2:]
        flat = np.array([(-0.5, -0.5), (w - 0.5, -0.5), (w - 0.5, h - 0.5), (-0.5, h - 0.5)], np.float32)
        H = cv2.getPerspectiveTransform(flat, (4 * (uv + 0.5) - 0.5).astype(np.float32))
        big = cv2.warpPerspective(print_px, H, (1600, 1200), flags=cv2.INTER_AREA, borderValue=110)
        out.append(cv2.resize(big, (400, 300), interpolation=cv2.INTER_AREA))
    return out


def old_charuco() -> np.ndarray:
    """Return the board as OpenCV drew it before 4.6."""
    board = cv2.aruco.CharucoBoard((7, 10), 0.025, 0.018, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250))
    board.setLegacyPattern(True)
    return cv2.copyMakeBorder(board.generateImage((700, 1000)), 50, 50, 50, 50, cv2.BORDER_CONSTANT, value=255)


def square_chessboard() -> np.ndarray:
    squares = np.kron((np.indices((8, 8)).sum(0) % 2).astype(np.uint8) * 255, np.ones((100, 100), np.uint8))
    return cv2.copyMakeBorder(squares, 100, 100, 100, 100, cv2.BORDER_CONSTANT, value=255)


@pytest.mark.parametrize(
    ("board", "print_px", "size_m"),
    [(CHARUCO, old_charuco(), (0.2, 0.275)), (Board("chessboard", 8, 8), square_chessboard(), (0.25, 0.25))],
)
def test_old_and_square_boards_measure_the_focal_length(board: Board, print_px: np.ndarray, size_m: tuple[float, float]) -> None:
    collection = Collection(board, moving=False)
    for n, px in enumerate(board_images(print_px, size_m)):
        collection.add(str(n), px)
    solution = solve(collection.views, board, (400, 300), STRAIGHT.T_body_cam)
    assert len(collection.views) >= 10
    assert solution.camera.fx == pytest.approx(320.0, rel=0.01)
    assert solution.rms_px < 0.3


def test_a_mirrored_board_is_named() -> None:
    collection = Collection(CHARUCO, moving=False)
    for n, px in enumerate(board_images(old_charuco(), (0.2, 0.275), 3)):
        assert collection.add(str(n), np.ascontiguousarray(px[:, ::-1])) is None
    assert collection.mirrored == 3


async def test_a_live_camera_is_watched_for_new_still_views(folders: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "live.mkv"
    with av.open(str(path), "w") as out:
        stream = out.add_stream("ffv1", rate=20)
        stream.width, stream.height, stream.pix_fmt = 480, 320, "gray"
        for name in ("00.png", "04.png", "08.png"):
            px = cv2.imread(str(folders["charuco"] / name), cv2.IMREAD_GRAYSCALE)
            for _ in range(20):
                out.mux(stream.encode(av.VideoFrame.from_ndarray(px, format="gray")))
        out.mux(stream.encode(None))
    guide, reported = Guide(CHARUCO), list[GuideState]()
    live = CameraOptions(source="stream", device=str(path), repeat=True)
    await watch(live, None, guide, reported.append, timeout_s=3.5)
    assert len(guide.collection.views) == reported[-1].views == 3
    assert guide.collection.image_count >= 6
    assert reported[0].rms_px is None
    assert "7 more views (3 of 10)" in reported[-1].lacks
    absent = CameraOptions(source="v4l2", device="/dev/v4l/by-id/no-such-camera")
    with pytest.raises(Recoverable, match="no such camera"):
        await watch(absent, (480, 320), guide, reported.append, timeout_s=1.0, first_s=0.2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--squares", "7by10"], "--squares"),
        (["--marker-mm", "24.9"], "markers must be"),
        (["--rpy-deg", "0,0"], "--rpy-deg"),
        (["--out", "none/such/camera.toml"], "--out"),
        (["--device", "cam"], "either images and videos, or --device"),
    ],
)
def test_wrong_use_is_one_line(folders, tmp_path, capsys, arguments, words):
    assert main(["calibrate", "camera", str(folders["charuco"]), "--out", str(tmp_path / "c.toml"), *arguments]) == 2
    output = capsys.readouterr().err
    assert words in output
    assert output.count("\n") == 1


def test_images_of_two_sizes_and_images_that_are_none_are_named(tmp_path: Path) -> None:
    collection = Collection(CHARUCO, moving=False)
    collection.add("a", np.zeros((64, 64), np.uint8))
    with pytest.raises(BadInput, match="b: 64x32 px"):
        collection.add("b", np.zeros((32, 64), np.uint8))
    (tmp_path / "x.png").write_text("none")
    assert main(["calibrate", "camera", str(tmp_path), "--out", str(tmp_path / "c.toml")]) == 2
