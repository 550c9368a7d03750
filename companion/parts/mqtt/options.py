"""The settings of MQTT: the table [mqtt]."""

from typing import Annotated, Any, Literal

from companion.settings.links import on_loopback
from companion.settings.part_table import PartTable
from drivers.vehicle import Claim, host_and_port
from estimator.contracts.keys import check_order, choice, name, number, text

_FILE = 'a path or "credential:NAME"; empty for none'


class MqttSettings(PartTable, frozen=True, forbid_unknown_fields=True):
    """Telemetry, events and commands through an MQTT broker. Topics and messages: docs/mqtt.md."""

    transport: Annotated[Literal["off", "tcp", "tls"], choice("no MQTT, plain TCP, or TLS", public=True)] = "off"
    host: Annotated[str, text("name or address of the broker, with TLS that of its certificate", 253, public=True)] = "127.0.0.1"
    port: Annotated[
        int, number("port of the broker; customary are 1883 for TCP and 8883 for TLS", "port", 1, 65535, public=True)
    ] = 8883
    protocol: Annotated[
        Literal["5", "3.1.1"],
        choice("MQTT version; 3.1.1 brokers cannot say that they refuse a message: events may be lost there"),
    ] = "5"
    drone: Annotated[str, name("name of this drone: its topics are decklander/v2/<drone>/...", 64, public=True)] = "drone"
    user: Annotated[str, text("user name; empty for none", 256, shortest=0, public=True)] = ""
    password_file: Annotated[str, text(f"password: {_FILE}", 4096, shortest=0, public=True)] = ""
    ca_file: Annotated[
        str, text(f"certificates of the CAs, in place of the system's: {_FILE}", 4096, shortest=0, public=True)
    ] = ""
    certificate_file: Annotated[str, text(f"client certificate: {_FILE}", 4096, shortest=0, public=True)] = ""
    key_file: Annotated[str, text(f"key of the client certificate: {_FILE}", 4096, shortest=0, public=True)] = ""
    commands: Annotated[
        Literal["off", "signed", "broker"],
        choice(
            "who may command: nobody; whoever signs with the key in command_key_file; or whom the broker lets write to the "
            "command topic (needs TLS)",
            public=True,
        ),
    ] = "off"
    command_key_file: Annotated[
        str, text(f"key of signed commands, 32 bytes or 64 hexadecimal digits: {_FILE}", 4096, shortest=0, public=True)
    ] = ""
    state_hz: Annotated[float, number("state messages a second; 0 for none", "Hz", 0.0, 50.0)] = 5.0
    sighting_hz: Annotated[float, number("most sighting messages a second; 0 for none", "Hz", 0.0, 50.0)] = 5.0
    health_hz: Annotated[float, number("health messages a second; 0 for none", "Hz", 0.0, 10.0)] = 1.0
    timeout_s: Annotated[
        float, number("time limit for an answer of the broker; after it the connection is opened again", "s", 0.2, 60.0)
    ] = 5.0
    reconnect_first_s: Annotated[float, number("first back-off before a new attempt to connect", "s", 0.05, 60.0)] = 0.5
    reconnect_cap_s: Annotated[
        float,
        number("longest back-off; each is twice the one before, reduced by a random part of up to one half", "s", 0.05, 600.0),
    ] = 30.0
    commands_max_hz: Annotated[
        int, number("rate of commands, or of the ship's reports, that closes the connection", "Hz", 1, 60)
    ] = 10
    spool: Annotated[
        str,
        text(
            "folder of events that wait; empty for $STATE_DIRECTORY/mqtt, or memory alone without that",
            4096,
            shortest=0,
            public=True,
        ),
    ] = ""
    spool_max_kib: Annotated[int, number("bound of that folder; the oldest events go first", "KiB", 8, 1_048_576)] = 16_384
    spool_fsync: Annotated[
        Literal["always", "second", "never"],
        choice("when events are forced to the disk: each at once, once a second, or as the system likes"),
    ] = "second"

    def __post_init__(self) -> None:
        check_order(self, "reconnect_first_s <= reconnect_cap_s")
        if bool(self.certificate_file) != bool(self.key_file):
            raise ValueError("certificate_file and key_file need each other")
        if (self.commands == "signed") != bool(self.command_key_file):
            raise ValueError('commands = "signed" and command_key_file need each other')
        if self.commands == "broker" and self.transport != "off":
            if self.transport != "tls" and not on_loopback(self.host):
                raise ValueError('commands = "broker" needs transport = "tls": on plain TCP anybody may be the broker')
            if not (self.user or self.certificate_file):
                raise ValueError('commands = "broker" needs a user or a certificate_file: the broker must know who is who')
        if self.password_file and not self.user:
            raise ValueError("password_file needs a user")

    @property
    def orders_recordings(self) -> bool:
        return self.transport != "off"

    @property
    def server(self) -> tuple[str, int] | None:
        return (self.host, self.port) if self.transport != "off" else None

    @property
    def in_words(self) -> str:
        return "off" if self.transport == "off" else f"{self.transport} to {self.host}:{self.port} as {self.drone}"

    def fault(self, settings: Any) -> str | None:
        if settings.vessel.mqtt and (self.transport == "off" or self.commands == "off"):
            return "vessel.mqtt needs mqtt.transport and mqtt.commands: reports come from whom commands may come"
        return None

    def claims(self) -> list[Claim]:
        if self.transport == "off":
            return []
        what = f"the name {self.drone!r} at the broker {self.host}:{self.port}"
        return [Claim(f"mqtt {host_and_port(self.host, self.port)} {self.drone}", what, "give this one another mqtt.drone")]
