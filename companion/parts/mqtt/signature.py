"""Sign and verify commands. The payload is the signature, a space, and the command as JSON. No I/O.

The signature is HMAC-SHA-256 over the topic, a line feed and the very bytes of the JSON, written as 64 hexadecimal digits. The
topic names the drone; the JSON names the run of the service, the command's own id and its expiry, so that a copy is worth nothing
for another drone, after a restart, a second time, or later.
"""

import hashlib
import hmac
import re

_SIGNED = re.compile(rb"([0-9a-f]{64}) (.+)", re.DOTALL)


class Unsigned(ValueError):
    """The payload carries no signature at all."""


class Forged(ValueError):
    """The signature does not match this topic, command and key."""


def signed(key: bytes, topic: str, command: bytes) -> bytes:
    """Return the payload to publish on `topic` for a command in JSON."""
    return _digits(key, topic, command) + b" " + command


def verified(key: bytes, topic: str, payload: bytes) -> bytes:
    """Return the command in JSON.

    Raises:
        Unsigned: the payload does not begin with a signature.
        Forged: the signature is wrong.
    """
    match = _SIGNED.fullmatch(payload)
    if match is None:
        raise Unsigned
    if not hmac.compare_digest(match[1], _digits(key, topic, match[2])):
        raise Forged
    return match[2]


def _digits(key: bytes, topic: str, command: bytes) -> bytes:
    return hmac.new(key, topic.encode() + b"\n" + command, hashlib.sha256).hexdigest().encode()
