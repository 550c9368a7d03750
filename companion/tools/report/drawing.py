"""The drawing library, matplotlib, which is installed with the extra `report` and not with the service."""

from importlib.util import find_spec

from estimator.contracts.errors import BadInput


def require_drawing(option: str, instead: str = "") -> None:
    """Refuse `option` before any work is done where matplotlib is not installed.

    Args:
        option: the command line's option that draws, as it is written there.
        instead: what the person can do without it, appended to the message.

    Raises:
        BadInput: matplotlib is not installed; the message names it and how to install it.
    """
    if find_spec("matplotlib") is None:
        raise BadInput(
            f"{option} draws with matplotlib, which is not installed: install requirements/report.txt, "
            f"or the extra decklander[report]{instead}"
        )
