"""`decklander keys`, against an autopilot that takes, obeys and gives up a key as ArduPilot does."""

import asyncio
import os
import stat
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main
from companion.settings.files import signing_key
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.signing import Signing, SigningKey, SigningTimes

HOST = "127.0.0.1"


class Lockable(asyncio.DatagramProtocol):
    """An autopilot on UDP that can be given a key; with one it receives signed messages only, and signs its own in MAVLink 2."""

    def __init__(self, *, armed: bool = False, deaf: bool = False, key: bytes | None = None, old_version: bool = False) -> None:
        self.armed, self.deaf, self.old_version = armed, deaf, old_version
        self.peer: Any = None
        self.measured_at: list[bytes] = []
        self._transport: Any = None
        self.lock(key)

    def lock(self, key: bytes | None) -> None:
        signing = None if key is None else Signing(lambda: SigningKey(key), SigningTimes(None), 5)
        self.codec = Codec(1, 1, datagrams=True, signing=signing)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.peer = addr
        for message in self.codec.feed(data):
            if message.get_type() == "SETUP_SIGNING" and not self.deaf and not self.armed:
                secret = bytes(message.secret_key)
                self.measured_at.append(secret)
                self.lock(secret if any(secret) else None)

    async def beat(self) -> None:
        while True:
            if self.peer is not None:
                beat = mav.MAVLink_heartbeat_message(2, 3, 128 if self.armed else 0, 0, 4, 3)
                plain = mav.MAVLink(None, srcSystem=1, srcComponent=1)
                data = beat.pack(plain, force_mavlink1=True) if self.old_version else self.codec.pack(beat)
                self._transport.sendto(data, self.peer)
            await asyncio.sleep(0.02)


@asynccontextmanager
async def lockable(**options: Any) -> AsyncIterator[tuple[Lockable, str]]:
    transport, autopilot = await asyncio.get_running_loop().create_datagram_endpoint(
        lambda: Lockable(**options), local_addr=(HOST, 0)
    )
    beating = asyncio.create_task(autopilot.beat())
    try:
        yield autopilot, f"udpout://{HOST}:{transport.get_extra_info('sockname')[1]}"
    finally:
        beating.cancel()
        transport.close()


async def keys(*words: str) -> int:
    return await asyncio.to_thread(main, ["keys", *words])


def made(folder: Path, name: str = "link.key") -> Path:
    path = folder / name
    assert main(["keys", "make", str(path)]) == 0
    return path


def test_a_key_is_made_for_its_owner_alone_and_never_over_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    umask = os.umask(0)
    try:
        path = made(tmp_path)
    finally:
        os.umask(umask)
    secret = path.read_bytes()
    assert len(secret) == 32
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert made(tmp_path, "other").read_bytes() != secret
    assert main(["keys", "make", str(path)]) == 2
    assert path.read_bytes() == secret
    assert main(["keys", "make", str(tmp_path / "none/key")]) == 2
    output = capsys.readouterr()
    assert "there is a file of that name already" in output.err
    assert signing_key(str(path)).fingerprint in output.out


def test_a_key_is_shown_by_its_fingerprint_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = made(tmp_path)
    capsys.readouterr()
    assert main(["keys", "show", str(path)]) == 0
    output = capsys.readouterr().out
    assert signing_key(str(path)).fingerprint in output
    assert path.read_bytes().hex()[:8] not in output.replace(":", "")
    assert main(["keys", "show", str(tmp_path / "none")]) == 2


async def test_a_key_is_installed_seen_to_be_in_force_and_removed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, second = made(tmp_path), made(tmp_path, "second.key")
    async with lockable() as (autopilot, url):
        assert await keys("install", "--link", url, "--yes", str(path)) == 0
        assert autopilot.measured_at[-1] == path.read_bytes()
        output = capsys.readouterr().out
        assert "ArduPilot, system 1" in output
        assert signing_key(str(path)).fingerprint in output
        assert "the autopilot signs with this key now" in output
        assert "IN CLEAR" not in output, "loopback"
        assert await keys("install", "--link", url, "--seconds", "1", "--yes", str(second)) == 1
        assert "--current" in capsys.readouterr().out
        assert await keys("install", "--link", url, "--current", str(path), "--yes", str(second)) == 0
        assert await keys("remove", "--link", url, "--current", str(second), "--yes") == 0
        assert autopilot.measured_at[-1] == bytes(32)
        assert "the autopilot no longer signs" in capsys.readouterr().out


async def test_nothing_is_sent_without_a_yes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = made(tmp_path)
    async with lockable() as (autopilot, url):
        assert await keys("install", "--link", url, str(path)) == 2
        assert "--yes" in capsys.readouterr().err
        assert autopilot.measured_at == []


async def test_what_did_not_come_about_is_not_called_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = made(tmp_path)
    async with lockable(deaf=True) as (_, url):
        assert await keys("install", "--link", url, "--seconds", "0.5", "--yes", str(path)) == 1
        assert "was not seen to sign" in capsys.readouterr().out
    async with lockable(armed=True) as (autopilot, url):
        assert await keys("install", "--link", url, "--yes", str(path)) == 2
        assert "armed" in capsys.readouterr().err
        assert autopilot.measured_at == []
    assert await keys("install", "--link", f"udpin://{HOST}:0", "--seconds", "0.5", "--yes", str(path)) == 1
    assert "no autopilot is connected" in capsys.readouterr().err


async def test_a_link_of_mavlink_1_gets_no_key_and_gives_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = made(tmp_path)
    async with lockable(old_version=True) as (autopilot, url):
        assert await keys("install", "--link", url, "--seconds", "1", "--yes", str(path)) == 2
        assert "SERIALn_PROTOCOL 2" in capsys.readouterr().err
        assert await keys("install", "--link", url, "--seconds", "0.5", "--current", str(path), "--yes", str(path)) == 1
        assert "what comes is MAVLink 1, which carries no signature" in capsys.readouterr().err
        assert autopilot.measured_at == []
