"""The programs in examples/ run as they are shipped, and their data is what the repository's script makes."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from examples import make_data, with_and_without_imu
from examples.known_controllers import Lateral, Lqr, Mpc, integrators
from tests.fly import record_to, recorded
from tests.support.kept import KeptFlights
from tests.support.processes import ran

ROOT = Path(__file__).parents[1]
DATA = ROOT / "configs/examples"
LARGEST_BYTES = 150_000


def run_example(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return ran(sys.executable, "-W", "error", "-m", f"examples.{name}", *arguments, cwd=ROOT)


def test_the_pad_is_found_in_the_shipped_image() -> None:
    done = run_example("find_pad")
    assert done.returncode == 0, done.stderr
    found = re.match(r"pad ([\d.]+) m ahead, ([\d.]+) m to the right, ([\d.]+) m below; confidence 1.00", done.stdout)
    assert found is not None, done.stdout
    assert 3.5 < float(found[3]) < 4.0


def test_an_image_without_a_pad_ends_with_exit_code_1(tmp_path: Path) -> None:
    black = cv2.imread(str(DATA / "pad.jpg"))
    cv2.imwrite(str(tmp_path / "black.png"), black * 0)
    done = run_example("find_pad", str(tmp_path / "black.png"))
    assert done.returncode == 1
    assert done.stderr == "no pad in the image\n"


def test_the_csv_file_is_fused_to_within_the_attitude_s_error() -> None:
    done = run_example("fuse_csv")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 21
    median = re.fullmatch(r"median error (\d+) mm", lines[-1])
    # The simulated drone's own attitude is off by one to two degrees, which is 0.07 to 0.14 m from 4 m above the pad.
    assert int(median[1]) < 150


def test_a_controller_of_one_s_own_lands_on_the_pad() -> None:
    done = run_example("own_controller")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("landed on the pad after ")
    for wrong in (("own_controller", "abc"), ("read_recording", "nothing.mcap")):
        assert "Traceback" not in run_example(*wrong).stderr


@pytest.mark.parametrize("lateral", [Lqr(0.02), Mpc()])
def test_the_known_controllers_settle_over_the_pad_against_a_steady_push_within_their_largest_lean(lateral: Lateral) -> None:
    A, B = integrators(0.02)
    x, leans = np.array([[0.0, 0.0], [1.0, -0.5], [0.0, 0.0]]), []
    for _ in range(1000):
        leans.append(lateral.lean(x, 2.0))
        x = A @ x + B @ (leans[-1] + [0.8, 0.0])[None]
    assert x[1:] == pytest.approx(np.zeros((2, 2)), abs=0.02)
    assert leans[-1] == pytest.approx([-0.8, 0.0], abs=0.02)
    assert 1.0 < np.abs(leans).max() <= 2.0


def test_a_vehicle_a_camera_a_pad_and_a_message_of_one_s_own_work_together() -> None:
    done = run_example("own_parts")
    assert done.returncode == 0, done.stderr
    forward, right, down = json.loads(done.stdout)["pad_m"]
    assert (forward, right, down) == pytest.approx((0.0, 0.0, 3.0), abs=0.1)


def test_a_recording_is_read(tmp_path: Path) -> None:
    record_to(tmp_path / "flight.mcap", seconds=1.0)
    done = run_example("read_recording", str(tmp_path / "flight.mcap"))
    assert done.returncode == 0, done.stderr
    *decisions, frames = done.stdout.splitlines()
    assert len(decisions) > 10
    assert all(re.fullmatch(r" *[\d.]+ s [a-z ]+: [\d.]+ m up, [\d.]+ m off", line) for line in decisions), decisions[0]
    assert re.fullmatch(r"frames: \{'fused': \d+.*\}", frames)
    # A package that is installed beside Decklander offers it as a command.
    offer = tmp_path / "approach-1.0.dist-info"
    offer.mkdir()
    (offer / "METADATA").write_text("Metadata-Version: 2.1\nName: approach\nVersion: 1.0\n")
    entries = "approach = examples.read_recording\nlost = examples.nowhere\n"
    (offer / "entry_points.txt").write_text(f"[decklander.commands]\n{entries}")
    command = (sys.executable, "-m", "companion.cli.main")
    path = os.pathsep.join((str(tmp_path), str(ROOT)))
    as_command = ran(*command, "approach", str(tmp_path / "flight.mcap"), cwd=ROOT, PYTHONPATH=path)
    assert (as_command.returncode, as_command.stdout) == (0, done.stdout)
    wrong = {
        ("approach", "no.mcap"): "decklander: no.mcap: No such file or directory\n",
        ("approach",): "decklander approach: the following arguments are required: FILE (see decklander approach --help)\n",
        ("lost",): "decklander: decklander lost of examples.nowhere cannot be loaded: No module named 'examples.nowhere'\n",
        ("aproach",): "decklander: unknown command 'aproach'; did you mean 'approach'? (see decklander --help)\n",
    }
    for words, message in wrong.items():
        refused = ran(*command, *words, cwd=ROOT, PYTHONPATH=path)
        assert (refused.returncode, refused.stderr) == (2, message)
    listed = ran(*command, "--help", cwd=ROOT, PYTHONPATH=path).stdout
    assert re.search(r"^of other packages\n  approach +from examples.read_recording$", listed, re.MULTILINE)


def test_the_data_is_written_over_nothing(tmp_path: Path) -> None:
    (tmp_path / "landing.csv").write_text("mine")
    done = run_example("make_data", "--out", str(tmp_path))
    assert done.returncode == 2
    assert "there is landing.csv already" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["landing.csv"]


def test_the_data_is_small_and_the_script_s_columns_are_the_file_s() -> None:
    sizes = {path.name: path.stat().st_size for path in DATA.iterdir() if path.is_file()}
    assert set(sizes) == {"attitude.csv", "landing.csv", "pad.jpg"}
    assert max(sizes.values()) < LARGEST_BYTES
    assert (DATA / "landing.csv").read_text().splitlines()[0] == ",".join(make_data.HEADER)


def test_the_imu_helps_where_the_pad_is_seen_rarely(
    kept: KeptFlights, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = kept("weather_3 by the model", recorded("weather_3", "--record-frames", "none", "--perception", "model"))
    capsys.readouterr()
    rare = [looks for looks in with_and_without_imu.LOOKS if looks.name in ("1 a second", "hidden for 2 s")]
    monkeypatch.setattr(with_and_without_imu, "LOOKS", rare)
    with_and_without_imu.main(flight)
    _, *rows = capsys.readouterr().out.splitlines()
    errors_mm = np.array([[int(mm) for mm in re.findall(r"(\d+) mm", row)] for row in rows])
    # With the IMU, without it; by camera and attitude, and then by every sensor.
    assert (errors_mm[:, ::2] < np.array([[0.95], [0.85]]) * errors_mm[:, 1::2]).all(), errors_mm
    assert errors_mm.max() < 500
    assert run_example("with_and_without_imu").returncode == 1
