"""Fuzz what comes from operators' screens: the local socket of terminals, the operator page's port, and its requests."""

import asyncio
import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import cast

from aiohttp import WSMessage, WSMsgType, web

from companion.base.health import Health
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.base.wire import OrderRequest, SticksRequest, WatchRequest, line_of
from companion.guidance.make_pilot import make_pilot
from companion.guidance.pilot import Pilot
from companion.parts.operator.local_socket import OperatorSocket
from companion.parts.page.endpoint import PageEndpoint
from companion.parts.page.messages import (
    DownloadRequest,
    DrawnNotice,
    LoginRequest,
    PageRequest,
    PictureRequest,
    RecordingsRequest,
)
from companion.parts.page.recordings import Recordings, ReportMaker
from companion.parts.page.state import video_quality
from companion.parts.page.tool_messages import ToolRequest
from companion.parts.page.viewer import PageViewer
from companion.recording.frame_encoder import FrameEncoder
from companion.settings.load import load
from companion.settings.model import Settings
from companion.settings.page import PageSettings
from drivers.clock import SystemClock
from estimator.contracts.ports import Clock
from fuzz.connections import ANSWER_S, HOST, converse, ended, upgrade, watched, websocket_frame
from fuzz.target import SHARED_MEMORY, Choices, Target, block

_TOKEN = "a-token-of-sixteen-and-more"


@cache
def _settings() -> Settings:
    return load("sim")


def run_operator_socket(data: bytes) -> None:
    """Send bytes in pieces to the local socket: obeyed, refused or closed, and the socket goes on without an error."""
    asyncio.run(watched(_on_socket(Choices(data).blocks())))


async def _on_socket(pieces: list[bytes]) -> None:
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        served = OperatorSocket(Path(folder) / "operator", make_pilot(_settings()), SystemClock())
        serving = asyncio.ensure_future(served.run())
        while not served.path.exists() and not serving.done():  # noqa: ASYNC110
            await asyncio.sleep(0)
        with suppress(OSError):
            await converse(await asyncio.open_unix_connection(str(served.path)), pieces)
        assert not serving.done(), "the socket has ended"
        await ended(serving)
        assert not served.connections


def run_page_port(data: bytes) -> None:
    """Send bytes in pieces to the page's port: answered or closed, and the page goes on without an error."""
    asyncio.run(watched(_on_port(Choices(data).blocks())))


async def _on_port(pieces: list[bytes]) -> None:
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        token, clock = Path(folder) / "token", SystemClock()
        token.write_text(_TOKEN)
        token.chmod(0o600)
        settings = PageSettings(endpoint="http", port=0, token_file=str(token))
        page = PageEndpoint(settings, make_pilot(_settings()), Health(clock), clock, "a vehicle", Path(folder))
        serving = asyncio.ensure_future(page.run())
        while page.port is None and not serving.done():  # noqa: ASYNC110
            await asyncio.sleep(0)
        with suppress(OSError):
            await converse(await asyncio.open_connection("127.0.0.1", page.port), pieces)
        assert not serving.done(), "the page has ended"
        await ended(serving)


class _Page:
    """Interface of the endpoint for a viewer, over an empty folder of recordings."""

    def __init__(self, pilot: Pilot, folder: Path) -> None:
        self.pilot = pilot
        self.clock: Clock = SystemClock()
        self._recordings = Recordings(folder, self.clock)
        self._reports = ReportMaker(folder, lambda: False)

    def count(self, what: str) -> None:
        assert what

    def frame_encoder(self) -> FrameEncoder | None:
        return FrameEncoder(video_quality(PageSettings()))

    def list_recordings(self, viewer: PageViewer) -> None:
        viewer.tell(self._recordings.listed())

    def offer_recording(self, viewer: PageViewer, name: str) -> None:
        answer = self._recordings.ticket(name, flying=False)
        assert answer.address is None or (name.endswith(".mcap") and not set(name) & set("/\\\0")), f"an address for {name!r}"
        viewer.tell(answer)

    def make_report(self, viewer: PageViewer, name: str) -> None:
        self._reports.ask(viewer, name)

    def use_tool(self, viewer: PageViewer, request: ToolRequest) -> None:
        assert request


class _Socket:
    """A browser's websocket that sends messages and takes every answer."""

    def __init__(self, messages: list[WSMessage]) -> None:
        self._messages = messages
        self.closed = False

    async def __aiter__(self) -> AsyncIterator[WSMessage]:
        for message in self._messages:
            if not self.closed:
                yield message
                await asyncio.sleep(0)

    async def send_str(self, text: str) -> None:
        assert text

    async def send_bytes(self, message: bytes) -> None:
        assert message

    async def close(self, *, code: int, message: bytes) -> None:
        assert 4000 <= code < 5000
        assert message
        self.closed = True


def run_page_requests(data: bytes) -> None:
    """Send messages on a connection that is logged in: each is carried out, or the connection is closed with a reason."""
    choices = Choices(data)
    messages = []
    while choices:
        binary, content = choices.number(1) == 1, choices.block()
        text = content.decode("utf-8", "replace")
        messages.append(WSMessage(WSMsgType.BINARY, content, None) if binary else WSMessage(WSMsgType.TEXT, text, None))
    asyncio.run(watched(_logged_in(messages)))


async def _logged_in(messages: list[WSMessage]) -> None:
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
        pilot = make_pilot(_settings())
        socket = cast(web.WebSocketResponse, _Socket(messages))
        viewer = PageViewer(_Page(pilot, Path(folder)), socket, OrderSender(OrderSource.PAGE, "1"))
        async with asyncio.timeout(ANSWER_S):
            await viewer.serve()
        pilot.decide(SystemClock().now())


def operator_socket_seeds() -> Iterator[bytes]:
    """Yield a terminal's session, a line in two pieces, a line that is too long, and lines that are no requests."""
    orders = [OrderRequest(number=n, order=order) for n, order in enumerate(OperatorOrder)]
    sticks = SticksRequest(forward=0.5, turn=-1.0)
    yield block(line_of(WatchRequest())) + b"".join(block(line_of(order)) for order in orders[:3]) + block(line_of(sticks))
    yield block(b"".join(line_of(order) for order in orders))
    line = line_of(orders[0])
    yield block(line[:9]) + block(line[9:])
    yield block(b"x" * 1100 + b"\n")
    yield block(b'{"kind": "sticks", "forward": 1e999}\n[[[[\n\n')


def page_port_seeds() -> Iterator[bytes]:
    """Yield requests for files, a login with the right and with no token, and bytes that are not HTTP."""
    yield block(b"GET / HTTP/1.1\r\n" + HOST + b"\r\n")
    yield block(b"GET /recordings/abc HTTP/1.1\r\n" + HOST + b"\r\n") + block(b"GET /../token HTTP/1.1\r\n" + HOST + b"\r\n")
    live = upgrade(b"/live", b"Origin: http://127.0.0.1")
    login = _text(LoginRequest(token=_TOKEN))
    output = (websocket_frame(login), websocket_frame(_text(RecordingsRequest())), websocket_frame(b"", 8))
    yield block(live) + b"".join(block(one) for one in output)
    yield block(live) + block(websocket_frame(b"", 9)) + block(websocket_frame(b"\xff" * 2000))
    yield block(b"POST /live HTTP/1.1\r\nContent-Length: 99999\r\n" + HOST + b"\r\nabc")
    yield block(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03")


def page_requests_seeds() -> Iterator[bytes]:
    """Yield a session of orders and sticks, one of recordings, and messages that are no requests."""
    session: list[PageRequest] = [OrderRequest(number=n, order=order) for n, order in enumerate(OperatorOrder)]
    session += [SticksRequest(climb=-0.3), PictureRequest(codec="h264"), DrawnNotice(number=3), PictureRequest(codec="jpeg")]
    yield b"".join(b"\0" + block(_text(one)) for one in session)
    asked: list[PageRequest] = [RecordingsRequest()]
    asked += [DownloadRequest(name=name) for name in ("flight.mcap", "../token", "/etc/passwd", "")]
    yield b"".join(b"\0" + block(_text(one)) for one in asked)
    yield b"\0" + block(b'{"kind": "order"}') + b"\1" + block(b"\xff\xfe") + b"\0" + block(_text(LoginRequest(token="x")))


def _text(request: PageRequest) -> bytes:
    return line_of(cast(OrderRequest, request)).rstrip()


TARGETS = {
    "operator_socket": Target(run_operator_socket, operator_socket_seeds, 4096),
    "page_port": Target(run_page_port, page_port_seeds, 4096),
    "page_requests": Target(run_page_requests, page_requests_seeds, 4096),
}
