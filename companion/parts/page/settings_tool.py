"""The settings on the page: what is in force, a text to edit that is checked as it is typed, and saving it on the ground.

A saved text is read at the next start of the service; nothing of it reaches a flight.
"""

import json
import logging
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from companion.base.observer import ProcessedFrame
from companion.base.worker import Worker
from companion.parts.page.tool_messages import (
    CheckedSettings,
    CheckSettingsRequest,
    SavedSettings,
    SaveSettingsRequest,
    SettingsRequest,
    SettingsText,
    ShownChange,
    ShownFault,
    ToolAnswer,
    ToolRequest,
)
from companion.parts.page.viewer import PageViewer
from companion.settings import whole_file
from companion.settings.draft import Draft, check_draft, masked, unmasked
from companion.settings.expert import split
from companion.settings.model import Settings
from companion.settings.settings_file import BEFORE, SettingsFile
from drivers.mailbox import Line
from estimator.contracts.errors import BadInput, DecklanderError

log = logging.getLogger(__name__)

IN_FLIGHT = "the vehicle flies: settings are checked and saved on the ground"
ARMED = "the motors are armed: settings are saved while they are disarmed"
NO_FILE = "this service was started without a settings file of its own"
AFTERWARDS = "It takes effect when the service starts again (sudo systemctl restart decklander)"
_WAITING = 8


class SettingsTool:
    """See the module's docstring.

    Args:
        in_force: the settings of the running service.
        file: the file that they were read from; None if there is none.
        flying: whether the vehicle flies now.
        armed: whether its motors are armed, as far as it says so.
    """

    kinds: tuple[type, ...] = (SettingsRequest, CheckSettingsRequest, SaveSettingsRequest)

    def __init__(
        self, in_force: Settings, file: SettingsFile | None, flying: Callable[[], bool], armed: Callable[[], bool]
    ) -> None:
        self._in_force = in_force
        self._file = file
        self._flying = flying
        self._armed = armed
        self._asked: Line[tuple[PageViewer, ToolRequest]] = Line(_WAITING)

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        refusal = self._refusal(request)
        if refusal is None:
            self._asked.offer((viewer, request))
        else:
            viewer.tell(refusal)

    def on_frame(self, processed: ProcessedFrame) -> None:
        pass

    async def run(self) -> None:
        worker = Worker("page settings")
        try:
            async for viewer, request in self._asked:
                answer = self._refusal(request)
                if answer is None:
                    answer = await worker.run(self._answer, request, str(viewer.sender))
                viewer.tell(answer)
        finally:
            worker.close()

    def _refusal(self, request: ToolRequest) -> ToolAnswer | None:
        """Return the refusal of what must not be done now."""
        if isinstance(request, CheckSettingsRequest) and self._flying():
            return CheckedSettings(number=request.number, text=IN_FLIGHT)
        if isinstance(request, SaveSettingsRequest) and (self._flying() or self._armed()):
            return SavedSettings(number=request.number, saved=False, text=IN_FLIGHT if self._flying() else ARMED)
        return None

    def _answer(self, request: ToolRequest, who: str) -> ToolAnswer:
        if isinstance(request, CheckSettingsRequest):
            return self._checked(request)
        return self._saved(request, who) if isinstance(request, SaveSettingsRequest) else self._shown()

    def _shown(self) -> SettingsText:
        in_force = masked(whole_file.toml(self._in_force))
        if self._file is None:
            return SettingsText(text=in_force, in_force=in_force, path="", revision="", refusal=NO_FILE)
        try:
            text, revision = self._file.read()
        except DecklanderError as why:
            return SettingsText(text=in_force, in_force=in_force, path=str(self._file.path), revision="", refusal=str(why))
        path, refusal = str(self._file.path), self._file.refusal()
        return SettingsText(text=masked(text), in_force=in_force, path=path, revision=revision, refusal=refusal)

    def _checked(self, request: CheckSettingsRequest) -> CheckedSettings:
        try:
            draft = self._draft(request.text)[1]
        except DecklanderError as why:
            return CheckedSettings(
                number=request.number, text="", faults=(ShownFault(path="", text=masked(str(why)), line=None),)
            )
        faults = tuple(ShownFault(path=one.path, text=masked(one.text), line=one.line) for one in draft.faults)
        changes = tuple(
            ShownChange(path=one.path, before=_shown_value(one.before), after=_shown_value(one.after)) for one in draft.changes
        )
        remarks = tuple(masked(one) for one in draft.remarks)
        return CheckedSettings(number=request.number, text="", faults=faults, changes=changes, remarks=remarks)

    def _saved(self, request: SaveSettingsRequest, who: str) -> SavedSettings:
        try:
            if self._file is None:
                raise BadInput(f"cannot be saved: {NO_FILE}")
            text, draft = self._draft(request.text)
            if draft.faults:
                raise BadInput(f"not saved, as it has {len(draft.faults)} faults: {draft.faults[0].text}")
            revision = self._file.save(text, request.revision)
        except DecklanderError as why:
            return SavedSettings(number=request.number, saved=False, text=masked(str(why)))
        log.warning("settings saved from the page by %s into %s", who, self._file.path)
        kept = f"the one before is {self._file.path.name}{BEFORE}"
        return SavedSettings(number=request.number, saved=True, text=f"Saved; {kept}. {AFTERWARDS}.", revision=revision)

    def _draft(self, text: str) -> tuple[str, Draft]:
        """Return the text with its secrets, and its remarks."""
        whole = whole_file.toml(self._in_force)
        original = whole if self._file is None else self._file.read()[0]
        path = Path("settings.toml") if self._file is None else self._file.path
        restored = unmasked(text, original)
        before = _mapping(original) or split(msgspec.to_builtins(self._in_force))
        return restored, check_draft(restored, path, before, self._in_force)


def _mapping(text: str) -> Mapping[str, Any] | None:
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError):
        return None


def _shown_value(value: object) -> str:
    return "" if value is None else masked(json.dumps(value, ensure_ascii=False))
