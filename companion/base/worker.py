"""A thread for long calls. Neither a cancelled task nor the end of the process waits for it."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from queue import SimpleQueue  # noqa: TID251 - `run` keeps its size, and no lock is taken in Python before a call begins
from typing import Any, TypeVar

from estimator.contracts.errors import Recoverable

T = TypeVar("T")


class Worker:
    """Runs one call after another on a daemon thread.

    Python joins the threads of a `ThreadPoolExecutor` at exit, so a call that hangs in a library would keep the process from
    ending and from being restarted.

    Args:
        name: the name of the thread.
        waiting: the number of calls that may wait behind one that does not return.
    """

    def __init__(self, name: str, waiting: int = 4) -> None:
        self._calls: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._waiting = waiting
        self._awaited: set[asyncio.Future[Any]] = set()
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """True if somebody awaits the result of a call."""
        return bool(self._awaited)

    def run(self, function: Callable[..., T], *args: Any) -> asyncio.Future[T]:
        """Begin to run the function on the thread and return its result to come. It is carried out even if that is cancelled.

        Raises:
            Recoverable: too many calls wait behind one that does not return.
            Whatever the function raises.
        """
        loop = asyncio.get_running_loop()
        future: asyncio.Future[T] = loop.create_future()

        def call() -> None:
            try:
                settle: Callable[[], object] = partial(future.set_result, function(*args))
            except BaseException as why:
                settle = partial(future.set_exception, why)
            with suppress(RuntimeError):  # the loop is closed, so nothing waits any more
                loop.call_soon_threadsafe(lambda: future.done() or settle())

        if self._calls.qsize() >= self._waiting:
            raise Recoverable(f"the thread {self._thread.name!r} is busy with an earlier call")
        self._calls.put(call)
        self._awaited.add(future)
        future.add_done_callback(self._awaited.discard)
        return future

    def close(self) -> None:
        """Take no more calls. The one that runs goes on by itself."""
        self._calls.put(None)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            call()
