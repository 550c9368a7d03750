"""Supervise the service's parts in two fault domains, and contain the errors of what the flight does not need.

Two fault domains share one process. A vital part (the vehicle with vision and the filter; guidance) is restarted after a failure
of the outside world. A bug of ours ends it and the whole group with an error, and the process manager restarts the process. A
part beside the flight (recorder, links to people, metrics, the pulse for systemd) may fail in any way: it is restarted with
growing back-off, and given up if that does not help. The vital parts are not affected. An observer's errors are logged once,
counted in health, and not propagated.

A failed part cannot be trusted: its thread may be gone and its files closed. Each restart therefore makes a new object, and
callers reach the present one through `RestartablePart.now`.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Generic, ParamSpec, Protocol, TypeVar

from companion.base.health import Health
from companion.base.observer import Observer, Relay, listens, rests
from drivers.reconnect import BackOff, reconnect
from estimator.contracts.errors import BadInput, Recoverable, in_words
from estimator.contracts.samples import Sample
from estimator.contracts.time import Clock, MonoNs, after, seconds_between

log = logging.getLogger(__name__)
RESTART = BackOff(0.2, 5.0, 5.0)
"""The waits before a failed part is started again."""
GIVE_UP_AFTER = 10
"""Failures in a row after which a part beside the flight is given up; those of the outside world do not count."""

P = ParamSpec("P")
T = TypeVar("T")

FAILURES_IN_A_ROW = 20
"""Failures in a row after which a callee is disabled: each call costs the flight time, and the next would likely fail too."""
BACK_OFF_FIRST_S = 10.0
"""First back-off before the callee is tried again. Memory or descriptors may free up."""
BACK_OFF_CAP_S = 300.0
"""Longest back-off; each is twice the last."""
CLOSE_S = 1.0
"""Time that the parts beside the flight have to end, once the vital ones have ended."""


class CallGuard:
    """Guards the calls to one callee.

    Args:
        name: the callee's name in health and in the log.
        limit: failures in a row after which it is disabled.
    """

    def __init__(self, name: str, health: Health, limit: int = FAILURES_IN_A_ROW) -> None:
        self._name = name
        self._health = health
        self._limit = limit
        self._in_a_row = 0
        self._back_off_s = BACK_OFF_FIRST_S
        self._aside_until: MonoNs | None = None

    def call(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """Return the function's result; None if it raised or is disabled.

        Raises:
            KeyboardInterrupt: it is the only error that does not come from the callee.
        """
        if self._aside_until is not None and self._health.now() < self._aside_until:
            return None
        try:
            result = function(*args, **kwargs)
        except KeyboardInterrupt:
            raise
        except BaseException as why:  # CancelledError and SystemExit are the callee's fault as well
            self._failed(why)
            return None
        self._in_a_row = 0
        if self._aside_until is not None:
            self._aside_until, self._back_off_s = None, BACK_OFF_FIRST_S
            self._health.up(self._name)
            log.warning("%s works again", self._name)
        return result

    def _failed(self, why: BaseException) -> None:
        self._in_a_row += 1
        if self._health.contain(self._name) == 1:
            report("%s failed; the flight goes on, further failures are only counted", self._name, why=why)
        if self._in_a_row >= self._limit:
            words = f"off after {self._in_a_row} failures in a row: {in_words(why)}"
            if self._aside_until is None:
                log.error("%s is %s", self._name, words)
            self._health.down(self._name, RuntimeError(words))
            self._aside_until = after(self._health.now(), self._back_off_s)
            self._back_off_s = min(2.0 * self._back_off_s, BACK_OFF_CAP_S)


class Audience(Relay):
    """Passes each event to all observers, each method of each observer behind its own guard.

    Args:
        guarded: False lets an observer's error through, as a simulated flight wants it.
    """

    def __init__(self, observers: Sequence[Observer], health: Health, *, guarded: bool = True) -> None:
        def call_of(observer: Observer, method: str) -> Callable[..., object]:
            call: Callable[..., object] = getattr(observer, method)
            return partial(CallGuard(f"{name_of(observer)}.{method}", health).call, call) if guarded else call

        self._calls = {
            method: [(call_of(o, method), o) for o in observers if _listens(o, method)]
            for method in ("on_sample", "on_fusion", "on_frame", "on_decision", "on_order")
        }

    @property
    def takes_fusion(self) -> bool:
        """True if an observer takes the results of measurements now."""
        return not all(rests(o) for _, o in self._calls["on_fusion"])

    def on_samples(self, samples: Sequence[Sample]) -> None:
        for call, observer in self._calls["on_sample"]:
            if not rests(observer):
                for sample in samples:
                    call(sample)

    def hand_on(self, method: str, *what: object) -> None:
        for call, _ in self._calls[method]:
            call(*what)


def _listens(observer: Observer, method: str) -> bool:
    """Return whether an observer does anything in a method; a restartable part that could not be made yet may."""
    part = observer.now if isinstance(observer, RestartablePart) else None
    return listens(observer if part is None else part, method)


def name_of(observer: object) -> str:
    """Return the observer's `name`, or the name of its class if it has none."""
    name = getattr(observer, "name", None)
    return name if isinstance(name, str) else type(observer).__name__.lower()


def report(text: str, *args: object, why: BaseException) -> None:
    """Log an error with its traceback. A failure of the log itself is ignored."""
    with suppress(Exception):
        log.error(text, *args, exc_info=why)


class Part(Observer, Protocol):
    """An observer that also has a task of its own."""

    async def run(self) -> None: ...


Made = TypeVar("Made", bound=Part)


class RestartablePart(Relay, Generic[Made]):
    """Makes the part at once, so that wrong settings are found before the service begins, and makes it again after each failure.

    Args:
        name: the name in health and in the log.
        make: makes the part; called again for each restart.

    Raises:
        BadInput: the settings are wrong.
    """

    def __init__(self, name: str, make: Callable[[], Made]) -> None:
        self.name = name
        self._make = make
        self.now: Made | None = None
        """The running part; None while there is none."""
        try:
            self.now = make()
        except BadInput:
            raise
        except Exception as why:  # neither the outside world's state nor our own bug may keep the drone on the ground
            report("%s could not be made; the service begins without it and tries again", name, why=why)

    async def run(self) -> None:
        """Run the part once.

        Raises:
            Whatever ends the part.
        """
        if self.now is None:
            self.now = await asyncio.to_thread(self._make)  # it reads files, of a disk that may hang
        living = self.now
        try:
            await living.run()
        finally:
            self.now = None

    def hand_on(self, method: str, *what: object) -> None:
        if self.now is not None:
            getattr(self.now, method)(*what)


Body = Callable[[], Awaitable[None]]


async def keep_alive(name: str, body: Body, waits: BackOff, health: Health, clock: Clock) -> None:
    """Run a vital `body` again after each `Recoverable`; anything else propagates. A body that returns has finished."""

    async def attempt() -> None:
        health.up(name)
        await uncancelled(name, body)

    await reconnect(name, attempt, waits, clock, lambda why: health.down(name, why), (Recoverable,))


async def contain(name: str, body: Body, waits: BackOff, health: Health, clock: Clock) -> None:
    """Run a `body` beside the flight again after any error. This raises nothing but its own cancellation.

    An error that does not come from the outside world (`Recoverable`, `OSError`) is logged with its traceback the first time, and
    `GIVE_UP_AFTER` of them in a row end the part for good. A body that returns has finished.
    """
    in_a_row = 0

    async def attempt() -> None:
        nonlocal in_a_row
        began = clock.now()
        try:
            health.up(name)
            await uncancelled(name, body)
            return
        except asyncio.CancelledError:
            raise
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            why = error
        if _cancelled():  # it failed while it was being cancelled
            report("%s failed while it ended", name, why=why)
            raise asyncio.CancelledError from why
        if seconds_between(began, clock.now()) >= waits.healthy_after_s:
            in_a_row = 0
        if not _of_the_world(why):
            in_a_row += 1
            if health.contain(name) == 1:
                report("%s failed and will be restarted; the flight goes on", name, why=why)
        if in_a_row >= GIVE_UP_AFTER:
            words = f"off after {in_a_row} failures: {in_words(why)}"
            health.down(name, RuntimeError(words))
            log.error("%s is %s", name, words)
            return
        raise Recoverable(in_words(why)) from why

    await reconnect(name, attempt, waits, clock, lambda why: health.down(name, why))


async def run(
    parts: Mapping[str, Body],
    waits: BackOff,
    health: Health,
    clock: Clock,
    until: asyncio.Event | None = None,
    beside: Mapping[str, Body] | None = None,
) -> None:
    """Run all parts until each vital one has returned, `until` is set, a vital one has failed for good, or we are cancelled.

    The vital parts end first, so that the vehicle gets its final hover burst whatever the others do; those then have `CLOSE_S`.

    Args:
        parts: the vital parts, by name.
        beside: the parts that the flight does not need, by name.

    Raises:
        ExceptionGroup: a vital part raised something other than `Recoverable`.
    """
    for name in parts:
        health.vital(name)
    others = [asyncio.create_task(contain(name, body, waits, health, clock), name=name) for name, body in (beside or {}).items()]
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(keep_alive(name, body, waits, health, clock), name=name) for name, body in parts.items()]
            if until is not None:
                await until.wait()
                for task in tasks:
                    task.cancel()
    finally:
        await _close(others)


async def uncancelled(name: str, body: Body) -> None:
    """Run `body`, and treat a cancellation that was not requested as a fault: a TaskGroup would take it for an orderly end.

    `sys.exit` in the body or in one of its tasks is a fault too: it would end the process silently, and with exit code 0.
    A task's `SystemExit` arrives here only with the loop of `companion.base.signals`; asyncio's own loop breaks.

    Raises:
        RuntimeError: the body was cancelled by none of us, or called `sys.exit`.
    """
    try:
        await body()
    except SystemExit as why:
        raise RuntimeError(f"{name} called sys.exit({why.code!r})") from why
    except asyncio.CancelledError as why:
        if _cancelled():
            raise
        raise RuntimeError(f"{name} was cancelled by none of us") from why


async def _close(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    if tasks:
        _, left = await asyncio.wait(tasks, timeout=CLOSE_S)
        for task in left:
            log.error("%s did not end within %.1f s and is abandoned", task.get_name(), CLOSE_S)


def _cancelled() -> bool:
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0


def _of_the_world(error: BaseException) -> bool:
    if isinstance(error, BaseExceptionGroup):
        return all(_of_the_world(one) for one in error.exceptions)
    return isinstance(error, (Recoverable, OSError))
