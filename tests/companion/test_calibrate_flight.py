"""Mount, delay and readout from a flight: within their sigmas, written beside the old files, refused where it is dull."""

import json
import math
import tomllib
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.cli.calibrate_flight import with_values
from companion.cli.main import main
from companion.guidance.make_pilot import estimator_options, with_mount
from companion.settings.load import SHIPPED, load
from companion.settings.model import CameraSettings, Settings
from companion.tools.calibrate.flight_result import flight_result
from companion.tools.calibrate.mount_fit import DELAY, MOUNT, READOUT, fit_mount
from companion.tools.calibrate.rotations import exp, exps
from estimator.contracts.errors import BadInput
from estimator.vision.camera import Camera
from tests.companion import calibration_flights as flights

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


def test_a_deck_that_rolls_is_reported_and_widens_the_sigmas() -> None:
    ashore = flight_result(flights.flight(4, TURNED, 0.02, seconds=30.0))
    on_deck = flight_result(flights.flight(4, TURNED, 0.02, seconds=30.0, deck_deg=2.0))
    assert np.all(on_deck.mount_sigma_deg > 1.5 * ashore.mount_sigma_deg)
    assert any("fly ashore" in lack for lack in on_deck.advice())
    assert not any("fly ashore" in lack for lack in ashore.advice())


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Settings]:
    """Return a recording with a camera file of the user's own, and the folder of both."""
    folder = tmp_path_factory.mktemp("flown")
    camera, rig = folder / "mine.toml", folder / "rig.toml"
    text = (SHIPPED / "cameras" / "sim.toml").read_text(encoding="utf-8")
    camera.write_text(text.replace("[0.0, 0.0, 90.0]", "[0.0, 0.0, 90.0]  # by eye"), encoding="utf-8")
    rig.write_text((SHIPPED / "sim.toml").read_text(encoding="utf-8").replace('"sim"', f'"{camera}"'), encoding="utf-8")
    settings = msgspec.structs.replace(load(str(rig)), camera=CameraSettings(str(camera)))
    flights.record(folder / "flight.mcap", flights.flight(5, TURNED, 0.03, seconds=40.0), settings)
    return folder, rig, settings


def test_the_mount_is_written_into_a_copy_of_the_camera_file(flown, tmp_path, capsys):
    folder, _, settings = flown
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


def test_the_delay_is_written_into_a_copy_of_the_settings(flown, tmp_path, capsys):
    folder, rig, settings = flown
    out = tmp_path / "rig.toml"
    words = ["calibrate", "delay", str(folder / "flight.mcap"), "--config", str(rig), "--out", str(out), "--json"]
    assert main(words) == 0
    reported = json.loads(capsys.readouterr().out)
    was = settings.vehicle.video_delay_s  # type: ignore[union-attr]
    assert reported["delay_s"] == pytest.approx(was - 0.03, abs=0.004)
    assert reported["sigma_s"] < 0.002
    new = load(str(out))
    assert new.vehicle.video_delay_s == pytest.approx(reported["delay_s"], abs=1e-4)  # type: ignore[union-attr]
    assert new.estimator.ekf.sigma_delay_s < 0.005
    assert "# The simulated AR.Drone on this machine" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(("seed", "readout_s"), [(7, 0.03), (8, 0.0), (9, -0.02)])
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


def test_a_readout_needs_the_images(flown: tuple[Path, Path, Settings], capsys: pytest.CaptureFixture[str]) -> None:
    folder, _, _ = flown
    assert main(["calibrate", "readout", str(folder / "flight.mcap"), "--out", str(folder / "no.toml")]) == 2
    assert "holds the images of 0 views" in capsys.readouterr().err
    assert not (folder / "no.toml").exists()


@pytest.mark.parametrize(
    ("value", "shown"), [("0.2", "readout_s must lie in -0.1..0.1"), ('"fast"', "readout_s must be a finite")]
)
def test_a_readout_time_that_is_none_is_refused(value: str, shown: str) -> None:
    text = (SHIPPED / "cameras" / "sim.toml").read_text(encoding="utf-8")
    with pytest.raises(BadInput, match=shown):
        Camera.from_mapping(tomllib.loads(text + f"readout_s = {value}\n"))


def test_a_recording_with_hardly_a_pad_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    short = tmp_path / "short.mcap"
    flights.record(short, flights.flight(6, TURNED, 0.0, seconds=6.0), load("sim"))
    assert main(["calibrate", "mount", str(short)]) == 2
    assert "100 are needed" in capsys.readouterr().err


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


@pytest.mark.parametrize("value", [3, [[1.0, 0.0], [0.0, 1.0]], [[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]])
def test_a_mount_covariance_that_is_none_is_refused(value: object) -> None:
    data = tomllib.loads((SHIPPED / "cameras" / "sim.toml").read_text(encoding="utf-8"))
    with pytest.raises(BadInput, match="mount_cov_deg2"):
        Camera.from_mapping(data | {"mount_cov_deg2": value})
