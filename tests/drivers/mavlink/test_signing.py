"""Keys from files, and a time that never runs back."""

import errno
import hashlib
import json
from pathlib import Path

import pytest

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import mav
from drivers.mavlink.signing import EPOCH_S, TICKS_PER_S, Signing, SigningKey, SigningTimes, load_key
from estimator.contracts.errors import BadInput

SECRET = bytes(range(100, 132))


def key_file(folder: Path, content: bytes, mode: int = 0o600) -> str:
    path = folder / "key"
    path.write_bytes(content)
    path.chmod(mode)
    return str(path)


@pytest.mark.parametrize(
    ("content", "secret"),
    [
        (SECRET, SECRET), (SECRET.hex().encode(), SECRET), (SECRET.hex().upper().encode() + b"\n", SECRET),
        (b"passphrase: sea and sky\n", hashlib.sha256(b"sea and sky").digest()),
    ],
)  # fmt: skip
def test_a_key_is_32_bytes_or_64_digits_or_the_passphrase_of_ground_stations(
    tmp_path: Path, content: bytes, secret: bytes
) -> None:
    assert load_key(key_file(tmp_path, content)).secret == secret


@pytest.mark.parametrize("mode", [0o400, 0o440])  # the second is how systemd's access list for a dynamic user shows
def test_a_systemd_credential(tmp_path: Path, mode: int) -> None:
    key_file(tmp_path, SECRET, mode)
    assert load_key("credential:key", {"CREDENTIALS_DIRECTORY": str(tmp_path)}).secret == SECRET
    with pytest.raises(BadInput, match="LoadCredential"):
        load_key("credential:key", {})
    with pytest.raises(BadInput, match="does not name a credential"):
        load_key("credential:../key", {"CREDENTIALS_DIRECTORY": str(tmp_path / "sub")})
    with pytest.raises(BadInput, match="neither 32 bytes"):
        load_key("credential:zero", {"CREDENTIALS_DIRECTORY": "/dev"})


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


def test_time_follows_the_wall_and_never_repeats() -> None:
    wall = [EPOCH_S + 10.0]
    time = SigningTimes(None, lambda: wall[0])
    first = time.next()
    assert first == 10 * TICKS_PER_S
    assert time.next() == first + 1
    wall[0] += 1
    assert time.next() == 11 * TICKS_PER_S
    wall[0] -= 100
    assert time.next() == 11 * TICKS_PER_S + 1, "a wall clock set back"
    time.note_received(10**9)
    assert time.next() == 10**9 + 1
    time.note_received(2**48 - 1)
    assert time.next() == 10**9 + 2, "who says the last time there is does not silence us"


def crossing(times: SigningTimes, messages: list[bytes]) -> int:
    """Return the number of these that a link with these times accepts."""
    codec = Codec(1, 191, datagrams=True, signing=Signing(SigningKey(SECRET), times, 0))
    return sum(len(codec.feed(message)) for message in messages)


def signed(wall_s: float, count: int = 3, system: int = 1) -> list[bytes]:
    sender = Codec(system, 1, signing=Signing(SigningKey(SECRET), SigningTimes(None, lambda: wall_s), 7))
    return [sender.pack(mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)) for _ in range(count)]


def test_what_was_received_before_a_restart_cannot_be_played_again_after_it(tmp_path: Path) -> None:
    path, now_s = tmp_path / "times", EPOCH_S + 5000.0
    captured = signed(now_s)
    before = SigningTimes(path, lambda: now_s)
    assert crossing(before, captured) == 3
    used = before.next()
    before.close()
    assert SigningTimes(path, lambda: now_s - 4000.0).next() > used, "a clock that was set back goes on after the last time"
    after = SigningTimes(path, lambda: now_s + 40.0)
    assert crossing(after, captured) == 0
    assert crossing(after, signed(now_s + 40.0)) == 3


def test_without_a_file_nothing_older_than_a_minute_is_accepted(tmp_path: Path) -> None:
    now_s = EPOCH_S + 5000.0
    for times in (SigningTimes(None, lambda: now_s), SigningTimes(tmp_path / "none yet", lambda: now_s)):
        assert crossing(times, signed(now_s - 61.0)) == 0
        assert crossing(times, signed(now_s - 59.0)) == 3


def test_it_is_written_rarely_whole_and_never_by_the_flight_itself(tmp_path: Path) -> None:
    path, elapsed = tmp_path / "times", [0.0]
    times = SigningTimes(path, lambda: EPOCH_S + 5000.0 + elapsed[0], lambda: elapsed[0])
    contents = set()
    for n in range(1000):
        elapsed[0] = 0.01 * n
        times.next()
        times._wait()
        contents.add(path.read_text())
    assert len(contents) == 2, "at 0 and 5 of 10 s"
    assert json.loads(path.read_text())["time"] > times._used, "ahead of what was used, should it be killed now"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "content",
    [b"", b"not a number", b"{}", b'{"time": 1, "streams": [[1]]}', b"[" * 100_000, b"1e999", b"null", b"99999999999999999"],
)
def test_a_file_that_cannot_be_used_is_reported_once_and_flown_on_without(tmp_path, content, caplog):
    path, now_s = tmp_path / "times", EPOCH_S + 5000.0
    path.write_bytes(content)
    times = SigningTimes(path, lambda: now_s)
    assert [r.levelname for r in caplog.records] == ["ERROR"]
    assert crossing(times, signed(now_s - 61.0)) == 0
    assert crossing(times, signed(now_s)) == 3
    times.close()
    assert json.loads(path.read_text())["streams"] == [[7, 1, 1, times.streams[7, 1, 1]]], "and mended"


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EIO])
def test_a_disk_that_takes_nothing_is_reported_once_and_flown_on_without(number, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(Path, "open", lambda *_: (_ for _ in ()).throw(OSError(number, "broken")))
    elapsed = [0.0]
    times = SigningTimes(tmp_path / "times", lambda: EPOCH_S + 5000.0 + elapsed[0], lambda: elapsed[0])
    used = []
    for _ in range(5):
        elapsed[0] += 10.0
        used.append(times.next())
        times._wait()
    assert used == sorted(set(used))
    assert caplog.text.count("kept in memory alone") == 1
    assert crossing(times, signed(EPOCH_S + 5000.0)) == 3


def test_a_wrong_name_is_reported_before_the_flight(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(BadInput, match="signing times"):
        SigningTimes(tmp_path / "file/times")


def test_a_right_signature_with_a_time_that_is_refused_is_counted_apart() -> None:
    """An autopilot without a fix signs by a clock that is days behind: that is no wrong key."""
    now_s = EPOCH_S + 4e8

    def codec_of(key: bytes, wall_s: float) -> Codec:
        return Codec(1, 1, datagrams=True, signing=Signing(SigningKey(key), SigningTimes(None, lambda: wall_s), 0))

    ours = codec_of(SECRET, now_s)
    heartbeat = mav.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    assert ours.feed(codec_of(SECRET, now_s - 3 * 86_400.0).pack(heartbeat)) == []
    assert (ours.counters.refused_signature, ours.counters.refused_time) == (1, 1)
    assert ours.counters.behind_s == pytest.approx(3 * 86_400.0, abs=0.1)
    for data in (codec_of(SECRET[::-1], now_s).pack(heartbeat), Codec(1, 1).pack(heartbeat)):
        assert ours.feed(data) == []
    assert (ours.counters.refused_signature, ours.counters.refused_time) == (3, 1)
    fresh = codec_of(SECRET, now_s).pack(heartbeat)
    assert len(ours.feed(fresh)) == 1
    assert ours.feed(fresh) == []
    assert ours.counters.refused_time == 2
    assert ours.counters.behind_s == pytest.approx(0.0, abs=0.1), "played again"
