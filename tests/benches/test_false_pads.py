"""No pad where there is none: the hardest of a seeded thousand frames, and photographs of sea and other things."""

import numpy as np
import pytest

from benches.false_pads import best_scores, photographs, scene_of, sure_of
from tests.support.hard_light import HARD
from tests.support.pad_scenes import DATA, load_camera

SUREST = {
    41000: (1, 61, 85, 88), 41001: (2, 5, 14, 25, 65, 84), 41002: (9, 32, 36, 60, 65, 83, 86, 93), 41003: (0, 15, 60, 64),
    41005: (12, 20, 85, 94), 41006: (31, 88, 99), 41007: (1, 6, 40, 60), 41008: (46, 66, 70, 94), 41009: (9, 12, 52, 53, 96),
}  # fmt: skip
"""The frames of nine hundred others in which the search is surest of something: 0.0008 to 0.02."""


@pytest.mark.hazard("H2")
def test_no_rendered_frame_without_a_pad_shows_one() -> None:
    """Chunk 41004 has a green disc with the pad's ring, and glare where the H would be."""
    scores = np.array(best_scores(41004)[0])
    assert len(scores) == 100
    assert scores.max() < 0.5, f"frame {scores.argmax()}"
    for chunk, frames in SUREST.items():
        for i in frames:
            scene = scene_of(chunk, i)
            assert sure_of(scene.px, load_camera("sim"), HARD["plain"].pad, scene.R_level_body) < 0.5, f"chunk {chunk}, {i}"


def test_no_green_disc_with_a_ring_in_glare_is_the_pad() -> None:
    """One of these hundred was the pad, with 0.98, by a ring and a disc's edge alone."""
    assert max(best_scores(8, rings=True)[0]) < 0.5


@pytest.mark.parametrize(
    ("chunk", "i"),
    [
        pytest.param(41037, 94, id="a life raft with a stripe"),
        pytest.param(41090, 55, id="a green disc with a ring and glare, cut"),
        pytest.param(41131, 79, id="another life raft"),
        pytest.param(41164, 16, id="an orange raft with a white middle on green"),
        pytest.param(41182, 75, id="the corner of another helipad"),
        pytest.param(41271, 58, id="another helipad in strong glare"),
        pytest.param(41329, 92, id="an H of other strokes"),
        pytest.param(41426, 13, id="another helipad that the drawing lies beside"),
        pytest.param(41487, 72, id="an orange raft on a dark sea"),
        pytest.param(60010, 96, id="a small green disc with the pad's ring and glare"),
        pytest.param(61582, 74, id="a corner of another helipad's H beside its edge"),
        pytest.param(54023, 28, id="a green disc with the pad's ring, cut by glare in the corner"),
    ],
)
def test_what_a_search_once_took_for_the_pad_is_none(chunk: int, i: int) -> None:
    scene = scene_of(chunk, i)
    assert sure_of(scene.px, load_camera("sim"), HARD["plain"].pad, scene.R_level_body) < 0.4


def test_half_of_a_raft_in_glare_is_no_pad() -> None:
    scene = scene_of(41776, 16)
    assert sure_of(scene.px, load_camera("sim"), HARD["plain"].pad, scene.R_level_body) < 0.5


@pytest.mark.hazard("H2")
@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not here")
def test_no_photograph_without_a_pad_shows_one() -> None:
    seen = photographs(HARD["plain"])
    assert len(seen) > 200
    assert max(score for _, score in seen) < 0.5, max(seen, key=lambda one: one[1])
