"""Whatever a part does that the flight does not need, the flight's commands are those of a flight without it, to the bit."""

import asyncio
import gc
import logging
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.base import event_loop
from companion.base.health import Health
from companion.base.http_server import HttpServer
from companion.base.observer import Decision, NullObserver, Observer, ProcessedFrame
from companion.base.orders import HandledOrder, OperatorOrder, OrderSender, OrderSource
from companion.base.watchdog import Pulse
from companion.parts.live.options import LiveHttp
from companion.parts.live.part import LiveFeed
from companion.parts.mavlink.bridge.options import BridgeOptions
from companion.parts.mavlink.bridge.part import BridgePart
from companion.parts.mqtt.options import MqttSettings
from companion.parts.mqtt.part import MqttPart
from companion.parts.page.endpoint import PageEndpoint
from companion.parts.recorder.recorder import Recorder
from companion.service import assemble as service
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.load import load
from companion.settings.model import Settings
from drivers.reconnect import BackOff
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.estimates import FusionResult
from estimator.contracts.samples import Sample
from estimator.contracts.time import MonoNs
from tests.companion.virtual_flight import FakeFlight, SeeingPilot, VirtualClock, fly

FLOWN_S = 1.0
SHORT_S = 0.3


class Unspeakable(Exception):
    """An error that fails in turn when it is asked what it is."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


def deep() -> BaseException:
    """Return a RecursionError as Python makes it."""

    def down() -> None:
        down()

    try:
        down()
    except RecursionError as why:
        return why
    raise AssertionError


ERRORS: dict[str, Callable[[], BaseException]] = {
    "value": lambda: ValueError("bad"),
    "os": lambda: OSError(24, "too many open files"),
    "world": lambda: Recoverable("gone"),
    "memory": MemoryError,
    "recursion": deep,
    "exit": lambda: SystemExit(3),
    "generator": GeneratorExit,
    "cancelled": asyncio.CancelledError,
    "group": lambda: ExceptionGroup("two", [ValueError("a"), OSError("b")]),
    "base group": lambda: BaseExceptionGroup("deep", [BaseExceptionGroup("in", [GeneratorExit(), ValueError("c")])]),
    "unspeakable": Unspeakable,
}
METHODS = ("on_sample", "on_fusion", "on_frame", "on_decision", "on_order")
ROLES = (*METHODS, "body", "child", "callback", "ending", "counters")


class OrderingPilot(SeeingPilot):
    """A pilot to whom a person gives an order in each cycle, which changes no command."""

    def decide(self, now: MonoNs) -> Decision:
        self.operator.take(OperatorOrder.RECORD, OrderSender(OrderSource.TERMINAL, "1"), now)
        return super().decide(now)


class Failing:
    """An observer and a body that fail when they are told to.

    Args:
        role: the method that fails, or "body" for the part, "child" for a task of the part's own, "callback" for what it has the
            loop call, "ending" for the part on its way out, "counters" for its figures.
        at: calls (or sleeps, for the part) that go well before the first failure.
        for_: calls that fail.
    """

    def __init__(self, role: str, error: Callable[[], BaseException], at: int, for_: int, clock: VirtualClock) -> None:
        self._role, self._error, self._at, self._for, self._clock = role, error, at, for_, clock
        self._calls = 0
        self.raised = 0

    def _called(self, role: str) -> None:
        if role != self._role:
            return
        self._calls += 1
        if self._at < self._calls <= self._at + self._for:
            self.raised += 1
            raise self._error()

    def on_sample(self, sample: Sample) -> None:
        self._called("on_sample")

    def on_fusion(self, at: MonoNs, result: FusionResult) -> None:
        self._called("on_fusion")

    def on_frame(self, processed: ProcessedFrame) -> None:
        self._called("on_frame")

    def on_decision(self, decision: Decision) -> None:
        self._called("on_decision")

    def on_order(self, handled: HandledOrder) -> None:
        self._called("on_order")

    def counted(self) -> dict[str, float]:
        self._called("counters")
        return {}

    async def _child(self) -> None:
        self._called("child")

    async def run(self) -> None:
        try:
            while True:
                self._called("body")
                async with asyncio.TaskGroup() as group:
                    group.create_task(self._child())
                    asyncio.get_running_loop().call_soon(self._called, "callback")
                    await self._clock.sleep(0.05)
        finally:
            self._at = 0
            self._called("ending")


async def fly_failing(
    role: str | None = None, error: str = "value", at: int = 0, for_: int = 10**9, seconds: float = FLOWN_S
) -> tuple[list[tuple[int, str]], Health, int]:
    """Return the commands of a flight with a failing part in one role; its health; how often it failed."""
    clock = VirtualClock()
    vehicle = FakeFlight(clock)
    health = Health(clock)
    failing = Failing(role or "none", ERRORS[error], at, for_, clock)
    health.counters("failing", failing.counted)

    class Curious(NullObserver):
        """Looks at health as heartbeats do."""

        def on_decision(self, decision: Decision) -> None:
            assert health.fault(of_flight=True) is None
            health.snapshot()

    daemon = Daemon(
        vehicle.open,
        OrderingPilot(vehicle),
        clock,
        DaemonSetup(BackOff(0.02, 0.1, 5.0), 50.0, health_period_s=0.3),
        observers=[failing, Curious()],
        health=health,
        extras={"failing": failing.run},
    )
    return await fly(daemon, vehicle, clock, seconds), health, failing.raised


@pytest.fixture(scope="module")
def undisturbed() -> list[tuple[int, str]]:
    commands, health, _ = event_loop.run(fly_failing())
    assert len({text for _, text in commands}) > 20  # it does fly
    assert not health.contained
    return commands


@pytest.fixture(autouse=True)
def quiet(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL + 1)


@pytest.mark.hazard("H11")
@settings(max_examples=30, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    role=st.sampled_from(ROLES),
    error=st.sampled_from(sorted(ERRORS)),
    at=st.integers(0, 20),
    for_=st.sampled_from((1, 3, 25, 10**9)),
)
def test_a_part_that_fails_in_any_way_at_any_time_changes_no_command(undisturbed, role, error, at, for_):
    commands, health, raised = event_loop.run(fly_failing(role, error, at, for_, 0.5))
    assert commands == undisturbed[: len(commands)]
    assert health.parts["vehicle"].restarts == health.parts["guidance"].restarts == 0
    if raised and role in METHODS:
        assert health.contained[f"failing.{role}"] == raised


def test_what_fails_again_and_again_is_set_aside_and_reported() -> None:
    _, health, raised = event_loop.run(fly_failing("on_sample", "value", seconds=SHORT_S))
    assert raised == 20
    assert not health.parts["failing.on_sample"].up
    assert health.parts["failing.on_sample"].last_error == "off after 20 failures in a row: bad"
    assert health.snapshot().counters["contained"] == {"failing.on_sample": 20}
    assert health.parts["failing"].up is True  # the part itself runs on


def test_a_part_that_fails_again_and_again_is_given_up_unless_it_is_the_outside_world() -> None:
    _, health, raised = event_loop.run(fly_failing("body", "value"))
    assert raised == 10
    assert health.parts["failing"].last_error == "off after 10 failures: bad"
    _, health, raised = event_loop.run(fly_failing("body", "world"))
    assert raised > 10
    assert health.parts["failing"].last_error == "gone"


def test_an_observer_that_was_set_aside_is_tried_again_and_comes_back() -> None:
    from companion.base.containment import CallGuard

    clock = VirtualClock()
    health = Health(clock)
    guard, calls = CallGuard("x", health, limit=2), 0

    def callee() -> int:
        nonlocal calls
        calls += 1
        if calls <= 3:
            raise ValueError("not yet")
        return calls

    def told(seconds: int) -> int | None:
        clock.t = type(clock.t)(seconds * 10**9)
        return guard.call(callee)

    assert [told(s) for s in (0, 0, 1, 9)] == [None] * 4
    assert calls == 2
    assert told(10) is None
    assert (calls, health.parts["x"].up) == (3, False)
    assert told(29) is None
    assert calls == 3
    assert (told(30), health.parts["x"].up) == (4, True)


# The parts themselves, as the service wires them


def settings_with_everything(folder: Path) -> Settings:
    sim, token = load("sim"), folder / "token"
    token.write_text("a-token-of-sixteen-and-more")
    return msgspec.structs.replace(
        sim,
        recorder=msgspec.structs.replace(sim.recorder, enabled=True, folder=str(folder / "recordings"), frames="none"),
        mqtt=msgspec.structs.replace(
            sim.of(MqttSettings), transport="tcp", host="127.0.0.1", port=1, spool=str(folder / "spool")
        ),
        http=LiveHttp(endpoint="http", port=0, token_file=str(token), foxglove=True),
        bridge=msgspec.structs.replace(sim.of(BridgeOptions), links="udpin://127.0.0.1:0"),
    )


PARTS: dict[str, tuple[type, ...]] = {
    "__init__": (Recorder, MqttPart),
    "run": (Recorder, MqttPart, HttpServer, LiveFeed, PageEndpoint, Pulse, BridgePart),
    "on_sample": (Recorder, MqttPart, LiveFeed, PageEndpoint, BridgePart),
    "on_fusion": (Recorder, MqttPart, LiveFeed),
    "on_frame": (Recorder, MqttPart, LiveFeed, PageEndpoint),
    "on_decision": (Recorder, MqttPart, LiveFeed, PageEndpoint, Pulse),
    "on_order": (Recorder, MqttPart, LiveFeed, PageEndpoint),
    "counts": (MqttPart,),
    "tell": (MqttPart,),
}
"""Methods, and the parts of which each is broken at once."""


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # a part whose body is broken closes nothing
@pytest.mark.parametrize("method", PARTS)
def test_the_services_own_parts_cannot_touch_the_flight(method, tmp_path, monkeypatch, undisturbed):
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a bug of ours")

    for part in PARTS[method]:
        monkeypatch.setattr(part, method, broken)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    clock = VirtualClock()
    vehicle = FakeFlight(clock)

    async def one() -> tuple[list[tuple[int, str]], Health]:
        daemon = service.make_daemon(settings_with_everything(tmp_path), OrderingPilot(vehicle), clock=clock)
        daemon._open_link, daemon._period_s = vehicle.open, 0.02
        return await fly(daemon, vehicle, clock, 0.4), daemon.health

    commands, health = asyncio.run(one())
    gc.collect()
    assert commands == undisturbed[: len(commands)]
    assert len(commands) >= 18
    assert len(health.contained) >= len(PARTS[method]), health.contained


def test_wrong_settings_of_a_part_are_found_before_the_service_begins(tmp_path: Path) -> None:
    settings_of = settings_with_everything(tmp_path)
    secret = msgspec.structs.replace(settings_of.of(MqttSettings), user="x", password_file=str(tmp_path / "none"))
    vehicle = FakeFlight(VirtualClock())
    with pytest.raises(BadInput, match="password"):
        service.make_daemon(msgspec.structs.replace(settings_of, mqtt=secret), SeeingPilot(vehicle))


def test_observers_are_the_whole_protocol() -> None:
    """A method that the protocol gains must get a guard too."""
    assert {name for name in vars(Observer) if name.startswith("on_")} == set(METHODS)
