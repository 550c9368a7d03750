"""Wheels carry the right library and metadata that an index takes."""

import io
import struct
import tarfile
from pathlib import Path

import pytest

from estimator.core.library import FILE
from supply import core, wheels


def elf(machine: int, *versions: bytes) -> bytes:
    """Return the beginning of an ELF file, and the symbol versions that it needs."""
    return b"\x7fELF".ljust(18, b"\0") + struct.pack("<H", machine) + b"\0".join(versions)


def test_a_library_that_fits_its_tag_is_taken() -> None:
    wheels.check(elf(183, b"GLIBC_2.17", b"GLIBC_2.4"), "aarch64")
    wheels.check(elf(62), "x86_64")
    with open(FILE, "rb") as own:
        machine = struct.unpack_from("<H", own.read(64), 18)[0]
    assert machine in wheels.ARCHITECTURES.values()


def test_one_for_another_machine_or_a_newer_glibc_is_refused() -> None:
    with pytest.raises(wheels.WheelError, match="for aarch64 is built for ELF machine 62"):
        wheels.check(elf(62, b"GLIBC_2.17"), "aarch64")
    with pytest.raises(wheels.WheelError, match=r"x86_64 needs glibc 2\.29"):
        wheels.check(elf(62, b"GLIBC_2.4", b"GLIBC_2.29", b"GLIBC_2.17"), "x86_64")


def test_another_architecture_needs_zig(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(core.BuildError, match=r"another architecture.*compiler\.txt"):
        core.build(core.FLYING, architecture="aarch64")


GOOD = (
    "Metadata-Version: 2.4\nName: decklander\nVersion: 1.0\nSummary: lands\nLicense-Expression: Apache-2.0\n"
    "Requires-Python: >=3.11\nDescription-Content-Type: text/markdown\n\n# Text\n"
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
    ],
)
def test_what_an_index_would_refuse_is_refused_here(tmp_path: Path, old: str, new: str, told: str) -> None:
    with pytest.raises(wheels.WheelError, match=told):
        wheels.check_metadata(archive(tmp_path, GOOD.replace(old, new)))
