"""The terminal's end of the service's local socket."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from companion.base.orders import OperatorOrder, StickPositions
from companion.base.wire import (
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
from estimator.contracts.errors import Recoverable

_ANSWER_S = 3.0


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

    async def order(self, order: OperatorOrder) -> OrderAnswer:
        """Give an order and return its answer.

        Raises:
            Recoverable: the service is gone, or does not answer in time.
        """
        if self._lost is not None:
            raise Recoverable(self._lost)
        self._number += 1
        answer = asyncio.get_running_loop().create_future()
        self._waiting[self._number] = answer
        self._writer.write(line_of(OrderRequest(number=self._number, order=order)))
        try:
            async with asyncio.timeout(_ANSWER_S):
                answered: OrderAnswer = await answer
                return answered
        except TimeoutError:
            raise Recoverable(f"the service did not answer within {_ANSWER_S:g} s") from None
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
    try:
        reader, writer = await asyncio.open_unix_connection(path, limit=8 * LINE_MAX)
    except OSError as why:
        raise Recoverable(f"{path}: {why.strerror or why}") from why
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
    return (
        f"{state.phase or state.situation}{why}; vehicle {state.mode or 'not heard'}, height {height}{lateral}, battery {battery}"
    )
