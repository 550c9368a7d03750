"""Message signing: the key, and the signing state of an endpoint.

Source: mavlink.io, "Message signing". The key is never printed, logged or offered as a parameter.

`SigningTimes` keeps the times of signed messages over a restart: our own newest, and the newest received of each stream. A
message that is not later than the newest one of its stream is a replay. The file is written behind the flight's back, by a
thread: a disk that hangs or is full costs the memory of a restart, never a message.
"""

import hashlib
import json
import logging
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from estimator.contracts.errors import BadInput, unusable

_log = logging.getLogger(__name__)

EPOCH_S = 1_420_070_400
"""2015-01-01 00:00 GMT as Unix time."""
TICKS_PER_S = 100_000
"""Signing times are counted in units of 10 us."""
Stream = tuple[int, int, int]
"""(link id, system, component) of a sender."""

_AHEAD_TICKS = 60 * TICKS_PER_S
"""Time by which our own signing time on disk is ahead, so that a crash never repeats a time."""
_LATEST = 2**47
"""The year 2059. A time has 48 bits: who has used them up can sign no more."""
_SAVE_S = 5.0
"""Interval between two writes; messages received for so long before a crash could be replayed after it."""
_STREAMS_MAX = 256  # streams whose newest signing time is kept
_CLOSE_S = 0.3  # time that the end of the service waits for the signing time on disk


class SigningTimes:
    """The signing time of this host, and the newest time received of each stream. In flight nothing here raises for a file.

    Our own time is wall time in 10 us since 2015, but never at or before one used earlier.

    Args:
        path: where they are kept; None keeps them in memory alone. Where nothing was kept, a new stream may be a minute behind
            our own time, as the protocol says.

    Raises:
        BadInput: the file cannot be used as it is named.
    """

    def __init__(
        self, path: Path | None, wall_s: Callable[[], float] = time.time, elapsed_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._path = path
        self._wall_s, self._elapsed_s = wall_s, elapsed_s
        self._used = 0
        self._saved_s: float | None = None
        self._failed = False
        self._writer: threading.Thread | None = None
        self.streams: dict[Stream, int] = {}
        """The newest time received of each stream."""
        if path is not None:
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                with self._scratch(path).open("a"):
                    pass
                self._load(path)
            except OSError as why:
                self._fails(why, starting=True)

    @property
    def now(self) -> int:
        """The time that a message would be signed with, before it is."""
        return max(self._used, self._wall())

    def next(self) -> int:
        """Return a time later than every one before it."""
        self._used = max(self._used + 1, self._wall())
        self._save_if_due()
        return self._used

    def note_received(self, time: int) -> None:
        """Accept the time of a valid message: our timestamps continue after it, unless that would exhaust the clock."""
        if time < _LATEST:
            self._used = max(self._used, time)

    def bound(self) -> None:
        """Forget the stream longest behind where there are too many; only holders of the key make any."""
        while len(self.streams) > _STREAMS_MAX:
            del self.streams[min(self.streams, key=self.streams.__getitem__)]

    def close(self) -> None:
        """Write what is not written yet; a disk that hangs is waited for briefly."""
        if self._path is None or self._used == 0:
            return
        self._wait()
        self._start()
        self._wait()

    def _wall(self) -> int:
        return int((self._wall_s() - EPOCH_S) * TICKS_PER_S)

    def _load(self, path: Path) -> None:
        try:
            kept = json.loads(path.read_bytes())
            if isinstance(kept, int):  # of a release that kept our own time alone
                kept = {"time": kept, "streams": []}
            streams = {(int(a), int(b), int(c)): int(t) for a, b, c, t in kept["streams"]}
            self._used, self.streams = int(kept["time"]), streams
            if not 0 <= self._used < _LATEST:
                self._used = 0
                raise ValueError("a time out of range")
        except FileNotFoundError:
            _log.info("signing times: none kept yet in %s", path)
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as why:
            _log.error(
                "signing times %s cannot be used (%s): a new stream may be a minute behind the wall clock; it is replaced",
                path,
                why,
            )
        self.bound()

    def _save_if_due(self) -> None:
        if self._path is None or (self._writer is not None and self._writer.is_alive()):
            return
        now_s = self._elapsed_s()
        if self._saved_s is None or now_s - self._saved_s >= _SAVE_S:
            self._saved_s = now_s
            self._start()

    def _start(self) -> None:
        kept = {"time": self._used + _AHEAD_TICKS, "streams": [[*stream, t] for stream, t in self.streams.items()]}
        self._writer = threading.Thread(target=self._write, args=(json.dumps(kept),), name="signing-times", daemon=True)
        self._writer.start()

    def _wait(self) -> None:
        if self._writer is not None:
            self._writer.join(_CLOSE_S)

    def _write(self, text: str) -> None:
        assert self._path is not None
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            scratch = self._scratch(self._path)
            with scratch.open("w") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            scratch.replace(self._path)
            self._failed = False
        except OSError as why:
            self._fails(why, starting=False)

    @staticmethod
    def _scratch(path: Path) -> Path:
        return path.with_name(path.name + ".new")

    def _fails(self, why: OSError, *, starting: bool) -> None:
        """Log a failing disk once: it must not silence the autopilot's link. At the start a wrong path is raised instead."""
        fault = unusable(f"signing times {self._path}", why)
        if starting and isinstance(fault, BadInput):
            raise fault from why
        if not self._failed:
            self._failed = True
            _log.error("%s; they are kept in memory alone meanwhile, and a restart will not know of them", fault)


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


@dataclass(frozen=True, slots=True)
class Signing:
    """The key and the state with which one endpoint signs.

    Args:
        key: returns the secret key, which may be renewed.
        times: the timestamps seen, shared by all endpoints, so that a message received on one cannot be replayed on another.
        link_id: number of this endpoint, 0..255, different from those of the other endpoints.
    """

    key: Callable[[], SigningKey]
    times: SigningTimes
    link_id: int

    def __post_init__(self) -> None:
        if not 0 <= self.link_id <= 255:
            raise ValueError(f"a link id must lie in 0..255, got {self.link_id}")
