"""Mutants of the native core's C files.

Only the changed file is compiled; it is linked with the objects of the others. The door to the core loads the library that is
made of them in place of its own.
"""

import subprocess
from collections.abc import Sequence
from pathlib import Path

from supply import core

QUICK = ("-O1",)
"""Compiler options of the tests' library."""
THOROUGH = ("-O2",)
"""Compiler options of the shipped library."""
TRAPPED = (*THOROUGH, "-fsanitize=bounds-strict,object-size", "-fsanitize-undefined-trap-on-error", "-fstack-protector-all")
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

    def compiled(self, source: str, name: str, flags: Sequence[str] = QUICK) -> Path:
        """Compile one file with another text.

        Raises:
            BuildError: the compiler refuses it.
        """
        made = self._folder / f"{name}.o"
        places = [f"-I{folder}" for folder in self._library.includes]
        command = [*core.compiler(), *core.FLAGS, *flags, self._library.define, *places, "-xc", "-c", "-", "-o", str(made)]
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

    def linked(self, name: str, changed: Path | None = None) -> Path:
        """Link a library; `changed` is the object in place of the changed file's own."""
        made = self._folder / name
        made.unlink(missing_ok=True)  # a process may have it open
        objects = [changed if changed and path == self._changed else own for path, own in self._objects.items()]
        command = [*core.compiler(), "-shared", *map(str, objects), "-o", str(made), "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        return made
