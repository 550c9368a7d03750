"""Certificates, tokens, passwords and keys that are replaced under a running service."""

import asyncio
import logging
import os
import ssl
import subprocess
from pathlib import Path

import pytest

from companion.base.health import Health
from companion.base.http_server import HttpServer
from companion.cli.main import main
from companion.parts.mavlink.signed_links import signed_links
from companion.parts.mqtt.connection import BrokerEndpoint, renewed_endpoint
from companion.parts.mqtt.options import MqttSettings
from companion.settings.files import Renewed
from companion.settings.links import HttpSettings
from drivers.clock import SystemClock
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.signing import Signing, SigningKey, SigningTimes
from estimator.contracts.errors import BadInput, Recoverable
from tests.support.waiting import listening

OLD, NEW = "a-token-of-before-the-change", "another-token-that-came-later"


def certify(folder: Path, name: str) -> bytes:
    """Write a certificate and its key as a timer does, one after the other, and return the certificate."""
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-subj", f"/CN={name}",
         "-keyout", str(folder / "new.key"), "-out", str(folder / "new.crt")], check=True, capture_output=True,
    )  # fmt: skip
    (folder / "new.crt").replace(folder / "page.crt")
    (folder / "new.key").replace(folder / "page.key")
    return ssl.PEM_cert_to_DER_cert((folder / "page.crt").read_text())


async def certificate_of(port: int, name: str | None) -> bytes:
    """Return the certificate that a browser gets, which names the server or does not."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    _, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context, server_hostname=name or "")
    connection = writer.get_extra_info("ssl_object")
    writer.close()
    return bytes(connection.getpeercert(binary_form=True))


async def test_the_page_serves_a_renewed_certificate_and_keeps_it_where_the_next_one_is_broken(tmp_path, caplog):
    first = certify(tmp_path, "first")
    files = {"certificate_file": str(tmp_path / "page.crt"), "key_file": str(tmp_path / "page.key")}
    server = HttpServer(HttpSettings(endpoint="https", port=0, page=False, **files), Health(SystemClock()))
    async with listening(server):
        assert await certificate_of(server.port, "drone") == first
        second = certify(tmp_path, "second")
        assert first != second == await certificate_of(server.port, "drone") == await certificate_of(server.port, None)
        (tmp_path / "page.key").write_text("half a key")
        with caplog.at_level(logging.WARNING):
            assert {await certificate_of(server.port, "drone") for _ in range(3)} == {second}
        (record,) = caplog.records
        assert str(tmp_path / "page.key") in record.getMessage()
        assert "kept" in record.getMessage()
        third = certify(tmp_path, "third")
        assert await certificate_of(server.port, "drone") == third


def test_a_token_that_is_rewritten_holds_from_then_on(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text(OLD)
    server = HttpServer(HttpSettings(endpoint="http", port=0, page=False, token_file=str(path)), Health(SystemClock()))
    assert server.has_token
    assert server.knows(OLD)
    path.write_text(NEW)
    assert server.knows(NEW)
    assert not server.knows(OLD)
    path.unlink()
    assert server.knows(NEW), "a file that is gone opens nothing"
    assert not server.knows(OLD)


def test_the_broker_is_known_by_a_renewed_authority(tmp_path: Path) -> None:
    certify(tmp_path, "ca")
    endpoint = renewed_endpoint(MqttSettings(transport="tls", user="drone", ca_file=str(tmp_path / "page.crt")))
    first = endpoint()
    assert endpoint() is first
    der = certify(tmp_path, "renewed")
    assert (tls := endpoint().tls) is not None
    assert tls.get_ca_certs(binary_form=True) == [der]


def test_watch_connects_by_the_password_of_now(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (file := tmp_path / "password").write_text("before")
    given = list[str | None]()

    def refuses(endpoint: BrokerEndpoint, *_: object, **__: object) -> None:
        given.append(endpoint.password)
        file.write_text("after")
        raise Recoverable("not today")

    monkeypatch.setattr("companion.parts.mqtt.connection.connect", refuses)
    monkeypatch.setattr("companion.cli.watch._BACK_OFF_S", 0.01)
    assert main(["watch", "--plain-tcp", "--user", "u", "--password-file", str(file), "--seconds", "0.3"]) == 1
    assert given[:2] == ["before", "after"]


def test_a_renewed_signing_key_holds_once_the_other_side_signs_by_it(tmp_path: Path) -> None:
    keys = bytes(32), bytes(range(32))
    (file := tmp_path / "key").write_bytes(keys[0])
    file.chmod(0o600)
    (link,) = signed_links(AutopilotOptions("tcp://127.0.0.1:1", signing_key_file=str(file)))
    ours = Codec(1, 191, signing=link.signing)
    old, new = (Codec(1, 1, signing=Signing(lambda k=key: SigningKey(k), SigningTimes(None), n)) for n, key in enumerate(keys))
    file.write_bytes(keys[1])
    beat = mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    assert ours.feed(old.pack(beat)), "the file is renewed before the autopilot"
    assert not ours.feed(new.pack(beat)), "this one says that the autopilot has it now"
    assert ours.feed(new.pack(beat))
    assert not ours.feed(old.pack(beat))
    assert new.feed(ours.pack(beat))


def test_a_link_that_points_to_another_folder_is_a_change_and_a_start_without_the_file_is_refused(tmp_path: Path) -> None:
    """A cluster renews secrets so: the file is a link into a folder that is swapped."""
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "secret").write_text(name)
    (tmp_path / "data").symlink_to("a")
    path = tmp_path / "data" / "secret"
    held = Renewed(path.read_text, "mqtt", str(path))
    assert held() == "a"
    (tmp_path / "next").symlink_to("b")
    os.replace(tmp_path / "next", tmp_path / "data")
    assert held() == "b"
    with pytest.raises(BadInput):
        renewed_endpoint(MqttSettings(transport="tcp", user="drone", password_file=str(tmp_path / "absent")))
