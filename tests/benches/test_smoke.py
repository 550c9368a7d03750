"""Every bench measures something in its smallest run, and one that measured nothing says why."""

import subprocess
import sys
from pathlib import Path

import pytest

from benches.options import alive, program
from tests.support.processes import ROOT, ran

BENCHES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__")
    for path in (ROOT / "benches").rglob("*.py")
    if "__main__" in path.read_text()
)


@pytest.mark.parametrize("bench", BENCHES)
def test_a_bench_runs_to_its_end_in_its_smallest_run(bench: str, tmp_path: Path) -> None:
    done = ran(sys.executable, "-m", bench, "--smoke", cwd=tmp_path, MPLCONFIGDIR=str(tmp_path))
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "skipped" in done.stdout or any(letter in "123456789" for letter in done.stdout), "it measured nothing"


def test_a_dead_child_is_an_error_with_its_own_words(tmp_path: Path) -> None:
    done = ran(sys.executable, "-m", "benches.cost", "--smoke", "--scenario", "no_such", cwd=tmp_path)
    assert done.returncode != 0
    assert "no_such" in done.stderr
    (tmp_path / "said").write_text("the port is taken\n")
    with subprocess.Popen(["false"], text=True) as child:
        child.wait()
        with pytest.raises(SystemExit, match="the service ended with 1: the port is taken"):
            alive(child, "the service", tmp_path / "said")


def test_a_missing_program_is_named_with_what_to_install() -> None:
    with pytest.raises(SystemExit, match=r"no-such-program is missing: apt install its-package"):
        program("no-such-program", "its-package")
