"""The wire without sockets: any bytes are a command or a refusal, messages read back, and who may command."""

import asyncio
import hashlib
import hmac
import json
import math
import re
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.base.health import Health
from companion.cli.main import main
from companion.facts import encode as facts
from companion.parts.mqtt import encode, messages
from companion.parts.mqtt.connection import BrokerEndpoint, Connection, connect, tls_context
from companion.parts.mqtt.encode import Changes
from companion.parts.mqtt.messages import PUBLISHED, Topics, decode, split
from companion.parts.mqtt.options import MqttSettings
from companion.parts.mqtt.part import FARTHEST_S, LONGEST_BYTES, CommandHandler, RefusedMessage, signed, spool_folder, verified
from companion.settings.load import from_mapping
from drivers.clock import SystemClock
from estimator.contracts.commands import Lean
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs
from tests.make import seen
from tests.support.fake_operator import FakeOperator
from tests.support.mosquitto import Broker
from tests.support.mqtt_service import RUN, SESSION, RunningPart, decision, running, vehicle_status
from tests.support.waiting import until

ROOT = Path(__file__).parents[3]
NOW = MonoNs(5_000_000_000)
GOOD: dict[str, Any] = {"command": "begin", "id": "a", "run": RUN, "given_ns": NOW - 1, "expires_ns": NOW + 1}


def command_handler() -> CommandHandler:
    return CommandHandler(Topics("deck"), SESSION, FakeOperator(), RUN)


def command(**changes: object) -> bytes:
    fields = {key: value for key, value in {**GOOD, **changes}.items() if value is not ...}
    return json.dumps(fields).encode()


@pytest.mark.parametrize(
    ("payload", "retained", "reason", "text"),
    [
        (b"begin", False, "malformed", "malformed"),
        (command(command="start"), False, "malformed", "'start' - at `$.command`: known are begin, stay, hold, abort, record"),
        (command(run=...), False, "malformed", "run"),
        (command(speed=3), False, "malformed", "speed"),
        (command(command="record", on="luck"), False, "malformed", "$.on"),
        (command(id="x" * 65), False, "malformed", "64"),
        (b" " * (LONGEST_BYTES + 1), False, "too_long", "4097 bytes"),
        (command(), True, "retained", "retained"),
        (command(run="other"), False, "other_run", "another run"),
        (command(expires_ns=NOW - 2_000_000_000), False, "expired", "2 s after"),
        (command(expires_ns=NOW + round((FARTHEST_S + 1) * 1e9)), False, "expiry_too_far", "60 s"),
        (command(reply_to="decklander/v2/other/reply"), False, "reply_elsewhere", "decklander/v2/deck/reply"),
        (command(reply_to="decklander/v2/deck/reply/#"), False, "reply_elsewhere", "reply"),
    ],
)
def test_a_refusal_has_a_reason_in_a_word_and_in_words(payload: bytes, retained: bool, reason: str, text: str) -> None:
    at = command_handler()
    handled = at.take(payload, NOW, retained=retained)
    assert (handled.reply.accepted, handled.reply.reason) == (False, reason)
    assert text in handled.reply.text
    assert handled.topic == "decklander/v2/deck/reply"
    assert at.operated.done == []  # type: ignore[attr-defined]
    assert at.counts == {reason: 1}


def test_an_answer_names_the_command_and_goes_where_it_is_wanted() -> None:
    assert command_handler().take(command(command="fly", id="b7"), NOW).reply.id == "b7"
    assert command_handler().take(b'{"id": 7}', NOW).reply.id is None
    there = "decklander/v2/deck/reply/tablet"
    assert command_handler().take(command(command="begin"), NOW, reply_to=there).reply.text == "begin done"
    assert command_handler().take(command(), NOW, reply_to=there).topic == there
    assert command_handler().take(command(command="fly", reply_to=there), NOW).topic == there
    assert command_handler().take(command(), NOW, reply_to="home/lights").reply.reason == "reply_elsewhere"


@given(
    st.binary(max_size=80)
    | st.text(max_size=80).map(str.encode)
    | st.dictionaries(
        st.sampled_from([*GOOD, "on", "reply_to", "x"]),
        st.none() | st.booleans() | st.integers() | st.text(max_size=8) | st.sampled_from(list(GOOD.values())),
    ).map(lambda d: json.dumps({**GOOD, **d}).encode())
)
@settings(max_examples=300)
def test_any_bytes_are_a_command_or_a_refusal(payload: bytes) -> None:
    at = command_handler()
    handled = at.take(payload, NOW)
    assert handled.reply.accepted == (handled.reply.reason is None) == bool(at.operated.done)  # type: ignore[attr-defined]
    assert isinstance(decode("reply", messages.encode(handled.reply)), messages.CommandReply)
    for leaf in PUBLISHED:
        decode(leaf, payload)


def test_what_a_flight_reports_is_what_its_recording_has() -> None:
    frame = seen(NOW, True)
    sighted = decode("sighting", messages.encode(encode.sighting(SESSION, frame)))
    assert (sighted.at_ns, sighted.detection) == (frame.done, facts.detection(frame))
    lean = Lean(np.array([0.5, -0.25]), np.array([1.0, 2.0]), np.array([0.1, 0.2, 0.3]), 0.4)
    cycle, vehicle = decision(NOW, command=lean), vehicle_status(NOW)
    state = decode("state", messages.encode(encode.state(SESSION, cycle, vehicle)))
    assert (state.decision, state.vehicle) == (facts.decision(cycle), facts.status(vehicle))
    assert cycle.belief is not None
    assert state.belief == facts.belief(cycle.belief)
    silent = encode.state(SESSION, replace(decision(NOW), command=None, belief=None), None)
    assert (silent.decision.command, silent.belief, silent.vehicle) == (None, None, None)
    health = Health(SystemClock())
    health.down("camera", OSError("unplugged"))
    health.frame(Verdict.FUSED)
    health.counters("mqtt", lambda: {"sent": 3, "odd": math.nan})
    health.delay("vision", 0.004)
    output = encode.health(SESSION, health.snapshot())
    assert decode("health", messages.encode(output)) == output
    assert [(c.part, c.name, c.value) for c in output.health.counters] == [("mqtt", "sent", 3.0)], "nan is no JSON"


def test_changes_are_reported_once() -> None:
    changes = Changes()
    assert [h.text for h in changes.decision(decision(NOW, "approach"))] == ["approach"]
    assert changes.decision(decision(NOW, "approach")) == []
    (down,) = changes.decision(decision(NOW, "descend"))
    assert down.data["from"] == "approach"
    assert down.data["height_m"] == 2.0
    assert [h.text for h in changes.vehicle(vehicle_status(NOW))] == ["vehicle is flying"]
    assert changes.vehicle(vehicle_status(NOW)) == []
    assert [h.text for h in changes.vehicle(vehicle_status(NOW, battery=0.19))] == ["battery at 19 %"]
    assert changes.vehicle(vehicle_status(NOW, battery=0.1)) == []
    assert [h.text for h in changes.vehicle(vehicle_status(NOW, "emergency", 0.1, True))] == [
        "vehicle is emergency",
        "emergency: motors cut",
    ]


def test_the_pad_is_lost_after_a_second_without_it_not_after_one_frame() -> None:
    changes = Changes()
    reported = []
    for k, found in enumerate([False, True, False, True] + [False] * 40 + [True]):
        reported += [(k, h.text) for h in changes.frame(seen(MonoNs(NOW + k * 33_000_000), found))]
    assert reported == [(1, "pad in sight"), (34, "pad out of sight"), (44, "pad in sight")]


def test_topics_are_one_subtree_a_drone() -> None:
    topics = Topics("deck")
    assert topics.of("event") == "decklander/v2/deck/event"
    assert split(topics.of("state")) == ("deck", "state")
    assert split("decklander/v2/deck/reply/x") == ("deck", "reply/x")
    for other in ("decklander/v3/deck/state", "decklander/v2/deck", "a/b/c/d", "decklander/v2/ü/state"):
        assert split(other) is None
    for bad in ("", "a/b", "+", "#", "x" * 65, "a\n"):
        with pytest.raises(ValueError, match="not a name"):
            Topics(bad)


def test_secrets_come_from_files_or_credentials(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    file = tmp_path / "secret"

    def password(of: Path = file) -> str | None:
        return BrokerEndpoint.of(MqttSettings(user="u", password_file=str(of))).password

    file.write_text("hush\r\n")
    file.chmod(0o600)
    assert password() == "hush"
    assert not caplog.messages
    file.chmod(0o644)
    assert password() == "hush"
    assert "can be read by everyone" in caplog.text
    for content, words in ((b"\n", "is empty"), (b"\xff", "not UTF-8 text")):
        file.write_bytes(content)
        with pytest.raises(BadInput, match=words):
            password()
    with pytest.raises(BadInput, match="No such file"):
        password(tmp_path / "none")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"ca_file": "junk.pem"}, r"mqtt\.ca_file: .*junk\.pem"),
        ({"ca_file": "none"}, "No such file"),
        ({"certificate_file": "junk.pem", "key_file": "junk.pem"}, r"mqtt\.certificate_file, key_file: .*junk\.pem"),
    ],
)
def test_certificates_that_cannot_be_used_are_named(changes: dict[str, str], said: str, tmp_path: Path) -> None:
    (tmp_path / "junk.pem").write_text("nothing")
    with pytest.raises(BadInput, match=said):
        tls_context(MqttSettings(transport="tls", **{key: str(tmp_path / name) for key, name in changes.items()}))  # type: ignore[arg-type]


def test_the_spool_is_where_it_is_set_else_where_systemd_says_else_nowhere() -> None:
    assert spool_folder(MqttSettings(spool="/a"), {"STATE_DIRECTORY": "/b"}) == Path("/a")
    assert spool_folder(MqttSettings(), {"STATE_DIRECTORY": "/b:/c"}) == Path("/b/mqtt")
    assert spool_folder(MqttSettings(), {}) is None


def test_the_schema_is_printed_and_the_examples_of_the_page_are_good(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "--schema"]) == 0
    assert set(json.loads(capsys.readouterr().out)["$defs"]) >= {"OperatorNotice", "ShipReport", "BeginCommand"}
    page = (ROOT / "docs/mqtt.md").read_text()
    blocks = [block.split("```")[0] for block in page.split("```json\n")[1:]]
    examples = [json.loads(block) for block in blocks if "$schema" not in block]
    commands = [e for e in examples if "command" in e and "expires_ns" in e]
    reports = [e for e in examples if "latitude_deg" in e]
    output = [e for e in examples if e not in commands and e not in reports]
    for example in commands:
        msgspec.convert(example, messages.Command)
    for example in reports:
        msgspec.convert(example, messages.ShipReport)
    assert reports
    assert len(output) >= len(PUBLISHED)
    fitting = [{leaf for leaf in PUBLISHED if decode(leaf, json.dumps(e).encode()) is not None} for e in output]
    assert all(len(leaves) == 1 for leaves in fitting), fitting
    assert set.union(*fitting) == set(PUBLISHED)


TREE = "decklander/v2/deck/"
KEY = bytes(range(32))


def body(**changes: object) -> bytes:
    return command(**{"expires_ns": NOW + 10**9, **changes})


def handler_and_operator() -> tuple[CommandHandler, FakeOperator]:
    operator = FakeOperator()
    return CommandHandler(Topics("deck"), SESSION, operator, RUN, lambda: KEY), operator


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
        taker, operator = handler_and_operator()
        handled = taker.take(payload, NOW)
        assert (handled.reply.accepted, handled.reply.reason) == (False, reason), payload
        assert operator.done == []
        assert RUN not in handled.reply.text
    taker, operator = handler_and_operator()
    assert taker.take(good, NOW).reply.accepted
    assert operator.done == ["begin"]
    assert not any(text in repr(taker) for text in (KEY.hex(), repr(KEY)))


def test_a_copy_is_answered_and_carried_out_no_second_time_whatever_comes_between() -> None:
    taker, operator = handler_and_operator()
    good = signed(KEY, TREE + "command", body())
    assert taker.take(good, NOW).reply.accepted
    for k in range(5000):
        taker.take(command(id=f"junk {k}"), NOW)
    again = taker.take(good, MonoNs(NOW + 10**10))
    assert (again.reply.accepted, again.repeated) == (True, True), "the first answer, even after it has expired"
    assert operator.done == ["begin"]
    later = CommandHandler(Topics("deck"), SESSION, operator, "f" * 32, lambda: KEY)
    assert later.take(good, NOW).reply.reason == "other_run", "after a restart"
    assert operator.done == ["begin"]


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
        await ground.publish_message(TREE + "command", command.replace(b"begin", b"hold"), qos=1)
        await until(lambda: rig.count("commands_accepted") == 1)
        assert rig.operator.done == ["hold"]
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
            *(sys.executable, str(ROOT / "examples/mqtt_command.py"), *words, "deck", str(key_file), '{"command": "hold"}'),
            stdout=asyncio.subprocess.PIPE,
        )
        async with asyncio.timeout(60):
            out, _ = await child.communicate()
        assert (child.returncode, rig.operator.done) == (0, ["hold"])
        assert b"accepted" in out


def test_openssl_in_the_docs_makes_the_same_signature(tmp_path: Path, key_file: Path) -> None:
    page = (ROOT / "docs/mqtt.md").read_text()
    match = re.search(r"```sh\n(# sign\.sh.*?)```", page, re.DOTALL)
    (tmp_path / "body.json").write_bytes(body())
    done = subprocess.run(["sh", "-c", match[1]], cwd=tmp_path, capture_output=True, check=True)
    assert done.stdout == signed(KEY, "decklander/v2/alpha/command", body())
    assert done.stdout[:64] == hmac.new(KEY, b"decklander/v2/alpha/command\n" + body(), hashlib.sha256).hexdigest().encode()
