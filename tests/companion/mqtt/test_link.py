"""Tests with a real mosquitto with TLS, a password file and an ACL: deliveries, answers, and the cost of trouble."""

import asyncio
import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from companion.parts.mqtt.connection import BrokerEndpoint, Connection
from companion.parts.mqtt.messages import CommandReply, FusionMessage, HealthMessage, StateMessage, StatusMessage, decode
from estimator.contracts.estimates import FusionResult, Verdict
from tests.support.mosquitto import Broker, on_message
from tests.support.mqtt_service import RUN, decision, running, vehicle_status
from tests.support.waiting import until

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
    assert isinstance(fusion, FusionMessage)
    assert [(s.newest.path, s.newest.source, s.newest.verdict) for s in fusion.sources] == [("ekf", "sighting", "no_attitude")]
    assert isinstance(received_at["status"], StatusMessage)
    assert (received_at["status"].online, received_at["status"].reason, received_at["status"].version) == (True, "up", "1.2.3")
    state = received_at["state"]
    assert isinstance(state, StateMessage)
    assert state.belief is not None
    assert (state.belief.d_body_pad_level, state.decision.command) == ([0.3, -0.2, 2.0], "velocity")
    assert isinstance(received_at["health"], HealthMessage)
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
    assert child.stdout is not None
    assert await child.stdout.readline() == b"connected\n"
    child.kill()
    await child.communicate()
    async with asyncio.timeout(60):
        while (output := await retained()).online:  # noqa: ASYNC110 (the condition is the broker's)
            await asyncio.sleep(0.05)
    assert output.reason == "lost"


_DYING = """
import asyncio, json, sys, tempfile, pathlib
from companion.settings.links import MqttSettings
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
            command = {"id": "a1", "run": RUN, "expires_ns": expires, **fields}
            await ground.publish_message(TREE + "command", json.dumps(command).encode(), qos=1)
            received_at = await anext(ground.publications())
            assert received_at.topic == fields.get("reply_to", TREE + "reply")
            reply = decode("reply", received_at.payload)
            assert isinstance(reply, CommandReply)
            return reply

        async with asyncio.timeout(60):
            assert rig.operator.done == [], "what the broker had retained does not reach us"
            assert (await ask(command="start")).accepted
            assert (await ask(command="start")).accepted
            to = TREE + "reply/tablet-1"
            assert (await ask(command="path", path="median_mean", id="a2", reply_to=to)).accepted
            assert (await ask(command="record", on=True, id="a3", reply_to=to)).accepted
            late = await ask(command="abort", id="a4", expires_ns=rig.clock.now() - 1, reply_to=to)
            assert (late.id, late.accepted, late.reason) == ("a4", False, "expired")
            rig.operator.cannot = "the flight is over: landed"
            cannot = await ask(command="pause", id="a6")
            assert (cannot.reason, cannot.text) == ("not_possible", "the flight is over: landed")
            assert rig.operator.done == ["start", "path median_mean", "record True"]
        assert rig.count("commands_accepted") == 3
        assert rig.count("commands_repeated") == 1


async def test_the_shipped_broker_configuration_serves_a_drone_that_has_its_users_name(broker: Broker, tmp_path: Path) -> None:
    broker.stop()
    broker.write_sample()
    broker.start()
    async with running(broker.settings(drone="drone"), tmp_path / "own") as rig, broker.ground() as ground:
        await until(lambda: rig.count("events_delivered") >= 1)
        command = {"command": "pause", "id": "x", "run": RUN, "expires_ns": rig.clock.now() + 30 * 10**9}
        await ground.publish_message("decklander/v2/drone/command", json.dumps(command).encode(), qos=1)
        await until(lambda: rig.operator.done == ["pause"])
    async with running(broker.settings(drone="other"), tmp_path / "others") as rig:
        await until(lambda: rig.count("connection_failures") + rig.count("events_refused") >= 1)
        assert rig.count("events_delivered") == 0


async def test_a_cancellation_that_comes_with_the_answer_is_not_swallowed(monkeypatch: pytest.MonkeyPatch) -> None:
    connection = Connection(BrokerEndpoint("nowhere", 1, None, None, None, True, 10, 5.0), "x", None, 1)
    sent = SimpleNamespace(rc=0, mid=1, is_published=lambda: False)
    monkeypatch.setattr(connection._client, "publish", lambda *_: sent)
    async with asyncio.TaskGroup() as group:
        saying = group.create_task(connection.publish_message("a", b"b", qos=1))
        await asyncio.sleep(0.01)
        connection._pending_publishes[1].set()
        saying.cancel()
        await asyncio.wait({saying})
    assert saying.cancelled()
