"""A real mosquitto with TLS, a password file and an ACL: deliveries, answers, the cost of trouble, how it hangs up."""

import asyncio
import json
import socket
import struct
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from companion.parts.mqtt import part as part_module
from companion.parts.mqtt.connection import BrokerEndpoint, Connection, client_id
from companion.parts.mqtt.messages import CommandReply, StatusMessage, decode, encode
from companion.parts.mqtt.options import MqttSettings
from estimator.contracts.estimates import FusionResult, Verdict
from tests.support.mosquitto import Broker, on_message
from tests.support.mqtt_service import RUN, SESSION, decision, running, vehicle_status
from tests.support.waiting import answering, until

ROOT = Path(__file__).parents[3]
TREE = "decklander/v2/deck/"


async def test_what_is_reported_arrives_and_the_status_is_there_for_late_comers(broker: Broker, tmp_path: Path) -> None:
    settings = broker.settings(state_hz=20.0, health_hz=10.0)
    received_at: dict[str, Any] = {}
    async with running(settings, tmp_path / "spool") as rig:
        await until(lambda: rig.count("connections") == 1)
        async with broker.ground() as ground, asyncio.timeout(60):
            async for message in on_message(ground, TREE + "#"):
                rig.part.on_sample(vehicle_status(rig.clock.now()))
                rig.part.on_decision(decision(rig.clock.now()))
                leaf = message.topic.removeprefix(TREE)
                if leaf == "health" and "fusion" not in received_at:
                    at = rig.clock.now()
                    rig.health.fusion(FusionResult("ekf", "sighting", Verdict.NO_ATTITUDE, at, at))
                received_at[leaf] = decode(leaf, message.payload)
                assert received_at[leaf] is not None, message
                if {"status", "state", "health", "event", "fusion"} <= received_at.keys():
                    break
            reported = rig.health.fusion_states()[0].verdicts["no_attitude"]
            await asyncio.sleep(3.5 / settings.sighting_hz)
            assert rig.count("fusion_sent") <= reported, "what is not new is not said again"
    fusion = received_at["fusion"]
    assert [(s.newest.path, s.newest.source, s.newest.verdict) for s in fusion.sources] == [
        ("ekf", "sighting", Verdict.NO_ATTITUDE)
    ]
    assert (received_at["status"].online, received_at["status"].reason, received_at["status"].version) == (True, "up", "1.2.3")
    state = received_at["state"]
    assert (state.belief.d_body_pad_level, state.decision.command) == ([0.3, -0.2, 2.0], "velocity")
    assert any(part.name == "broker" and part.up for part in received_at["health"].health.parts)


async def test_leaving_says_stopped_and_dying_says_lost(broker: Broker, tmp_path: Path) -> None:
    async def retained() -> StatusMessage:
        async with broker.ground() as ground:
            async for message in on_message(ground, TREE + "status"):
                found = decode("status", message.payload)
                assert isinstance(found, StatusMessage)
                return found
        raise AssertionError

    async with running(broker.settings(), tmp_path / "spool") as rig:
        await until(lambda: rig.count("connections") == 1)
        assert (await retained()).online
    output = await retained()
    assert (output.online, output.reason) == (False, "stopped")

    words = (sys.executable, "-c", _DYING, msgspec.json.encode(broker.settings()).decode())
    child = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE, cwd=ROOT)
    assert await child.stdout.readline() == b"connected\n"
    child.kill()
    await child.communicate()
    async with asyncio.timeout(60):
        while (output := await retained()).online:  # noqa: ASYNC110 (the condition is the broker's)
            await asyncio.sleep(0.05)
    assert output.reason == "lost"


_DYING = """
import asyncio, json, sys, tempfile, pathlib
from companion.parts.mqtt.options import MqttSettings
from tests.support.mqtt_service import running
from tests.support.waiting import until
async def main():
    async with running(MqttSettings(**json.loads(sys.argv[1])), pathlib.Path(tempfile.mkdtemp())) as rig:
        await until(lambda: rig.count("connections") == 1)
        print("connected", flush=True)
        await asyncio.sleep(60)
asyncio.run(main())
"""


async def test_a_command_is_carried_out_once_and_answered_where_it_asks(broker: Broker, tmp_path: Path) -> None:
    async with broker.ground() as before:
        old = {"command": "abort", "id": "x", "run": RUN, "expires_ns": time.monotonic_ns() + 30 * 10**9}
        await before.publish_message(TREE + "command", json.dumps(old).encode(), qos=1, retain=True)
    async with running(broker.settings(), tmp_path / "spool") as rig, broker.ground() as ground:
        await until(lambda: rig.count("connections") == 1)
        await ground.subscribe(TREE + "reply/#", qos=1)
        expires = rig.clock.now() + 30 * 10**9

        async def ask(**fields: object) -> CommandReply:
            command = {"id": "a1", "run": RUN, "given_ns": rig.clock.now(), "expires_ns": expires, **fields}
            await ground.publish_message(TREE + "command", json.dumps(command).encode(), qos=1)
            received_at = await anext(ground.publications())
            assert received_at.topic == fields.get("reply_to", TREE + "reply")
            reply = decode("reply", received_at.payload)
            assert isinstance(reply, CommandReply)
            return reply

        async with asyncio.timeout(60):
            assert rig.operator.done == [], "what the broker had retained does not reach us"
            assert (await ask(command="begin")).accepted
            assert (await ask(command="begin")).accepted
            to = TREE + "reply/tablet-1"
            assert (await ask(command="record", on=True, id="a3", reply_to=to)).accepted
            assert (await ask(command="stay", id="a5", reply_to=to)).accepted
            late = await ask(command="abort", id="a4", expires_ns=rig.clock.now() - 1, reply_to=to)
            assert (late.id, late.accepted, late.reason) == ("a4", False, "expired")
            rig.operator.cannot = "the flight is over: landed"
            cannot = await ask(command="hold", id="a6")
            assert (cannot.reason, cannot.text) == ("not_possible", "the flight is over: landed")
            assert rig.operator.done == ["begin", "record True", "stay"]
        assert rig.count("commands_accepted") == 3
        assert rig.count("commands_repeated") == 1


async def test_the_shipped_broker_configuration_serves_a_drone_that_has_its_users_name(broker: Broker, tmp_path: Path) -> None:
    broker.stop()
    broker.write_sample()
    broker.start()
    async with running(broker.settings(drone="drone"), tmp_path / "own") as rig, broker.ground() as ground:
        await until(lambda: rig.count("events_delivered") >= 1)
        command = {"command": "hold", "id": "x", "run": RUN, "expires_ns": rig.clock.now() + 30 * 10**9}
        await ground.publish_message("decklander/v2/drone/command", json.dumps(command).encode(), qos=1)
        await until(lambda: rig.operator.done == ["hold"])
    async with running(broker.settings(drone="other"), tmp_path / "others") as rig:
        await until(lambda: rig.count("connection_failures") + rig.count("events_refused") >= 1)
        assert rig.count("events_delivered") == 0


async def test_a_cancellation_that_comes_with_the_answer_is_not_swallowed(monkeypatch: pytest.MonkeyPatch) -> None:
    connection = Connection(BrokerEndpoint("nowhere", 1, None, None, None, True, 5.0), "x", None, 1)
    sent = SimpleNamespace(rc=0, mid=1, is_published=lambda: False)
    monkeypatch.setattr(connection._client, "publish", lambda *_: sent)
    async with asyncio.TaskGroup() as group:
        saying = group.create_task(connection.publish_message("a", b"b", qos=1))
        await asyncio.sleep(0.01)
        connection._pending_publishes[1].set()
        saying.cancel()
        await asyncio.wait({saying})
    assert saying.cancelled()


async def test_a_socket_that_closes_before_the_loop_watches_it_is_left_alone(caplog: pytest.LogCaptureFixture) -> None:
    connection = Connection(BrokerEndpoint("nowhere", 1, None, None, None, True, 5.0), "x", None, 1)
    for end in socket.socketpair():
        connection._on_socket_register_write(None, None, end)
        end.close()
    await asyncio.sleep(0.01)
    assert caplog.messages == []


STATUS = "decklander/v2/drone/status"
DAYS_200_S = 200 * 86400.0


class WordyBroker:
    """Takes any client of MQTT 5, acknowledges everything, and keeps what was published."""

    def __init__(self) -> None:
        self.clients: list[tuple[str, asyncio.StreamWriter]] = []
        self.published: list[tuple[str, bytes]] = []
        self.hangs_up_at = ""

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            while True:
                head = (await reader.readexactly(1))[0]
                size = shift = 0
                while (digit := (await reader.readexactly(1))[0]) & 0x80:
                    size, shift = size | (digit & 127) << shift, shift + 7
                body = await reader.readexactly(size | digit << shift)
                writer.write(self._answer(head, body, writer))

    def _answer(self, head: int, body: bytes, writer: asyncio.StreamWriter) -> bytes:
        kind = head >> 4
        if kind == 1:
            at = 11 + body[10]  # behind the properties, shorter than 128 bytes here
            (length,) = struct.unpack_from(">H", body, at)
            self.clients.append((body[at + 2 : at + 2 + length].decode(), writer))
            return b"\x20\x03\x00\x00\x00"
        if kind == 8:
            return b"\x90\x04" + body[:2] + b"\x00\x01"
        if kind == 12:
            return b"\xd0\x00"
        if kind != 3:
            return b""
        (length,) = struct.unpack_from(">H", body)
        topic, rest, quality = body[2 : 2 + length].decode(), body[2 + length :], head >> 1 & 3
        if topic == self.hangs_up_at:
            writer.close()
            return b""
        self.published.append((topic, rest[(2 if quality else 0) + 1 :]))
        return b"\x40\x02" + rest[:2] if quality else b""

    @property
    def statuses(self) -> list[StatusMessage]:
        return [msgspec.json.decode(body, type=StatusMessage) for topic, body in self.published if topic == STATUS]

    def publish(self, topic: str, payload: bytes) -> None:
        body = struct.pack(">H", len(topic)) + topic.encode() + b"\x00" + payload
        size = bytes([len(body) & 127 | 128, len(body) >> 7]) if len(body) > 127 else bytes([len(body)])
        self.clients[-1][1].write(b"\x30" + size + body)


@asynccontextmanager
async def wordy() -> AsyncIterator[tuple[WordyBroker, MqttSettings]]:
    broker = WordyBroker()
    async with answering(broker.serve) as port:
        yield broker, MqttSettings(transport="tcp", port=port, timeout_s=2.0, reconnect_first_s=0.05, reconnect_cap_s=0.1)


@pytest.mark.parametrize(
    ("code", "said"),
    [(0x8E, "same client id"), (0x8B, "shuts down"), (0x97, "quota"), (0x98, "administrator"), (0x99, "format invalid")],
)
async def test_the_reason_of_the_broker_is_reported(code, said, tmp_path, caplog):
    async with wordy() as (broker, settings), running(settings, tmp_path / "spool") as rig:
        await until(lambda: len(broker.statuses) == 1)
        broker.clients[0][1].write(bytes([0xE0, 2, code, 0]))
        broker.clients[0][1].close()
        await until(lambda: len(broker.statuses) == 2)
        assert rig.count("connection_failures") == 1
        assert {name for name, _ in broker.clients} == {client_id("drone")}
    reported = [line for line in caplog.messages if "the broker ended the connection" in line]
    assert len(reported) == 1
    assert said in reported[0].lower()


@pytest.mark.parametrize("leaf", ["event", "health"])
async def test_a_broker_that_hangs_up_at_a_topic_gets_everything_else_and_it_is_named(leaf, tmp_path, caplog):
    """AWS IoT does so where a policy does not allow a topic."""
    async with wordy() as (broker, settings), running(replace(settings, health_hz=10.0), tmp_path / "spool") as rig:
        broker.hangs_up_at = f"decklander/v2/drone/{leaf}"
        await until(lambda: len(broker.statuses) == 4)
        await asyncio.sleep(0.3)
        assert len(broker.clients) == 4, "three connections ended at the events, and the next one stays"
        assert rig.count("connection_failures") == 3
        assert rig.count("connections") == 4
        assert {"event", "health"} - {name.rpartition("/")[2] for name, _ in broker.published} == {leaf}
    said = [line for line in caplog.messages if broker.hangs_up_at in line]
    assert f"ended just after publishing {broker.hangs_up_at}: may this user write there?" in said[0]
    assert "left out" in said[-1]


async def test_the_status_follows_a_clock_that_is_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    right, late_s = time.time, DAYS_200_S
    monkeypatch.setattr(time, "time", lambda: right() - late_s)
    monkeypatch.setattr(part_module, "_WATCH_CLOCK_S", 0.02)
    async with wordy() as (broker, settings), running(settings, tmp_path / "spool"):
        await until(lambda: len(broker.statuses) == 1)
        await asyncio.sleep(0.1)
        assert len(broker.statuses) == 1, "it is published when there is something to say"
        late_s = 0.0
        await until(lambda: len(broker.statuses) == 2)
        first, second = broker.statuses
        assert second.started_ns == first.started_ns
        assert second.started_unix_s - first.started_unix_s == pytest.approx(DAYS_200_S, abs=1.0)
        monkeypatch.setattr(part_module, "_STATUS_AGAIN_S", 0.1)
        await until(lambda: len(broker.statuses) >= 4)  # a broker that lost what it retained has it again


async def test_another_service_of_our_name_is_named_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def of(session: str, online: bool = True) -> bytes:
        reason = "up" if online else "lost"
        return encode(
            StatusMessage(session=session, at_ns=1, online=online, reason=reason, version="1", started_unix_s=0.0, started_ns=0)
        )

    async with wordy() as (broker, settings), running(settings, tmp_path / "spool") as rig:
        await until(lambda: len(broker.statuses) == 1)
        for payload in (of(SESSION), of("another", online=False), b"no status", b"\xff", of("another"), of("another")):
            broker.publish(STATUS, payload)
        await until(lambda: rig.count("namesakes") == 2)
        assert rig.count("connection_failures") == 0
    assert sum("give each drone a name of its own (mqtt.drone)" in line for line in caplog.messages) == 1


def test_a_client_id_is_of_one_computer_and_one_drone(tmp_path: Path) -> None:
    def computer(name: str, machine: str, address: str) -> Path:
        root = tmp_path / name
        (root / "etc").mkdir(parents=True)
        (root / "etc/machine-id").write_text(machine)
        (root / "sys/class/net/wlan0/device").mkdir(parents=True)
        (root / "sys/class/net/wlan0/address").write_text(address)
        (root / "sys/class/net/veth7").mkdir()
        (root / "sys/class/net/veth7/address").write_text(name)
        return root

    one, copied_card, other = computer("a", "1", "aa:bb"), computer("b", "1", "aa:cc"), computer("c", "2", "aa:bb")
    names = {client_id(drone, root) for drone in ("drone", "alpha") for root in (one, copied_card, other)}
    assert len(names) == 6
    assert client_id("drone", one) == client_id("drone", one)
    assert client_id("drone", tmp_path / "nothing").startswith("decklander-drone-")
