"""The public names are those of supply/public.json, and a change of them is announced."""

import json
import re

import pytest

from supply import stability
from supply.deb import ROOT

COMMITTED = json.loads(stability.DESCRIPTION.read_text())
PAGE = (ROOT / "docs/stability.md").read_text()


@pytest.fixture(scope="module")
def found() -> dict[str, str]:
    return stability.description()


def test_the_description_is_that_of_the_code(found: dict[str, str]) -> None:
    assert stability.changes(COMMITTED, found, stability.announced()) == []
    assert found == COMMITTED, "python -m supply.stability --write"


def test_each_kind_that_the_page_promises_is_described(found: dict[str, str]) -> None:
    kinds = set(re.findall(r"^\| `([a-z ]+)` \|", PAGE, re.MULTILINE))
    assert len(kinds) == 7
    for kind in kinds:
        assert any(name.startswith(f"{kind} ") for name in found), kind
    assert all(any(name.startswith(f"{kind} ") for kind in kinds) for name in found)


@pytest.mark.parametrize(
    "name",
    [
        "python decklander.PadTracker.track",
        "setting guidance.mission",
        "mqtt StatusMessage.reason",
        "recording topic /detection",
        "exit code 2",
        "json detect confidence",
        "mavlink parameter",
    ],
)
def test_what_is_gone_or_changed_without_a_word_is_named(name: str) -> None:
    name = next(known for known in COMMITTED if known.startswith(name))
    without = {known: meaning for known, meaning in COMMITTED.items() if known != name}
    changed = COMMITTED | {name: "something else"}
    (gone,), (other,) = stability.changes(COMMITTED, without, ""), stability.changes(COMMITTED, changed, "")
    assert gone.startswith(f"{name} is gone: say so under Unreleased")
    assert other.startswith(f"{name} is something else, was ")
    assert stability.changes(COMMITTED, without, f"- `{name.split()[-1]}` is gone: use another.") == []
    assert stability.changes(COMMITTED, COMMITTED | {"setting new.key": "a number"}, "") == []


def test_what_is_deprecated_is_still_there_and_says_when_it_goes() -> None:
    table = PAGE.partition("## What is deprecated\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `([^`]+)` \| (.+) \| (\d+\.\d+) \| (\d+\.\d+), (\d{4}-\d\d-\d\d) \|$", table, re.MULTILINE)
    assert len(rows) == len(re.findall(r"^\| `", table, re.MULTILINE)), "| `name` | instead | since | gone in, date |"
    for name, _, since, gone, _ in rows:
        assert any(known.split()[-1] == name for known in COMMITTED), name
        assert tuple(map(int, gone.split("."))) > tuple(map(int, since.split("."))), "one minor release has both"
