"""The daemon as a process: settings with relative secrets, a broker with TLS, a vehicle that is not there."""

import asyncio
import json
import signal
import sys
from pathlib import Path
from typing import TypeVar

from companion.parts.mqtt.commands import signed
from companion.parts.mqtt.messages import (
    CommandReply,
    EventMessage,
    HealthMessage,
    Message,
    OperatorNotice,
    StatusMessage,
    decode,
)
from tests.support.mosquitto import Broker

ROOT = Path(__file__).parents[3]
TREE = "decklander/v2/deck/"
RIG = """
[vehicle]
kind = "ardrone"
host = "127.0.0.1"
[expert.vehicle]
navdata_port = 1
video_port = 1
at_port = 1
control_port = 1
[camera]
file = "sim"
[pad]
file = "thesis"
[mqtt]
transport = "tls"
host = "localhost"
port = {port}
drone = "deck"
user = "drone"
password_file = "broker/drone.password"
ca_file = "ca.crt"
spool = "spool"
commands = "signed"
command_key_file = "command.key"
[expert.mqtt]
health_hz = 5.0
[recorder]
folder = "{folder}/recordings"
"""
M = TypeVar("M", bound=Message)


async def test_the_daemon_answers_commands_and_says_goodbye(broker: Broker, tmp_path: Path) -> None:
    (tmp_path / "ca.crt").write_bytes((broker.certificates / "ca.crt").read_bytes())
    (tmp_path / "rig.toml").write_text(RIG.format(port=broker.port, folder=tmp_path))
    key = bytes(range(32))
    (tmp_path / "command.key").touch(0o600)
    (tmp_path / "command.key").write_bytes(key)
    async with broker.ground() as ground, asyncio.timeout(60):
        await ground.subscribe(TREE + "#", qos=1)
        daemon = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "companion.cli.main", "run", "--config", str(tmp_path / "rig.toml")),
            cwd=ROOT,
            stderr=asyncio.subprocess.PIPE,
        )
        received_at = ground.publications()
        events: list[str] = []
        runs: list[str] = []

        async def wait(kind: type[M]) -> M:
            async for message in received_at:
                output = decode(message.topic.removeprefix(TREE), message.payload)
                if isinstance(output, EventMessage):
                    events.append(output.text)
                if isinstance(output, OperatorNotice):
                    runs.append(output.run)
                if isinstance(output, kind):
                    return output
            raise AssertionError

        async def ask(**fields: object) -> CommandReply:
            health = await wait(HealthMessage)
            command = {"id": f"c{health.at_ns}", "run": runs[-1], "expires_ns": health.at_ns + 30 * 10**9, **fields}
            await ground.publish_message(TREE + "command", signed(key, TREE + "command", json.dumps(command).encode()), qos=1)
            return await wait(CommandReply)

        try:
            assert (await wait(StatusMessage)).online
            assert (await ask(command="start")).accepted
            assert (await ask(command="path", path="median_mean")).accepted
            assert (await ask(command="abort")).accepted
            late = await ask(command="start")
            assert (late.reason, late.text) == ("not_possible", "the flight is over: aborted")
            daemon.send_signal(signal.SIGTERM)
            farewell = await wait(StatusMessage)
            assert (farewell.online, farewell.reason) == (False, "stopped")
            await daemon.wait()
        finally:
            if daemon.returncode is None:
                daemon.kill()
            _, stderr = await daemon.communicate()
    assert daemon.returncode == 0, stderr.decode()
    assert events[0] == "service started"
    assert events[-1] == "service stopped"
    assert {"command start accepted", "command path accepted", "command abort accepted"} <= set(events)
    assert any(text.startswith("aborted") for text in events)
    assert "command start refused: the flight is over: aborted" in events
    assert "secret" not in stderr.decode()
