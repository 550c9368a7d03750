"""The results of one file's mutants, and which of them a run tries."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from typing import TextIO

from mutants.equivalent import EQUIVALENT
from mutants.operators import Mutant


@dataclass(slots=True)
class Tally:
    """The results of one file's mutants."""

    path: str
    killed: int = 0
    survivors: list[Mutant] = field(default_factory=list)
    compiled_alike: int = 0
    """Mutants that the compiler translates to the same instructions as the original."""
    named: int = 0
    """Survivors that `mutants/equivalent.py` says cannot be distinguished from the original, each with its reason."""
    out: TextIO | None = None
    """Stream for survivors as they are found; None is the standard output."""

    @property
    def tried(self) -> int:
        """The number of mutants that a test could notice."""
        return self.killed + len(self.survivors)

    @property
    def share(self) -> float:
        """The share of killed mutants among those tried."""
        return self.killed / self.tried if self.tried else 1.0

    def dumped(self) -> str:
        """Return the counts as a text."""
        survivors = [(mutant.line, mutant.change) for mutant in self.survivors]
        return json.dumps([self.path, self.killed, survivors, self.compiled_alike, self.named])

    @classmethod
    def loaded(cls, text: str) -> Tally:
        """Return the counts that were dumped; the survivors' sources are empty."""
        path, killed, survivors, compiled_alike, named = json.loads(text)
        return cls(path, killed, [Mutant(line, change, "") for line, change in survivors], compiled_alike, named)

    def count(self, mutant: Mutant, killed: bool) -> None:
        """Count a mutant; print one that survives, and one that is killed though it is said to make no difference."""
        alike = EQUIVALENT.get(self.path, {})
        named = mutant.change in alike or f"{mutant.within}: {mutant.change}" in alike
        if killed:
            self.killed += 1
            if named:
                print(f"  killed though named equivalent, line {mutant.line}: {mutant.change}", file=self.out, flush=True)
        elif named:
            self.named += 1
        else:
            self.survivors.append(mutant)
            print(f"  survives, line {mutant.line}: {mutant.change}", file=self.out, flush=True)


def chosen(path: str, mutant: Mutant, share: float, seed: int) -> bool:
    """Return whether a mutant is in the sample; it depends on the seed, not on other changes in the file."""
    digest = hashlib.sha256(f"{seed} {path} {mutant.change}".encode()).digest()
    return int.from_bytes(digest[:6], "big") < share * 2**48
