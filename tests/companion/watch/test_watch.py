"""`decklander watch`: what it keeps, what it shows, and the command against a real broker."""

import asyncio
import re
import socket
import sys
from itertools import count
from pathlib import Path
from typing import Literal

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.base.health import Health
from companion.base.observer import Decision
from companion.cli import main as cli
from companion.cli.watch import DRONES, WatchModel, line, screen
from companion.parts.mqtt import encode, messages
from companion.parts.mqtt.messages import EventMessage, StatusMessage, Topics
from drivers.clock import SystemClock
from estimator.contracts.errors import Recoverable
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs
from tests.companion.mqtt.conftest import broker, certificates
from tests.support.mosquitto import Broker
from tests.support.mqtt_service import SESSION, decision, running, vehicle_status
from tests.support.mqtt_service import event as pending_event
from tests.support.waiting import PATIENCE_S, free_port, until

__all__ = ["broker", "certificates"]

NOW = MonoNs(60_000_000_000)
ROOT = Path(__file__).parents[3]


def event(number: int, text: str = "landed", spool: str = "s") -> EventMessage:
    return EventMessage(
        session=SESSION, at_ns=NOW, id=f"{SESSION}-{number}", spool=spool, sequence=number, kind="phase", text=text, data={}
    )


def online(reason: Literal["up", "stopped", "lost"] = "up") -> StatusMessage:
    return StatusMessage(
        session=SESSION, at_ns=NOW, online=reason == "up", reason=reason, version="1.2", started_unix_s=0.0, started_ns=0,
    )  # fmt: skip


def on_message(model: WatchModel, drone: str, leaf: str, message: messages.Message, at_s: float = 0.0) -> None:
    assert model.on_message(Topics(drone).of(leaf), messages.encode(message), at_s) is not None


def full() -> WatchModel:
    model = WatchModel()
    model.connected = True
    health = Health(SystemClock())
    health.up("vehicle")
    health.down("broker", Recoverable("unplugged"))
    health.frame(Verdict.FUSED)
    health.beat("Imu")
    for k in range(100):
        health.delay("exposure_to_belief", 0.02 + 0.0001 * k)
    health.counters("mqtt", lambda: {"events_waiting": 3})
    on_message(model, "deck", "status", online())
    on_message(model, "deck", "state", encode.state(SESSION, decision(NOW), vehicle_status(NOW, battery=0.15)))
    on_message(model, "deck", "health", encode.health(SESSION, health.snapshot()))
    on_message(model, "deck", "event", event(1, "pad in sight"))
    return model


def test_one_screen_shows_where_the_pad_is_how_the_parts_are_and_what_happened() -> None:
    text = "\n".join(screen(full(), 0.0, 150, 45, colour=False))
    for part in (
        "connected", "deck  online  version 1.2", "phase    approach", "height  2.00 m   sideways  0.36 m", "20.0 cm sideways",
        "heading +29 deg", "forward +0.40 right +0.50 down +0.60 m/s   turn +40 deg/s", "flying   battery 15 %",
        "exposure to belief 25.0 ms (p99 29.9)", "fused 1", "events delivered 0, waiting 3", "phase    pad in sight",
    ):  # fmt: skip
        assert part in text, text
    assert re.search(r"^vehicle +up +0 s  0$", text, re.MULTILINE)
    assert re.search(r"^broker +down +0 s  1  unplugged$", text, re.MULTILINE)


def test_what_does_not_fit_beside_goes_below_and_commands_of_others_are_not_the_drone_s_words() -> None:
    model = full()
    health = Health(SystemClock())
    for k in range(12):
        health.beat(f"Kind{k}")
    on_message(model, "deck", "health", encode.health(SESSION, health.snapshot()))
    text = "\n".join(screen(model, 0.0, 60, 45, colour=False))
    assert all(f"Kind{k} --" in text for k in range(12))
    model.on_message(Topics("deck").of("command"), b"{}", 0.0)
    assert model.drones["deck"].malformed == 0
    model.on_message(Topics("deck").of("state"), b"{}", 0.0)
    assert model.drones["deck"].malformed == 1


@pytest.mark.hazard("H9")
def test_a_drone_that_falls_silent_does_not_look_alive() -> None:
    model = full()
    text = "\n".join(screen(model, 20.0, 150, 45, colour=False))
    assert "deck  silent" in text
    assert "20 s old" in text
    on_message(model, "deck", "status", online("lost"), 20.0)
    assert "deck  lost" in "\n".join(screen(model, 20.0, 150, 45, colour=False))


def test_a_fleet_is_a_table_above_the_first_by_name() -> None:
    model = full()
    on_message(model, "aft", "status", online("stopped"))
    lines = screen(model, 0.0, 150, 45, colour=False)
    assert [row.split()[:2] for row in lines[3:5]] == [["aft", "stopped"], ["deck", "online"]]
    assert lines[6].startswith("aft  stopped")
    status = messages.encode(online())
    for k in range(19):
        on_message(model, "aft", "status", online(), 0.5 * (k + 1))
    row = screen(model, 9.5, 150, 45, colour=False)[3].split()
    assert (float(row[-2]), float(row[-1])) == pytest.approx((20 / 9.5, 20 * len(status) / 9.5e3), abs=0.1), (
        "messages and kB a second"
    )
    for k in range(DRONES + 10):
        model.on_message(Topics(f"d{k}").of("status"), status, 0.0)
    assert (len(model.drones), model.ignored) == (DRONES, 12), "a crowd of names is bounded"
    only = WatchModel("deck")
    assert only.on_message(Topics("aft").of("status"), messages.encode(online()), 0.0) is None
    assert only.ignored == 1


def test_copies_are_thrown_away_and_gaps_are_counted() -> None:
    model = WatchModel()
    for number in (1, 2, 2, 1, 3, 7):
        on_message(model, "deck", "event", event(number))
    on_message(model, "deck", "event", msgspec.structs.replace(event(1, spool="new"), id="other-1"))
    drone = model.drones["deck"]
    assert [e.sequence for e in drone.events] == [1, 2, 3, 7, 1]
    assert (drone.copies, drone.missing) == (2, 3)
    assert "events missing 3, copies 2" in "\n".join(screen(model, 0.0, 150, 45, colour=False))


@given(st.text(max_size=40), st.binary(max_size=60), st.integers(1, 60), st.integers(1, 200))
@settings(max_examples=150)
def test_nothing_on_the_broker_can_break_the_screen_or_steer_the_terminal(text, payload, height, width):
    model = full()
    for leaf in (*messages.PUBLISHED, "reply/x", "nonsense"):
        model.on_message(Topics("deck").of(leaf), payload, 0.0)
    on_message(model, "deck", "event", event(2, "\x1b[2J\x07" + text))
    state = encode.state(SESSION, Decision(NOW, "\x1b]0;owned\x07" + text, None, None), None)
    on_message(model, "deck", "state", state)
    lines = screen(model, 0.0, width, height, colour=False)
    assert len(lines) <= height
    assert all(len(row) <= width and row.isprintable() for row in lines)
    coloured = screen(model, 0.0, width, height)
    assert [re.sub(r"\x1b\[\d+m", "", row) for row in coloured] == lines
    drone = model.drones["deck"]
    assert line(drone, drone.events[-1]).isprintable()
    assert line(drone, None).isprintable()


def words_for(broker: Broker, *more: str) -> list[str]:
    """Return the command that watches a broker as its ground station."""
    words = ["watch", "--host", "localhost", "--port", str(broker.port), "--user", "ground", *more]
    return [*words, "--password-file", str(broker.folder / "ground.password"), "--ca-file", str(broker.certificates / "ca.crt")]


def test_a_broker_that_does_not_answer_or_has_no_drones_is_reported(broker: Broker, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        assert cli.main(["watch", "--host", "127.0.0.1", "--port", str(port), "--plain-tcp", "--seconds", "3"]) == 1
    assert f"no connection: nothing answers at broker 127.0.0.1:{port} (plain TCP) yet" in capsys.readouterr().err
    assert cli.main(["watch", "--host", "localhost", "--port", str(broker.port), "--plain-tcp", "--seconds", "0.7"]) == 1
    output = capsys.readouterr().err
    assert output.startswith(f"connecting to broker localhost:{broker.port} (plain TCP) ...\n")
    assert f"decklander: no answer from broker localhost:{broker.port} (plain TCP) within 0.7 s" in output
    assert "a broker that expects TLS does not answer plain TCP" in output
    assert cli.main(["watch", "--host", "127.0.0.1", "--port", str(free_port()), "--plain-tcp", "--seconds", "0.7"]) == 1
    assert capsys.readouterr().err.endswith("nothing listens there: start it, or check address and port\n")
    # A busy machine, on which not even the handshake is over in that time, is given more.
    assert any(cli.main(words_for(broker, "--seconds", seconds)) == 0 for seconds in ("0.7", "3", "12"))
    assert f"connected to broker localhost:{broker.port} (TLS), but no drone published anything" in capsys.readouterr().err


async def test_where_there_is_no_terminal_it_prints_lines(broker: Broker, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "companion.cli.main", *words_for(broker)]
    async with running(broker.settings(), tmp_path / "spool") as rig:
        await until(lambda: rig.count("connections") == 1)
        watch = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE, cwd=ROOT)

        async def fly() -> None:
            for k in count():
                rig.part.on_sample(vehicle_status(rig.clock.now()))
                rig.part.on_decision(decision(rig.clock.now()))
                rig.part.tell(pending_event(rig.clock.now(), f"number {k}"))
                await asyncio.sleep(0.1)

        wanted = [
            re.compile(r"^deck online approach: height  2\.00 m   sideways  0\.36 m .* battery 80 %$", re.MULTILINE),
            re.compile(r"^deck event \d+ phase: number \d+$", re.MULTILINE),
        ]
        text = ""
        async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as group:
            flying = group.create_task(fly())
            while not all(pattern.search(text) for pattern in wanted):
                line = await watch.stdout.readline()
                assert line, text
                text += line.decode()
            flying.cancel()
        watch.terminate()
        await watch.wait()
    assert "\x1b" not in text
