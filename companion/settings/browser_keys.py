"""What settings from a browser may not change: who may command, where secrets are and go, and files outside the settings' folder.

Whoever has the page's token commands the vehicle. That must not grow into reading other files of the computer, writing into
other folders, or sending a password to another host at the next start.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from companion.settings.expert import in_file
from companion.settings.load import from_file
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput

GUARDED = (
    "page", "metrics", "foxglove", "mqtt", "bridge", "recorder.folder", "operator.socket", "vehicle.operators",
    "vehicle.signing_key_file", "vehicle.signing_time_file", "vehicle.unsigned", "vehicle.links",
)  # fmt: skip
"""Keys and tables that keep the value that they have."""
REFERENCES = ("camera.file", "camera.device", "pad.file", "guidance.follow_deck.response", "operator.gamepad")
"""Keys that name a shipped file, or one in the folder of the settings or below it."""
_NAME = re.compile(r"[\w-]*")


def refused_values(settings: Settings, before: Mapping[str, Any]) -> Iterator[str]:
    """Yield a line for each guarded key that differs from the settings before, which count as good if they can be read."""
    try:
        old = msgspec.to_builtins(from_file(before, ""))
    except BadInput as why:
        yield f"the settings file itself is refused ({why}): mend it on the drone's computer first"
        return
    new = msgspec.to_builtins(settings)
    for path in GUARDED:
        had, has = _at(old, path), _at(new, path)
        changed = [path]
        if isinstance(had, Mapping) and isinstance(has, Mapping):
            changed = [f"{path}.{name}" for name in has if has[name] != had.get(name)]
        elif had == has:
            continue
        for key in changed:
            shown = in_file(key)
            yield f"{shown} is not changed from a browser: who may command, and where secrets go, is set on the drone itself"


def refused_references(data: Mapping[str, Any], before: Mapping[str, Any], folder: Path) -> Iterator[str]:
    """Yield a line for each key that names a file elsewhere. It reads none of them."""
    cameras = [(_at(settings, "camera.source"), _at(settings, "camera.device")) for settings in (data, before)]
    if cameras[0] != cameras[1] and cameras[0][0] == "gstreamer":
        yield "camera.device is not changed from a browser: a pipeline may read and write any file; set it on the drone itself"
    for path in REFERENCES:
        name = _at(data, path)
        if not isinstance(name, str) or _NAME.fullmatch(name):
            continue
        if path == "camera.device":
            if cameras[0] == cameras[1] or not _is_file(data):
                continue
        elif name == _at(before, path):
            continue
        if not _inside(name, folder):
            yield f"{path}: from a browser only a shipped name or a file beside the settings may be named, found {name[:60]!r}"


def _is_file(data: Mapping[str, Any]) -> bool:
    device = str(_at(data, "camera.device"))
    if _at(data, "camera.source") == "stream":
        return not re.match(r"(rtsps?|https?|udp|tcp)://", device)
    return device.startswith("/") and not device.startswith("/dev/")


def _inside(name: str, folder: Path) -> bool:
    if ":" in name:  # an address, whatever a folder of that name would be
        return False
    try:
        return not Path(name).is_absolute() and (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):
        return False


def _at(data: object, path: str) -> object:
    for name in path.split("."):
        data = data.get(name) if isinstance(data, Mapping) else None
    return data
