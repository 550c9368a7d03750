"""The path of the service's local socket: which folder, and which name for which vehicle."""

import os
import socket
import tempfile
from pathlib import Path

from companion.settings.model import Settings
from drivers.ardrone.options import ArDroneOptions
from estimator.contracts.errors import BadInput, Recoverable

OFF, AUTO = "off", "auto"
_PATH_MAX = 100
"""The longest path that the kernel takes for a Unix socket is 107 bytes."""
_SYSTEM = Path("/run/decklander")


def socket_path(settings: Settings) -> Path | None:
    """Return the path that the settings mean, or None if there is no socket.

    Raises:
        BadInput: the path is too long for a socket.
    """
    chosen = settings.operator.socket
    if chosen == OFF:
        return None
    path = folders()[0] / _name(settings) if chosen == AUTO else Path(chosen)
    if len(os.fsencode(path)) > _PATH_MAX:
        raise BadInput(f"operator.socket: a socket's path has at most {_PATH_MAX} bytes, got {str(path)!r}")
    return path


def folders() -> list[Path]:
    """Return the folders in which sockets may be, the one of this process first."""
    own = tempfile.gettempdir()
    found = [Path(os.environ["RUNTIME_DIRECTORY"].split(":")[0])] if os.environ.get("RUNTIME_DIRECTORY") else []
    if os.environ.get("XDG_RUNTIME_DIR"):
        found.append(Path(os.environ["XDG_RUNTIME_DIR"]) / "decklander")
    return [*found, Path(own) / f"decklander-{os.getuid()}", _SYSTEM]


def running(settings: Settings | None) -> Path:
    """Return the socket of the running service: that of the settings, or the only one on this computer.

    Raises:
        BadInput: the settings switch the socket off, or there are several services.
        Recoverable: no service runs.
    """
    if settings is not None:
        path = socket_path(settings)
        if path is None:
            raise BadInput('operator.socket is "off" in these settings')
        names = [path] if settings.operator.socket != AUTO else [folder / path.name for folder in folders()]
        what = f"no service runs with these settings (nothing answers at {path})"
    else:
        names = [path for folder in folders() for path in _sockets(folder)]
        what = "no service runs on this computer, or this user may not reach it"
    alive = [path for path in names if answers(path)]
    if not alive:
        raise Recoverable(f"{what}; start one with: decklander run --config FILE")
    if len(alive) > 1:
        raise BadInput(f"{len(alive)} services run ({', '.join(p.name for p in alive)}): say which with --config FILE")
    return alive[0]


def answers(path: Path) -> bool:
    """Return whether a service listens at the path."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def _name(settings: Settings) -> str:
    v = settings.vehicle
    vehicle = f"{v.host}-{v.at_port}" if isinstance(v, ArDroneOptions) else f"mavlink-{v.component_id}-{v.system_id}"
    return "".join(c if c.isalnum() or c in ".-" else "_" for c in vehicle)[:60] + ".sock"


def _sockets(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.glob("*.sock") if path.is_socket())
    except OSError:
        return []
