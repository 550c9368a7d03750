"""Run a program's main task on an event loop that signals end as `companion.base.signals` says, always in bounded time.

    run(main())                          # instead of asyncio.run
    with heeded({SIGTERM: daemon.stop, SIGUSR1: pilot.begin}): ...

`asyncio.run` waits at its end for every task and every thread of the default executor, for as long as they take: one task that
swallows its cancellation, or a thread inside getaddrinfo, and the program never ends. It also ends at a `SystemExit` of any
task or callback and abandons the other tasks; here a `SystemExit` is an error of its task like any other, and the loop goes on.
"""

import asyncio
import logging
import signal
from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, TypeVar

from companion.base.signals import ABANDON_S, ENDING, PROCESS, check

log = logging.getLogger(__name__)

T = TypeVar("T")
Handler = Callable[[], object]
_SHORTEST_S = 0.05  # least time that tasks and generators get to end
_SLACK_S = 0.002
"""Time by which a timer may come early, with another one: each wake-up of the loop costs more than most of what it is for."""
_heeded: dict[int, Handler] = {}


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run the main task and return its result.

    Raises:
        Stopped: a signal ended the task, which was cancelled or abandoned.
        Whatever `main` raises.
    """
    loop = asyncio.new_event_loop()
    loop._clock_resolution = _SLACK_S  # type: ignore[attr-defined]  # timers due within it run together
    asyncio.set_event_loop(loop)
    task = loop.create_task(main, name="main")

    def into_loop(number: int) -> None:
        with suppress(RuntimeError):  # the loop was closed just now
            loop.call_soon_threadsafe(_take, number, loop, task)

    PROCESS.unfinished, PROCESS.into_loop = lambda: _names(loop), into_loop
    try:
        if PROCESS.number is not None:
            into_loop(PROCESS.number)
        return _complete(loop, task)
    except asyncio.CancelledError:
        check()
        raise
    except RuntimeError:
        if not task.done():
            check()  # `_abandon` stopped the loop
        raise
    finally:
        _close(loop)
        PROCESS.into_loop, PROCESS.unfinished = None, str
        asyncio.set_event_loop(None)
        loop.close()


@contextmanager
def heeded(handlers: Mapping[signal.Signals, Handler]) -> Iterator[None]:
    """Let the event loop of `run` call these handlers for signals instead of cancelling the main task.

    An ending signal that came before is handled at once. SIGTERM and SIGQUIT keep their deadlines; SIGINT has none here, because
    a person at the keyboard can press Ctrl-C twice.
    """
    before = dict(_heeded)
    _heeded.update({int(number): handler for number, handler in handlers.items()})
    others = [number for number in handlers if number not in ENDING and PROCESS.heeding]
    old = {number: signal.signal(number, PROCESS.heed) for number in others}
    if PROCESS.number is not None and (handler := _heeded.get(PROCESS.number)) is not None:
        handler()
    try:
        yield
    finally:
        for number, previous in old.items():
            signal.signal(number, previous)
        _heeded.clear()
        _heeded.update(before)


def _take(number: int, loop: asyncio.AbstractEventLoop, task: asyncio.Task[Any]) -> None:
    handler = _heeded.get(number)
    if number in ENDING and (handler is None or number != signal.SIGINT):
        loop.call_later(max(0.0, PROCESS.left_s()), _abandon, loop)
    if handler is not None:
        handler()
    elif number in ENDING:
        task.cancel()


def _complete(loop: asyncio.AbstractEventLoop, future: asyncio.Future[T]) -> T:
    """Run the loop until the future is done; return its result.

    The loop re-raises a `SystemExit` after it has stored it in the task that raised it. Nothing is lost, so the loop is run
    again. A Ctrl-C without a handler ends it.
    """
    while True:
        try:
            return loop.run_until_complete(future)
        except SystemExit as why:
            if future.done():
                raise
            log.error("a task or callback called sys.exit(%r); the others go on", why.code)


def _abandon(loop: asyncio.AbstractEventLoop) -> None:
    if names := _names(loop):
        log.error("not ended %.1f s after the signal: %s; going without", ABANDON_S + PROCESS.extra_s, names)
    loop.stop()


def _close(loop: asyncio.AbstractEventLoop) -> None:
    tasks = asyncio.all_tasks(loop)
    for task in tasks:
        task.cancel()
    with suppress(RuntimeError):  # the deadline stopped the loop
        if tasks:
            _complete(loop, loop.create_task(asyncio.wait(tasks, timeout=max(_SHORTEST_S, PROCESS.left_s()))))
        generators = loop.create_task(loop.shutdown_asyncgens())
        _complete(loop, loop.create_task(asyncio.wait([generators], timeout=max(_SHORTEST_S, PROCESS.left_s()))))
    if names := _names(loop):
        log.error("tasks that did not end: %s; going without", names)
    for task in tasks:
        if task.done() and not task.cancelled() and (why := task.exception()) is not None:
            loop.call_exception_handler({"message": "a task that was left behind failed", "exception": why, "task": task})


def _names(loop: asyncio.AbstractEventLoop) -> str:
    return ", ".join(sorted(task.get_name() for task in asyncio.all_tasks(loop)))
