"""Foxglove's live data over real sockets, of the real pilot in a simulated flight: what comes, who is refused, and the layout."""

import asyncio
import base64
import json
import re
import struct
from collections import defaultdict
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import aiohttp
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader

from companion.base.health import Health
from companion.base.http_server import HttpServer
from companion.base.observer import Observer
from companion.base.worker import Worker
from companion.cli.main import main
from companion.guidance.pilot import make_pilot
from companion.parts.live import part
from companion.parts.live.options import LiveHttp
from companion.parts.live.part import FoxgloveEndpoint
from companion.parts.recorder.recorder import Recorder
from companion.parts.recorder.setup import about, recorder_to_file
from companion.recording import foxglove_protocol as protocol
from companion.recording.frame_encoder import is_key_frame
from drivers.clock import SystemClock
from sitl.ardrone.flight import Flight
from sitl.scenario.scenario import load as load_scenario
from tests.fly import sim_settings
from tests.support.waiting import PATIENCE_S, listening, until

TOKEN = "a-token-of-more-than-sixteen"


class Service:
    """The endpoint beside a simulated flight."""

    def __init__(self, recorder: Recorder | None, **settings: Any) -> None:
        whole = sim_settings()
        pilot = make_pilot(whole, shadows=("median_mean",))
        clock = SystemClock()
        health = Health(clock)
        own = LiveHttp(endpoint="http", page=False, **{"port": 0, **settings})
        self.server = HttpServer(own, health)
        self.endpoint = FoxgloveEndpoint(self.server, own, pilot, health, clock, "drone", 0)
        observers: list[Observer] = [self.endpoint.feed] if recorder is None else [recorder, self.endpoint.feed]
        self.flight = Flight(load_scenario("demo"), 1, whole, pilot, observers=observers)

    async def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.005)):
            self.flight.step()
            await asyncio.sleep(0.0005)

    @property
    def address(self) -> str:
        return f"ws://127.0.0.1:{self.server.port}/live"

    def counted(self, name: str) -> float:
        return {**self.server.counted(), **self.endpoint.counted()}.get(name, 0.0)


@asynccontextmanager
async def serve_live(recorder: Recorder | None = None, **settings: Any) -> AsyncIterator[Service]:
    service = Service(recorder, **settings)
    # A viewer here answers pings when the test reads, which may be seconds apart on a busy machine.
    with patch.object(part, "_ALIVE_S", PATIENCE_S):
        async with listening(service.server, service.endpoint.run):
            yield service


class Client:
    """A viewer as the protocol describes one."""

    def __init__(self, opened: aiohttp.ClientWebSocketResponse) -> None:
        self.socket = opened
        self.texts: list[dict[str, Any]] = []
        self.channels: dict[str, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, Any]]] = defaultdict(list)
        self._topics: dict[int, str] = {}

    async def subscribe(self, *topics: str) -> None:
        asked = []
        for topic in topics:
            number = 1000 + len(self._topics)
            self._topics[number] = topic
            asked.append({"id": number, "channelId": self.channels[topic]["id"]})
        await self.say(op="subscribe", subscriptions=asked)

    async def say(self, **fields: Any) -> None:
        await self.socket.send_str(json.dumps(fields))

    async def read(self) -> aiohttp.WSMessage:
        async with asyncio.timeout(PATIENCE_S):
            message = await self.socket.receive()
        if message.type is aiohttp.WSMsgType.TEXT:
            text = json.loads(message.data)
            self.texts.append(text)
            if text["op"] == "advertise":
                self.channels |= {channel["topic"]: channel for channel in text["channels"]}
        elif message.type is aiohttp.WSMsgType.BINARY:
            opcode, number, at_ns = struct.unpack_from("<BIQ", message.data)
            assert opcode == 1
            self.messages[self._topics[number]].append((at_ns, message.data[13:]))
        return message

    async def told(self, op: str) -> dict[str, Any]:
        while not any(text["op"] == op for text in self.texts):
            assert (await self.read()).type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), "closed"
        return next(self.texts.pop(k) for k, text in enumerate(self.texts) if text["op"] == op)

    async def drain(self, *topics: str) -> None:
        """Read until there is a message of each of these topics."""
        while not all(self.messages[topic] for topic in topics):
            await self.read()


@asynccontextmanager
async def watching(
    service: Service, query: str = "", protocols: tuple[str, ...] = ("foxglove.sdk.v1",), **headers: str
) -> AsyncIterator[Client]:
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(service.address + query, protocols=protocols, headers=headers, max_msg_size=0) as opened,
    ):
        client = Client(opened)
        assert (await client.read()).type is aiohttp.WSMsgType.TEXT
        yield client


async def test_a_viewer_gets_the_very_messages_of_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    settings = sim_settings()
    with recorder_to_file(path, make_pilot(settings).camera, about(settings, {"kind": "test"})) as recorder:
        async with serve_live(recorder=recorder) as service, watching(service) as client:
            info = await client.told("serverInfo")
            assert (info["name"], info["capabilities"]) == ("drone", [])
            await client.told("advertise")
            assert client.channels["/tf"]["schemaName"] == "foxglove.FrameTransforms"
            assert json.loads(client.channels["/decision"]["schema"])["title"] == "decklander.Decision"
            assert "/truth" not in client.channels
            wanted = (
                "/decision", "/belief/dead_reckoning", "/sample/imu", "/tf", "/tf_static", "/camera/image", "/fusion/sighting",
            )  # fmt: skip
            await client.subscribe(*wanted)
            await until(lambda: service.counted("viewers") == 1 and len(service.endpoint.feed._wanted) == len(wanted))
            flying = asyncio.create_task(service.fly(1.2))
            while not flying.done() or service.endpoint._viewers[0]._waiting:
                try:
                    async with asyncio.timeout(0.3):
                        await client.read()
                except TimeoutError:
                    pass
            await flying
            assert service.counted("events_dropped") == service.counted("slow_dropped") == 0.0
    recorded: dict[str, set[tuple[int, bytes]]] = defaultdict(set)
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            recorded[channel.topic].add((message.log_time, message.data))
    assert set(client.messages) >= set(wanted)
    for topic in ("/decision", "/belief/dead_reckoning", "/sample/imu", "/fusion/sighting"):
        assert len(client.messages[topic]) > 20
        assert set(client.messages[topic]) <= recorded[topic], topic
    assert {json.loads(data)["transforms"][1]["child_frame_id"] for _, data in client.messages["/tf_static"]} == {"cam"}
    image = json.loads(client.messages["/camera/image"][0][1])
    px = cv2.imdecode(np.frombuffer(base64.b64decode(image["data"]), np.uint8), cv2.IMREAD_COLOR)
    assert px.shape == (360, 640, 3)
    times = [at for at, _ in client.messages["/camera/image"]]
    assert min(np.diff(times)) >= 0.9e9 / 15.0, "no more pictures than were requested"


async def test_a_late_viewer_gets_the_latched_topics_and_a_video_from_a_key_frame() -> None:
    async with serve_live(foxglove_frames="h264") as service, watching(service) as first:
        await first.told("advertise")
        assert "/camera/image" not in first.channels
        await first.subscribe("/camera/video")
        await until(lambda: bool(service.endpoint.feed._wanted))
        await service.fly(0.4)
        async with watching(service, protocols=("foxglove.websocket.v1",)) as late:
            assert late.socket.protocol == "foxglove.websocket.v1"
            await late.told("advertise")
            await late.subscribe("/camera/video", "/tf_static", "/scene", "/camera/calibration", "/log")
            await until(lambda: len(service.endpoint.feed._wanted) == 5)
            await service.fly(0.15)
            await late.drain("/camera/video", "/tf_static", "/scene", "/camera/calibration", "/log")
        assert is_key_frame(base64.b64decode(json.loads(late.messages["/camera/video"][0][1])["data"]))
        await until(lambda: service.endpoint.feed._wanted == {"/camera/video"})


async def test_nothing_is_taken_that_nobody_requested() -> None:
    async with serve_live() as service, watching(service) as client:
        await client.told("advertise")
        await service.fly(0.1)
        assert service.endpoint.feed._events.offered == 0
        await client.subscribe("/sample/range")
        await until(lambda: bool(service.endpoint.feed._wanted))
        await client.say(op="unsubscribe", subscriptionIds=[1000])
        await until(lambda: not service.endpoint.feed._wanted)
        await service.fly(0.1)
        assert service.endpoint.feed._events.offered == 0


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("{", "not understood"),
        ("[]", "not understood"),
        ('{"op":"getParameters","parameterNames":[]}', "not understood"),
        ('{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}', "not understood"),
        ('{"op":"subscribe","subscriptions":[{"id":1,"channelId":999}]}', "there is no channel 999"),
        (
            '{"op":"subscribe","subscriptions":[{"id":1,"channelId":1},{"id":1,"channelId":2}]}',
            "there is a subscription 1 already",
        ),
        ('{"op":"unsubscribe","subscriptionIds":[5]}', "there is no subscription 5"),
        (b"\x01\x00\x00\x00\x00data", "publishing is not offered"),
    ],
)
async def test_garbage_is_counted_and_reported_and_ends_nothing(said: str | bytes, why: str) -> None:
    async with serve_live() as service, watching(service) as client, watching(service) as other:
        await client.told("advertise")
        await (client.socket.send_str(said) if isinstance(said, str) else client.socket.send_bytes(said))
        status = await client.told("status")
        assert status["level"] == 2
        assert why in status["message"]
        assert service.counted("refused") == 1
        await other.told("advertise")
        await other.subscribe("/decision")
        await until(lambda: "/decision" in service.endpoint.feed._wanted)
        await service.fly(0.05)
        await other.drain("/decision")


async def test_a_flood_and_a_huge_message_end_their_own_connection_alone() -> None:
    async with serve_live() as service, watching(service) as other:
        for flood in (["{"] * (part._REFUSALS_MAX + 5), ['{"op":"unsubscribe","subscriptionIds":[]}'] * 400, ["x" * 70_000]):
            async with watching(service) as client:
                for output in flood:
                    if not client.socket.closed:
                        await client.socket.send_str(output)
                async with asyncio.timeout(PATIENCE_S):
                    while (await client.socket.receive()).type not in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED):
                        pass
            await until(lambda: service.counted("viewers") == 1)
        await other.told("advertise")


async def test_a_slow_viewer_loses_the_oldest_and_delays_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part, "_WAITING_BYTES", 300_000)
    async with serve_live() as service, watching(service) as slow, watching(service) as quick:
        for client in (slow, quick):
            await client.told("advertise")
            await client.subscribe("/decision")
        await until(lambda: all(v.wanted for v in service.endpoint._viewers))
        slow.socket._conn.transport.pause_reading()
        for k in range(120):
            service.endpoint._show([("/decision", k, b"x" * 100_000)])
            while len(quick.messages["/decision"]) <= k:
                await quick.read()
        assert service.counted("slow_dropped") > 30
        assert max(v._waiting_bytes for v in service.endpoint._viewers) <= 300_000
        slow.socket._conn.transport.resume_reading()
        while not slow.messages["/decision"] or slow.messages["/decision"][-1][0] != 119:
            await slow.read()
        numbers = [at for at, _ in slow.messages["/decision"]]
        assert numbers == sorted(numbers)


async def test_a_thread_that_is_behind_costs_events_and_never_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    held = asyncio.Event()

    async def stuck(*_: object) -> list[object]:
        await held.wait()
        return []

    monkeypatch.setattr(Worker, "run", stuck)
    monkeypatch.setattr(part, "_EVENTS", 50)
    async with serve_live() as service, watching(service) as client:
        await client.told("advertise")
        await client.subscribe("/sample/imu", "/camera/image", "/decision")
        await until(lambda: bool(service.endpoint.feed._wanted))
        reading = asyncio.create_task(client.read())
        await service.fly(0.6)
        assert len(service.endpoint.feed._events) == 50
        assert service.counted("events_dropped") > 50
        assert service.counted("frames_dropped") > 3
        reading.cancel()


async def test_without_the_token_nothing_is_reported(tmp_path: Path) -> None:
    (tmp_path / "token").write_text(TOKEN)
    async with serve_live(token_file=str(tmp_path / "token")) as service:
        for query, headers in (
            ("", {}),
            ("?token=wrong-token-of-sixteen", {}),
            (f"?token={TOKEN}x", {}),
            ("", {"Authorization": "Bearer x"}),
        ):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                async with watching(service, query, **headers):
                    pass
            assert refused.value.status == 401
        assert service.counted("wrong_tokens") == 4
        async with watching(service, f"?token={TOKEN}", Origin="http://anywhere.example") as client:
            await client.told("advertise")
        async with watching(service, Authorization=f"Bearer {TOKEN}") as client:
            await client.told("advertise")


async def test_a_page_that_is_not_named_cannot_connect_from_a_browser_here() -> None:
    async with serve_live() as service:
        for origin in ("http://evil.example", "null", "http://127.0.0.1:1", "https://app.foxglove.dev.evil.example"):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                async with watching(service, Origin=origin):
                    pass
            assert refused.value.status == 403
        assert service.counted("foreign_origins") == 4
        async with watching(service, Origin="https://app.foxglove.dev") as client:
            await client.told("advertise")


async def test_a_connection_of_another_protocol_or_one_too_many_is_refused() -> None:
    async with serve_live(viewers_max=1) as service:
        for protocols, status in (((), 426), (("mqtt",), 426)):
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                async with watching(service, protocols=protocols):
                    pass
            assert refused.value.status == status
        async with watching(service) as client:
            await client.told("advertise")
            with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
                async with watching(service):
                    pass
            assert refused.value.status == 503


@given(st.text(max_size=200))
def test_no_text_makes_the_decoder_raise(text: str) -> None:
    assert isinstance(protocol.request_in(text), str | protocol.Subscribe | protocol.Unsubscribe)


ROOT = Path(__file__).parents[3]
LAYOUT: dict[str, Any] = json.loads((ROOT / "configs/viewer/foxglove.json").read_text())
PANELS: dict[str, Any] = LAYOUT["configById"]
DRAWN_IN_3D = {"foxglove.SceneUpdate", "foxglove.PoseInFrame", "foxglove.PosesInFrame", "foxglove.FrameTransforms"}
IMAGES = {"foxglove.CompressedImage", "foxglove.CompressedVideo", "foxglove.RawImage"}
PATH = re.compile(r'(?P<topic>/[\w/]+)(?:\{(?P<key>\w+)==(?P<value>"[^"]*"|[\w.-]+)\})?(?P<fields>(?:\.\w+|\[\d+\])*)')
"""A message path: a topic, a filter by one field, and fields and indices. Source: docs.foxglove.dev, message path syntax."""
Messages = dict[str, list[dict[str, Any]]]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, str], Messages]:
    """Return the schema of each topic of a simulated landing's first seconds, and its messages."""
    path = tmp_path_factory.mktemp("layout") / "flight.mcap"
    assert main(["simulate", "demo", "--seed", "1", "--set", "duration_limit_s=2.5", "--record", str(path)]) == 1
    kinds: dict[str, str] = {}
    messages: Messages = defaultdict(list)
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            kinds[channel.topic] = schema.name
            messages[channel.topic].append(json.loads(message.data))
    return kinds, messages


def layout_values(path: str, messages: Messages) -> list[Any]:
    """Return what a message path finds in the messages."""
    found = PATH.fullmatch(path)
    assert found is not None, f"{path} is no message path"
    steps = [int(i) if i else name for name, i in re.findall(r"\.(\w+)|\[(\d+)\]", found["fields"])]
    out = []
    for message in messages[found["topic"]]:
        if found["key"] is not None and message.get(found["key"]) != json.loads(found["value"]):
            continue
        value: Any = message
        for step in steps:
            there = value is not None and (step < len(value) if isinstance(step, int) else step in value)
            value = value[step] if there else None
        out += [] if value is None else [value]
    return out


def panels_of(kind: str) -> list[tuple[str, Any]]:
    return [(name, config) for name, config in PANELS.items() if name.partition("!")[0] == kind]


def leaves(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else [*leaves(node["first"]), *leaves(node["second"])]


def test_each_panel_stands_once_in_the_layout() -> None:
    assert sorted(leaves(LAYOUT["layout"])) == sorted(PANELS)
    assert {name.partition("!")[0] for name in PANELS} == {"3D", "Image", "Plot", "StateTransitions", "RosOut"}


def test_plots_and_states_find_values_in_a_recording(recorded: tuple[dict[str, str], Messages]) -> None:
    _, messages = recorded
    plotted = [path["value"] for _, config in panels_of("Plot") for path in config["paths"]]
    assert len(plotted) > 5
    for path in plotted:
        found = layout_values(path, messages)
        assert len(found) > 10, path
        assert all(isinstance(value, int | float) for value in found), path
    for path in [path["value"] for _, config in panels_of("StateTransitions") for path in config["paths"]]:
        assert {type(value) for value in layout_values(path, messages)} == {str}, path


def test_images_scenes_and_logs_are_of_the_kinds_that_their_panels_show(recorded: tuple[dict[str, str], Messages]) -> None:
    kinds, messages = recorded
    for _, config in panels_of("Image"):
        mode = config["imageMode"]
        assert kinds[mode["imageTopic"]] in IMAGES
        assert kinds[mode["calibrationTopic"]] == "foxglove.CameraCalibration"
        assert {kinds[topic] for topic in mode["annotations"]} == {"foxglove.ImageAnnotations"}
    transforms = [t for topic in ("/tf", "/tf_static") for m in messages[topic] for t in m["transforms"]]
    frames = {t[end] for t in transforms for end in ("parent_frame_id", "child_frame_id")}
    for _, config in panels_of("3D"):
        assert {kinds[topic] for topic in config["topics"]} <= DRAWN_IN_3D
        assert config["followTf"] in frames
        for topic in config["topics"]:
            shown = messages[topic]
            named = {m["frame_id"] for m in shown if "frame_id" in m} | {
                e["frame_id"] for m in shown for e in m.get("entities", ())
            }
            assert named, topic
            assert named <= frames, topic
    assert {kinds[config["topicToRender"]] for _, config in panels_of("RosOut")} == {"foxglove.Log"}


def test_the_paths_that_the_docs_name_are_there(recorded: tuple[dict[str, str], Messages]) -> None:
    text = (ROOT / "docs/recordings.md").read_text()
    named = re.findall(r"`(/(?:belief|fusion|truth|detection)[^`]*\.[^`]+)`", text)
    assert len(named) >= 4
    for path in named:
        assert layout_values(path, recorded[1]), path
