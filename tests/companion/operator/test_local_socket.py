"""Terminals at the service's local socket: real sockets, the real pilot, and `decklander fly` in a pseudo-terminal."""

import asyncio
import os
import pty
import select
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.base.orders import HandledOrder, OperatorOrder, StickPositions
from companion.cli.fly import KEY_S, KeyMotion, keys_in
from companion.cli.main import main
from companion.facts.wire import FlightState, answer_of, request_of
from companion.guidance.operator.precedence import CROSSING_S
from companion.guidance.pilot import Pilot, make_pilot
from companion.parts.operator.client import answers, connected, running, socket_path
from companion.parts.operator.local_socket import OperatorSocket
from companion.settings.load import load
from estimator.contracts.commands import Hover, Velocity
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.samples import VehicleStatus
from estimator.contracts.time import Stamp
from tests.support.clocks import PatientClock
from tests.support.waiting import PATIENCE_S, until


@pytest.fixture
def folder() -> Iterator[Path]:
    """Yield a folder with a path short enough for a socket: pytest's own may be too long."""
    with tempfile.TemporaryDirectory(prefix="fly") as path:
        yield Path(path)


@pytest.fixture
def alone(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let sockets be in the folder alone, whatever else runs on this computer."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))


class Service:
    """The parts of a service that orders meet: the socket, the pilot and guidance cycles, without a vehicle."""

    def __init__(self, path: Path) -> None:
        self.pilot: Pilot = make_pilot(load("sim"))
        self.clock = PatientClock()
        self.served = OperatorSocket(path, self.pilot, self.clock)
        self.orders: list[HandledOrder] = []
        self.pilot.operator.on_order = self.orders.append
        self.command: object = None
        self.flying = True

    async def live(self) -> None:
        while True:
            now = self.clock.now()
            self.pilot.on_sample(VehicleStatus(Stamp(now, now, 0.001, "arrival"), self.flying, "hovering", 0.5, False, True))
            decision = self.pilot.decide(now)
            self.served.on_decision(decision)
            self.command = decision.command
            await asyncio.sleep(0.02)


@asynccontextmanager
async def serving(path: Path) -> AsyncIterator[Service]:
    service = Service(path)
    async with asyncio.TaskGroup() as group:
        tasks = [group.create_task(service.served.run()), group.create_task(service.live())]
        await until(lambda: answers(path))
        yield service
        for task in tasks:
            task.cancel()


async def test_a_terminal_flies_by_hand_and_its_end_is_a_hold(folder: Path) -> None:
    path = folder / "s.sock"
    states: list[FlightState] = []
    async with serving(path) as service:
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        async with connected(path, states.append) as client:
            client.watch()
            assert (await client.order(OperatorOrder.RELEASE)).text == "refused: nobody flies by hand"
            for order, goal in ((OperatorOrder.BEGIN, "to land"), (OperatorOrder.STAY, "to stay over the pad")):
                assert (await client.order(order)).accepted
                await until(lambda goal=goal: states[-1].reason == goal)
            assert (await client.order(OperatorOrder.MANUAL)).accepted
            client.move(StickPositions(forward=1.0))
            await until(lambda: isinstance(service.command, Velocity))
            await until(lambda: states[-1].yours and states[-1].situation == "by hand")
            async with connected(path) as other:
                refused = await other.order(OperatorOrder.BEGIN)
                assert "has the hand" in refused.text
                assert not refused.accepted
        await until(lambda: isinstance(service.command, Hover))
        assert service.pilot.paused
        assert "its terminal closed" in service.orders[-1].detail
    assert not path.exists()


@pytest.mark.parametrize(
    "lines", [b"{}\n", b"x" * 3000, b"\xff\xfe\n", b'{"kind":"sticks","forward":2.0}\n', b'{"kind":"sticks"}\n' * 150]
)
async def test_garbage_and_floods_end_their_own_connection_alone(folder: Path, lines: bytes) -> None:
    path = folder / "s.sock"
    async with serving(path) as service:
        reader, writer = await asyncio.open_unix_connection(path)
        writer.write(lines)
        assert b"refused" in await reader.read()
        writer.close()
        async with connected(path) as client:
            assert (await client.order(OperatorOrder.HOLD)).accepted
        assert service.served.counts["refused"] == 1


@given(st.binary(max_size=80))
def test_no_bytes_make_the_decoders_raise(line: bytes) -> None:
    assert isinstance(request_of(line), str) or line
    assert answer_of(line) is None or line


async def test_a_stale_socket_is_replaced_and_a_living_one_is_not(folder: Path) -> None:
    path = folder / "s.sock"
    async with serving(path):
        with pytest.raises(Recoverable, match="another service listens"):
            await Service(path).served.run()
        assert answers(path)
    left = await asyncio.start_unix_server(lambda reader, writer: None, path)
    left.close()
    await left.wait_closed()
    path.touch()
    async with serving(path), connected(path) as client:
        assert (await client.order(OperatorOrder.HOLD)).accepted
    with pytest.raises(Recoverable, match="No such file"):
        async with connected(path):
            pass


async def test_the_client_says_that_the_service_is_gone(folder: Path) -> None:
    path = folder / "s.sock"
    async with serving(path) as service:
        lost = ""
        try:
            async with connected(path) as client:
                assert (await client.order(OperatorOrder.HOLD)).accepted
                for connection in list(service.served.connections):
                    connection.close()
                await asyncio.sleep(PATIENCE_S)
        except* Recoverable as why:
            lost = str(why.exceptions[0])
        assert lost == "the service has closed the connection"
        with pytest.raises(Recoverable, match="has closed the connection"):
            await client.order(OperatorOrder.HOLD)


@pytest.mark.usefixtures("alone")
def test_the_path_follows_the_settings(folder: Path) -> None:
    shipped = load("sim")
    assert socket_path(shipped) == folder / "decklander" / "127.0.0.1-5556.sock"

    def with_socket(text: str) -> object:
        return msgspec.structs.replace(shipped, operator=msgspec.structs.replace(shipped.operator, socket=text))

    assert socket_path(with_socket("off")) is None  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="at most"):
        socket_path(with_socket("/" + "x" * 150))  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="off"):
        running(with_socket("off"))  # type: ignore[arg-type]
    with pytest.raises(Recoverable, match="no service runs with these settings"):
        running(shipped)


@pytest.mark.usefixtures("alone")
def test_orders_of_the_command_line_and_keys_of_a_terminal_reach_a_service(capsys):
    path = socket_path(load("sim"))
    assert main(["fly", "hold"]) == 1
    assert "no service runs" in capsys.readouterr().err
    path.parent.mkdir()
    with socket.create_server(str(path), family=socket.AF_UNIX):
        assert main(["fly", "status", "--config", "sim"]) == 1
    assert capsys.readouterr().err == "decklander: the service did not answer within 3 s\n"
    assert main(["fly", "--config", "sim"]) == 2, "no terminal"
    assert main(["fly", "hold", "--wait", "3"]) == 2
    capsys.readouterr()
    commands: list[Velocity] = []

    async def terminal() -> list[tuple[OperatorOrder, bool]]:
        async with serving(path) as service:
            code = [str(Path(sys.executable).parent / "decklander"), "fly"]
            for order, expected in (("takeoff", 1), ("hold", 0), ("status", 0), ("land", 0)):
                await asyncio.sleep(CROSSING_S if order == "land" else 0.0)  # a hold of just before stands against a landing
                done = await asyncio.to_thread(
                    subprocess.run, [*code, order, "--config", "sim"], capture_output=True, text=True, check=False
                )
                assert done.returncode == expected, (done.stdout, done.stderr)
                assert done.stdout.startswith(f"{order}: " if order != "status" else "paused"), done
            assert done.stderr.startswith("land here, where no pad is known"), "it is said, and ordered by the whole word"
            parent, child = pty.openpty()
            process = await asyncio.to_thread(subprocess.Popen, code, stdin=child, stdout=child, stderr=child)
            os.close(child)
            await _screen(parent, "watching")
            os.write(parent, b"lt")
            await _screen(parent, "press t again within 2 s to take off")
            os.write(parent, b"m")
            await _screen(parent, "manual: accepted")
            while not isinstance(service.command, Velocity) or service.command.v_level[0] == 0.0:
                os.write(parent, b"\x1b[A")
                await asyncio.sleep(0.05)
            commands.append(service.command)
            await until(lambda: isinstance(service.command, Hover))  # the key is let go
            assert service.pilot.operator.hand is not None
            os.write(parent, b"ll")
            await _screen(parent, "land: accepted")
            os.write(parent, b"q")
            assert await asyncio.to_thread(process.wait, PATIENCE_S) == 0
            os.close(parent)
            parent, child = pty.openpty()
            asked = await asyncio.to_thread(subprocess.Popen, [*code, "land"], stdin=child, stdout=child, stderr=child)
            os.close(child)
            await _screen(parent, "land here, where no pad is known")
            os.write(parent, b"y\n")
            await _screen(parent, "land: accepted")
            assert await asyncio.to_thread(asked.wait, PATIENCE_S) == 0
            os.close(parent)
            for order, expected, ends in (
                ("emergency", 1, "NOT CONFIRMED: after 1 s the vehicle is still hovering\n"),
                ("reset", 0, "done\n"),
            ):
                done = await asyncio.to_thread(
                    subprocess.run, [*code, order, "--wait", "1", "--config", "sim"], capture_output=True, text=True, check=False
                )
                assert (done.returncode, done.stdout.endswith(ends)) == (expected, True), done.stdout
            return [(one.order, one.accepted) for one in service.orders if not str(one.refusal).startswith("not obeyed yet")]

    orders = asyncio.run(terminal())
    assert [order.value for order, _ in orders] == ["takeoff", "hold", "land", "manual", "land", "land", "emergency", "reset"]
    assert [accepted for _, accepted in orders] == [False] + 7 * [True]
    assert [c.v_level.tolist() for c in commands] == [[0.5, 0.0, 0.0]]


async def _screen(parent: int, text: str) -> None:
    """Wait until the terminal shows the text."""
    shown = ""

    def shows() -> bool:
        nonlocal shown
        if select.select([parent], [], [], 0)[0]:
            shown += os.read(parent, 4096).decode(errors="replace")
        return text in shown

    await until(shows)


def test_keys_are_sticks_with_a_dead_man() -> None:
    assert list(keys_in("w\x1b[A\x1bOD\x1b[3~x")) == ["w", "up", "left", "x"]
    motion = KeyMotion().pressed("w", 10.0).pressed("left", 10.1)
    assert motion.sticks(10.2) == StickPositions(climb=0.5, right=-0.5)
    assert motion.sticks(10.0 + KEY_S + 0.05) == StickPositions(right=-0.5)
    assert motion.sticks(10.1 + KEY_S).centred
    for _ in range(20):
        motion = motion.pressed("+", 10.0)
    assert motion.pressed("d", 11.0).sticks(11.1) == StickPositions(turn=1.0)


@given(st.text(max_size=30))
def test_whatever_a_terminal_sends_is_keys(text: str) -> None:
    assert all(key and "\x1b" not in key for key in keys_in(text))
