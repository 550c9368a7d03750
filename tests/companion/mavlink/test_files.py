"""Component metadata and MAVLink FTP: pymavlink's client reads them, garbage is refused, targets are not delayed."""

import asyncio
import json
import lzma
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import mavftp, mavutil

from companion.parts.mavlink.file_server import DATA_MAX, FileServer, FtpError, Opcode, crc32
from companion.parts.mavlink.metadata import metadata_files
from companion.parts.mavlink.parameters import NAMES
from drivers.mavlink.access import AccessLevel
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.links import ReceivedMessage
from estimator.contracts.time import MonoNs
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.mavlink.stage import HOST, staged
from tests.support.waiting import free_port

S = 1_000_000_000
FILES = {"a.json": bytes(range(256)) * 3, "b": b"short"}


class Client:
    """Sends requests to a server and takes its packets in virtual time."""

    def __init__(self) -> None:
        self.server = FileServer(FILES)
        self.now = MonoNs(0)

    def send(self, opcode: int, data: bytes = b"", *, session: int = 0, offset: int = 0, **more: Any) -> None:
        head = struct.pack("<HBBBBBBI", more.pop("seq", 7), session, opcode, more.pop("size", len(data)), 0, 0, 0, offset)
        self.throw((head + data).ljust(251, b"\0"), **more)

    def throw(
        self, payload: bytes, system: int = 255, level: AccessLevel = AccessLevel.PEER, target: int = 191, us: int = 191
    ) -> None:
        m = mav.MAVLink_file_transfer_protocol_message(0, 7, target, list(payload))
        self.server.on_message(ReceivedMessage(m, 0, self.now, system, 190, access_level=level), (7, us))

    def packets(self, seconds: float = 5.0) -> list[tuple[int, ...]]:
        """(sequence, session, opcode, size, request, last, 0, offset, data) of what arrives within these seconds of ticks."""
        out = []
        for _ in range(round(seconds * 50)):
            self.now = MonoNs(self.now + S // 50)
            for message, source in self.server.due(self.now):
                assert source == (0, None)
                raw = bytes(message.payload)
                head = struct.unpack_from("<HBBBBBBI", raw)
                out.append((*head, raw[12 : 12 + head[3]]))
        return out

    def one(self, opcode: int, data: bytes = b"", **more: Any) -> tuple[Any, ...]:
        self.send(opcode, data, **more)
        (answer,) = self.packets()
        return answer


def test_a_burst_brings_the_whole_file_and_then_its_end() -> None:
    client = Client()
    opened = client.one(Opcode.OPEN_FILE_RO, b"//a.json")
    assert (opened[0], opened[2], opened[-1]) == (8, 128, struct.pack("<I", 768))
    client.send(Opcode.BURST_READ_FILE, session=opened[1], size=DATA_MAX, seq=65534)
    got = client.packets()
    assert b"".join(p[-1] for p in got) == FILES["a.json"]
    assert [p[0] for p in got] == [65535, 0, 1, 2]
    assert [p[5] for p in got] == [0, 0, 0, 1]
    assert client.one(Opcode.BURST_READ_FILE, session=opened[1], offset=768)[-1] == bytes([FtpError.EOF])
    assert client.one(Opcode.CALC_FILE_CRC32, b"b")[-1] == struct.pack("<I", crc32(b"short"))
    assert client.one(Opcode.LIST_DIRECTORY, b"/")[-1] == b"Fa.json\t768\0Fb\t5\0"
    assert client.one(Opcode.TERMINATE_SESSION, session=opened[1])[2] == 128
    assert client.one(Opcode.READ_FILE, session=opened[1], size=9)[-1] == bytes([FtpError.INVALID_SESSION])


@pytest.mark.parametrize(
    ("opcode", "data", "more", "error"),
    [
        (Opcode.OPEN_FILE_RO, b"/etc/passwd", {}, FtpError.FILE_NOT_FOUND),
        (Opcode.OPEN_FILE_RO, b"../b", {}, FtpError.FILE_NOT_FOUND),
        (Opcode.LIST_DIRECTORY, b"/etc", {}, FtpError.FILE_NOT_FOUND),
        (Opcode.LIST_DIRECTORY, b"/", {"offset": 2}, FtpError.EOF),
        (Opcode.READ_FILE, b"", {"session": 1, "size": 5}, FtpError.INVALID_SESSION),
        (Opcode.READ_FILE, b"", {"session": 0, "size": 240}, FtpError.INVALID_DATA_SIZE),
        (Opcode.READ_FILE, b"", {"session": 0, "offset": 1 << 31, "size": 5}, FtpError.EOF),
        (6, b"new", {}, FtpError.FILE_PROTECTED),
        (99, b"", {}, FtpError.UNKNOWN_COMMAND),
    ],
)
def test_a_senseless_request_is_refused_by_its_reason(opcode: int, data: bytes, more: dict[str, int], error: FtpError) -> None:
    client = Client()
    client.one(Opcode.OPEN_FILE_RO, b"a.json")
    assert client.one(opcode, data, **more)[2:5:2] == (129, opcode)
    assert client.server.refused == {error.name: 1}


def test_no_answer_goes_to_who_gets_no_telemetry_to_other_servers_and_to_what_is_for_all_but_by_the_autopilot() -> None:
    client = Client()
    client.send(Opcode.LIST_DIRECTORY, b"/", target=0)
    client.send(Opcode.LIST_DIRECTORY, b"/", target=1)
    client.send(Opcode.LIST_DIRECTORY, b"/", level=AccessLevel.UNKNOWN)
    client.send(128)
    client.send(129)
    assert client.packets() == []
    assert client.one(Opcode.LIST_DIRECTORY, b"/", target=0, us=1)[2] == 128


@settings(max_examples=300, derandomize=True)
@given(payloads=st.lists(st.binary(min_size=251, max_size=251) | st.builds(
    lambda opcode, session, size, offset, rest: struct.pack("<HBBBBBBI", 3, session, opcode, size, 0, 0, 0, offset) + rest,
    st.integers(0, 20), st.integers(0, 3), st.integers(0, 255), st.integers(0, 800) | st.integers(0, 2**32 - 1),
    st.sampled_from([b"a.json".ljust(239, b"\0"), b"\xff" * 239, b"/".ljust(239, b"\0")])), max_size=12))  # fmt: skip
def test_any_payload_is_answered_by_what_is_true_or_a_refusal(payloads: list[bytes]) -> None:
    client = Client()
    client.one(Opcode.OPEN_FILE_RO, b"a.json")
    for payload in payloads:
        client.throw(payload)
    for _, session, opcode, size, request, _, _, offset, data in client.packets(20.0):
        assert (opcode in (128, 129), size) == (True, len(data))
        if opcode == 129:
            assert FtpError(data[0])
        elif request in (Opcode.READ_FILE, Opcode.BURST_READ_FILE):
            assert (session, data) == (0, FILES["a.json"][offset : offset + size])
            assert data
    assert client.one(Opcode.CALC_FILE_CRC32, b"a.json")[-1] == struct.pack("<I", crc32(FILES["a.json"]))


def test_clients_that_flood_share_half_of_a_slow_radio() -> None:
    client, codec, taken = Client(), Codec(7, 191), {255: 0, 254: 0, 1: 0}
    for system in taken:
        client.send(Opcode.OPEN_FILE_RO, b"a.json", system=system)
    for _ in range(10 * 50):
        client.now = MonoNs(client.now + S // 50)
        for system in taken:
            client.send(Opcode.READ_FILE, size=DATA_MAX, system=system)
        sent = [m for m, _ in client.server.due(client.now)]
        assert len(sent) <= 1, "one packet a tick at most"
        for m in sent:
            taken[m.target_system] += len(codec.pack(m))
    assert sum(taken.values()) <= 10 * 57600 / 10 / 2
    assert min(taken.values()) > 0.8 * max(taken.values()), taken
    assert client.server.refused["TOO_MANY"] > 1000


def read_by_pymavlink(port: int) -> dict[str, bytes]:
    """Return every file that pymavlink's own client lists."""
    link = mavutil.mavlink_connection(f"udpin:{HOST}:{port}", source_system=255, source_component=190)
    try:
        assert link.wait_heartbeat(timeout=30) is not None
        client = mavftp.MAVFTP(link, 7, 191)
        client.ftp_settings.burst_read_size = DATA_MAX
        assert client.cmd_list(["/"]).error_code == mavftp.FtpError.Success
        out = {}
        for name in [entry.name for entry in client.list_result]:
            got: list[bytes] = []
            client.cmd_get([name], callback=lambda fh, got=got: got.append(fh.read() if fh else b""))
            client.process_ftp_reply("OpenFileRO", timeout=30)
            out[name] = got[-1]
        return out
    finally:
        link.close()


async def test_pymavlinks_client_reads_every_file_while_the_targets_go_on() -> None:
    port, fake = free_port(), MiniatureAutopilot()
    async with staged(fake, f"udpout://{HOST}:{port}", operators="255") as stage:
        before = len(fake.of("LANDING_TARGET"))
        assert await asyncio.to_thread(read_by_pymavlink, port) == metadata_files(191)
        assert len(fake.of("LANDING_TARGET")) > before
        assert not stage.autopilot.links.contained.faults


def test_the_parameters_are_described_by_the_settings() -> None:
    files = metadata_files(191)
    described = json.loads(lzma.decompress(files["parameters.json.xz"]))
    assert described["version"] == 1
    by_name = {p["name"]: p for p in described["parameters"]}
    assert list(by_name) == list(NAMES)
    assert {k: by_name["PID_TURN_MAX"][k] for k in ("type", "units", "min", "max", "default", "group", "shortDesc")} == {
        "type": "Float", "units": "deg/s", "min": 1.0, "max": 360.0, "default": 34.4, "group": "guidance.pid",
        "shortDesc": "largest turn rate",
    }  # fmt: skip
    reference = Path("docs/configuration.md").read_text(encoding="utf-8")
    assert all(p["group"] and p["shortDesc"] and p["min"] <= p["default"] <= p["max"] for p in by_name.values())
    public = [p for p in by_name.values() if "Setting expert." not in p["longDesc"]]
    assert public
    assert all(f"[{p['group']}]" in reference and p["shortDesc"] in reference for p in public)
