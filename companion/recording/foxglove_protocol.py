"""Foxglove's websocket protocol as a server speaks it: texts are JSON objects with a key `op`, data is binary.

Only what a server of live data needs: no parameters, services or publishing by clients, which the server's own capabilities
say. Source: github.com/foxglove/ws-protocol, docs/spec.md, version 1; `foxglove.sdk.v1` is the newer name of the same.
"""

import json
import struct
from collections.abc import Sequence
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from companion.facts.wire import read
from companion.recording.channels import TOPICS, json_schema, schema_name

SUBPROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
TEXT_MAX = 65_536
"""The longest text of a client, bytes: a subscription to every channel has a twentieth of it."""
INFO, WARNING, ERROR = 0, 1, 2
MESSAGE = struct.Struct("<BIQ")
MESSAGE_DATA = 1
Id = Annotated[int, Meta(ge=0, le=2**32 - 1)]
_IDS_MAX = 1000
CHANNELS: dict[int, str] = dict(enumerate(TOPICS, 1))
"""The topic of each channel, by its number."""


class Subscription(Struct, frozen=True):
    """A client's own number for the messages of a channel."""

    id: Id
    channelId: Id  # noqa: N815


class Subscribe(Struct, frozen=True, tag_field="op", tag="subscribe"):
    """A client requests channels."""

    subscriptions: Annotated[list[Subscription], Meta(max_length=_IDS_MAX)]


class Unsubscribe(Struct, frozen=True, tag_field="op", tag="unsubscribe"):
    """A client requests channels no more."""

    subscriptionIds: Annotated[list[Id], Meta(max_length=_IDS_MAX)]  # noqa: N815


Request = Subscribe | Unsubscribe
_requests: msgspec.json.Decoder[Request] = msgspec.json.Decoder(Request)


def request_in(text: str) -> Request | str:
    """Return a client's request, or why it is none."""
    found = read(_requests, text)
    return f"not understood: {found}"[:200] if isinstance(found, str) else found


def server_info(name: str, session: str) -> str:
    """Return the first text to a client: no capabilities beyond channels."""
    return _text(op="serverInfo", name=name, capabilities=[], metadata={}, sessionId=session)


def advertise(topics: Sequence[str]) -> str:
    """Return the text that names the channels of these topics with their schemas."""
    channels = []
    for number, topic in CHANNELS.items():
        if topic in topics:
            name = schema_name(TOPICS[topic])
            schema = json.dumps(json_schema(TOPICS[topic], name), separators=(",", ":"))
            channel = {"id": number, "topic": topic, "encoding": "json", "schemaName": name}
            channels.append(channel | {"schemaEncoding": "jsonschema", "schema": schema})
    return _text(op="advertise", channels=channels)


def status(level: int, message: str) -> str:
    """Return a text for the person at the viewer; `level` is `INFO`, `WARNING` or `ERROR`."""
    return _text(op="status", level=level, message=message)


def message_data(subscription: int, at_ns: int, payload: bytes) -> bytes:
    """Return one message of a channel, with the client's own number for it and its time on the viewer's axis, ns."""
    return MESSAGE.pack(MESSAGE_DATA, subscription, at_ns) + payload


def _text(**fields: object) -> str:
    return json.dumps(fields, separators=(",", ":"))
