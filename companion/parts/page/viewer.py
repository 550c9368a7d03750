"""One browser that is logged in: its requests, and what is sent to it without ever waiting for it.

A slow link gets fewer pictures and states, never late ones: at most `_IN_FLIGHT` pictures are on their way, and a newer state
replaces one that is not sent yet. A browser that has the hand and goes away leads to a hold; nothing else changes by its going.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Protocol

from aiohttp import WSMsgType, web

from companion.base.orders import OperatorOrder, OrderSender
from companion.base.wire import OrderAnswer, OrderRequest, RequestRefused, SticksRequest
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.parts.page.messages import (
    DownloadRequest,
    DrawnNotice,
    LoginRequest,
    PageState,
    PictureRequest,
    RecordingsRequest,
    ReportRequest,
    ToPage,
    request_in,
    text_of,
)
from companion.parts.page.tool_messages import ToolRequest
from companion.recording.frame_encoder import FrameEncoder
from drivers.mailbox import Latest, Line
from estimator.contracts.ports import Clock
from estimator.contracts.time import MonoNs, seconds_between

ORDERS = tuple(order for order in OperatorOrder if order not in (OperatorOrder.PATH, OperatorOrder.RECORD))
"""The orders that the page may give."""
REFUSED_CODE = 4400
"""Close code of a message that is no request, or of too many."""
_REQUESTS_EACH_S = 100
"""The most requests of one browser in a second: sticks come at 20 Hz, and a notice with each picture."""
_IN_FLIGHT = 2
"""Pictures that may be on their way: one travels while the next is encoded."""
_TEXTS = 64
"""Events and answers that may wait; the oldest is dropped."""


class Served(Protocol):
    """Interface of the page's endpoint that a viewer needs."""

    pilot: Pilot
    clock: Clock

    def count(self, what: str) -> None: ...

    def frame_encoder(self) -> FrameEncoder | None: ...

    def list_recordings(self, viewer: PageViewer) -> None: ...

    def offer_recording(self, viewer: PageViewer, name: str) -> None: ...

    def make_report(self, viewer: PageViewer, name: str) -> None: ...

    def use_tool(self, viewer: PageViewer, request: ToolRequest) -> None: ...


class PageViewer:
    """See the module's docstring.

    Args:
        sender: this browser as a sender of orders.
    """

    def __init__(self, served: Served, socket: web.WebSocketResponse, sender: OrderSender) -> None:
        self._served = served
        self._socket = socket
        self.sender = sender
        self._states: Latest[str] = Latest()
        self._pictures: Latest[bytes] = Latest()
        self._texts: Line[str] = Line(_TEXTS)
        self._flying: dict[int, MonoNs] = {}
        """The exposure of each picture that is on its way, by its number."""
        self._recent: deque[MonoNs] = deque(maxlen=_REQUESTS_EACH_S)
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
        self._served.count("pictures")
        self._pictures.offer(message)

    def tell(self, message: ToPage) -> None:
        """Send a message; a state replaces one that is not sent yet."""
        if isinstance(message, PageState):
            self._states.offer(text_of(message))
        else:
            self._texts.offer(text_of(message))

    async def serve(self) -> None:
        """Serve this browser until it goes away."""
        try:
            async with asyncio.TaskGroup() as group:
                sending = [group.create_task(send()) for send in (self._send_states, self._send_texts, self._send_pictures)]
                await self._read()
                for task in sending:
                    task.cancel()
        except* ConnectionError:
            pass
        finally:
            self._served.pilot.operator.lost(self.sender, self._served.clock.now(), "its page closed")

    async def close(self, code: int, why: str) -> None:
        """Close the connection and say why."""
        if not self._socket.closed:
            await self._socket.send_str(text_of(RequestRefused(text=why)))
            await self._socket.close(code=code, message=why.encode()[:120])

    async def _send_states(self) -> None:
        async for text in self._states:
            await self._socket.send_str(text)

    async def _send_texts(self) -> None:
        async for text in self._texts:
            await self._socket.send_str(text)

    async def _send_pictures(self) -> None:
        async for message in self._pictures:
            await self._socket.send_bytes(message)

    async def _read(self) -> None:
        async for message in self._socket:
            refused = self._take(message.data) if message.type is WSMsgType.TEXT else "a request is a text"
            if refused is not None:
                self._served.count("refused")
                await self.close(REFUSED_CODE, refused)
                return

    def _take(self, text: str) -> str | None:
        """Carry a request out; return why it is refused, which ends the connection."""
        now = self._served.clock.now()
        if len(self._recent) == self._recent.maxlen and seconds_between(self._recent[0], now) < 1.0:
            return f"more than {_REQUESTS_EACH_S} requests in a second"
        self._recent.append(now)
        match request := request_in(text):
            case OrderRequest():
                self._order(request)
            case SticksRequest():
                self._served.pilot.operator.move(self.sender, request.positions, now)
            case DrawnNotice():
                self._drawn(request.number, now)
            case PictureRequest():
                # A frame that is lost to the browser's decoder would be missing in all that follow: it asks again.
                self.encoder = self._served.frame_encoder() if request.codec == "h264" else None
                self._flying.clear()
            case RecordingsRequest():
                self._served.list_recordings(self)
            case DownloadRequest():
                self._served.offer_recording(self, request.name)
            case ReportRequest():
                self._served.make_report(self, request.name)
            case LoginRequest():
                return "this page is logged in already"
            case str():
                return request
            case _:
                self._served.use_tool(self, request)
        return None

    def _order(self, request: OrderRequest) -> None:
        if request.order not in ORDERS:
            refusal: str | None = f"{request.order.value} is an order of MQTT and MAVLink"
        else:
            refusal = PilotOperator(self._served.pilot, self.sender, self._served.clock).order(request.order)
        text = "accepted" if refusal is None else f"refused: {refusal}"
        self.tell(OrderAnswer(number=request.number, accepted=refusal is None, text=text))

    def _drawn(self, number: int, now: MonoNs) -> None:
        exposed = self._flying.get(number)
        if exposed is not None:
            self.picture_delay_s = seconds_between(exposed, now)
        for earlier in [one for one in self._flying if one <= number]:
            del self._flying[earlier]
