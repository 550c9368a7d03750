"""Message signing: the key from a file or a systemd credential, the 48-bit time kept on disk so that it never runs back.

Source: mavlink.io, "Message signing". The key is never printed, logged or offered as a parameter.
"""

from __future__ import annotations

import hashlib
import logging
import os
import stat
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from estimator.contracts.errors import BadInput, unusable

_log = logging.getLogger(__name__)

EPOCH_S = 1_420_070_400
"""2015-01-01 00:00 GMT as Unix time."""
TICKS_PER_S = 100_000
_AHEAD_TICKS = 60 * TICKS_PER_S
"""How far the time on disk runs ahead, so that it is written once a minute and a crash still never repeats a time."""
_CREDENTIAL, _PASSPHRASE = "credential:", "passphrase:"


@dataclass(frozen=True, slots=True)
class SigningKey:
    """32 secret bytes that do not show when printed."""

    secret: bytes = field(repr=False)

    def __post_init__(self) -> None:
        if len(self.secret) != 32:
            raise ValueError("a signing key has 32 bytes")


def load_key(where: str, environment: Mapping[str, str] | None = None) -> SigningKey:
    """The key in a file: 32 raw bytes, 64 hexadecimal digits, or `passphrase: ...` (its SHA-256, as ground stations make it).

    Args:
        where: a path, or `credential:NAME` for a file that systemd put into `$CREDENTIALS_DIRECTORY`.

    Raises:
        BadInput: no such file, others may read it, or it holds no key. The text never shows what is in the file.
    """
    environment = os.environ if environment is None else environment
    if where.startswith(_CREDENTIAL):
        folder = environment.get("CREDENTIALS_DIRECTORY")
        if folder is None:
            raise BadInput(f"signing key {where!r}: systemd passed no credentials to this process (LoadCredential= in the unit)")
        path = Path(folder) / where.removeprefix(_CREDENTIAL)
    else:
        path = Path(where)
    try:
        mode = path.stat().st_mode
        content = path.read_bytes()
    except OSError as why:
        raise unusable(f"signing key {path}", why) from why
    if stat.S_IMODE(mode) & 0o077:
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


class SigningTime:
    """The signing time of this host: wall time in 10 us since 2015, but never at or before one used earlier, across restarts.

    The file holds a time that was not used yet; it is written before times beyond it are used.

    Args:
        path: where it is kept; None keeps it in memory only.

    Raises:
        BadInput: the file cannot be read or written as it is named.
    """

    def __init__(self, path: Path | None, wall_s: Callable[[], float] = time.time) -> None:
        self._path = path
        self._wall_s = wall_s
        self._reserved = 0
        self._used = 0
        self._said = False
        if path is not None and path.exists():
            try:
                self._used = self._reserved = int(path.read_text())
            except OSError as why:
                self._fails(why, starting=True)
            except ValueError:  # torn by a power cut: no setting is wrong, and the next write mends it
                _log.error("signing time %s: it should hold one whole number; going on from this host's clock", path)
        self._reserve(self._reserved, starting=True)

    def next(self, at_least: int = 0) -> int:
        """A time later than every one before it, and not before `at_least` (a peer's)."""
        wall = int((self._wall_s() - EPOCH_S) * TICKS_PER_S)
        self._used = max(self._used + 1, wall, at_least)
        if self._used >= self._reserved:
            self._reserve(self._used + _AHEAD_TICKS)
        return self._used

    def _reserve(self, until: int, *, starting: bool = False) -> None:
        self._reserved = until
        if self._path is None:
            return
        scratch = self._path.with_name(self._path.name + ".new")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            scratch.write_text(str(until))
            scratch.replace(self._path)
        except OSError as why:
            self._fails(why, starting=starting)

    def _fails(self, why: OSError, *, starting: bool) -> None:
        """A disk that fails must not silence the link to the autopilot: this host's clock is all but always ahead by itself."""
        fault = unusable(f"signing time {self._path}", why)
        if starting and isinstance(fault, BadInput):
            raise fault from why
        if not self._said:
            _log.error("%s; it is kept in memory alone meanwhile", fault)
        self._said = True


@dataclass(frozen=True, slots=True)
class Signing:
    """What one endpoint signs with, and the newest times it heard.

    Args:
        link_id: this endpoint's own number, 0..255, different from the other endpoints'.
    """

    key: SigningKey
    time: SigningTime
    link_id: int
    streams: dict[tuple[int, int, int], int] = field(default_factory=dict)
    """Newest time heard of each (link id, system, component): what is not later is a replay. Outlives reconnections."""

    def __post_init__(self) -> None:
        if not 0 <= self.link_id <= 255:
            raise ValueError(f"a link id must lie in 0..255, got {self.link_id}")
