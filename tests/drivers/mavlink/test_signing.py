"""Keys from files, and a time that never runs back."""

from __future__ import annotations

import errno
import hashlib
from pathlib import Path

import pytest

from drivers.mavlink.signing import EPOCH_S, TICKS_PER_S, SigningKey, SigningTime, load_key
from estimator.contracts.errors import BadInput

SECRET = bytes(range(100, 132))


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> str:
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return str(path)


@pytest.mark.parametrize("content", [SECRET, SECRET.hex().encode(), SECRET.hex().upper().encode() + b"\n"])
def test_a_key_is_32_bytes_or_64_digits(tmp_path: Path, content: bytes) -> None:
    assert load_key(key_file(tmp_path, content)).secret == SECRET


def test_a_passphrase_gives_the_key_ground_stations_make_of_it(tmp_path: Path) -> None:
    assert load_key(key_file(tmp_path, b"passphrase: sea and sky\n")).secret == hashlib.sha256(b"sea and sky").digest()


def test_a_systemd_credential(tmp_path: Path) -> None:
    key_file(tmp_path, SECRET, 0o400)
    assert load_key("credential:key", {"CREDENTIALS_DIRECTORY": str(tmp_path)}).secret == SECRET
    with pytest.raises(BadInput, match="LoadCredential"):
        load_key("credential:key", {})


@pytest.mark.parametrize(
    ("content", "mode", "says"),
    [(SECRET, 0o644, "chmod 600"), (b"short and secret", 0o600, "neither 32 bytes"), (b"", 0o600, "neither")],
)
def test_a_bad_key_file_is_named_and_its_content_is_not(tmp_path: Path, content: bytes, mode: int, says: str) -> None:
    with pytest.raises(BadInput, match=says) as raised:
        load_key(key_file(tmp_path, content, mode))
    assert "secret" not in str(raised.value)
    with pytest.raises(BadInput, match="No such file"):
        load_key(str(tmp_path / "absent"))


def test_a_key_does_not_show() -> None:
    assert "101" not in repr(SigningKey(SECRET))
    assert SECRET.hex() not in repr(SigningKey(SECRET))


def test_time_follows_the_wall_and_never_repeats() -> None:
    wall = [EPOCH_S + 10.0]
    time = SigningTime(None, lambda: wall[0])
    first = time.next()
    assert first == 10 * TICKS_PER_S
    assert time.next() == first + 1
    wall[0] += 1
    assert time.next() == 11 * TICKS_PER_S
    wall[0] -= 100
    assert time.next() == 11 * TICKS_PER_S + 1, "a wall clock set back"
    assert time.next(at_least=10**9) == 10**9


def test_a_restart_with_a_clock_set_back_goes_on_after_the_last_time(tmp_path: Path) -> None:
    path = tmp_path / "state/time"
    before = SigningTime(path, lambda: EPOCH_S + 5000.0)
    used = [before.next() for _ in range(5)]
    after = SigningTime(path, lambda: EPOCH_S + 10.0)
    assert after.next() > used[-1]


def test_a_torn_time_is_said_and_mended_and_keeps_no_service_from_starting(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "time"
    path.write_text("not a number")
    time = SigningTime(path, lambda: EPOCH_S + 5000.0)
    assert "it should hold one whole number" in caplog.text
    used = time.next()
    assert SigningTime(path, lambda: EPOCH_S + 10.0).next() > used


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EIO])
def test_a_disk_that_fails_in_flight_silences_no_link(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now = EPOCH_S + 5000.0
    time = SigningTime(tmp_path / "time", lambda: now)
    used = [time.next()]
    monkeypatch.setattr(Path, "write_text", lambda *_: (_ for _ in ()).throw(OSError(number, "broken")))
    for _ in range(5):
        now += 100.0
        used.append(time.next())
    assert used == sorted(set(used))
    assert caplog.text.count("kept in memory alone") == 1
