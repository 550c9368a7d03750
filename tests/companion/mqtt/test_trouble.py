"""A broker that refuses, hangs, stays silent, floods or goes: the loop keeps its pace, and no event is lost."""

import asyncio
import gc
import json
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import msgspec
import pytest

from companion.parts.mqtt.messages import (
    CommandReply,
    EventMessage,
    HealthMessage,
    Message,
    OperatorNotice,
    StatusMessage,
    decode,
)
from companion.parts.mqtt.options import MqttSettings
from companion.parts.mqtt.part import signed
from estimator.contracts.time import seconds_between
from tests.support.mosquitto import Broker
from tests.support.mqtt_consumer import consuming
from tests.support.mqtt_service import RUN, SESSION, RunningPart, decision, event, running
from tests.support.waiting import answering, until

HANG_S = 20.0
"""Time for which a disk or a resolver hangs in these tests, s."""
BLOCKING = ("socket.connect", "socket.getaddrinfo", "socket.gethostbyname", "os.truncate", "os.remove", "os.rename")


class Flight:
    """Guidance beside the part: what the part does to its thread. Not how late it is, which a busy machine decides."""

    def __init__(self, rig: RunningPart) -> None:
        self._rig = rig
        self.busy_s = 0.0
        """The most CPU time that the loop's thread took between two rounds."""
        self.rounds = 0
        self.blocking: list[str] = []
        """Calls on the loop's thread that wait for the network or the disk."""

    async def fly(self) -> None:
        global _flying
        _flying = (threading.get_ident(), self.blocking)
        try:
            while True:
                began = time.thread_time()
                self._rig.part.on_decision(decision(self._rig.clock.now()))
                await asyncio.sleep(0.01)
                self.busy_s = max(self.busy_s, time.thread_time() - began)
                self.rounds += 1
        finally:
            _flying = None


_flying: tuple[int, list[str]] | None = None


def _audit(event: str, args: tuple[object, ...]) -> None:
    flying = _flying
    if flying is None or threading.get_ident() != flying[0]:
        return
    if event in BLOCKING or (event == "open" and "spool" in str(args[0])):
        flying[1].append(f"{event} {args[:1]}")


sys.addaudithook(_audit)


async def test_a_call_that_waits_is_noticed_here(broker: Broker, tmp_path: Path) -> None:
    async with running(broker.settings(), tmp_path / "spool") as rig, asyncio.TaskGroup() as group:
        flight = Flight(rig)
        flying = group.create_task(flight.fly())
        await until(lambda: flight.rounds > 2)
        socket.gethostbyname("127.0.0.1")
        (tmp_path / "spool" / "name").read_text()
        flying.cancel()
    assert [words.split()[0] for words in flight.blocking] == ["socket.gethostbyname", "open"]


async def fly_until(settings: MqttSettings, folder: Path, enough: Callable[[RunningPart], bool]) -> tuple[RunningPart, Flight]:
    """Fly until `enough` holds, and a few rounds at least."""
    async with running(settings, folder) as rig, asyncio.TaskGroup() as group:
        flight = Flight(rig)
        flying = group.create_task(flight.fly())
        await until(lambda: enough(rig) and flight.rounds > 5)
        flying.cancel()
    return rig, flight


def failed(times: int) -> Callable[[RunningPart], bool]:
    """Return whether connecting has failed this many times."""
    return lambda rig: rig.count("connection_failures") >= times


def undisturbed(flight: Flight) -> None:
    assert flight.rounds > 5
    assert flight.blocking == []
    began = time.thread_time()
    sum(range(3_000_000))
    assert flight.busy_s < max(0.3, 10.0 * (time.thread_time() - began)), "0.3 s, and as much longer as this machine is slower"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"user": "wrong"}, "ot authorized"), ({"user": "wrong", "protocol": "3.1.1"}, "ot authori"),
        ({"ca": "stranger_ca.crt"}, "CERTIFICATE_VERIFY_FAILED"), ({"host": "127.0.0.2"}, "check address and port"),
        ({"host": "no such host"}, ""), ({"transport": "tcp"}, ""),
    ],
)  # fmt: skip
async def test_a_broker_that_will_not_have_us(broker: Broker, tmp_path: Path, changes: dict[str, str], said: str) -> None:
    changes = dict(changes)
    user = changes.pop("user", "drone")
    if ca := changes.pop("ca", None):
        changes["ca_file"] = str(broker.certificates / ca)
    rig, flight = await fly_until(broker.settings(user, **{"timeout_s": 0.4, **changes}), tmp_path / "spool", failed(1))
    assert rig.count("connections") == 0
    assert not rig.health.parts["broker"].up
    assert said in rig.health.parts["broker"].last_error
    assert rig.health.parts["mqtt"].restarts == 0
    undisturbed(flight)
    gc.collect()  # a socket that is left open is a warning here


async def test_a_line_that_is_open_and_silent(certificates: Path, tmp_path: Path) -> None:
    opened = 0

    async def accept(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal opened
        opened += 1
        await asyncio.sleep(30)

    async with answering(accept) as port:
        for transport in ("tcp", "tls"):
            settings = MqttSettings(
                transport=transport, host="127.0.0.1", port=port, timeout_s=0.2, reconnect_first_s=0.05, reconnect_cap_s=0.1,
                ca_file=str(certificates / "ca.crt"),
            )  # fmt: skip
            before = opened
            _, flight = await fly_until(settings, tmp_path / transport, failed(2))
            assert opened - before >= 2
            undisturbed(flight)
    sockets = [t for t in asyncio.all_tasks() if "_misc_loop" in repr(t)]
    assert sockets == [], "a connection that failed half-way is still tended"
    gc.collect()


@pytest.mark.hazard("H11")
async def test_a_broker_that_hangs_and_wakes_up(broker: Broker, tmp_path: Path) -> None:
    async with consuming(broker, 20) as consumer, running(broker.settings(timeout_s=0.4), tmp_path / "spool") as rig:
        await until(lambda: rig.count("connections") == 1)
        flight = Flight(rig)
        flying = asyncio.create_task(flight.fly())
        broker.hold()
        for n in range(20):
            rig.part.tell(event(rig.clock.now(), f"number {n}"))
        await until(lambda: rig.count("connection_failures") >= 2)
        assert not rig.health.parts["broker"].up
        broker.go_on()
        await asyncio.wait_for(consumer.done.wait(), 60.0)
        flying.cancel()
    assert consumer.numbers == list(range(20))
    undisturbed(flight)


async def test_a_flood_of_commands_is_cut_off(broker: Broker, tmp_path: Path) -> None:
    async with running(broker.settings(commands_max_hz=10), tmp_path / "spool") as rig, broker.ground() as ground:
        began = rig.clock.now()
        await until(lambda: rig.count("connections") == 1)
        async with asyncio.TaskGroup() as group:
            flight = Flight(rig)
            flying = group.create_task(flight.fly())
            for k in range(3000):
                command = {"command": "hold", "id": f"f{k}", "run": RUN, "expires_ns": rig.clock.now() + 10**10}
                await ground.publish_message("decklander/v2/deck/command", json.dumps(command).encode())
            await until(lambda: rig.count("floods") >= 1)
            await until(lambda: rig.count("connections") >= 2)
            flying.cancel()
        seconds = seconds_between(began, rig.clock.now())
        assert rig.count("commands_accepted") <= 10 * (rig.count("connections") + seconds)
        undisturbed(flight)


async def test_events_that_the_broker_forbids_are_kept(broker: Broker, tmp_path: Path) -> None:
    async with running(broker.settings("mute"), tmp_path / "spool") as rig:
        await until(lambda: rig.count("events_refused") >= 1)
        assert rig.count("events_delivered") == 0
        assert rig.count("connections") == 1
    async with consuming(broker, 1) as consumer, running(broker.settings(), tmp_path / "spool", session="allowed") as rig:
        rig.part.tell(event(rig.clock.now(), "number 0"))
        await consumer.done.wait()
    assert [e.session for e in consumer.others[:1]] == [SESSION]


async def test_a_client_certificate_where_one_is_required(broker: Broker, tmp_path: Path) -> None:
    broker.stop()
    broker.require_certificate = True
    broker.write_files()
    broker.start()
    rig, _ = await fly_until(broker.settings(), tmp_path / "none", failed(1))
    assert rig.count("connections") == 0
    folder = broker.certificates
    settings = broker.settings(certificate_file=str(folder / "client.crt"), key_file=str(folder / "client.key"))
    rig, _ = await fly_until(settings, tmp_path / "with", lambda rig: rig.count("connections") > 0)
    assert rig.count("connections") == 1


async def test_a_broker_of_the_older_version(broker: Broker, tmp_path: Path) -> None:
    async with running(broker.settings(protocol="3.1.1"), tmp_path / "spool") as rig, broker.ground() as ground:
        await until(lambda: rig.count("connections") == 1)
        await ground.subscribe("decklander/v2/deck/reply", qos=1)
        command = {
            "command": "begin",
            "id": "a",
            "run": RUN,
            "given_ns": rig.clock.now(),
            "expires_ns": rig.clock.now() + 30 * 10**9,
        }
        await ground.publish_message("decklander/v2/deck/command", json.dumps(command).encode(), qos=1)
        async with asyncio.timeout(60):
            assert b'"accepted":true' in (await anext(ground.publications())).payload
        assert rig.operator.done == ["begin"]


async def ended_after_s(settings: MqttSettings, folder: Path, enough: Callable[[RunningPart], bool]) -> float:
    """Return the time that the part takes to end once `enough` holds, s."""
    async with running(settings, folder) as rig:
        await until(lambda: enough(rig))
        began = time.monotonic()
    return time.monotonic() - began


async def test_a_resolver_that_hangs_holds_up_neither_the_flight_nor_its_end(tmp_path, monkeypatch):
    hang, asked, returned = threading.Event(), 0, 0

    def never(*_: object, **__: object) -> list[object]:
        nonlocal asked, returned
        asked += 1
        hang.wait(HANG_S)
        returned += 1
        return []

    monkeypatch.setattr(socket, "getaddrinfo", never)
    try:
        settings = MqttSettings(transport="tcp", host="deck", timeout_s=0.2, reconnect_first_s=0.05, reconnect_cap_s=0.05)
        _, flight = await fly_until(settings, tmp_path / "spool", failed(2))
        undisturbed(flight)
        assert asked == 1, "one thread, however often it is tried"
        hang.set()
        await until(lambda: returned == 1)
        hang.clear()
        slow = msgspec.structs.replace(settings, timeout_s=15.0)
        assert await ended_after_s(slow, tmp_path / "again", lambda _: asked == 2) < slow.timeout_s
    finally:
        hang.set()
        await asyncio.sleep(0.05)


@pytest.mark.parametrize("transport", ["tcp", "tls"])
async def test_a_broker_that_never_answers_does_not_hold_up_the_end(certificates, tmp_path, transport):
    """Connecting happens on a thread; it is ended rather than waited for."""
    ours = []
    with socket.create_server(("127.0.0.1", 0)) as silent:
        silent.setblocking(False)

        def accepted(_: object) -> bool:
            try:
                ours.append(silent.accept()[0])
            except BlockingIOError:
                return False
            return True

        port = silent.getsockname()[1]
        ca = str(certificates / "ca.crt") if transport == "tls" else ""
        settings = MqttSettings(transport=transport, host="127.0.0.1", port=port, timeout_s=20.0, ca_file=ca)
        assert await ended_after_s(settings, tmp_path / "spool", accepted) < settings.timeout_s
    for connection in ours:
        connection.close()


async def test_a_broker_that_sends_megabytes_is_hung_up_on(tmp_path: Path) -> None:
    """MQTT 3.1.1 has no word for how much we take, and a broker may not keep to MQTT 5's."""
    sent = 0

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal sent
        await reader.read(1000)
        writer.write(b"\x20\x02\0\0")
        await reader.read(1000)
        writer.write(b"\x90\x03\0\1\1")
        writer.write(b"\x30\x80\x80\x80\x08")  # a publication of 16 MiB
        with suppress(ConnectionError):
            for _ in range(256):
                writer.write(bytes(65_536))
                await writer.drain()
                sent += 65_536

    async with answering(serve) as port:
        settings = MqttSettings(
            transport="tcp", host="127.0.0.1", port=port, protocol="3.1.1", user="u", commands="broker", timeout_s=0.5,
            reconnect_first_s=60.0, reconnect_cap_s=60.0,
        )  # fmt: skip
        async with running(settings, tmp_path / "spool") as rig:
            await until(lambda: rig.count("connection_failures") == 1)
            assert sent < 16 << 20


async def test_a_disk_that_stands_still_does_not_hold_up_the_end(broker, tmp_path, monkeypatch):
    moving, stuck = threading.Event(), threading.Event()

    def hanging(*_: object) -> int:
        stuck.set()
        moving.wait(HANG_S)
        return 0

    monkeypatch.setattr("companion.parts.mqtt.spool.os.pwrite", hanging)
    try:
        took_s = await ended_after_s(broker.settings(), tmp_path / "spool", lambda _: stuck.is_set())
        assert took_s < HANG_S
    finally:
        monkeypatch.undo()
        moving.set()


async def test_events_survive_a_broker_that_stops_and_one_that_is_killed(broker: Broker, tmp_path: Path) -> None:
    total = 500
    async with consuming(broker, total) as consumer, running(broker.settings(), tmp_path / "spool") as rig:
        await until(lambda: rig.count("connections") == 1)
        for n in range(total):
            if n == 100:
                stopped = asyncio.create_task(asyncio.to_thread(broker.away, signal.SIGTERM, 1.0))
            if n == 400:
                await stopped
                await until(lambda: rig.count("connections") == 2)
                # What the broker has acknowledged and not handed on when it is killed is lost by the broker, not by us.
                await until(lambda: len(consumer.numbers) == 400)
                killed = asyncio.create_task(asyncio.to_thread(broker.away, signal.SIGKILL, 0.2))
            rig.part.tell(event(rig.clock.now(), f"number {n}"))
            await asyncio.sleep(0.003)
        await killed
        await asyncio.wait_for(consumer.done.wait(), 60.0)
        assert rig.count("connections") >= 3
        await until(lambda: rig.count("events_waiting") == 0)
        assert rig.count("events_dropped") == 0
    assert consumer.numbers == list(range(total))


async def test_events_of_a_service_without_a_broker_come_with_the_next_one(broker: Broker, tmp_path: Path) -> None:
    """Session one meets no broker at all and ends; session two delivers what it left, first."""
    broker.stop()
    async with running(broker.settings(), tmp_path / "spool", session="one") as rig:
        for n in range(40):
            rig.part.tell(event(rig.clock.now(), f"number {n}"))
        await until(lambda: rig.count("connection_failures") >= 2)
    broker.start()
    async with consuming(broker, 41) as consumer, running(broker.settings(), tmp_path / "spool", session="two") as rig:
        rig.part.tell(event(rig.clock.now(), "number 40"))
        await asyncio.wait_for(consumer.done.wait(), 60.0)
    assert consumer.numbers == list(range(41))
    assert [e.text for e in consumer.others[:3]] == ["service started", "service stopped", "service started"]
    assert {e.session for e in consumer.others[:2]} == {"one"}


async def test_stopping_at_any_moment_loses_no_event(broker: Broker, tmp_path: Path) -> None:
    """The service is cancelled while it connects, subscribes, spools, publishes; what it said is delivered or on disk."""
    reported = 0
    async with consuming(broker, 10**9) as consumer:
        for k in range(14):
            async with running(broker.settings(), tmp_path / "spool", session=f"s{k}") as rig:
                for _ in range(5):
                    rig.part.tell(event(rig.clock.now(), f"number {reported}"))
                    reported += 1
                await asyncio.sleep(0.0025 * k)
        async with running(broker.settings(), tmp_path / "spool", session="last"):
            await until(lambda: len(consumer.numbers) == reported)
    assert consumer.numbers == list(range(reported))


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
            at_ns = health.at_ns
            command = {"id": f"c{at_ns}", "run": runs[-1], "given_ns": at_ns, "expires_ns": at_ns + 30 * 10**9, **fields}
            await ground.publish_message(TREE + "command", signed(key, TREE + "command", json.dumps(command).encode()), qos=1)
            return await wait(CommandReply)

        try:
            assert (await wait(StatusMessage)).online
            assert (await ask(command="hold")).accepted
            key = key[::-1]
            (tmp_path / "command.key").write_bytes(key)
            assert (await ask(command="abort")).accepted, "a renewed key holds"
            late = await ask(command="begin")
            assert (late.reason, late.text) == ("not_possible", "the vehicle is silent")
            daemon.send_signal(signal.SIGTERM)
            farewell = await wait(StatusMessage)
            assert (farewell.online, farewell.reason) == (False, "stopped")
            await daemon.wait()
        finally:
            if daemon.returncode is None:
                daemon.kill()
            _, stderr = await daemon.communicate()
    assert daemon.returncode == 0, stderr.decode()
    assert b"SIGTERM ends the service and leaves the vehicle as it is" in stderr
    assert events[0] == "service started"
    assert events[-1] == "service stopped"
    assert {"command hold accepted", "command abort accepted"} <= set(events)
    assert any(text.startswith("aborted") for text in events)
    assert "command begin refused: the vehicle is silent" in events
    assert "secret" not in stderr.decode()
