"""The calls of exercise.c, which reach every function of the core: clean under the sanitizers, and on a Raspberry Pi the same."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from estimator.core import abi
from estimator.core.library import CORE
from sitl.core.library import SIM
from supply import core
from tests.estimator.core.test_library import entries

CALLS = Path(__file__).parents[1] / "tests/estimator/core/exercise.c"
FLAGS = ["-std=c99", "-O3", "-ffp-contract=off", *core.all_in_one(), str(CALLS), "-lm"]


def test_the_core_runs_clean_under_the_sanitizers(tmp_path: Path) -> None:
    flags = ["-std=c99", "-g", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    program = tmp_path / "exercise"
    command = [*core.compiler(), *flags, *core.all_in_one(), str(CALLS)]
    built = subprocess.run([*command, "-o", str(program), "-lm"], capture_output=True, text=True, check=False)
    if built.returncode != 0 and re.search("sanitize|asan|ubsan", built.stderr):
        pytest.skip("this compiler has no sanitizers")
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([str(program)], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert entries(CORE) | entries(SIM) <= set(ran.stdout.split()), "exercise.c misses a function"


@pytest.mark.skipif(
    shutil.which("qemu-aarch64") is None or importlib.util.find_spec("ziglang") is None,
    reason="needs qemu-aarch64 (apt install qemu-user) and zig's compiler; `make test-aarch64` installs the latter",
)
def test_both_architectures_compute_the_same(tmp_path: Path) -> None:
    """The core of a Raspberry Pi is cross-built by zig and runs under qemu's emulation."""
    own, other = tmp_path / "own", tmp_path / "aarch64"
    subprocess.run([*core.compiler(), *FLAGS, "-o", str(own)], check=True)
    zig = [sys.executable, "-m", "ziglang", "cc", "-target", "aarch64-linux-musl", "-static"]
    subprocess.run([*zig, *FLAGS, "-o", str(other)], check=True, env={**os.environ, "ZIG_LOCAL_CACHE_DIR": str(tmp_path)})
    here, there = _called([str(own)]), _called(["qemu-aarch64", str(other)])
    assert here.keys() == there.keys()
    assert int(here["dl_digest"]) == abi.DIGEST
    assert len(here) > 3
    for functions, found in here.items():
        assert there[functions] == pytest.approx(found, rel=1e-9), functions


def _called(command: list[str]) -> dict[str, float]:
    """Return the sum over what the functions computed, by their names."""
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    return {names: float(found) for found, _, names in (line.partition(" ") for line in ran.stdout.splitlines())}
