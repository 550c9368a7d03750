"""The heartbeat says what is true of the flight: a broker that is away or a full disk is told, and changes nothing else."""

from collections import Counter
from types import SimpleNamespace
from typing import Any

import pytest

from companion.base.health import Health
from companion.base.observer import Decision
from companion.parts.mavlink.component import Component, ComponentOptions
from drivers.mavlink.dialect import Message
from drivers.mavlink.links import Containment
from estimator.contracts.errors import Recoverable
from estimator.contracts.time import MonoNs, after
from tests.companion.mavlink.test_component_parts import Tower

FLOWN_S = 10


class Clock:
    """Stands where it is put."""

    t = MonoNs(0)

    def now(self) -> MonoNs:
        return self.t

    async def sleep(self, seconds: float) -> None:
        raise RuntimeError("nobody sleeps here")


class Said:
    """Messages that go out over the links."""

    def __init__(self, clock: Clock) -> None:
        self.contained = Containment(clock)
        self.kinds: Counter[str] = Counter()
        self.texts: list[str] = []
        self.identity = (1, 191)

    def send(self, message: Message, to: int | None = None) -> bool:
        self.kinds[message.get_type()] += 1
        if message.get_type() == "STATUSTEXT":
            self.texts.append(str(message.text))
        return True


def flown(health: Health, clock: Clock, broken: str | None = None, error: BaseException | None = None) -> Said:
    """Ten seconds of ticks with guidance deciding, one thing that it says broken."""
    options = ComponentOptions(0.39, 0.5)
    component = Component(options, Tower(), None, healthy=health.flight_fault, clock=clock, health=health)
    output = Said(clock)
    autopilot: Any = SimpleNamespace(links=output, add_listener=lambda listener: None, connected=False)
    component.attach(autopilot)

    def fail(*_: object) -> None:
        assert error is not None
        raise error

    if broken is not None:
        owner, _, name = broken.rpartition(".")
        setattr(getattr(component, owner) if owner else component, name, fail)
    for n in range(100 * FLOWN_S):
        clock.t = after(clock.t, 0.01)
        if n % 2 == 0:
            component.on_decision(Decision(clock.t, "approach", None, None))
        component.tick(clock.t)
    return output


@pytest.fixture
def health() -> Health:
    health = Health(Clock())
    for part in ("vehicle", "guidance"):
        health.vital(part)
        health.up(part)
    return health


@pytest.mark.parametrize("part", ["broker", "recorder", "mqtt", "metrics", "bridge"])
def test_a_part_beside_the_flight_that_is_down_costs_no_heartbeat_and_is_reported_once(health: Health, part: str) -> None:
    health.down(part, Recoverable("gone"))
    output = flown(health, Clock())
    assert output.kinds["HEARTBEAT"] == FLOWN_S
    assert [text for text in output.texts if part in text] == [f"Decklander: {part} is down: gone"]


@pytest.mark.parametrize("part", ["vehicle", "guidance"])
def test_a_vital_part_that_is_down_ends_it(health: Health, part: str) -> None:
    health.down(part, Recoverable("gone"))
    assert flown(health, Clock()).kinds["HEARTBEAT"] == 0


@pytest.mark.parametrize("broken", ["_computer.read", "_value", "texts.due", "_commands.due", "_check_health"])
@pytest.mark.parametrize("error", [OSError(24, "too many open files"), ValueError("bad"), MemoryError(), RecursionError()])
def test_whatever_else_it_says_may_fail_and_the_heartbeat_goes_on(health: Health, broken: str, error: BaseException) -> None:
    output = flown(health, Clock(), broken, error)
    assert output.kinds["HEARTBEAT"] == FLOWN_S
    assert sum(health.contained.values()) + output.contained.total > 0
