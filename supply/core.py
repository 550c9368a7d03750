"""Build the native core: `python -m supply.core` compiles `estimator/core/*.c` into the library beside them.

The compiler is `cc` where there is one, else zig's, from `requirements/compiler.txt`. `--header` writes `interface.h` from
`interface/`. This module needs only the standard library: a build environment has no other.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "estimator/core"
LIBRARY = FOLDER / "libdecklander.so.1"
HEADER = FOLDER / "interface.h"
FLAGS = (
    "-std=c99", "-O3", "-fPIC", "-Wall", "-Wextra", "-Werror", "-Wmissing-prototypes",
    "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math",
)  # fmt: skip
"""Without contraction and without fast-math, machines of one architecture compute the same bits. Nobody reads `errno` or the
flags of floating-point exceptions, so roots and choices are instructions and not calls and branches.
"""
NO_COMPILER = (
    "the native core needs a C compiler, and there is neither `cc` (on Debian: apt install gcc libc6-dev) "
    "nor zig's (pip install --require-hashes -r requirements/compiler.txt)"
)


ARCHITECTURE = "DECKLANDER_WHEEL_FOR"
"""Name of the environment variable that tells a wheel's build hook for which architecture to build."""
GLIBC = (2, 17)
"""The oldest glibc on which a cross-built library runs."""


class BuildError(Exception):
    """The library could not be built; the text says why and what helps."""


def compiler() -> list[str]:
    """Return the command that compiles C.

    Raises:
        BuildError: there is none.
    """
    if shutil.which("cc") is not None:
        return ["cc"]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise BuildError(NO_COMPILER)


def cross_compiler(architecture: str) -> list[str]:
    """Return the command that compiles C for another architecture, and for every glibc that is not older than `GLIBC`.

    Raises:
        BuildError: zig's compiler is missing.
    """
    if importlib.util.find_spec("ziglang") is None:
        raise BuildError("building for another architecture needs zig's compiler (requirements/compiler.txt)")
    return [sys.executable, "-m", "ziglang", "cc", "-target", f"{architecture}-linux-gnu.{'.'.join(map(str, GLIBC))}"]


def build(out: Path = LIBRARY, extra: Sequence[str] = (), sources: Path = FOLDER, architecture: str | None = None) -> Path:
    """Compile the library. It replaces an older one at once, so that a process that runs keeps the file it has opened.

    Args:
        out: the file to write.
        extra: further flags for the compiler.
        sources: the folder of the C files.
        architecture: for what machine, as Linux names it; by default for this one.

    Raises:
        BuildError: there is no compiler, or it refuses a source.
    """
    files = [str(path) for path in sorted(sources.glob("*.c"))]
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".core-") as folder:
        made = Path(folder, out.name)
        used = compiler() if architecture is None else cross_compiler(architecture)
        command = [*used, *FLAGS, "-shared", *extra, *files, "-o", str(made), "-lm"]
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, env={**os.environ, "ZIG_LOCAL_CACHE_DIR": folder}
        )
        if done.returncode != 0:
            raise BuildError(f"{' '.join(command)}\n{done.stderr.strip()}")
        made.replace(out)
    return out


def header() -> str:
    """Return the C header of the interface that `estimator/core/interface` describes."""
    place = FOLDER / "interface"
    spec = importlib.util.spec_from_file_location("interface", place / "__init__.py", submodule_search_locations=[str(place)])
    assert spec is not None
    assert spec.loader is not None
    interface = sys.modules["interface"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(interface)
    return str(interface.header())


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m supply.core", description="Build the native core.")
    parser.add_argument("--header", action="store_true", help="write interface.h from interface/, and build nothing")
    args = parser.parse_args(argv)
    if args.header:
        HEADER.write_text(header())
        return 0
    try:
        build()
    except BuildError as why:
        print(f"{why}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
