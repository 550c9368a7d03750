"""Counts of `benches.house` that cannot be met by gluing files or packing lines: code by capability, constants, paths, rooms."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

PATHS_MAX, ROOMS_MAX, ARROWS_MAX = 15, 12, 40

FLIES = "what flies"
OWNERS: Mapping[str, tuple[str, ...]] = {
    FLIES: (
        "companion/base/", "companion/cycle/", "companion/facts/", "companion/guidance/", "companion/recording/",
        "companion/service/", "companion/settings/", "drivers/camera/", "drivers/clock", "drivers/confined.py",
        "drivers/datagrams.py", "drivers/device_errors.py", "drivers/endpoint.py", "drivers/extras.py", "drivers/files.py",
        "drivers/mailbox.py", "drivers/mavlink/", "drivers/one_source.py", "drivers/pyav.py", "drivers/reconnect.py",
        "drivers/vehicle.py", "drivers/wires.py", "estimator/",
    ),
    "AR.Drone": (
        "companion/parts/ardrone/", "companion/parts/mavlink/bridge/", "drivers/ardrone/", "estimator/core/video/",
        "estimator/uvlc.py", "sitl/ardrone/", "sitl/core/video/", "sitl/emulators/ardrone/",
    ),
    "ship's wires": ("companion/parts/ship/", "drivers/nmea/", "drivers/relpos.py"),
    "MQTT and watch": ("companion/cli/watch.py", "companion/parts/mqtt/"),
    "ROS 2": ("companion/cli/ros2.py", "companion/tools/ros2/", "drivers/camera/ros2.py", "drivers/ros2.py"),
    "Foxglove": ("companion/parts/live/",),
    "gamepad": ("companion/cli/gamepad.py", "companion/parts/gamepad/", "drivers/gamepad/"),
    "campaigns and studies": ("companion/cli/campaign.py", "sitl/campaign/", "sitl/study/perception/"),
    "pads from pictures, printing": ("companion/cli/pad.py", "companion/tools/pads/", "companion/tools/print_pad/"),
    "imports of others' files": ("companion/cli/config_import.py", "companion/tools/others_settings.py", "drivers/imports/"),
    "learned parts": (
        "companion/cli/train.py", "companion/guidance/law/policy.py", "companion/tools/second_opinion.py",
        "estimator/vision/learned/", "sitl/core/training/", "sitl/study/gym/",
    ),
    "thesis": (
        "companion/cli/experiments.py", "companion/guidance/thesis.py", "estimator/constant_velocity.py",
        "estimator/dead_reckoning.py", "estimator/vision/thesis/", "estimator/vision/track/by_thesis.py",
        "sitl/study/experiments/",
    ),
}  # fmt: skip
"""Beginnings of the paths of what flies and of each capability; the longest one that fits has the file."""

VEHICLE_OPTIONS = frozenset({"ArDroneOptions", "AutopilotOptions", "MavlinkOptions"})
_C_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_C_BODY = re.compile(r"^[A-Za-z_][^;{}#]*?(\w+)\([^;{}]*\)\s*\{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
_C_BRANCH = re.compile(r"\b(?:if|for|while|case)\b|&&|\|\||\?")
_C_OWN_NAME = re.compile(r"^#define (\w+)|^static const \w[\w ]* (\w+)(?:\[| =)|^\} (\w+);$", re.MULTILINE)
_LAST_WORD = 3
"""The most letters of a word that may be a unit, so that it alone makes two constants no pair."""


def owner(path: str) -> str | None:
    """Return what flies, the capability, or None for what is neither, that a file belongs to."""
    fits = ((len(start), name) for name, starts in OWNERS.items() for start in starts if path.startswith(start))
    return max(fits, default=(0, None))[1]


def without_comments(text: str) -> str:
    """Return C, JavaScript or style sheets with the lines of each comment left empty."""
    return _C_COMMENT.sub(lambda found: re.sub(r"[^\n]", "", found[0]), text)


def docstring_lines(nodes: Iterable[ast.AST]) -> set[int]:
    """Return the lines that texts without a use take: docstrings of modules, functions, classes and values."""
    return {
        line
        for node in nodes
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }


def code_lines(text: str, tree: ast.Module | None) -> int:
    """Return the lines of a file without blank lines, comments and, if it is Python, docstrings."""
    if tree is None:
        return sum(1 for line in without_comments(text).splitlines() if line.strip())
    skipped = docstring_lines(ast.walk(tree))
    numbered = enumerate(text.splitlines(), start=1)
    return sum(1 for n, line in numbered if n not in skipped and line.strip() and not line.lstrip().startswith("#"))


class Constant:
    """A module's numeric constants of one assignment."""

    def __init__(self, names: Sequence[str], *, late: bool, bare: bool) -> None:
        self.names = names
        self.late = late
        """It stands after the first function or class."""
        self.bare = bare
        """No text below it, no comment above it or beside it says what it is."""

    @property
    def is_packed(self) -> bool:
        """Several constants of unlike things: no word of more than three letters is in all of their names."""
        words = [{word for word in name.split("_") if len(word) > _LAST_WORD} for name in self.names]
        return len(self.names) > 1 and not set.intersection(*words)


def _is_number(value: ast.expr, known: set[str]) -> bool:
    match value:
        case ast.Constant(value=number):
            return isinstance(number, int | float) and not isinstance(number, bool)
        case ast.Name(id=name):
            return name in known
        case ast.UnaryOp(operand=inner):
            return _is_number(inner, known)
        case ast.BinOp(left=left, right=right):
            return _is_number(left, known) and _is_number(right, known)
        case ast.Call(func=function, args=args):
            return ast.unparse(function).startswith(("math.", "np.radians")) and all(_is_number(a, known) for a in args)
    return False


def constants(text: str, tree: ast.Module) -> Iterator[Constant]:
    """Yield the numeric constants of a module, those computed from others by arithmetic too."""
    lines, known, late = text.splitlines(), set[str](), False
    for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        late |= isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)):
                pairs = list(zip(names, values, strict=False))
            case (
                ast.Assign(targets=[ast.Name() as name], value=value)
                | ast.AnnAssign(target=ast.Name() as name, value=ast.expr() as value)
            ):
                pairs = [(name, value)]
            case _:
                continue
        found = [name.id for name, value in pairs if isinstance(name, ast.Name) and _is_number(value, known)]
        known.update(found)
        if found:
            beside = lines[max(node.lineno - 2, 0)].lstrip().startswith("#") or "#" in "".join(
                lines[node.lineno - 1 : node.end_lineno]
            )
            yield Constant(found, late=late, bare=not beside and not docstring_lines([after] if after else []))


def python_paths(nodes: Iterable[ast.AST]) -> Iterator[tuple[str, int]]:
    """Yield each function's name and number of paths (cyclomatic), without those of functions inside it."""
    owners, paths, names = dict[int, int](), Counter[int](), dict[int, str]()
    branches = list[tuple[int, int]]()
    for node in nodes:  # outer functions come before inner ones
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names[node.lineno], paths[node.lineno] = node.name, 1
            owners |= dict.fromkeys(range(node.lineno, (node.end_lineno or node.lineno) + 1), node.lineno)
        elif isinstance(node, ast.If | ast.IfExp | ast.For | ast.AsyncFor | ast.While | ast.ExceptHandler):
            branches.append((node.lineno, 1))
        elif isinstance(node, ast.BoolOp):
            branches.append((node.lineno, len(node.values) - 1))
        elif isinstance(node, ast.comprehension):
            branches.append((node.target.lineno, 1 + len(node.ifs)))
        elif isinstance(node, ast.match_case):
            branches.append((node.pattern.lineno, 1))
    for line, more in branches:
        if line in owners:
            paths[owners[line]] += more
    yield from ((names[line], count) for line, count in paths.items())


def c_paths(text: str) -> Iterator[tuple[str, int]]:
    """Yield each C function's name and number of paths (cyclomatic)."""
    for name, body in _C_BODY.findall(without_comments(text)):
        yield name, 1 + len(_C_BRANCH.findall(body))


def asks_vehicle(nodes: Iterable[ast.AST]) -> Iterator[int]:
    """Yield the lines that ask by its type which kind of vehicle some options are of."""
    for node in nodes:
        match node:
            case ast.Call(func=ast.Name(id="isinstance"), args=[_, kinds]) | ast.MatchClass(cls=kinds):
                if VEHICLE_OPTIONS & {inner.id for inner in ast.walk(kinds) if isinstance(inner, ast.Name)}:
                    yield node.lineno


def rooms(edges: Mapping[str, Iterable[str]], separator: str) -> dict[str, dict[str, set[str]]]:
    """Return each folder's children, and for each of those the children beside it that its files import.

    Args:
        edges: the files that each file imports, as paths with this separator.
    """
    found: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for name, ends in edges.items():
        parts = name.split(separator)
        for depth in range(1, len(parts)):
            folder = separator.join(parts[:depth])
            beside = {end.split(separator)[depth] for end in ends if end.startswith(folder + separator)}
            found[folder][parts[depth]] |= beside - {parts[depth]}
    return found


def arrows(children: Mapping[str, Iterable[str]]) -> int:
    """Return the number of imports between a folder's children."""
    return sum(len(set(ends)) for ends in children.values())


def c_units(texts: Mapping[str, str]) -> dict[str, set[str]]:
    """Return each C unit (a file with the header of its name, without ending) with the units that it includes, or calls.

    Args:
        texts: the files of C by path, without comments.
    """

    def unit(path: str) -> str:
        return path.rpartition(".")[0]

    homes = {
        name: unit(path)
        for path, text in texts.items()
        for head, name in re.findall(r"^([A-Za-z_][\w \t*]*?)\**(\w+)\([^;{}]*\)\s*\{", text, re.MULTILINE)
        if path.endswith(".c") and not head.startswith("static")
    }
    found: dict[str, set[str]] = defaultdict(set)
    for path, text in texts.items():
        included = {
            unit(other) for name in re.findall(r'#include "([\w/.]+)"', text) for other in texts if other.endswith("/" + name)
        }
        called = {homes[word] for word in re.findall(r"\b\w+(?=\()", text) if word in homes}
        found[unit(path)] |= (included | called) - {unit(path)}
    return found


def c_shared_names(texts: Mapping[str, str]) -> list[str]:
    """Return the constants, macros and types that two C files of one library define.

    Args:
        texts: the files of C by path, without comments.
    """
    homes: dict[tuple[str, str], set[str]] = defaultdict(set)
    for path, text in texts.items():
        for names in _C_OWN_NAME.findall(text):
            homes[path.partition("/")[0], next(filter(None, names))].add(path)
    return sorted(f"{name}: {', '.join(sorted(paths))}" for (_, name), paths in homes.items() if len(paths) > 1)
