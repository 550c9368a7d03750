"""The house rules that no linter knows: pure calls, plain sentences, declared imports, no path of one machine."""

import ast
import re
import subprocess
import tomllib
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from sys import stdlib_module_names
from typing import Any

import pytest

from tests.conftest import SLOW

ROOT = Path(__file__).parents[1]
PACKAGES = ("companion", "decklander", "drivers", "estimator", "sitl")
AROUND = ("benches", "configs", "examples", "fuzz", "mutants", "qualification", "supply", "tests")
DISTRIBUTION_NAMES = {
    "opencv-python-headless": "cv2", "pytest-asyncio": "pytest_asyncio", "pytest-xdist": "xdist",
    "pupil-apriltags": "pupil_apriltags", "pyserial": "serial", "paho-mqtt": "paho", "prometheus-client": "prometheus_client",
    "python-can": "can", "ruamel.yaml": "ruamel", "resvg-py": "resvg_py",
}  # fmt: skip
IMPURE_CALLS = {
    "open", "print", "input", "np.random", "np.load", "np.save", "np.savez", "np.loadtxt", "np.savetxt", "np.fromfile",
    "cv2.imread", "cv2.imwrite", "cv2.imshow", "cv2.VideoCapture", "cv2.VideoWriter", "cv2.setNumThreads",
}  # fmt: skip
"""Calls that no module of the estimator makes; imports that none has are a contract of pyproject.toml."""
MACHINE = re.compile(
    "|".join([re.escape("/" + "work/"), r"/ro" + r"ot/", r"/home/\w+/", r"/Us" + r"ers/\w+/", "index" + "-url|find" + "-links"])
    + "|files.python"
    + r"hosted|\"resolved\": *\"http|registry = \"http"
)
NO_OPENING = {
    "What", "Whether", "Where", "How", "Why", "Who", "Whose", "Which", "That", "Those", "Of", "In", "From", "By", "When", "As",
    "At", "For", "With", "Without", "Over", "Against", "Through",
}  # fmt: skip
"""First words of docstrings that make a reader start again: functions open with a verb, classes and values with a noun."""
PROSE = re.compile(r"\b(told|heard|of which|of whom|be it|were it|astray|anew|strangers?|The same (of|for|where|in))\b")
"""Words and constructions for which plain ones exist (docs/conventions.md)."""
MESSAGE = re.compile(PROSE.pattern + r"|\b(asked|said)\b")
"""Words that no message, help text or log line uses of a program."""
LONGEST_OPENING = 27
"""Number of words in a docstring's first sentence, and in any sentence of a message."""


@cache
def files() -> tuple[Path, ...]:
    """Return every file of the project that git knows or would take."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    return tuple(path for name in listed.stdout.decode().split("\0") if name and (path := ROOT / name).is_file())


def sources(*folders: str) -> Iterator[tuple[str, str]]:
    """Yield path and text of every Python file, or of those below some top-level folders."""
    for path in files():
        name = path.relative_to(ROOT).as_posix()
        if path.suffix == ".py" and (not folders or name.partition("/")[0] in folders):
            yield name, path.read_text()


def docstrings(body: Iterable[ast.stmt]) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each docstring in the statements of a module, those after assignments too."""
    for node in body:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, " ".join(node.value.value.split())
        elif isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from docstrings(node.body)


def hard_to_read(tree: ast.Module, *, words: bool = True) -> list[tuple[int, str]]:
    """Return lines of docstrings with a hard opening, a long first sentence or, unless in tests, a word of `PROSE`."""
    found = []
    for line, text in docstrings(tree.body):
        prose = text.partition("Args:")[0]
        first = re.split(r"(?<=[.:;!?])\s", prose)[0]
        if re.split(r"\W", text)[0] in NO_OPENING or len(first.split()) > LONGEST_OPENING or (words and PROSE.search(prose)):
            found.append((line, first[:60]))
    return found


def hard_messages(nodes: Sequence[ast.AST]) -> list[tuple[int, str]]:
    """Return lines of texts other than docstrings with a word of `MESSAGE` or a sentence longer than `LONGEST_OPENING`."""
    skipped, found = set[int](), []
    for node in nodes:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            skipped |= {id(inner) for inner in ast.walk(node) if inner is not node}
    for node in nodes:
        if id(node) in skipped or not isinstance(node, ast.Constant | ast.JoinedStr):
            continue
        pieces = node.values if isinstance(node, ast.JoinedStr) else [node]
        text = "".join(str(piece.value) if isinstance(piece, ast.Constant) else "X" for piece in pieces)
        if len(text.split()) < 3 or "<" in text:
            continue
        sentences = re.split(r"(?<=[.:;!?])\s|\n", text)
        if MESSAGE.search(text) or any(len(sentence.split()) > LONGEST_OPENING for sentence in sentences):
            found.append((node.lineno, text[:60]))
    return found


def let_go(nodes: Sequence[ast.AST]) -> list[int]:
    """Return lines that keep nothing of a connection but its transport or its reader.

    From Python 3.13 on a server's connection closes with its `StreamWriter`, as soon as nothing refers to that.
    """
    used = {id(node.func.value) for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)}
    found = []
    for node in nodes:
        match node:
            case ast.Attribute(value=ast.Name(id=name) | ast.Attribute(attr=name), attr="transport") if name.endswith("writer"):
                found += [] if id(node) in used else [node.lineno]
            case ast.Assign(targets=[ast.Tuple(elts=[_, ast.Name(id="_")])], value=ast.Await(value=ast.Call(func=call))):
                found += [node.lineno] if re.search(r"open_(unix_)?connection", ast.unparse(call)) else []
            case ast.FunctionDef(args=ast.arguments(args=args)):
                kinds = {ast.unparse(arg.annotation or arg).rpartition(".")[2]: arg.arg for arg in args}
                inside = list(ast.walk(node))
                parts = {id(inner.value) for inner in inside if isinstance(inner, ast.Attribute)}
                kept = {inner.id for inner in inside if isinstance(inner, ast.Name) and id(inner) not in parts}
                found += [node.lineno] if "StreamReader" in kinds and kinds.get("StreamWriter", "") not in {"", *kept} else []
    return found


def test_no_connection_lives_by_its_transport_alone() -> None:
    met = "def met(reader: asyncio.StreamReader, writer: asyncio.StreamWriter):\n    "
    for lets_go in (
        f"{met}transport = writer.transport",
        f"{met}writer.write(b'x')",
        "reader, _ = await asyncio.open_connection()",
    ):
        assert let_go(list(ast.walk(ast.parse(lets_go)))), lets_go
    for keeps in (f"{met}kept.add(writer)", f"{met}return serve(reader, writer)", "writer.transport.abort()"):
        assert not let_go(list(ast.walk(ast.parse(keeps)))), keeps
    streams = {name: text for name, text in sources() if re.search(r"StreamWriter|open_\w*connection", text)}
    assert {name: lines for name, text in streams.items() if (lines := let_go(list(ast.walk(ast.parse(text)))))} == {}


def test_the_rules_for_sentences_catch_an_offender() -> None:
    parsed = ast.parse('"""What is there."""\nX = 1\n"""Of the disc."""')
    assert hard_to_read(parsed) == [(1, "What is there."), (3, "Of the disc.")]
    assert hard_to_read(ast.parse('"""Time that is told, s."""')) == [(1, "Time that is told, s.")]
    assert len(hard_to_read(ast.parse(f'"""Return {"a long " * LONGEST_OPENING}line."""'))) == 1
    parsed = ast.parse('"""He asked."""\nraise BadInput(f"{a} was not heard at all")')
    assert hard_messages(list(ast.walk(parsed))) == [(2, "X was not heard at all")]


@cache
def findings() -> dict[str, tuple[Collection[Any], Collection[Any], set[str], set[str]]]:
    """Return each file's hard docstrings, hard messages, impure calls and imports; it is parsed once for all of them."""
    found: dict[str, tuple[Collection[Any], Collection[Any], set[str], set[str]]] = {}
    for name, text in sources():
        tree, top = ast.parse(text), name.partition("/")[0]
        nodes = list(ast.walk(tree)) if top in PACKAGES else []
        calls = (getattr(n, "func", n) for n in nodes if top == "estimator" and isinstance(n, ast.Call | ast.Attribute))
        tops = set(re.findall(r"^ *(?:import|from) (\w+)[\w.]*(?: as \w+| import .*)?(?:  #.*)?$", text, re.MULTILINE))
        docs = hard_to_read(tree, words=top not in ("tests", "qualification"))
        found[name] = docs, hard_messages(nodes), IMPURE_CALLS & {*map(ast.unparse, calls)}, tops
    return found


def test_sentences_are_understood_at_one_reading_and_the_estimator_is_values_in_values_out() -> None:
    assert {name: wrong[:3] for name, wrong in findings().items() if any(wrong[:3])} == {}


def test_no_file_knows_this_machine_or_a_package_index() -> None:
    assert MACHINE.search("at /" + "work/main")
    assert MACHINE.search("--extra-index" + "-url")
    found = []
    for path in files():
        data = path.read_bytes()
        lines = [] if b"\0" in data else data.decode(errors="replace").splitlines()
        found += [f"{path.relative_to(ROOT)}:{number}" for number, line in enumerate(lines, 1) if MACHINE.search(line)]
    assert found == []


def test_the_readme_shows_the_two_commands_and_ci_uses_one_of_them() -> None:
    readme, makefile = (ROOT / "README.md").read_text(), (ROOT / "Makefile").read_text()
    for command in ("demo", "test"):
        assert f"make {command}" in readme
        assert re.search(rf"^{command}:", makefile, re.MULTILINE)
    assert (ROOT / ".ci/run").read_text().rstrip().endswith("make test")


def test_what_is_imported_is_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    everything = [*project["dependencies"], *chain.from_iterable(project["optional-dependencies"].values())]
    for path in (ROOT / "requirements").glob("*.in"):
        everything += [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    bare = {re.split(r"[<>=~!\[ ;]", requirement)[0].lower() for requirement in everything}
    known = {DISTRIBUTION_NAMES.get(name, name) for name in bare} | stdlib_module_names | {*PACKAGES, *AROUND}
    undeclared = {(name, top) for name, (*_, tops) in findings().items() for top in tops - known}
    assert undeclared == set()


def test_the_files_named_slow_are_there() -> None:
    assert [name for name in SLOW if not (ROOT / name).exists()] == []
