"""The house rules that no linter knows, each shown to catch an offender."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import SLOW

ROOT = Path(__file__).parents[1]
PACKAGES = ("companion", "drivers", "estimator", "sitl")
"""Truth generators, scenes and fakes of tests and benches; not in the wheel."""
NAMELESS = {"utils", "util", "helpers", "helper", "common", "misc", "types"}

DISTRIBUTION_NAMES = {
    "opencv-python-headless": "cv2", "pytest-asyncio": "pytest_asyncio", "pytest-xdist": "xdist",
    "pupil-apriltags": "pupil_apriltags", "pyserial": "serial", "paho-mqtt": "paho", "prometheus-client": "prometheus_client",
}  # fmt: skip

DRAWINGS = {
    "sitl/experiments/page.py", "sitl/campaign/plots.py", "companion/tools/calibrate/figures.py", "sitl/gym/environment.py",
}  # fmt: skip
"""Modules that need the extra `report`. The commands that draw call `require_drawing` first and import these late."""

LAB = {"companion/cli/progress.py", *(f"sitl/campaign/{name}.py" for name in ("design", "store", "tables"))}
"""Modules that need the extra `lab`. They call `require_lab` first, or do without."""

ROS2 = {f"companion/tools/ros2/{name}.py" for name in ("bag", "bag_import", "typestore")}
"""Modules that need the extra `ros2`. They call `require_rosbags` first."""

COMPARE = {"estimator/constant_velocity.py"}
"""Modules that need the extra `compare`. `pipeline.require_filterpy` is called first."""

TRAINING = {"sitl/gym/environment.py"}
"""Modules that need the extra `rl`."""

FLEET = {"companion/parts/recorder/upload.py"}
"""Modules that need the extra `fleet`."""

VIDEO = {
    *(f"companion/{name}.py" for name in ("cli/detect", "parts/video/part", "tools/calibrate/guide")),
    *(f"companion/tools/report/{name}.py" for name in ("animation", "video")),
    *(f"companion/recording/{name}.py" for name in ("frame_encoder", "frame_video", "timed_frames")),
    *(f"drivers/camera/{name}.py" for name in ("live_bytes", "v4l2_formats", "video_source", "videos")),
    *("drivers/ardrone/video.py", "drivers/imports/video.py", "sitl/camera/film.py", "sitl/emulators/ardrone/wire_pictures.py"),
}
"""Modules that need the extra `video`. They call `require_pyav` first, or are imported after `check_installed`."""

IMPURE_MODULES = {
    "asyncio", "ctypes", "datetime", "glob", "io", "logging", "multiprocessing", "os", "pathlib", "queue", "random", "secrets",
    "select", "selectors", "shutil", "signal", "socket", "subprocess", "sys", "tempfile", "threading", "time", "tomllib",
    "urllib", "uuid",
}  # fmt: skip
IMPURE_CALLS = {
    "open", "print", "input", "np.random", "np.load", "np.save", "np.savez", "np.loadtxt", "np.savetxt", "np.fromfile",
    "cv2.imread", "cv2.imwrite", "cv2.imshow", "cv2.VideoCapture", "cv2.VideoWriter", "cv2.setNumThreads",
}  # fmt: skip
MACHINE = [
    re.compile("|".join([re.escape("/" + "work/"), r"/ro" + r"ot/", r"/home/\w+/", r"/Us" + r"ers/\w+/"])),
    re.compile("index" + "-url|find" + "-links|files.python" + r"hosted|\"resolved\": *\"http|registry = \"http"),
]
UNFINISHED = re.compile("|".join(["TO" + "DO", "FIX" + "ME", "XX" + "X", "NotImplemented" + "Error"]))


@cache
def files() -> tuple[Path, ...]:
    """Return every file of the project that git knows or would take."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT, capture_output=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    return tuple(path for name in listed.stdout.decode().split("\0") if name and (path := ROOT / name).is_file())


@cache
def parsed(source: str) -> ast.Module:
    """Return the tree of a source, which several rules walk."""
    return ast.parse(source)


def modules() -> list[Path]:
    return [p for p in files() if p.suffix == ".py" and p.relative_to(ROOT).parts[0] in PACKAGES]


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.AST) -> Iterator[str]:
    """Yield every module that is imported anywhere in the file, functions and type-checking blocks included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")
            yield from (f"{node.module}.{alias.name}" for alias in node.names if node.module in (*PACKAGES, "companion.cli"))


def within(module: str, *roots: str) -> bool:
    return any(module == root or module.startswith(root + ".") for root in roots)


def impurities(source: str) -> list[str]:
    """List the imports and calls that reach out of a module that must be values in, values out."""
    tree = parsed(source)
    reached = {name for name in imports(tree) if name.partition(".")[0] in IMPURE_MODULES}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call | ast.Attribute):
            text = ast.unparse(node.func if isinstance(node, ast.Call) else node)
            reached |= {text} & IMPURE_CALLS
    return sorted(reached)


def unbounded_queues(source: str) -> list[int]:
    """Lines that make a queue without a size."""
    kinds = {"Queue", "LifoQueue", "PriorityQueue", "SimpleQueue"}
    return [
        node.lineno
        for node in ast.walk(parsed(source))
        if isinstance(node, ast.Call)
        and ast.unparse(node.func).split("[")[0].rpartition(".")[2] in kinds
        and (not node.args or ast.unparse(node.args[0]) in ("0", "-1"))
        and not any(k.arg == "maxsize" and ast.unparse(k.value) not in ("0", "-1") for k in node.keywords)
    ]


def makes_group(expression: ast.expr) -> bool:
    return ast.unparse(expression) in ("asyncio.TaskGroup()", "TaskGroup()")


WAITED_ON_GROUND = {"companion/parts/operator/local_socket.py", "companion/parts/page/recordings.py"}
"""Removes its socket when it ends; removes reports, which are made on the ground alone."""
WAITING_CALLS = {
    "open", "read_text", "write_text", "read_bytes", "write_bytes", "unlink", "iterdir", "glob", "stat", "lstat", "mkdir",
    "fsync", "getaddrinfo", "gethostbyname", "Popen", "check_output", "check_call",
}  # fmt: skip
"""Calls that may wait for a disk, a name or a process, by their last name."""


def waiting_calls(source: str) -> list[int]:
    """Lines of coroutines that call what may wait, on the loop itself: what is awaited or in a function of its own does not."""
    found = []
    for task in (node for node in ast.walk(parsed(source)) if isinstance(node, ast.AsyncFunctionDef)):
        awaited = {id(node.value) for node in ast.walk(task) if isinstance(node, ast.Await)}
        inner = {id(deep) for node in ast.walk(task) if isinstance(node, ast.FunctionDef | ast.Lambda) for deep in ast.walk(node)}
        for node in ast.walk(task):
            if isinstance(node, ast.Call) and id(node) not in awaited | inner:
                name = ast.unparse(node.func).rpartition(".")[2]
                if name in WAITING_CALLS or ast.unparse(node.func) in ("time.sleep", "subprocess.run"):
                    found.append(node.lineno)
    return sorted(found)


def detached_tasks(source: str) -> list[int]:
    """Lines that start a task outside a TaskGroup: by `create_task` of anything else, or by `ensure_future`."""
    tree = parsed(source)
    groups = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.withitem) and node.optional_vars is not None and makes_group(node.context_expr):
            groups.add(ast.unparse(node.optional_vars))
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Await) and isinstance(node.value.value, ast.Call):
            entering = node.value.value
            if ast.unparse(entering.func).endswith("enter_async_context") and makes_group(entering.args[0]):
                groups |= {ast.unparse(target) for target in node.targets}
        elif isinstance(node, ast.arg) and node.annotation is not None and ast.unparse(node.annotation).endswith("TaskGroup"):
            groups.add(node.arg)
    return [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and (
            (
                isinstance(node.func, ast.Attribute)
                and node.func.attr == "create_task"
                and ast.unparse(node.func.value) not in groups
            )
            or ast.unparse(node.func) in ("create_task", "asyncio.ensure_future", "ensure_future")
        )
    ]


def public_classes(source: str) -> list[str]:
    """Return the names of the public classes that the module defines at its top level."""
    return [node.name for node in parsed(source).body if isinstance(node, ast.ClassDef) and not node.name.startswith("_")]


NO_OPENING = {
    "What", "Whether", "Where", "How", "Why", "Who", "Whose", "Which", "That", "Those", "Of", "In", "From", "By", "When", "As",
    "At", "For", "With", "Without", "Over", "Against", "Through",
}  # fmt: skip
"""First words of docstrings that make a reader start again: functions open with a verb, classes and values with a noun."""
PROSE = re.compile(r"\b(told|heard|of which|of whom|be it|were it|astray|anew|strangers?|The same (of|for|where|in))\b")
"""Words and constructions for which plain ones exist (docs/conventions.md)."""
LONGEST_OPENING = 27
"""Number of words in a docstring's first sentence."""


def docstrings(body: Iterable[ast.stmt]) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of each docstring in the statements of a module, those after assignments too."""
    for node in body:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, " ".join(node.value.value.split())
        elif isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from docstrings(node.body)


def hard_to_read(source: str, *, words: bool = True) -> list[tuple[int, str]]:
    """Return lines of docstrings with a hard opening, a long first sentence or, unless in tests, a word of `PROSE`."""
    found = []
    for line, text in docstrings(parsed(source).body):
        prose = text.partition("Args:")[0]
        first = re.split(r"(?<=[.:;!?])\s", prose)[0]
        if re.split(r"\W", text)[0] in NO_OPENING or len(first.split()) > LONGEST_OPENING or (words and PROSE.search(prose)):
            found.append((line, first[:60]))
    return found


MESSAGE = re.compile(PROSE.pattern + r"|\b(asked|said)\b")
"""Words that no message, help text or log line uses of a program."""


def hard_messages(source: str) -> list[tuple[int, str]]:
    """Return lines of texts other than docstrings with a word of `MESSAGE` or a sentence longer than `LONGEST_OPENING`."""
    tree, skipped, found = parsed(source), set[int](), []
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            skipped |= {id(inner) for inner in ast.walk(node) if inner is not node}
    for node in ast.walk(tree):
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


def ambiguous(defined: Iterable[tuple[str, list[str]]]) -> dict[str, list[str]]:
    """Return the class names that more than one module defines, with those modules."""
    homes: dict[str, list[str]] = {}
    for module, names in defined:
        for name in names:
            homes.setdefault(name, []).append(module)
    return {name: modules for name, modules in homes.items() if len(modules) > 1}


def test_the_rules_catch_an_offender() -> None:
    assert impurities("import time\nimport os.path\nx = np.random.default_rng()\nprint(open('x'))") == [
        "np.random",
        "open",
        "os.path",
        "print",
        "time",
    ]
    assert impurities("from estimator.contracts.time import MonoNs\nx = np.zeros(3)\nself.opened()") == []
    assert unbounded_queues(
        "asyncio.Queue()\nasyncio.Queue(8)\nQueue(maxsize=4)\nqueue.SimpleQueue()\nasyncio.Queue[int](maxsize=0)"
    ) == [1, 4, 5]
    tasks = """
async def f(given: asyncio.TaskGroup):
    given.create_task(g())
    asyncio.create_task(g())
    async with asyncio.TaskGroup() as tg:
        tg.create_task(g())
    entered = await stack.enter_async_context(asyncio.TaskGroup())
    entered.create_task(g())
    loop.create_task(g())
    ensure_future(g())
"""
    assert detached_tasks(tasks) == [4, 9, 10]
    assert MACHINE[0].search("at /" + "work/main")
    assert MACHINE[1].search("--extra-index" + "-url")


def test_the_rule_for_names_catches_an_offender() -> None:
    assert public_classes("class A: ...\nclass _B: ...\ndef f():\n    class C: ...") == ["A"]
    assert ambiguous([("x", ["A", "B"]), ("y", ["B"])]) == {"B": ["x", "y"]}


def test_the_rule_for_docstrings_catches_an_offender() -> None:
    assert hard_to_read('"""What is there."""\nX = 1\n"""Of the disc."""\ndef f():\n    """Return what is there."""') == [
        (1, "What is there."),
        (3, "Of the disc."),
    ]
    assert hard_to_read('"""Time that is told, s."""') == [(1, "Time that is told, s.")]
    assert hard_to_read('"""Time that is told, s."""', words=False) == []
    assert len(hard_to_read(f'"""Return {"a long " * LONGEST_OPENING}line."""')) == 1


def test_docstrings_are_understood_at_one_reading() -> None:
    found = {
        str(p.relative_to(ROOT)): wrong
        for p in files()
        if p.suffix == ".py" and (wrong := hard_to_read(p.read_text(), words=p.relative_to(ROOT).parts[0] != "tests"))
    }
    assert found == {}


def test_messages_are_understood_at_one_reading() -> None:
    assert hard_messages('"""He asked in a docstring."""\nraise BadInput(f"{a} was not heard at all")') == [
        (2, "X was not heard at all")
    ]
    assert len(hard_messages(f'log.info("{"a long " * LONGEST_OPENING}line")')) == 1
    assert hard_messages("x = 'asked'") == []
    assert {str(p.relative_to(ROOT)): wrong for p in modules() if (wrong := hard_messages(p.read_text()))} == {}


def test_one_class_name_means_one_thing() -> None:
    assert ambiguous((name_of(p), public_classes(p.read_text())) for p in modules()) == {}


CONTEXTS_OF_THE_CORE = ROOT / "estimator/vision/native.py"
"""It keeps one context of the native core for each thread, whose results depend on what they are given alone."""


def test_the_estimator_is_values_in_values_out() -> None:
    assert impurities(CONTEXTS_OF_THE_CORE.read_text()) == ["threading"]
    pure = [p for p in modules() if within(name_of(p), "estimator") and p != CONTEXTS_OF_THE_CORE]
    assert {str(p.relative_to(ROOT)): found for p in pure if (found := impurities(p.read_text()))} == {}
    contracts = [p for p in pure if within(name_of(p), "estimator.contracts")]
    tops = {name.partition(".")[0] for p in contracts for name in imports(parsed(p.read_text()))}
    assert tops <= sys.stdlib_module_names | {"msgspec", "numpy", "estimator"}


SUPERVISED = {"companion/base/supervise.py", "companion/base/event_loop.py"}
"""They cancel their tasks and wait for them as a group does, but not for ever: what does not end must not hold the process."""


def test_no_queue_is_unbounded_and_no_task_detached() -> None:
    found = {
        str(p.relative_to(ROOT)): lines
        for p in modules()
        if (lines := unbounded_queues(p.read_text()) + detached_tasks(p.read_text()))
    }
    assert {path for path in found if path in SUPERVISED} == SUPERVISED
    assert {path: lines for path, lines in found.items() if path not in SUPERVISED} == {}


def test_calls_that_wait_are_found() -> None:
    source = """
async def part(path, loop):
    text = path.read_text()
    with open(path) as file:
        time.sleep(1.0)
    await loop.getaddrinfo("host", 1)
    def later(): return path.read_bytes()
    await asyncio.to_thread(path.read_bytes)
    socket.getaddrinfo("host", 1)
"""
    assert waiting_calls(source) == [3, 4, 5, 9]


def test_no_coroutine_of_the_service_waits_for_a_disk_a_name_or_a_process() -> None:
    of_service = [p for p in modules() if within(name_of(p), "companion.base", "companion.parts", "companion.service", "drivers")]
    found = {str(p.relative_to(ROOT)): lines for p in of_service if (lines := waiting_calls(p.read_text()))}
    assert set(found) <= WAITED_ON_GROUND, found


def test_modules_are_named_for_what_is_in_them() -> None:
    python = [p for p in files() if p.suffix == ".py"]
    assert [str(p.relative_to(ROOT)) for p in python if p.stem in NAMELESS or p.parent.name in NAMELESS] == []


def test_no_file_knows_this_machine_or_a_package_index() -> None:
    found = []
    for path in files():
        try:
            text = path.read_text()
        except UnicodeDecodeError:
            continue
        for number, line in enumerate(text.splitlines(), 1):
            if any(pattern.search(line) for pattern in MACHINE):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:80]}")
    assert found == []


def test_nothing_is_left_unfinished() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in files()
        if path.suffix == ".py"
        for number, line in enumerate(path.read_text().splitlines(), 1)
        if UNFINISHED.search(line)
    ]
    assert found == []


def test_the_readme_shows_the_two_commands_and_ci_uses_one_of_them() -> None:
    readme, makefile = (ROOT / "README.md").read_text(), (ROOT / "Makefile").read_text()
    for command in ("demo", "test"):
        assert f"make {command}" in readme
        assert re.search(rf"^{command}:", makefile, re.MULTILINE)
    assert (ROOT / ".ci/run").read_text().rstrip().endswith("make test")
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", readme):
        assert (ROOT / target).exists(), f"README links to {target}"


def test_what_is_imported_is_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    needed = {"report": DRAWINGS, "lab": LAB, "ros2": ROS2, "compare": COMPARE, "rl": TRAINING, "fleet": FLEET, "video": VIDEO}
    runtime = import_names(project["dependencies"])
    dev = runtime.union(*(import_names(extras[name]) for name in (*needed, "dev")))
    undeclared = set()
    for path in files():
        if path.suffix == ".py":
            top = path.relative_to(ROOT).parts[0]
            shipped = top in PACKAGES
            where = str(path.relative_to(ROOT))
            further = set().union(*(import_names(extras[name]) for name, paths in needed.items() if where in paths))
            declared = runtime | further if shipped else dev | extra(top)
            tops = {name.partition(".")[0] for name in imports(parsed(path.read_text()))}
            ours = {"", *PACKAGES, "configs", "examples", "tests", "benches", "fuzz", "mutants", "supply"}
            undeclared |= {(str(path.relative_to(ROOT)), top) for top in tops - sys.stdlib_module_names - declared - ours}
    assert undeclared == set()


def import_names(requirements: list[str]) -> set[str]:
    """Return what the distributions are called in an import statement."""
    return {DISTRIBUTION_NAMES.get(name, name) for name in map(bare_name, requirements)}


def extra(folder: str) -> set[str]:
    """Distributions that one folder of tools has to itself: `requirements/<folder>.in`."""
    path = ROOT / f"requirements/{folder}.in"
    lines = path.read_text().splitlines() if path.exists() else []
    return {bare_name(line) for line in lines if line and not line.startswith("#")}


def bare_name(requirement: str) -> str:
    return re.split(r"[<>=~!\[ ;]", requirement)[0].lower()


def test_every_dependency_is_pinned_by_version_and_hash() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = {"runtime": project["dependencies"], "report": project["dependencies"] + extras["report"]}
    wanted["lab"] = project["dependencies"] + extras["lab"]
    wanted["compare"] = project["dependencies"] + extras["compare"]
    wanted["dev"] = wanted["report"] + extras["lab"] + extras["compare"] + extras["dev"]
    wanted |= {path.stem: sorted(extra(path.stem)) for path in (ROOT / "requirements").glob("*.in")}
    for name, requirements in wanted.items():
        text = (ROOT / f"requirements/{name}.txt").read_text()
        pinned = dict(re.findall(r"^([a-z0-9._-]+)==(\S+) \\\n    --hash=sha256:[0-9a-f]{64}", text, re.MULTILINE))
        assert len(pinned) == sum(not line.startswith((" ", "#")) for line in text.splitlines() if line)
        assert set(map(bare_name, requirements)) <= set(pinned)


def test_benches_and_tests_do_not_import_each_other() -> None:
    """Benches take what both need from tests/support; only tests/benches, the tests of the benches themselves, import them."""
    root = Path(__file__).parents[1]
    for folder, other in (("tests", "benches"), ("benches", "tests")):
        for path in sorted((root / folder).rglob("*.py")):
            if path.parent == root / "tests/benches":
                continue
            for node in ast.walk(parsed(path.read_text())):
                names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom) and node.module:
                    names = [node.module]
                wrong = [name for name in names if within(name, other) and not within(name, "tests.support")]
                assert not wrong, path


def test_the_files_named_slow_are_there() -> None:
    assert [name for name in SLOW if not (ROOT / name).exists()] == []
