"""The settings on the page: what is in force, and a text that replaces the settings file while the vehicle stands disarmed.

A text is checked as `decklander config check` checks a file, and read at the next start of the service; nothing of it reaches a
flight. A browser with the page's token commands the vehicle. That must not grow into reading other files of the computer, writing
into other folders, sending a password to another host or giving others rights at the next start: only the keys that are declared
for it are changed (`estimator.contracts.keys`).
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
_WAITING = 8  # requests that may wait
_FOLDER = re.compile(r"[/\\]")


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
        notes = "".join(f" {line}." for line in remarks(checked))
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
        _refuse_unmarked(settings, before, file)
        settings = complete(settings, file.path)
        check_files(settings)
    except BadInput as why:
        raise BadInput(str(why).removeprefix(": ").removeprefix(f"{file.path}: ")) from why
    return settings


def _refuse_unmarked(settings: Settings, before: str, file: SettingsFile) -> None:
    """Refuse a change of a key that is not declared for the page, and a name with a folder in it, before any file is read."""
    try:
        old = _flat(msgspec.to_builtins(from_file(toml_of(before, file.path), ""), enc_hook=raw))
    except BadInput as why:
        raise BadInput(f"the settings file itself is refused ({why}): mend it on the drone's computer first") from why
    new = _flat(msgspec.to_builtins(settings, enc_hook=raw))
    allowed = schema.on_page(new["vehicle.kind"])
    for path in dict.fromkeys((*old, *new)):
        has = new.get(path)
        if old.get(path) == has:
            continue
        if path not in allowed:
            raise BadInput(f"{in_file(path)} is not changed from a browser: set it in the file on the drone's computer")
        if isinstance(has, str) and _FOLDER.search(has):
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
