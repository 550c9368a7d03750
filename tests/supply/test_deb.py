"""The Debian package, the wheels and what they ship: what they hold and do, and that two builds are the same bytes."""

import gzip
import io
import os
import re
import shutil
import struct
import subprocess
import sys
import tarfile
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from companion.cli.commands import COMMANDS
from estimator.core.library import FILE
from supply import core, deb, wheels
from supply.deb import PINS, ROOT

needs_dpkg = pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="there is no dpkg-deb here")
OWN = "decklander-1.1.0.dev7+g0a1b2c3-py3-none-manylinux_2_17_x86_64.whl"


@pytest.fixture
def carried(tmp_path: Path) -> Path:
    folder = tmp_path / "wheels"
    folder.mkdir()
    for name in (OWN, "numpy-2-cp311-cp311-manylinux_2_28_x86_64.whl"):
        (folder / name).write_bytes(name.encode() * 99)
    return folder


def staged(tmp_path: Path, carried: Path, name: str, system: str = "debian13") -> Path:
    folder = tmp_path / name
    folder.mkdir()
    deb.stage(folder, system, "x86_64", carried, b"{}\n")
    return folder


@needs_dpkg
def test_two_builds_at_different_times_are_the_same_bytes(tmp_path: Path, carried: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1760000000")
    made = []
    for number in (1, 2):
        folder = staged(tmp_path, carried, f"package-{number}")
        for path in folder.rglob("*"):
            if not path.is_symlink():
                os.utime(path, (1.8e9 + number, 1.8e9 + number))
        made.append(deb.build(folder, tmp_path / f"dist-{number}", "x86_64").read_bytes())
    assert made[0] == made[1]
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1760000001")
    assert deb.build(staged(tmp_path, carried, "package-3"), tmp_path / "dist-3", "x86_64").read_bytes() != made[0]


@needs_dpkg
@pytest.mark.parametrize(("system", "python"), [("debian12", 11), ("ubuntu24.04", 12), ("debian13", 13)])
def test_dpkg_reads_what_the_package_says_of_itself(tmp_path: Path, carried: Path, system: str, python: int) -> None:
    made = deb.build(staged(tmp_path, carried, "package", system), tmp_path, "aarch64")
    assert made.name == f"decklander_1.1.0~dev7+g0a1b2c3.{system}_arm64.deb"
    fields = subprocess.run(["dpkg-deb", "--field", str(made)], capture_output=True, text=True, check=True).stdout
    depends = rf"^Depends: python3 \(>= 3\.{python}~\), python3 \(<< 3\.{python + 1}~\), python3-venv, systemd$"
    assert re.search(depends, fields, re.MULTILINE)
    listed = subprocess.run(["dpkg-deb", "--contents", str(made)], capture_output=True, text=True, check=True).stdout
    assert all(" root/root " in line for line in listed.splitlines())
    for path in (f"./{deb.CARRIED}/{OWN}", "./usr/lib/systemd/system/decklander.service", "./etc/decklander/"):
        assert f" {path}\n" in listed
    assert f"./usr/bin/decklander -> {deb.PREFIX}/current/bin/decklander\n" in listed


@pytest.fixture
def computer(tmp_path: Path, carried: Path):
    """Return a call that runs a script of the package on a computer below tmp_path, and the log of the programs that it calls.

    Its Python makes an environment whose `decklander` answers as the files `flying` and `refusal` say.
    """
    scripts = staged(tmp_path, carried, "package") / "DEBIAN"
    (tmp_path / "bin").mkdir()
    for name, body in _PROGRAMS.items():
        program = tmp_path / "bin" / name
        program.write_text(f'#!/bin/sh\necho {name} "$@" >> "$HERE/log"\n{body}\n')
        program.chmod(0o755)
    (tmp_path / "opt").mkdir()
    (tmp_path / "etc/decklander").mkdir(parents=True)

    def run(script: str, argument: str, **states: str) -> subprocess.CompletedProcess[str]:
        text = re.sub(r"/(?=opt/|etc/|run/|usr/share)", f"{tmp_path}/", (scripts / script).read_text())
        environment = {"PATH": f"{tmp_path}/bin:/usr/bin:/bin", "HERE": str(tmp_path), **states}
        command = ["/bin/sh", "-c", text, script, argument]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    return run


_DECKLANDER = """#!/bin/sh
case "$1" in fly) echo "{\\"flying\\":${FLYING:-null}}";; config) [ -z "$REFUSED" ] || { echo "$REFUSED" >&2; exit 2; };; esac"""
_PROGRAMS = {
    "python3": f"""mkdir -p "$3/bin"; cat > "$3/bin/decklander" << 'END'
{_DECKLANDER}
END
ln -s /bin/true "$3/bin/python"; chmod +x "$3/bin/decklander" """,
    "systemctl": 'case "$1" in show) echo "${STATE:-inactive}";; restart) exit ${RESTART:-0};; esac',
    "systemd-sysusers": "",
    "sh": "",
}


def test_an_update_turns_the_link_once_its_version_is_whole_and_takes_the_settings(computer, tmp_path: Path) -> None:
    current = tmp_path / "opt/decklander/current"
    done = computer("postinst", "configure")
    assert (done.returncode, "next: decklander start" in done.stdout) == (0, True), done.stderr
    first = current.readlink()
    assert "systemctl --quiet enable decklander" in (tmp_path / "log").read_text()
    (tmp_path / "etc/decklander/rig.toml").write_text("")
    old = current.parent / "0.9"
    shutil.copytree(current.resolve(), old, symlinks=True)
    for states, code in (
        ({"STATE": "active", "FLYING": "true"}, 1),
        ({"STATE": "active", "FLYING": "null"}, 1),
        ({"STATE": "activating"}, 1),
        ({"STATE": "active", "FLYING": "false", "REFUSED": "no such key"}, 2),
        ({"STATE": "failed", "RESTART": "1"}, 1),
        ({"STATE": "active", "FLYING": "false"}, 0),
    ):
        current.unlink()
        current.symlink_to(old.name)
        done = computer("postinst", "configure", **states)
        assert (done.returncode, current.readlink()) == (code, first if code == 0 else Path(old.name)), done.stderr
    assert sorted(path.name for path in current.parent.iterdir()) == [str(first), "current"], "the old one is gone"


def test_it_is_removed_on_the_ground_alone_and_purges_nothing_of_others(computer, tmp_path: Path) -> None:
    assert computer("postinst", "configure").returncode == 0
    done = computer("prerm", "remove", STATE="active", FLYING="true")
    assert (done.returncode, "the drone flies" in done.stderr) == (1, True)
    assert computer("prerm", "upgrade", STATE="active", FLYING="true").returncode == 0, "the new version's script decides"
    assert (tmp_path / "opt/decklander/current").exists()
    assert computer("prerm", "remove", STATE="active", FLYING="false").returncode == 0
    assert not (tmp_path / "opt/decklander").exists()
    assert (tmp_path / "etc/decklander").exists()
    assert all("decklander" in path for path in deb.PURGED.split())


def test_it_says_under_which_licences_each_wheel_is(tmp_path: Path, carried: Path) -> None:
    folder = staged(tmp_path, carried, "package")
    text = (folder / "usr/share/doc/decklander/copyright").read_text()
    assert "Files: usr/share/decklander/wheels/av-*" in text
    assert re.search(r"The wheel also holds [^.]*libx264[^.]*, under\s+GPL-2\.0-or-later", text)
    pins = deb.PINS.read_text() + deb.SHIP_PINS.read_text()
    shipped = sorted({re.sub("[-.]", "_", name) for name in re.findall(r"^([a-z0-9._-]+)==", pins, re.MULTILINE)})
    assert sorted(re.findall(r"^Files: usr/share/decklander/wheels/(\w+)-\*$", text, re.MULTILINE)) == shipped
    manual = gzip.decompress((folder / "usr/share/man/man1/decklander.1.gz").read_bytes()).decode()
    assert all(f".B {name}\n" in manual for name in COMMANDS)


def test_a_folder_without_our_wheel_makes_no_package(tmp_path: Path, carried: Path) -> None:
    (carried / OWN).unlink()
    with pytest.raises(deb.PackageError, match="0 wheels of decklander, want one"):
        staged(tmp_path, carried, "package")


def elf(machine: int, *versions: bytes) -> bytes:
    """Return the beginning of an ELF file, and the symbol versions that it needs."""
    return b"\x7fELF".ljust(18, b"\0") + struct.pack("<H", machine) + b"\0".join(versions)


def test_a_library_that_fits_its_tag_is_taken() -> None:
    wheels.check(elf(183, b"GLIBC_2.17", b"GLIBC_2.4"), "aarch64")
    wheels.check(elf(62), "x86_64")
    with open(FILE, "rb") as own:
        machine = struct.unpack_from("<H", own.read(64), 18)[0]
    assert machine in wheels.ARCHITECTURES.values()


def test_one_for_another_machine_a_newer_glibc_or_of_a_folder_that_shows_is_refused() -> None:
    with pytest.raises(wheels.WheelError, match="for aarch64 is built for ELF machine 62"):
        wheels.check(elf(62, b"GLIBC_2.17"), "aarch64")
    with pytest.raises(wheels.WheelError, match=r"x86_64 needs glibc 2\.29"):
        wheels.check(elf(62, b"GLIBC_2.4", b"GLIBC_2.29", b"GLIBC_2.17"), "x86_64")
    with pytest.raises(wheels.WheelError, match="x86_64 holds the folder of its build"):
        wheels.check(elf(62, b"GLIBC_2.17", str(ROOT / "estimator").encode()), "x86_64")


def test_another_architecture_needs_zig(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(core.BuildError, match=r"another architecture.*compiler\.txt"):
        core.build(core.FLYING, architecture="aarch64")


GOOD = (
    "Metadata-Version: 2.4\nName: decklander\nVersion: 1.0\nSummary: lands\nLicense-Expression: Apache-2.0\n"
    "Requires-Python: >=3.11\nAuthor: A\nProject-URL: Source, https://example.org/a\n"
    "Description-Content-Type: text/markdown\n\n# Text\n"
)


def archive(folder: Path, text: str) -> Path:
    made = folder / "decklander-1.0.tar.gz"
    with tarfile.open(made, "w:gz") as out:
        entry = tarfile.TarInfo("decklander-1.0/PKG-INFO")
        entry.size = len(text.encode())
        out.addfile(entry, io.BytesIO(text.encode()))
    return made


def test_good_metadata_pass(tmp_path: Path) -> None:
    wheels.check_metadata(archive(tmp_path, GOOD))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("Apache-2.0", "Apache Two", "license"),
        ("Version: 1.0", "Version: one", "version"),
        (">=3.11", "later", "requires-python"),
        ("text/markdown", "text/plain", "no description in Markdown"),
        ("# Text", "", "no description in Markdown"),
        ("Summary: lands\n", "", "summary, licence or Python's version is missing"),
        ("Author: A\n", "", "nobody can find the authors"),
        ("Project-URL: Source, https://example.org/a\n", "", "nobody can find the authors or the source"),
    ],
)
def test_what_an_index_would_refuse_is_refused_here(tmp_path: Path, old: str, new: str, told: str) -> None:
    with pytest.raises(wheels.WheelError, match=told):
        wheels.check_metadata(archive(tmp_path, GOOD.replace(old, new)))


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
    for extra in declared.keys() - {"dev", "witness", "all"}:
        file = PINS.with_name(f"{extra}.txt")
        if not file.exists():  # every file of pins has it
            needs = {re.split(r"[<>=~\[]", need)[0] for need in declared[extra]} - {"decklander"}
            assert needs <= pins(PINS.with_name("runtime.txt")).keys()
            continue
        for name, version in pins(file).items():
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
