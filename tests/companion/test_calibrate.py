"""Calibration on images rendered by a known camera: what is recovered, what is refused and in which words."""

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import pytest

from companion.cli.calibrate_flight import with_values
from companion.cli.main import main
from companion.guidance.pilot import estimator_options, with_mount
from companion.settings.load import load
from companion.settings.model import CameraSettings, Settings
from companion.tools.calibrate.board import Board, BoardView, Collection
from companion.tools.calibrate.flight_result import flight_result
from companion.tools.calibrate.guide import Guide, GuideState, assess, missing_before, watch
from companion.tools.calibrate.gyro_attitude import exp, exps
from companion.tools.calibrate.mount_fit import DELAY, MOUNT, READOUT, fit_mount
from companion.tools.calibrate.solve import distance_errors, solve
from decklander.place import SHIPPED
from drivers.ardrone.options import ardrone_options
from drivers.camera.options import CameraOptions
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.geometry import Rotation
from estimator.vision.camera.camera import Camera
from tests.companion import calibration_flights as flights
from tests.support.calibration_images import Studio, good_round, lens
from tests.support.image_files import film

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
    out, figures = tmp_path / "camera.toml", tmp_path / "figures"
    code = main(
        ["calibrate", "camera", str(folders[kind]), "--out", str(out), "--figures", str(figures), "--json",
         "--position-m", "0.1,0,0.02", *more]
    )  # fmt: skip
    output = json.loads(capsys.readouterr().out)
    assert output["missing"] == []
    assert (code, output["good"], output["views"]) == (0, True, 15)
    found = Camera.from_mapping(tomllib.loads(out.read_text()))
    assert (found.width, found.height) == (true.width, true.height)
    assert (found.fx, found.fy) == pytest.approx((true.fx, true.fy), rel=3e-3)
    assert (found.cx, found.cy) == pytest.approx((true.cx, true.cy), abs=1.5)
    for value, truth, sigma in zip((found.fx, found.fy), (true.fx, true.fy), output["sigma_fx_fy_cx_cy"][:2], strict=True):
        assert abs(value - truth) < 6 * sigma
    assert worst_px(found, true) < 1.0
    assert output["rms_px"] < 0.15
    assert np.allclose(found.T_body_cam.t, (0.1, 0.0, 0.02))
    for name in ("coverage.png", "residuals.png"):
        assert cv2.imread(str(figures / name)) is not None


def views_of(camera: Camera, board: Board, tilt_deg: float, seed: int, reach: float = 0.2) -> list[BoardView]:
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
    views = views_of(BENT, CHARUCO, tilt_deg, 5)
    one, large = (solve(views, Board(square_m=s, marker_m=0.7 * s), (480, 320)) for s in (0.025, 0.8))
    assert np.allclose(one.sigma, large.sigma, rtol=0.05)
    off = np.abs(distance_errors(one.camera, BENT))
    assert off.max() < one.distances_right_to * 1.5
    assert (one.distances_right_to < 0.006) == (tilt_deg > 1.0)
    assert (assess(one, (480, 320)).grade == "poor") == (tilt_deg < 1.0)


@pytest.mark.hazard("H12")
def test_a_flat_set_is_written_by_consent_alone_and_its_cost_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    studio, out = Studio(STRAIGHT, CHESSBOARD), tmp_path / "camera.toml"
    for i in range(4):
        px = studio.aim((200.0 + 15 * i, 180.0 - 8 * i), 0.55 + 0.02 * i, (0.6, -0.6, 7.0 * i))
        cv2.imwrite(str(tmp_path / f"{i}.png"), px)
    words = ["calibrate", "camera", str(tmp_path), "--board", "chessboard", "--squares", "8x5", "--out", str(out)]
    assert main([*words, "--accept", "fair"]) == 1
    assert "(--accept poor writes it all the same)" in capsys.readouterr().out
    assert not out.exists()
    assert main([*words, "--accept", "poor"]) == 0
    output = capsys.readouterr().out
    assert "at touchdown" in output or "Distances are not known" in output
    assert Camera.from_mapping(tomllib.loads(out.read_text())).focal_sigma > 0.02


def test_a_fisheye_is_recognized_and_recovered() -> None:
    straight = lens(480, 320, 220.0, (0.0,) * 5)
    k = np.array([-0.02, 0.004, -0.001, 0.0002])
    true = replace(straight, lens="fisheye", distortion=k)
    views = views_of(true, CHARUCO, 35.0, 7, 0.36)
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
        if not any("bottom right" in lack for lack in missing_before(collection.views, size)):
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
    [
        (CHARUCO, old_charuco(), (0.2, 0.275)),
        (Board("chessboard", 8, 8), square_chessboard(), (0.25, 0.25)),
        (Board("chessboard", 7, 7), square_chessboard(), (0.25, 0.25)),  # its inner corners, as other programs count them
    ],
)
def test_old_and_square_boards_measure_the_focal_length(board: Board, print_px: np.ndarray, size_m: tuple[float, float]) -> None:
    collection, rng = Collection(board, moving=False), np.random.default_rng(1)
    for n, px in enumerate(board_images(print_px, size_m)):
        burst = np.clip(np.roll(px, 1, axis=1) + rng.normal(0.0, 3.0, px.shape), 0, 255).astype(np.uint8)
        for name, again in {f"{n}": px, f"{n} copied": px, f"{n} in a burst": burst}.items():
            collection.add(name, again)
    assert collection.board == (board if board.columns != 7 or board.rows != 7 else Board("chessboard", 8, 8))
    solution = solve(collection.views, collection.board, (400, 300), STRAIGHT.T_body_cam)
    assert len(collection.views) >= 10
    assert collection.repeated == [f"{view.name} {why}" for view in collection.views for why in ("copied", "in a burst")]
    assert solution.camera.fx == pytest.approx(320.0, rel=0.01)
    assert solution.rms_px < 0.3


def test_a_mirrored_board_is_named() -> None:
    collection = Collection(CHARUCO, moving=False)
    for n, px in enumerate(board_images(old_charuco(), (0.2, 0.275), 3)):
        assert collection.add(str(n), np.ascontiguousarray(px[:, ::-1])) is None
    assert collection.mirrored == 3


async def test_a_live_camera_is_watched_for_new_still_views(folders: dict[str, Path], tmp_path: Path) -> None:
    views = [cv2.imread(str(folders["charuco"] / name), cv2.IMREAD_GRAYSCALE) for name in ("00.png", "04.png", "08.png")]
    path = film(tmp_path / "live.mkv", [px for px in views for _ in range(20)], "ffv1", 20, "gray")
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


def test_images_of_two_sizes_and_images_that_are_none_are_named(tmp_path: Path) -> None:
    collection = Collection(CHARUCO, moving=False)
    collection.add("a", np.zeros((64, 64), np.uint8))
    with pytest.raises(BadInput, match="b: 64x32 px"):
        collection.add("b", np.zeros((32, 64), np.uint8))
    (tmp_path / "x.png").write_text("none")
    assert main(["calibrate", "camera", str(tmp_path), "--out", str(tmp_path / "c.toml")]) == 2


TURNED = np.radians([2.1, -1.4, 0.9])


@pytest.mark.parametrize(("seed", "later_s"), [(0, 0.035), (1, -0.025)])
def test_a_wrong_mount_and_delay_are_found_within_their_sigmas(seed: int, later_s: float) -> None:
    turned = np.random.default_rng(seed).permutation(TURNED)
    found = fit_mount(flights.flight(seed, turned, later_s, seconds=40.0))
    off = np.r_[found.values[MOUNT] - turned, found.values[DELAY] - later_s]
    assert np.all(np.abs(off) < 3.5 * found.sigma[: DELAY + 1])
    assert np.degrees(found.sigma[MOUNT]).max() < 0.2
    assert found.sigma[DELAY] < 0.0015


def test_a_hover_without_tilts_and_turns_is_refused_with_what_it_lacks() -> None:
    result = flight_result(flights.flight(3, TURNED, 0.02, lean_deg=0.2, turn_deg=0.0, seconds=30.0))
    assert "degrees only" in (result.mount_refusal() or "")
    assert "ms only" in (result.delay_refusal() or "")
    assert np.all(np.abs(result.fit.values[MOUNT] - TURNED) < 3.5 * result.fit.sigma[MOUNT])
    lacks = " ".join(result.advice())
    for lack in ("40 s", "lean left", "lean right", "lean forward", "lean back", "counter-clockwise by 90"):
        assert lack in lacks
    ashore, on_deck = (flight_result(flights.flight(4, TURNED, 0.02, seconds=30.0, deck_deg=deg)) for deg in (0.0, 2.0))
    assert np.all(on_deck.mount_sigma_deg > 1.5 * ashore.mount_sigma_deg)
    assert [any("fly ashore" in lack for lack in result.advice()) for result in (ashore, on_deck)] == [False, True]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"readout_s": 0.2}, "readout_s must lie in -0.1..0.1"),
        ({"readout_s": "fast"}, "readout_s must be a finite"),
        ({"mount_cov_deg2": [[1.0, 0.0], [0.0, 1.0]]}, "mount_cov_deg2"),
        ({"mount_cov_deg2": [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "mount_cov_deg2"),
    ],
)
def test_calibrated_values_that_are_none_are_refused(values: dict[str, object], said: str) -> None:
    data = tomllib.loads((SHIPPED / "cameras" / "sim.toml").read_text(encoding="utf-8"))
    with pytest.raises(BadInput, match=said):
        Camera.from_mapping(data | values)


@pytest.fixture(scope="module")
def recorded_rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Settings]:
    """Return a recording with a camera file of the user's own, and the folder of both."""
    folder = tmp_path_factory.mktemp("flown")
    camera, rig = folder / "mine.toml", folder / "rig.toml"
    text = (SHIPPED / "cameras" / "sim.toml").read_text(encoding="utf-8")
    camera.write_text(text.replace("[0.0, 0.0, 90.0]", "[0.0, 0.0, 90.0]  # by eye"), encoding="utf-8")
    rig.write_text((SHIPPED / "sim.toml").read_text(encoding="utf-8").replace('"sim"', f'"{camera}"'), encoding="utf-8")
    settings = msgspec.structs.replace(load(str(rig)), camera=CameraSettings(str(camera)))
    flights.record(folder / "flight.mcap", flights.flight(5, TURNED, 0.03, seconds=40.0), settings)
    return folder, rig, settings


def test_the_mount_is_written_into_a_copy_of_the_camera_file(recorded_rig, tmp_path, capsys):
    folder, _, settings = recorded_rig
    out = tmp_path / "new.toml"
    assert main(["calibrate", "mount", str(folder / "flight.mcap"), "--out", str(out)]) == 0
    output = capsys.readouterr().out
    assert "cm at touchdown" in output
    assert "was [0.00, 0.00, 90.00]" in output
    text = out.read_text(encoding="utf-8")
    assert "# by eye" in text
    assert "# The bottom camera of the thesis' simulator" in text
    new = Camera.from_mapping(tomllib.loads(text))
    right = exp(TURNED) @ flights.camera().T_body_cam.R.matrix
    off_deg = math.degrees(math.acos(min(1.0, 0.5 * (np.trace(right.T @ new.T_body_cam.R.matrix) - 1.0))))
    assert off_deg < 0.4
    assert new.cov_mount is not None
    given = estimator_options(settings)
    assert with_mount(given, new).ekf.sigma_mount_rad < 0.5 * given.ekf.sigma_mount_rad
    assert main(["calibrate", "mount", str(folder / "flight.mcap"), "--out", str(out)]) == 2
    assert "name a new one" in capsys.readouterr().err


def test_the_delay_is_written_into_a_copy_of_the_settings(recorded_rig, tmp_path, capsys):
    folder, rig, settings = recorded_rig
    out = tmp_path / "rig.toml"
    words = ["calibrate", "delay", str(folder / "flight.mcap"), "--config", str(rig), "--out", str(out), "--json"]
    assert main(words) == 0
    reported = json.loads(capsys.readouterr().out)
    was = ardrone_options(settings.vehicle).video_delay_s
    assert reported["delay_s"] == pytest.approx(was - 0.03, abs=0.004)
    assert reported["sigma_s"] < 0.002
    new = load(str(out))
    assert ardrone_options(new.vehicle).video_delay_s == pytest.approx(reported["delay_s"], abs=1e-4)
    assert new.estimator.ekf.sigma_delay_s < 0.005
    assert "# The simulated AR.Drone on this machine" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(("seed", "readout_s"), [(7, 0.03), (9, -0.02)])
def test_a_readout_time_is_found_within_its_sigma_and_does_not_spoil_mount_and_delay(seed: int, readout_s: float) -> None:
    """Each pose is turned as a rolling shutter turns it: about the view by the roll's rate, by its tilt by the pitch's."""
    views = flights.flight(seed, TURNED, 0.02, seconds=40.0)
    rates = np.stack([np.interp(views.t + 0.02, views.t_gyro, axis) for axis in views.w_body.T], axis=1)
    by = np.stack([1.5 * rates[:, 1], -1.5 * rates[:, 0], 0.4 * rates[:, 0]], axis=1)
    rolled = exps(by * readout_s).swapaxes(1, 2) @ views.R_cam_pad
    found = fit_mount(replace(views, R_cam_pad=rolled, by_readout=by))
    assert abs(found.values[READOUT] - readout_s) < 3.5 * found.sigma[READOUT] < 0.007
    assert np.all(np.abs(found.values[MOUNT] - TURNED) < 3.5 * found.sigma[MOUNT])
    assert fit_mount(views).values[READOUT] == pytest.approx(0.0, abs=1e-5), "poses that do not say leave it as it is"


def test_a_readout_needs_the_images(recorded_rig: tuple[Path, Path, Settings], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _, _ = recorded_rig
    assert main(["calibrate", "readout", str(folder / "flight.mcap"), "--out", str(folder / "no.toml")]) == 2
    assert "holds the images of 0 views" in capsys.readouterr().err
    assert not (folder / "no.toml").exists()


def test_values_change_in_place_and_comments_stay() -> None:
    text = '# mine\na = [1.0,  # one\n  2.0]\n\n[camera]\nfile = "x"  # a file\n\n[pad]\nfile = "y"\n'
    out = with_values(text, "camera", {"file": "z", "latency_s": 0.01}, "t")
    assert out == '# mine\na = [1.0,  # one\n  2.0]\n\n[camera]\nfile = "z"  # a file\nlatency_s = 0.01\n\n[pad]\nfile = "y"\n'
    assert tomllib.loads(with_values(text, "", {"a": [3.0]}, "t"))["a"] == [3.0]
    assert tomllib.loads(with_values(text, "estimator.ekf", {"s": 1.0}, "t"))["estimator"] == {"ekf": {"s": 1.0}}
    assert with_values('camera = {file = "x"}  # mine\n', "camera", {"file": "z"}, "t") == 'camera = {file = "z"}  # mine\n'
    assert with_values('camera.file = "x"\n', "camera", {"file": "z"}, "t") == 'camera.file = "z"\n'
    for bad, output in (("camera = 3\n", "camera is not a table"), ("camera", "t: .* line 1")):
        with pytest.raises(BadInput, match=output):
            with_values(bad, "camera", {"file": "z"}, "t")
