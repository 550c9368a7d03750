"""Recordings in object storage: whole, once, and before the recorder may delete them. The peer is moto's S3 server."""

import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.cli.record import Storage, storage, upload
from companion.parts.recorder.storage_policy import Folder, digest_file
from companion.recording.container import MAGIC
from tests.support.waiting import accepts, free_port, wait_until

FIRST, SECOND = (f"decklander-20261120T050000Z-000{i}.mcap" for i in (1, 2))


def written(folder: Path, name: str, size: int = 300_000) -> bytes:
    """Write a finished recording of random messages, and return its bytes."""
    content = MAGIC + os.urandom(size) + MAGIC
    (folder / name).write_bytes(content)
    return content


@pytest.fixture
def s3(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[str]:
    """The URL of a bucket of an S3 server on loopback."""
    port = free_port()
    for name, value in (
        ("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}"), ("AWS_ACCESS_KEY_ID", "drone"), ("AWS_SECRET_ACCESS_KEY", "secret"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):  # fmt: skip
        monkeypatch.setenv(name, value)
    server = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with (tmp_path / "moto.log").open("wb") as log, subprocess.Popen(server, stdout=log, stderr=log) as process:
        try:
            wait_until(lambda: process.poll() is not None or accepts(port))
            assert process.poll() is None, (tmp_path / "moto.log").read_text()
            storage("s3://ship").system.mkdir("ship")
            yield "s3://ship/drone_1"
        finally:
            process.kill()


def test_an_s3_server_gets_each_finished_recording_once(s3: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "recordings"
    folder.mkdir()
    content = written(folder, FIRST)
    (folder / SECOND).write_bytes(MAGIC + bytes(1000))
    (folder / "notes.txt").write_text("not ours")
    assert main(["record", "upload", str(folder), "--to", s3]) == 0
    assert capsys.readouterr().out == f"{FIRST}: uploaded, 0.3 MB\n"
    there = storage(s3)
    assert sorted(path.rsplit("/")[-1] for path in there.system.ls(there.root)) == [FIRST, f"{FIRST}.sha256"]
    assert there.system.cat_file(there.at(FIRST)) == content
    line = f"{hashlib.sha256(content).hexdigest()}  {FIRST}\n"
    assert there.system.cat_file(there.at(f"{FIRST}.sha256")).decode() == digest_file(folder / FIRST).read_text() == line
    assert main(["record", "upload", str(folder), "--to", s3]) == 0
    assert capsys.readouterr().out == ""
    os.utime(folder / SECOND, (time.time() - 100.0,) * 2)
    assert main(["record", "upload", str(folder), "--to", s3]) == 0
    assert SECOND in capsys.readouterr().out, "a crash left it without its end"


class Bent:
    """A file system that changes what is written, until it is mended."""

    def __init__(self, whole: Storage) -> None:
        self._whole, self.broken = whole, True

    def __getattr__(self, name: str) -> object:
        return getattr(self._whole.system, name)

    def put_file(self, path: str, there: str) -> None:
        if self.broken:
            Path(there).write_bytes(bytes(Path(path).stat().st_size))
        else:
            self._whole.system.put_file(path, there)


def test_what_comes_back_changed_does_not_count(tmp_path: Path) -> None:
    content = written(tmp_path, FIRST)
    whole = storage(str(tmp_path / "there"))
    bent = Bent(whole)
    (done,) = upload(tmp_path, whole._replace(system=bent))
    assert done.why is not None
    assert "differs" in done.why
    assert not digest_file(tmp_path / FIRST).exists()
    bent.broken = False
    (done,) = upload(tmp_path, whole._replace(system=bent))
    assert done.why is None
    assert (tmp_path / "there" / FIRST).read_bytes() == content


def test_a_storage_that_does_not_answer_costs_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = written(tmp_path, FIRST)
    (tmp_path / "there").write_text("a file where the folder should be")
    assert main(["record", "upload", str(tmp_path), "--to", str(tmp_path / "there")]) == 1
    assert f"{FIRST}: not uploaded" in capsys.readouterr().err
    assert (tmp_path / FIRST).read_bytes() == content
    assert not digest_file(tmp_path / FIRST).exists()


def test_the_recorder_deletes_no_recording_before_it_is_uploaded(tmp_path: Path) -> None:
    folder = Folder(tmp_path, "20261121T050000Z", max_file_mb=0.2, max_total_mb=0.5, min_free_mb=0.0, delete="uploaded")
    for name in (FIRST, SECOND):
        written(tmp_path, name)
    folder.tidy(None)
    assert {FIRST, SECOND} <= {path.name for path in tmp_path.iterdir()}
    assert "not uploaded" in (folder.lacks_room() or "")
    list(upload(tmp_path, storage(str(tmp_path / "there"))))
    assert folder.lacks_room() is None
    assert sorted(path.name for path in tmp_path.glob("*.mcap*")) == [SECOND, f"{SECOND}.sha256"]
