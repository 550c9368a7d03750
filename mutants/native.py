"""Mutants of the native core's C files.

Only the changed file is compiled; it is linked with the objects of the others. The door to the core loads the library that is
made of them in place of its own.
"""

import importlib
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mutants import child
from mutants.c_operators import c_mutants
from mutants.forks import Forks, in_server
from mutants.operators import Mutant
from mutants.tally import Tally, chosen
from supply import core

_QUICK = ("-O1",)
"""Compiler options of the tests' library."""
_THOROUGH = ("-O2",)
"""Compiler options for comparing a survivor once more with the original."""
_TRAPPED = (*_THOROUGH, "-fsanitize=bounds-strict,object-size", "-fsanitize-undefined-trap-on-error", "-fstack-protector-all")
"""Compiler options of the changed file: an index beyond the end of an array ends the test.

Only the optimizer follows an array into a called function.
"""


class Workshop:
    """The core's objects, and libraries in which one of them is another.

    Raises:
        BuildError: the compiler refuses a source.
    """

    def __init__(self, folder: Path, library: core.Library, changed: Path) -> None:
        self._folder, self._library, self._changed = folder, library, changed
        self._objects = {path: self.compiled(path.read_text(), f"{k}.c") for k, path in enumerate(library.sources)}
        self._originals: dict[tuple[str, ...], bytes] = {}

    def compiled(self, source: str, name: str, flags: Sequence[str] = _QUICK) -> Path:
        """Compile one file with another text.

        Raises:
            BuildError: the compiler refuses it.
        """
        made = self._folder / f"{name}.o"
        command = [
            *core.compiler(),
            *core.FLAGS,
            *flags,
            self._library.define,
            *(f"-I{folder}" for folder in self._library.includes),
            "-xc",
            "-c",
            "-",
            "-o",
            str(made),
        ]
        done = subprocess.run(command, input=source, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise core.BuildError(done.stderr.strip())
        return made

    def alike(self, source: str, flags: Sequence[str]) -> bool:
        """Return whether a text of the changed file is compiled to the instructions of the original."""
        key = tuple(flags)
        if key not in self._originals:
            self._originals[key] = self.compiled(self._changed.read_text(), "original.c", flags).read_bytes()
        return self.compiled(source, "mutant.c", flags).read_bytes() == self._originals[key]

    def original(self, flags: Sequence[str]) -> Path:
        """Link a library whose file that is to be changed is compiled in another way."""
        return self.linked("original.so", self.compiled(self._changed.read_text(), "original.c", flags))

    def linked(self, name: str, changed: Path | None = None) -> Path:
        """Link a library; `changed` is the object in place of the changed file's own."""
        made = self._folder / name
        made.unlink(missing_ok=True)  # a process may have it open
        objects = [changed if changed and path == self._changed else own for path, own in self._objects.items()]
        command = [*core.compiler(), "-shared", *map(str, objects), "-o", str(made), "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        return made


class _Native(Forks):
    def __init__(self, shop: Workshop, door: Any, tally: Tally, mutants: Sequence[Mutant]) -> None:
        super().__init__(tally)
        self._shop, self._door, self._mutants = shop, door, mutants
        self._original = shop.original(_TRAPPED)

    def on_original(self, k: int) -> Callable[[], None]:
        return lambda: self._door.load(str(self._original))

    def judge(self) -> None:
        for mutant in self._mutants:
            try:
                if self._shop.alike(mutant.source, _QUICK):
                    self.tally.compiled_alike += 1
                    continue
                library = self._shop.linked("mutant.so", self._shop.compiled(mutant.source, "mutant.c", _TRAPPED))
            except core.BuildError:
                continue
            killed = self.is_killed(lambda made=library: self._door.load(str(made)))  # type: ignore[misc]
            if not killed and self._shop.alike(mutant.source, _THOROUGH):
                self.tally.compiled_alike += 1
            else:
                self.tally.count(mutant, killed=killed)


def judge_native(path: str, tests: Sequence[str], share: float, seed: int, *, root: Path) -> Tally:
    """Test every mutant of one C file of the core, or a sample.

    Raises:
        SystemExit: the tests fail on the original file, or it cannot be compiled.
    """
    drawn = [m for m in c_mutants((root / path).read_text()) if chosen(path, m, share, seed)]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "tally.json")

        def serve() -> str:
            tally = Tally(path, out=child.quiet())
            shop = Workshop(Path(folder), core.FLYING, root / path)
            sys.path.insert(0, str(root))
            door = importlib.import_module("estimator.core.library").CORE
            wrong = _Native(shop, door, tally, drawn).run([str(root / test) for test in tests])
            report.write_text(tally.dumped())
            return wrong

        in_server(path, tests, report, serve)
        return Tally.loaded(report.read_text())
