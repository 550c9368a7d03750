"""The wire without sockets: any bytes are a command or a refusal, every message reads back, changes become events once."""

import json
import math
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
from companion.parts.mqtt.commands import FARTHEST_S, LONGEST_BYTES, CommandHandler
from companion.parts.mqtt.connection import BrokerEndpoint
from companion.parts.mqtt.encode import Changes
from companion.parts.mqtt.messages import PUBLISHED, Topics, decode, split
from companion.parts.mqtt.part import spool_folder
from companion.settings import files
from companion.settings.links import MqttSettings
from companion.settings.referenced_files import tls_context
from drivers.clock import SystemClock
from estimator.contracts.commands import Lean
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs
from tests.make import seen
from tests.support.fake_operator import FakeOperator
from tests.support.mqtt_service import RUN, SESSION, decision, vehicle_status

ROOT = Path(__file__).parents[3]
NOW = MonoNs(5_000_000_000)
GOOD: dict[str, Any] = {"command": "start", "id": "a", "run": RUN, "expires_ns": NOW + 1}


def command_handler() -> CommandHandler:
    return CommandHandler(Topics("deck"), SESSION, FakeOperator(), RUN)


def command(**changes: object) -> bytes:
    fields = {key: value for key, value in {**GOOD, **changes}.items() if value is not ...}
    return json.dumps(fields).encode()


@pytest.mark.parametrize(
    ("payload", "retained", "reason", "text"),
    [
        (b"start", False, "malformed", "malformed"),
        (command(command="fly"), False, "malformed", "'fly'"),
        (command(run=...), False, "malformed", "run"),
        (command(speed=3), False, "malformed", "speed"),
        (command(command="path", path="luck"), False, "malformed", "luck"),
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
    assert command_handler().take(command(), NOW, reply_to=there).topic == there
    assert command_handler().take(command(), NOW, reply_to="home/lights").reply.reason == "reply_elsewhere"


@given(
    st.binary(max_size=80)
    | st.text(max_size=80).map(str.encode)
    | st.dictionaries(
        st.sampled_from([*GOOD, "path", "on", "reply_to", "x"]),
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
    assert isinstance(sighted, messages.SightingMessage)
    assert (sighted.at_ns, sighted.detection) == (frame.done, facts.detection(frame))
    lean = Lean(np.array([0.5, -0.25]), np.array([1.0, 2.0]), np.array([0.1, 0.2, 0.3]), 0.4)
    cycle, vehicle = decision(NOW, command=lean), vehicle_status(NOW)
    state = decode("state", messages.encode(encode.state(SESSION, cycle, vehicle)))
    assert isinstance(state, messages.StateMessage)
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
    assert files.find("credential:mqtt", "mqtt", {"CREDENTIALS_DIRECTORY": "/run/x"}) == Path("/run/x/mqtt")
    for reference, environment in (("credential:mqtt", {}), ("credential:../a", {"CREDENTIALS_DIRECTORY": "/x"})):
        with pytest.raises(BadInput, match="mqtt: 'credential:"):
            files.find(reference, "mqtt", environment)
    for content, words in ((b"\n", "is empty"), (b"\xff", "not text")):
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
    assert main(["config", "schema", "--mqtt"]) == 0
    assert set(json.loads(capsys.readouterr().out)["$defs"]) >= {"OperatorNotice", "ShipReport", "StartCommand"}
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
