"""Test the navigation and every link of the documentation, without mkdocs; `make docs` builds the site itself."""

import re
import tomllib
from pathlib import Path

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


def test_the_readme_leads_to_the_glossary() -> None:
    assert "(docs/conventions.md#glossary)" in (ROOT / "README.md").read_text()


def test_the_changelog_and_the_pages_name_the_version() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\n## {version} - " in (ROOT / "CHANGELOG.md").read_text()
    assert f"decklander_{version}_arm64.deb" in (DOCS / "installation.md").read_text()
