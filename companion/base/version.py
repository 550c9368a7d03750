"""The version of the installed distribution, and the mark of what it plots."""

MARK = {"Title": "decklander:plot"}
"""Metadata of every plot that it writes, as matplotlib takes them for PNG, SVG and PDF."""


def version() -> str:
    """Return the version of the installed distribution, or "(not installed)" in a bare checkout."""
    from importlib import metadata

    try:
        return metadata.version("decklander")
    except metadata.PackageNotFoundError:
        return "(not installed)"
