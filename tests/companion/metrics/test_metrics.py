"""Health as Prometheus reads it, and the endpoint on a real socket."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import aiohttp
import pytest
from prometheus_client.parser import text_string_to_metric_families

from companion.base.containment import run
from companion.base.health import Health
from companion.base.http_server import ConnectionLimits, HttpServer
from companion.parts.metrics.endpoint import MetricsEndpoint, text
from companion.settings.links import HttpSettings
from drivers.clock import SystemClock
from drivers.reconnect import BackOff
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import Verdict
from tests.support.clocks import SteppedClock
from tests.support.processes import no_descriptors
from tests.support.waiting import until


def samples(page: bytes) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    """Return every sample that Prometheus' own parser finds."""
    found = {}
    for family in text_string_to_metric_families(page.decode()):
        for sample in family.samples:
            found[sample.name, frozenset(sample.labels.items())] = sample.value
    return found


def value(page: bytes, sample: str, /, **labels: str) -> float | None:
    return samples(page).get((sample, frozenset(labels.items())))


def test_every_figure_of_health_is_in_the_page() -> None:
    clock = SteppedClock()
    health = Health(clock)
    health.up("vehicle")
    health.down("mqtt", Recoverable('a "quoted"\nreason'))
    for verdict, n in ((Verdict.FUSED, 3), (Verdict.NO_PAD, 2)):
        for _ in range(n):
            health.frame(verdict)
    health.input("Imu", Verdict.TOO_OLD)
    health.beat("Frame")
    for k in range(100):
        health.delay("vision", 0.001 * (k + 1))
    health.counters("mqtt", lambda: {"events_waiting": 7})
    clock.advance(2.5)
    page = text(health.snapshot())
    assert value(page, "decklander_part_up", part="vehicle") == 1
    assert value(page, "decklander_part_up", part="mqtt") == 0
    assert value(page, "decklander_part_age_seconds", part="mqtt") == 2.5
    assert value(page, "decklander_part_failures_total", part="mqtt") == 1
    assert value(page, "decklander_frames_total", verdict="fused") == 3
    assert value(page, "decklander_frames_total", verdict="no_pad") == 2
    assert value(page, "decklander_inputs_total", kind="Imu", verdict="too_old") == 1
    assert value(page, "decklander_items_total", kind="Frame") == 1
    assert value(page, "decklander_item_age_seconds", kind="Frame") == 2.5
    assert value(page, "decklander_item_rate_hertz", kind="Frame") is None
    assert value(page, "decklander_stage_seconds", stage="vision", quantile="0.5") == pytest.approx(0.051)
    assert value(page, "decklander_stage_seconds", stage="vision", quantile="0.99") == pytest.approx(0.1)
    assert value(page, "decklander_stage_runs_total", stage="vision") == 100
    # 1, 2 ... 100 ms; a bucket counts what is not longer than its edge.
    held = {
        le: value(page, "decklander_stage_duration_seconds_bucket", stage="vision", le=le) for le in ("0.001", "0.05", "+Inf")
    }
    assert held == {"0.001": 1, "0.05": 50, "+Inf": 100}
    assert value(page, "decklander_stage_duration_seconds_sum", stage="vision") == pytest.approx(5.05)
    assert value(page, "decklander_count", part="mqtt", name="events_waiting") == 7


def test_nothing_known_is_a_page_without_samples() -> None:
    assert samples(text(Health(SteppedClock()).snapshot())) == {}


def test_a_flow_that_stops_slows_down_instead_of_keeping_its_rate() -> None:
    clock = SteppedClock()
    health = Health(clock)
    for _ in range(60):
        clock.advance(0.01)
        health.beat("Imu")
    assert health.snapshot().flows["Imu"].rate_hz == pytest.approx(100.0)
    clock.advance(9.51)
    assert health.snapshot().flows["Imu"].rate_hz == pytest.approx(4.9)


@asynccontextmanager
async def serve(health: Health, limits: ConnectionLimits | None = None, token_file: str = "") -> AsyncIterator[HttpServer]:
    endpoint = HttpServer(HttpSettings(endpoint="http", port=0, token_file=token_file, page=False), health, limits)
    MetricsEndpoint(endpoint, health)
    over = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        group.create_task(
            run({}, BackOff(0.01, 0.01, 5.0, 1.0), health, SystemClock(), until=over, beside={"http": endpoint.run})
        )
        await until(lambda: endpoint.port is not None)
        try:
            yield endpoint
        finally:
            over.set()


async def test_the_endpoint_serves_the_page_and_a_yes_or_no() -> None:
    health = Health(SystemClock())
    async with serve(health) as endpoint, aiohttp.ClientSession(f"http://127.0.0.1:{endpoint.port}") as client:
        async with client.get("/metrics") as answer:
            assert answer.headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
            assert value(await answer.read(), "decklander_part_up", part="http") == 1
        async with client.get("/health") as answer:
            assert (answer.status, await answer.json()) == (200, {"ok": True, "down": {}})
        health.down("mqtt", Recoverable("no broker"))
        async with client.get("/health") as answer:
            assert (answer.status, await answer.json()) == (200, {"ok": True, "down": {"mqtt": "no broker"}})
        health.vital("vehicle")
        health.down("vehicle", Recoverable("no route"))
        async with client.get("/health") as answer:
            assert answer.status == 503
            down = json.loads(await answer.text())["down"]
            assert "no frames from the camera yet" in down.pop("inputs")
            assert down == {"mqtt": "no broker", "vehicle": "no route"}
        health.up("vehicle")
        for flows, status in (((), 503), (("VehicleStatus", "Attitude"), 503), (("VehicleStatus", "Attitude", "Frame"), 200)):
            for flow in flows:
                health.beat(flow)
            async with client.get("/health") as answer:
                assert answer.status == status, "a vehicle that is open and silent is none"
        health.down("vehicle", Recoverable("no route"))
        assert value(text(health.snapshot()), "decklander_flight_up") == 0
        async with client.get("/") as answer:
            assert answer.status == 404
        async with client.post("/metrics") as answer:
            assert answer.status == 405


async def test_a_taken_port_is_waited_for() -> None:
    health = Health(SystemClock())
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        endpoint = HttpServer(HttpSettings(endpoint="http", port=holder.getsockname()[1], page=False), health)
        with pytest.raises(Recoverable, match=r"HTTP cannot be served on 127\.0\.0\.1:\d+: .*in use"):
            await endpoint.run()


async def dialled(endpoint: HttpServer, said: bytes) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Return a connection after this much was sent."""
    reader, writer = await asyncio.open_connection("127.0.0.1", endpoint.port)
    writer.write(said)
    return reader, writer


async def over(reader: asyncio.StreamReader) -> bytes:
    """Everything until the endpoint closes."""
    try:
        async with asyncio.timeout(60):
            return await reader.read()
    except ConnectionResetError:
        return b""


@pytest.mark.parametrize(
    "said", [b"", b"GET /metrics HTTP/1.1\r\nHost: x\r\n", b"POST /metrics HTTP/1.1\r\nContent-Length: 900\r\n\r\nabc"]
)
async def test_a_request_that_never_ends_is_closed_in_time(said: bytes) -> None:
    limits = ConnectionLimits(connection_s=0.1)
    async with serve(Health(SystemClock()), limits) as endpoint:
        reader, writer = await dialled(endpoint, said)
        await over(reader)
        writer.close()
        assert not limits.open
        assert limits.overdue == 1 or said.startswith(b"POST"), "a POST is answered at once"


async def test_many_half_open_requests_neither_pile_up_nor_shut_out_a_whole_one() -> None:
    limits = ConnectionLimits(connections=8, connection_s=30.0)
    health = Health(SystemClock())
    async with serve(health, limits) as endpoint:
        lines = [await dialled(endpoint, b"GET /metrics HTTP/1.1\r\n") for _ in range(60)]
        for reader, _ in lines[: 60 - 8]:
            await over(reader)
        assert len(limits.open) == 8
        assert health.snapshot().counters["http"]["connections_evicted"] == 52
        reader, whole = await dialled(endpoint, b"GET /health HTTP/1.1\r\nHost: x\r\n\r\n")
        assert (await over(reader)).startswith(b"HTTP/1.1 200")
        for _, writer in (*lines, (reader, whole)):
            writer.close()


async def test_an_endless_request_is_cut_off() -> None:
    limits = ConnectionLimits()
    async with serve(Health(SystemClock()), limits) as endpoint:
        reader, writer = await dialled(endpoint, b"GET /health HTTP/1.1\r\n")
        for k in range(20):
            writer.write(b"X-%d: %s\r\n" % (k, b"y" * 4000))
        assert await over(reader) == b""
        writer.close()
    assert limits.oversized == 1


async def test_no_descriptors_left_is_waited_out(caplog: pytest.LogCaptureFixture) -> None:
    """Asyncio itself stops accepting for a second; the endpoint goes on afterwards."""
    health = Health(SystemClock())
    async with serve(health) as endpoint:
        with socket.socket() as client:
            client.setblocking(False)
            with no_descriptors():
                await asyncio.get_running_loop().sock_connect(client, ("127.0.0.1", endpoint.port))
                await asyncio.sleep(0.1)
            await asyncio.get_running_loop().sock_sendall(client, b"GET /health HTTP/1.1\r\nHost: x\r\n\r\n")
            async with asyncio.timeout(60):
                assert (await asyncio.get_running_loop().sock_recv(client, 100)).startswith(b"HTTP/1.1 200")
        assert health.parts["http"].restarts == 0


async def test_with_a_token_nothing_is_reported_without_it(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("0123456789abcdef\n")
    file.chmod(0o600)
    health = Health(SystemClock())
    health.vital("vehicle")
    health.down("vehicle", Recoverable("no route to 10.0.0.7"))
    async with (
        serve(health, token_file=str(file)) as endpoint,
        aiohttp.ClientSession(f"http://127.0.0.1:{endpoint.port}") as client,
    ):
        for wrong in ({}, {"Authorization": "Bearer 0123456789abcdeF"}, {"Authorization": "Basic 0123456789abcdef"}):
            async with client.get("/metrics", headers=wrong) as answer:
                assert (answer.status, await answer.text()) == (401, "")
            async with client.get("/health", headers=wrong) as answer:
                assert (answer.status, await answer.json()) == (503, {"ok": False})
        right = {"Authorization": "Bearer 0123456789abcdef"}
        async with client.get("/metrics", headers=right) as answer:
            assert value(await answer.read(), "decklander_count", part="http", name="wrong_tokens") == 5
        async with client.get("/health", headers=right) as answer:
            assert "10.0.0.7" in await answer.text()
