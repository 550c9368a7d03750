"""Test that what the pages name exists: settings, commands, options, topics, metrics, modules, make targets and files."""

import argparse
import importlib
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from msgspec import inspect

from companion.cli.main import COMMANDS
from companion.parts.mqtt.messages import PUBLISHED
from companion.settings.model import EXPERT, Settings, in_file
from companion.settings.schema import variants

ROOT = Path(__file__).parents[2]
PAGES = [
    *sorted(ROOT.glob("docs/**/*.md")),
    *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY", "CHANGELOG")),
]
PACKAGES = "companion|drivers|estimator|sitl|study|configs|tests|benches|fuzz|mutants|supply|requirements|qualification"
FOREIGN_OPTIONS = {"--scale", "--user", "--offline", "--profile", "--require-hashes", "--list-ctrls-menus", "--cafile"}
"""Options of systemctl, systemd-analyze, docker, pip, v4l2-ctl and mosquitto_pub."""
ENDINGS = {"toml", "py", "md", "txt", "json", "csv", "png", "svg", "html"}


@cache
def keys() -> frozenset[str]:
    """Return the path of every section and key that a settings file may have."""

    def below(spot: inspect.Type, path: str) -> Iterator[str]:
        for struct in variants(spot):
            if struct.tag_field:
                yield f"{path}.{struct.tag_field}"
            for field in struct.fields:
                here = f"{path}.{field.encode_name}".lstrip(".")
                yield in_file(here)
                if variants(field.type):
                    yield f"{EXPERT}.{here}"
                yield from below(field.type, here)

    return frozenset((EXPERT, *below(inspect.type_info(Settings), "")))


@cache
def options() -> dict[str, frozenset[str]]:
    """Return the options of every command, those of its own commands among them."""

    def of(parser: argparse.ArgumentParser) -> Iterator[str]:
        for action in parser._actions:
            yield from action.option_strings
            if isinstance(action, argparse._SubParsersAction):
                for name, inner in action.choices.items():
                    yield name
                    yield from of(inner)

    found = {}
    for name, (module, _) in COMMANDS.items():
        parser = argparse.ArgumentParser()
        importlib.import_module(module).add_parser(parser.add_subparsers())
        found[name] = frozenset(of(parser))
    return found


def prose(page: Path) -> str:
    """Return the page's text without its fenced blocks."""
    return re.sub(r"^( *)```.*?^\1```$", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)


def in_backticks() -> list[tuple[str, str]]:
    """Return (page, text) of everything that stands in single backticks."""
    return [
        (str(page.relative_to(ROOT)), " ".join(text.split()))
        for page in PAGES
        for text in re.findall(r"(?<!`)`([^`]+)`(?!`)", prose(page))
    ]


def indented_blocks() -> list[tuple[str, str]]:
    """Return (page, text) of every block that is indented by four."""
    return [
        (str(page.relative_to(ROOT)), re.sub(r"^    ", "", block, flags=re.MULTILINE))
        for page in PAGES
        for block in re.findall(r"^\n((?:    \S[^\n]*\n|\n(?=    ))+)", prose(page), re.MULTILINE)
    ]


def test_settings_in_the_text_are_keys_of_the_model() -> None:
    sections = {key for key in keys() if "." not in key}
    named = {
        (page, text.split(" = ")[0]) for page, text in in_backticks() if re.fullmatch(r"[a-z_0-9]+(\.[a-z_0-9]+)+( = .*)?", text)
    }
    leaves = {key.rpartition(".")[2] for key in keys()}
    named = {(page, key) for page, key in named if key.rpartition(".")[2] not in ENDINGS}
    wrong = {
        (page, key)
        for page, key in named
        # `estimator` is a package and a section: what is no key there has to be a module or a name in one.
        if key not in keys() and (key.split(".")[0] in sections or key.rpartition(".")[2] in leaves) and not is_importable(key)
    }
    headers = {(page, text[1:-1]) for page, text in in_backticks() if re.fullmatch(r"\[[a-z_0-9.]+\]", text)}
    wrong |= {(page, header) for page, header in headers if header not in keys() | {"project.urls"}}
    assert sorted(wrong) == []


def test_settings_in_the_blocks_are_keys_of_the_model() -> None:
    wrong, seen = [], 0
    for page, block in indented_blocks():
        header = re.search(r"^\[([a-z_]+)[\].]", block, re.MULTILINE)
        if header is None or header[1] not in keys():
            continue
        seen += 1
        for path in flat(tomllib.loads(block[header.start() :]), ""):
            wrong += [f"{page}: {path}"] if path not in keys() else []
    assert wrong == []
    assert seen >= 2


def flat(table: dict[str, object], path: str) -> Iterator[str]:
    for key, value in table.items():
        here = f"{path}.{key}".lstrip(".")
        yield here
        if isinstance(value, dict):
            yield from flat(value, here)


def test_commands_and_options_in_the_text_exist() -> None:
    everywhere = frozenset[str]().union(*options().values()) | tool_options() | FOREIGN_OPTIONS | {"--help", "--version"}
    wrong = []
    for page, text in in_backticks():
        words = text.removeprefix(".venv/bin/").split()
        if words[0] == "decklander" and len(words) > 1:
            words = words[1:]
            if words[0] not in COMMANDS and not words[0].startswith("-") and words[0] != "X":
                wrong.append(f"{page}: {text}")
        of_command = options().get(words[0])
        known = everywhere if of_command is None or len(words) == 1 else of_command | {"--help"}
        wrong += [f"{page}: {text}: {w}" for w in words if re.match(r"--[a-z]", w) and w.split("=")[0].rstrip(",;") not in known]
    assert wrong == []


@cache
def tool_options() -> frozenset[str]:
    """Return the options that benches and the tools of the repository define."""
    sources = [*ROOT.glob("benches/*.py"), *ROOT.glob("supply/*.py"), *ROOT.glob("fuzz/*.py"), *ROOT.glob("mutants/*.py")]
    return frozenset(option for path in sources for option in re.findall(r'"(--[a-z][a-z-]*)"', path.read_text()))


def test_topics_in_the_pages_are_those_of_the_link() -> None:
    leaves = {"command", "vessel", *PUBLISHED}
    named = {
        (page.name, leaf)
        for page in PAGES
        for leaf in re.findall(r"(?:decklander/v2/[^/\s`\"]+|`\.\.\.)/([a-z]+)", page.read_text())
    }
    assert sorted((page, leaf) for page, leaf in named if leaf not in leaves) == []
    assert {leaf for page, leaf in named if page == "mqtt.md"} == leaves


def test_metrics_in_the_pages_are_exported() -> None:
    source = "".join(path.read_text() for path in ROOT.glob("companion/parts/metrics/*.py"))
    named = {(page, text) for page, text in in_backticks() if re.fullmatch(r"decklander_[a-z_]+", text)}
    assert sorted((page, name) for page, name in named if name not in source) == []


def test_named_values_and_parameters_in_the_pages_are_sent_or_types_of_the_core() -> None:
    source = "".join(path.read_text() for path in ROOT.glob("companion/parts/mavlink/*.py"))
    types = set(re.findall(r"\bdl_[a-z_]+", (ROOT / "estimator/core/decklander.h").read_text()))
    named = {(page, text) for page, text in in_backticks() if re.fullmatch(r"dl_[a-z_]+", text)}
    assert sorted((page, name) for page, name in named if f'"{name}"' not in source and name not in types) == []


def test_modules_and_names_in_the_pages_exist() -> None:
    first = "companion|drivers|estimator|sitl|study|tests|benches|fuzz|mutants|supply|qualification"
    named = {(p, text.split("(")[0]) for p, text in in_backticks() if re.match(rf"({first})(\.[A-Za-z_]\w*)+(\(|$)", text)}
    named |= {
        (str(page.relative_to(ROOT)), name)
        for page in PAGES
        for name in re.findall(r"python -m ((?:\w+\.)+\w+)", page.read_text())
    }
    assert sorted((page, name) for page, name in named if not is_importable(name) and name not in keys()) == []


def is_importable(name: str) -> bool:
    """Return whether `name` is a module of the repository, or something that one defines."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:length])
        if path.with_suffix(".py").is_file() or (path.is_dir() and any(path.glob("*.py"))):
            rest = parts[length:]
            if not rest:
                return True
            found: object = importlib.import_module(".".join(parts[:length]))
            for part in rest:
                if not hasattr(found, part):
                    return False
                found = getattr(found, part)
            return True
    return False


def test_make_targets_in_the_pages_exist() -> None:
    targets = set(re.findall(r"^([a-z][a-z0-9-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    named = {
        (page.name, name)
        for page in PAGES
        for name in re.findall(r"(?:`|^ {4})make ([a-z][a-z0-9-]*)", page.read_text(), re.MULTILINE)
    }
    assert sorted((page, name) for page, name in named if name not in targets) == []


def test_files_in_the_pages_exist() -> None:
    """A path may be a pattern: `companion/tools/doctor/rules_*.py`."""
    named = {
        (page, text.split("::")[0].rstrip("/"))
        for page, text in in_backticks()
        if re.match(rf"({PACKAGES})/[\w./*-]+(::|$)", text)
    }
    wrong = [(page, path) for page, path in named if "<" not in path and not any(ROOT.glob(path))]
    assert sorted(wrong) == []
    assert len(named) > 40


def test_files_in_the_commands_exist() -> None:
    """Settings, camera and pad files that a command line takes by a path from the top."""
    named = {
        (page.name, path)
        for page in PAGES
        for path in re.findall(r"(?<![\w/.-])((?:configs|requirements)/[\w./-]+\w)", page.read_text())
    }
    assert sorted((page, path) for page, path in named if not (ROOT / path).exists()) == []


def test_topics_of_bags_in_the_page_are_those_that_are_written() -> None:
    source = (ROOT / "companion/tools/ros2/messages.py").read_text()
    written = set(re.findall(r'"(/[a-z][\w/]*)"', source)) | {"/vehicle/fix", "/vessel/fix", "/PATH/pad_pose", "/PATH/odometry"}
    named = set(re.findall(r"`(/[\w/]+)`", (ROOT / "docs/ros2.md").read_text()))
    assert named == written
