"""Message signing: load the key from a file or a systemd credential, and keep the signing state of an endpoint.

Source: mavlink.io, "Message signing". The key is never printed, logged or offered as a parameter.
"""

import hashlib
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from drivers.mavlink.signing_times import SigningTimes
from estimator.contracts.errors import BadInput

_CREDENTIAL, _PASSPHRASE = "credential:", "passphrase:"
_LONGEST = 4096


@dataclass(frozen=True, slots=True)
class SigningKey:
    """A secret key of 32 bytes whose representation does not show them."""

    secret: bytes = field(repr=False)

    def __post_init__(self) -> None:
        if len(self.secret) != 32:
            raise ValueError("a signing key has 32 bytes")

    @property
    def fingerprint(self) -> str:
        """Sixteen digits that identify the key without revealing it."""
        return ":".join(f"{byte:02x}" for byte in hashlib.sha256(self.secret).digest()[:8])


def load_key(where: str, environment: Mapping[str, str] | None = None) -> SigningKey:
    """Load the key from a file: 32 raw bytes, 64 hexadecimal digits, or `passphrase: ...`.

    The key of a passphrase is its SHA-256, as ground stations compute it.

    Args:
        where: a path, or `credential:NAME` for a file that systemd put into `$CREDENTIALS_DIRECTORY`.
        environment: the environment variables, by default those of the process.

    Raises:
        BadInput: the file does not exist, other users may read it, or it holds no key. The text never shows the file's content.
    """
    environment = os.environ if environment is None else environment
    if where.startswith(_CREDENTIAL):
        folder = environment.get("CREDENTIALS_DIRECTORY")
        if folder is None:
            raise BadInput(f"signing key {where!r}: systemd passed no credentials to this process (LoadCredential= in the unit)")
        name = where.removeprefix(_CREDENTIAL)
        if not name or "/" in name or name in (".", ".."):
            raise BadInput(f"signing key {where!r} does not name a credential")
        path = Path(folder) / name
    else:
        path = Path(where)
    try:
        mode = path.stat().st_mode
        with path.open("rb") as file:
            content = file.read(_LONGEST)  # a setting may name any file, also one without an end, such as a device
    except (OSError, ValueError) as why:  # open() raises a plain ValueError for a path with a NUL character
        raise BadInput(f"signing key {str(path)!r}: {getattr(why, 'strerror', None) or why}") from why
    # systemd protects credentials by an access list, which looks like a group that may read.
    if not where.startswith(_CREDENTIAL) and stat.S_IMODE(mode) & 0o077:
        raise BadInput(f"signing key {path}: others may read it; chmod 600 {path}")
    if len(content) == 32:
        return SigningKey(content)
    text = content.decode("utf-8", errors="replace").strip()
    if text.startswith(_PASSPHRASE) and text.removeprefix(_PASSPHRASE).strip():
        return SigningKey(hashlib.sha256(text.removeprefix(_PASSPHRASE).strip().encode()).digest())
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) != 32:
        raise BadInput(f"signing key {path}: neither 32 bytes, nor 64 hexadecimal digits, nor a line 'passphrase: ...'")
    return SigningKey(key)


@dataclass(frozen=True, slots=True)
class Signing:
    """The key and the state with which one endpoint signs.

    Args:
        key: the secret key.
        times: the timestamps seen, shared by all endpoints, so that a message received on one cannot be replayed on another.
        link_id: number of this endpoint, 0..255, different from those of the other endpoints.
    """

    key: SigningKey
    times: SigningTimes
    link_id: int

    def __post_init__(self) -> None:
        if not 0 <= self.link_id <= 255:
            raise ValueError(f"a link id must lie in 0..255, got {self.link_id}")
