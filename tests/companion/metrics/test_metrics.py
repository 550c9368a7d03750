"""Health as Prometheus reads it, and the endpoint on a real socket."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import aiohttp
import pytest
from prometheus_client.parser import text_string_to_metric_families

from companion.health import Health
from companion.metrics.endpoint import MetricsEndpoint
from companion.metrics.exposition import text
from companion.metrics.settings import MetricsSettings
from companion.supervise import Restart, run
from drivers.clock import SystemClock
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs


class Clock:
    """Stands still."""

    t = 1_000_000_000

    def now(self) -> MonoNs:
        return MonoNs(self.t)

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


def samples(page: bytes) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    """Every sample that Prometheus' own parser finds."""
    found = {}
    for family in text_string_to_metric_families(page.decode()):
        for sample in family.samples:
            found[sample.name, frozenset(sample.labels.items())] = sample.value
    return found


def value(page: bytes, sample: str, /, **labels: str) -> float | None:
    return samples(page).get((sample, frozenset(labels.items())))


def test_every_figure_of_health_is_in_the_page() -> None:
    clock = Clock()
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
    clock.t += 2_500_000_000
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
    assert value(page, "decklander_count", part="mqtt", name="events_waiting") == 7


def test_nothing_known_is_a_page_without_samples() -> None:
    assert samples(text(Health(Clock()).snapshot())) == {}


def test_a_flow_that_stops_slows_down_instead_of_keeping_its_rate() -> None:
    clock = Clock()
    health = Health(clock)
    for _ in range(60):
        clock.t += 10_000_000
        health.beat("Imu")
    assert health.snapshot().flows["Imu"].rate_hz == pytest.approx(100.0)
    clock.t += 9_510_000_000
    assert health.snapshot().flows["Imu"].rate_hz == pytest.approx(4.9)


@asynccontextmanager
async def serving(health: Health, **changes: object) -> AsyncIterator[MetricsEndpoint]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    endpoint = MetricsEndpoint(MetricsSettings(endpoint="http", port=port), health)
    ended = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        group.create_task(run({"metrics": endpoint.run}, Restart(0.01, 1.0, 0.01, 5.0), health, SystemClock(), until=ended))
        async with asyncio.timeout(3):
            while endpoint.port is None:  # noqa: ASYNC110 (the endpoint says nothing when it is ready)
                await asyncio.sleep(0.005)
        try:
            yield endpoint
        finally:
            ended.set()


async def test_the_endpoint_serves_the_page_and_a_yes_or_no() -> None:
    health = Health(SystemClock())
    async with serving(health) as endpoint, aiohttp.ClientSession(f"http://127.0.0.1:{endpoint.port}") as client:
        async with client.get("/metrics") as answer:
            assert answer.headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
            assert value(await answer.read(), "decklander_part_up", part="metrics") == 1
        async with client.get("/health") as answer:
            assert (answer.status, await answer.json()) == (200, {"ok": True, "down": {}})
        health.down("vehicle", Recoverable("no route"))
        async with client.get("/health") as answer:
            assert (answer.status, json.loads(await answer.text())) == (503, {"ok": False, "down": {"vehicle": "no route"}})
        async with client.get("/") as answer:
            assert answer.status == 404
        async with client.post("/metrics") as answer:
            assert answer.status == 405


async def test_a_taken_port_is_waited_for() -> None:
    health = Health(SystemClock())
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        endpoint = MetricsEndpoint(MetricsSettings(endpoint="http", port=holder.getsockname()[1]), health)
        with pytest.raises(Recoverable, match=r"metrics cannot be served on 127\.0\.0\.1:\d+: .*in use"):
            await endpoint.run()
