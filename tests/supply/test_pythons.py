"""`make pythons` checks every Python of the classifiers that runs here, and names those that do not."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CHECKED = 'echo "$@" >> {done}; exit {code}'


def program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


@pytest.mark.parametrize(("make", "demo", "failed"), [(0, 0, "none"), (2, 0, "3.12.9 (check)"), (0, 1, "3.12.9 (demo)")])
def test_a_shim_that_does_not_run_is_no_python_and_each_other_is_checked_in_its_own_environment(tmp_path, make, demo, failed):
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text())
    done, path = tmp_path / "done", tmp_path / "bin"
    program(path / "python3.11", "exit 127")
    program(path / "python3", "echo 3.10")
    program(path / "pyenv", f"[ $1 = root ] && echo {tmp_path}")
    program(path / "python3.12", 'case $2 in *ensurepip*) echo 3.12;; *) echo "3.12.9 /somewhere";; esac')
    program(tmp_path / "versions/3.13.1/bin/python3", 'case $2 in *ensurepip*) echo 3.13;; *) echo "3.13.1 /elsewhere";; esac')
    program(path / "make", "case $* in *3.12*) " + CHECKED.format(done=done, code=make) + ";; *) exit 0;; esac")
    for version, code in (("3.12", demo), ("3.13", 0)):
        program(tmp_path / f".venv-{version}/bin/decklander", CHECKED.format(done=done, code=code))
    ran = subprocess.run(
        ["sh", ROOT / "supply/pythons.sh"],
        cwd=tmp_path,
        env={"PATH": f"{path}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.stdout.splitlines()[-1] == (
        f"Pythons of the classifiers: checked 3.12.9 3.13.1; not on this machine: 3.11; failed: {failed}"
    )
    assert (ran.returncode == 0) is (failed == "none")
    lines = done.read_text().splitlines()
    assert lines[0] == "--no-print-directory VENV=.venv-3.12 PYTHON=python3.12 check"
    assert len([line for line in lines if line.startswith("demo --report")]) == (1 if make else 2)
