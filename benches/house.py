"""Measure the shape of the code: `python -m benches.house`.

Prints one row a figure: its name, what is asked, its limit, and what it is in the working tree. `--check` fails where a figure is
worse than its limit in house.toml, and prints what the figure counts. `--tighten` sets each limit to the figure where that is
better. A change that adds lines finds as many to remove, or raises the limit in
house.toml in its own commit and gives the reason there.
"""

from __future__ import annotations

import argparse
import ast
import gc
import re
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import tomlkit

from benches import house_counts as counts
from benches.options import parsed

ROOT = Path(__file__).parents[1]
LIMITS = Path(__file__).with_suffix(".toml")
PRODUCT = ("companion/", "decklander/", "drivers/", "estimator/", "sitl/")
AROUND = ("benches/", "fuzz/", "mutants/", "supply/")
CODE = (".py", ".c", ".h", ".js", ".css")
PARAMETERS_MAX = 8
HELPERS_MAX = 3
FLYING = "estimator/core/decklander.h"
HEADERS = (FLYING, "sitl/core/decklander_sim.h")
_BARRED = {"companion.parts.mavlink.bridge"}
"""Parts of the service that an autopilot bars (`AutopilotOptions.barred`)."""
EXPERT = "## Expert keys"
"""The heading of docs/configuration.md below which the keys of experts stand."""


class Tree:
    """The text of every file of code of the working tree, by path."""

    def __init__(self) -> None:
        self.texts = dict(_working())

    def under(self, *places: str, ending: tuple[str, ...] = CODE) -> dict[str, str]:
        """Return the files of some folders by their endings."""
        return {path: text for path, text in self.texts.items() if path.startswith(places) and path.endswith(ending)}

    @cached_property
    def modules(self) -> dict[str, ast.Module]:
        """The product's Python modules by dotted name."""
        return {_dotted(path): ast.parse(text) for path, text in self.under(*PRODUCT, ending=(".py",)).items()}

    @cached_property
    def nodes(self) -> dict[str, list[ast.AST]]:
        """The nodes of each of the product's modules, outer ones first."""
        return {name: list(ast.walk(tree)) for name, tree in self.modules.items()}

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """The product's modules that each module imports, in functions, under TYPE_CHECKING and by `import_module` too."""
        return {name: set(_imported(name, nodes, self.modules)) - {name} for name, nodes in self.nodes.items()}

    @cached_property
    def lines_of(self) -> dict[str, int]:
        """The lines of each of the product's Python modules."""
        return {_dotted(path): text.count("\n") for path, text in self.under(*PRODUCT, ending=(".py",)).items()}

    @cached_property
    def code_lines(self) -> Counter[str | None]:
        """The lines of code of what flies, of each capability, and of all else."""
        found = Counter[str | None]()
        for path, text in self.under(*PRODUCT).items():
            tree = self.modules.get(_dotted(path)) or ast.parse(text) if path.endswith(".py") else None
            found[counts.owner(path)] += counts.code_lines(text, tree)
        return found

    @cached_property
    def constants(self) -> list[tuple[str, counts.Constant]]:
        """The numeric constants of the product's Python modules."""
        texts = {_dotted(path): text for path, text in self.under(*PRODUCT, ending=(".py",)).items()}
        return [(name, constant) for name, tree in self.modules.items() for constant in counts.constants(texts[name], tree)]

    @cached_property
    def paths(self) -> list[tuple[int, str]]:
        """The number of paths (cyclomatic) of each function of the product, Python and C."""
        python = [(n, f"{name}.{function}") for name, nodes in self.nodes.items() for function, n in counts.python_paths(nodes)]
        texts = self.under(*PRODUCT, ending=(".c",)).items()
        return python + [(n, f"{path}:{function}") for path, text in texts for function, n in counts.c_paths(text)]

    @cached_property
    def c_texts(self) -> dict[str, str]:
        """The C files without their comments, and without the headers of the libraries."""
        texts = self.under(*PRODUCT, ending=(".c", ".h")).items()
        return {path: counts.without_comments(text) for path, text in texts if path not in HEADERS}

    @cached_property
    def rooms(self) -> dict[str, tuple[int, int]]:
        """The numbers of rooms (files and folders) in each of the product's folders, and of arrows (imports) between them."""
        python = {name.replace(".", "/"): {end.replace(".", "/") for end in ends} for name, ends in self.imports.items()}
        found = counts.rooms(python | counts.c_units(self.c_texts), "/")
        return {folder: (len(children), counts.arrows(children)) for folder, children in found.items()}

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


def _dotted(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _imported(name: str, nodes: Iterable[ast.AST], known: Mapping[str, ast.Module]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*name.split(".")[: -node.level], *([base] if base else [])])
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                yield from (found for found in (inner if inner in known else base,) if found in known)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif (
            isinstance(node, ast.Call)
            and ast.unparse(node.func).endswith("import_module")
            and isinstance(node.args[0], ast.Constant)
        ):
            yield from {str(node.args[0].value)} & known.keys()


def _count(parameters: str) -> int:
    inside = parameters.strip()
    return 0 if inside in ("", "void") else inside.count(",") + 1


def floors(edges: Mapping[str, Iterable[str]]) -> tuple[int, set[str]]:
    """Return the nodes of the longest chain of a graph, and the nodes that lie on or above a circle."""
    left, found = {node: set(ends) & set(edges) for node, ends in edges.items()}, 0
    while ground := {node for node, ends in left.items() if not ends & left.keys()}:
        left = {node: ends for node, ends in left.items() if node not in ground}
        found += 1
    return found, set(left)


def reached(edges: Mapping[str, Iterable[str]], *starts: str) -> set[str]:
    """Return the nodes that some nodes lead to."""
    seen: set[str] = set()
    todo = list(starts)
    while todo:
        new = set(edges.get(todo.pop(), ())) - seen
        seen |= new
        todo += new
    return seen


def circles(edges: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Return the groups of nodes that reach each other (strongly connected, of two or more)."""
    reach = {node: reached(edges, node) for node in floors(edges)[1]}
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


def wide_python(tree: Tree) -> list[str]:
    """Return the product's functions and constructors with more parameters than are allowed, without self and cls."""
    found = []
    for name, nodes in tree.nodes.items():
        for node in nodes:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                taken = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                if len([a for a in taken if a not in ("self", "cls")]) > PARAMETERS_MAX:
                    found.append(f"{name}.{node.name}")
    return found


def entries(tree: Tree) -> list[tuple[str, int]]:
    """Return the entries of the native door of what flies, with their numbers of parameters."""
    return [(name, _count(inside)) for name, inside in _PROTOTYPE.findall(_COMMENT.sub(" ", tree.texts[FLYING]))]


_MEMBERS_OF_ONE_COMMENT = 3


def bare_members(tree: Tree) -> list[str]:
    """Return the members of the headers' structures without a comment above them or behind them on their line.

    A comment serves at most three members of one declaration.
    """
    found = []
    for header in HEADERS:
        for inside, kind in re.findall(r"typedef struct \{(.*?)\n\} (\w+);", tree.texts.get(header, ""), re.DOTALL):
            has_comment = False
            for line in inside.splitlines():
                code = _COMMENT.sub("", line).strip()
                has_comment |= "*/" in line
                names = re.findall(r"(\w+)(?:\[[^]]*\])*\s*[,;]", code)
                if not has_comment or len(names) > _MEMBERS_OF_ONE_COMMENT:
                    found += [f"{kind}.{name}" for name in names]
                has_comment &= ";" not in code
    return found


def bare_names(tree: Tree) -> list[str]:
    """Return the types, enumerators and entries of the headers that do not begin with dl_."""
    found = []
    for header in HEADERS:
        text = re.sub(r"^#.*$", "", _COMMENT.sub(" ", tree.texts.get(header, "")), flags=re.MULTILINE)
        found += re.findall(r"^\} (\w+);", text, re.MULTILINE) + re.findall(r"\benum (\w+) \{", text)
        found += [name for name, _ in _PROTOTYPE.findall(text)]
        for inside in re.findall(r"\benum \w* ?\{(.*?)\}", text, re.DOTALL):
            found += re.findall(r"(?:^|,)\s*([A-Z]\w*)", inside)
    return [name for name in found if not name.lower().startswith("dl_")]


def public_keys(tree: Tree) -> int:
    """Return the number of keys that docs/configuration.md shows to everybody."""
    page = tree.texts.get("docs/configuration.md", "").partition(EXPERT)[0]
    return len(re.findall(r"^\| `\w+` \|", page, re.MULTILINE))


def lines(tree: Tree, *places: str) -> int:
    """Return the lines of code below some folders, or of the whole project."""
    return sum(text.count("\n") for text in tree.under(*(places or ("",))).values())


def repeated_helpers(tree: Tree) -> list[str]:
    """Return the names of functions, not tests, that more than three files of tests define at their top level."""
    files: dict[str, set[str]] = defaultdict(set)
    for path, text in tree.under("tests/", "qualification/", ending=(".py",)).items():
        for node in ast.parse(text).body:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("test_"):
                files[node.name].add(path)
    return sorted(name for name, where in files.items() if len(where) > HELPERS_MAX)


def contracts(tree: Tree) -> int:
    """Return the number of contracts that lint-imports holds."""
    return tree.texts.get("pyproject.toml", "").count("[[tool.importlinter.contracts]]")


def lines_of_run(tree: Tree) -> int:
    """Return the lines of Python that `run` with an autopilot and a V4L2 camera imports, in functions and by tables too.

    Rows of tables that such a run does not load are left out: other vehicles, cameras, methods and paths, and the page's tools.
    """
    named = re.findall(r'"(companion[\w.]+):\w+"', tree.texts["companion/service/parts.py"])
    starts = {"companion.cli.run", "companion.parts.mavlink.make", "drivers.camera.v4l2", *named} - _BARRED
    return sum(tree.lines_of[name] for name in starts.union(*(reached(tree.imports, start) for start in starts)))


def guidance(tree: Tree) -> dict[str, dict[str, set[str]]]:
    """Return the files and folders of companion.guidance, and of each folder in it, with those beside them that they import."""
    return {name: children for name, children in counts.rooms(tree.imports, ".").items() if name.startswith("companion.guidance")}


def constants(tree: Tree, chosen: Callable[[counts.Constant], bool]) -> list[str]:
    """Return the names of the numeric constants that are chosen."""
    return [f"{module}.{name}" for module, constant in tree.constants if chosen(constant) for name in constant.names]


def branching(tree: Tree) -> list[str]:
    """Return the functions of more paths than are asked, the worst first."""
    return [f"{name}: {n}" for n, name in sorted(tree.paths, reverse=True) if n > counts.PATHS_MAX]


def crowded(tree: Tree) -> list[str]:
    """Return the folders of more rooms or arrows than are asked."""
    over = ((name, n, arrows) for name, (n, arrows) in tree.rooms.items() if n > counts.ROOMS_MAX or arrows > counts.ARROWS_MAX)
    return [f"{name}: {n} rooms, {arrows} arrows" for name, n, arrows in over]


def asks_vehicle(tree: Tree) -> list[str]:
    """Return the places that ask by its type which kind of vehicle some options are of."""
    return [f"{name}:{line}" for name, nodes in tree.nodes.items() for line in counts.asks_vehicle(nodes)]


@dataclass(frozen=True)
class Figure:
    """One row: its key in house.toml, what is asked, and how it is counted."""

    label: str
    asked: float | None
    count: Callable[[Tree], float]
    names: Callable[[Tree], Iterable[object]] = lambda _: ()
    """Lists what it counts."""
    more_is_better: bool = False

    def is_worse(self, value: float, limit: float) -> bool:
        """Compare a value with the limit."""
        return value < limit if self.more_is_better else value > limit


def counted(label: str, asked: float | None, names: Callable[[Tree], Iterable[object]]) -> Figure:
    """Return the figure that counts what it names."""
    return Figure(label, asked, lambda tree: len(list(names(tree))), names)


def wide_c(tree: Tree) -> list[str]:
    """Return the C functions with more parameters than are allowed."""
    return [f"{path}:{name}" for path, name, n in tree.c_functions if n > PARAMETERS_MAX]


def wide_entries(tree: Tree) -> list[str]:
    """Return the entries of the flying library with more parameters than are allowed."""
    return [name for name, n in entries(tree) if n > PARAMETERS_MAX]


def lines_of_code(part: str) -> Figure:
    """Return the figure of a part's lines of code, without blank lines, comments and docstrings."""
    return Figure(f"code: {part}", None, lambda tree: tree.code_lines[part])


FIGURES = (
    counted("circles of packages", 0, package_circles),
    counted("circles of Python files", 0, lambda t: circles(t.imports)),
    counted("circles of C files", 0, c_circles),
    Figure("contracts of lint-imports", None, contracts, more_is_better=True),
    counted("entries of the flying library", 25, entries),
    counted("entries of more than 8 parameters", 0, wide_entries),
    counted("C functions of more than 8 parameters", 0, wide_c),
    counted("Python functions of more than 8", 0, wide_python),
    counted("header members without a comment", 0, bare_members),
    counted("names without dl_", 0, bare_names),
    counted("constants and types of two C files", 0, lambda t: counts.c_shared_names(t.c_texts)),
    counted("constants after the first function", 100, lambda t: constants(t, lambda c: c.late)),
    counted("constants packed with unlike ones", 0, lambda t: constants(t, lambda c: c.is_packed)),
    counted("constants without words or source", 0, lambda t: constants(t, lambda c: c.bare)),
    Figure("most paths of a function", counts.PATHS_MAX, lambda t: max(t.paths)[0], branching),
    counted("functions of more than 15 paths", 0, branching),
    Figure("most rooms of a folder", counts.ROOMS_MAX, lambda t: max(n for n, _ in t.rooms.values()), crowded),
    Figure("most arrows of a folder", counts.ARROWS_MAX, lambda t: max(arrows for _, arrows in t.rooms.values()), crowded),
    counted("folders over 12 rooms or 40 arrows", 0, crowded),
    counted("questions for the kind of vehicle", 0, asks_vehicle),
    Figure("public keys", 130, public_keys),
    Figure("most import floors of a guidance folder", 7, lambda t: max(floors(rooms)[0] for rooms in guidance(t).values())),
    *map(lines_of_code, counts.OWNERS),
    Figure("lines of Python that run reaches", 52_000, lines_of_run),
    Figure("lines of the product", 118_000, lambda t: lines(t, *PRODUCT)),
    Figure("lines of tests", 60_000, lambda t: lines(t, "tests/", "qualification/")),
    counted("test helpers of one name in 4 files", 0, repeated_helpers),
    Figure("lines of benches, fuzz, mutants, supply", 8_000, lambda t: lines(t, *AROUND)),
    Figure("lines of all code", 186_000, lines),
)


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benches.house", description="Measure the shape of the code.")
    parser.add_argument("--check", action="store_true", help="fail where a figure is worse than its limit")
    parser.add_argument("--tighten", action="store_true", help="set each limit to the figure where that is better")
    args = parsed(parser, "")
    gc.disable()  # the trees' millions of nodes stay to the end
    tree, limits, failed = Tree(), tomlkit.parse(LIMITS.read_text()), False
    print(f"{'':<40}{'asked':>10}{'limit':>10}{'now':>10}")
    for figure in FIGURES:
        value = round(figure.count(tree), 2)
        limit, asked = limits.get(figure.label, value), "" if figure.asked is None else figure.asked
        print(f"{figure.label:<40}{asked:>10}{limit:>10}{value:>10}")
        if args.tighten and not figure.is_worse(value, limit):
            limits[figure.label] = value
        elif args.check and figure.is_worse(value, limit):
            print(f"worse than its limit in {LIMITS.name}: {figure.label}", *figure.names(tree), sep="\n  ", file=sys.stderr)
            failed = True
    if args.tighten:
        LIMITS.write_text(tomlkit.dumps(limits))
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
