"""Every bench says what its smallest run is, and one that measured nothing says why."""

import logging
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from benches.options import alive, mapping, program
from tests.support.processes import ROOT, ran

BENCHES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "benches").rglob("*.py")
    if "__main__" in path.read_text()
)
OWN_PROCESS = ("benches.soak", "benches.vision")
"""The one watches the memory of its process, and a detector of the other corrupts the heap where it is destroyed."""


def run_smoke(bench: str, folder: Path, monkeypatch: pytest.MonkeyPatch, option: str = "--smoke") -> object:
    """Return the exit code of a bench's smallest run in this process, which has compiled and imported what all of them need."""
    with monkeypatch.context() as patch:
        patch.setattr(sys, "argv", [bench, option])
        patch.chdir(folder)
        patch.setenv("PYTHONPATH", str(ROOT))
        terminates, level = signal.getsignal(signal.SIGTERM), logging.root.manager.disable
        try:
            return import_module(bench).main()
        except SystemExit as end:
            return end.code
        finally:
            signal.signal(signal.SIGTERM, terminates)
            logging.disable(level)


def assert_measures(bench: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Run a bench's smallest run to its end."""
    monkeypatch.setenv("MPLCONFIGDIR", str(folder))
    if bench in OWN_PROCESS:
        done = ran(sys.executable, "-m", bench, "--smoke", cwd=folder)
        failed, out, err = bool(done.returncode), done.stdout, done.stderr
    else:
        failed = bool(run_smoke(bench, folder, monkeypatch))
        out, err = capsys.readouterr()
    assert not failed, out[-2000:] + err[-2000:]
    assert "skipped" in out or any(letter in "123456789" for letter in out), "it measured nothing"


@pytest.mark.parametrize("bench", BENCHES)
def test_a_bench_says_what_its_smallest_run_is(bench, tmp_path, monkeypatch, capsys):
    """`make qualify` runs each of them to its end."""
    assert run_smoke(bench, tmp_path, monkeypatch, "--help") == 0
    assert "the smallest run, as a test runs it" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("workers", [1, 2])
def test_what_is_mapped_comes_in_its_order(workers: int) -> None:
    with mapping(workers) as mapped:
        assert list(mapped(pow, (5, 4, 3), (2, 2, 2))) == [25, 16, 9]


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
