"""Judge the mutants of one file: which of them a run tries, whether its tests notice, and the counts."""

import ast
import hashlib
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from mutants import child
from mutants.c_operators import c_mutants
from mutants.native import QUICK, THOROUGH, TRAPPED, Workshop
from mutants.operators import Mutant, mutants
from supply import core

_PATIENCE, _PATIENCE_S = 4.0, 20.0
"""Times as long as the tests take on the original, and some seconds, until a mutant counts as hanging, which is killed."""


@dataclass(slots=True)
class Tally:
    """The results of one file's mutants."""

    path: str
    killed: int = 0
    survivors: list[Mutant] = field(default_factory=list)
    alike: int = 0
    """Mutants that the compiler translates to the same instructions as the original; they are not tried."""

    @property
    def tried(self) -> int:
        """The number of mutants that a test could notice."""
        return self.killed + len(self.survivors)

    @property
    def share(self) -> float:
        """The share of killed mutants among those tried."""
        return self.killed / self.tried if self.tried else 1.0


def chosen(path: str, mutant: Mutant, share: float, seed: int) -> bool:
    """Return whether a mutant is in the sample; it depends on the seed, not on other changes in the file."""
    digest = hashlib.sha256(f"{seed} {path} {mutant.change}".encode()).digest()
    return int.from_bytes(digest[:6], "big") < share * 2**48


def judge(path: str, tests: Sequence[str], share: float, seed: int, *, root: Path) -> Tally:
    """Test every mutant of one file, or a sample, and print each that survives.

    Raises:
        SystemExit: the tests fail on the original file.
        BuildError: the core cannot be compiled.
    """
    tally, original = Tally(path), (root / path).read_text()
    drawn = [m for m in (c_mutants if path.endswith(".c") else mutants)(original) if chosen(path, m, share, seed)]
    with tempfile.TemporaryDirectory() as folder:
        cases = (_native if path.endswith(".c") else _interpreted)(path, root, [Mutant(0, "", original), *drawn], Path(folder))
        began = time.monotonic()
        _, prepare = next(cases)
        if prepare is None or not child.passes(prepare, root, tests, 900.0):
            raise SystemExit(f"{path}: its tests do not pass as it is: {' '.join(tests)}")
        patience_s = _PATIENCE_S + _PATIENCE * (time.monotonic() - began)
        for mutant, prepare in cases:
            if prepare is None:
                tally.alike += 1
            elif not child.passes(prepare, root, tests, patience_s):
                tally.killed += 1
            else:
                tally.survivors.append(mutant)
                print(f"  survives in {path}, line {mutant.line}: {mutant.change}", flush=True)
    return tally


_Cases = Iterator[tuple[Mutant, Callable[[], None] | None]]
"""Each source and what puts it in place of the original in a fork; None where it is compiled as the original is."""


def _interpreted(path: str, root: Path, sources: Sequence[Mutant], folder: Path) -> _Cases:
    plain = compile(ast.unparse(ast.parse(sources[0].source)), path, "exec")
    for mutant in sources:
        alike = mutant is not sources[0] and compile(mutant.source, path, "exec") == plain
        yield mutant, None if alike else partial(child.change_module, root, path, mutant.source)


def _native(path: str, root: Path, sources: Sequence[Mutant], folder: Path) -> _Cases:
    shop = Workshop(folder, core.FLYING, root / path)
    for mutant in sources:
        try:
            alike = mutant is not sources[0] and any(shop.alike(mutant.source, flags) for flags in (QUICK, THOROUGH))
            made = None if alike else shop.linked("mutant.so", shop.compiled(mutant.source, "mutant.c", TRAPPED))
        except core.BuildError:
            if mutant is sources[0]:
                raise
            continue
        yield mutant, None if made is None else partial(child.load_core, made)
