"""An installation makes a small service that runs; the wheel and the source archive hold what they should."""

import os
import platform
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from supply import core, size, wheels

ROOT = Path(__file__).parents[2]
MOST_MB = 300


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


def instead_of_cc(folder: Path, body: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a shell script before the compiler, which the flags of its command are given."""
    (folder / "bin").mkdir()
    (folder / "bin/cc").write_text(f"#!/bin/sh\n{body}\n")
    (folder / "bin/cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}/bin", prepend=os.pathsep)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_checkout_installs_a_small_service_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIP_COMPILE", "0")  # most of what pip compiles is taken out again; what stays is compiled below
    monkeypatch.delenv("PYTHONPYCACHEPREFIX", raising=False)  # of the service's size its bytecode is a part
    # The core that this checkout has built serves again; that a wheel's build compiles it, the next test shows.
    built = " ".join(f"*{library.file.name}) exec cp {library.file} $2;;" for library in core.LIBRARIES)
    last_two = 'while [ $# -gt 2 ] && [ "$1" != -o ]; do shift; done'
    instead_of_cc(tmp_path, f'{last_two}; case "$2" in {built} *.o) : > "$2";; esac', monkeypatch)
    source = tmp_path / "source"
    checkout(source)
    target = tmp_path / "decklander"
    try:
        size.make(target, source)
    except subprocess.CalledProcessError as why:
        if re.search("No matching distribution|Failed to establish a new connection", str(why.stderr)):
            pytest.skip("pip reaches no packages here")
        raise
    assert run(f"{target}/bin/python -m compileall -q {target}/lib", tmp_path).returncode == 0
    assert megabytes(target) < MOST_MB
    decklander = target / "bin/decklander"
    assert run(f"{decklander} config check raspberry_px4", tmp_path).returncode == 0
    refused = run(f"{decklander} config check sim", tmp_path)
    assert (refused.returncode, "decklander[video]" in refused.stderr) == (2, True)
    refused = run(f"{decklander} campaign demo --report --runs 1", tmp_path)
    assert (refused.returncode, "matplotlib" in refused.stderr) == (2, True)
    flown = run(f"{decklander} simulate demo --seed 1 --json", tmp_path)
    assert '"landed_on_pad": true' in flown.stdout, flown.stderr
    imported = run(
        f"{target}/bin/python -c 'import drivers.imports.dataflash, drivers.imports.px4_ulog, drivers.mavlink.dialect'", tmp_path
    )
    assert imported.stderr == ""


@pytest.mark.slow
def test_wheel_and_source_archive_hold_what_they_should(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = shutil.which("cc")
    if compiler is not None:
        instead_of_cc(tmp_path, f'exec "{compiler}" "$@" -O0', monkeypatch)  # twice compiled, never run
    source = tmp_path / "source"
    checkout(source)
    done = run(f"{sys.executable} -m hatchling build -d {tmp_path}/dist", source)
    assert done.returncode == 0, done.stderr
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    (archive,) = (tmp_path / "dist").glob("*.tar.gz")
    names = zipfile.ZipFile(wheel).namelist()
    assert wheel.stem.endswith(f"-py3-none-linux_{platform.machine()}")
    assert {
        *(library.file.relative_to(core.ROOT).as_posix() for library in core.LIBRARIES),
        "estimator/core/decklander.h",
        "estimator/core/abi.py",
        "estimator/core/base/kalman.c",
    } <= set(names)
    tops = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    assert tops == {"companion", "decklander", "drivers", "estimator", "sitl"}
    assert [name for name in names if "/test_" in name] == []
    python = {path.relative_to(source).as_posix() for top in tops for path in (source / top).rglob("*.py")}
    assert python <= set(names)
    assert {
        "companion/tools/report/style.css",
        "decklander/configs/sim.toml",
        "decklander/py.typed",
        "estimator/py.typed",
    } <= set(names)
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
    for made in (wheel, archive):
        wheels.check_metadata(made)
    elsewhere = tmp_path / "elsewhere/by another name"
    checkout(elsewhere)
    done = run(f"{sys.executable} -m hatchling build -d {tmp_path}/again", elsewhere)
    assert done.returncode == 0, done.stderr
    for made in (wheel, archive):
        assert (tmp_path / "again" / made.name).read_bytes() == made.read_bytes(), "two builds differ"
    assert [name for name in inside if name.startswith((".venv", ".git/", "dist/", "report/"))] == []
