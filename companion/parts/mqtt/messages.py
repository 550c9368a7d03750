"""The topics `decklander/v2/<drone>/...`, and their messages: one immutable struct each, JSON (UTF-8, SI units and radians).

A fleet shares a broker; the version in the topics changes when a meaning does. Times are `*_ns`: nanoseconds of the drone's
monotonic clock, comparable within one `session` (one run of the service). What a flight reports has the fields that recordings
have (`companion.facts`); unknown values are null or left out.
"""

import json
import re
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta, Struct

from companion.facts.records import BeliefRecord, DecisionRecord, DetectionRecord, FusionRecord, HealthRecord, StatusRecord
from companion.facts.wire import read

ROOT = "decklander/v2"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,64}")
EventKind = Literal["service", "phase", "vehicle", "pad", "part", "command", "limit"]
EventData = dict[str, str | float | bool | None]
CommandId = Annotated[str, Meta(min_length=1, max_length=64)]


class Topics(Struct, frozen=True):
    """The subtree of one drone.

    Raises:
        ValueError: a name that is not 1 to 64 letters, digits, - and _.
    """

    drone: str

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.drone):
            raise ValueError(f"not a name of a drone: {self.drone!r}")

    def of(self, leaf: str) -> str:
        """Return the topic of a leaf of `PUBLISHED`, or of `command` or `vessel`, to which the drone subscribes."""
        return f"{ROOT}/{self.drone}/{leaf}"

    def allows_reply(self, topic: str) -> bool:
        """Return whether `topic` is `reply` or one name below it: no sender can make us publish an answer elsewhere."""
        below = topic.removeprefix(self.of("reply") + "/")
        return topic == self.of("reply") or (below != topic and _NAME.fullmatch(below) is not None)


def split(topic: str) -> tuple[str, str] | None:
    """Return (drone, leaf) of a topic of ours, or None for any other."""
    parts = topic.split("/", 3)
    if len(parts) != 4 or "/".join(parts[:2]) != ROOT or not _NAME.fullmatch(parts[2]):
        return None
    return parts[2], parts[3]


class Message(Struct, frozen=True, kw_only=True):
    """The fields that every message from the drone has."""

    session: str
    """Identifier of one run of the service."""
    at_ns: int
    """Instant that the content describes, ns."""


class StatusMessage(Message, frozen=True, kw_only=True):
    """Retained. Whether the service is online; the last will publishes `online: false` when it is not."""

    online: bool
    reason: Literal["up", "stopped", "lost"]
    version: str
    started_unix_s: float
    """Unix time of `started_ns`, s, to date the times of this session."""
    started_ns: int


class StateMessage(Message, frozen=True, kw_only=True):
    """The newest guidance cycle."""

    decision: DecisionRecord
    belief: BeliefRecord | None
    """The estimate that steered."""
    shadows: tuple[BeliefRecord, ...]
    """Estimates of the paths that do not steer."""
    vehicle: StatusRecord | None


class SightingMessage(Message, frozen=True, kw_only=True):
    """The newest frame and its result. `at_ns` is the instant when vision finished the frame."""

    detection: DetectionRecord


class SourceReport(Struct, frozen=True, kw_only=True):
    """The estimator's newest result for one source of measurements on one path, and the counts so far."""

    newest: FusionRecord
    nis_mean: float | None
    """Recent mean of NIS divided by the number of components; it is 1 when the covariance is consistent."""
    verdicts: dict[str, int]
    """Number of measurements so far by verdict."""


class FusionMessage(Message, frozen=True, kw_only=True):
    """The estimator's results for each path and source of measurements."""

    sources: tuple[SourceReport, ...]


class HealthMessage(Message, frozen=True, kw_only=True):
    """Health of the service."""

    health: HealthRecord


class EventMessage(Message, frozen=True, kw_only=True):
    """An event that happened once.

    `id` is globally unique and the same in every delivery. `sequence` counts without a gap within one `spool`, so that a consumer
    sees what was dropped.
    """

    id: str
    spool: str
    sequence: int
    kind: EventKind
    text: str
    """Description of the event in English."""
    data: EventData


class OperatorNotice(Message, frozen=True, kw_only=True):
    """Retained. What senders of commands have to know; an access list hides it from all others."""

    run: str
    """Identifier of this run of the service, used only in commands and the ship's reports: 128 random bits."""
    commands: Literal["signed", "broker"]
    """True if commands must be signed, or the broker controls who may send them."""


class OperatorCommand(Struct, frozen=True, kw_only=True, tag_field="command", forbid_unknown_fields=True):
    """The fields that every command has."""

    id: CommandId
    """Identifier chosen by the sender; a repeated command is answered again but executed once."""
    run: Annotated[str, Meta(max_length=64)]
    """The run that the topic `operator` names; a command for an earlier run is refused."""
    expires_ns: int
    """Expiry on the drone's clock, ns: the newest `at_ns` received plus the time that the command may take to arrive."""
    given_ns: int | None = None
    """Time at which it was given on the drone's clock, ns: the newest `at_ns` received plus the time since its arrival."""
    reply_to: str | None = None
    """Topic of the reply: `decklander/v2/<drone>/reply` (the default) or a topic one level below it."""


class TakingCommand(OperatorCommand, frozen=True, kw_only=True):
    """The fields of a command that takes the vehicle: it is refused if something stopped the vehicle after `given_ns`."""

    given_ns: int


class BeginCommand(TakingCommand, frozen=True, kw_only=True, tag="begin"):
    """Begin or resume the approach."""


class StayCommand(TakingCommand, frozen=True, kw_only=True, tag="stay"):
    """Fly over the pad, and wait there until `begin`."""


class HoldCommand(OperatorCommand, frozen=True, kw_only=True, tag="hold"):
    """Hover until `begin`."""


class AbortCommand(OperatorCommand, frozen=True, kw_only=True, tag="abort"):
    """Hover and end the approach."""


class SetRecordingCommand(OperatorCommand, frozen=True, kw_only=True, tag="record"):
    """Switch recording on or off."""

    on: bool


class ShipReport(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ship's report of her place, to the drone. Angles are degrees; speed and course need each other."""

    run: Annotated[str, Meta(max_length=64)]
    """The run that the topic `operator` names; a report for an earlier run is refused."""
    at_ns: Annotated[int, Meta(ge=0)]
    """Instant for which it is true, on the drone's clock, ns: the newest `at_ns` received plus the time since its arrival."""
    latitude_deg: Annotated[float, Meta(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[float, Meta(ge=-360.0, le=360.0)]
    height_m: Annotated[float, Meta(ge=-1000.0, le=20_000.0)] | None = None
    """Height of the same point above mean sea level."""
    sigma_m: Annotated[float, Meta(ge=0.01, le=1000.0)] = 5.0
    """Standard deviation of the place on each horizontal axis."""
    speed_m_s: Annotated[float, Meta(ge=0.0, le=100.0)] | None = None
    """Speed over the ground; it needs the course."""
    course_deg: Annotated[float, Meta(ge=0.0, le=360.0)] | None = None
    """Direction of the speed, clockwise from true north."""
    heading_deg: Annotated[float, Meta(ge=0.0, le=360.0)] | None = None
    """Heading of the bow, clockwise from true north."""

    def __post_init__(self) -> None:
        if (self.speed_m_s is None) != (self.course_deg is None):
            raise ValueError("speed_m_s and course_deg need each other")


PlainCommand = BeginCommand | StayCommand | HoldCommand | AbortCommand
"""The commands without fields of their own; each has the word of its order."""
Command = PlainCommand | SetRecordingCommand

Refusal = Literal[
    "malformed",
    "too_long",
    "unsigned",
    "bad_signature",
    "retained",
    "other_run",
    "expired",
    "expiry_too_far",
    "reply_elsewhere",
    "not_possible",
]


class CommandReply(Message, frozen=True, kw_only=True):
    """The answer to a command."""

    id: str | None
    """Identifier of the command; null if it could not be read."""
    accepted: bool
    reason: Refusal | None
    text: str
    """Description of the result in English."""


PUBLISHED: dict[str, type[Message]] = {
    "status": StatusMessage,
    "state": StateMessage,
    "sighting": SightingMessage,
    "fusion": FusionMessage,
    "health": HealthMessage,
    "event": EventMessage,
    "operator": OperatorNotice,
    "reply": CommandReply,
}
"""Last level of the topic to the type of its messages."""

encode = msgspec.json.Encoder().encode
_DECODERS = {leaf: msgspec.json.Decoder(model) for leaf, model in PUBLISHED.items()}


def decode(leaf: str, payload: bytes) -> Message | None:
    """Return the decoded message of the drone, or None if the payload does not fit the topic `leaf`."""
    decoder = _DECODERS.get(leaf.partition("/")[0])
    if decoder is None:
        return None
    found = read(decoder, payload)
    return None if isinstance(found, str) else found


def schema() -> str:
    """Return the JSON Schema of every message under `$defs`, with one property per line."""
    models = (*PUBLISHED.values(), *get_args(Command), ShipReport)
    _, definitions = msgspec.json.schema_components(models, ref_template="#/$defs/{name}")
    whole = []
    for name, definition in sorted(definitions.items()):
        lines = []
        for key, value in definition.items():
            if key == "properties":
                inner = ",\n".join(f"    {json.dumps(k)}: {json.dumps(v, ensure_ascii=False)}" for k, v in value.items())
                lines.append(f'   "properties": {{\n{inner}}}')
            elif key != "title":
                lines.append(f"   {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}")
        whole.append(f"  {json.dumps(name)}: {{\n" + ",\n".join(lines) + "}")
    draft = "https://json-schema.org/draft/2020-12/schema"
    return f'{{"$schema": "{draft}",\n "$defs": {{\n' + ",\n".join(whole) + "}}\n"
