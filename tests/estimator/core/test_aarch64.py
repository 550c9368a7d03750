"""The core of a Raspberry Pi computes what this machine's does: the same calls, cross-built by zig, under qemu's emulation."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from estimator.core import abi
from supply import core

CALLS = Path(__file__).parent / "exercise.c"
FLAGS = ["-std=c99", "-O3", "-ffp-contract=off", *core.all_in_one(), str(CALLS), "-lm"]

pytestmark = pytest.mark.skipif(
    shutil.which("qemu-aarch64") is None or importlib.util.find_spec("ziglang") is None,
    reason="needs qemu-aarch64 (apt install qemu-user) and zig's compiler; `make test-aarch64` installs the latter",
)


def test_both_architectures_compute_the_same(tmp_path: Path) -> None:
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
        print(f"{functions}: {found!r} here, {there[functions]!r} on aarch64")


def _called(command: list[str]) -> dict[str, float]:
    """Return the sum over what the functions computed, by their names."""
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    return {names: float(found) for found, _, names in (line.partition(" ") for line in ran.stdout.splitlines())}
