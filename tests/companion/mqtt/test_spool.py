"""The spool against a model: whatever happens in between, nothing changes place or vanishes uncounted."""

import errno
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import Mock

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from companion.parts.mqtt.spool import FILES, UNWRITTEN, Spool
from estimator.contracts.errors import BadInput


def payload(n: int) -> bytes:
    return b'{"n":%d}' % n


def everything(spool: Spool) -> list[bytes]:
    """All that is undelivered, taken out in batches."""
    found = []
    while batch := spool.peek(7):
        found += [record.body for record in batch]
        spool.deliver(batch[-1].number)
    return found


class AgainstAModel(RuleBasedStateMachine):
    """A bound that is never hit: the spool is a queue that survives being opened again."""

    def __init__(self) -> None:
        super().__init__()
        self.temporary = TemporaryDirectory()
        self.folder = Path(self.temporary.name)
        self.spool = Spool(self.folder, 8 * 200)
        self.model: list[bytes] = []
        self.told = 0

    @rule(count=st.integers(1, 5))
    def append(self, count: int) -> None:
        if self.spool.size_bytes > 7 * 100:
            return
        bodies = [payload(self.told + k) for k in range(count)]
        self.told += count
        self.model += bodies
        self.spool.append(bodies)

    @rule(most=st.integers(1, 6))
    def deliver(self, most: int) -> None:
        batch = self.spool.peek(most)
        assert [r.body for r in batch] == self.model[:most]
        if batch:
            self.spool.deliver(batch[-1].number)
            del self.model[: len(batch)]

    @rule(properly=st.booleans())
    def open_again(self, properly: bool) -> None:
        name, number = self.spool.name, self.spool.next_number
        if properly:
            self.spool.close()
        self.spool = Spool(self.folder, 8 * 200)
        assert (self.spool.name, self.spool.next_number) == (name, number)

    @rule()
    def sync(self) -> None:
        self.spool.sync()

    @invariant()
    def counts(self) -> None:
        assert self.spool.waiting == len(self.model)
        assert self.spool.dropped == self.spool.torn == self.spool.write_errors == 0

    def teardown(self) -> None:
        self.spool.close()
        self.temporary.cleanup()


TestAgainstAModel = AgainstAModel.TestCase
TestAgainstAModel.settings = settings(max_examples=25, stateful_step_count=20)


@given(cut=st.integers(1, 60), junk=st.binary(max_size=40))
@settings(max_examples=40)
def test_a_torn_end_costs_the_torn_records_alone(tmp_path_factory: pytest.TempPathFactory, cut: int, junk: bytes) -> None:
    folder = tmp_path_factory.mktemp("spool")
    spool = Spool(folder, 8000)
    spool.append([payload(n) for n in range(5)])
    spool.close()
    (file,) = folder.glob("events-*.log")
    whole = file.read_bytes()
    file.write_bytes(whole[:-cut] + junk)
    again = Spool(folder, 8000)
    kept = everything(again)
    assert kept == [payload(n) for n in range(len(kept))]
    assert len(kept) == (whole[:-cut] + junk).count(b"\n") or junk
    assert len(kept) >= whole[:-cut].count(b"\n")
    again.append([payload(9)])
    assert everything(again) == [payload(9)]
    again.close()


def test_a_lost_or_damaged_mark_means_copies_not_losses(tmp_path: Path) -> None:
    spool = Spool(tmp_path, 8000)
    spool.append([payload(n) for n in range(4)])
    spool.deliver(2)
    spool.close()
    (tmp_path / "delivered").write_bytes(b"00000000 4\n")
    again = Spool(tmp_path, 8000)
    assert everything(again) == [payload(n) for n in range(4)]
    again.close()


def test_the_oldest_go_first_and_are_counted(tmp_path: Path) -> None:
    spool = Spool(tmp_path, 4096)
    reported = 1000
    for n in range(reported):
        spool.append([payload(n)])
    on_disk = sum(f.stat().st_size for f in tmp_path.glob("events-*.log"))
    assert on_disk == spool.size_bytes <= 4096
    assert len(list(tmp_path.glob("events-*.log"))) <= FILES
    assert spool.dropped > 0
    kept = everything(spool)
    assert kept == [payload(n) for n in range(reported - len(kept), reported)]
    assert len(kept) + spool.dropped == reported
    spool.close()


def test_a_disk_that_refuses_is_waited_for_in_memory(tmp_path, monkeypatch, caplog):
    spool = Spool(tmp_path, 80_000)
    spool.append([payload(0)])
    real = os.pwrite

    def full(descriptor: int, data: bytes, offset: int) -> int:
        real(descriptor, data[:3], offset)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("companion.parts.mqtt.spool.os.pwrite", full)
    spool.append([payload(1), payload(2)])
    spool.append([payload(3)])
    assert spool.write_errors >= 2
    assert [r.getMessage().partition(": ")[2] for r in caplog.records] == [
        f"{tmp_path}: No space left on device: events wait in memory, {UNWRITTEN} at most"
    ], "said once"
    assert spool.waiting == 4
    assert [r.body for r in spool.peek(9)] == [payload(n) for n in range(4)]
    monkeypatch.setattr("companion.parts.mqtt.spool.os.pwrite", real)
    spool.append([payload(4)])
    assert "takes events again" in caplog.text
    spool.close()
    again = Spool(tmp_path, 80_000)
    assert (again.torn, everything(again)) == (0, [payload(n) for n in range(5)])
    again.close()


def test_memory_alone_is_bounded_too() -> None:
    spool = Spool(None, 8000)
    spool.append([payload(n) for n in range(UNWRITTEN + 5)])
    assert spool.dropped == 5
    assert everything(spool) == [payload(n) for n in range(5, UNWRITTEN + 5)]
    assert spool.write_errors == 0


def test_a_folder_that_cannot_be_is_the_users_fault(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match=r"mqtt\.spool: .*file"):
        Spool(tmp_path / "file", 8000)


def test_a_disk_that_is_read_only_keeps_events_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "mkdir", Mock(side_effect=OSError(errno.EROFS, os.strerror(errno.EROFS))))
    spool = Spool(tmp_path / "spool", 8000)
    spool.append([b"{}"])
    assert [record.body for record in spool.peek(5)] == [b"{}"]
    assert spool.write_errors == 1
