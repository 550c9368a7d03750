"""Make the MQTT part from the settings."""

from __future__ import annotations

import secrets
import uuid
from collections.abc import Callable
from importlib import metadata

from companion.config import secret_files
from companion.mqtt import access
from companion.mqtt.commands import CommandHandler
from companion.mqtt.connection import BrokerEndpoint
from companion.mqtt.outbox import Outbox
from companion.mqtt.part import MqttPart
from companion.mqtt.settings import MqttSettings
from companion.mqtt.ship_reports import ShipReportReader
from companion.mqtt.spool import Spool
from companion.mqtt.topics import Topics
from companion.operator.orders import OrderSender, OrderSource
from companion.operator.pilot_operator import PilotOperator
from companion.runtime.health import Health
from companion.runtime.pilot import Pilot
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
    spool = Spool(access.spool_folder(settings), settings.spool_max_kib * 1024)
    outbox = Outbox(spool, session, topics.event, settings.spool_fsync)
    operator = PilotOperator(pilot, OrderSender(OrderSource.MQTT), clock, recording)
    key = secret_files.key(settings.command_key_file, "mqtt", "command_key_file")
    run = secrets.token_hex(16)
    command_handler = CommandHandler(topics, session, operator, run, key)
    ship = None if reports is None else (ShipReportReader(topics, run, key), reports)
    return MqttPart(settings, endpoint, outbox, command_handler, health, clock, session=session, version=_version(), ship=ship)


def _version() -> str:
    try:
        return metadata.version("decklander")
    except metadata.PackageNotFoundError:
        return "(not installed)"
