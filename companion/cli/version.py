"""Which decklander this is."""

from __future__ import annotations


def version() -> str:
    """The installed distribution's version, "(not installed)" when run from a bare checkout."""
    from importlib import metadata

    try:
        return metadata.version("decklander")
    except metadata.PackageNotFoundError:
        return "(not installed)"
