"""Each capability taken away: the tree without its files imports, its fast tests pass, and a drone lands."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from benches.house_counts import OWNERS

ROOT = Path(__file__).parents[1]
REMOVABLE = (
    "AR.Drone",
    "MQTT and watch", "ROS 2", "Foxglove", "gamepad", "ship's wires", "imports of others' files", "pads from pictures, printing",
    "campaigns and studies", "learned parts", "thesis",
)  # fmt: skip
"""Names of `benches.house_counts.OWNERS`, whose files are taken away."""
TESTS = {
    "MQTT and watch": ("tests/companion/page/test_settings_tool.py",),
    "gamepad": ("tests/companion/page/test_settings_tool.py",),
    "imports of others' files": ("tests/companion/doctor/test_set_ups.py", "tests/companion/test_config_import.py"),
    "learned parts": ("tests/estimator/core/test_library.py",),
    "ship's wires": (
        "tests/companion/doctor/test_gather.py",
        "tests/companion/doctor/test_rules.py",
        "tests/companion/page/test_settings_tool.py",
        "tests/companion/page/test_tools.py",
        "tests/sitl/test_rig.py",
    ),
    "thesis": ("tests/companion/test_thesis_mission.py", "tests/estimator/vision/test_tracker.py"),
}
"""Tests by a capability's command, keys of the settings or entries of the header, which import nothing of it."""
RIGS = {"AR.Drone": r'(?:load|settings)\w*\("(?:sim|ardrone\d)"|rig_for\(.*"ardrone1"|kind"?(?:: | = |=)"ardrone"'}
"""Text of tests that stand on a capability's own rig: the profiles `sim`, `ardrone1` and `ardrone2` are an AR.Drone's."""
WANTED = {
    "learned parts": ("guidance.controller=policy", "vision.learned=second_opinion"),
    "thesis": ("guidance.mission=thesis", "estimator.path=dead_reckoning", "vision.method=fused"),
}
"""Settings of a flight that want a capability."""
CONFTEST = "tests/conftest.py"
"""Imports in the bodies of its fixtures alone, so that it stays; tests that use a fixture that imports what is gone go."""
BUILT = ("estimator/core", "sitl/core")
LEFT_OUT = (
    "qualification/", "tests/benches/", "tests/companion/test_capabilities.py", "tests/docs/", "tests/fuzz/", "tests/mutants/",
    "tests/supply/", "tests/test_examples.py", "tests/test_house.py",
)  # fmt: skip
"""Tests of the whole, of benches, documents and packages, which name everything."""
_IMPORT_ALL = """
import pkgutil, sys
for top in ("companion", "drivers", "estimator", "sitl"):
    package = __import__(top)
    for module in pkgutil.walk_packages(package.__path__, f"{top}."):
        if module.name.rpartition(".")[2] != "__main__":
            __import__(module.name)
"""


def modules_of(paths: Iterable[str]) -> set[str]:
    return {path.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for path in paths if path.endswith(".py")}


def names_in(text: str) -> set[str]:
    """Return the dotted names that a file of tests imports, names of modules that it mentions as text, and fixtures."""
    found = set[str]()
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Import(names=names):
                found |= {alias.name for alias in names}
            case ast.ImportFrom(module=str(module), names=names):
                found |= {module, *(f"{module}.{alias.name}" for alias in names)}
            case ast.Constant(value=str(value)):
                found.add(value)
            case ast.arg(arg=name):
                found.add(name)
    return found


def lost_fixtures(gone: set[str]) -> set[str]:
    """Return the names of the fixtures that import what is gone."""
    functions = (node for node in ast.parse((ROOT / CONFTEST).read_text()).body if isinstance(node, ast.FunctionDef))
    return {one.name for one in functions if any(within(name, gone) for name in names_in(ast.unparse(one)))}


def kept_without(owner: str) -> list[str]:
    """Return the files of the tree that stay without a capability; tests that import what is gone go, too."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.splitlines()
    of_owner = (*OWNERS[owner], *TESTS.get(owner, ()))
    gone = modules_of(path for path in listed if path.startswith(of_owner))
    files = [path for path in listed if not path.startswith((*of_owner, *LEFT_OUT))]
    texts = {path: (ROOT / path).read_text() for path in files if path.startswith("tests/") and path.endswith(".py")}
    tests = {path: names_in(text) for path, text in texts.items() if path != CONFTEST}
    lost = [path for path in tests if owner in RIGS and re.search(RIGS[owner], texts[path])]
    while lost := [*lost, *(path for path, names in tests.items() if any(within(name, gone) for name in names))]:
        gone |= modules_of(lost) | lost_fixtures(gone | modules_of(lost))
        for path in lost:
            tests.pop(path, None)
        lost = []
    return [path for path in files if path in {*tests, CONFTEST} or path not in texts]


def within(name: str, gone: set[str]) -> bool:
    """Return whether a name is a module that is gone, or something in one."""
    parts = name.split(".")
    return any(".".join(parts[:n]) in gone for n in range(1, len(parts) + 1))


@pytest.fixture(scope="module", params=REMOVABLE)
def tree(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("tree")
    built = [path for at in BUILT for path in (ROOT / at).iterdir() if path.suffix in (".so", ".1") or path.name == "abi.py"]
    for path in {*kept_without(request.param), *(str(path.relative_to(ROOT)) for path in built)}:
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / path, folder / path)
    if any(path.startswith(BUILT) for path in OWNERS[request.param]):
        ran_in(folder, "-m", "supply.core", "libraries")
    return folder


def ran_in(folder: Path, *arguments: str, code: int = 0) -> str:
    """Return what Python prints in a tree; of a refusal what stands on stderr."""
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    done = subprocess.run([sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stderr if code else done.stdout


def test_the_rest_imports_and_passes_its_fast_tests(tree: Path) -> None:
    ran_in(tree, "-c", _IMPORT_ALL)
    ran_in(tree, "-m", "pytest", "-q", "-x", "-n", "2", "-m", "not slow")


def test_a_setting_that_wants_it_is_refused_in_one_line(tree: Path, request: pytest.FixtureRequest) -> None:
    line = r"decklander: .* needs .*, which (is|are) not installed: install .*the extra decklander\[\w+\]\n"
    for word in WANTED.get(request.node.callspec.params["tree"], ()):
        flight = ("simulate", "calm", "--perception", "model", "--set", word)
        told = ran_in(tree, "-m", "companion.cli.main", *flight, code=2)
        assert re.fullmatch(line, told), told


def test_a_drone_lands_without_it(tree: Path) -> None:
    flight = ("calm", "--perception", "model", "--json")
    for autopilot in ((), ("--autopilot", "px4")):  # the first is the AR.Drone, or without it ArduCopter in miniature
        flown = json.loads(ran_in(tree, "-m", "companion.cli.main", "simulate", *flight, *autopilot))
        assert flown["landed_on_pad"] is True
        assert flown.get("autopilot") == ("px4" if autopilot else None if (tree / "sitl/ardrone").exists() else "arducopter")
