"""Check a settings text before anybody saves it: every fault with its line, and what it would change.

It is read by the code of `decklander config check`, which stops at the first fault. Here a key that is refused takes the value
that it has in the settings before, and the text is read again, so that a person sees all faults at once.
"""

import copy
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from companion.settings.effect import without_effect
from companion.settings.expert import in_file
from companion.settings.load import complete, from_file
from companion.settings.model import Settings
from companion.settings.referenced_files import check_files
from companion.settings.ship_place import contradiction
from estimator.contracts.errors import BadInput

# Hide what is secret in addresses within a settings text: the user's part of one, and query values that are named like a
# secret.
#
#     text = masked('device = "rtsp://admin:hunter2@10.0.0.8/stream"')     # device = "rtsp://***@10.0.0.8/stream"
#     unmasked(text, original)                                            # as it was
#
# All other secrets are in files of their own, which settings only name.

MASK = "***"
_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:(?://|\\/\\/)[^\s\"']+")
_USER = re.compile(r"^([^:]+:[/\\]+).*@")
_VALUE = re.compile(r"([?&;][\w.-]*(?:pass|pwd|token|key|secret|auth|user)[\w.-]*=)[^&;#]*", re.IGNORECASE)


def masked(text: str) -> str:
    """Return the text with the secrets of its addresses hidden."""
    return _ADDRESS.sub(lambda found: _masked(found[0]), text)


def unmasked(text: str, original: str) -> str:
    """Return the text with each masked address as the original has it.

    Raises:
        BadInput: a masked address is none of the original's: it was changed, so its secret would go elsewhere.
    """
    known: dict[str, set[str]] = {}
    for found in _ADDRESS.finditer(original):
        known.setdefault(_masked(found[0]), set()).add(found[0])

    def restored(found: re.Match[str]) -> str:
        address = found[0]
        if MASK not in address:
            return address
        meant = known.get(address, set())
        if len(meant) != 1:
            raise BadInput(f"{address}: the address was changed, so write its user and password again in place of {MASK}")
        return next(iter(meant))

    return _ADDRESS.sub(restored, text)


def _masked(address: str) -> str:
    return _VALUE.sub(rf"\1{MASK}", _USER.sub(rf"\1{MASK}@", address))


# What settings from a browser may not change: who may command, where secrets are and go, and files outside the settings'
# folder.
#
# Whoever has the page's token commands the vehicle. That must not grow into reading other files of the computer, writing into
# other folders, or sending a password to another host at the next start.

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


_FAULTS = 20
_PATH = re.compile(r"(?:the table \[)?([A-Za-z_][\w-]*(?:\.[\w-]+)*)")
_TOML_LINE = re.compile(r"\(at line (\d+)")


@dataclass(frozen=True, slots=True)
class DraftFault:
    """One reason why a text cannot be saved."""

    path: str
    """The key's dotted path; empty for a fault of the whole text."""
    text: str
    line: int | None
    """The line of the text, from 1; None if the key is not in it."""


@dataclass(frozen=True, slots=True)
class DraftChange:
    """A key whose value differs; None where it has no such key."""

    path: str
    before: object
    after: object


@dataclass(frozen=True, slots=True)
class Draft:
    """Result of checking a settings text."""

    faults: tuple[DraftFault, ...]
    changes: tuple[DraftChange, ...] = ()
    """Differences from the settings in force."""
    remarks: tuple[str, ...] = ()
    """Keys without effect, and what hardly is meant."""


def check_draft(text: str, path: Path, before: Mapping[str, Any], in_force: Settings) -> Draft:
    """Return every fault of a settings text, or what it would change.

    Args:
        path: where the text would be saved; references in it are relative to its folder.
        before: the mapping of the settings that it replaces.
        in_force: the settings of the running service.
    """
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as why:  # a number of thousands of digits is a plain ValueError
        found = _TOML_LINE.search(str(why))
        return Draft((DraftFault("", f"not valid TOML: {why}", int(found[1]) if found else None),))
    faults, settings = _every_fault(data, before)
    if settings is not None and (clash := settings.fault()):
        faults.append(clash)
    if settings is not None:
        faults += refused_values(settings, before)
    faults += refused_references(data, before, path.parent)
    if settings is not None and not faults:
        try:
            settings = complete(settings, path)
            check_files(settings)
        except BadInput as why:
            faults.append(str(why).removeprefix(f"{path}: "))
    if faults or settings is None:
        return Draft(tuple(_fault(why, text) for why in faults[:_FAULTS]))
    alert = contradiction(settings)
    remarks = (*without_effect(settings), *(() if alert is None else (f"{alert.what}: {alert.fix}",)))
    return Draft((), _changes(in_force, settings), remarks)


def _every_fault(data: dict[str, Any], before: Mapping[str, Any]) -> tuple[list[str], Settings | None]:
    """Return the faults of the keys' names and values, and the settings if there are none."""
    faults: list[str] = []
    tried, settings = copy.deepcopy(data), None
    seen: set[str] = set()
    while len(faults) < _FAULTS:
        try:
            settings = from_file(tried, "")
            break
        except BadInput as why:
            output = str(why).removeprefix(": ")
        faults.append(output)
        path = _path_of(output)
        if not path or path in seen:
            break
        seen.add(path)
        if not _replaced(tried, path, before):
            break
    return faults, None if faults else settings


def _replaced(data: dict[str, Any], path: str, before: Mapping[str, Any]) -> bool:
    """Give a key the value that it has in `before`, or take it out; return whether anything changed."""
    *tables, last = path.split(".")
    inner: Any = data
    old: Any = before
    for name in tables:
        inner = inner.get(name) if isinstance(inner, dict) else None
        old = old.get(name) if isinstance(old, Mapping) else None
    if not isinstance(inner, dict):
        return False
    if isinstance(old, Mapping) and last in old and old[last] != inner.get(last):
        inner[last] = copy.deepcopy(old[last])
        return True
    return inner.pop(last, None) is not None


def _path_of(said: str) -> str:
    found = _PATH.match(said)
    return found[1] if found else ""


def _fault(said: str, text: str) -> DraftFault:
    path = _path_of(said)
    return DraftFault(path, said, line_of(text, path))


def line_of(text: str, path: str) -> int | None:
    """Return the line, from 1, on which a key or a table begins in a TOML text; None if it is written in another way."""
    table = ""
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            table = header[1]
            if table == path:
                return number
        elif (key := re.match(r"\s*([\w.-]+)\s*=", line)) and ".".join(filter(None, (table, key[1]))) == path:
            return number
    return None


def _changes(before: Settings, after: Settings) -> tuple[DraftChange, ...]:
    old, new = _flat(msgspec.to_builtins(before)), _flat(msgspec.to_builtins(after))
    return tuple(
        DraftChange(path, old.get(path), new.get(path)) for path in dict.fromkeys((*old, *new)) if old.get(path) != new.get(path)
    )


def _flat(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in data.items():
        if isinstance(value, Mapping):
            out |= _flat(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = value
    return out
