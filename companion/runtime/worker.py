"""One thread for long calls, that nobody ever waits for: neither a cancelled task nor the end of the process."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Full, Queue
from typing import Any, TypeVar

from estimator.contracts.errors import Recoverable

WAITING = 4
"""Calls that may wait behind one that does not come back."""

T = TypeVar("T")


class Worker:
    """Runs one call after another on a daemon thread. A `ThreadPoolExecutor`'s threads are joined when Python ends: a call
    that hangs in a library would hold the process, which then could not be started anew.

    Args:
        name: of the thread.
    """

    def __init__(self, name: str) -> None:
        self._calls: Queue[Callable[[], None] | None] = Queue(maxsize=WAITING)
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    async def run(self, function: Callable[..., T], *args: Any) -> T:
        """The function's result, computed on the thread. Cancelled, it leaves the call to itself.

        Raises:
            Recoverable: `WAITING` calls wait behind one that does not come back.
            Whatever the function raises.
        """
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()

        def settle(result: T | None, error: BaseException | None) -> None:
            if future.done():
                return
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(result)  # type: ignore[arg-type]

        def call() -> None:
            if future.cancelled():
                return
            result, error = None, None
            try:
                result = function(*args)
            except BaseException as why:
                error = why
            with suppress(RuntimeError):  # the loop is closed: nobody waits any more
                loop.call_soon_threadsafe(settle, result, error)

        try:
            self._calls.put_nowait(call)
        except Full as why:
            raise Recoverable(f"the thread {self._thread.name!r} is busy with an earlier call") from why
        return await future

    def close(self) -> None:
        """Take no more calls. The one that runs goes on by itself."""
        with suppress(Full):  # then it never comes back, and ends with the process
            self._calls.put_nowait(None)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            call()
