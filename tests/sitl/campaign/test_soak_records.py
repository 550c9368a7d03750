"""The records of a soak: they come back as they were, take no memory, and a full temporary folder loses none."""

import tempfile
import tracemalloc
from typing import Any

import pytest

from sitl.campaign.soak_flights import Class, Flown, Records


def record_number(n: int) -> Flown:
    return Flown(30.0 * n, n, f"a ferry; faults/number_{n}", Class.FAILED if n % 3 else Class.ON_PAD, f"because of {n}", 12.5 + n)


def test_records_come_back_in_their_order_and_more_may_come_meanwhile() -> None:
    records = Records(Flown)
    assert list(records) == []
    for n in range(3):
        records.append(record_number(n))
    seen = []
    for record in records:
        seen.append(record)
        records.append(record_number(10 + len(seen)))
    assert seen == [record_number(0), record_number(1), record_number(2)]
    assert len(records) == 6
    assert list(records)[3:] == [record_number(11), record_number(12), record_number(13)]


def test_a_day_of_records_takes_no_memory() -> None:
    records = Records(Flown)
    records.append(record_number(0))
    tracemalloc.start()
    try:
        for n in range(5000):
            records.append(record_number(n))
        assert tracemalloc.get_traced_memory()[0] < 20_000, "a list of them takes two megabytes"
    finally:
        tracemalloc.stop()
    assert len(records) == 5001


def test_a_full_temporary_folder_loses_none(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    class Full:
        """A file on which there is room for two and a half records."""

        def __init__(self, file: Any) -> None:
            self._file, self._left = file, 0

        def write(self, data: bytes) -> int:
            self._left = self._left or 2 * len(data) + len(data) // 2
            part = data[: self._left - self._file.tell()]
            return int(self._file.write(part))

        def close(self) -> None:
            self._file.close()

        def fileno(self) -> int:
            return int(self._file.fileno())

    whole = tempfile.TemporaryFile
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **keys: Full(whole(**keys)))
    records = Records(Flown)
    for n in range(6):
        records.append(record_number(n))
    assert list(records) == [record_number(n) for n in range(6)]
    assert capsys.readouterr().err.count("no space left; the run keeps its further records in memory\n") == 1
