"""What travels over MQTT: one immutable struct a message, JSON on the wire (UTF-8, numbers in SI and radians).

Times are `*_ns`: nanoseconds of the drone's monotonic clock, comparable within one `session` (one run of the service). What
is not known is null. The JSON Schema in docs/mqtt.md is made from here.
"""

from __future__ import annotations

import json
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from estimator.contracts.estimates import PathName

Vector3 = tuple[float, float, float]
Word = Annotated[str, Meta(min_length=1, max_length=64)]


class Message(Struct, frozen=True, kw_only=True):
    """What every message from the drone begins with."""

    session: str
    """One run of the service."""
    at_ns: int
    """When it was true."""


class StatusMessage(Message, frozen=True, kw_only=True):
    """Retained. Whether the service is there; the last will says `online: false` for it."""

    online: bool
    reason: Literal["up", "stopped", "lost"]
    version: str
    started_unix_s: float
    """Wall time of `started_ns`, to put dates on the times of this session."""
    started_ns: int


class BeliefReport(Struct, frozen=True, kw_only=True):
    """Where the pad is believed to be; axes forward, right, down of the body without roll and pitch."""

    path: str
    d_body_pad_level_m: Vector3
    v_pad_level_m_s: Vector3
    yaw_rad: float | None
    sigma_d_m: Vector3
    sigma_v_m_s: Vector3
    sigma_yaw_rad: float
    sighted_age_s: float
    """Since the newest fused sighting was true."""
    consistent: bool


class CommandReport(Struct, frozen=True, kw_only=True):
    """What guidance asked of the vehicle."""

    kind: Literal["velocity", "hover", "takeoff", "land"]
    v_level_m_s: Vector3 | None = None
    yaw_rate_rad_s: float | None = None


class VehicleState(Struct, frozen=True, kw_only=True):
    """What the vehicle says of itself."""

    mode: str
    flying: bool | None
    battery_fraction: float | None
    emergency: bool
    link_ok: bool
    age_s: float


class StateMessage(Message, frozen=True, kw_only=True):
    """The newest round of guidance."""

    phase: str
    belief: BeliefReport | None
    shadows: tuple[BeliefReport, ...]
    """Beliefs of the paths that do not steer."""
    order: CommandReport | None
    """null while guidance leaves the vehicle to itself."""
    vehicle: VehicleState | None


class MethodReport(Struct, frozen=True, kw_only=True):
    """One method's answer about one frame."""

    d_body_pad_level_m: Vector3
    yaw_rad: float | None
    yaw_ambiguous: bool
    cov: tuple[float, ...]
    """4x4 row-major of [forward, right, down, yaw] in m and rad."""
    confidence: float


class SightingMessage(Message, frozen=True, kw_only=True):
    """The newest frame and what became of it. `at_ns` is when vision had done with it."""

    measured_at_ns: int
    """Mid-exposure."""
    sequence: int
    verdict: str
    chosen: str | None
    """The method that speaks for the frame."""
    selected: MethodReport | None
    methods: dict[str, MethodReport | None]


class SourceReport(Struct, frozen=True, kw_only=True):
    """What the estimator makes of one source of measurements: the newest result and the counts so far."""

    measured_at_ns: int
    verdict: str
    components: tuple[str, ...]
    """Names of the innovation's components, each with its unit."""
    innovation: tuple[float, ...] | None
    """Measured minus predicted; null where nothing was compared."""
    innovation_var: tuple[float, ...] | None
    """Variance of each component that the estimator claims."""
    nis: float | None
    """Normalized innovation squared."""
    test_ratio: float | None
    """NIS over the gate's limit: above 1 the gate refuses."""
    nis_mean: float | None
    """Recent mean of NIS over the number of components: 1 when the covariance is honest."""
    verdicts: dict[str, int]
    """Measurements so far by verdict."""


class FusionMessage(Message, frozen=True, kw_only=True):
    """What each path of the estimator makes of each source of measurements."""

    paths: dict[str, dict[str, SourceReport]]
    """By path, then by source."""


class PartReport(Struct, frozen=True, kw_only=True):
    up: bool
    age_s: float
    restarts: int
    last_error: str


class FlowReport(Struct, frozen=True, kw_only=True):
    count: int
    age_s: float | None
    rate_hz: float | None


class StageReport(Struct, frozen=True, kw_only=True):
    count: int
    p50_s: float | None
    p99_s: float | None


class HealthReport(Message, frozen=True, kw_only=True):
    """How the service is."""

    all_up: bool
    """Every part of the service."""
    flight_up: bool = True
    """The parts that the flight needs; left out by drones that did not tell them apart."""
    parts: dict[str, PartReport]
    flows: dict[str, FlowReport]
    frames: dict[str, int]
    inputs: dict[str, dict[str, int]]
    stages: dict[str, StageReport]
    counters: dict[str, dict[str, float]]


class EventMessage(Message, frozen=True, kw_only=True):
    """Something that happened once. `id` is unique for ever and the same in every delivery; `sequence` counts without a gap
    within one `spool`, so that a consumer sees what was dropped."""

    id: str
    spool: str
    sequence: int
    kind: Literal["service", "phase", "vehicle", "pad", "part", "command"]
    text: str
    """In words."""
    data: dict[str, str | float | bool | None]


class OperatorNotice(Message, frozen=True, kw_only=True):
    """Retained. What whoever commands has to know; an access list keeps it from all others."""

    run: str
    """This run of the service, in commands and nowhere else: 128 random bits."""
    commands: Literal["signed", "broker"]
    """Whether commands are signed, or the broker answers for who may send them."""


class OperatorCommand(Struct, frozen=True, kw_only=True, tag_field="command", forbid_unknown_fields=True):
    """What every command carries."""

    id: Word
    """Chosen by the sender; a repeated one is answered again and not carried out again."""
    run: Annotated[str, Meta(max_length=64)]
    """The run that the topic `operator` names; a command meant for an earlier run is refused."""
    expires_ns: int
    """On the drone's clock: the newest `at_ns` heard plus how long the command may take to arrive."""
    reply_to: str | None = None
    """`decklander/v1/<drone>/reply` (the default) or one name below it."""


class StartCommand(OperatorCommand, frozen=True, kw_only=True, tag="start"):
    """Begin the approach, or go on with it."""


class PauseCommand(OperatorCommand, frozen=True, kw_only=True, tag="pause"):
    """Hover until `start`."""


class AbortCommand(OperatorCommand, frozen=True, kw_only=True, tag="abort"):
    """Hover, and leave it at that."""


class SetPathCommand(OperatorCommand, frozen=True, kw_only=True, tag="path"):
    """Steer by this estimator."""

    path: PathName


class SetRecordingCommand(OperatorCommand, frozen=True, kw_only=True, tag="record"):
    """Recording on or off."""

    on: bool


Command = StartCommand | PauseCommand | AbortCommand | SetPathCommand | SetRecordingCommand

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
    """Of the command; null where it could not be read."""
    accepted: bool
    reason: Refusal | None
    text: str
    """In words."""


PUBLISHED: dict[str, type[Message]] = {
    "status": StatusMessage,
    "state": StateMessage,
    "sighting": SightingMessage,
    "fusion": FusionMessage,
    "health": HealthReport,
    "event": EventMessage,
    "operator": OperatorNotice,
    "reply": CommandReply,
}
"""Last part of the topic to the message that travels there."""

encode = msgspec.json.Encoder().encode


def decode(leaf: str, payload: bytes) -> Message | None:
    """A message of the drone, None when the payload is not one of `leaf`."""
    model = PUBLISHED.get(leaf.partition("/")[0])
    if model is None:
        return None
    try:
        return msgspec.json.decode(payload, type=model)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def schema() -> str:
    """JSON Schema of every message under `$defs`, one property a line."""
    models = (*PUBLISHED.values(), StartCommand, PauseCommand, AbortCommand, SetPathCommand, SetRecordingCommand)
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
