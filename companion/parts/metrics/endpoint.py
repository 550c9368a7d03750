"""Format health in Prometheus' text format, and serve it at /metrics and /health."""

import asyncio
import json
import math
from collections.abc import Iterator
from itertools import accumulate

from aiohttp import web
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4 as CONTENT_TYPE
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import Collector, CollectorRegistry

from companion.base.delays import EDGES_S
from companion.base.health import Health, HealthSnapshot, MissionHealth
from companion.base.http_server import HttpServer
from companion.base.liveness import stuck

__all__ = ["CONTENT_TYPE", "text"]


class _Snapshot(Collector):
    def __init__(self, health: HealthSnapshot) -> None:
        self._health = health

    def collect(self) -> Iterator[Metric]:
        yield from families(self._health)


def text(health: HealthSnapshot) -> bytes:
    """Return everything in a snapshot, in version 0.0.4 of the format."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Snapshot(health))
    return generate_latest(registry)


def families(health: HealthSnapshot) -> Iterator[Metric]:
    """Yield the metric families of a snapshot; an unknown value has no sample."""
    flight = GaugeMetricFamily("decklander_flight_up", "Whether the parts that the flight needs are up.")
    if any(part.vital for part in health.parts.values()):
        flight.add_metric([], float(health.flight_up))
    yield flight
    up = GaugeMetricFamily("decklander_part_up", "Whether a supervised part runs.", labels=["part"])
    since = GaugeMetricFamily("decklander_part_age_seconds", "Since the part came up or went down.", labels=["part"])
    restarts = CounterMetricFamily("decklander_part_failures", "How often the part failed.", labels=["part"])
    for part, state in health.parts.items():
        up.add_metric([part], float(state.up))
        since.add_metric([part], state.age_s)
        restarts.add_metric([part], state.restarts)
    yield from (up, since, restarts)

    items = CounterMetricFamily("decklander_items", "Data that came by, by kind.", labels=["kind"])
    ages = GaugeMetricFamily("decklander_item_age_seconds", "Since the last of its kind.", labels=["kind"])
    rates = GaugeMetricFamily("decklander_item_rate_hertz", "How many of a kind a second, over the newest.", labels=["kind"])
    for kind, flow in health.flows.items():
        items.add_metric([kind], flow.count)
        if flow.age_s is not None:
            ages.add_metric([kind], flow.age_s)
        if flow.rate_hz is not None:
            rates.add_metric([kind], flow.rate_hz)
    yield from (items, ages, rates)

    frames = CounterMetricFamily("decklander_frames", "What became of each frame; exactly one verdict each.", labels=["verdict"])
    for verdict, n in health.frames.items():
        frames.add_metric([verdict], n)
    inputs = CounterMetricFamily("decklander_inputs", "What became of each measurement.", labels=["kind", "verdict"])
    for kind, tally in health.inputs.items():
        for verdict, n in tally.items():
            inputs.add_metric([kind, verdict], n)
    yield from (frames, inputs)

    results = CounterMetricFamily(
        "decklander_fusion",
        "What became of each measurement on each path of the estimator.",
        labels=["path", "source", "verdict"],
    )
    ratios = GaugeMetricFamily(
        "decklander_innovation_test_ratio",
        "NIS over the gate's limit of the newest measurement that was compared with a prediction; above 1 the gate refuses.",
        labels=["path", "source"],
    )
    nis = GaugeMetricFamily(
        "decklander_normalized_nis_mean",
        "Recent mean of NIS over the number of components; 1 when the estimator's covariance is honest.",
        labels=["path", "source"],
    )
    for fusion in health.fusion:
        of = [fusion.path, fusion.source]
        for verdict, n in fusion.verdicts.items():
            results.add_metric([*of, verdict], n)
        if fusion.test_ratio is not None:
            ratios.add_metric(of, fusion.test_ratio)
        if fusion.nis_mean is not None:
            nis.add_metric(of, fusion.nis_mean)
    yield from (results, ratios, nis)

    stages = GaugeMetricFamily(
        "decklander_stage_seconds", "How long a stage takes, quantiles of its newest runs.", labels=["stage", "quantile"]
    )
    runs = CounterMetricFamily("decklander_stage_runs", "How often a stage ran.", labels=["stage"])
    for name, stage in health.stages.items():
        runs.add_metric([name], stage.count)
        for quantile, value in (("0.5", stage.p50_s), ("0.99", stage.p99_s)):
            if value is not None:
                stages.add_metric([name, quantile], value)
    yield from (stages, runs, _durations(health))

    yield from _mission(health.mission)

    counts = GaugeMetricFamily("decklander_count", "What the parts count for themselves.", labels=["part", "name"])
    for part, values in health.counters.items():
        for name, number in values.items():
            counts.add_metric([part, name], number)
    yield counts


def _durations(health: HealthSnapshot) -> Metric:
    family = HistogramMetricFamily(
        "decklander_stage_duration_seconds", "How long a stage took, each run since the start.", labels=["stage"]
    )
    edges = [*map(str, EDGES_S), "+Inf"]
    for name, stage in health.stages.items():
        family.add_metric([name], list(zip(edges, accumulate(stage.buckets), strict=True)), stage.sum_s)
    return family


def _mission(mission: MissionHealth) -> Iterator[Metric]:
    phase = GaugeMetricFamily("decklander_phase", "1 for the present state of the mission.", labels=["phase"])
    if mission.phase:
        phase.add_metric([mission.phase], 1.0)
    yield phase
    delay_s, longer_s = (None, None) if mission.response is None else (mission.response.delay_s, mission.response.longer_s)
    numbers = (
        ("decklander_height_metres", "Height over the pad by the steering estimate.", mission.height_m),
        ("decklander_error_metres", "Horizontal distance from the pad's centre by the steering estimate.", mission.error_m),
        ("decklander_battery_ratio", "The vehicle's charge, 0 to 1.", mission.battery),
        ("decklander_response_delay_seconds", "Delay of the vehicle's tilt that is flown with, once identified.", delay_s),
        ("decklander_response_longer_seconds", "By how much that is longer than the response file says.", longer_s),
    )
    for name, words, value in numbers:
        family = GaugeMetricFamily(name, words)
        if value is not None:
            family.add_metric([], value)
        yield family
    changes = CounterMetricFamily(
        "decklander_transitions", "Changes of the mission's state, with event and cause.", labels=["from", "to", "event", "cause"]
    )
    for labels, n in mission.transitions.items():
        changes.add_metric(labels, n)
    flights = CounterMetricFamily("decklander_flights", "Ended flights by outcome.", labels=["outcome"])
    for outcome, n in mission.flights.items():
        flights.add_metric([outcome], n)
    yield from (changes, flights)


_PAGE_S = 0.2
"""The shortest time between two renderings of a page, s: a flood of requests must not cost the flight more than that."""


class MetricsEndpoint:
    """Serves /metrics (Prometheus) and /health.

    /health answers 200 while what the flight needs is up and not stuck, else 503, and as JSON every part that is down. Whoever
    restarts the service on a 503 must not do so in flight because the broker is away.

    Without the server's token /metrics answers 401, and /health only yes or no.
    """

    def __init__(self, server: HttpServer, health: Health) -> None:
        self._server = server
        self._health = health
        self._page = b""
        self._made_s = -math.inf
        server.serve("/metrics", self._metrics)
        server.serve("/health", self._state)

    async def _metrics(self, request: web.Request) -> web.Response:
        if not self._server.allows(request):
            return web.Response(status=401, headers={"WWW-Authenticate": "Bearer"})
        now_s = asyncio.get_running_loop().time()
        if now_s >= self._made_s + _PAGE_S:
            self._made_s = now_s
            self._page = await asyncio.to_thread(text, self._health.snapshot())
        return web.Response(body=self._page, headers={"Content-Type": CONTENT_TYPE})

    async def _state(self, request: web.Request) -> web.Response:
        down = {name: part.last_error for name, part in self._health.parts.items() if not part.up}
        ok = self._health.flight_fault() is None
        if "Decision" in self._health.flows and (why := stuck(self._health.snapshot(), flying=False)) is not None:
            down["pipeline"], ok = why, False
        output: dict[str, object] = {"ok": ok}
        if "Authorization" in request.headers or not self._server.has_token:
            output |= {"down": down} if self._server.allows(request) else {}
        return web.Response(text=json.dumps(output) + "\n", status=200 if ok else 503, content_type="application/json")
