"""Files that commands write: declared with their kind, and checked before the work begins.

Nothing that a command reads is written over, and no file of another kind. What can be made again (a report, a drawing) replaces
an earlier one of ours; what somebody owns, such as a recording or settings, is replaced only with --force.
"""

import argparse
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from companion.cli.options import option
from estimator.contracts.errors import BadInput, refused

_HEAD_BYTES = 4096


class Kind(NamedTuple):
    """A kind of file."""

    name: str
    endings: tuple[str, ...]
    mark: bytes = b""
    """Bytes in the first 4 kB by which one of ours is known that can be made again; empty for what somebody owns."""


RECORDING = Kind("recording", (".mcap",))
SETTINGS = Kind("settings file", (".toml",))
CAMERA_FILE, PAD_FILE = Kind("camera file", (".toml",)), Kind("pad file", (".toml",))
RESPONSE_FILE, ERROR_MODEL = Kind("response file", (".toml",)), Kind("error model", (".toml",))
SNAPSHOT, POLICY = Kind("snapshot", (".json",)), Kind("policy", (".npz",))
PARAMETERS = Kind("file of parameters", (".param", ".params", ".parm"))
REPORT, SHEETS = Kind("report", (".html", ".htm"), b"decklander"), Kind("drawing", (".pdf", ".svg"), b"decklander")
PREVIEW = Kind("preview", (".png",))
ANIMATION = Kind("animation", (".gif",))
PLOT = Kind("plot", (".png", ".svg", ".pdf"), b"atplotlib")


class Output(NamedTuple):
    """An option that names a file to write."""

    option: str
    dest: str
    kind: Kind


def output(parser: argparse._ActionsContainer, spec: str, meaning: str, kind: Kind, **more: Any) -> None:
    """Declare an option that names a file to write, and --force where such a file is somebody's own. See `option`."""
    name = spec.partition(" ")[0]
    declared: tuple[Output, ...] = parser.get_default("outputs") or ()
    option(parser, spec, meaning, type=Path, **more)
    parser.set_defaults(outputs=(*declared, Output(name, name.lstrip("-").replace("-", "_"), kind)))
    if not kind.mark and all(one.kind.mark for one in declared):
        option(parser, "--force", "replace a file of that kind that is there already")


def check_outputs(args: argparse.Namespace) -> None:
    """Check the files that a command will write.

    Raises:
        BadInput: the name has a wrong ending, names what is read or what is not ours to replace, or cannot be written.
    """
    for one in getattr(args, "outputs", ()):
        if (path := getattr(args, one.dest)) is not None:
            check_output(path, one.kind, one.option, _read_by(args), force=getattr(args, "force", False))


def check_output(path: Path, kind: Kind, named: str, read: list[Path], *, force: bool = False) -> None:
    """Check a file that will be written.

    Args:
        named: the option that names it.
        read: files that are read meanwhile.

    Raises:
        BadInput: as for `check_outputs`.
    """
    if path.suffix.lower() not in kind.endings:
        raise BadInput(f"{named} {path}: the name of a {kind.name} must end in {' or '.join(kind.endings)}")
    for source in read:
        if source == path or (path.exists() and source.exists() and os.path.samefile(source, path)):
            raise BadInput(f"{named} {path}: it is {source}, which is read: name another file")
    with refused(f"{named} {path}", OSError):
        if path.exists() or path.is_symlink():
            ours = bool(kind.mark) and path.is_file() and kind.mark in _head(path)
            if not path.is_file() or not (ours or (force and not kind.mark)):
                cure = "name a new one" if kind.mark or not path.is_file() else "--force replaces it, or name a new one"
                raise BadInput(f"{named} {path}: there is a file of that name already: {cure}")
            with path.open("r+b"):
                return
        with tempfile.TemporaryFile(dir=path.parent):
            pass


def prepare_folder(folder: Path | None) -> None:
    """Create a report's folder and check that the report can be written into it; do nothing without a folder.

    Raises:
        BadInput: the folder cannot be created or written, or a page that is none of ours is there.
    """
    if folder is not None:
        with refused(f"--report {folder}", OSError):
            folder.mkdir(parents=True, exist_ok=True)
        check_output(folder / "index.html", REPORT, "--report", [])


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)


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
