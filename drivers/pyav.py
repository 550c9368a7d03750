"""PyAV, FFmpeg's libraries for H.264, video files and streams, which are installed with the extra `video`."""

from importlib.util import find_spec

from estimator.contracts.errors import BadInput


def has_pyav() -> bool:
    """Return whether PyAV is installed."""
    return find_spec("av") is not None


def require_pyav(wanted: str) -> None:
    """Refuse what is wanted where PyAV is not installed.

    Raises:
        BadInput: it is not; the message says how to install it.
    """
    if not has_pyav():
        raise BadInput(f"{wanted} needs PyAV, which is not installed: install the extra decklander[video]")
