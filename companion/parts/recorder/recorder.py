"""The recorder: an observer that passes records to a separate thread, which writes them to MCAP files.

The service's loop never waits for it: when the thread is behind, records are dropped and counted by channel. A disk that is full,
read-only or gone is reported once and retried with a growing back-off, while the flight continues.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from enum import Enum
from queue import Empty, SimpleQueue  # noqa: TID251 - `_give` bounds it, and no lock is taken in Python for each record
from types import TracebackType
from typing import Literal, ParamSpec

from companion.base.health import Health
from companion.base.observer import Decision, ProcessedFrame
from companion.base.orders import HandledOrder
from companion.facts import encode
from companion.facts import records as rec
from companion.parts.recorder.folder import Folder, SingleFile, in_words
from companion.recording.mcap_file import About, McapFile
from companion.recording.message_encoder import MessageEncoder
from companion.settings.service import RecorderOptions
from estimator.contracts.errors import Recoverable, refused
from estimator.contracts.estimates import FusionResult, Verdict
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs, seconds_between
from estimator.vision.camera.camera import Camera

_ROOM_AGAIN_MB = 20.0
"""The free space at which a disk that ran full is used again, MB: less would be full again within seconds."""
_HANGS_S = 1.5
"""Time for one record after which the disk counts as hanging: a card that tidies itself takes up to a second."""
_GATHER_S = 0.05
"""Time for which records gather once all are written, s: a thread that wakes for each costs the flight more than to write it."""


StoragePolicy = Folder | SingleFile
"""Chooses paths for files and reports when there is no space; `Folder` says what each method does."""


log = logging.getLogger(__name__)
PART = "recorder"
P = ParamSpec("P")


class RecorderState(Enum):
    """The state of the writing thread."""

    IDLE = "idle"
    RECORDING = "recording"
    BLOCKED = "blocked"
    """The disk or the folder prevents recording; the thread tries again."""
    PAUSED = "paused"
    CLOSED = "closed"


class Recorder:
    """An observer (`companion.base.observer`) and a context manager: its thread runs inside the context.

    Args:
        about: the metadata and attachments of every file.
        health: the health that shows the recorder's own state, and that is recorded.
        lossless: the caller waits for the thread when it is behind, as in virtual time; else records are dropped and counted.
        close_s: the longest time that closing may take before the remaining records are abandoned, seconds.
    """

    def __init__(
        self,
        storage_policy: StoragePolicy,
        camera: Camera,
        about: About,
        options: RecorderOptions,
        health: Health | None = None,
        *,
        lossless: bool = False,
        close_s: float = 10.0,
    ) -> None:
        self._storage_policy = storage_policy
        self._options = options
        self._lossless = lossless
        self._close_s = close_s
        self._message_encoder = MessageEncoder(camera, about.offset_ns, options.frames, options.jpeg_quality, about.pad)
        self._about = about
        self._health: Health | None = None
        if health is not None:
            self.watch(health)
        self._queue: SimpleQueue[tuple[MonoNs, object] | threading.Event | None] = SimpleQueue()
        self._frames_waiting = threading.BoundedSemaphore(options.queue_frames)
        self._thread = threading.Thread(target=self._work, name=PART, daemon=True)
        self._file: McapFile | None = None
        """The file that is being written."""
        self._began = self._flushed = self._synced = MonoNs(0)
        self._tried: MonoNs | None = None
        self._back_off_s = options.retry_s
        self._again_mb = 0.0
        self._recorded_health: MonoNs | None = None
        self._shown = RecorderState.IDLE
        self._busy_since_s: float | None = None
        """Time when the thread began with its present record; None while it waits for one."""
        self._hanging: int | None = None
        """The number of records dropped before the disk hung; None while it does not."""
        self._paused = False
        self._unflushed = 0
        self._state = RecorderState.IDLE
        self.why = ""
        """The reason why nothing is being written, in words; it is empty while records are written."""
        self.written = 0
        """The number of messages passed to files."""
        self.lost = 0
        """The number of messages among them that a fault of the disk lost."""
        self.blocked = 0
        """The number of faults of the disk or folder, including each failed attempt to begin a file."""
        self.dropped: Counter[str] = Counter()
        """The number of dropped records, by kind: the thread was behind, or the disk had no space."""
        self.faults = 0
        """Number of the recorder's own faults; each costs one record at most."""
        self.files = 0

    @property
    def state(self) -> RecorderState:
        return self._state

    @property
    def rests(self) -> bool:
        """True while it is paused and its file has ended: it takes nothing, and its thread is not woken."""
        return self._paused and self._state is RecorderState.PAUSED

    def __enter__(self) -> Recorder:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, why: BaseException | None, where: TracebackType | None) -> None:
        self.close()

    async def run(self) -> None:
        """Record until cancelled: the recorder as a part of the service.

        Raises:
            Recoverable: the system gives no thread.
        """
        with refused("the recorder's thread does not start", RuntimeError, by=Recoverable):
            self._thread.start()
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.to_thread(self.close)

    def watch(self, health: Health) -> None:
        """Record this health from now on, and show the recorder's own state in it.

        In virtual time the counters depend on the thread's timing, so there they are left out.
        """
        self._health = health
        if not self._lossless:
            health.counters(PART, self.counted)

    def close(self) -> None:
        """Write the waiting records and end the file. Stop waiting after `close_s`."""
        if self._state is RecorderState.CLOSED or not self._thread.is_alive():
            return
        self._queue.put(None)
        self._thread.join(self._close_s)
        if self._thread.is_alive():
            log.error("recorder: the disk took nothing for %.1f s; the end of the recording is lost", self._close_s)

    def switch(self, on: bool) -> str | None:
        """Begin a new file, or end the file and write nothing more; return the reason if that is impossible, else None."""
        self._paused = not on
        return self.why if on and self._state is RecorderState.BLOCKED else None

    def on_sample(self, sample: Sample) -> None:
        self._give(sample.stamp.received_at, sample)

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        """Record every result except those of accepted IMU samples, which are compared with nothing and add no information."""
        if result.source != "imu" or result.verdict is not Verdict.FUSED:
            self._give(at, result)

    def on_frame(self, processed: ProcessedFrame) -> None:
        if self.rests:
            return
        keep = self._options.frames != "none"
        if keep and not self._frames_waiting.acquire(blocking=self._lossless):
            self.dropped["frame"] += 1
            keep = False
        if (
            not self._give(processed.done, (encode.detection(processed), processed if keep else None, processed.detection))
            and keep
        ):
            self._frames_waiting.release()

    def on_decision(self, decision: Decision) -> None:
        self._give(decision.at, decision)
        if self._recorded_health is None or seconds_between(self._recorded_health, decision.at) >= 1.0:
            self._recorded_health = decision.at
            if self._lossless:
                self._catch_up()  # how far the thread has come must not show in a file of virtual time
            self._show()
            if self._health is not None and not self.rests:
                self._give(decision.at, encode.health(decision.at, self._health.snapshot()))

    def on_order(self, handled: HandledOrder) -> None:
        self._give(handled.at, handled)

    def on_truth(self, truth: rec.TruthRecord) -> None:
        """Record the truth from a simulator or motion capture."""
        self._give(MonoNs(truth.at_ns), truth)

    def on_link(self, at: MonoNs, link: str, direction: Literal["in", "out"], data: bytes, name: str | None = None) -> None:
        """Record one message of a link (MAVLink, MQTT) as its bytes; `name` is for readers."""
        self._give(at, rec.LinkRecord(int(at), link, direction, data, name))

    def _give(self, at: MonoNs, what: object) -> bool:
        if self.rests:
            return False
        if self._queue.qsize() >= self._options.queue_records:
            if not self._lossless or not self._thread.is_alive():
                self.dropped[_kind(what)] += 1
                return False
            self._catch_up()
        self._queue.put((at, what))
        return True

    def _catch_up(self) -> None:
        """Wait until the thread has written everything, if it runs."""
        if self._thread.is_alive():
            self._queue.put(written := threading.Event())
            written.wait()

    def counted(self) -> dict[str, float]:
        """Return the counters for health, with dropped records by kind under `dropped_<kind>`."""
        out: dict[str, float] = {"written": self.written, "lost": self.lost, "faults": self.faults, "files": self.files}
        out |= {"blocked": self.blocked, "not_removed": self._storage_policy.not_removed}
        return out | {f"dropped_{kind}": n for kind, n in sorted(self.dropped.items())}

    def _show(self) -> None:
        """Write the recorder's own state into the service's health, from the loop's thread."""
        if not self._lossless:
            self._tell_of_hanging()
        if self._health is None or self._state is self._shown:
            return
        self._shown = self._state
        if self._state is RecorderState.BLOCKED:
            self._health.down(PART, OSError(self.why))
        else:
            self._health.up(PART)

    def _tell_of_hanging(self) -> None:
        """Log when the disk takes nothing, and when it does again."""
        since_s = self._busy_since_s
        if self._hanging is None and since_s is not None and time.monotonic() - since_s > _HANGS_S:
            self._hanging = self.dropped.total()
            log.warning("recorder: the disk has taken nothing for %.1f s; records wait, then are dropped", _HANGS_S)
        elif self._hanging is not None and (since_s is None or time.monotonic() - since_s < _HANGS_S):
            log.warning("recorder: the disk takes records again; %d were dropped", self.dropped.total() - self._hanging)
            self._hanging = None

    def _work(self) -> None:
        try:
            while True:
                try:
                    item = self._queue.get(timeout=self._options.flush_s)
                except Empty:
                    if not self._lossless:
                        self._guarded(self._flush, None)
                    continue
                if item is None:
                    break
                if isinstance(item, threading.Event):
                    item.set()
                    continue
                self._busy_since_s = time.monotonic()
                self._guarded(self._take, *item)
                self._busy_since_s = None
                if not self._lossless and self._queue.empty():
                    time.sleep(_GATHER_S)
            self._guarded(self._end_file)
        finally:
            self._state = RecorderState.CLOSED

    def _guarded(self, handler: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Run a handler: a fault of the disk ends the file, a fault of ours costs a record; neither ends the flight."""
        try:
            handler(*args, **kwargs)
        except OSError as why:
            file, self._file = self._file, None
            if file is not None:
                file.abandon()
            self.lost += self._unflushed
            self._unflushed = 0
            self._again_mb = _ROOM_AGAIN_MB if why.errno in (errno.ENOSPC, errno.EDQUOT) else 0.0
            self._lacks(in_words(why))
        except Exception:
            self.faults += 1
            if self.faults == 1:
                log.exception("recorder: a fault of its own; further ones are only counted")

    def _take(self, at: MonoNs, what: object) -> None:
        accepted = False
        try:
            if not self._ready(at):
                return
            assert self._file is not None
            for topic, at_ns, message in self._message_encoder.messages(at, what):
                self._file.add(topic, at_ns, message)
                self.written += 1
                self._unflushed += 1
            accepted = True
        finally:
            if not accepted:
                self.dropped[_kind(what)] += 1
            if isinstance(what, tuple) and what[1] is not None:
                self._frames_waiting.release()
        self._flush(at)

    def _ready(self, at: MonoNs) -> bool:
        """Return whether there is a file to write to, and open one if that is allowed."""
        if self._paused:
            if self._file is not None:
                self._end_file()
            self._state = RecorderState.PAUSED
            return False
        if self._file is not None:
            return True
        if (
            self._tried is not None
            and self._state is RecorderState.BLOCKED
            and 0.0 <= seconds_between(self._tried, at) < self._back_off_s
        ):
            return False
        self._tried = at
        reason = self._storage_policy.lacks_room(self._again_mb)
        if reason is not None:
            self._lacks(reason)
            return False
        self._open(at)
        return True

    def _open(self, at: MonoNs) -> None:
        self._file = McapFile(self._storage_policy.next_path(), self._about)
        self.files += 1
        self._message_encoder.begin()
        for topic, at_ns, message in self._message_encoder.preamble(at):
            self._file.add(topic, at_ns, message)
        self._file.flush()
        self._began = self._flushed = self._synced = at
        if self._state is RecorderState.BLOCKED:
            log.warning("recorder: recording again, into %s", self._file.path)
        self._state, self.why, self._back_off_s, self._again_mb = RecorderState.RECORDING, "", self._options.retry_s, 0.0
        self._storage_policy.tidy(self._file.path)

    def _flush(self, now: MonoNs | None) -> None:
        """Flush the file if that is due at `now`, or at once if `now` is None."""
        file = self._file
        if file is None or (now is not None and seconds_between(self._flushed, now) < self._options.flush_s):
            return
        file.flush()
        self._unflushed = 0
        if now is None:
            return
        self._flushed = now
        if seconds_between(self._synced, now) >= self._options.sync_s:
            if file.removed:
                raise OSError(f"{file.path} was removed while it was written")
            file.sync()
            self._synced = now
            self._storage_policy.tidy(file.path)
        limit = self._storage_policy.max_file_bytes
        if limit is not None and (file.bytes >= limit or seconds_between(self._began, now) >= self._options.max_file_s):
            self._end_file()
        elif (reason := self._storage_policy.lacks_room()) is not None:
            self._end_file()
            self._lacks(reason)

    def _end_file(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            file.close()
            self._unflushed = 0

    def _lacks(self, reason: str) -> None:
        self.blocked += 1
        if self._state is RecorderState.BLOCKED:
            self._back_off_s = min(2.0 * self._back_off_s, self._options.retry_cap_s)
        else:
            room = f" from {self._again_mb:g} MB of free space on" if self._again_mb else ""
            log.error("recorder: nothing is recorded now: %s; the flight goes on, trying again%s", reason, room)
        self._state, self.why = RecorderState.BLOCKED, reason


def _kind(what: object) -> str:
    if isinstance(what, tuple):
        return "detection"
    return type(what).__name__.removesuffix("Record").removesuffix("Result").lower()
