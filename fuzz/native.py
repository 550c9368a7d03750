"""The fuzz target `core`: every native entry under libFuzzer, with the address and undefined-behaviour sanitizers.

The calls are those of `tests/estimator/core/exercise.c`. Its bytes choose a call and its sizes, and put into its arguments what
no measurement should hold: NaN, infinities, numbers beyond all bounds.
"""

import shutil
import subprocess
from pathlib import Path

from supply import core

NAME = "core"
_CALLS = Path(__file__).parents[1] / "tests/estimator/core/exercise.c"
_FLAGS = ("-std=c99", "-g", "-O1", "-DFUZZED", "-fsanitize=address,undefined,fuzzer", "-fno-sanitize-recover=all")
NO_CLANG = "the target core needs clang and its libFuzzer (on Debian: apt install clang libclang-rt-14-dev)"


def missing() -> bool:
    """Return whether there is no clang."""
    return shutil.which("clang") is None


def command(work: Path, seconds: float, hang_s: int) -> list[str]:
    """Build the fuzzer into a folder, and return the command that runs it for so long.

    Raises:
        core.BuildError: clang refuses a source, or has no libFuzzer.
    """
    program, corpus, crashes = work / "core-fuzzer", work / "corpus" / NAME, work / "crashes"
    for folder in (corpus, crashes):
        folder.mkdir(parents=True, exist_ok=True)
    build = ["clang", *_FLAGS, *core.all_in_one(), str(_CALLS), "-o", str(program), "-lm"]
    built = subprocess.run(build, capture_output=True, text=True, check=False)
    if built.returncode != 0:
        raise core.BuildError(f"{NO_CLANG}; it said: {built.stderr.strip()[-500:]}")
    return [
        str(program.resolve()), str(corpus), f"-max_total_time={max(1, round(seconds))}", "-max_len=4096", "-len_control=0",
        f"-timeout={hang_s}", "-print_final_stats=1", f"-artifact_prefix={crashes}/{NAME}-",
    ]  # fmt: skip
