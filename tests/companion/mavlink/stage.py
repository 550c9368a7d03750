"""The component on the links of an autopilot in miniature, with a pad that stands still under it."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import companion.settings.load as settings_of
from companion.base.health import Health
from companion.base.observer import Decision
from companion.parts.mavlink.commands import Tunables
from companion.parts.mavlink.component import PARAMETERS, Component, speaking
from companion.parts.mavlink.outputs import Outputs
from companion.settings.links import OutputOptions
from companion.settings.model import Settings
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.estimates import IntegrityAlert, RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Range
from estimator.contracts.time import MonoNs
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.support.clocks import PatientClock
from tests.support.fake_operator import FakeOperator
from tests.support.waiting import until

HOST = "127.0.0.1"
PAD_NED = np.array([1.5, -0.8, 0.0])


@dataclass
class Stage:
    """Everything of one test."""

    component: Component
    autopilot: Autopilot
    fake: MiniatureAutopilot
    tower: FakeOperator
    health: Health
    applied: list[Settings] = field(default_factory=list)
    seen: bool = True
    alerts: tuple[IntegrityAlert, ...] = ()
    lost: tuple[str, ...] = ()
    deciding: bool = True
    phase: str = "approach"
    ranges: int = 0
    """Measured distances that came from the autopilot."""

    def believe(self, now: MonoNs) -> RelativeState | None:
        """Return the truth, as long as it is `seen`."""
        attitude = self.autopilot.attitude
        if not self.seen or attitude is None:
            return None
        to_level = Rotation.from_rpy(0.0, 0.0, attitude.R_ned_body.rpy_rad[2]).inv
        d, v = to_level @ (PAD_NED - self.fake.p_ned), to_level @ -self.fake.v_ned
        return RelativeState(
            now, "dead_reckoning", d, v, 0.2, np.eye(7) * 1e-4, now, not self.alerts, alerts=self.alerts, lost=self.lost
        )


@asynccontextmanager
async def staged(
    fake: MiniatureAutopilot, *more_links: str, outputs: dict[str, Any] | None = None, operators: str = ""
) -> AsyncIterator[Stage]:
    """Autopilot found, component speaking, guidance deciding at 50 Hz."""
    clock = fake.clock = PatientClock()
    health = Health(clock)
    autopilot_options = AutopilotOptions(
        ", ".join((f"udpin://{HOST}:0", *more_links)),
        silence_s=0.8,
        command_period_s=0.02,
        operators=operators,
        restart_first_s=0.02,
        restart_most_s=0.1,
    )
    stage: Stage
    tower = FakeOperator()
    applied: list[Settings] = []
    component = Component(
        Outputs(OutputOptions(**(outputs or {})), 0.39, 0.5),
        tower,
        Tunables(settings_of.load("sim"), applied.append),
        believe=lambda now: stage.believe(now),
        clock=clock,
        health=health,
    )
    async with open_autopilot(autopilot_options, clock, parameters=PARAMETERS) as autopilot:
        stage = Stage(component, autopilot, fake, tower, health, applied)

        async def pump() -> None:
            async for sample in autopilot.samples:
                stage.ranges += isinstance(sample, Range)
                component.on_sample(sample)

        async def decide() -> None:
            while True:
                if stage.deciding:
                    now = clock.now()
                    component.on_decision(Decision(now, stage.phase, None, stage.believe(now)))
                await asyncio.sleep(0.02)

        await until(lambda: autopilot.links.all[0].local is not None)
        host, port = autopilot.links.all[0].local or ("", 0)
        async with fake.talking_to(f"udpout://{host}:{port}"), asyncio.TaskGroup() as group:
            tasks = [group.create_task(pump()), group.create_task(decide())]
            await until(lambda: autopilot.connected)
            async with speaking(component, autopilot, clock):
                yield stage
            for task in tasks:
                task.cancel()


def count(fake: MiniatureAutopilot, kind: str) -> Callable[[], int]:
    return lambda: len(fake.of(kind))
