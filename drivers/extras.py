"""Packages that an extra of the distribution installs, and what to answer where one is missing."""

from importlib.util import find_spec

from estimator.contracts.errors import BadInput

_NAMES = {
    "av": "PyAV",
    "can": "python-can",
    "cv2": "OpenCV",
    "paho": "paho-mqtt",
    "prometheus_client": "prometheus-client",
    "resvg_py": "resvg-py",
    "serial": "pyserial",
}
"""Names of packages that are not those of their modules."""
SERVICE = (
    "aiohttp", "cv2", "lz4", "mcap", "prometheus_client", "pymavlink", "serial", "shtab", "simplejpeg", "tomlkit", "zstandard",
)  # fmt: skip
"""The modules of the extra `service`, without which no command runs."""


def is_installed(module: str) -> bool:
    """Return whether a module is there."""
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # not even the package around it
        return False


def require(wanted: str, extra: str, *modules: str) -> None:
    """Refuse what is wanted where a module of an extra is missing.

    Raises:
        BadInput: one is; the message says how to install it.
    """
    for module in modules:
        if not is_installed(module):
            name = _NAMES.get(module, module)
            raise BadInput(f"{wanted} needs {name}, which is not installed: install the extra decklander[{extra}]")
