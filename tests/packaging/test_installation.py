"""The installation page makes a small service that runs; the wheel and the source archive hold what they should."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/installation.md"
MOST_MB = 450


def commands() -> list[str]:
    """Return the lines of the page's block that make the environment."""
    blocks = re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    return next(block for block in blocks if "-m venv" in block).splitlines()


def checkout(target: Path) -> None:
    """Copy what git knows of the project, without what a build has left in the working tree."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["sh", "-c", command], cwd=folder, capture_output=True, text=True, check=False)


def megabytes(folder: Path) -> float:
    """Return the disk space of the files below a folder, in units of 2^20 bytes, as `du -m` counts it."""
    return sum(path.lstat().st_blocks * 512 for path in folder.rglob("*")) / 2**20


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_page_installs_a_small_service_that_runs(tmp_path: Path) -> None:
    source, target = tmp_path / "source", tmp_path / "installed"
    checkout(source)
    for command in commands():
        words = command.replace("sudo ", "").replace("/opt/decklander", str(target)).replace("python3 -m", f"{sys.executable} -m")
        done = run(words, source)
        if "No matching distribution" in done.stderr or "Failed to establish a new connection" in done.stderr:
            pytest.skip("pip reaches no packages here")
        assert done.returncode == 0, f"{command}\n{done.stderr}"
    assert megabytes(target) < MOST_MB
    decklander = target / "bin/decklander"
    assert run(f"{decklander} config check sim", tmp_path).returncode == 0
    refused = run(f"{decklander} demo", tmp_path)
    assert (refused.returncode, "matplotlib" in refused.stderr) == (2, True)
    flown = run(f"{decklander} simulate demo --seed 1 --json", tmp_path)
    assert '"landed_on_pad": true' in flown.stdout, flown.stderr
    imported = run(
        f"{target}/bin/python -c 'import drivers.imports.dataflash, drivers.imports.px4_ulog, drivers.mavlink.dialect'", tmp_path
    )
    assert imported.stderr == ""


@pytest.mark.slow
def test_wheel_and_source_archive_hold_what_they_should(tmp_path: Path) -> None:
    source = tmp_path / "source"
    checkout(source)
    done = run(f"{sys.executable} -m hatchling build -d {tmp_path}/dist", source)
    assert done.returncode == 0, done.stderr
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    (archive,) = (tmp_path / "dist").glob("*.tar.gz")
    names = zipfile.ZipFile(wheel).namelist()
    assert wheel.stem.endswith(f"-py3-none-linux_{platform.machine()}")
    assert {"estimator/core/libdecklander.so.1", "estimator/core/interface.h", "estimator/core/kalman.c"} <= set(names)
    tops = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert tops == {"companion", "drivers", "estimator", "sitl", "configs"}
    assert [name for name in names if "/test_" in name] == []
    python = {path.relative_to(source).as_posix() for top in tops for path in (source / top).rglob("*.py")}
    assert python <= set(names)
    assert {"companion/report/style.css", "configs/sim.toml", "estimator/py.typed"} <= set(names)
    with tarfile.open(archive) as opened:
        inside = {name.split("/", 1)[1] for name in opened.getnames()}
    assert {
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "CHANGELOG.md",
        "Makefile",
        "tests/test_house.py",
        "requirements/runtime.txt",
        "supply/wheel.py",
    } <= inside
    assert [name for name in inside if ".so" in name] == []
    assert [name for name in inside if name.startswith((".venv", ".git/", "dist/", "report/"))] == []
