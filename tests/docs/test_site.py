"""Navigation and links of the documentation, and pages that are made from the code or name its tests."""

import re
import tomllib
from pathlib import Path

from companion.cli.fly import KEYS, MOTIONS, ORDERS
from companion.guidance.operator.precedence import markdown

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


def test_the_changelog_and_the_pages_name_the_version() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\n## {version} - " in (ROOT / "CHANGELOG.md").read_text()
    assert f"decklander_{version}_arm64.deb" in (DOCS / "installation.md").read_text()


PAGE = (Path(__file__).parents[2] / "docs/operator.md").read_text()


def test_the_page_holds_the_table_of_precedence() -> None:
    shown = PAGE.partition("<!-- precedence -->\n")[2].partition("<!-- /precedence -->")[0]
    assert shown == markdown(), "copy what python -m companion.guidance.operator.precedence prints"


def test_the_page_names_every_order_and_key() -> None:
    assert all(f"decklander fly {name}" in PAGE for name in ORDERS)
    letters = [key for key in (*MOTIONS, *KEYS) if len(key) == 1 and key != " "]
    assert all(f"`{key}`" in PAGE for key in letters)


PAGE_OF_SECURITY = ROOT / "docs/security.md"
_NAMED = re.compile(r"`(tests/[\w./]+)::(\w+)`")


def rows() -> list[str]:
    """Return the lines of the threat model's table, without its head."""
    model = PAGE_OF_SECURITY.read_text().split("## Threat model", 1)[1].split("\n## ", 1)[0]
    return [line for line in model.splitlines() if line.startswith("|")][2:]


def test_every_line_of_the_threat_model_names_a_test() -> None:
    assert len(rows()) >= 5
    assert [row for row in rows() if not _NAMED.search(row)] == []
    assert [row for row in rows() if row.count("|") != 5] == [], "who, what they try, what they get, the test"


def test_every_test_that_the_page_names_is_there() -> None:
    missing = [
        f"{path}::{name}"
        for path, name in _NAMED.findall(PAGE_OF_SECURITY.read_text())
        if not (ROOT / path).is_file() or not re.search(rf"^ *(?:async )?def {name}\(", (ROOT / path).read_text(), re.MULTILINE)
    ]
    assert missing == []
