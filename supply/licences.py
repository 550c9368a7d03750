"""List the licences of everything that is shipped: `python -m supply.licences` prints docs/licences.md."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from supply.packages import Package, every_pin, packages

_HEAD = """# Licences of what is shipped

Decklander's own code is under Apache 2.0 (`LICENSE`). An image or an installation ships these distributions from PyPI
beside it, pinned by version and hash in `requirements/runtime.txt`; an extra adds those of its own file there, and an image
holds no extra. `make licences` makes this page from their metadata and, for a few distributions whose metadata name no
licence, from a table in `supply/packages.py`; a test refuses a distribution without a known licence. The licences of native
libraries are those that their projects state.

| distribution | version | licence | installed with |
|---|---|---|---|
"""
_COPYLEFT = """
## Under the GPL or LGPL

Whoever passes on an image or a Debian package passes these on under their own terms, source included. Our own wheel
carries none of them, and no distribution that it needs is under the GPL itself. PyAV decodes the AR.Drone's video and
network cameras: its wheel carries FFmpeg with x264 and x265. pymavlink's dialects are loaded as modules.

| what | licence | where |
|---|---|---|
"""


def page(shipped: Sequence[Package]) -> str:
    """Return the page as Markdown."""
    rows = [
        f"| {p.pin.name} | {p.pin.version} | {p.licence} | {f'the extra `{p.pin.extra}`' if p.pin.extra else 'the service'} |"
        for p in shipped
    ]
    return _HEAD + "\n".join(rows) + "\n" + _COPYLEFT + "\n".join(copyleft(shipped)) + "\n"


def copyleft(shipped: Sequence[Package]) -> list[str]:
    """Return rows of distributions and carried libraries under the GPL or LGPL."""
    rows = [f"| {p.pin.name} | {p.licence} | a distribution of its own |" for p in shipped if "GPL" in (p.licence or "")]
    for p in shipped:
        by_licence: dict[str, list[str]] = {}
        for library, licence in p.carried.items():
            by_licence.setdefault(licence, []).append(library)
        rows += [
            f"| {', '.join(names)} | {licence} | in the wheel of {p.pin.name} |" for licence, names in sorted(by_licence.items())
        ]
    return rows


def unknown(shipped: Sequence[Package]) -> list[str]:
    """Return the names of distributions without a known licence."""
    return [p.pin.name for p in shipped if p.licence is None]


def main() -> int:
    """Run the command."""
    shipped = packages(every_pin())
    if missing := unknown(shipped):
        print(f"no known licence: {', '.join(missing)}", file=sys.stderr)
        return 1
    print(page(shipped), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
