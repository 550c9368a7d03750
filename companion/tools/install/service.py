"""The running service as systemd sees it: whether it may be stopped, and whether it comes up again."""

import json
import re
import time
from collections.abc import Callable
from dataclasses import dataclass

from companion.tools.install.layout import CURRENT, PREFIX, UNIT_NAME
from companion.tools.install.machine import Machine
from estimator.contracts.errors import Recoverable, in_words

WATCHED_S = 20.0
"""How long a restarted service is watched after it said that it is ready, seconds."""
_POLL_S = 1.0
_RATES = re.compile(r"(\d+) frames and (\d+) inertial samples a second")


@dataclass(frozen=True, slots=True)
class ServiceState:
    """The service at one instant."""

    active: str
    """ActiveState of systemd: active, inactive, failed, activating..."""
    pid: int
    restarts: int
    status: str
    """The service's own line: phase and rates."""

    @property
    def runs(self) -> bool:
        """Whether there is a process, or will be at once."""
        return self.active in ("active", "activating", "reloading", "deactivating")

    @property
    def wanted(self) -> bool:
        """Whether it was started and not stopped, be it that it failed."""
        return self.runs or self.active == "failed"

    def flows(self) -> tuple[bool, bool]:
        """Return whether frames and inertial samples come."""
        found = _RATES.search(self.status)
        return (False, False) if found is None else (found[1] != "0", found[2] != "0")


def has_manager(machine: Machine) -> bool:
    """Return whether systemd runs the computer, so that services can be started on it."""
    return machine.is_this and machine.exists("/run/systemd/system")


def state(machine: Machine) -> ServiceState | None:
    """Return the state of the service; None where no systemd runs."""
    if not has_manager(machine):
        return None
    done = machine.ask(["systemctl", "show", UNIT_NAME, "--property=ActiveState,MainPID,NRestarts,StatusText"])
    said = dict(line.split("=", 1) for line in done.stdout.splitlines() if "=" in line)
    return ServiceState(
        said.get("ActiveState", "unknown"),
        int(said.get("MainPID") or 0),
        int(said.get("NRestarts") or 0),
        said.get("StatusText", ""),
    )


def running_version(machine: Machine, found: ServiceState) -> str | None:
    """Return the name of the version that the running process was started from; None if there is no such process."""
    words = (machine.read(f"/proc/{found.pid}/cmdline") or b"").decode(errors="replace").split("\0") if found.pid else [""]
    return words[0].removeprefix(f"{PREFIX}/").split("/")[0] if words[0].startswith(f"{PREFIX}/") else None


def refuse_in_flight(machine: Machine, *, on_ground: bool = False) -> None:
    """Refuse to go on while the drone flies, or while a running service cannot say that it does not.

    Args:
        on_ground: the operator sees it stand; counts only where the service does not know.

    Raises:
        Recoverable: it flies, or it is not known whether it does.
    """
    found = state(machine)
    if found is None or not found.runs:
        return
    done = machine.ask([f"{CURRENT}/bin/decklander", "fly", "status", "--json"])
    try:
        flying = json.loads(done.stdout)["flying"] if done.returncode == 0 else None
        why = (
            "the service has no word of the vehicle"
            if done.returncode == 0
            else f"the service does not answer: {_last(done.stderr)}"
        )
    except (ValueError, KeyError, TypeError) as error:
        flying, why = None, f"the service's answer cannot be read: {in_words(error)}"
    if flying:
        raise Recoverable(f"the drone is flying ({found.status or 'no status'}): land it first; nothing was changed")
    if flying is None and not on_ground:
        raise Recoverable(
            f"whether the drone flies is not known ({why}); if you see it stand, add --on-ground, or stop the service first "
            "(systemctl stop decklander)"
        )


def start(machine: Machine, sleep: Callable[[float], None] = time.sleep, seconds: float = WATCHED_S) -> str | None:
    """Start the service again and watch it; return why it does not come up, None if it does.

    It is up when it has said that it is ready, keeps its process for `seconds`, and has the frames and samples that came before.
    """
    before = state(machine)
    try:
        machine.do(["systemctl", "restart", UNIT_NAME])
    except Recoverable as why:
        now = state(machine)
        return f"{why}" + (f" ({now.status})" if now is not None and now.status else "")
    if machine.dry:
        return None
    first = now = state(machine)
    waited = 0.0
    while waited < seconds and now is not None and first is not None:
        if now.active != "active":
            return f"the service is {now.active}" + (f" ({now.status})" if now.status else "")
        if (now.pid, now.restarts) != (first.pid, first.restarts):
            return "the service ended and was started again"
        sleep(_POLL_S)
        waited += _POLL_S
        now = state(machine)
    if before is not None and now is not None and before.active == "active":
        for what, came, comes in zip(("frames", "inertial samples"), before.flows(), now.flows(), strict=True):
            if came and not comes:
                return f"no {what} come, and before they did ({now.status})"
    return None


def _last(text: str) -> str:
    return (text.strip().splitlines() or ["no reason"])[-1].removeprefix("decklander: ")
