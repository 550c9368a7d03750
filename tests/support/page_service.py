"""The parts of a service that the operator page meets: its endpoint, the pilot and guidance cycles, without a vehicle."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import aiohttp
import numpy as np
from msgspec import structs

from companion.base.health import Health
from companion.base.http_server import ConnectionLimits, HttpServer
from companion.base.observer import ProcessedFrame
from companion.base.orders import HandledOrder
from companion.guidance.pilot import Pilot, make_pilot
from companion.parts.page import endpoint, recordings, viewer
from companion.parts.page.make import make_page
from companion.settings.load import load
from companion.settings.service import RecorderOptions
from companion.settings.settings_file import SettingsFile
from drivers.mavlink.autopilot import Autopilot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.samples import Frame, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from estimator.vision.detection import Detection
from tests.support.clocks import PatientClock
from tests.support.waiting import PATIENCE_S, listening, until

TOKEN = "a-token-of-sixteen-and-more"


class PageService:
    """See the module's docstring."""

    def __init__(
        self,
        folder: Path,
        limits: ConnectionLimits | None = None,
        autopilot: Autopilot | None = None,
        settings_file: Path | None = None,
        **settings: Any,
    ) -> None:
        token = folder / "token"
        token.write_text(TOKEN + "\n")
        token.chmod(0o600)
        given = {"endpoint": "http", "port": 0, "token_file": str(token)} | settings
        self.settings = structs.replace(
            load("sim"),
            http=structs.replace(load("sim").http, **given),
            recorder=RecorderOptions(folder=str(folder / "recordings")),
        )
        if autopilot is not None:
            self.settings = structs.replace(self.settings, vehicle=AutopilotOptions("udpin://127.0.0.1:0"))
        self.pilot: Pilot = make_pilot(self.settings)
        self.clock = PatientClock()
        self.health = Health(self.clock)
        self.server = HttpServer(self.settings.http, self.health, limits)
        file = None if settings_file is None else SettingsFile(settings_file)
        args = self.settings, self.pilot, self.health, self.clock, lambda: autopilot, file
        self.page = make_page(viewer.PageService(self.server, *args), "a vehicle")
        self.orders: list[HandledOrder] = []
        self.pilot.operator.on_order = self._on_order
        self.command: object = None
        self.commanded: set[type] = set()
        """The kinds of all commands so far: some are repeated for half a second only."""
        self.flying = True
        self.px = np.full((360, 640, 3), 90, np.uint8)
        """Image that the camera takes."""
        self.believed: RelativeState | None = None
        self.found: Detection | None = None
        """Estimate that guidance has in place of the estimator's, and detection in the frames."""
        self.cycles = 0
        self._frames = 0

    def _on_order(self, handled: HandledOrder) -> None:
        self.orders.append(handled)
        self.page.on_order(handled)

    async def live(self) -> None:
        """Run guidance cycles, each with a status of the vehicle and every third with a frame."""
        all_at = self.pilot.estimator.all_at

        def believed(instant: MonoNs) -> tuple[RelativeState, ...]:
            return all_at(instant) if self.believed is None else (self.believed,)

        self.pilot.estimator.all_at = believed  # type: ignore[method-assign]
        while True:
            now = self.clock.now()
            self.health.beat("Decision")
            self.pilot.on_sample(VehicleStatus(Stamp(now, now, 0.001, "arrival"), self.flying, "hovering", 0.5, False, True))
            decision = self.pilot.decide(now)
            self.page.on_decision(decision)
            self.command = decision.command
            self.commanded.add(type(decision.command))
            self.cycles += 1
            if self.cycles % 3 == 0:
                self.page.on_frame(self.frame(now))
            await asyncio.sleep(0.02)

    def counted(self, part: str, name: str) -> float:
        """Return a counter of a part; 0 before it counts."""
        return self.health.snapshot().counters[part].get(name, 0)

    async def lands(self) -> None:
        """Let the vehicle stand, and wait until the pilot knows it."""
        self.flying = False
        await until(lambda: self.pilot.vehicle is not None and self.pilot.vehicle.flying is False)

    def frame(self, now: MonoNs) -> ProcessedFrame:
        self._frames += 1
        frame = Frame(Stamp(now, now, 0.001, "arrival"), self._frames, self.px)
        return ProcessedFrame(frame, None, self.found, Verdict.NO_PAD, now, now)

    @property
    def address(self) -> str:
        return f"{self.settings.http.endpoint}://127.0.0.1:{self.server.port}"


@asynccontextmanager
async def serving(folder: Path, limits: ConnectionLimits | None = None, **settings: Any) -> AsyncIterator[PageService]:
    """Serve the page; at the end show that neither it nor guidance has failed."""
    service = PageService(folder, limits, **settings)
    # A browser of a test answers pings when the test reads, which may be seconds apart on a busy machine. A report's process of
    # the lowest priority would wait there until all other tests have ended.
    with patch.object(endpoint, "_ALIVE_S", PATIENCE_S), patch.object(recordings, "_NICE", 0):
        async with listening(service.server, service.page.run), asyncio.TaskGroup() as group:
            flying = group.create_task(service.live())
            yield service
            flying.cancel()


class Browser:
    """A websocket as a browser opens it, and what arrived on it."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = socket
        self.messages: list[dict[str, Any]] = []
        self.pictures: list[tuple[dict[str, Any], bytes]] = []
        self._number = 0

    async def send(self, **message: Any) -> None:
        await self.socket.send_str(json.dumps(message))

    async def read(self, kind: str) -> dict[str, Any]:
        """Read until a message of this kind, and return it."""
        async with asyncio.timeout(60):
            while True:
                message = await self.socket.receive()
                if message.type is aiohttp.WSMsgType.BINARY:
                    length = int.from_bytes(message.data[:4], "little")
                    self.pictures.append((json.loads(message.data[4 : 4 + length]), message.data[4 + length :]))
                    if kind == "picture":
                        return self.pictures[-1][0]
                    continue
                if message.type is not aiohttp.WSMsgType.TEXT:
                    return {"kind": "closed", "code": self.socket.close_code}
                self.messages.append(json.loads(message.data))
                if self.messages[-1]["kind"] == kind:
                    return self.messages[-1]

    async def order(self, order: str) -> dict[str, Any]:
        self._number += 1
        seen = next((m["at_s"] for m in reversed(self.messages) if m["kind"] == "state"), None)
        await self.send(kind="order", number=self._number, order=order, seen_at_s=seen)
        answer = await self.read("answer")
        assert answer["number"] == self._number
        return answer


@asynccontextmanager
async def browsing(service: PageService, token: str = TOKEN, origin: str | None = None, page: str = "") -> AsyncIterator[Browser]:
    """Connect as the page does."""
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"{service.address}/operator", origin=service.address if origin is None else origin) as socket,
    ):
        browser = Browser(socket)
        await browser.send(kind="login", token=token, page=page)
        yield browser
