"""Read the secrets that settings name, and archives whose files unpack to no more than what they are for."""

import hashlib
import hmac
import logging
import os
import stat
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Generic, TypeVar

from drivers.files import Largest, opened
from drivers.mavlink.signing import SigningKey
from estimator.contracts.errors import BadInput, DecklanderError, file_errors
from estimator.contracts.text import text_of, utf8_of

_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""The packings that unpack in bounded steps. Four kilobytes of bzip2 may hold gigabytes, and zipfile unpacks them at once."""


def unzipped(path: Path, largest: int) -> dict[str, bytes]:
    """Return files of a zip archive by name; their sizes are summed before any memory is taken for them.

    Args:
        largest: most bytes of all of them together.

    Raises:
        OSError: the archive cannot be read.
        ValueError: it is none, is damaged or encrypted, or the files are larger.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            size = sum(entry.file_size for entry in entries)
            if size > largest:
                raise ValueError(f"its files unpack to {size} bytes, and at most {largest} are read")
            if any(entry.compress_type not in _PACKINGS for entry in entries):
                raise ValueError("a packing that is neither stored nor deflated")
            return {entry.filename: archive.read(entry) for entry in entries}
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError) as why:
        raise ValueError(str(why) or type(why).__name__) from why


log = logging.getLogger(__name__)

T_co = TypeVar("T_co", covariant=True)


class Renewed(Generic[T_co]):
    """The contents of files that settings name, read again at each call after one of them changed.

    Certificates, passwords and tokens are replaced under a service that runs for months. Where the new ones cannot be read or
    used, what they held before is kept, and the log names the file once for each change.

    Args:
        read: returns what they hold.
        named: values of the settings that name them; empty ones name none.

    Raises:
        BadInput: they cannot be read or used at the start.
    """

    def __init__(self, read: Callable[[], T_co], what: str, *named: str, environment: Mapping[str, str] = os.environ) -> None:
        self._read = read
        self._paths = [path for path in (find(one, what, environment) for one in named) if path is not None]
        self._state = self._found()
        self._held = read()

    def __call__(self) -> T_co:
        if (state := self._found()) != self._state:
            self._state = state
            try:
                self._held = self._read()
            except DecklanderError as why:
                log.warning("%s; what it held before is kept", why)
            else:
                log.info("read again: %s", ", ".join(map(str, self._paths)))
        return self._held

    def _found(self) -> list[tuple[int, ...]]:
        found: list[tuple[int, ...]] = []
        for path in self._paths:
            try:
                status = path.stat()
            except OSError:
                found.append(())
            else:
                found.append((status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns))
        return found


CREDENTIAL, _PASSPHRASE = "credential:", "passphrase:"
"""Prefix that marks the name of a systemd credential in place of a path, and the begin of a line that a key is made of."""
KEY_BYTES = 32
_LONGEST = 4096
_SHORTEST_TOKEN = 16


def find(reference: str, what: str, environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the file that a setting names, or None for an empty setting.

    Args:
        reference: the value of the setting.
        what: the setting or option, for errors.
        environment: the environment variables, by default those of the process.

    Raises:
        BadInput: the setting names a credential but systemd has given no directory, or its name contains a slash.
    """
    if not reference:
        return None
    if not reference.startswith(CREDENTIAL):
        return Path(reference)
    wanted, folder = reference.removeprefix(CREDENTIAL), environment.get("CREDENTIALS_DIRECTORY")
    if not wanted or "/" in wanted or wanted in (".", ".."):
        raise BadInput(f"{what}: {reference!r} does not name a credential")
    if not folder:
        raise BadInput(f"{what}: {reference!r} is named, but there is no $CREDENTIALS_DIRECTORY (LoadCredential= in the unit)")
    return Path(folder) / wanted


def text(reference: str, what: str, environment: Mapping[str, str] = os.environ) -> str | None:
    """Return a secret text without the final newline that editors add, or None for an empty setting.

    Raises:
        BadInput: the file cannot be read, is empty, or is not text.
    """
    if (path := find(reference, what, environment)) is None:
        return None
    where = f"{what}: {path}"
    mode, content = _read(path, where)
    if mode & stat.S_IROTH:
        log.warning("%s can be read by everyone on this machine (chmod o-r)", where)
    secret = text_of(content, where).rstrip("\r\n")
    if not secret:
        raise BadInput(f"{where}: is empty")
    return secret


def key(reference: str, what: str, environment: Mapping[str, str] = os.environ, *, phrase: bool = False) -> bytes | None:
    """Return a key of `KEY_BYTES` bytes from a file that holds them raw or as hexadecimal digits; None for an empty setting.

    Args:
        phrase: whether the file may hold `passphrase: ...`, too, whose SHA-256 is the key, as ground stations compute it.

    Raises:
        BadInput: the file cannot be read, other users may read it, or it holds no key. The text never shows its content.
    """
    if (path := find(reference, what, environment)) is None:
        return None
    where = f"{what}: {path}"
    mode, content = _read(path, where)
    # systemd protects credentials by an access list, which looks like a group that may read.
    if not reference.startswith(CREDENTIAL) and mode & 0o077:
        raise BadInput(f"{where}: others may read it; chmod 600 {path}")
    if len(content) == KEY_BYTES:
        return content
    words = utf8_of(content).decode(errors="replace").strip()
    if phrase and words.startswith(_PASSPHRASE) and (of := words.removeprefix(_PASSPHRASE).strip()):
        return hashlib.sha256(of.encode()).digest()
    try:
        found = bytes.fromhex(words)
    except ValueError:
        found = b""
    if len(found) != KEY_BYTES:
        line = f", nor a line '{_PASSPHRASE} ...'" if phrase else ""
        raise BadInput(f"{where}: holds neither {KEY_BYTES} bytes nor {2 * KEY_BYTES} hexadecimal digits{line}")
    return found


def signing_key(reference: str, what: str = "signing key", environment: Mapping[str, str] = os.environ) -> SigningKey:
    """Return the key that MAVLink messages are signed with. Raises BadInput, as `key`."""
    secret = key(reference, what, environment, phrase=True)
    if secret is None:
        raise BadInput(f"{what}: no file is named")
    return SigningKey(secret)


def token(reference: str, what: str) -> bytes | None:
    """Return the token that callers must know, from a file; None for an empty setting.

    Raises:
        BadInput: the file cannot be read, or holds no token.
    """
    secret = text(reference, what)
    if secret is None:
        return None
    if len(secret) < _SHORTEST_TOKEN or not secret.isascii() or any(c.isspace() for c in secret):
        raise BadInput(f"{what}: a token has {_SHORTEST_TOKEN} or more ASCII characters without spaces")
    return secret.encode()


def _read(path: Path, where: str) -> tuple[int, bytes]:
    """Return a file's mode, and at most as many bytes as a secret can have. Raises BadInput."""
    with opened(path, Largest.SETTINGS, where) as file, file_errors(where):
        return os.fstat(file.fileno()).st_mode, file.read(_LONGEST)


def is_token(given: str, token: bytes) -> bool:
    """Return whether the text is the token, in a time that does not depend on where they differ."""
    return hmac.compare_digest(given.strip().encode(errors="replace"), token)
