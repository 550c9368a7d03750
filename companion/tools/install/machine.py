"""The computer, or the bare root of one, that is installed on. Every change to it is made here."""

import fcntl
import os
import shutil
import stat
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from estimator.contracts.errors import Recoverable, in_words

LONGEST_S = 1800.0
"""The longest time of one command, seconds: an environment on a Raspberry Pi's card takes minutes."""


class Machine:
    """The computer that is installed on. Paths are those that the computer itself has, whatever its root is here.

    Args:
        root: the folder of its root; "/" for this computer.
        out: where each change is
        printed. dry: print the changes and make none.
    """

    def __init__(self, root: Path, out: TextIO, *, dry: bool = False) -> None:
        self.root = root
        self.dry = dry
        self._out = out

    @property
    def is_this(self) -> bool:
        """True if it is the computer that runs this program, not the root of another."""
        return self.root == Path("/")

    def path(self, inside: str) -> Path:
        """Return where a path of that computer is here."""
        return self.root / inside.lstrip("/")

    def say(self, text: str) -> None:
        """Tell the user something in one line."""
        self._out.write(text + "\n")
        self._out.flush()

    def changes(self, text: str) -> bool:
        """Tell a change, and return whether it is to be made."""
        self.say(f"would {text}" if self.dry else text)
        return not self.dry

    def exists(self, inside: str) -> bool:
        """Return whether there is something at a path, even a link to nothing."""
        return os.path.lexists(self.path(inside))

    def target(self, inside: str) -> str | None:
        """Return what a link points to; None if there is none."""
        try:
            return os.readlink(self.path(inside))
        except OSError:
            return None

    def read(self, inside: str) -> bytes | None:
        """Return the content of a file; None if it cannot be read."""
        try:
            return self.path(inside).read_bytes()
        except OSError:
            return None

    def folder(self, inside: str, mode: int = 0o755) -> None:
        """Make a folder unless it is there."""
        if not self.path(inside).is_dir() and self.changes(f"make {inside}"):
            self.path(inside).mkdir(mode, parents=True, exist_ok=True)

    def write(self, inside: str, content: bytes, mode: int = 0o644) -> bool:
        """Write a file whole or not at all, and return whether it changed. One that is as wished is left alone.

        Raises:
            OSError: it cannot be written.
        """
        path = self.path(inside)
        if self._is_as_wished(path, content, mode):
            return False
        if self.changes(f"write {inside} (mode {mode:o})"):
            path.parent.mkdir(parents=True, exist_ok=True)
            beside = path.with_name(f".{path.name}.partial")
            beside.unlink(missing_ok=True)
            with open(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
                os.fchmod(file.fileno(), mode)
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            if os.geteuid() == 0:
                os.chown(beside, 0, 0)
            beside.replace(path)
        return True

    @staticmethod
    def _is_as_wished(path: Path, content: bytes, mode: int) -> bool:
        try:
            found = path.lstat()
            same = stat.S_ISREG(found.st_mode) and stat.S_IMODE(found.st_mode) == mode and path.read_bytes() == content
        except OSError:
            return False
        return same and (os.geteuid() != 0 or (found.st_uid, found.st_gid) == (0, 0))

    def copy(self, here: Path, inside: str) -> None:
        """Copy a file, or the files of a folder, of this machine's into the computer."""
        if self.changes(f"copy {here} to {inside}"):
            self.path(inside).parent.mkdir(parents=True, exist_ok=True)
            if here.is_dir():
                shutil.copytree(here, self.path(inside), dirs_exist_ok=True)
            else:
                shutil.copyfile(here, self.path(inside))

    def link(self, inside: str, target: str) -> None:
        """Let a link point to a target; there is no instant at which it points nowhere."""
        if self.target(inside) == target:
            return
        if self.changes(f"link {inside} -> {target}"):
            path = self.path(inside)
            path.parent.mkdir(parents=True, exist_ok=True)
            beside = path.with_name(f".{path.name}.partial")
            beside.unlink(missing_ok=True)
            beside.symlink_to(target)
            beside.replace(path)

    def remove(self, inside: str) -> None:
        """Remove a file, a link or a whole folder, if it is there."""
        if not self.exists(inside) or not self.changes(f"remove {inside}"):
            return
        path = self.path(inside)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()

    def do(self, command: Sequence[str], *, outside: bool = False) -> None:
        """Run a command that changes the computer.

        Args:
            outside: run it here even if the computer is only a root; the command gets the root as an argument.

        Raises:
            Recoverable: it failed; the text has its own last words.
        """
        if not self.changes(f"run {' '.join(command)}"):
            return
        done = self.run(command if outside else self._within(command))
        if done.returncode != 0:
            output = " ".join(line.strip() for line in (done.stderr or done.stdout).strip().splitlines()[-4:])
            raise Recoverable(f"{' '.join(command)}: {output or f'ended with {done.returncode}'}")

    def ask(self, command: Sequence[str]) -> subprocess.CompletedProcess[str]:
        """Run a command that changes nothing, also in a dry run."""
        return self.run(self._within(command))

    def run(self, command: Sequence[str]) -> subprocess.CompletedProcess[str]:
        """Run a command of this machine. One that cannot be started, or does not end, has failed with 127."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        try:
            return subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=LONGEST_S, stdin=subprocess.DEVNULL, env=environment
            )
        except (OSError, subprocess.TimeoutExpired) as why:
            return subprocess.CompletedProcess(command, 127, "", in_words(why))

    def _within(self, command: Sequence[str]) -> list[str]:
        return [*command] if self.is_this else ["chroot", str(self.root), *command]

    def sync(self) -> None:
        """Have everything written to the disk before the next change: power may go at any time."""
        if not self.dry:
            os.sync()

    def free_bytes(self, inside: str) -> int:
        """Return the free space where a path is, or would be, bytes."""
        path = self.path(inside)
        while not path.exists():
            path = path.parent
        return shutil.disk_usage(path).free

    @contextmanager
    def locked(self, inside: str) -> Iterator[None]:
        """Keep every other installation of this computer out, and leave nothing behind.

        Raises:
            Recoverable: another is at work.
        """
        if self.dry:
            yield
            return
        path = self.path(inside)
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if not os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    raise FileNotFoundError(inside)  # the one before has just ended, and its file is gone
            except OSError as why:
                raise Recoverable("another installation or update is at work on this computer") from why
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
                with suppress(OSError):  # it holds a version, or something of the user's
                    path.parent.rmdir()
