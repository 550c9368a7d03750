"""A thread for work on a disk that may stall: its callers can stop waiting, and it keeps no process alive."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

from estimator.contracts.errors import Recoverable

T = TypeVar("T")

_WAITING = 64
"""The most tasks that may wait; few do at a time, because a caller waits for its task."""


class DiskThread:
    """Runs tasks one after the other, in the order in which they were submitted.

    `concurrent.futures` would be joined when the interpreter ends, however long the disk takes; a daemon thread is not.
    """

    def __init__(self, name: str) -> None:
        self._work: queue.Queue[Callable[[], None] | None] = queue.Queue(_WAITING)
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    async def do(self, work: Callable[[], T]) -> T:
        """Return what `work` returns, or raise what it raises. It is carried out even if the caller is cancelled.

        Raises:
            Recoverable: too many tasks wait for the disk already.
        """
        if not self._thread.ident:
            self._thread.start()
        loop = asyncio.get_running_loop()
        done: asyncio.Future[T] = loop.create_future()

        def carry_out() -> None:
            outcome: T | None = None
            error: BaseException | None = None
            try:
                outcome = work()
            except BaseException as why:
                error = why
            # The loop may have ended in the meantime.
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(_settle, done, outcome, error)

        try:
            self._work.put_nowait(carry_out)
        except queue.Full as why:
            raise Recoverable(f"the disk stands still: {_WAITING} pieces of work wait for it") from why
        return await asyncio.shield(done)

    def end(self) -> None:
        """End the thread after the tasks that were submitted."""
        with suppress(queue.Full):
            self._work.put_nowait(None)

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            work()


def _settle(done: asyncio.Future[T], outcome: T | None, error: BaseException | None) -> None:
    if done.done():
        return
    if error is not None:
        done.set_exception(error)
    else:
        done.set_result(outcome)  # type: ignore[arg-type]
