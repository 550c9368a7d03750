"""The version comes from git's tags, or from the archive that knew them, and dpkg sorts it as Python does."""

import itertools
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from hatchling.metadata.core import ProjectMetadata
from hatchling.plugin.manager import PluginManager

from supply.deb import ROOT, debian_version


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def git(folder: Path, *words: str) -> str:
    identity = ("-c", "user.name=a", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main")
    return subprocess.run(["git", *identity, *words], cwd=folder, check=True, capture_output=True, text=True).stdout.strip()


def version(folder: Path) -> str:
    return str(ProjectMetadata(str(folder), PluginManager()).version)


def test_tags_give_the_version_and_each_commit_after_them_its_own(source: Path) -> None:
    git(source, "init", "--quiet")
    git(source, "add", ".")
    git(source, "commit", "--quiet", "--message", "one")
    untagged = version(source)
    assert re.fullmatch(rf"1\.1\.0\.dev\d\+g{git(source, 'rev-parse', 'HEAD')[:9]}", untagged)
    git(source, "tag", "v1.2.0")
    assert version(source) == "1.2.0"
    git(source, "commit", "--quiet", "--allow-empty", "--message", "two")
    assert version(source) == f"1.2.1.dev1+g{git(source, 'rev-parse', 'HEAD')[:9]}"


def test_without_git_it_is_that_of_the_archive_or_the_next_one(source: Path) -> None:
    assert version(source) == "1.1.0.dev0"
    (source / "PKG-INFO").write_text("Metadata-Version: 2.4\nName: decklander\nVersion: 1.7.0\n")
    assert version(source) == "1.7.0"


@pytest.mark.skipif(shutil.which("dpkg") is None, reason="there is no dpkg here")
def test_dpkg_takes_a_development_version_and_a_candidate_for_older_than_their_release() -> None:
    rising = [
        debian_version(text) for text in ("1.0.0", "1.1.0.dev2", "1.1.0.dev10+gabc", "1.1.0rc1", "1.1.0", "1.1.1.dev1+gdev2")
    ]
    assert rising[-1] == "1.1.1~dev1+gdev2"
    for older, newer in itertools.pairwise(rising):
        assert subprocess.run(["dpkg", "--compare-versions", older, "lt", newer], check=False).returncode == 0, (older, newer)
