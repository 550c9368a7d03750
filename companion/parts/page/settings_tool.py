"""The settings on the page: what is in force, and a text that replaces the settings file while the vehicle stands disarmed.

A text is checked as `decklander config check` checks a file, and read at the next start of the service; nothing of it reaches a
flight. Whoever has the page's token commands the vehicle. That must not grow into reading other files of the computer, writing
into other folders, or sending a password to another host at the next start.
"""

import logging
import re
from collections.abc import Mapping
from contextlib import closing
from typing import Any

import msgspec

from companion.base.worker import Worker
from companion.parts.page.messages import SavedSettings, SaveSettingsRequest, SettingsRequest, SettingsText, ToolRequest
from companion.parts.page.viewer import PageService, PageViewer, Tool
from companion.settings import schema
from companion.settings.load import complete, from_file, toml_of
from companion.settings.model import Settings, in_file
from companion.settings.referenced_files import check_files
from companion.settings.remarks import remarks
from companion.settings.settings_file import BEFORE, SettingsFile
from drivers.mailbox import Line
from estimator.contracts.address import ADDRESS, MASK, guarded, masked, raw
from estimator.contracts.errors import BadInput, DecklanderError

log = logging.getLogger(__name__)

IN_FLIGHT = "the vehicle flies: settings are saved on the ground"
ARMED = "the motors are armed: settings are saved while they are disarmed"
NO_FILE = "this service was started without a settings file of its own"
AFTERWARDS = "It takes effect when the service starts again (sudo systemctl restart decklander)"
_WAITING = 8

GUARDED = (
    "http", "mqtt", "bridge", "recorder.folder", "operator.socket", "vehicle.operators",
    "vehicle.signing_key_file", "vehicle.signing_time_file", "vehicle.unsigned", "vehicle.links",
)  # fmt: skip
"""Keys and tables that a browser does not change: who may command, where secrets are and go, and where files are written."""
_NO_PATH = re.compile(r"[^/\\]*|/dev/[\w/-]+|(?:rtsps?|https?|udp|tcp)://\S+")
"""A changed text may name what is shipped, a file beside the settings, a device or a stream."""


class SettingsTool(Tool):
    """See the module's docstring."""

    kinds = (SettingsRequest, SaveSettingsRequest)

    def __init__(self, service: PageService) -> None:
        self._service = service
        self._file = service.settings_file
        self._asked: Line[tuple[PageViewer, ToolRequest]] = Line(_WAITING)

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        self._asked.offer((viewer, request))

    async def run(self) -> None:
        with closing(Worker("page settings")) as worker:
            async for viewer, request in self._asked:
                if not isinstance(request, SaveSettingsRequest):
                    viewer.tell(await worker.run(self._shown))
                elif self._service.flying or self._service.armed:
                    viewer.tell(SavedSettings(saved=False, text=IN_FLIGHT if self._service.flying else ARMED))
                else:
                    viewer.tell(await worker.run(self._saved, request, str(viewer.sender)))

    def _shown(self) -> SettingsText:
        in_force = masked(schema.toml(self._service.settings))
        if self._file is None:
            return SettingsText(text=in_force, in_force=in_force, path="", revision="", refusal=NO_FILE)
        path = str(self._file.path)
        try:
            text, revision = self._file.read()
        except DecklanderError as why:
            return SettingsText(text=in_force, in_force=in_force, path=path, revision="", refusal=str(why))
        return SettingsText(text=masked(text), in_force=in_force, path=path, revision=revision, refusal=self._file.refusal())

    def _saved(self, request: SaveSettingsRequest, who: str) -> SavedSettings:
        try:
            if self._file is None:
                raise BadInput(f"cannot be saved: {NO_FILE}")
            before = self._file.read()[0]
            text = unmasked(request.text, before)
            checked = check(text, before, self._file)
            revision = self._file.save(text, request.revision)
        except DecklanderError as why:
            words = str(why)
            return SavedSettings(saved=False, text=f"Not saved: {masked(words)}", line=line_of(request.text, words))
        log.warning("settings saved from the page by %s into %s", who, self._file.path)
        kept = f"the one before is {self._file.path.name}{BEFORE}"
        notes = "".join(f" {line}." for line in remarks(checked, self._file.path))
        return SavedSettings(saved=True, text=f"Saved; {kept}. {AFTERWARDS}.{masked(notes)}", revision=revision)


def check(text: str, before: str, file: SettingsFile) -> Settings:
    """Return the settings of a text from a browser.

    Args:
        before: the text that it replaces.
        file: where it would be saved; references in it are relative to its folder.

    Raises:
        BadInput: `decklander config check` would refuse it, or it changes what a browser must not change.
    """
    try:
        settings = from_file(toml_of(text, file.path), "")
        _refuse_guarded(settings, before, file)
        settings = complete(settings, file.path)
        check_files(settings)
    except BadInput as why:
        raise BadInput(str(why).removeprefix(": ").removeprefix(f"{file.path}: ")) from why
    return settings


def _refuse_guarded(settings: Settings, before: str, file: SettingsFile) -> None:
    """Refuse changes of who may command and of where secrets go, and names of files elsewhere. It reads none of them."""
    try:
        old = _flat(msgspec.to_builtins(from_file(toml_of(before, file.path), ""), enc_hook=raw))
    except BadInput as why:
        raise BadInput(f"the settings file itself is refused ({why}): mend it on the drone's computer first") from why
    new = _flat(msgspec.to_builtins(settings, enc_hook=raw))
    if old.get("camera.source") != new.get("camera.source"):
        del old["camera.device"]  # what names no file for one kind of camera may name one for another
    for path in dict.fromkeys((*old, *new)):
        had, has = old.get(path), new.get(path)
        if had == has:
            continue
        if any(f"{path}.".startswith(f"{guarded}.") for guarded in GUARDED):
            raise BadInput(
                f"{in_file(path)} is not changed from a browser: who may command, and where secrets go, is set on the drone"
            )
        pipeline = path == "camera.device" and new["camera.source"] == "gstreamer"
        if isinstance(has, str) and (pipeline or not _NO_PATH.fullmatch(has)):
            raise BadInput(
                f"{in_file(path)}: from a browser only what is shipped or lies beside the settings is named: {guarded(has)!r:.50}"
            )


def _flat(data: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name, value in data.items():
        out |= _flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {prefix + name: value}
    return out


def unmasked(text: str, original: str) -> str:
    """Return the text with each masked address as the original has it.

    Raises:
        BadInput: a masked address is none of the original's: it was changed, so its secret would go elsewhere.
    """
    known: dict[str, set[str]] = {}
    for found in ADDRESS.finditer(original):
        known.setdefault(masked(found[0]), set()).add(found[0])

    def restored(found: re.Match[str]) -> str:
        address = found[0]
        if MASK not in address:
            return address
        meant = known.get(address, set())
        if len(meant) != 1:
            raise BadInput(f"{address}: the address was changed, so write its user and password again in place of {MASK}")
        return next(iter(meant))

    return ADDRESS.sub(restored, text)


def line_of(text: str, refusal: str) -> int | None:
    """Return the line, from 1, of a TOML text that a refusal is about; None if the key is not in it or written in another way."""
    if at := re.search(r"\(at line (\d+)", refusal):
        return int(at[1])
    path, table = re.match(r"(?:the table \[)?([\w.-]*)", refusal), ""
    for number, line in enumerate(text.splitlines(), 1):
        key = re.match(r"\s*(?:\[\s*([\w.-]+)\s*\]|([\w.-]+)\s*=)", line)
        if key is None:
            continue
        table = key[1] or table
        if path is not None and ".".join(filter(None, (table, key[2]))) == path[1]:
            return number
    return None
