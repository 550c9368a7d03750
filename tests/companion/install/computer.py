"""A computer in a folder. Its commands are answered by what lies in the folder, so that it outlives a process that is killed."""

import io
import json
import os
import shutil
import subprocess
import zipfile
from collections.abc import Sequence
from pathlib import Path

from companion.tools.install.layout import CURRENT, PREFIX, SETTINGS, UNIT
from companion.tools.install.machine import Machine
from companion.tools.install.versions import PINS, SLIM, VIDEO_PINS, Release, read

ROOT = Path(__file__).parents[3]
GOOD, REFUSES, DIES, SILENT, ENDS_LATER, BLIND = "good", "refuses the settings", "dies", "silent", "ends later", "blind"
FLYING, STANDS, UNKNOWN = True, False, None


def wheel(folder: Path, version: str, behaviour: str = GOOD) -> Release:
    """Return a wheel as `make wheels` makes it, so far as the installer reads it."""
    path = folder / f"decklander-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as made:
        made.writestr(
            f"decklander-{version}.dist-info/METADATA", f"Metadata-Version: 2.4\nName: decklander\nVersion: {version}\n\nText\n"
        )
        made.writestr("behaviour", behaviour)
        made.writestr(PINS, (ROOT / "requirements/runtime.txt").read_bytes())
        made.writestr(VIDEO_PINS, (ROOT / "requirements/video.txt").read_bytes())
        made.writestr(SLIM, (ROOT / "requirements/slim.sh").read_bytes())
        for file in (ROOT / "configs/systemd").iterdir():
            made.writestr(f"configs/systemd/{file.name}", file.read_bytes() + f"# of {version}\n".encode())
    return read(path)


class Computer(Machine):
    """It answers python, pip, systemctl and decklander; `killed_at` ends this process before its n-th change.

    Args:
        fails: a word of a command that fails, and what it says.
    """

    def __init__(
        self, root: Path, *, killed_at: int | None = None, fails: tuple[str, str] | None = None, dry: bool = False
    ) -> None:
        super().__init__(root, io.StringIO(), dry=dry)
        self.commands: list[str] = []
        self.made = 0
        self._killed_at = killed_at
        self._fails = fails
        if not (root / "etc").exists():
            for folder in ("etc", "usr/bin", "run/systemd/system", "proc"):
                (root / folder).mkdir(parents=True)
            (root / "etc/passwd").write_text("root:x:0:0:root:/root:/bin/bash\n")
            for program in ("systemctl", "systemd-sysusers"):
                (root / "usr/bin" / program).touch()
            self.unit(active="inactive", pid=0, restarts=0, status="")

    @property
    def is_this(self) -> bool:
        return True

    @property
    def said(self) -> str:
        assert isinstance(self._out, io.StringIO)
        return self._out.getvalue()

    def changes(self, text: str) -> bool:
        if self.made == self._killed_at:
            os._exit(9)
        self.made += 1
        return super().changes(text)

    def unit(self, **values: object) -> dict[str, object]:
        """Change the state of the service, and return it."""
        path = self.path("/state.json")
        state = (json.loads(path.read_text()) if path.exists() else {}) | values
        path.write_text(json.dumps(state))
        return state

    def settings(self, text: str = "good") -> None:
        self.path(SETTINGS).parent.mkdir(parents=True, exist_ok=True)
        self.path(SETTINGS).write_text(text)

    def behaviour(self, version: str) -> str:
        return self.path(f"{PREFIX}/{version}/behaviour").read_text()

    def run(self, command: Sequence[str]) -> subprocess.CompletedProcess[str]:
        line = " ".join(command)
        self.commands.append(line)
        if self._fails is not None and self._fails[0] in line:
            return subprocess.CompletedProcess(command, 1, "", self._fails[1])
        code, out, err = self._answer(list(command), line)
        return subprocess.CompletedProcess(command, code, out, err)

    def _answer(self, words: list[str], line: str) -> tuple[int, str, str]:
        if words[0] == "/usr/bin/python3" and words[1] == "-c":
            return 0, "3 11 64\n", ""
        if words[1:3] == ["-m", "venv"]:
            self.path(f"{words[3]}/bin").mkdir(parents=True)
            return 0, "", ""
        if "pip" in words:
            if words[-1].endswith(".whl"):
                home = self.path(str(Path(words[0]).parents[1]))
                with zipfile.ZipFile(words[-1]) as opened:
                    (home / "behaviour").write_bytes(opened.read("behaviour"))
                (home / "bin/decklander").touch()
            return 0, "", ""
        if words[0].endswith("/bin/decklander"):
            folder = words[0].removesuffix("/bin/decklander")
            if not self.path(words[0]).exists():
                return 127, "", "no such file"
            if words[1:2] == ["fly"]:
                unit = self.unit()
                answered = unit.get("answers", True) and unit["active"] == "active"
                return (0, json.dumps({"flying": unit.get("flying", False)}), "") if answered else (1, "", "decklander: nobody")
            if words[1] == "config" and self.path(f"{folder}/behaviour").read_text() == REFUSES:
                return 2, "", f"decklander: {SETTINGS}: vision.colors is no key"
            return 0, "good\n", ""
        if words[0] == "systemctl":
            return self._systemctl(words[1], words)
        return 0, "", ""

    def _systemctl(self, verb: str, words: list[str]) -> tuple[int, str, str]:
        if verb == "restart":
            return self._start()
        if verb == "enable":
            self.link("/etc/systemd/system/multi-user.target.wants/decklander.service", UNIT)
        if verb == "disable":
            self.unit(active="inactive", pid=0)
        if verb == "show":
            unit = self.unit()
            if unit.get("ends_in") is not None:
                left = int(str(unit["ends_in"])) - 1
                unit = self.unit(ends_in=left) if left else self.unit(ends_in=None, restarts=1, pid=int(str(unit["pid"])) + 1)
            shown = zip(
                ("ActiveState", "MainPID", "NRestarts", "StatusText"), ("active", "pid", "restarts", "status"), strict=True
            )
            return 0, "".join(f"{name}={unit[key]}\n" for name, key in shown), ""
        return 0, "", ""

    def _start(self) -> tuple[int, str, str]:
        version = Path(str(self.target(CURRENT))).name
        behaviour = self.behaviour(version)
        pid = int(str(self.unit()["pid"])) + 100
        if behaviour == DIES:
            self.unit(active="failed", pid=0, status="")
            return 1, "", "Job for decklander.service failed."
        shutil.rmtree(self.path("/proc"))
        self.path(f"/proc/{pid}").mkdir(parents=True)
        self.path(f"/proc/{pid}/cmdline").write_bytes(f"{PREFIX}/{version}/bin/python\0run\0".encode())
        status = f"standing; {0 if behaviour == BLIND else 30} frames and 200 inertial samples a second"
        self.unit(active="active", pid=pid, restarts=0, status=status, ends_in=6 if behaviour == ENDS_LATER else None)
        return 0, "", ""
