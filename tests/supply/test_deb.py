"""The Debian package: what it holds, what its scripts do, and that two builds are the same bytes."""

import gzip
import os
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from companion.cli.main import COMMANDS
from companion.tools.install.layout import PACKAGED_UNIT, PREFIX
from supply import deb

needs_dpkg = pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="there is no dpkg-deb here")
OWN = "decklander-1.0.0-py3-none-manylinux_2_17_x86_64.whl"


@pytest.fixture
def carried(tmp_path: Path) -> Path:
    folder = tmp_path / "wheels"
    folder.mkdir()
    for name in (OWN, "numpy-2-cp311-cp311-manylinux_2_28_x86_64.whl"):
        (folder / name).write_bytes(name.encode() * 99)
    return folder


def staged(tmp_path: Path, carried: Path, name: str) -> Path:
    folder = tmp_path / name
    folder.mkdir()
    deb.stage(folder, "x86_64", carried, b"{}\n")
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
def test_dpkg_reads_what_the_package_says_of_itself(tmp_path: Path, carried: Path) -> None:
    made = deb.build(staged(tmp_path, carried, "package"), tmp_path, "aarch64")
    assert made.name == "decklander_1.0.0_arm64.deb"
    fields = subprocess.run(["dpkg-deb", "--field", str(made)], capture_output=True, text=True, check=True).stdout
    assert re.search(r"^Depends: python3 \(>= 3\.11~\), python3 \(<< 3\.12~\), python3-venv, systemd$", fields, re.MULTILINE)
    listed = subprocess.run(["dpkg-deb", "--contents", str(made)], capture_output=True, text=True, check=True).stdout
    assert all(" root/root " in line for line in listed.splitlines())
    for path in (f"./{deb.CARRIED}/{OWN}", f".{PACKAGED_UNIT}", "./usr/share/man/man1/decklander.1.gz"):
        assert f" {path}\n" in listed
    assert f"./usr/bin/decklander -> {PREFIX}/current/bin/decklander\n" in listed


def test_there_is_no_package_for_a_32_bit_system() -> None:
    assert set(deb.ARCHITECTURES.values()) == {"amd64", "arm64"}


def test_its_scripts_run_the_commands_that_a_user_runs(tmp_path: Path, carried: Path) -> None:
    """Each script is run by a shell whose python3 and rm only tell what they were given."""
    folder = staged(tmp_path, carried, "package")
    reported = tmp_path / "told"
    for name in ("python3", "rm"):
        program = tmp_path / "bin" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text(f'#!/bin/sh\necho {name} "$PYTHONPATH" "$@" >> {reported}\n')
        program.chmod(0o755)
    ours = f"python3 /{deb.CARRIED}/{OWN} -m companion.cli.main"
    wanted = {
        ("postinst", "configure"): f"{ours} service install --packaged /{deb.CARRIED}",
        ("prerm", "remove"): f"{ours} service uninstall --packaged",
        ("postinst", "abort-upgrade"): "",
        ("prerm", "upgrade"): "",
        ("postrm", "remove"): "",
    }
    environment = {"PATH": f"{tmp_path}/bin:/usr/bin:/bin"}
    for (script, argument), line in wanted.items():
        reported.write_text("")
        subprocess.run([folder / "DEBIAN" / script, argument], check=True, env=environment)
        assert reported.read_text().strip() == line
    reported.write_text("")
    subprocess.run([folder / "DEBIAN/postrm", "purge"], check=True, env=environment)
    purged = shlex.split(reported.read_text())[1:]
    assert {"/etc/decklander", "/var/lib/private/decklander", PREFIX} <= set(purged)
    assert all("decklander" in path for path in purged if path.startswith("/")), "nothing of others'"


def test_it_says_under_which_licences_each_wheel_is(tmp_path: Path, carried: Path) -> None:
    folder = staged(tmp_path, carried, "package")
    text = (folder / "usr/share/doc/decklander/copyright").read_text()
    assert "Files: usr/share/decklander/wheels/av-*" in text
    assert re.search(r"The wheel also holds [^.]*libx264[^.]*, under\s+GPL-2\.0-or-later", text)
    shipped = re.findall(r"^([a-z0-9._-]+)==", deb.PINS.read_text(), re.MULTILINE)
    assert re.findall(r"^Files: usr/share/decklander/wheels/(\w+)-\*$", text, re.MULTILINE) == [
        re.sub("[-.]", "_", n) for n in shipped
    ]
    manual = gzip.decompress((folder / "usr/share/man/man1/decklander.1.gz").read_bytes()).decode()
    assert all(f".B {name}\n" in manual for name in COMMANDS)


def test_a_folder_without_our_wheel_makes_no_package(tmp_path: Path, carried: Path) -> None:
    (carried / OWN).unlink()
    with pytest.raises(deb.PackageError, match="0 wheels of decklander, want one"):
        staged(tmp_path, carried, "package")
