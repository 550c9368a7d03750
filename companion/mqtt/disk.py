"""A thread for work on a disk that may stand still: who waits for it may stop waiting, and it keeps no process alive."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import TypeVar

T = TypeVar("T")


class DiskThread:
    """Runs one piece of work after the other, in the order in which they were given.

    `concurrent.futures` would be joined when the interpreter ends, however long the disk takes; a daemon thread is not.
    """

    def __init__(self, name: str) -> None:
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    async def do(self, work: Callable[[], T]) -> T:
        """Return what `work` returns, or raise what it raises. Cancelled, it is carried out all the same."""
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
            # The loop may have ended meanwhile.
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(_settle, done, outcome, error)

        self._work.put(carry_out)
        return await asyncio.shield(done)

    def end(self) -> None:
        """End the thread after what it was given."""
        self._work.put(None)

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
