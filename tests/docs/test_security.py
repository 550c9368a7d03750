"""The threat model is no promise: every line names a test, and every test that it names is there."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/security.md"
_NAMED = re.compile(r"`(tests/[\w./]+)::(\w+)`")


def rows() -> list[str]:
    """Return the lines of the threat model's table, without its head."""
    model = PAGE.read_text().split("## Threat model", 1)[1].split("\n## ", 1)[0]
    return [line for line in model.splitlines() if line.startswith("|")][2:]


def test_every_line_of_the_threat_model_names_a_test() -> None:
    assert len(rows()) >= 5
    assert [row for row in rows() if not _NAMED.search(row)] == []
    assert [row for row in rows() if row.count("|") != 5] == [], "who, what they try, what they get, the test"


def test_every_test_that_the_page_names_is_there() -> None:
    missing = [
        f"{path}::{name}"
        for path, name in _NAMED.findall(PAGE.read_text())
        if not (ROOT / path).is_file() or not re.search(rf"^ *(?:async )?def {name}\(", (ROOT / path).read_text(), re.MULTILINE)
    ]
    assert missing == []
