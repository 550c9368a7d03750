"""Faults of the streams: what becomes of packets, and what reaches the service and the drone of a flight."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.ardrone.navdata_channel import NavdataOrder
from drivers.ardrone.navdata_channel import SequencePlace as P
from estimator.contracts.samples import Imu
from estimator.contracts.time import MonoNs
from sitl.faults.faulty_streams import FaultyStream, InTransit
from sitl.faults.kinds import KIND_OF_STREAM, STREAMS, CommandStream, FrameStream, LinkLost, NavdataStream, StreamFault
from sitl.faults.timer import FaultTimer
from tests.sitl.test_faults import at, fly_calm, world

TICK_NS = 10_000_000


def carried(*faults: StreamFault | LinkLost, seed: int = 1, packets: int = 400) -> list[tuple[int, MonoNs]]:
    """Send a packet each 10 ms over a stream of frames; return number and time of each arrival."""
    timer = FaultTimer(faults, seed)
    transit: InTransit[int] = InTransit(FaultyStream(timer, "frames", seed))
    out = []
    for n in range(packets + 200):
        now = MonoNs(n * TICK_NS)
        timer.update(n * 0.01, 3.0, None)
        if n < packets:
            transit.send(lambda n=n: n, now, 0.02)  # type: ignore[misc]
        while (packet := transit.arrived(now)) is not None:
            out.append((packet[1], packet[0]))
    return out


def test_late_packets_keep_their_order_when_the_delay_ends() -> None:
    out = carried(FrameStream(at_s=1.0, for_s=1.0, delay_s=0.5))
    assert [n for n, _ in out] == list(range(400))
    late = {n: (when - n * TICK_NS) / 1e9 for n, when in out}
    assert late[99] == pytest.approx(0.02)
    assert late[100] == pytest.approx(0.52)
    assert late[200] == pytest.approx(0.51), "it waits behind the last late one"
    assert late[399] == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("effect", "share"),
    [("dropped_fraction", lambda out: 1 - len(out) / 400), ("duplicated_fraction", lambda out: len(out) / 400 - 1)],
)
def test_a_share_is_lost_or_doubled_and_the_seed_says_which(effect: str, share: object) -> None:
    out = carried(FrameStream(at_s=0.0, **{effect: 0.3}))
    assert 0.22 < share(out) < 0.38  # type: ignore[operator]
    assert out == carried(FrameStream(at_s=0.0, **{effect: 0.3}))
    assert out != carried(FrameStream(at_s=0.0, **{effect: 0.3}), seed=2)
    assert all(b - a >= -2 for a, b in itertools.pairwise(n for n, _ in out)), "a copy comes just after the packet behind it"


def test_overtaken_packets_come_after_the_next_one_that_is_not() -> None:
    numbers = [n for n, _ in carried(FrameStream(at_s=0.0, reordered_fraction=0.3))]
    assert sorted(numbers) == list(range(len(numbers)))
    backward = np.diff(numbers) < 0
    assert 0.15 < backward.mean() < 0.35


@given(st.lists(st.tuples(st.floats(0, 0.5), st.floats(0, 0.99), st.floats(0, 1)), max_size=3), st.integers(0, 50))
def test_nothing_is_made_up_and_nothing_is_late_for_ever(effects: list[tuple[float, float, float]], seed: int) -> None:
    faults = [
        FrameStream(at_s=0.1, for_s=0.3, delay_s=late + 0.001, dropped_fraction=lost, reordered_fraction=behind)
        for late, lost, behind in effects
    ]
    numbers = [n for n, _ in carried(*faults, seed=seed, packets=100)]
    assert len(set(numbers)) == len(numbers)
    assert set(range(50, 100)) <= set(numbers)


@pytest.mark.parametrize("stream", STREAMS)
def test_a_lost_link_and_a_lost_stream_are_silent(stream: str) -> None:
    lost = at(world(LinkLost(at_s=0.1)), 0.2)
    own = at(world(KIND_OF_STREAM[stream](at_s=0.1, dropped_fraction=1.0)), 0.2)  # type: ignore[index]
    for w in (lost, own):
        assert getattr(w.streams, stream).silent
        assert getattr(w.streams, stream).fate().copies == 0
    assert [getattr(own.streams, name).silent for name in STREAMS] == [name == stream for name in STREAMS]


def test_late_samples_arrive_late_and_keep_their_stamps() -> None:
    _, seen = fly_calm(NavdataStream(at_s=0.5, delay_s=0.3))
    delays = np.array([s.stamp.delay_s for s in seen.samples if isinstance(s, Imu)])
    assert delays[0] == pytest.approx(0.004, abs=0.001)
    assert delays[-1] == pytest.approx(0.304, abs=0.006)
    gap = np.diff([s.stamp.received_at for s in seen.samples if isinstance(s, Imu)]).max() * 1e-9
    assert gap == pytest.approx(0.305, abs=0.006)


def test_doubled_and_overtaken_samples_reach_the_service_once_and_in_order() -> None:
    _, all_of_them = fly_calm(NavdataStream(at_s=9.0, delay_s=0.1), 0.6)
    for effect in ("duplicated_fraction", "reordered_fraction"):
        _, seen = fly_calm(NavdataStream(at_s=0.1, **{effect: 0.4}), 0.6)
        stamps = [s.stamp.measured_at for s in seen.samples if isinstance(s, Imu)]
        assert stamps == sorted(set(stamps))
        expected = len([s for s in all_of_them.samples if isinstance(s, Imu)])
        assert len(stamps) == expected if effect == "duplicated_fraction" else len(stamps) < 0.85 * expected


def test_late_commands_move_the_drone_later_and_lost_ones_let_it_go_on() -> None:
    taken = []
    for fault in (CommandStream(at_s=9.0, delay_s=0.1), CommandStream(at_s=0.2, delay_s=0.1)):
        flight, _ = fly_calm(fault, 0.25)
        taken.append(flight._drone.state.counters["at_taken"])
    assert taken[1] < taken[0]
    flight, _ = fly_calm(CommandStream(at_s=0.3, dropped_fraction=1.0), 3.0)
    assert flight._drone.state.silent, "the drone misses its client"


def test_a_datagram_that_was_overtaken_is_old_and_a_restarted_drone_is_not() -> None:
    order = NavdataOrder()
    places = [order.place(n) for n in (5, 6, 9, 8, 9, 10, 1)]
    assert places == [P.NEXT, P.NEXT, P.NEXT, P.OLD, P.OLD, P.NEXT, P.RESTARTED]
    order.silence()
    assert [order.place(n) for n in (40, 30)] == [P.NEXT, P.OLD]
