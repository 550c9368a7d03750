"""One browser that is logged in: its messages, and what is sent to it without ever waiting for it.

A slow link gets fewer pictures and states, never late ones: at most `_IN_FLIGHT` pictures are on their way, and a newer state
replaces one that is not sent yet.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, TypeVar

from aiohttp import WSMsgType, web
from msgspec import Struct, field
from msgspec.structs import replace

from companion.base.health import Health
from companion.base.http_server import HttpServer
from companion.base.observer import ProcessedFrame
from companion.base.orders import OrderSender
from companion.facts.wire import RequestRate, RequestRefused
from companion.guidance.pilot import Pilot
from companion.parts.page.messages import PageEvent, PageRequest, PageState, ToolRequest, ToPage, request_in, text_of
from companion.recording.frame_encoder import FrameEncoder
from companion.settings.model import Settings
from companion.settings.settings_file import SettingsFile
from drivers.mailbox import Latest, Line
from estimator.contracts.time import Clock, MonoNs, seconds_between

if TYPE_CHECKING:
    from drivers.mavlink.autopilot import Autopilot

T = TypeVar("T")
REFUSED_CODE = 4400
"""Close code of a message that is no request, or of too many."""
_REQUESTS_EACH_S = 100
"""The most requests of one browser in a second: sticks come at 20 Hz, and a notice with each picture."""
_IN_FLIGHT = 2
"""Pictures that may be on their way: one travels while the next is encoded."""
_TEXTS = 64
"""Events and answers that may wait; the oldest is dropped."""


class PageViewer:
    """See the module's docstring.

    Args:
        sender: this browser as a sender of orders.
        counts: the counters of the page.
    """

    def __init__(self, socket: web.WebSocketResponse, sender: OrderSender, clock: Clock, counts: Counter[str]) -> None:
        self.socket = socket
        self.sender = sender
        self._clock = clock
        self._counts = counts
        self._states: Latest[str] = Latest()
        self._pictures: Latest[bytes] = Latest()
        self._texts: Line[str] = Line(_TEXTS)
        self._flying: dict[int, MonoNs] = {}
        """The exposure of each picture that is on its way, by its number."""
        self._rate = RequestRate(_REQUESTS_EACH_S)
        self.encoder: FrameEncoder | None = None
        """Makes H.264 for this browser alone, which may skip pictures that others get; None while it gets JPEG."""
        self.picture_delay_s: float | None = None
        """Time from the newest drawn picture's exposure until the browser confirmed it, s."""

    @property
    def ready(self) -> bool:
        """True if another picture may be sent."""
        return len(self._flying) < _IN_FLIGHT

    def show(self, number: int, exposed: MonoNs, message: bytes) -> None:
        """Send a picture; only if the viewer is ready."""
        self._flying[number] = exposed
        self._counts["pictures"] += 1
        self._pictures.offer(message)

    def begin_pictures(self, encoder: FrameEncoder | None) -> None:
        """Send pictures by this encoder, or as JPEG, from now on; those on their way are not waited for."""
        self.encoder = encoder
        self._flying.clear()

    def drawn(self, number: int) -> None:
        """Take note that the browser has drawn a picture."""
        exposed = self._flying.get(number)
        if exposed is not None:
            self.picture_delay_s = seconds_between(exposed, self._clock.now())
        for earlier in [one for one in self._flying if one <= number]:
            del self._flying[earlier]

    def tell(self, message: ToPage) -> None:
        """Send a message; a state replaces one that is not sent yet."""
        if isinstance(message, PageState):
            self._states.offer(text_of(message))
        elif isinstance(message, PageEvent):
            reads = self.sender.reads
            self._texts.offer(text_of(replace(message, text=reads(message.text), advice=reads(message.advice))))
        else:
            self._texts.offer(text_of(message))

    async def serve(self, take: Callable[[PageRequest], str | None]) -> None:
        """Serve this browser until it goes away.

        Args:
            take: carries a request out; it returns why it is refused, which ends the connection.
        """
        socket = self.socket
        try:
            for text in self._texts.waiting():  # a state would overtake the welcome, and the events from before it
                await socket.send_str(text)
            async with asyncio.TaskGroup() as group:
                sending = [
                    group.create_task(_send(self._states, socket.send_str)),
                    group.create_task(_send(self._texts, socket.send_str)),
                    group.create_task(_send(self._pictures, socket.send_bytes)),
                ]
                await self._read(take)
                for task in sending:
                    task.cancel()
        except* ConnectionError:
            pass

    async def _read(self, take: Callable[[PageRequest], str | None]) -> None:
        async for message in self.socket:
            request = request_in(message.data) if message.type is WSMsgType.TEXT else "a request is a text"
            if self._rate.exceeded(self._clock.now()):
                request = f"more than {_REQUESTS_EACH_S} requests in a second"
            refused = request if isinstance(request, str) else take(request)
            if refused is not None:
                self._counts["refused"] += 1
                await refuse(self.socket, REFUSED_CODE, refused)
                return


async def _send(queue: Latest[T] | Line[T], send: Callable[[T], Awaitable[None]]) -> None:
    async for message in queue:
        await send(message)


async def refuse(socket: web.WebSocketResponse, code: int, why: str) -> None:
    """Say why a connection is closed, and close it, if it is open."""
    if socket.closed:
        return
    try:
        await socket.send_str(text_of(RequestRefused(text=why)))
        await socket.close(code=code, message=why.encode()[:120])
    except ConnectionError:
        pass


class PageService(Struct, frozen=True, eq=False):
    """The running service as the page and its tools see it."""

    server: HttpServer
    settings: Settings
    pilot: Pilot
    health: Health
    clock: Clock
    autopilot: Callable[[], Autopilot | None]
    """Returns the autopilot whose links are open; None while they are not."""
    settings_file: SettingsFile | None
    """The file that the settings were read from; None if there is none."""
    counts: Counter[str] = field(default_factory=Counter)

    @property
    def flying(self) -> bool:
        """True if the vehicle reports that it flies."""
        status = self.pilot.vehicle
        return status is not None and bool(status.flying)

    @property
    def left_alone(self) -> str:
        """The vehicle's way on once the service has ended, in words."""
        if self.pilot.vehicle is not None and self.pilot.vehicle.flying is False:
            return "the vehicle stands on the ground"
        return self.settings.vehicle.left_alone

    @property
    def armed(self) -> bool:
        """True if its motors are armed, as far as it says so."""
        found = self.autopilot()
        return found is not None and found.condition.armed is True


class Tool:
    """Something that the page offers beside the flight: work that takes time or the link is done only on the ground."""

    kinds: tuple[type, ...] = ()
    """The requests that it answers."""

    def ask(self, viewer: PageViewer, request: ToolRequest) -> None:
        """Take a request and return at once; the answer goes to the viewer, now or later."""
        raise NotImplementedError

    def on_frame(self, processed: ProcessedFrame) -> None:
        """Look at a frame; it must be quick."""

    async def run(self) -> None:
        """Work until cancelled."""
