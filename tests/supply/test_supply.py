"""The shipped packages are listed, under licences that are allowed, and known weaknesses of them fail the audit."""

import re
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from supply.deb import PINS, ROOT

PAGE = (ROOT / "docs/licences.md").read_text()
COPYLEFT = (
    "libx264", "libx265", "libav", "libsw", "libgfortran", "libquadmath", "libmp3lame", "libgnutls", "libasound", "libgmp",
    "libnettle", "libhogweed", "libunistring",
)  # fmt: skip
"""Beginnings of the names of native libraries under copyleft."""


def pins(path: Path) -> dict[str, str]:
    return dict(re.findall(r"^([a-z0-9._-]+)==(\S+)", path.read_text(), re.MULTILINE))


def shipped() -> dict[str, str]:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    found = pins(PINS)
    for extra in declared.keys() - {"dev", "witness"}:
        for name, version in pins(PINS.with_name(f"{extra}.txt")).items():
            assert found.setdefault(name, version) == version, f"the extra {extra} pins another {name} than others"
    return found


def listed(root: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["sh", root / "supply/licences.sh", sys.executable], capture_output=True, text=True, check=False)


def test_the_page_of_licences_is_that_of_today_and_names_every_pin() -> None:
    assert listed(ROOT).stdout == PAGE, "make licences"
    rows = re.findall(r"^\| (\S+) +\| ([0-9]\S*) +\|", PAGE, re.MULTILINE)
    assert {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in rows} == shipped()


def test_a_distribution_under_a_licence_that_is_not_allowed_is_refused(tmp_path: Path) -> None:
    for folder, pattern in (("supply", "*.sh"), ("requirements", "*.txt"), ("docs", "licences.md")):
        (tmp_path / folder).mkdir()
        for path in (ROOT / folder).glob(pattern):
            (tmp_path / folder / path.name).write_text(path.read_text())
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text().replace("EPL-2.0 OR BSD-3-Clause;", ""))
    refused = listed(tmp_path)
    assert refused.returncode == 1
    assert "EPL-2.0 OR BSD-3-Clause not in allow-only licenses was found for package paho-mqtt" in refused.stderr


def test_what_is_under_the_gpl_is_named_with_what_carries_it() -> None:
    named = {
        (where, library)
        for libraries, where in re.findall(r"^\| (.*?) \|.*\| in the wheel of (\S+) \|$", PAGE, re.MULTILINE)
        for library in libraries.split(", ")
    }
    carried = {
        (name, re.split(r"[-.]", file.name)[0])
        for name in shipped()
        for file in metadata.distribution(name).files or ()
        if re.search(r"\.libs/", str(file))
    }
    assert named == {pair for pair in carried if pair[1].startswith(COPYLEFT) and pair[1] != "libavif"}
    assert {name for name, library in named if library in ("libx264", "libx265")} == {"av"}, "docs/cameras.md names PyAV alone"


COULD_NOT = "THE AUDIT COULD NOT BE MADE: "
SKIPPED = "Dependency not found on PyPI and could not be audited: zstandard (0.25.0)"
FOUND = "Found 1 known vulnerability in 1 package"


@pytest.mark.parametrize(
    ("answer", "code", "options", "ends", "says"),
    [
        ("No known vulnerabilities found", 0, [], 0, "No known vulnerabilities found"),
        (FOUND, 1, [], 1, FOUND),
        (f"{FOUND}\n{SKIPPED}", 1, [], 1, FOUND),
        (f"No known vulnerabilities found\n{SKIPPED}", 0, [], 0, COULD_NOT + SKIPPED),
        ("Tip: your network may be blocking this service.", 1, [], 0, COULD_NOT + "Tip: your network"),
        (f"ERROR: {SKIPPED}", 1, ["--strict"], 1, COULD_NOT),
    ],
)
def test_an_audit_fails_on_a_weakness_and_reports_it_where_it_could_not_be_made(tmp_path, answer, code, options, ends, says):
    program = tmp_path / "pip-audit"
    program.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/asked\ncat <<END\n{answer}\nEND\nexit {code}\n')
    program.chmod(0o755)
    done = subprocess.run(["sh", ROOT / "supply/audit.sh", program, *options], capture_output=True, text=True, check=False)
    assert (done.returncode, says in done.stdout) == (ends, True)
    asked = [Path(word).stem for word in (tmp_path / "asked").read_text().split() if word.endswith(".txt")]
    assert set().union(*(pins(PINS.with_name(f"{name}.txt")) for name in asked)) == shipped().keys()


def test_an_installation_prints_what_it_downloaded_and_ends_as_pip_does(tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text(
        '#!/bin/sh\n[ -e two.txt ] || exit 3\necho "$@" > words\n'
        "printf '  Downloading %s\\n' 'a.whl.metadata (900 kB)' 'a.whl (1.5 MB)' 'c.whl (500 kB)'\n"
        "echo 'Installing collected packages: a, b, c'\n"
    )
    python.chmod(0o755)
    command = ["sh", ROOT / "supply/install.sh", python, "one.txt", "two.txt"]
    assert subprocess.run(command, cwd=tmp_path, capture_output=True, check=False).returncode == 3
    (tmp_path / "two.txt").touch()
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True)
    assert re.search(r"downloaded 2 files, 2.0 MB, in \d+ s; installed 3 packages in \d+ s", done.stdout)
    assert (tmp_path / "words").read_text().endswith(" -r one.txt -r two.txt\n")
