"""A frame that was there before shows nothing new, whatever its stamp says."""

import numpy as np

from estimator.integrity.sensors import FrameWatch, digest, watch_frame

RNG = np.random.default_rng(3)


def noisy(level: int = 100) -> np.ndarray:
    """Return a still scene as a sensor sees it."""
    return RNG.normal(level, 2.0, (360, 640, 3)).astype(np.uint8)


def test_frames_of_a_still_scene_differ_by_the_sensors_noise_and_are_let_through() -> None:
    state = FrameWatch()
    for _ in range(30):
        state, repeated = watch_frame(state, noisy())
        assert not repeated
    assert not state.frozen


def test_a_frame_that_repeats_is_refused_at_once_and_the_camera_is_frozen_at_the_third() -> None:
    state, still = FrameWatch(), noisy()
    state, _ = watch_frame(state, still)
    runs = []
    for _ in range(4):
        state, repeated = watch_frame(state, still.copy())
        runs.append((repeated, state.frozen))
    assert runs == [(True, False), (True, False), (True, True), (True, True)]
    state, repeated = watch_frame(state, noisy())
    assert (repeated, state.frozen) == (False, False)


def test_a_ring_of_buffers_handed_out_again_and_again_is_frozen() -> None:
    state, ring = FrameWatch(), [noisy() for _ in range(8)]
    for frame in ring:
        state, _ = watch_frame(state, frame)
    for frame in ring[:3]:
        state, repeated = watch_frame(state, frame)
        assert repeated
    assert state.frozen


def test_an_image_that_is_one_row_in_memory_is_known_by_that_row() -> None:
    row = noisy()[0]
    assert digest(np.broadcast_to(row, (360, *row.shape))) == digest(np.broadcast_to(row, (9, *row.shape)))
    assert digest(np.repeat(row[None], 360, axis=0)) != digest(row[None].repeat(9, axis=0))
