"""Files that commands write: declared with their kind, and checked before the work begins.

Nothing that a command reads is written over. What can be made again (a report, a plot) and bears our mark is replaced, everything
else only with --force.
"""

import argparse
import hashlib
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from companion.base.version import MARK
from companion.cli.options import option
from estimator.contracts.errors import BadInput, refused


class Kind(NamedTuple):
    """A kind of file, or of folder."""

    name: str
    endings: tuple[str, ...] = ()
    """Endings of its name; a file without any may have every name, and may be a device."""
    marks: tuple[bytes, ...] = ()
    """Bytes by which one of ours is known that can be made again; none for what somebody owns."""
    inside: tuple[str, ...] | None = None
    """Patterns of the files that are written into a folder, if a name without these endings is one."""
    lasting: bool = False
    """True for what not even --force replaces."""


RECORDING = Kind("recording", (".mcap",))
SETTINGS = Kind("settings file", (".toml",))
CAMERA_FILE, PAD_FILE = Kind("camera file", (".toml",)), Kind("pad file", (".toml",))
RESPONSE_FILE = Kind("response file", (".toml",))
SNAPSHOT, POLICY = Kind("snapshot", (".json",)), Kind("policy", (".npz",))
PARAMETERS = Kind("file of parameters", (".param", ".params", ".parm"))
SECRET, UNDO_FILE = Kind("secret", lasting=True), Kind("undo file", lasting=True)
REPORT = Kind("report", (".html", ".htm"), (b'<meta name="generator" content="decklander">',))
REPORT_FOLDER = Kind("report", (), REPORT.marks, ("index.html", "against/index.html"))
SHEETS = Kind("drawing", (".pdf", ".svg"))
PREVIEW = Kind("preview", (".png",))
ANIMATION = Kind("animation", (".gif",))
PLOT = Kind("plot", (".png", ".svg", ".pdf"), (MARK["Title"].encode(),))
EXPORTED = Kind("camera file of another program", (".yaml",))
FIGURES = Kind("figures", (), PLOT.marks, ("coverage.png", "residuals.png"))
EXPERIMENTS = Kind(
    "page",
    (),
    (*PLOT.marks, b"\n\nMade by `decklander experiments", b"flight,t_s,name,x_m,"),
    ("experiments.md", "experiments_*"),
)
CAMPAIGN = Kind("campaign", (), (), ())
LOGS = Kind("logs", (), (), ("*",), lasting=True)


class Output(NamedTuple):
    """An option that names a file or folder to write."""

    option: str
    dest: str
    kind: Kind


def output(parser: argparse._ActionsContainer, spec: str, meaning: str, kind: Kind, **more: Any) -> None:
    """Declare an option that names a file or folder to write, and --force. See `option`."""
    name = spec.partition(" ")[0]
    declared: tuple[Output, ...] = parser.get_default("outputs") or ()
    option(parser, spec, meaning, **{"type": Path, **more})
    parser.set_defaults(outputs=(*declared, Output(name, name.lstrip("-").replace("-", "_"), kind)))
    if not kind.lasting and all(one.kind.lasting for one in declared):
        option(parser, "--force", "replace what is there under the name of a file to write (never a file that is read)")


@contextmanager
def checked_outputs(args: argparse.Namespace) -> Iterator[None]:
    """Check the files that a command will write, and keep other commands from them until it ends.

    Raises:
        BadInput: the name has a wrong ending, names what is read, what is not ours to replace or what another command writes, or
            cannot be written.
    """
    with ExitStack() as claims:
        for one in getattr(args, "outputs", ()):
            if path := getattr(args, one.dest):
                if not Path(path).is_char_device():
                    claims.enter_context(_claim(Path(path), one.option))
                check_output(Path(path), one.kind, one.option, _read_by(args), force=getattr(args, "force", False))
        yield


@contextmanager
def _claim(path: Path, named: str) -> Iterator[None]:
    """Hold the name of a file: as that of an abstract socket, which leaves nothing behind however the command ends."""
    digest = hashlib.blake2b(os.fsencode(os.path.abspath(path)), digest_size=16).hexdigest()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as held:
        try:
            held.bind(f"\0decklander writes {digest}")
        except OSError:
            raise BadInput(f"{named} {path}: another command is writing it: name another one") from None
        yield


def check_output(path: Path, kind: Kind, named: str, read: list[Path], *, force: bool = False) -> None:
    """Check a file to write, or a folder and the files to write into it, as `checked_outputs` does; `read` are the files read."""
    if kind.inside is not None and path.suffix.lower() not in kind.endings:
        with refused(f"{named} {path}", OSError):
            for there in sorted({there for pattern in kind.inside for there in path.glob(pattern)}):
                _check_file(there, kind._replace(endings=(), inside=None), named, read, force=force)
            with tempfile.TemporaryFile(dir=next(folder for folder in (path, *path.parents) if os.path.lexists(folder))):
                return
    _check_file(path, kind, named, read, force=force)


def _check_file(path: Path, kind: Kind, named: str, read: list[Path], *, force: bool) -> None:
    """Check a file to write as `check_output` does."""
    if kind.endings and path.suffix.lower() not in kind.endings:
        raise BadInput(f"{named} {path}: the name of a {kind.name} must end in {' or '.join(kind.endings)}")
    for source in read:
        if _is_same(source, path):
            raise BadInput(f"{named} {path}: it is {source}, which is read: name another file")
    with refused(f"{named} {path}", OSError):
        if not kind.endings and path.is_char_device():
            return
        if path.exists() or path.is_symlink():
            if not (path.is_file() and (force or _is_ours(path, kind))) or kind.lasting:
                cure = "name a new one" if kind.lasting or not path.is_file() else "--force replaces it, or name a new one"
                raise BadInput(f"{named} {path}: there is a file of that name already: {cure}")
            with path.open("r+b"):
                return
        with tempfile.TemporaryFile(dir=path.parent):
            pass


def _is_ours(path: Path, kind: Kind) -> bool:
    return any(mark in path.read_bytes() for mark in kind.marks)


def _is_same(one: Path, other: Path) -> bool:
    return one == other or (one.exists() and other.exists() and os.path.samefile(one, other))


def _read_by(args: argparse.Namespace) -> list[Path]:
    """Return the files among the arguments that the command does not write."""
    written = {one.dest for one in args.outputs}
    return [path for name, value in vars(args).items() if name not in written for path in _paths(value) if os.path.isfile(path)]


def _paths(value: object) -> Iterator[Path]:
    if isinstance(value, Path):
        yield value
    elif isinstance(value, str):
        yield from {Path(value), Path(value.rpartition("@")[0])}  # with the offset of a source that is imported
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _paths(each)
