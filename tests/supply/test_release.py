"""The repository's address stands in one place and is written into all, and what a release lacks is named."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from supply import release
from supply.deb import ROOT

ADDRESS = "https://github.com/someone/decklander"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    for name in (*release.NAMING, "CHANGELOG.md"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def git(folder: Path, *words: str) -> None:
    subprocess.run(
        ["git", "-c", "user.name=a", "-c", "user.email=a@example.org", *words], cwd=folder, check=True, capture_output=True
    )


def test_every_file_names_the_one_address_and_no_other_place_the_placeholder() -> None:
    known = release.address()
    assert all(known in (ROOT / name).read_text() for name in release.NAMING)
    found = subprocess.run(["git", "grep", "-l", "ADDRESS-OF-THIS"], cwd=ROOT, capture_output=True, text=True, check=False)
    if found.returncode == 128:
        pytest.skip("not a git checkout")
    assert set(found.stdout.split()) <= {*release.NAMING, "supply/release.py", "tests/supply/test_release.py"}


def test_an_address_is_written_everywhere_and_back_to_the_byte(source: Path) -> None:
    before = {name: (source / name).read_text() for name in release.NAMING}
    release.write(f"{ADDRESS}.git", source)
    release.write(ADDRESS, source)
    assert release.address(source) == ADDRESS
    for name in release.NAMING:
        text = (source / name).read_text()
        assert ADDRESS in text
        assert release.PLACEHOLDER not in text
    readme = (source / "README.md").read_text()
    assert readme.count(f"({ADDRESS}/actions/workflows/tests.yml)") == 1
    assert f"git clone {ADDRESS} decklander" in readme
    release.write(before["CITATION.cff"].split("repository-code: ")[1].split()[0], source)
    assert {name: (source / name).read_text() for name in release.NAMING} == before


@pytest.mark.parametrize("text", ["decklander", "http://github.com/a/b", "https://github.com", "https://github.com/a b/c"])
def test_what_is_no_address_is_refused_in_a_line(text: str, source: Path) -> None:
    with pytest.raises(ValueError, match="is no address as"):
        release.write(text, source)
    done = subprocess.run([sys.executable, "-m", "supply.release", "--address", text], cwd=ROOT, capture_output=True, check=False)
    assert (done.returncode, done.stderr.count(b"\n")) == (2, 1)


def test_each_thing_that_a_release_lacks_has_a_line_until_it_is_there(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(source.parent))
    git(source, "init", "--quiet")
    git(source, "add", ".")
    git(source, "commit", "--quiet", "--message", "one")
    release.write(release.PLACEHOLDER, source)
    assert [line.split(":")[0].split(",")[0] for line in release.missing(source)] == [
        "the repository's address",
        "who answers",
        "the tag",
    ]
    release.write(ADDRESS, source)
    project = source / "pyproject.toml"
    project.write_text(
        project.read_text().replace("authors = [", 'maintainers = [{name = "A", email = "a@example.org"}]\nauthors = [')
    )
    (newest,) = re.findall(r"\A.*?^## (\d\S*) - ", (source / "CHANGELOG.md").read_text(), re.MULTILINE | re.DOTALL)
    git(source, "commit", "--quiet", "--all", "--message", "two")
    git(source, "tag", f"v{newest}")
    assert release.missing(source) == []
    git(source, "commit", "--quiet", "--allow-empty", "--message", "three")
    assert [line.split(" for ")[0] for line in release.missing(source)] == ["a section of CHANGELOG.md"]
