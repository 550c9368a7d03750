"""Build the native libraries: `python -m supply.core` compiles the C files of each that changed, links them, and binds them.

The compiler is `cc` where there is one, else zig's, from `requirements/compiler.txt`. Python's side of a library is `abi.py`
beside it, which cffi makes from the library's header. A build environment has no other package.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
CORE = ROOT / "estimator/core"
SIM_CORE = ROOT / "sitl/core"
OBJECTS = ROOT / "build/core"
"""The folder of compiled files. An object's name holds the digest of all that it was compiled from."""


class Library(NamedTuple):
    """A native library: the file that it is built into, the header that it is called by, its C files, folders of headers."""

    file: Path
    header: Path
    sources: tuple[Path, ...]
    includes: tuple[Path, ...]

    @property
    def abi(self) -> Path:
        """Return the module that Python calls the library through."""
        return self.header.with_name("abi.py")

    @property
    def digest(self) -> int:
        """Return the digest of the header, by which the library and the module know each other."""
        return zlib.crc32(self.header.read_bytes())

    @property
    def define(self) -> str:
        """Return the compiler's flag that tells the library this digest."""
        return f"-DHEADER_DIGEST={self.digest}u"

    def part(self, *patterns: str) -> Library:
        """Return a library of those C files alone whose paths match."""
        return self._replace(sources=tuple(s for s in self.sources if any(s.match(pattern) for pattern in patterns)))


FLYING = Library(CORE / "libdecklander.so.1", CORE / "decklander.h", tuple(sorted(CORE.rglob("*.c"))), (CORE,))
SIMULATED = Library(
    SIM_CORE / "libdecklander_sim.so.1",
    SIM_CORE / "decklander_sim.h",
    (*sorted(SIM_CORE.rglob("*.c")), CORE / "base/digest.c", CORE / "base/rotation.c"),
    (SIM_CORE, CORE),
)
LIBRARIES = (FLYING, SIMULATED)


def all_in_one() -> list[str]:
    """Return the compiler's arguments for a program of both libraries: folders of headers, and every C file once."""
    sources = {source for library in LIBRARIES for source in library.sources}
    return [FLYING.define, *(f"-I{folder}" for folder in SIMULATED.includes), *map(str, sorted(sources))]


FLAGS = (
    "-std=c99", "-O3", "-fPIC", "-Wall", "-Wextra", "-Wmissing-prototypes",
    "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-g0",
)  # fmt: skip
"""Compiler options.

Without contraction and without fast-math, machines of one architecture compute the same bits. Nobody reads `errno` or the flags
of floating-point exceptions, so roots and choices are instructions and not calls and branches. Debugging data, which zig adds
without a word, would hold the folder of the build, and so two builds would differ.
"""
NO_COMPILER = (
    "the native core needs a C compiler, and there is neither `cc` (on Debian: apt install gcc libc6-dev) "
    "nor zig's (pip install --require-hashes -r requirements/compiler.txt)"
)


ARCHITECTURE = "DECKLANDER_WHEEL_FOR"
"""Name of the environment variable with the architecture for a wheel's build hook."""
GLIBC = (2, 17)
"""The oldest glibc on which a cross-built library runs."""


class BuildError(Exception):
    """The library could not be built; the text gives the reason and the cure."""


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


def build(library: Library, out: Path | None = None, extra: Sequence[str] = (), architecture: str | None = None) -> Path:
    """Compile what changed and link the library.

    It replaces an older one at once, so that a process that runs keeps the file it has opened.

    Args:
        library: what to build.
        out: the file to write, by default the library's own.
        extra: further flags for the compiler.
        architecture: for what machine, as Linux names it; by default for this one.

    Raises:
        BuildError: there is no compiler, or it refuses a source.
    """
    out = out or library.file
    used = compiler() if architecture is None else cross_compiler(architecture)
    # A stranger's compiler may be newer and find more: a warning ends the build in CI alone.
    strict = ["-Werror"] if os.environ.get("CI") else []
    common = [*used, *FLAGS, *strict, *extra, *(f"-I{folder}" for folder in library.includes)]
    version = _run([*used, "--version"])
    OBJECTS.mkdir(parents=True, exist_ok=True)

    def compiled(source: Path) -> Path:
        digest = [library.define] if source.name == "digest.c" else []
        return _object([*common, *digest, "-c", str(source)], _read_by(source, library.includes), version)

    with ThreadPoolExecutor(os.cpu_count()) as workers:
        objects = list(workers.map(compiled, library.sources))
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".core-") as folder:
        made = Path(folder, out.name)
        _run([*used, "-shared", *extra, *map(str, objects), "-o", str(made), "-lm"])
        made.replace(out)
    return out


def _object(command: Sequence[str], read: Sequence[Path], version: str) -> Path:
    """Return the object that a command makes of some files; run it if it was not yet run on the same texts."""
    texts = [version, *command, *(path.read_text() for path in read)]
    made = OBJECTS / f"{read[0].stem}-{hashlib.sha256(chr(0).join(texts).encode()).hexdigest()[:20]}.o"
    if not made.exists():
        with tempfile.TemporaryDirectory(dir=OBJECTS) as folder:
            _run([*command, "-o", f"{folder}/made.o"])
            Path(folder, "made.o").replace(made)
    return made


def _read_by(source: Path, includes: Sequence[Path]) -> list[Path]:
    """Return a C file and every header of ours that it includes, directly or by another one."""
    found = [source]
    for path in found:
        for name in re.findall(r'^#include "(.+)"', path.read_text(), re.MULTILINE):
            header = next(folder / name for folder in includes if (folder / name).exists())
            if header not in found:
                found.append(header)
    return found


def _run(command: Sequence[str]) -> str:
    environment = {**os.environ, "ZIG_LOCAL_CACHE_DIR": str(OBJECTS / "zig")}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode != 0:
        raise BuildError(f"{' '.join(command)}\n{done.stderr.strip()}")
    return done.stdout


def bind(library: Library, out: Path | None = None) -> Path:
    """Write the module that Python calls a library through: its declarations, its enumerations, and its digest.

    Args:
        library: the library.
        out: the file to write, by default the library's own.
    """
    from cffi import FFI  # the libraries compile while it is fetched

    out = out or library.abi
    declared = FFI()
    declared.set_source(".".join(library.abi.relative_to(ROOT).with_suffix("").parts), None)
    declared.cdef(re.sub(r"^#.*$", "", library.header.read_text(), flags=re.MULTILINE))  # without the preprocessor's lines
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=".core-") as folder:
        made = Path(folder, out.name)
        with contextlib.redirect_stdout(None):
            declared.emit_python_code(str(made))
        entries = declared.dlopen(None)
        numbers = {name: value for name in dir(entries) if isinstance(value := getattr(entries, name, None), int)}
        with made.open("a") as file:
            file.write("".join(f"{name} = {value}\n" for name, value in {"DIGEST": library.digest, **numbers}.items()))
        made.replace(out)
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m supply.core", description="Build the native libraries.")
    parser.add_argument("what", nargs="?", choices=("libraries", "bindings"), help="make these alone")
    what = parser.parse_args(argv).what
    try:
        if what != "bindings":
            began_s = time.monotonic()
            print(f"compiling the native core, {sum(len(library.sources) for library in LIBRARIES)} files ...", flush=True)
            for library in LIBRARIES:
                build(library)
            print(f"compiled in {time.monotonic() - began_s:.1f} s", flush=True)
        if what != "libraries":
            for library in LIBRARIES:
                bind(library)
    except BuildError as why:
        print(f"{why}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
