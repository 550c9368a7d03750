"""A thread for long calls. Neither a cancelled task nor the end of the process waits for it."""

import asyncio
import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Full, Queue
from typing import Any, TypeVar

from estimator.contracts.errors import Recoverable

WAITING = 4

T = TypeVar("T")


class Worker:
    """Runs one call after another on a daemon thread.

    Python joins the threads of a `ThreadPoolExecutor` at exit, so a call that hangs in a library would keep the process from
    ending and from being restarted.

    Args:
        name: the name of the thread.
        waiting: the number of calls that may wait behind one that does not return.
    """

    def __init__(self, name: str, waiting: int = WAITING) -> None:
        self._calls: Queue[Callable[[], None] | None] = Queue(maxsize=waiting)
        self._awaited = 0
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    @property
    def busy(self) -> bool:
        """True if somebody awaits the result of a call."""
        return self._awaited > 0

    async def run(self, function: Callable[..., T], *args: Any) -> T:
        """Run the function on the thread and return its result. It is carried out even if the caller is cancelled meanwhile.

        Raises:
            Recoverable: too many calls wait behind one that does not return.
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
            result, error = None, None
            try:
                result = function(*args)
            except BaseException as why:
                error = why
            with suppress(RuntimeError):  # the loop is closed, so nobody waits any more
                loop.call_soon_threadsafe(settle, result, error)

        try:
            self._calls.put_nowait(call)
        except Full as why:
            raise Recoverable(f"the thread {self._thread.name!r} is busy with an earlier call") from why
        self._awaited += 1
        try:
            return await future
        finally:
            self._awaited -= 1

    def close(self) -> None:
        """Take no more calls. The one that runs goes on by itself."""
        with suppress(Full):  # then the running call never returns, and the thread ends with the process
            self._calls.put_nowait(None)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            call()
