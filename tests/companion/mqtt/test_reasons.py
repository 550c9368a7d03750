"""Reasons with which a broker ends a connection, a second client of our name, and a clock that is set late."""

import asyncio
import struct
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import msgspec
import pytest

from companion.parts.mqtt import part as part_module
from companion.parts.mqtt.connection import client_id
from companion.parts.mqtt.messages import StatusMessage, encode
from companion.settings.links import MqttSettings
from tests.support.mqtt_service import SESSION, running
from tests.support.waiting import until

STATUS = "decklander/v2/drone/status"
DAYS_200_S = 200 * 86400.0


class WordyBroker:
    """Takes any client of MQTT 5, acknowledges everything, and keeps what was published."""

    def __init__(self) -> None:
        self.clients: list[tuple[str, asyncio.StreamWriter]] = []
        self.published: list[tuple[str, bytes]] = []

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                head = (await reader.readexactly(1))[0]
                size = shift = 0
                while (digit := (await reader.readexactly(1))[0]) & 0x80:
                    size, shift = size | (digit & 127) << shift, shift + 7
                body = await reader.readexactly(size | digit << shift)
                writer.write(self._answer(head, body, writer))
        except (asyncio.IncompleteReadError, ConnectionError):
            writer.close()

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
    server = await asyncio.start_server(broker.serve, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    try:
        yield broker, MqttSettings(transport="tcp", port=port, timeout_s=2.0, reconnect_first_s=0.05, reconnect_cap_s=0.1)
    finally:
        server.close()
        for _, writer in broker.clients:
            writer.close()


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
