"""The distributions that the service and its extras pin, as their own metadata describes them in an environment."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parents[1]
PINS = ROOT / "requirements/runtime.txt"
_NOT_SHIPPED = {"dev"}
"""Extras for those who work on the project."""

_FROM_CLASSIFIER = {
    "Apache Software License": "Apache-2.0",
    "MIT License": "MIT",
    "Python Software Foundation License": "PSF-2.0",
    "GNU Lesser General Public License v3 (LGPLv3)": "LGPL-3.0-only",
}
_FROM_TEXT = {
    "Apache 2.0": "Apache-2.0",
    "Apache-2.0": "Apache-2.0",
    "any-OSI": "any-OSI",
    "BSD": "BSD-3-Clause",
    "BSD 3-Clause License": "BSD-3-Clause",
    "BSD-3-Clause": "BSD-3-Clause",
    "LGPLv3": "LGPL-3.0-only",
    "MIT": "MIT",
    "PSF-2.0": "PSF-2.0",
}
READ = {
    "aiomqtt": "BSD-3-Clause",
    "contourpy": "BSD-3-Clause",
    "cycler": "BSD-3-Clause",
    "jinja2": "BSD-3-Clause",
    "kiwisolver": "BSD-3-Clause",
    "locket": "BSD-2-Clause",
    "lz4": "BSD-3-Clause",
    "scipy": "BSD-3-Clause",
}
"""Distributions whose metadata do not give a licence that a program can read. Each entry was compared with the licence file
of the distribution, in the version pinned in November 2026: where it says BSD-3-Clause, the text has the third clause. No test
reads these texts again for a new version."""

_CARRIED = {
    "libx264": "GPL-2.0-or-later",
    "libx265": "GPL-2.0-or-later",
    "libav": "LGPL-2.1-or-later",
    "libsw": "LGPL-2.1-or-later",
    "libgfortran": "GPL-3.0-or-later WITH GCC-exception-3.1",
    "libquadmath": "LGPL-2.1-or-later",
    "libmp3lame": "LGPL-2.0-or-later",
    "libgnutls": "LGPL-2.1-or-later",
    "libasound": "LGPL-2.1-or-later",
    "libgmp": "LGPL-3.0-or-later OR GPL-2.0-or-later",
    "libnettle": "LGPL-3.0-or-later OR GPL-2.0-or-later",
    "libhogweed": "LGPL-3.0-or-later OR GPL-2.0-or-later",
    "libunistring": "LGPL-3.0-or-later OR GPL-2.0-or-later",
}
"""Native libraries under copyleft that wheels carry, by the beginning of their file names. The licences are those that the
libraries' own projects state; the wheels were not asked. FFmpeg built with x264 or x265 is under the GPL as a whole."""


@dataclass(frozen=True, slots=True)
class Pin:
    """One line of the pins."""

    name: str
    version: str
    hashes: tuple[str, ...]
    """SHA-256 of every file that may be installed, for all platforms."""
    extra: str = ""
    """The extra that brings it; empty for what the service itself needs."""


@dataclass(frozen=True, slots=True)
class Package:
    """One distribution as it is installed."""

    pin: Pin
    licence: str | None
    """SPDX expression; None if the licence is unknown."""
    summary: str
    requires: tuple[str, ...]
    """Names of other pinned distributions that it needs."""
    libraries: tuple[str, ...]
    """Native libraries of others that its wheel carries, without version and extension."""

    @property
    def carried(self) -> dict[str, str]:
        """The carried libraries that are under copyleft, with their licences."""
        found: dict[str, str] = {}
        gpl = any(name.startswith(("libx264", "libx265")) for name in self.libraries)
        for name in self.libraries:
            for start, licence in _CARRIED.items():
                if name.startswith(start) and name != "libavif":
                    found[name] = "GPL-2.0-or-later" if gpl and start in ("libav", "libsw") else licence
        return found


def pins(path: Path = PINS) -> tuple[Pin, ...]:
    """Return every pin of a requirements file, in the file's order."""
    found = re.findall(
        r"^([a-z0-9._-]+)==(\S+) \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n?)+)", path.read_text(), re.MULTILINE
    )
    return tuple(Pin(name, version, tuple(re.findall(r"sha256:([0-9a-f]{64})", hashes))) for name, version, hashes in found)


def extras() -> tuple[str, ...]:
    """Return the names of the extras that a user may install, in the order of pyproject.toml."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    return tuple(name for name in declared if name not in _NOT_SHIPPED)


def every_pin(folder: Path = PINS.parent) -> tuple[Pin, ...]:
    """Return the pins of the service, then those that each extra adds.

    Args:
        folder: where `runtime.txt` and a file named after each extra lie.

    Raises:
        ValueError: an extra pins another version than the service or than an extra before it.
        OSError: a file of pins is missing.
    """
    found = {pin.name: pin for pin in pins(folder / PINS.name)}
    for extra in extras():
        for pin in pins(folder / f"{extra}.txt"):
            before = found.setdefault(pin.name, replace(pin, extra=extra))
            if before.version != pin.version:
                raise ValueError(f"{pin.name} {before.version} is pinned already, and the extra {extra} pins {pin.version}")
    return tuple(found.values())


def installed(wanted: Sequence[Pin], site: Sequence[str] | None = None) -> tuple[Pin, ...]:
    """Return the pins of the service, and of the extras those whose distribution is in the environment, whatever its version."""
    names = {normal(d.name) for d in _distributions(site)}
    return tuple(pin for pin in wanted if not pin.extra or normal(pin.name) in names)


def packages(wanted: Sequence[Pin], site: Sequence[str] | None = None) -> tuple[Package, ...]:
    """Return the pinned distributions that are installed, in the order of `wanted`.

    Args:
        site: folders of another environment's packages; None for this one's.

    Raises:
        LookupError: a distribution is missing or differs in version from its pin; the text names it.
    """
    found = {normal(d.name): d for d in _distributions(site)}
    return tuple(_package(pin, found, {p.name for p in wanted}) for pin in wanted)


def _distributions(site: Sequence[str] | None) -> Iterable[metadata.Distribution]:
    return metadata.distributions() if site is None else metadata.distributions(path=list(site))


def normal(name: str) -> str:
    """Return a distribution's name in the form that indexes compare."""
    return re.sub(r"[-_.]+", "-", name).lower()


def _package(pin: Pin, installed: Mapping[str, metadata.Distribution], known: set[str]) -> Package:
    distribution = installed.get(normal(pin.name))
    if distribution is None or distribution.version != pin.version:
        raise LookupError(f"{pin.name} {pin.version} is pinned, installed is {getattr(distribution, 'version', 'none')}")
    needed = {normal(re.split(r"[\s<>=!~;\[(]", line)[0]) for line in distribution.requires or () if "extra ==" not in line}
    return Package(
        pin,
        _licence(pin.name, distribution.metadata),
        _field(distribution.metadata, "Summary"),
        tuple(sorted(needed & known)),
        tuple(sorted(set(_libraries(distribution)))),
    )


def _field(told: metadata.PackageMetadata, name: str) -> str:
    """Return one field of the metadata, empty if it is absent; older Pythons return None for it, newer ones raise."""
    return (told[name] or "") if name in told else ""


def _licence(name: str, told: metadata.PackageMetadata) -> str | None:
    if expression := _field(told, "License-Expression"):
        return expression
    if name in READ:
        return READ[name]
    text = _field(told, "License").strip()
    if text in _FROM_TEXT:
        return _FROM_TEXT[text]
    classifiers = [line.rpartition(":: ")[2] for line in told.get_all("Classifier") or [] if line.startswith("License")]
    return next((_FROM_CLASSIFIER[line] for line in classifiers if line in _FROM_CLASSIFIER), None)


def _libraries(distribution: metadata.Distribution) -> Iterator[str]:
    for file in distribution.files or ():
        if re.search(r"\.libs/|\.dylibs/", str(file)):
            yield re.split(r"[-.]", file.name)[0]
