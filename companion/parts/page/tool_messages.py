"""The messages of the page's tools: requests of browsers, and answers. No I/O."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

SETTINGS_MAX = 60_000
"""The longest settings text from a browser, characters."""


class ExamineRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="examine", forbid_unknown_fields=True):
    """Examine the setup as `decklander doctor` does. It is answered by an `ExaminedReport`, at once and at the end."""


class PageFinding(Struct, frozen=True, kw_only=True):
    """One fault of the setup."""

    rule: str
    severity: str
    """error, warning or advice."""
    what: str
    fix: str


class ExaminedReport(Struct, frozen=True, kw_only=True, tag_field="kind", tag="examined"):
    """The findings of an examination, the most severe first; or that it is under way, or why there is none."""

    text: str
    busy: bool = False
    """True if the examination is still under way."""
    findings: tuple[PageFinding, ...] | None = None
    """None if nothing was examined."""


class SettingsRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="settings", forbid_unknown_fields=True):
    """Show the settings. It is answered by a `SettingsText`."""


class SaveSettingsRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="save_settings", forbid_unknown_fields=True):
    """Save this text as the settings file. It is answered by a `SavedSettings`."""

    text: Annotated[str, Meta(max_length=SETTINGS_MAX)]
    revision: Annotated[str, Meta(max_length=64)]
    """Revision of the text that was edited."""


class SettingsText(Struct, frozen=True, kw_only=True, tag_field="kind", tag="settings"):
    """The settings, with the secrets of addresses hidden."""

    text: str
    """The settings file."""
    in_force: str
    """The settings of the running service with every default."""
    path: str
    """The file's name; empty if there is no file."""
    revision: str
    refusal: str
    """Reason why the text cannot be saved here; empty if it can."""


class SavedSettings(Struct, frozen=True, kw_only=True, tag_field="kind", tag="saved"):
    """Result of saving a text."""

    saved: bool
    text: str
    """Next step, or the reason why the text was not saved."""
    line: int | None = None
    """The line of the text that is wrong; null if it is no single one."""
    revision: str = ""


class CalibrationRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="calibration", forbid_unknown_fields=True):
    """Begin or end a calibration of the camera, or save what came of it. It is answered by `CalibrationReport`s."""

    action: Literal["begin", "end", "save"]
    board: Literal["charuco", "chessboard"] = "charuco"
    columns: Annotated[int, Meta(ge=3, le=40)] = 7
    """Squares across."""
    rows: Annotated[int, Meta(ge=3, le=40)] = 10
    """Squares down."""
    square_mm: Annotated[float, Meta(ge=1.0, le=1000.0)] = 25.0


class CalibrationReport(Struct, frozen=True, kw_only=True, tag_field="kind", tag="calibration"):
    """Progress of a calibration, or the reason for none."""

    active: bool
    text: str
    """Result, or the reason for none; empty if there is nothing to report."""
    images: int = 0
    views: int = 0
    board_seen: bool = False
    cells: tuple[tuple[int, ...], ...] | None = None
    """Corners of the board in each part of the image, rows of columns; None if there is no calibration."""
    lacks: tuple[str, ...] = ()
    rms_px: float | None = None
    grade: str | None = None
    file: str = ""
    """The camera file, once a calibration has ended with one that can be used."""


ToolRequest = ExamineRequest | SettingsRequest | SaveSettingsRequest | CalibrationRequest
ToolAnswer = ExaminedReport | SettingsText | SavedSettings | CalibrationReport
