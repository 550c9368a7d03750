"""Events that are put into the past together: what goes in one row, and that it is the past of one after the other."""

import numpy as np
import pytest

from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Baro, Imu
from estimator.contracts.time import MonoNs, Stamp
from estimator.ekf.history import _CHUNK, History, Leap, _in_order, put, put_all
from estimator.ekf.packed_belief import Followed
from estimator.ekf.packed_event import Event
from tests.estimator.ekf.hand import MS, OPTIONS, TOOLS, T

LEAP, AHEAD = round(OPTIONS.leap_s * 1e9), round(OPTIONS.max_ahead_s * 1e9)


def baro(measured: int, received: int | None = None) -> Baro:
    return Baro(Stamp(MonoNs(T + measured), MonoNs(T + (measured if received is None else received)), 0.02, "sim"), 1.0, 0.5)


def attitude(measured: int, received: int | None = None) -> Attitude:
    return Attitude(baro(measured, received).stamp, Rotation.identity(), 1e-4 * np.eye(3))


def begun() -> History:
    return put(History(), attitude(0), TOOLS)[0]


@pytest.mark.parametrize(
    ("events", "taken", "heard"),
    [
        ([baro(1), baro(2), baro(2), baro(5)], 4, 5),
        ([baro(1), baro(0), baro(2)], 1, 1),
        ([baro(2), attitude(2), baro(3)], 1, 2),
        ([baro(2), baro(1)], 1, 2),
        ([attitude(-1), baro(1)], 0, 0),
        ([baro(1), baro(2 + AHEAD, 2), baro(3 + AHEAD, 3)], 3, 3),
        ([baro(1), baro(3 + AHEAD, 2)], 1, 1),
        ([baro(5), baro(5 + AHEAD, 2)], 2, 5),
        ([baro(1), baro(2, LEAP + 1)], 2, LEAP + 1),
        ([baro(1), baro(2, LEAP + 2)], 1, 1),
        ([baro(1)], 0, 0),
    ],
)
def test_what_follows_in_order_goes_in_one_row(events: list[Event], taken: int, heard: int) -> None:
    entries, received_at = _in_order(begun(), events, TOOLS)
    assert [entry.event for entry in entries] == events[:taken]
    assert received_at == T + heard


def test_nothing_goes_in_a_row_before_the_first_event_or_while_time_may_have_leapt() -> None:
    two = [baro(1), baro(2)]
    assert _in_order(History(), two, TOOLS) == ([], -1)
    assert _in_order(begun()._replace(leapt=Leap(T, 1)), two, TOOLS) == ([], T)


def told(history: History) -> list[object]:
    newest = history.newest()
    assert newest is not None
    base = None if history.base is None else history.base.t
    beliefs = [b"" if node.after is None else node.after.x.tobytes() + node.after.P.tobytes() for node in history.nodes]
    keys = [node.key for node in history.nodes]
    return [keys, beliefs, base, history.forgotten, history.received_at, history.leapt, newest.t]


@pytest.mark.parametrize("seed", range(4))
def test_events_together_make_the_past_of_one_after_the_other(seed: int) -> None:
    rng, now, one, all_at_once = np.random.default_rng(seed), 0, begun(), begun()
    for size in rng.integers(1, 9, 50).tolist():
        batch: list[Event] = []
        for _ in range(size):
            now += int(rng.integers(1, 12)) * MS
            late = int(rng.choice([0, 0, 0, 0, 0, 0, 30, 400, 1500])) * MS
            away = int(rng.choice([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 3000])) * MS
            batch.append((baro if rng.random() < 0.7 else attitude)(now - late, now + away))
        singly = []
        for event in batch:
            one, result = put(one, event, TOOLS)
            singly.append(result.verdict)
        all_at_once, results = put_all(all_at_once, batch, TOOLS)
        assert [result.verdict for result in results] == singly
        assert told(all_at_once) == told(one)
    assert all(len(chunk) <= _CHUNK for chunk in all_at_once.chunks)


def test_a_row_is_one_memory_and_chunks_are_filled_before_the_next() -> None:
    history, results = put_all(begun(), [baro(k * MS) for k in range(1, 81)], TOOLS)
    assert len(results) == 80
    assert [len(chunk) for chunk in history.chunks] == [32, 32, 17]
    rows = {id(node.row) for node in history.nodes[1:]}
    assert len(rows) == 1
    assert isinstance(history.nodes[1].row, Followed)
    assert [node.at for node in history.nodes[1:]] == list(range(80))


@pytest.mark.parametrize(("late_ms", "copied"), [(21, False), (20, True)])
def test_a_row_of_which_few_beliefs_are_left_is_freed(late_ms: int, copied: bool) -> None:
    """A late event leaves the first of 80 states; a quarter of them or fewer are copied."""
    history, _ = put_all(begun(), [baro(k * MS) for k in range(1, 81)], TOOLS)
    row = history.nodes[1].row
    after, _ = put(history, attitude(late_ms * MS + 1, 81 * MS), TOOLS)
    kept = [node for node in after.nodes if 0 < node.key[0] - T <= late_ms * MS]
    assert len(kept) == late_ms
    assert {node.row is row for node in kept} == {not copied}
    assert {len(node.row) for node in kept} == {late_ms if copied else 80}
    for node, before in zip(kept, history.nodes[1:], strict=False):
        assert node.after is not None
        assert before.after is not None
        assert node.after.P.tobytes() == before.after.P.tobytes()


def test_a_row_that_the_first_attitude_interrupts_is_the_past_of_one_after_the_other() -> None:
    """The filter has felt which way is down; the first heading is set outright, and the core's row ends before it."""

    def felt(measured_ms: int) -> Imu:
        return Imu(baro(measured_ms * MS).stamp, np.array([0.02 * measured_ms, 0.0, 0.1]), np.array([0.1, 0.2, -9.8]))

    events: list[Event] = [felt(5), felt(10), felt(15), attitude(16 * MS), felt(20), baro(21 * MS)]
    one = all_at_once = put(History(), felt(0), TOOLS)[0]
    singly = []
    for event in events:
        one, result = put(one, event, TOOLS)
        singly.append(result)
    all_at_once, together = put_all(all_at_once, events, TOOLS)
    assert [result.verdict for result in together] == [result.verdict for result in singly]
    assert told(all_at_once) == told(one)
    assert [len(node.row) for node in all_at_once.nodes] == [1, 3, 3, 3, 1, 2, 2]


def test_whole_chunks_are_forgotten_one_at_a_time() -> None:
    history, _ = put_all(begun(), [baro(k * MS) for k in range(1, 81)], TOOLS)
    kept_ms = round(OPTIONS.history_s * 1e3)
    history, _ = put(history, baro((kept_ms + 40) * MS), TOOLS)
    assert [node.key[0] - T for node in history.nodes] == [*(k * MS for k in range(40, 81)), (kept_ms + 40) * MS]
    assert history.forgotten == T + 39 * MS
