"""Navigation, links and made pages of the documentation; settings, commands, topics, modules and files that it names exist."""

import argparse
import importlib
import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from msgspec import NODEFAULT, inspect
from packaging.version import Version

from companion.base.mission import State
from companion.cli.commands import COMMANDS
from companion.cli.config import mission_page
from companion.cli.fly import KEYS, MOTIONS, ORDERS, TWICE
from companion.guidance.operator import order_time, precedence
from companion.parts.mqtt.messages import PUBLISHED
from companion.settings.model import EXPERT, Settings, in_file
from companion.settings.schema import variants, walk
from supply import safety

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.rglob("*.md")), *(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "SECURITY", "CHANGELOG"))]
_FENCED = re.compile(r"^( *)```.*?^\1```$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"\]\((?!https?:|mailto:)([^)\s]+)\)")


def anchors(page: Path) -> set[str]:
    """Return the anchors of the page's headings, as GitHub and Python-Markdown make them."""
    found = set()
    for heading in re.findall(r"^#+ +(.+)$", _FENCED.sub("", page.read_text()), re.MULTILINE):
        words = re.sub(r"[^\w\s-]", "", heading.lower()).strip()
        found.add(re.sub(r"[\s-]+", "-", words))
    return found


def test_the_navigation_names_every_page_once() -> None:
    nav = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n", 1)[1]
    named = re.findall(r"([\w./-]+\.md)$", nav, re.MULTILINE)
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    records = {path for path in pages if path.startswith("decisions/") and path != "decisions/README.md"}
    assert sorted(named) == sorted(set(named))
    assert sorted(set(named) ^ (pages - records)) == [], "each page of docs/ belongs into `nav` of mkdocs.yml"


def test_pages_for_users_name_no_bench_and_no_commit() -> None:
    """Users read every page before the evidence in the navigation; the command of a figure stands in benches/figures.toml."""
    nav = (ROOT / "mkdocs.yml").read_text().split("\nnav:\n", 1)[1].split("\n  - Evidence:\n")[0]
    users = [ROOT / "README.md", *(DOCS / name for name in re.findall(r"([\w./-]+\.md)$", nav, re.MULTILINE))]
    makers = re.compile(r"benches\.\w|bench\s+`|\bof (?=\w*\d)[0-9a-f]{8}\b|earlier\s+referee|we\s+decided|\bargument\b", re.I)
    found = {f"{page.name}: {match[0]}" for page in users for match in makers.finditer(page.read_text())}
    assert len(users) > 30
    assert found == set()


def test_the_list_of_decisions_names_every_record() -> None:
    records = {path.name for path in DOCS.glob("decisions/*.md")} - {"README.md"}
    listed = set(re.findall(r"\]\(([\w-]+\.md)\)", (DOCS / "decisions/README.md").read_text()))
    assert sorted(listed ^ records) == [], "each record has a line in docs/decisions/README.md"


def test_every_link_leads_to_a_file_and_a_heading() -> None:
    broken = []
    for page in PAGES:
        for link in _LINK.findall(_FENCED.sub("", page.read_text())):
            path, _, anchor = link.partition("#")
            target = page.parent / path if path else page
            if not target.is_file() and not (page.parent == ROOT and target.is_dir()):
                broken.append(f"{page.relative_to(ROOT)}: {link} is no file")
            elif anchor and anchor not in anchors(target):
                broken.append(f"{page.relative_to(ROOT)}: {link} is no heading")
            elif page.is_relative_to(DOCS) and not target.resolve().is_relative_to(DOCS):
                broken.append(f"{page.relative_to(ROOT)}: {link} lies outside the site")
    assert broken == []


def test_the_changelog_begins_with_what_comes_and_the_next_version_follows_its_newest() -> None:
    headings = re.findall(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    dated = [re.fullmatch(r"(\d+\.\d+\.\d+) - \d{4}-\d\d-\d\d", heading) for heading in headings[1:]]
    released = [Version(match[1]) for match in dated if match is not None]
    assert headings[0] == "Unreleased"
    assert len(released) == len(headings) - 1
    assert released == sorted(released, reverse=True)
    coming = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["version"]["fallback-version"]
    assert released[0] < Version(coming)
    assert f"decklander_{released[0]}+debian13_arm64.deb" in (DOCS / "installation.md").read_text()


PAGE = (DOCS / "operator.md").read_text()


@pytest.mark.parametrize(("name", "module"), [("precedence", precedence), ("order time", order_time)])
def test_the_page_holds_the_tables_of_orders(name: str, module: Any) -> None:
    shown = PAGE.partition(f"<!-- {name} -->\n")[2].partition(f"<!-- /{name} -->")[0]
    assert shown == module.markdown(), f"copy what python -m {module.__name__} prints"


def test_the_page_names_every_order_and_key() -> None:
    assert all(f"decklander fly {name}" in PAGE for name in ORDERS)
    letters = [key for key in (*MOTIONS, *KEYS, *TWICE) if len(key) == 1 and key != " "]
    assert all(f"`{key}`" in PAGE for key in letters)


THREATS = tomllib.loads((ROOT / "tests/docs/threats.toml").read_text())


def test_every_line_of_the_threat_model_has_a_test_that_is_there() -> None:
    model = (DOCS / "security.md").read_text().split("## Threat model", 1)[1].split("\n## ", 1)[0]
    rows = [line for line in model.splitlines() if line.startswith("|")][2:]
    assert len(rows) >= 5
    assert [row for row in rows if row.count("|") != 5] == [], "number, who, what they try, what they get"
    assert [row.split("|")[1].strip() for row in rows] == list(THREATS)
    tests = [test.split("::") for tests in THREATS.values() for test in tests or ["none::none"]]
    wrong = [
        f"{path}::{name}"
        for path, name in tests
        if not (ROOT / path).is_file() or not re.search(rf"^ *(?:async )?def {name}\(", (ROOT / path).read_text(), re.MULTILINE)
    ]
    assert wrong == []


def test_every_hazard_and_action_has_a_test_and_every_mark_is_one_of_them() -> None:
    assert sorted(safety.marked_tests()) == sorted((*safety.SAID["hazards"], *safety.SAID["actions"]))
    assert {h for row in safety.SAID["actions"].values() for h in row["hazards"].split()} <= set(safety.SAID["hazards"])
    assert {loss for hazard in safety.SAID["hazards"].values() for loss in hazard["losses"].split()} == set(safety.SAID["losses"])


def test_the_safety_case_is_that_of_the_marks() -> None:
    assert (ROOT / "docs/safety.md").read_text() == safety.page(), "python -m supply.safety > docs/safety.md"


TEXTS = {str(page.relative_to(ROOT)): page.read_text() for page in PAGES}
PACKAGES = "companion|drivers|estimator|sitl|configs|tests|benches|fuzz|mutants|supply|requirements|qualification"
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
    for name, command in COMMANDS.items():
        parser = argparse.ArgumentParser()
        importlib.import_module(command.module).add_arguments(parser)
        found[name] = frozenset(of(parser))
    return found


@cache
def in_backticks() -> list[tuple[str, str]]:
    """Return (page, text) of everything that stands in single backticks outside of fenced blocks."""
    return [
        (page, " ".join(text.split()))
        for page, whole in TEXTS.items()
        for text in re.findall(r"(?<!`)`([^`]+)`(?!`)", re.sub(r"^( *)```.*?^\1```$", "", whole, flags=re.MULTILINE | re.DOTALL))
    ]


@cache
def source(*patterns: str) -> str:
    return "".join(path.read_text() for pattern in patterns for path in ROOT.glob(pattern))


def is_importable(name: str) -> bool:
    """Return whether `name` is a module of the repository, or something that one defines."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:length])
        if path.with_suffix(".py").is_file() or (path.is_dir() and any(path.glob("*.py"))):
            found: object = importlib.import_module(".".join(parts[:length])) if parts[length:] else path
            for part in parts[length:]:
                found = getattr(found, part, None)
            return found is not None
    return False


def is_setting(text: str) -> bool:
    """Return whether `section.key` is one; `estimator` is a package and a section, so a module or a name in one is right too."""
    key = text.split(" = ")[0]
    looks_like_one = key.split(".")[0] in keys() or key.rpartition(".")[2] in {known.rpartition(".")[2] for known in keys()}
    return key in keys() or key.rpartition(".")[2] in ENDINGS or not looks_like_one or is_importable(key)


def is_file(text: str) -> bool:
    """Return whether a path exists; it may be a pattern: `companion/tools/doctor/rules_*.py`."""
    path = text.split("::")[0].rstrip("/")
    return "<" in path or any(ROOT.glob(path))


NAMED: dict[str, tuple[str, Callable[[str], bool]]] = {
    "settings": (r"[a-z_0-9]+(\.[a-z_0-9]+)+( = .*)?", is_setting),
    "tables": (r"\[[a-z_0-9.]+\]", lambda text: text[1:-1] in keys() | {"project.urls"}),
    "metrics": (r"decklander_[a-z_]+", lambda name: name in source("companion/parts/metrics/*.py")),
    "named values, types of the core": (
        r"dl_[a-z_]+",
        lambda name: f'"{name}"' in source("companion/parts/mavlink/*.py") or name in source("estimator/core/decklander.h"),
    ),
    "modules": (rf"({PACKAGES})(\.[A-Za-z_]\w*)+(\(.*)?", lambda text: is_importable(text.split("(")[0]) or text in keys()),
    "files": (rf"({PACKAGES})/[\w./*-]+(::.*)?", is_file),
}
"""Kinds of names in backticks: the pattern of one, and whether it exists."""


@pytest.mark.parametrize("kind", NAMED)
def test_what_stands_in_backticks_exists(kind: str) -> None:
    pattern, exists = NAMED[kind]
    named = {(page, text) for page, text in in_backticks() if re.fullmatch(pattern, text)}
    assert sorted((page, text) for page, text in named if not exists(text)) == []
    assert named


EVERYWHERE: dict[str, tuple[str, Callable[[str], bool]]] = {
    "modules": (r"python -m ((?:\w+\.)+\w+)", is_importable),
    "make targets": (
        r"(?:`|^ {4})make ([a-z][a-z0-9-]*)",
        lambda name: re.search(rf"^{name}:", source("Makefile"), re.MULTILINE) is not None,
    ),
    "files": (r"(?<![\w/.-])((?:configs|requirements)/[\w./-]+\w)", lambda path: (ROOT / path).exists()),
    "topics": (r"(?:decklander/v2/[^/\s`\"]+|`\.\.\.)/([a-z]+)", lambda leaf: leaf in {"command", "vessel", *PUBLISHED}),
}
"""Kinds of names anywhere in a page, commands and blocks included."""


@pytest.mark.parametrize("kind", EVERYWHERE)
def test_what_stands_in_commands_and_blocks_exists(kind: str) -> None:
    pattern, exists = EVERYWHERE[kind]
    named = {(page, name) for page, text in TEXTS.items() for name in re.findall(pattern, text, re.MULTILINE)}
    assert sorted((page, name) for page, name in named if not exists(name)) == []
    assert named


def test_settings_in_the_blocks_are_keys_of_the_model() -> None:
    wrong, seen = [], 0
    for page, text in TEXTS.items():
        for block in re.findall(r"^\n((?:    \S[^\n]*\n|\n(?=    ))+)", text, re.MULTILINE):
            bare = re.sub(r"^    ", "", block, flags=re.MULTILINE)
            header = re.search(r"^\[([a-z_]+)[\].]", bare, re.MULTILINE)
            if header is not None and header[1] in keys():
                seen += 1
                wrong += [f"{page}: {path}" for path in flat(tomllib.loads(bare[header.start() :]), "") if path not in keys()]
    assert wrong == []
    assert seen >= 2


_DEFAULT = re.compile(
    r"`([a-z_0-9.]+)(?: = ([^`]+)`,? \(?the default|` \((-?[\d.]+|the default) ?(ms|cm|s|m|%)?(?:/s|/s\^2)?[),;])"
)
_SI = {"ms": 0.001, "cm": 0.01, "%": 0.01}


@cache
def defaults() -> dict[str, list[object]]:
    """Return the defaults of every key, by its path in a file and by each shorter ending of it."""
    found: dict[str, list[object]] = {}
    for path, field in walk(Settings):
        value = field.default if field.default_factory is NODEFAULT else field.default_factory()
        for name in (in_file(path), *(path.split(".", n)[n] for n in range(path.count(".") + 1))):
            found.setdefault(name, []).append(value)
    return found


def test_a_default_that_a_page_states_is_that_of_the_code() -> None:
    wrong, seen = [], 0
    for page, text in TEXTS.items():
        for name, written, number, unit in _DEFAULT.findall(text) if page != "docs/configuration.md" else ():
            written = "true" if number == "the default" else written
            value = tomllib.loads(f"v = {written}")["v"] if written else float(number) * _SI.get(unit, 1.0)
            known = defaults().get(name, [])
            seen += bool(known)
            if known and not any(value == pytest.approx(d) if isinstance(d, float) else value == d for d in known):
                wrong.append(f"{page}: {name} is {known}, not {value}")
    assert wrong == []
    assert seen > 6


def flat(table: dict[str, object], path: str) -> Iterator[str]:
    for key, value in table.items():
        here = f"{path}.{key}".lstrip(".")
        yield here
        if isinstance(value, dict):
            yield from flat(value, here)


def test_commands_and_options_in_the_text_exist() -> None:
    of_tools = re.findall(r'"(--[a-z][a-z-]*)"', source("benches/**/*.py", "supply/*.py", "fuzz/*.py", "mutants/*.py"))
    everywhere = frozenset[str]().union(*options().values(), of_tools, FOREIGN_OPTIONS, {"--help", "--version"})
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


def test_the_page_of_the_mission_is_what_its_table_says() -> None:
    printed = (DOCS / "mission.md").read_text(encoding="utf-8")
    assert printed == mission_page(), "run: decklander config mission > docs/mission.md"
    for state in State:
        assert f"| {state.value} |" in printed
