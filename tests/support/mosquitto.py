"""A mosquitto of our own on a free port of the loopback, with TLS, a password file and an ACL."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from companion.parts.mqtt.connection import BrokerEndpoint, Connection, Publication, connect
from companion.parts.mqtt.options import MqttSettings
from tests.support.waiting import accepts, free_port, wait_until

MOSQUITTO = shutil.which("mosquitto", path=os.environ.get("PATH", "") + ":/usr/sbin:/usr/local/sbin")

CONFIGS = Path(__file__).parents[2] / "configs/broker"

ACL = """
user drone
topic write decklander/v2/deck/#
topic read decklander/v2/deck/command
topic read decklander/v2/deck/vessel
user ship
topic read decklander/v2/+/operator
topic read decklander/v2/+/health
topic write decklander/v2/+/vessel
user ground
topic read decklander/v2/#
topic write decklander/v2/+/command
user mute
topic read decklander/v2/#
topic write decklander/v2/deck/status
"""


def need_mosquitto() -> None:
    """Skip where there is none; on CI that is a failure."""
    if MOSQUITTO is None:
        (pytest.fail if os.environ.get("CI") else pytest.skip)("no mosquitto on this machine (apt install mosquitto)")


@dataclass
class Broker:
    """A broker that can be started, stopped, killed and held up."""

    folder: Path
    certificates: Path
    require_certificate: bool = False
    port: int = field(default_factory=free_port)
    process: subprocess.Popen[bytes] | None = None

    def write_files(self) -> None:
        (self.folder / "acl").write_text(ACL)
        (self.folder / "passwords").write_text("".join(f"{user}:{user}-secret\n" for user in ("drone", "ship", "ground", "mute")))
        tool = shutil.which("mosquitto_passwd")
        assert tool is not None
        subprocess.run([tool, "-U", "passwords"], cwd=self.folder, check=True, capture_output=True)
        for user in ("drone", "ship", "ground", "mute", "wrong"):
            (self.folder / f"{user}.password").write_text(f"{user}-secret\n")
            (self.folder / f"{user}.password").chmod(0o600)
        for name in ("acl", "passwords"):
            (self.folder / name).chmod(0o600)
        user = "user root\n" if os.geteuid() == 0 else ""
        (self.folder / "mosquitto.conf").write_text(
            f"{user}listener {self.port} 127.0.0.1\nallow_anonymous false\npassword_file {self.folder}/passwords\n"
            f"acl_file {self.folder}/acl\ncafile {self.certificates}/ca.crt\ncertfile {self.certificates}/server.crt\n"
            f"keyfile {self.certificates}/server.key\nrequire_certificate {str(self.require_certificate).lower()}\n"
            f"persistence true\npersistence_location {self.folder}/\nautosave_on_changes true\nautosave_interval 1\n"
            "set_tcp_nodelay true\nmax_inflight_messages 0\nmax_queued_messages 100000\nlog_type error\nlog_type warning\n"
        )

    def write_sample(self) -> None:
        """Write the shipped configuration with its files here and its port ours."""
        text = (CONFIGS / "mosquitto.conf").read_text().replace("listener 8883", f"listener {self.port} 127.0.0.1")
        for shipped, ours in (
            ("/etc/mosquitto/decklander.passwords", self.folder / "passwords"),
            ("/etc/mosquitto/decklander.acl", self.folder / "acl"),
            ("/etc/mosquitto/certs", self.certificates),
            ("/var/lib/mosquitto", self.folder),
        ):
            assert shipped in text
            text = text.replace(shipped, str(ours))
        user = "user root\n" if os.geteuid() == 0 else ""
        (self.folder / "mosquitto.conf").write_text(user + text)
        (self.folder / "acl").write_text((CONFIGS / "decklander.acl").read_text())

    def start(self) -> None:
        assert MOSQUITTO is not None
        log = (self.folder / "log").open("ab")
        self.process = subprocess.Popen(
            [MOSQUITTO, "-c", str(self.folder / "mosquitto.conf")], stdout=log, stderr=subprocess.STDOUT
        )
        log.close()
        process = self.process
        wait_until(lambda: process.poll() is not None or accepts(self.port))
        assert process.poll() is None, (self.folder / "log").read_text()

    def stop(self, how: signal.Signals = signal.SIGTERM) -> None:
        if self.process is not None:
            self.process.send_signal(how)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
            self.process = None

    def away(self, how: signal.Signals, seconds: float) -> None:
        """Gone for a while. Blocks."""
        self.stop(how)
        time.sleep(seconds)
        self.start()

    def hold(self) -> None:
        """Stop the process; its sockets stay open."""
        self.process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        if self.process is not None:
            self.process.send_signal(signal.SIGCONT)

    def settings(self, user: str = "drone", **changes: object) -> MqttSettings:
        given: dict[str, object] = {
            "transport": "tls",
            "host": "localhost",
            "port": self.port,
            "drone": "deck",
            "commands": "broker",
            "user": user,
            "password_file": str(self.folder / f"{user}.password"),
            "ca_file": str(self.certificates / "ca.crt"),
            "timeout_s": 1.0,
            "reconnect_first_s": 0.05,
            "reconnect_cap_s": 0.3,
            **changes,
        }
        return MqttSettings(**given)  # type: ignore[arg-type]

    @asynccontextmanager
    async def ground(self) -> AsyncIterator[Connection]:
        """Yield a ground station's connection."""
        async with connect(BrokerEndpoint.of(self.settings("ground", timeout_s=10.0)), "ground", incoming=100_000) as connection:
            yield connection


async def on_message(connection: Connection, topic: str) -> AsyncIterator[Publication]:
    """Everything on a topic, what was retained included."""
    await connection.subscribe(topic, qos=1)
    async for received_at in connection.publications():
        yield received_at
