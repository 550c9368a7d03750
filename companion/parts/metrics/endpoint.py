"""Format health in Prometheus' text format, and serve it at /metrics and /health."""

import asyncio
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import accumulate

from aiohttp import web
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4 as CONTENT_TYPE
from prometheus_client.exposition import generate_latest
from prometheus_client.registry import Collector, CollectorRegistry

from companion.base.health import EDGES_S, Health, HealthSnapshot, MissionHealth, missing_inputs
from companion.base.http_server import HttpServer
from companion.base.watchdog import stuck
from companion.cycle.ports import Assembly

__all__ = ["CONTENT_TYPE", "text"]


Samples = Iterable[tuple[Sequence[str], float | None]]
_Row = tuple[type[CounterMetricFamily | GaugeMetricFamily], str, str, tuple[str, ...], Samples]
"""Kind of a family, its name, its description, the names of its labels, and its samples by their labels."""
_PAGE_S = 0.2
"""The shortest time between two renderings of a page, s: a flood of requests must not cost the flight more than that."""


class _Snapshot(Collector):
    def __init__(self, health: HealthSnapshot) -> None:
        self._health = health

    def collect(self) -> Iterator[Metric]:
        return families(self._health)


def text(health: HealthSnapshot) -> bytes:
    """Return everything in a snapshot, in version 0.0.4 of the format."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Snapshot(health))
    return generate_latest(registry)


def families(health: HealthSnapshot) -> Iterator[Metric]:
    """Yield the metric families of a snapshot; an unknown value has no sample."""
    for kind, name, words, labels, samples in (*_of_service(health), *_of_mission(health.mission)):
        family = kind(name, words, labels=labels)
        for values, number in samples:
            if number is not None:
                family.add_metric(values, number)
        yield family
    durations = HistogramMetricFamily(
        "decklander_stage_duration_seconds", "How long a stage took, each run since the start.", labels=["stage"]
    )
    edges = [*map(str, EDGES_S), "+Inf"]
    for stage, times in health.stages.items():
        durations.add_metric([stage], list(zip(edges, accumulate(times.buckets), strict=True)), times.sum_s)
    yield durations


def _of_service(health: HealthSnapshot) -> Iterator[_Row]:
    counter, gauge = CounterMetricFamily, GaugeMetricFamily
    flight = float(health.flight_up) if health.vital else None
    yield gauge, "decklander_flight_up", "Whether the parts that the flight needs are up.", (), [((), flight)]
    parts = health.parts.items()
    words = "Whether a supervised part runs."
    yield gauge, "decklander_part_up", words, ("part",), [((name,), float(part.up)) for name, part in parts]
    words = "Since the part came up or went down."
    yield gauge, "decklander_part_age_seconds", words, ("part",), [((name,), p.age_s) for name, p in parts]
    words = "How often the part failed."
    yield counter, "decklander_part_failures", words, ("part",), [((name,), part.restarts) for name, part in parts]

    flows = health.flows.items()
    yield counter, "decklander_items", "Data that came by, by kind.", ("kind",), [((kind,), flow.count) for kind, flow in flows]
    words = "Since the last of its kind."
    yield gauge, "decklander_item_age_seconds", words, ("kind",), [((kind,), flow.age_s) for kind, flow in flows]
    words = "How many of a kind a second, over the newest."
    yield gauge, "decklander_item_rate_hertz", words, ("kind",), [((kind,), flow.rate_hz) for kind, flow in flows]

    words = "What became of each frame; exactly one verdict each."
    yield counter, "decklander_frames", words, ("verdict",), [((verdict,), n) for verdict, n in health.frames.items()]
    inputs = (((kind, verdict), n) for kind, tally in health.inputs.items() for verdict, n in tally.items())
    yield counter, "decklander_inputs", "What became of each measurement.", ("kind", "verdict"), inputs

    of, results = ("path", "source"), health.fusion
    words = "What became of each measurement on each path of the estimator."
    verdicts = (((f.path, f.source, verdict), n) for f in results for verdict, n in f.verdicts.items())
    yield counter, "decklander_fusion", words, (*of, "verdict"), verdicts
    words = "NIS over the gate's limit of the newest measurement that was compared with a prediction; above 1 the gate refuses."
    yield gauge, "decklander_innovation_test_ratio", words, of, [((f.path, f.source), f.test_ratio) for f in results]
    words = "Recent mean of NIS over the number of components; 1 when the estimator's covariance is honest."
    yield gauge, "decklander_normalized_nis_mean", words, of, [((f.path, f.source), f.nis_mean) for f in results]

    stages = health.stages.items()
    quantiles = (((name, q), value) for name, s in stages for q, value in (("0.5", s.p50_s), ("0.99", s.p99_s)))
    words = "How long a stage takes, quantiles of its newest runs."
    yield gauge, "decklander_stage_seconds", words, ("stage", "quantile"), quantiles
    words = "How often a stage ran."
    yield counter, "decklander_stage_runs", words, ("stage",), [((name,), stage.count) for name, stage in stages]
    counts = (((part, name), n) for part, values in health.counters.items() for name, n in values.items())
    yield gauge, "decklander_count", "What the parts count for themselves.", ("part", "name"), counts


def _of_mission(mission: MissionHealth) -> Iterator[_Row]:
    counter, gauge = CounterMetricFamily, GaugeMetricFamily
    phase = [((mission.phase,), 1.0)] if mission.phase else []
    yield gauge, "decklander_phase", "1 for the present state of the mission.", ("phase",), phase
    delay_s, longer_s = (None, None) if mission.response is None else (mission.response.delay_s, mission.response.longer_s)
    for name, words, value in (
        ("decklander_height_metres", "Height over the pad by the steering estimate.", mission.height_m),
        ("decklander_error_metres", "Horizontal distance from the pad's centre by the steering estimate.", mission.error_m),
        ("decklander_battery_ratio", "The vehicle's charge, 0 to 1.", mission.battery),
        ("decklander_response_delay_seconds", "Delay of the vehicle's tilt that is flown with, once identified.", delay_s),
        ("decklander_response_longer_seconds", "By how much that is longer than the response file says.", longer_s),
    ):
        yield gauge, name, words, (), [((), value)]
    words, labels = "Changes of the mission's state, with event and cause.", ("from", "to", "event", "cause")
    yield counter, "decklander_transitions", words, labels, mission.transitions.items()
    words = "Ended flights by outcome."
    yield counter, "decklander_flights", words, ("outcome",), [((name,), n) for name, n in mission.flights.items()]


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
        health = self._health.snapshot()
        ok = health.flight_up
        if health.vital and (missing := missing_inputs(health)):
            down["inputs"] = ", ".join(missing)
        if "Decision" in self._health.flows and (why := stuck(health, flying=False)) is not None:
            down["pipeline"], ok = why, False
        output: dict[str, object] = {"ok": ok}
        if "Authorization" in request.headers or not self._server.has_token:
            output |= {"down": down} if self._server.allows(request) else {}
        return web.Response(text=json.dumps(output) + "\n", status=200 if ok else 503, content_type="application/json")


def join(service: Assembly) -> None:
    """Open the HTTP port of the settings, and serve metrics and health on it."""
    service.server = HttpServer(service.settings.http, service.health)
    service.extras["http"] = service.server.run
    MetricsEndpoint(service.server, service.health)
