"""The messages of the page's websocket: JSON texts both ways, and pictures as binary messages to the page. No I/O."""

import struct
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from companion.base.observer import ThingReport
from companion.facts.records import BeliefRecord, DeckRecord
from companion.facts.wire import FlightState, OrderAnswer, OrderRequest, RequestRefused, SticksRequest, read

TEXT_MAX = 1024
"""The longest message from a browser, characters, unless it brings a settings text."""
SETTINGS_MAX = 60_000
"""The longest settings text from a browser, characters."""
MESSAGE_MAX = 65_536
"""The longest message of all, bytes."""
Level = Literal["info", "warning", "fault"]


class LoginRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="login", forbid_unknown_fields=True):
    """The first message: the token, which no browser sends by itself."""

    token: Annotated[str, Meta(max_length=512)]
    page: Annotated[str, Meta(max_length=64)] = ""
    """Random name of the page, the same over its connections; empty for a sender of orders of its own."""


class DrawnNotice(Struct, frozen=True, kw_only=True, tag_field="kind", tag="drawn", forbid_unknown_fields=True):
    """A picture is on the screen; another one may be sent."""

    number: Annotated[int, Meta(ge=0, le=1 << 53)]


class PictureRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="picture", forbid_unknown_fields=True):
    """Send pictures so from now on; H.264 begins again with a key frame."""

    codec: Literal["jpeg", "h264"]


class RecordingsRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="recordings", forbid_unknown_fields=True):
    """Request for the list of recordings. The answer is a `RecordingList`."""


class DownloadRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="download", forbid_unknown_fields=True):
    """Request for the address of a recording. The answer is a `DownloadAnswer`."""

    name: Annotated[str, Meta(max_length=205)]


class ReportRequest(Struct, frozen=True, kw_only=True, tag_field="kind", tag="report", forbid_unknown_fields=True):
    """Make the report of a recording. It is answered by a `ReportAnswer` at once, and by another one with the address."""

    name: Annotated[str, Meta(max_length=205)]


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
    rows: Annotated[int, Meta(ge=3, le=40)] = 10
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


ToolRequest = (
    ExamineRequest
    | SettingsRequest
    | SaveSettingsRequest
    | CalibrationRequest
    | RecordingsRequest
    | DownloadRequest
    | ReportRequest
)
PageRequest = LoginRequest | OrderRequest | SticksRequest | DrawnNotice | PictureRequest | ToolRequest


class PageWelcome(Struct, frozen=True, kw_only=True, tag_field="kind", tag="welcome"):
    """The answer to the right token: what does not change while the service runs."""

    you: str
    run: str
    """Name of this run of the service: another one after a restart."""
    vehicle: str
    camera_px: tuple[int, int]
    h264: bool
    """True if images are sent as H.264 to browsers that request it."""
    pad_lines_m: tuple[tuple[tuple[float, float], ...], ...]
    """The pad's drawing: lines of points along the arrow and to starboard of it, metres."""
    pad_radius_m: float
    words: dict[str, dict[str, str]]
    """See `companion.base.orders.WORDS`."""


class PageState(FlightState, frozen=True, kw_only=True, tag_field="kind", tag="state"):
    """The state of the flight for the page, several times a second."""

    at_s: float
    """Time since the service began, s."""
    advice: str
    """Advice for a person on the mission's newest change; empty if there is nothing to do."""
    landing: bool
    belief: BeliefRecord | None
    """The steering estimate, without its details; null where its place is not known."""
    deck: DeckRecord | None
    things: tuple[ThingReport, ...]
    """Objects on the pad and about it in the newest frame."""
    roll_rad: float | None
    pitch_rad: float | None
    refusals: dict[str, str | None]
    """Reason why each order would be refused now; null for one that would be carried out."""
    picture_delay_s: float | None
    """Time from the exposure of a picture until this browser has drawn it and confirmed it, s."""


class HealthCause(Struct, frozen=True, kw_only=True):
    """One thing that is not as it should be."""

    level: Level
    text: str


class PageHealth(Struct, frozen=True, kw_only=True, tag_field="kind", tag="health"):
    """The health of the service, once a second."""

    causes: tuple[HealthCause, ...]
    """Causes of trouble, the worst first; empty if there are none."""
    figures: tuple[tuple[str, str], ...]


class PageEvent(Struct, frozen=True, kw_only=True, tag_field="kind", tag="event"):
    """Something that happened once: a change of the mission's state, or an order with its answer."""

    at_s: float
    level: Level
    text: str
    advice: str = ""
    """Advice for a person; empty if there is nothing to do."""


class RecordingFile(Struct, frozen=True, kw_only=True):
    """One recording on the service's disk."""

    name: str
    size_bytes: int
    unix_s: float
    """Time of the last write, wall time."""


class RecordingList(Struct, frozen=True, kw_only=True, tag_field="kind", tag="recordings"):
    """The recordings, the newest first."""

    files: tuple[RecordingFile, ...]
    fault: str
    """Reason why the folder cannot be read; empty if it can."""


class DownloadAnswer(Struct, frozen=True, kw_only=True, tag_field="kind", tag="download"):
    """Address for one download of a recording, valid for a short time; or the reason for none."""

    name: str
    address: str | None
    text: str


class ReportAnswer(DownloadAnswer, frozen=True, kw_only=True, tag_field="kind", tag="report"):
    """Address of a report, as long as it is kept; or its progress, or the reason for none."""


class PictureLine(Struct, frozen=True):
    """A line to draw over the picture."""

    kind: Literal["pad", "seen", "sigma", "ahead"]
    uv_px: tuple[float, ...]
    """Its points in the camera's pixels: u, v, u, v, ..."""


class PictureHeader(Struct, frozen=True, kw_only=True):
    """Header that is sent with a picture."""

    number: int
    verdict: str
    codec: str
    """ "jpeg", "avc1.PPCCLL" of a key frame of H.264, or "" of a frame that follows one."""
    lines: tuple[PictureLine, ...]


ToolAnswer = ExaminedReport | SettingsText | SavedSettings | CalibrationReport | RecordingList | DownloadAnswer | ReportAnswer
ToPage = PageWelcome | PageState | PageHealth | PageEvent | OrderAnswer | RequestRefused | ToolAnswer

_requests: msgspec.json.Decoder[PageRequest] = msgspec.json.Decoder(PageRequest)
_encode = msgspec.json.Encoder().encode


def request_in(text: str) -> PageRequest | str:
    """Return the request in a message, or the reason why it is none. Never raises."""
    found = read(_requests, text)
    too_long = len(text) > TEXT_MAX and not isinstance(found, SaveSettingsRequest | str)
    return f"more than {TEXT_MAX} characters" if too_long else found


def text_of(message: ToPage) -> str:
    """Return a message as the text that the page reads."""
    return _encode(message).decode()


def picture_message(header: PictureHeader, image: bytes) -> bytes:
    """Return a picture's message: the header's length as a little-endian u32, the header as JSON, the encoded image."""
    output = _encode(header)
    return struct.pack("<I", len(output)) + output + image
