"""Access to commands over MQTT: nobody by default, holders of the key, or users whom the broker lets."""

import asyncio
import hashlib
import hmac
import json
import re
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.parts.mqtt.commands import CommandHandler, RefusedMessage, signed, verified
from companion.parts.mqtt.connection import BrokerEndpoint, Connection, connect
from companion.parts.mqtt.messages import Topics
from companion.settings.links import MqttSettings
from companion.settings.load import from_mapping
from estimator.contracts.errors import BadInput
from estimator.contracts.time import MonoNs
from tests.support.fake_operator import FakeOperator
from tests.support.mosquitto import Broker
from tests.support.mqtt_service import RUN, SESSION, RunningPart, running
from tests.support.waiting import until

ROOT = Path(__file__).parents[3]
TREE = "decklander/v2/deck/"
KEY = bytes(range(32))
NOW = MonoNs(5_000_000_000)


def body(**changes: object) -> bytes:
    return json.dumps({"command": "start", "id": "a", "run": RUN, "expires_ns": NOW + 10**9, **changes}).encode()


def command_handler() -> tuple[CommandHandler, FakeOperator]:
    operator = FakeOperator()
    return CommandHandler(Topics("deck"), SESSION, operator, RUN, KEY), operator


def test_only_the_right_key_topic_and_bytes_are_obeyed() -> None:
    good = signed(KEY, TREE + "command", body())
    for payload, reason in (
        (body(), "unsigned"),
        (b"", "unsigned"),
        (b"0" * 64 + b" " + body(), "bad_signature"),
        (signed(bytes(32), TREE + "command", body()), "bad_signature"),
        (signed(KEY, "decklander/v2/other/command", body()), "bad_signature"),
        (good[:-1] + b" }", "bad_signature"),
        (signed(KEY, TREE + "command", body(run="\ud800")), "malformed"),
    ):
        taker, operator = command_handler()
        handled = taker.take(payload, NOW)
        assert (handled.reply.accepted, handled.reply.reason) == (False, reason), payload
        assert operator.done == []
        assert RUN not in handled.reply.text
    taker, operator = command_handler()
    assert taker.take(good, NOW).reply.accepted
    assert operator.done == ["start"]
    assert not any(text in repr(taker) for text in (KEY.hex(), repr(KEY)))


def test_a_copy_is_answered_and_carried_out_no_second_time_whatever_comes_between() -> None:
    taker, operator = command_handler()
    good = signed(KEY, TREE + "command", body())
    assert taker.take(good, NOW).reply.accepted
    for k in range(5000):
        taker.take(json.dumps({"command": "start", "id": f"junk {k}", "run": RUN, "expires_ns": NOW + 1}).encode(), NOW)
    again = taker.take(good, MonoNs(NOW + 10**10))
    assert (again.reply.accepted, again.repeated) == (True, True), "the first answer, even after it has expired"
    assert operator.done == ["start"]
    later = CommandHandler(Topics("deck"), SESSION, operator, "f" * 32, KEY)
    assert later.take(good, NOW).reply.reason == "other_run", "after a restart"
    assert operator.done == ["start"]


@given(st.one_of(st.binary(max_size=200), st.binary(max_size=80).map(lambda junk: b"0" * 64 + b" " + junk)))
def test_any_bytes_are_no_signature(payload: bytes) -> None:
    with pytest.raises(RefusedMessage):
        verified(KEY, TREE + "command", payload)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"commands": "signed"}, "need each other"),
        ({"command_key_file": "k"}, "need each other"),
        ({"commands": "broker", "command_key_file": "k", "transport": "tls", "user": "u"}, "need each other"),
        ({"commands": "broker", "transport": "tcp", "host": "10.0.0.2", "user": "u"}, 'needs transport = "tls"'),
        ({"commands": "broker", "transport": "tls", "host": "10.0.0.2"}, "needs a user or a certificate_file"),
    ],
)
def test_settings_that_would_let_anybody_command_are_refused(table: dict[str, object], said: str) -> None:
    rest = {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}}
    with pytest.raises(BadInput, match=f"mqtt.*{re.escape(said)}"):
        from_mapping({**rest, "mqtt": table}, "rig.toml")
    assert MqttSettings().commands == "off"


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    path = tmp_path / "command.key"
    path.touch(0o600)
    path.write_bytes(KEY)
    return path


@asynccontextmanager
async def listening(broker: Broker, tmp_path: Path, **changes: object) -> AsyncIterator[tuple[RunningPart, Connection]]:
    """Yield a part, and a ground station that receives its answers."""
    async with running(broker.settings(**changes), tmp_path / "spool") as rig, broker.ground() as ground:
        await until(lambda: rig.count("connections") == 1)
        await ground.subscribe([(TREE + "reply/#", 1), (TREE + "operator", 1)])
        yield rig, ground


async def test_by_default_nobody_commands(broker: Broker, tmp_path: Path) -> None:
    async with listening(broker, tmp_path, commands="off") as (rig, ground):
        for k in range(3):
            await ground.publish_message(TREE + "command", body(id=f"c{k}", expires_ns=rig.clock.now() + 30 * 10**9), qos=1)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3):
                await anext(ground.publications())
        assert rig.operator.done == []


async def test_what_a_display_may_read_reports_no_run_and_lets_it_command_nothing(broker: Broker, tmp_path: Path) -> None:
    """The shipped access list lets the display read, and the ground command."""
    acl = (ROOT / "configs/broker/decklander.acl").read_text().replace("user display", "user mute")
    broker.stop()
    drone = "\nuser drone\ntopic write decklander/v2/deck/#\ntopic read decklander/v2/deck/command\n"
    (broker.folder / "acl").write_text(acl + drone)
    broker.start()
    async with (
        connect(BrokerEndpoint.of(broker.settings("mute")), "display", incoming=1000) as display,
        listening(broker, tmp_path, state_hz=20.0, health_hz=10.0) as (rig, ground),
        asyncio.timeout(60),
    ):
        await display.subscribe([("decklander/#", 1), ("decklander/v2/deck/operator", 1)])
        command = body(expires_ns=rig.clock.now() + 30 * 10**9)
        await display.publish_message(TREE + "command", command, qos=1)
        await ground.publish_message(TREE + "command", command.replace(b"start", b"pause"), qos=1)
        await until(lambda: rig.count("commands_accepted") == 1)
        assert rig.operator.done == ["pause"]
        leaves: set[str] = set()
        async for publication in display.publications():
            assert RUN.encode() not in publication.payload
            leaves.add(publication.topic.removeprefix(TREE))
            if {"status", "health", "event"} <= leaves and rig.count("health_sent") > 3:
                break
        assert leaves <= {"status", "state", "sighting", "health", "event"}


async def test_the_script_of_the_examples_commands_a_drone(broker: Broker, tmp_path: Path, key_file: Path) -> None:
    changes = {"commands": "signed", "command_key_file": str(key_file), "health_hz": 10.0}
    words = ["localhost", str(broker.port), str(broker.certificates / "ca.crt"), "ground", str(broker.folder / "ground.password")]
    async with listening(broker, tmp_path, **changes) as (rig, _):
        child = await asyncio.create_subprocess_exec(
            *(sys.executable, str(ROOT / "examples/mqtt_command.py"), *words, "deck", str(key_file), '{"command": "pause"}'),
            stdout=asyncio.subprocess.PIPE,
        )
        async with asyncio.timeout(60):
            out, _ = await child.communicate()
        assert (child.returncode, rig.operator.done) == (0, ["pause"])
        assert b"accepted" in out


def test_openssl_in_the_docs_makes_the_same_signature(tmp_path: Path, key_file: Path) -> None:
    page = (ROOT / "docs/mqtt.md").read_text()
    match = re.search(r"```sh\n(# sign\.sh.*?)```", page, re.DOTALL)
    assert match is not None
    (tmp_path / "body.json").write_bytes(body())
    done = subprocess.run(["sh", "-c", match[1]], cwd=tmp_path, capture_output=True, check=True)
    assert done.stdout == signed(KEY, "decklander/v2/alpha/command", body())
    assert done.stdout[:64] == hmac.new(KEY, b"decklander/v2/alpha/command\n" + body(), hashlib.sha256).hexdigest().encode()
