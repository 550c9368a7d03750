"""Make the MQTT part from the settings."""

import os
import secrets
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path

from companion.base.health import Health
from companion.base.orders import OrderSender, OrderSource
from companion.base.version import version
from companion.guidance.pilot import Pilot
from companion.guidance.pilot_operator import PilotOperator
from companion.parts.mqtt.commands import CommandHandler
from companion.parts.mqtt.connection import BrokerEndpoint
from companion.parts.mqtt.outbox import Outbox
from companion.parts.mqtt.part import MqttPart
from companion.parts.mqtt.ship_reports import ShipReportReader
from companion.parts.mqtt.spool import Spool
from companion.parts.mqtt.topics import Topics
from companion.settings import secret_files
from companion.settings.mqtt import MqttSettings
from drivers.mailbox import Line
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Sample


def make_mqtt(
    settings: MqttSettings,
    pilot: Pilot,
    health: Health,
    clock: Clock,
    recording: Callable[[bool], str | None] | None = None,
    reports: Line[Sample] | None = None,
) -> MqttPart:
    """Read the secrets, open the spool and return the part.

    Args:
        recording: switches the recorder and returns why it cannot; None if there is no recorder.
        reports: where the ship's reports from the broker are put; None where none are taken.

    Raises:
        BadInput: a secret, a certificate or the spool cannot be read or used.
    """
    session, topics = uuid.uuid4().hex[:12], Topics(settings.drone)
    endpoint = BrokerEndpoint.of(settings)
    spool = Spool(spool_folder(settings), settings.spool_max_kib * 1024)
    outbox = Outbox(spool, session, topics.event, settings.spool_fsync)
    operator = PilotOperator(pilot, OrderSender(OrderSource.MQTT), clock, recording)
    key = secret_files.key(settings.command_key_file, "mqtt", "command_key_file")
    run = secrets.token_hex(16)
    command_handler = CommandHandler(topics, session, operator, run, key)
    ship = None if reports is None else (ShipReportReader(topics, run, key), reports)
    return MqttPart(settings, endpoint, outbox, command_handler, health, clock, version=version(), ship=ship)


def spool_folder(settings: MqttSettings, environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the folder that events are spooled in, or None if they stay in memory."""
    if settings.spool:
        return Path(settings.spool)
    state = environment.get("STATE_DIRECTORY", "").split(":")[0]
    return Path(state) / "mqtt" if state else None
