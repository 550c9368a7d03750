"""The base install works without PyAV, and names the extra where something needs it."""

import subprocess
import sys
from pathlib import Path

from tests.fly import NEAR

ROOT = Path(__file__).parents[2]
_WITHOUT = """
import sys
from importlib.abc import MetaPathFinder
class Hidden(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "av":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hidden())
import importlib.util, drivers.pyav
drivers.pyav.find_spec = lambda name: None
from companion.cli import main
for words in sys.argv[1:]:
    print(main.main(words.split()))
"""


def without_pyav(*commands: str, cwd: Path) -> tuple[list[str], str]:
    """Return the exit codes, and what was printed to stderr, of command lines in a process without PyAV."""
    done = subprocess.run(
        [sys.executable, "-c", _WITHOUT, *commands],
        cwd=cwd,
        env={"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    return [line for line in done.stdout.splitlines() if line.isdigit()], done.stderr


def test_without_pyav_a_pixhawk_and_a_webcam_work_and_other_video_is_refused_by_its_setting(tmp_path: Path) -> None:
    photo, film = ROOT / "configs/examples/pad.jpg", tmp_path / "film.mp4"
    film.write_bytes(b"no image")
    (tmp_path / "near.toml").write_text(NEAR)
    codes, printed = without_pyav(
        "run --config raspberry_ardupilot --check",
        f"detect {photo} --camera sim --pad thesis",
        "simulate near.toml --seed 3 --perception model",
        "config check ardrone1",
        "run --config ardrone2 --check",
        f"detect {film} --camera sim --pad thesis",
        cwd=tmp_path,
    )
    assert codes == ["0", "0", "0", "0", "2", "2"], printed
    assert 'vehicle.model = "2.0" needs PyAV' in printed
    assert f"{film}: a video needs PyAV" in printed
    assert printed.count("decklander[video]") == 2
    assert "Traceback" not in printed
