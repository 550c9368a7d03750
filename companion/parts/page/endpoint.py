"""The operator page: an observer of the flight, and a supervised part that serves browsers.

No cookie is set, so no other page can use a login: the token is the first message of a websocket, whose origin must be ours.
Until the token was right a connection is bounded in bytes and time, and the oldest gives way; a flood of such connections
therefore neither grows nor touches the browsers that are logged in. A browser that has the hand and goes away leads to a hold;
nothing else changes by its going.
"""

import asyncio
import logging
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial

import cv2
import numpy as np
from aiohttp import WSMsgType, web
from msgspec import structs
from numpy.typing import NDArray

from companion.base.health import HealthSnapshot, missing_inputs
from companion.base.mission import FAULTS, FLOWN
from companion.base.observer import Decision, DeckOutlook, NullObserver, ProcessedFrame, ThingReport, things_of
from companion.base.orders import WORDS, HandledOrder, OperatorOrder, OrderSender, OrderSource
from companion.base.watchdog import stuck
from companion.base.worker import Worker
from companion.facts import encode as facts
from companion.facts.wire import OrderRequest, SticksRequest
from companion.guidance.advice import advice
from companion.guidance.pilot_operator import FlightWatch, PilotOperator
from companion.parts.page.access import own_names, refused_origin
from companion.parts.page.files import assets
from companion.parts.page.messages import (
    MESSAGE_MAX,
    DrawnNotice,
    HealthCause,
    Level,
    LoginRequest,
    PageEvent,
    PageHealth,
    PageRequest,
    PageState,
    PageWelcome,
    PictureHeader,
    PictureLine,
    PictureRequest,
    picture_message,
    request_in,
)
from companion.parts.page.viewer import PageService, PageViewer, Tool, refuse
from companion.recording.frame_encoder import FrameEncoder, VideoQuality, codec_name
from companion.tools.report.overlay import camera_lean, pad_lines, runs_of
from drivers.mailbox import Latest
from drivers.pyav import has_pyav
from estimator.contracts.estimates import RelativeState, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Sample
from estimator.contracts.time import MonoNs, seconds_between
from estimator.ekf import Forecast
from estimator.vision.camera.camera import Camera
from estimator.vision.pad.pad import Pad

log = logging.getLogger(__name__)

# The live picture: what the estimate says of a frame, as lines that the page draws itself, and the frame as JPEG. Pure.
# Lines instead of painted pixels stay sharp on any screen, can be switched off, and cost the drone's computer no drawing.

AHEAD_S = (1.0, 2.0)
"""Horizons at which the deck is drawn, s; the drone is assumed to keep its velocity."""
_CHI2_95 = 5.991
"""95 % quantile of the chi-square distribution with two degrees of freedom."""
_FAR_PX = 4000.0  # lines are cut so far outside the picture
_CIRCLE = np.linspace(0.0, math.tau, 36, endpoint=True)
WRONG_TOKEN_CODE = 4401
"""Close code of a websocket without the token."""
FULL_CODE = 4409
"""Close code where as many watch as may."""
GOING_CODE = 1001
"""Close code of a service that ends (RFC 6455)."""
_STATE_S = 0.1  # interval of the state
_HEALTH_EACH = 10  # health comes with each state of this number
_LOGIN_S = 3.0
"""The time in which a connection must name the token."""
_WRONG_TOKEN_S = 1.0
"""A wrong token is answered after this time."""
_ALIVE_S = 4.0
"""Interval of pings to a browser, s; half of it without an answer ends the connection."""
_ATTITUDE_S = 1.0  # age up to which an attitude is shown
_THINGS_S = 1.0
"""Time after the last frame that was searched for which things are shown."""
_EVENTS = 60
"""Events that are kept for a browser that comes later."""


def picture_lines(
    processed: ProcessedFrame, belief: RelativeState | None, ahead: Forecast | None, lean: Rotation, camera: Camera, pad: Pad
) -> Iterator[PictureLine]:
    """Yield what is drawn over a picture.

    Args:
        belief: the estimate at the exposure.
        ahead: the deck after the exposure.
        lean: see `camera_lean`.
    """
    found = processed.detection
    seen = None if found is None else found.selected or found.elsewhere
    for feature in () if seen is None else seen.features:
        if feature.kind != "point":
            for uv in _pieces(np.asarray(feature.uv_px, dtype=float).reshape(-1, 2), closed=feature.kind != "line"):
                yield PictureLine("seen", uv)
    if belief is None:
        return
    R_level_body = Rotation.identity() if processed.attitude is None else processed.attitude.R_ned_body.without_heading()
    R_level_body = R_level_body @ lean.inv
    for line in pad_lines(belief, R_level_body, camera, pad):
        for uv in _pieces(line, closed=True):
            yield PictureLine("pad", uv)
    to_cam, R_body_level = camera.T_body_cam.inv, R_level_body.inv
    on_deck = belief.d_body_pad_level + _ellipse(belief.cov[:2, :2])
    for uv in _pieces(camera.project(to_cam @ (R_body_level @ on_deck)), closed=False):
        yield PictureLine("sigma", uv)
    for d in () if ahead is None else ahead.d_body_pad_level:
        disc = pad.circle(pad.disc_radius_m, 36) + d
        for uv in _pieces(camera.project(to_cam @ (R_body_level @ disc)), closed=True):
            yield PictureLine("ahead", uv)


def _ellipse(cov: F64) -> F64:
    """Return (36, 3) m: the ellipse that holds 95 % of a (2, 2) covariance, around the origin."""
    variances, axes = np.linalg.eigh(cov)
    radii = np.sqrt(_CHI2_95 * np.maximum(variances, 0.0))
    xy = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1) * radii @ axes.T
    return np.concatenate([xy, np.zeros((len(xy), 1))], axis=1)


def _pieces(uv_px: F64, *, closed: bool) -> Iterator[tuple[float, ...]]:
    """Yield a line of (n, 2) points in pieces, without the points that are nan or far off."""
    for run in runs_of(uv_px, _FAR_PX, closed=closed):
        yield tuple(np.round(run, 1).ravel().tolist())


HORIZONS_S = tuple(0.25 * k for k in range(13))
"""Instants at which the deck's height is shown ahead, s."""
_FLOWS = (("Frame", "camera"), ("Attitude", "attitude"), ("VehicleStatus", "status"))
_STAGES = (("look", "picture searched in"), ("exposure_to_command", "picture to command"), ("guidance_late", "guidance late by"))


def _causes(health: HealthSnapshot, decision: Decision | None, *, flying: bool) -> Iterator[HealthCause]:
    why = stuck(health, flying)
    if why is not None:
        yield HealthCause(level="fault", text=why)
    for name, part in health.parts.items():
        if not part.up:
            level: Level = "fault" if name in health.vital else "warning"
            yield HealthCause(level=level, text=f"{name}: {part.last_error or 'not begun'}")
    for text in missing_inputs(health):
        yield HealthCause(level="fault" if flying else "warning", text=text)
    if health.too_slow is not None:
        yield HealthCause(level="fault", text=health.too_slow)
    belief = None if decision is None else decision.belief
    for text in () if belief is None else (*(alert.value for alert in belief.alerts), *belief.lost):
        yield HealthCause(level="warning", text=text)
    if belief is not None and not belief.consistent and not belief.alerts:
        yield HealthCause(level="warning", text="the estimate of the pad contradicts itself")
    if decision is not None and decision.limit:
        yield HealthCause(level="warning", text=decision.limit)
    for name, count in health.counters.get("contained", {}).items():
        yield HealthCause(level="info", text=f"{name} failed {count:.0f} times; the flight goes on")


def _figures(health: HealthSnapshot) -> Iterator[tuple[str, str]]:
    for flow, name in _FLOWS:
        found = health.flows.get(flow)
        rate = None if found is None else found.rate_hz
        yield name, "none" if rate is None else f"{rate:.0f} Hz"
    for stage, name in _STAGES:
        times = health.stages.get(stage)
        if times is not None and times.p50_s is not None and times.p99_s is not None:
            yield name, f"{1000 * times.p50_s:.0f} ms, worst {1000 * times.p99_s:.0f} ms"
    frames = sum(health.frames.values())
    if frames:
        yield "frames used", f"{100 * health.frames.get(Verdict.FUSED.value, 0) / frames:.0f} % of {frames}"


ORDERS = tuple(order for order in OperatorOrder if order is not OperatorOrder.RECORD)
"""The orders that the page may give."""
_NO_WEBSOCKET = "this address is for a websocket; a reverse proxy must pass Upgrade and Connection on, over HTTP/1.1\n"
_LANDING_PHASES = frozenset(state.value for state in FLOWN)


class PageEndpoint(NullObserver):
    """See the module's docstring.

    Args:
        vehicle: the vehicle's name for the page.
        tools: what the page offers beside the flight.
    """

    def __init__(self, service: PageService, vehicle: str, tools: Sequence[Tool]) -> None:
        server, pilot, clock, camera = service.server, service.pilot, service.clock, service.pilot.camera
        self._service = service
        self._server = server
        self._settings = server.settings
        self._pilot = pilot
        self._clock = clock
        self._vehicle = vehicle
        self._h264 = server.settings.picture_codec == "h264" and camera.width % 2 == camera.height % 2 == 0 and has_pyav()
        self._tools = tools
        self._quality = VideoQuality(crf=26, key_each=300, preset="ultrafast", kbit_s=server.settings.bitrate_kbit_s)
        """Little work for the encoder of each browser, and a key frame only where it begins."""
        self._flight = FlightWatch(pilot, clock)
        self._attitude: Attitude | None = None
        self._things: tuple[ThingReport, ...] = ()
        self._looked: MonoNs | None = None
        """Time when a frame was last searched."""
        self._viewers: list[PageViewer] = []
        self._frames: Latest[ProcessedFrame] = Latest()
        self._offered: MonoNs | None = None
        self._advice = "", ""
        """The mission's newest state, and the advice on it: it holds for no other, such as flight by hand."""
        self._events: deque[PageEvent] = deque(maxlen=_EVENTS)
        self._names: dict[str, str] = {}
        """Name of each page's first connection, under which it orders over all of them."""
        self._counts = service.counts
        self._began = clock.now()
        service.health.counters("page", lambda: self._counts)
        server.serve("/operator", self._operate)
        for path, asset in assets().items():
            server.serve(path, asset.answer)

    def on_sample(self, sample: Sample) -> None:
        if type(sample) is Attitude:
            self._attitude = sample
        self._flight.on_sample(sample)

    def on_decision(self, decision: Decision) -> None:
        self._flight.on_decision(decision)
        for change in decision.transitions:
            level: Level = "warning" if change.event in FAULTS else "info"
            todo = advice(change.target, change.reason) if change.event in FAULTS else ""
            phase, self._advice = WORDS["phases"].get(change.target.value, change.target.value), (change.target.value, todo)
            self._tell(decision.at, level, f"{phase}: {change.reason.text}", todo)

    def on_order(self, handled: HandledOrder) -> None:
        outcome = str(handled).removeprefix(f"{handled.sender}: {handled.order.value}")
        named = WORDS["orders"].get(handled.order.value, handled.order.value)
        self._tell(handled.at, "info" if handled.accepted else "warning", f"{handled.sender}: {named}{outcome}")

    def on_frame(self, processed: ProcessedFrame) -> None:
        for tool in self._tools:
            tool.on_frame(processed)
        now = self._clock.now()
        if processed.detection is not None:
            self._things, self._looked = things_of(processed.detection), now
        due = self._offered is None or seconds_between(self._offered, now) >= 1.0 / self._settings.picture_rate_hz
        if due and any(viewer.ready for viewer in self._viewers):
            self._offered = now
            self._frames.offer(processed)

    async def run(self) -> None:
        """Send states and pictures, and let the tools work, until cancelled."""
        worker = Worker("page")
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._send_states())
                group.create_task(self._send_pictures(worker))
                for tool in self._tools:
                    group.create_task(tool.run())
        finally:
            worker.close()
            for viewer in list(self._viewers):
                await refuse(viewer.socket, GOING_CODE, f"the service has ended: {self._service.left_alone}")

    def _take(self, viewer: PageViewer, request: PageRequest) -> str | None:
        """Carry a browser's request out; return why it is refused, which ends the connection."""
        match request:
            case OrderRequest():
                operator = PilotOperator(self._pilot, viewer.sender, self._clock)
                viewer.tell(operator.answer(request, seconds_between(self._began, self._clock.now())))
            case SticksRequest():
                self._pilot.operator.move(viewer.sender, request.positions, self._clock.now())
            case DrawnNotice():
                viewer.drawn(request.number)
            case PictureRequest():
                # A frame that is lost to the browser's decoder would be missing in all that follow: it asks again.
                encodes = request.codec == "h264" and self._h264
                viewer.begin_pictures(FrameEncoder(self._quality) if encodes else None)
            case LoginRequest():
                return "this page is logged in already"
            case _:
                for tool in self._tools:
                    if isinstance(request, tool.kinds):
                        tool.ask(viewer, request)
        return None

    async def _operate(self, request: web.Request) -> web.StreamResponse:
        why = refused_origin(request.headers, own_names(self._settings))
        if why is not None:
            self._server.counts["foreign_origins"] += 1
            if self._server.counts["foreign_origins"] == 1:  # a browser shows a script no reason
                log.warning("the page is refused: %s; further ones are only counted", why)
            return web.Response(status=403, text=f"{why}\n")
        socket = web.WebSocketResponse(max_msg_size=MESSAGE_MAX, compress=False, heartbeat=_ALIVE_S, timeout=1.0)
        if not socket.can_prepare(request).ok:
            return web.Response(status=426, text=_NO_WEBSOCKET, headers={"Upgrade": "websocket"})
        await socket.prepare(request)
        login = await self._login(socket)
        if login is None:
            return socket
        if self._server.full:
            await refuse(socket, FULL_CODE, f"{self._server.viewers} watch already, and there may be no more")
            return socket
        with self._server.watched_by(request):
            name = f"{self._server.counts['opened']} ({request.remote or 'unknown'})"
            sender = OrderSender(OrderSource.PAGE, self._names.setdefault(login.page or name, name))
            viewer = PageViewer(socket, sender, self._clock, self._counts)
            await self._serve(viewer)
        return socket

    async def _login(self, socket: web.WebSocketResponse) -> LoginRequest | None:
        """Wait for the token; refuse a browser that does not name it in time."""
        try:
            async with asyncio.timeout(_LOGIN_S):
                message = await socket.receive()
        except TimeoutError:
            await refuse(socket, WRONG_TOKEN_CODE, f"no token within {_LOGIN_S:g} s")
            return None
        request = request_in(message.data) if message.type is WSMsgType.TEXT else ""
        if socket.closed:
            return None
        login = request if isinstance(request, LoginRequest) else LoginRequest(token="")
        if self._server.knows(login.token):
            return login
        await asyncio.sleep(_WRONG_TOKEN_S)
        await refuse(socket, WRONG_TOKEN_CODE, "the token is wrong")
        return None

    async def _serve(self, viewer: PageViewer) -> None:
        viewer.tell(self._welcome(viewer))
        for event in self._events:
            viewer.tell(event)
        viewer.tell(self._health_report())
        self._viewers.append(viewer)
        try:
            await viewer.serve(partial(self._take, viewer))
        finally:
            self._viewers.remove(viewer)
            if all(other.sender != viewer.sender for other in self._viewers):
                self._pilot.operator.lost(viewer.sender, self._clock.now(), "its page closed")

    def _welcome(self, viewer: PageViewer) -> PageWelcome:
        pad, camera = self._pilot.pad, self._pilot.camera
        return PageWelcome(
            you=str(viewer.sender),
            run=str(self._began),
            vehicle=self._vehicle,
            camera_px=(camera.width, camera.height),
            h264=self._h264,
            pad_lines_m=tuple(tuple((float(x), float(y)) for x, y, _ in line) for line in pad.borders()),
            pad_radius_m=pad.disc_radius_m,
            words=WORDS,
        )

    async def _send_states(self) -> None:
        rounds = 0
        while True:
            await self._clock.sleep(_STATE_S)
            if self._viewers:
                if rounds % _HEALTH_EACH == 0:
                    health = self._health_report()
                    for viewer in self._viewers:
                        viewer.tell(health)
                self._tell_states()
            rounds += 1

    def _tell_states(self) -> None:
        now, decision, (advised, todo) = self._clock.now(), self._flight.decision, self._advice
        belief, ahead = self._flight.belief(now), self._pilot.estimator.forecast(now, HORIZONS_S)
        roll = pitch = None
        if self._attitude is not None and seconds_between(self._attitude.stamp.received_at, now) < _ATTITUDE_S:
            roll, pitch, _ = self._attitude.R_ned_body.rpy_rad
        looks = self._looked is not None and seconds_between(self._looked, now) < _THINGS_S
        slow = self._service.health.too_slow is not None  # health says so, and another advice would lead away from it
        for viewer in self._viewers:
            flight = self._flight.state(viewer.sender)
            why = {order.value: self._pilot.operator.refusal(order, viewer.sender, now) for order in ORDERS}
            viewer.tell(
                PageState(
                    **{name: getattr(flight, name) for name in flight.__struct_fields__},
                    at_s=seconds_between(self._began, now),
                    advice=viewer.sender.reads(todo) if flight.phase == advised and not slow else "",
                    landing=decision is not None and decision.phase in _LANDING_PHASES,
                    belief=None if belief is None else structs.replace(facts.belief(belief), details=[]),
                    deck=None if ahead is None else facts.deck(DeckOutlook.of(ahead)),
                    things=self._things if looks else (),
                    roll_rad=roll,
                    pitch_rad=pitch,
                    refusals={order: text and viewer.sender.reads(text) for order, text in why.items()},
                    picture_delay_s=viewer.picture_delay_s,
                )
            )

    def _health_report(self) -> PageHealth:
        """Return what is wrong, the worst first, and the figures of the service."""
        health, worst_first = self._service.health.snapshot(), ("fault", "warning", "info")
        causes = list(_causes(health, self._flight.decision, flying=self._service.flying))
        causes.sort(key=lambda cause: worst_first.index(cause.level))
        sensors = ((f"motion sensor {s.sensor}", s.text) for s in self._pilot.estimator.ship_motion.standings())
        return PageHealth(causes=tuple(causes), figures=(*_figures(health), *sensors))

    async def _send_pictures(self, worker: Worker) -> None:
        number, lean = 0, Rotation.identity()
        async for processed in self._frames:
            exposed = processed.frame.stamp.measured_at
            belief, ahead = self._pilot.estimator.at(exposed), self._pilot.estimator.forecast(exposed, AHEAD_S)
            lean = camera_lean(processed, belief) or lean
            number += 1
            ready = [viewer for viewer in self._viewers if viewer.ready]
            self._counts["pictures_skipped"] += len(self._viewers) - len(ready)
            encoders = {viewer.encoder for viewer in ready}
            camera = processed.camera or self._pilot.camera
            lines = partial(picture_lines, processed, belief, ahead, lean, camera, self._pilot.pad)
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
    return "jpeg", cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def _messages(
    number: int,
    processed: ProcessedFrame,
    lines: Callable[[], Iterator[PictureLine]],
    encoders: set[FrameEncoder | None],
    quality: int,
) -> dict[FrameEncoder | None, bytes]:
    """Return a picture's message by each encoder; None stands for JPEG."""
    messages, drawn = {}, tuple(lines())
    for encoder in encoders:
        codec, image = _encoded(processed.frame.px, encoder, quality)
        header = PictureHeader(number=number, verdict=processed.verdict.value, codec=codec, lines=drawn)
        messages[encoder] = picture_message(header, image)
    return messages
