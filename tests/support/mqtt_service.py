"""The part without a daemon: a fake operator, a real clock, samples and decisions made up."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.base.containment import RESTART, run
from companion.base.health import Health
from companion.base.observer import Decision
from companion.parts.mqtt.connection import renewed_endpoint
from companion.parts.mqtt.encode import PendingEvent
from companion.parts.mqtt.messages import Topics
from companion.parts.mqtt.options import MqttSettings
from companion.parts.mqtt.outbox import Outbox
from companion.parts.mqtt.part import CommandHandler, MqttPart
from companion.parts.mqtt.spool import Spool
from companion.settings import files
from drivers.clock import SystemClock
from estimator.contracts.commands import Command, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from tests.support.fake_operator import FakeOperator

SESSION = "0123456789ab"
RUN = "fedcba9876543210fedcba9876543210"


def estimate_at(at: MonoNs, height_m: float = 2.0) -> RelativeState:
    return RelativeState(
        at, "dead_reckoning", np.array([0.3, -0.2, height_m]), np.array([0.1, 0.2, -0.3]), 0.5,
        np.diag([0.01, 0.04, 0.09, 0.16, 0.25, 0.36, 0.49]), MonoNs(at - 40_000_000), True,
    )  # fmt: skip


def decision(at: MonoNs, phase: str = "approach", command: Command | None = None) -> Decision:
    return Decision(at, phase, command or Velocity(np.array([0.4, 0.5, 0.6]), 0.7), estimate_at(at))


def vehicle_status(at: MonoNs, mode: str = "flying", battery: float = 0.8, emergency: bool = False) -> VehicleStatus:
    return VehicleStatus(Stamp(at, at, 0.0, "sim"), mode == "flying", mode, battery, emergency, True)


def event(at: MonoNs, text: str) -> PendingEvent:
    return PendingEvent(at, "phase", text)


@dataclass
class RunningPart:
    """A running part and what it is made of."""

    part: MqttPart
    health: Health
    operator: FakeOperator
    clock: SystemClock
    spool: Spool

    def count(self, name: str) -> float:
        return self.part.counts().get(name, 0)


@asynccontextmanager
async def running(settings: MqttSettings, folder: Path, session: str = SESSION) -> AsyncIterator[RunningPart]:
    """Yield the part, supervised as in the daemon."""
    logging.getLogger("companion.parts.mqtt").setLevel(logging.WARNING)
    clock = SystemClock()
    health, topics, operator = Health(clock), Topics(settings.drone), FakeOperator()
    spool = Spool(folder, settings.spool_max_kib * 1024)
    outbox = Outbox(spool, session, topics.of("event"), settings.spool_fsync)
    command_handler = CommandHandler(
        topics, session, operator, RUN, lambda: files.key(settings.command_key_file, "mqtt.command_key_file")
    )
    part = MqttPart(settings, renewed_endpoint(settings), outbox, command_handler, health, clock, version="1.2.3")
    ended = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        group.create_task(run({"mqtt": part.run}, RESTART, health, clock, until=ended))
        try:
            yield RunningPart(part, health, operator, clock, spool)
        finally:
            ended.set()
