"""An autopilot in miniature in real time: the service on sockets, orders, and others at its link. No test asks how fast."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import pytest
from msgspec.structs import replace

from companion.base.health import Health
from companion.base.mission import State
from companion.base.orders import OperatorOrder, OrderSender, OrderSource
from companion.cli import main as cli
from companion.guidance.pilot import Pilot, make_pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.service.assemble import make_daemon
from companion.service.daemon import Daemon
from companion.tools.doctor.gather import wait_until
from drivers.clock import SystemClock
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.estimates import Verdict
from sitl.emulators.autopilots.stand_in.flight import StackName
from sitl.emulators.autopilots.stand_in.rehearsal import Rehearsal
from sitl.scenario.scenario import load
from sitl.scenario.settings import rig_for
from tests.support.waiting import free_port, until

RIGS: dict[StackName, str] = {"arducopter": "raspberry_ardupilot", "px4": "raspberry_px4"}


@pytest.fixture(params=RIGS)
def rehearsal(request: pytest.FixtureRequest) -> Iterator[tuple[Rehearsal, int]]:
    rig, port = rig_for(load("calm"), RIGS[request.param], by_autopilot=True), free_port()
    made = Rehearsal(rig.scenario, 1, rig.settings, request.param, f"udpout://127.0.0.1:{port}")
    with made.rendering():
        yield made, port


@dataclass
class Served:
    pilot: Pilot
    health: Health
    daemon: Daemon

    def order(self, order: OperatorOrder) -> str | None:
        return PilotOperator(self.pilot, OrderSender(OrderSource.TERMINAL, "test"), SystemClock()).order(order)


@asynccontextmanager
async def service(world: Rehearsal) -> AsyncIterator[Served]:
    """Provide the real service in the world, until it is stopped as by Ctrl-C."""
    async with world.flying() as settings:
        settings = replace(settings, operator=replace(settings.operator, socket="off"), recorder=type(settings.recorder)())
        pilot, health = make_pilot(settings), Health(SystemClock())
        daemon = make_daemon(settings, pilot, observers=world.observers(pilot, health), health=health)
        world.serve(daemon)
        async with asyncio.TaskGroup() as group:
            running = group.create_task(daemon.run())
            yield Served(pilot, health, daemon)
            daemon.stop()
            await running


async def test_a_service_flies_and_others_find_the_vehicle_at_the_same_time(rehearsal: tuple[Rehearsal, int]) -> None:
    made, port = rehearsal
    stack = {"arducopter": "ArduPilot", "px4": "PX4"}[made.autopilot]
    async with service(made) as served, open_autopilot(AutopilotOptions(f"udpin://127.0.0.1:{port}"), SystemClock()) as doctor:
        await wait_until(SystemClock(), 30.0, lambda: doctor.identity is not None)
        assert doctor.identity is not None
        assert doctor.identity.stack.value == stack
        await until(lambda: served.pilot.vehicle is not None and served.health.frames[Verdict.FUSED] > 3)
        assert served.pilot.state is State.READY
        assert abs(made.body.height_m - made.scenario.start.height_m) < 1.5, "the pilot keeps it there"
        assert served.order(OperatorOrder.BEGIN) is None
        await until(lambda: served.pilot.state in (State.INTERCEPT, State.DESCEND, State.SEARCH))
        assert served.order(OperatorOrder.HOLD) is None
        await until(lambda: served.pilot.state is State.PAUSED)
        assert made.stand_in.armed
    assert served.health.frames.total() <= made.frames_sent
    assert made.frames_sent <= made.frames_due
    assert [one.at for one in made.truth()] == sorted({one.at for one in made.truth()})


async def test_a_vehicle_on_the_pad_waits_disarmed_and_takes_off_by_a_person_s_order() -> None:
    scenario = load("calm")
    rig = rig_for(replace(scenario, start=replace(scenario.start, where="pad")), None, by_autopilot=True)
    made = Rehearsal(rig.scenario, 1, rig.settings, "arducopter", f"udpout://127.0.0.1:{free_port()}")
    with made.rendering():
        async with service(made) as served:
            await until(lambda: isinstance(link := served.daemon.link, Autopilot) and link.positions)
            assert not made.stand_in.armed
            await until(lambda: served.order(OperatorOrder.TAKE_OFF) is None)
            await until(lambda: made.body.height_m > 0.5)


def test_nobody_is_there_to_take_a_vehicle_off_the_pad_without_a_page(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["demo", "--autopilot", "arducopter", "--scenario", "calm", "--set", "start.where=pad", "--no-report"]
    assert cli.main(words) == 2
    assert "the vehicle stands on the pad: give --page" in capsys.readouterr().err
