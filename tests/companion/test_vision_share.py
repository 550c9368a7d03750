"""On a machine too slow for each frame, vision leaves frames out and leaves a share of the core to everything else."""

import gc

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.base.memory import GroundedCollector, no_full_collections
from companion.service.daemon import VisionShare
from estimator.contracts.time import MonoNs, after, seconds_between


def looked_at(core_fraction: float, look_s: float, period_s: float, frames: int = 300) -> tuple[list[float], float]:
    """Return the instants at which frames of a camera were looked at, s, and the share of the time that the looks took."""
    share, free_at, began = VisionShare(core_fraction), MonoNs(0), []
    for n in range(frames):
        now = after(MonoNs(0), n * period_s)
        if now < free_at or not share.admits(now):
            continue
        free_at = after(now, look_s)
        share.looked(now, look_s)
        began.append(seconds_between(MonoNs(0), now))
    return began, look_s * len(began) / (frames * period_s)


@given(st.floats(0.4, 0.9), st.floats(0.002, 0.1), st.sampled_from((1 / 60, 1 / 30, 1 / 15)))
def test_looks_take_no_more_than_their_share(core_fraction: float, look_s: float, period_s: float) -> None:
    began, share = looked_at(core_fraction, look_s, period_s)
    assert share <= core_fraction + look_s / (300 * period_s)
    assert np.max(np.diff(began), initial=0.0) <= look_s / core_fraction + period_s + 1e-6, "and hardly less"


def test_a_machine_that_is_fast_enough_looks_at_each_frame() -> None:
    began, share = looked_at(0.7, 0.02, 1 / 30)
    assert len(began) == 300
    assert 0.5 < share < 0.7


def test_a_share_of_one_skips_nothing_that_the_thread_has_time_for() -> None:
    began, _ = looked_at(1.0, 0.05, 1 / 30)
    assert len(began) == 150


def test_however_long_a_look_takes_the_next_one_waits_no_longer_than_a_fifth_of_a_second() -> None:
    began, _ = looked_at(0.1, 1.0, 1 / 30)
    assert np.max(np.diff(began)) <= 1.0 + 0.2 + 1 / 30 + 1e-6


def test_a_full_collection_happens_on_the_ground_alone() -> None:
    collector = GroundedCollector()
    for at_s, flying, collections in (
        (0, False, 0),
        (59, None, 0),
        (61, True, 0),
        (600, True, 0),
        (601, False, 1),
        (630, None, 1),
    ):
        collector.tick(after(MonoNs(0), at_s), flying)
        assert collector.collections == collections, (at_s, flying)


def test_the_interpreter_starts_no_full_collection_while_the_service_runs() -> None:
    """A list of many young objects that stay makes the interpreter look through the oldest generation, as a flight's do."""
    fulls: list[int] = []

    def seen(phase: str, info: dict[str, int]) -> None:
        if phase == "start" and info["generation"] == 2:
            fulls.append(1)

    def churn() -> list[list[int]]:
        return [[n] for n in range(300_000)]

    before = gc.get_threshold()
    gc.callbacks.append(seen)
    try:
        kept = churn()
        assert fulls, "or this test proves nothing"
        with no_full_collections():
            fulls.clear()
            kept += churn()
            assert not fulls
    finally:
        gc.callbacks.remove(seen)
    assert gc.get_threshold() == before
    assert len(kept) == 600_000
