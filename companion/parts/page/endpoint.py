"""The page's server: an observer of the flight and a supervised part beside it.

No cookie is set, so no other page can use a login: the token is the first message of a websocket, whose origin must be ours.
Until the token was right a connection is bounded in bytes and time, and the oldest gives way; a flood of such connections
therefore neither grows nor touches the browsers that are logged in.
"""

import asyncio
import logging
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from aiohttp import WSMsgType, web
from numpy.typing import NDArray

from companion.base.connection_limits import ConnectionLimits, listen
from companion.base.health import Health
from companion.base.mission import FAULTS, FLOWN
from companion.base.observer import Decision, NullObserver, ProcessedFrame
from companion.base.orders import HandledOrder, OrderSender, OrderSource
from companion.base.server_log import make_runner
from companion.base.things import ThingReport, things_of
from companion.base.wire import RequestRefused
from companion.base.worker import Worker
from companion.guidance.advice import advice
from companion.guidance.flight_state import FlightWatch
from companion.guidance.pilot import Pilot
from companion.parts.page import recordings
from companion.parts.page.access import HEADERS, own_names, refused_origin, token_of
from companion.parts.page.file_answer import assets, send_file
from companion.parts.page.messages import (
    MESSAGE_MAX,
    Level,
    LoginRequest,
    PageEvent,
    PageHealth,
    PageState,
    PageWelcome,
    PictureHeader,
    PictureLine,
    picture_message,
    request_in,
    text_of,
)
from companion.parts.page.recordings import Recordings, ReportMaker
from companion.parts.page.state import AHEAD_S, HORIZONS_S, jpeg, page_health, picture_lines, place, video_quality
from companion.parts.page.tool import Tool, flying
from companion.parts.page.tool_messages import ToolRequest
from companion.parts.page.viewer import ORDERS, PageViewer
from companion.recording.frame_encoder import FrameEncoder, codec_name
from companion.settings.page import PageSettings
from companion.settings.secret_files import is_token
from companion.settings.tls import server_context
from companion.tools.report.expected_place import camera_lean
from drivers.mailbox import Latest, Line
from drivers.pyav import has_pyav
from estimator.contracts.geometry import Rotation
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Attitude, Sample
from estimator.contracts.time import MonoNs, seconds_between

log = logging.getLogger(__name__)

WRONG_TOKEN_CODE, FULL_CODE, GOING_CODE = 4401, 4409, 1001
_STATE_S, _HEALTH_EACH = 0.1, 10
_LOGIN_S = 3.0
"""The time in which a connection must name the token."""
_WRONG_TOKEN_S = 1.0
"""A wrong token is answered after this time."""
_ALIVE_S = 4.0
"""Interval of pings to a browser, s; half of it without an answer ends the connection."""
_ATTITUDE_S = 1.0
_THINGS_S = 1.0
"""Time after the last frame that was searched for which things are shown."""
_LANDING_PHASES = frozenset(state.value for state in FLOWN)
_EVENTS = 60
"""Events that are kept for a browser that comes later."""


class PageEndpoint(NullObserver):
    """See the module's docstring.

    Args:
        vehicle: the vehicle's name for the page.
        recordings: the recorder's folder.
        tools: what the page offers beside the flight.

    Raises:
        BadInput: the token or the certificate cannot be read.
    """

    def __init__(
        self,
        settings: PageSettings,
        pilot: Pilot,
        health: Health,
        clock: Clock,
        vehicle: str,
        recordings: Path,
        limits: ConnectionLimits | None = None,
        tools: Sequence[Tool] = (),
    ) -> None:
        self._settings = settings
        self.pilot = pilot
        self.clock = clock
        self._health = health
        self._vehicle = vehicle
        camera = pilot.camera
        self._h264 = settings.picture_codec == "h264" and camera.width % 2 == camera.height % 2 == 0 and has_pyav()
        self._video = video_quality(settings)
        self._token, self._names = token_of(settings), own_names(settings)
        self._tls = server_context(settings)
        self._limits = limits or ConnectionLimits()
        self._assets = assets()
        self._tools = tuple(tools)
        self._recordings = Recordings(recordings, clock)
        self._reports = ReportMaker(recordings, lambda: self._flying)
        self._asking: Line[PageViewer] = Line(settings.viewers_max)
        self._flight = FlightWatch(pilot, clock)
        self._attitude: Attitude | None = None
        self._things: tuple[ThingReport, ...] = ()
        self._looked: MonoNs | None = None
        """Time when a frame was last searched."""
        self._viewers: list[PageViewer] = []
        self._frames: Latest[ProcessedFrame] = Latest()
        self._offered: MonoNs | None = None
        self._events: deque[PageEvent] = deque(maxlen=_EVENTS)
        self._counts: Counter[str] = Counter()
        self._began = clock.now()
        self.port: int | None = None
        """The port that the page listens on; None while it does not listen."""

    def count(self, what: str) -> None:
        """Count something for health."""
        self._counts[what] += 1

    def counted(self) -> Mapping[str, float]:
        """Return the counters for health."""
        return {**self._counts, "viewers": len(self._viewers), **self._limits.counts()}

    def on_sample(self, sample: Sample) -> None:
        if type(sample) is Attitude:
            self._attitude = sample
        self._flight.on_sample(sample)

    def on_decision(self, decision: Decision) -> None:
        self._flight.on_decision(decision)
        for change in decision.transitions:
            level: Level = "warning" if change.event in FAULTS else "info"
            todo = advice(change.target, change.reason) if change.event in FAULTS else ""
            self._tell(decision.at, level, f"{change.target.value}: {change.reason.text}", todo)

    def on_order(self, handled: HandledOrder) -> None:
        self._tell(handled.at, "info" if handled.accepted else "warning", str(handled))

    def on_frame(self, processed: ProcessedFrame) -> None:
        for tool in self._tools:
            tool.on_frame(processed)
        now = self.clock.now()
        if processed.detection is not None:
            self._things, self._looked = things_of(processed.detection), now
        due = self._offered is None or seconds_between(self._offered, now) >= 1.0 / self._settings.picture_rate_hz
        if due and any(viewer.ready for viewer in self._viewers):
            self._offered = now
            self._frames.offer(processed)

    async def run(self) -> None:
        """Serve until cancelled.

        Raises:
            Recoverable: the port is taken, or the address is none of this machine's.
        """
        app = web.Application(client_max_size=1024)
        app.router.add_get("/live", self._live)
        app.router.add_get("/recordings/{ticket}", self._recording)
        app.router.add_get("/reports/{ticket}", self._report)
        app.router.add_get("/{name:.*}", self._file)
        app.on_response_prepare.append(_secured)
        runner = make_runner(app)
        await runner.setup()
        worker = Worker("page")
        try:
            host, port = self._settings.host, self._settings.port
            server = await listen(runner, self._limits, host, port, "the page", self._tls)
            try:
                self.port = server.sockets[0].getsockname()[1]
                log.info("operator page on %s://%s:%d/", self._settings.endpoint, self._settings.host, self.port)
                async with asyncio.TaskGroup() as group:
                    group.create_task(self._send_states())
                    group.create_task(self._send_pictures(worker))
                    group.create_task(self._send_lists())
                    group.create_task(self._reports.run())
                    for tool in self._tools:
                        group.create_task(tool.run())
            finally:
                server.close()
        finally:
            self.port = None
            worker.close()
            for viewer in list(self._viewers):
                await viewer.close(GOING_CODE, "the service ends")
            await runner.cleanup()

    async def _file(self, request: web.Request) -> web.Response:
        asset = self._assets.get(request.path)
        if asset is None:
            return _missing("there is no such file")
        answer = web.Response(body=asset.body, headers={"Content-Type": asset.content_type})
        answer.force_close()  # a connection's time is bounded, and an idle one holds no descriptor
        return answer

    def frame_encoder(self) -> FrameEncoder | None:
        """Return a new encoder of H.264; None where pictures are sent as JPEG."""
        return FrameEncoder(self._video) if self._h264 else None

    def list_recordings(self, viewer: PageViewer) -> None:
        """Send this viewer the list of recordings soon."""
        self._asking.offer(viewer)

    def offer_recording(self, viewer: PageViewer, name: str) -> None:
        """Send this viewer an address for a recording, or why there is none."""
        viewer.tell(self._recordings.ticket(name, flying=self._flying))

    def make_report(self, viewer: PageViewer, name: str) -> None:
        """Make the report of a recording for this viewer, or report the reason for none."""
        self._reports.ask(viewer, name)

    def use_tool(self, viewer: PageViewer, request: ToolRequest) -> None:
        """Pass a request to the tool that answers it."""
        for tool in self._tools:
            if isinstance(request, tool.kinds):
                tool.ask(viewer, request)

    @property
    def _flying(self) -> bool:
        return flying(self.pilot)

    async def _send_lists(self) -> None:
        worker = Worker("page lists")
        try:
            async for viewer in self._asking:
                viewer.tell(await worker.run(self._recordings.listed))
        finally:
            worker.close()

    async def _recording(self, request: web.Request) -> web.StreamResponse:
        name = self._recordings.redeem(request.match_info["ticket"])
        if name is None:
            return _missing("this address holds once, and only for a short time")
        self.count("downloads")
        self._limits.lift(request.transport)
        return await self._recordings.send(request, name)

    async def _report(self, request: web.Request) -> web.StreamResponse:
        path = self._reports.path(request.match_info["ticket"])
        if path is None:
            return _missing("this report is no longer kept; ask for it again on the page")
        self.count("reports")
        self._limits.lift(request.transport)
        return await send_file(request, path, recordings.HEADERS)

    async def _live(self, request: web.Request) -> web.StreamResponse:
        why = refused_origin(request.headers.get("Origin"), request.headers.get("Host"), self._names)
        if why is not None:
            self.count("foreign_origins")
            answer = web.Response(status=403, text=f"{why}\n")
            answer.force_close()
            return answer
        socket = web.WebSocketResponse(max_msg_size=MESSAGE_MAX, compress=False, heartbeat=_ALIVE_S, timeout=1.0)
        if not socket.can_prepare(request).ok:
            answer = web.Response(status=426, text="this address is for a websocket\n", headers={"Upgrade": "websocket"})
            answer.force_close()
            return answer
        await socket.prepare(request)
        if not await self._knows_token(socket):
            return socket
        if len(self._viewers) >= self._settings.viewers_max:
            await _refuse(socket, FULL_CODE, f"{self._settings.viewers_max} browsers watch already, and there may be no more")
            return socket
        self._limits.lift(request.transport)
        await self._serve(socket, request.remote or "unknown")
        return socket

    async def _knows_token(self, socket: web.WebSocketResponse) -> bool:
        """Wait for the token; refuse whoever does not name it in time."""
        try:
            async with asyncio.timeout(_LOGIN_S):
                message = await socket.receive()
        except TimeoutError:
            await _refuse(socket, WRONG_TOKEN_CODE, f"no token within {_LOGIN_S:g} s")
            return False
        request = request_in(message.data) if message.type is WSMsgType.TEXT else ""
        if isinstance(request, LoginRequest) and is_token(request.token, self._token):
            return True
        if not socket.closed:
            self.count("wrong_tokens")
            if self._counts["wrong_tokens"] == 1:
                log.warning("a wrong token was given to the operator page; further ones are only counted")
            await asyncio.sleep(_WRONG_TOKEN_S)
            await _refuse(socket, WRONG_TOKEN_CODE, "the token is wrong")
        return False

    async def _serve(self, socket: web.WebSocketResponse, remote: str) -> None:
        self.count("opened")
        viewer = PageViewer(self, socket, OrderSender(OrderSource.PAGE, f"{self._counts['opened']} ({remote})"))
        viewer.tell(self._welcome(viewer))
        for event in self._events:
            viewer.tell(event)
        viewer.tell(self._health_report())
        self._viewers.append(viewer)
        try:
            await viewer.serve()
        finally:
            self._viewers.remove(viewer)

    def _welcome(self, viewer: PageViewer) -> PageWelcome:
        pad, camera = self.pilot.pad, self.pilot.camera
        return PageWelcome(
            you=str(viewer.sender),
            vehicle=self._vehicle,
            camera_px=(camera.width, camera.height),
            h264=self._h264,
            pad_lines_m=tuple(tuple((float(x), float(y)) for x, y, _ in line) for line in pad.borders()),
            pad_radius_m=pad.disc_radius_m,
        )

    async def _send_states(self) -> None:
        rounds = 0
        while True:
            await self.clock.sleep(_STATE_S)
            if self._viewers:
                if rounds % _HEALTH_EACH == 0:
                    health = self._health_report()
                    for viewer in self._viewers:
                        viewer.tell(health)
                self._tell_states()
            rounds += 1

    def _tell_states(self) -> None:
        now, decision = self.clock.now(), self._flight.decision
        belief = None if decision is None else decision.belief
        where = None if belief is None else place(belief, self.pilot.forecast(now, HORIZONS_S), now)
        roll = pitch = None
        if self._attitude is not None and seconds_between(self._attitude.stamp.received_at, now) < _ATTITUDE_S:
            roll, pitch, _ = self._attitude.R_ned_body.rpy_rad
        looks = self._looked is not None and seconds_between(self._looked, now) < _THINGS_S
        for viewer in self._viewers:
            flight = self._flight.state(viewer.sender)
            viewer.tell(
                PageState(
                    **{name: getattr(flight, name) for name in flight.__struct_fields__},
                    at_s=seconds_between(self._began, now),
                    landing=decision is not None and decision.phase in _LANDING_PHASES,
                    place=where,
                    things=self._things if looks else (),
                    roll_rad=roll,
                    pitch_rad=pitch,
                    refusals={order.value: self.pilot.operator.refusal(order, viewer.sender, now) for order in ORDERS},
                    picture_delay_s=viewer.picture_delay_s,
                )
            )

    def _health_report(self) -> PageHealth:
        return page_health(self._health.snapshot(), self._flight.decision, flying=self._flying)

    async def _send_pictures(self, worker: Worker) -> None:
        number, lean = 0, Rotation.identity()
        async for processed in self._frames:
            exposed = processed.frame.stamp.measured_at
            belief, ahead = self.pilot.believed(exposed), self.pilot.forecast(exposed, AHEAD_S)
            lean = camera_lean(processed, belief) or lean
            number += 1
            ready = [viewer for viewer in self._viewers if viewer.ready]
            self._counts["pictures_skipped"] += len(self._viewers) - len(ready)
            encoders = {viewer.encoder for viewer in ready}
            camera = processed.camera or self.pilot.camera
            lines = await worker.run(picture_lines, processed, belief, ahead, lean, camera, self.pilot.pad)
            messages = await worker.run(_messages, number, processed, lines, encoders, self._settings.jpeg_quality)
            for viewer in ready:
                # Nothing for one that has requested another codec meanwhile: the next picture is for it.
                if viewer.encoder in messages:
                    viewer.show(number, exposed, messages[viewer.encoder])

    def _tell(self, at: MonoNs, level: Level, text: str, todo: str = "") -> None:
        event = PageEvent(at_s=seconds_between(self._began, at), level=level, text=text, advice=todo)
        self._events.append(event)
        for viewer in self._viewers:
            viewer.tell(event)


def _encoded(image: NDArray[np.uint8], encoder: FrameEncoder | None, quality: int) -> tuple[str, bytes]:
    """Return codec and bytes of a picture; JPEG of one that H.264 does not take, as one of odd size."""
    if encoder is not None:
        with suppress(ValueError):
            unit = encoder.encoded(image)
            return codec_name(unit) or "", unit
    return "jpeg", jpeg(image, quality)


def _messages(
    number: int, processed: ProcessedFrame, lines: tuple[PictureLine, ...], encoders: set[FrameEncoder | None], quality: int
) -> dict[FrameEncoder | None, bytes]:
    """Return a picture's message by each encoder; None stands for JPEG."""
    messages = {}
    for encoder in encoders:
        codec, image = _encoded(processed.frame.px, encoder, quality)
        header = PictureHeader(number=number, verdict=processed.verdict.value, codec=codec, lines=lines)
        messages[encoder] = picture_message(header, image)
    return messages


async def _secured(request: web.Request, answer: web.StreamResponse) -> None:
    """Set the headers of every answer; one that has its own policy keeps it."""
    own = answer.headers.get("Content-Security-Policy")
    answer.headers.update(HEADERS)
    if own is not None:
        answer.headers["Content-Security-Policy"] = own


def _missing(why: str) -> web.Response:
    answer = web.Response(status=404, text=f"{why}\n")
    answer.force_close()
    return answer


async def _refuse(socket: web.WebSocketResponse, code: int, why: str) -> None:
    """Say why a connection is refused, and close it."""
    try:
        await socket.send_str(text_of(RequestRefused(text=why)))
        await socket.close(code=code, message=why.encode()[:120])
    except ConnectionError:
        pass
