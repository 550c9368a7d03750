"""Measure the shape of the code: `python -m benches.house [COMMIT ...]`.

Prints, for the working tree and for each commit named, the modules and lines of each package, the import floors (the longest
chain of imports among the package's own modules) and the public class names that several modules define.
"""

from __future__ import annotations

import argparse
import ast
import subprocess
from collections import defaultdict
from collections.abc import Mapping
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("estimator", "estimator/vision", "estimator/ekf", "drivers", "companion", "companion/cli", "sitl", "tests", "benches")
SHIPPED = ("companion", "drivers", "estimator", "sitl")


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def sources(commit: str | None) -> dict[str, str]:
    """Return the text of every Python module by its path, of a commit or (None) of the working tree."""
    if commit is None:
        listed = _git("ls-files", "--cached", "--others", "--exclude-standard", "*.py").split()
        return {path: (ROOT / path).read_text(encoding="utf-8") for path in listed if (ROOT / path).is_file()}
    listed = [path for path in _git("ls-tree", "-r", "--name-only", commit).split() if path.endswith(".py")]
    return {path: _git("show", f"{commit}:{path}") for path in listed}


def module_name(path: str) -> str:
    """Return the dotted name of a module's path."""
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def floors(trees: Mapping[str, ast.Module]) -> int:
    """Return the number of floors: one more than the longest chain of imports among these modules (dotted name to tree)."""

    def imported(name: str) -> set[str]:
        found = set()
        for node in ast.walk(trees[name]):
            if isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    found.add(inner if inner in trees else node.module)
            elif isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
        return (found & trees.keys()) - {name}

    under_way: set[str] = set()

    @cache
    def floor(name: str) -> int:
        under_way.add(name)
        below = [floor(other) for other in imported(name) if other not in under_way]
        under_way.discard(name)
        return 1 + max(below, default=0)

    return max(map(floor, sorted(trees)), default=0)


def shared_names(trees: Mapping[str, ast.Module]) -> dict[str, list[str]]:
    """Return the public class names that several modules define, with those modules."""
    where = defaultdict(list)
    for name, tree in sorted(trees.items()):
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                where[node.name].append(name)
    return {name: modules for name, modules in where.items() if len(modules) > 1}


def describe(commit: str | None) -> None:
    """Print the figures of one state of the code."""
    texts = sources(commit)
    print(f"{commit or 'working tree'}\n  {'package':<18} {'modules':>7} {'lines':>7} {'floors':>6}")
    trees = {path: ast.parse(text) for path, text in texts.items()}
    for package in PACKAGES:
        inside = [path for path in texts if path.startswith(package + "/")]
        lines = sum(texts[path].count("\n") for path in inside)
        height = floors({module_name(path): trees[path] for path in inside})
        print(f"  {package:<18} {len(inside):>7} {lines:>7} {height:>6}")
    shared = shared_names({module_name(p): tree for p, tree in trees.items() if p.startswith(SHIPPED) and "/testing/" not in p})
    print(f"  class names with more than one meaning: {len(shared)}")
    for name, modules in sorted(shared.items()):
        print(f"    {name}: {', '.join(modules)}")


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benches.house", description="Measure the shape of the code.")
    parser.add_argument("commits", nargs="*", metavar="COMMIT", help="describe these too")
    for commit in [*parser.parse_args().commits, None]:
        describe(commit)


if __name__ == "__main__":
    main()
