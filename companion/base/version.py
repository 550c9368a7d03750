"""The version of the installed distribution."""


def version() -> str:
    """Return the version of the installed distribution, or "(not installed)" in a bare checkout."""
    from importlib import metadata

    try:
        return metadata.version("decklander")
    except metadata.PackageNotFoundError:
        return "(not installed)"
