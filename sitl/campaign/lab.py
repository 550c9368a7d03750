"""The extra `lab`: the packages with which campaigns do more than fly and count."""

from importlib.util import find_spec

from estimator.contracts.errors import BadInput


def missing_from_lab(*packages: str) -> list[str]:
    """Return those of the packages that are not installed."""
    return [package for package in packages if find_spec(package) is None]


def require_lab(option: str, *packages: str) -> None:
    """Refuse an option before any work is done where its packages are not installed.

    Raises:
        BadInput: one is missing; the message names it and how to install it.
    """
    if missing := missing_from_lab(*packages):
        raise BadInput(
            f"{option} needs {' and '.join(missing)}, which is not installed: install requirements/lab.txt, "
            "or the extra decklander[lab]"
        )
