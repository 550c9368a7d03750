"""Measure the shape of the code: `python -m benches.house [COMMIT ...]`.

Prints one row a figure: its name, one column for each commit and one for the working tree. Without a commit the first column
is that of the commit from which the house was rebuilt, where the clone has it.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import tarfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[1]
REBUILT_FROM = "34a8ccc7"
PRODUCT = ("companion", "drivers", "estimator", "sitl")
CODE = (".py", ".c", ".h", ".js", ".css")
PARAMETERS_MAX = 8
EXPERT = "## Expert keys"
"""The heading of docs/configuration.md below which the keys of experts stand."""


class Tree:
    """The text of every file of code of one state of the project, by path."""

    def __init__(self, commit: str | None) -> None:
        self.texts = dict(_committed(commit) if commit else _working())

    def under(self, *places: str, ending: tuple[str, ...] = CODE) -> dict[str, str]:
        """Return the files of some folders by their endings."""
        return {path: text for path, text in self.texts.items() if path.startswith(places) and path.endswith(ending)}

    @cached_property
    def modules(self) -> dict[str, ast.Module]:
        """The product's Python modules by dotted name."""
        return {_dotted(path): ast.parse(text) for path, text in self.under(*PRODUCT, ending=(".py",)).items()}

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """The product's modules that each module imports, in functions and under TYPE_CHECKING too."""
        return {name: set(_imported(name, tree, self.modules)) - {name} for name, tree in self.modules.items()}

    @cached_property
    def c_functions(self) -> list[tuple[str, str, int]]:
        """Every function that a C file defines: file, name and number of parameters."""
        found = []
        for path, text in self.under("estimator", "sitl", ending=(".c",)).items():
            for name, inside in _DEFINITION.findall(_COMMENT.sub(" ", text)):
                found.append((path, name, _count(inside)))
        return found


_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_DEFINITION = re.compile(r"^[A-Za-z_][\w \t*]*?\**(\w+)\(([^(){};]*(?:\([^()]*\)[^(){};]*)*)\)\s*\{", re.MULTILINE)
_PROTOTYPE = re.compile(r"^[A-Za-z_][\w \t*]*?\**(\w+)\(([^(){};]*)\)\s*;", re.MULTILINE)


def _working() -> Iterator[tuple[str, str]]:
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout.split("\0")
    for path in listed:
        if path.endswith((*CODE, ".md", ".toml")) and (ROOT / path).is_file():
            yield path, (ROOT / path).read_text(encoding="utf-8")


def _committed(commit: str) -> Iterator[tuple[str, str]]:
    packed = subprocess.run(["git", "archive", commit], cwd=ROOT, check=True, capture_output=True).stdout
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for member in archive:
            if member.isfile() and member.name.endswith((*CODE, ".md", ".toml")) and (file := archive.extractfile(member)):
                yield member.name, file.read().decode()


def _dotted(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _imported(name: str, tree: ast.Module, known: Mapping[str, ast.Module]) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*name.split(".")[: -node.level], *([base] if base else [])])
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                yield from (found for found in (inner if inner in known else base,) if found in known)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)


def _count(parameters: str) -> int:
    inside = parameters.strip()
    return 0 if inside in ("", "void") else inside.count(",") + 1


def circles(edges: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Return the groups of nodes that reach each other (strongly connected, of two or more)."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        todo = [start]
        while todo:
            new = set(edges.get(todo.pop(), ())) - seen
            seen |= new
            todo += new
        return seen

    reach = {node: reached(node) for node in edges}
    groups = {tuple(sorted(n for n in ends if node in reach.get(n, ()))) for node, ends in reach.items() if node in ends}
    return sorted(list(group) for group in groups)


def package_circles(tree: Tree) -> list[list[str]]:
    """Return the circles among the packages inside each top-level folder, and inside each folder of those."""
    edges: dict[str, set[str]] = defaultdict(set)
    packages = {name for name, module in tree.modules.items() if any(other.startswith(name + ".") for other in tree.modules)}
    for name, imported in tree.imports.items():
        for other in imported:
            mine, theirs = name.split("."), other.split(".")
            shared = next((n for n, (a, b) in enumerate(zip(mine, theirs, strict=False)) if a != b), 0)
            here, there = ".".join(mine[: shared + 1]), ".".join(theirs[: shared + 1])
            if shared and here != there and here in packages and there in packages:
                edges[here].add(there)
    return circles(edges)


def c_circles(tree: Tree) -> list[list[str]]:
    """Return the circles among C files by the functions that they define and call."""
    texts = {path: _COMMENT.sub(" ", text) for path, text in tree.under("estimator", "sitl", ending=(".c",)).items()}
    homes = {d[1]: path for path, text in texts.items() for d in _DEFINITION.finditer(text) if not d[0].startswith("static")}
    edges = {path: {homes[w] for w in re.findall(r"\b\w+(?=\()", text) if w in homes} - {path} for path, text in texts.items()}
    return circles(edges)


def one_importer(tree: Tree) -> list[str]:
    """Return the modules that exactly one other module of the product imports."""
    importers: dict[str, set[str]] = defaultdict(set)
    for name, imported in tree.imports.items():
        for other in imported:
            importers[other].add(name)
    packages = {path for path in tree.texts if path.endswith("__init__.py")}
    return sorted(
        name for name, who in importers.items() if len(who) == 1 and f"{name.replace('.', '/')}/__init__.py" not in packages
    )


def import_share(tree: Tree) -> float:
    """Return the share of the product's lines of Python that import statements take, percent."""
    lines = sum(text.count("\n") for text in tree.under(*PRODUCT, ending=(".py",)).values())
    taken = sum(
        node.end_lineno - node.lineno + 1
        for module in tree.modules.values()
        for node in ast.walk(module)
        if isinstance(node, ast.Import | ast.ImportFrom) and node.end_lineno
    )
    return 100 * taken / lines


def wide_python(tree: Tree) -> list[str]:
    """Return the product's functions and constructors with more parameters than are allowed, without self and cls."""
    found = []
    for name, module in tree.modules.items():
        for node in ast.walk(module):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                taken = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                if len([a for a in taken if a not in ("self", "cls")]) > PARAMETERS_MAX:
                    found.append(f"{name}.{node.name}")
    return found


def entries(tree: Tree, *headers: str) -> list[tuple[str, int]]:
    """Return the entries of the native door with their numbers of parameters, by the first of these headers that is there."""
    text = next((tree.texts[header] for header in headers if header in tree.texts), "")
    return [(name, _count(inside)) for name, inside in _PROTOTYPE.findall(_COMMENT.sub(" ", text))]


FLYING = ("estimator/core/decklander.h", "estimator/core/interface.h")


def public_keys(tree: Tree) -> int:
    """Return the number of keys that docs/configuration.md shows to everybody."""
    page = tree.texts.get("docs/configuration.md", "").partition(EXPERT)[0]
    return len(re.findall(r"^\| `\w+` \|", page, re.MULTILINE))


def lines(tree: Tree, *places: str) -> int:
    """Return the lines of code below some folders, or of the whole project."""
    return sum(text.count("\n") for text in tree.under(*(places or ("",))).values())


def contracts(tree: Tree) -> int:
    """Return the number of contracts that lint-imports holds."""
    return tree.texts.get("pyproject.toml", "").count("[[tool.importlinter.contracts]]")


FIGURES: tuple[tuple[str, str, Callable[[Tree], float]], ...] = (
    ("circles of packages", "0", lambda t: len(package_circles(t))),
    ("packages in circles", "0", lambda t: sum(map(len, package_circles(t)))),
    ("circles of Python files", "0", lambda t: len(circles(t.imports))),
    ("circles of C files", "0", lambda t: len(c_circles(t))),
    ("contracts of lint-imports", "", contracts),
    ("entries of the flying library", "<= 25", lambda t: len(entries(t, *FLYING))),
    ("  of more than 8 parameters", "0", lambda t: sum(n > PARAMETERS_MAX for _, n in entries(t, *FLYING))),
    ("C functions of more than 8 parameters", "0", lambda t: sum(n > PARAMETERS_MAX for *_, n in t.c_functions)),
    ("Python functions of more than 8", "0", lambda t: len(wide_python(t))),
    ("modules of the product", "", lambda t: len(t.modules)),
    ("  with exactly one importer", "<= 90", lambda t: len(one_importer(t))),
    ("  median lines", "", lambda t: median(x.count("\n") for x in t.under(*PRODUCT, ending=(".py",)).values())),
    ("import lines, %", "<= 6", import_share),
    ("public keys", "<= 130", public_keys),
    ("lines of the product", "", lambda t: lines(t, *PRODUCT)),
    ("lines of tests", "<= 62000", lambda t: lines(t, "tests/")),
    ("lines of all code", "<= 170000", lines),
)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benches.house", description="Measure the shape of the code.")
    parser.add_argument("commits", nargs="*", metavar="COMMIT", help=f"describe these (default: {REBUILT_FROM})")
    parser.add_argument("--names", action="store_true", help="name what the figures of the working tree count")
    args = parser.parse_args()
    commits = args.commits or [
        c for c in (REBUILT_FROM,) if not subprocess.run(["git", "cat-file", "-e", c], cwd=ROOT).returncode
    ]
    trees = [Tree(commit) for commit in commits] + [now := Tree(None)]
    print(f"{'':<40}{'asked':>10}" + "".join(f"{c:>12}" for c in [*commits, "now"]))
    for label, asked, figure in FIGURES:
        print(f"{label:<40}{asked:>10}" + "".join(f"{figure(tree):>12.10g}"[:12] for tree in trees))
    if args.names:
        for label, names in (
            ("circles", [*package_circles(now), *circles(now.imports), *c_circles(now)]),
            (
                "more than 8 parameters",
                [*wide_python(now), *(f"{p}:{f} {n}" for p, f, n in now.c_functions if n > PARAMETERS_MAX)],
            ),
            ("one importer", one_importer(now)),
        ):
            print(f"\n{label}:", *names, sep="\n  ")


if __name__ == "__main__":
    main()
