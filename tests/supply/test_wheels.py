"""A wheel for every machine that flies holds a library that the machine can load."""

import struct

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
