"""List the cameras and find the one that a name means. Device numbers change with each boot and each plug; names do not."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from estimator.contracts.errors import BadInput

BY_NAME = (Path("/dev/v4l/by-id"), Path("/dev/v4l/by-path"))
SYSFS = Path("/sys/class/video4linux")


@dataclass(frozen=True, slots=True)
class CaptureDevice:
    """A capture device of this machine."""

    path: Path
    """The most stable path that exists: by-id, by-path, else /dev/videoN."""
    node: Path
    """The present device node /dev/videoN."""
    card: str
    """The name that the kernel driver gives the device."""
    body: Path
    """The hardware device in sysfs, which may have several nodes."""
    index: int = 0
    """The index among the nodes of one hardware device: the first gives frames, a second often metadata."""


def cameras(by_name: tuple[Path, ...] = BY_NAME, sysfs: Path = SYSFS, dev: Path = Path("/dev")) -> list[CaptureDevice]:
    """Return every video device with its most stable path, in order of that path.

    A device may be plugged out while it is read: what is gone by then counts as absent.
    """
    stable: dict[Path, Path] = {}
    for folder in reversed(by_name):
        for link in _entries(folder):
            if (node := _resolved(link)) is not None:
                stable[node] = link
    found = []
    for entry in _entries(sysfs):
        if not entry.name.startswith("video"):
            continue
        node, body = dev / entry.name, _resolved(entry / "device") or entry
        found.append(CaptureDevice(stable.get(node, node), node, _text(entry / "name"), body, int(_text(entry / "index") or 0)))
    return sorted(found, key=lambda f: str(f.path))


def find(text: str, there: list[CaptureDevice]) -> Path | None:
    """Return the path that `text` means: itself if it is a path, else the one camera whose stable name or card contains it.

    If a camera has several nodes (many have one for frames and one for metadata) the first is returned.
    The result is None if there is no such camera at the moment.

    Raises:
        BadInput: more than one camera matches.
    """
    if "/" in text:
        path = Path(text)
        return path if path.exists() else None
    matches = [f for f in there if text.lower() in f.path.name.lower() or text.lower() in f.card.lower() or text == f.node.name]
    exact = [f for f in matches if text in (f.path.name, f.node.name)]
    matches = sorted(exact or matches, key=lambda f: f.index)
    if len({f.body for f in matches}) > 1:
        raise BadInput(f"camera {text!r} may be any of {', '.join(str(f.path) for f in matches)}; give more of its name")
    return matches[0].path if matches else None


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def _resolved(link: Path) -> Path | None:
    try:
        return link.resolve(strict=True)
    except OSError:
        return None


def _text(file: Path) -> str:
    try:
        return file.read_text().strip()
    except OSError:
        return ""
