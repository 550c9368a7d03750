"""The wheel fits beside what a person has: two examples print the same with the oldest and the newest numpy and OpenCV."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from supply import core

ROOT = Path(__file__).parents[2]
HEADLESS = "opencv-python-headless"
OLDEST = ("numpy==1.26.0", f"{HEADLESS}==4.10.0.84", "msgspec==0.19.0", "cffi==1.16.0")
BESIDE = (
    OLDEST,
    ("numpy==1.26.*", "opencv-contrib-python==4.11.*"),
    ("numpy==2.0.*", f"{HEADLESS}==4.10.*"),
    ("numpy==2.0.*", f"{HEADLESS}==5.*"),
    ("numpy==2.2.*", "opencv-python==4.12.*"),
    ("numpy", f"{HEADLESS}==4.10.*"),
    ("numpy", f"{HEADLESS}==4.14.*"),
    ("numpy", f"{HEADLESS}==5.*"),
)
"""The requirements that pip installs beside the wheel; a bare name is the newest for this Python.

OpenCV's own metadata leave out the other pairs: from 4.12 on it wants numpy 2.
"""
EXAMPLES = ("find_pad", "fuse_csv")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    dist = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", dist], cwd=ROOT, check=True)
    (made,) = dist.glob("*.whl")
    return made


def environment(folder: Path, *wanted: str | Path) -> Path:
    """Make an environment of these requirements, with the examples beside it; return its Python."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    python = folder / "bin/python"
    done = subprocess.run(
        [python, "-m", "pip", "--disable-pip-version-check", "install", "--quiet", *wanted],
        capture_output=True,
        text=True,
        check=False,
    )
    if "No matching distribution" in done.stderr:
        pytest.skip(f"pip reaches none of {wanted} for this Python")
    assert done.returncode == 0, done.stderr
    for name in EXAMPLES:
        shutil.copy(ROOT / f"examples/{name}.py", folder)
    return python


def printed(python: Path, example: str, code: int = 0) -> str:
    """Return what an example prints, away from the checkout; of a failure the last line of the traceback."""
    command = [python, "-W", "error::DeprecationWarning", python.parents[1] / f"{example}.py"]
    done = subprocess.run(command, cwd=python.parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    return done.stderr.splitlines()[-1] if code else done.stdout


@pytest.fixture(scope="module")
def here() -> dict[str, str]:
    """Return what each example prints in this checkout's own environment."""
    command = [sys.executable, "-m"]
    return {
        name: subprocess.run([*command, f"examples.{name}"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in EXAMPLES
    }


@pytest.mark.timeout(600)
@pytest.mark.parametrize("beside", BESIDE, ids=" ".join)
def test_the_examples_print_the_same_beside(beside: tuple[str, ...], wheel: Path, here: dict[str, str], tmp_path: Path) -> None:
    python = environment(tmp_path, wheel, *beside)
    assert {name: printed(python, name) for name in EXAMPLES} == here


@pytest.mark.timeout(600)
def test_the_wheel_alone_is_four_packages_and_needs_an_opencv_only_to_see(
    wheel: Path, here: dict[str, str], tmp_path: Path
) -> None:
    python = environment(tmp_path, wheel)
    listed = subprocess.run([python, "-m", "pip", "freeze"], capture_output=True, text=True, check=True).stdout
    assert set(re.findall(r"^[\w-]+", listed, re.MULTILINE)) == {"cffi", "decklander", "msgspec", "numpy", "pycparser"}
    assert printed(python, "fuse_csv") == here["fuse_csv"]
    (tmp_path / "tracker.py").write_text("from decklander import PadTracker\n")
    assert "PadTracker needs OpenCV 4.10 or newer (cv2), which is not installed" in printed(python, "tracker", code=1)
    done = subprocess.run([tmp_path / "bin/decklander", "demo"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch(r"decklander: decklander demo needs .* install the extra decklander\[service\]\n", done.stderr)


def test_no_native_library_refers_to_python_or_numpy() -> None:
    """Plain C by cffi: numpy's binary interface, which changed with 2.0, does not enter."""
    for library in core.LIBRARIES:
        names = re.findall(rb"[A-Za-z_]\w{3,}", library.file.read_bytes())
        assert b"dl_digest" in names
        assert [name for name in names if re.match(rb"_?Py[A-Z]|NPY_|PyArray|_ARRAY_API", name)] == []
