"""A terminal's end of the service's local socket: its folder, its name, and the messages through it."""

import asyncio
import os
import socket
import tempfile
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TypeVar

from companion.base.orders import OperatorOrder, StickPositions
from companion.facts.wire import (
    LINE_MAX,
    FlightState,
    OrderAnswer,
    OrderRequest,
    RequestRefused,
    SticksRequest,
    WatchRequest,
    answer_of,
    line_of,
)
from companion.settings.model import Settings
from estimator.contracts.errors import BadInput, Recoverable, refused

OFF, AUTO = "off", "auto"
_PATH_MAX = 100
"""The longest path that the kernel takes for a Unix socket is 107 bytes."""
_SYSTEM = Path("/run/decklander")
_ANSWER_S = 3.0
"""Longer than a standstill of the service whose waiting orders it still obeys (`OperatorArbiter.refusal`)."""


def socket_path(settings: Settings) -> Path | None:
    """Return the path that the settings mean, or None if there is no socket.

    Raises:
        BadInput: the path is too long for a socket.
    """
    chosen = settings.operator.socket
    if chosen == OFF:
        return None
    path = folders()[0] / _name(settings) if chosen == AUTO else Path(chosen)
    if len(os.fsencode(path)) > _PATH_MAX:
        raise BadInput(f"operator.socket: a socket's path has at most {_PATH_MAX} bytes, got {str(path)!r}")
    return path


def folders() -> list[Path]:
    """Return the folders in which sockets may be, the one of this process first."""
    own = tempfile.gettempdir()
    found = [Path(os.environ["RUNTIME_DIRECTORY"].split(":")[0])] if os.environ.get("RUNTIME_DIRECTORY") else []
    if os.environ.get("XDG_RUNTIME_DIR"):
        found.append(Path(os.environ["XDG_RUNTIME_DIR"]) / "decklander")
    return [*found, Path(own) / f"decklander-{os.getuid()}", _SYSTEM]


def running(settings: Settings | None) -> Path:
    """Return the socket of the running service: that of the settings, or the only one on this computer.

    Raises:
        BadInput: the settings switch the socket off, or there are several services.
        Recoverable: no service runs.
    """
    if settings is not None:
        path = socket_path(settings)
        if path is None:
            raise BadInput('operator.socket is "off" in these settings')
        names = [path] if settings.operator.socket != AUTO else [folder / path.name for folder in folders()]
        what = f"no service runs with these settings (nothing answers at {path})"
    else:
        names = [path for folder in folders() for path in _sockets(folder)]
        what = "no service runs on this computer, or this user may not reach it"
    alive = [path for path in names if answers(path)]
    if not alive:
        raise Recoverable(f"{what}; start one with: decklander run --config FILE")
    if len(alive) > 1:
        raise BadInput(f"{len(alive)} services run: give the settings or socket of one, --config {' or '.join(map(str, alive))}")
    return alive[0]


def answers(path: Path) -> bool:
    """Return whether a service listens at the path."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def _name(settings: Settings) -> str:
    return "".join(c if c.isalnum() or c in ".-" else "_" for c in settings.vehicle.address)[:60] + ".sock"


def _sockets(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.glob("*.sock") if path.is_socket())
    except OSError:
        return []


T = TypeVar("T")


async def in_time(answer: Awaitable[T]) -> T:
    """Return what a service sends.

    Raises:
        Recoverable: nothing comes in time.
    """
    try:
        async with asyncio.timeout(_ANSWER_S):
            return await answer
    except TimeoutError:
        raise Recoverable(f"the service did not answer within {_ANSWER_S:g} s") from None


class OperatorClient:
    """An open connection. See `connected`.

    Args:
        on_state: receives each state of the flight.
    """

    def __init__(self, writer: asyncio.StreamWriter, on_state: Callable[[FlightState], None]) -> None:
        self._writer = writer
        self._on_state = on_state
        self._number = 0
        self._waiting: dict[int, asyncio.Future[OrderAnswer]] = {}
        self._lost: str | None = None

    async def order(self, order: OperatorOrder, age_s: float = 0.0) -> OrderAnswer:
        """Give an order and return its answer.

        Args:
            age_s: time since it was given, s.

        Raises:
            Recoverable: the service is gone, or does not answer in time.
        """
        if self._lost is not None:
            raise Recoverable(self._lost)
        self._number += 1
        answer: asyncio.Future[OrderAnswer] = asyncio.get_running_loop().create_future()
        self._waiting[self._number] = answer
        self._writer.write(line_of(OrderRequest(number=self._number, order=order, age_s=age_s)))
        try:
            return await in_time(answer)
        finally:
            self._waiting.pop(self._number, None)

    def move(self, sticks: StickPositions) -> None:
        """Send the present positions of the sticks."""
        if self._lost is None:
            self._writer.write(
                line_of(SticksRequest(forward=sticks.forward, right=sticks.right, climb=sticks.climb, turn=sticks.turn))
            )

    def watch(self) -> None:
        """Ask for the state, now and from then on."""
        self._writer.write(line_of(WatchRequest()))

    async def read(self, reader: asyncio.StreamReader) -> None:
        """Read answers until the service closes the connection.

        Raises:
            Recoverable: it was closed.
        """
        why = "the service has closed the connection"
        try:
            while line := await reader.readline():
                match answer_of(line):
                    case OrderAnswer() as answer:
                        waiting = self._waiting.get(answer.number)
                        if waiting is not None and not waiting.done():
                            waiting.set_result(answer)
                    case FlightState() as state:
                        self._on_state(state)
                    case RequestRefused() as refused:
                        why = f"the service refuses this terminal: {refused.text}"
        except (OSError, ValueError):
            pass
        self._lost = why
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(Recoverable(why))
        raise Recoverable(why)


@asynccontextmanager
async def connected(path: Path, on_state: Callable[[FlightState], None] = lambda state: None) -> AsyncIterator[OperatorClient]:
    """Connect to the service at this socket. The block ends with `Recoverable` when the service is gone.

    Raises:
        Recoverable: nothing listens there, or this user may not connect.
    """
    with refused(str(path), OSError, by=Recoverable):
        reader, writer = await asyncio.open_unix_connection(path, limit=8 * LINE_MAX)
    client = OperatorClient(writer, on_state)
    try:
        async with asyncio.TaskGroup() as group:
            reading = group.create_task(client.read(reader))
            yield client
            reading.cancel()
    finally:
        writer.close()


def line_of_state(state: FlightState) -> str:
    """Return the state as one line for a person."""
    battery = "unknown" if state.battery_fraction is None else f"{100 * state.battery_fraction:.0f} %"
    height = "unknown" if state.height_m is None else f"{state.height_m:.1f} m"
    lateral = "" if state.lateral_m is None else f", pad {state.lateral_m:.1f} m away"
    why = f" ({state.reason})" if state.reason else ""
    why += f" (you lost the hand: {state.hand_taken})" if state.hand_taken else ""
    return f"{state.phase or state.situation}{why}; vehicle {state.mode or 'silent'}, height {height}{lateral}, battery {battery}"
