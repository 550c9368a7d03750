"""No pad where there is none: the hardest of a seeded thousand frames, and photographs of sea and other things."""

import pytest

from benches.false_pads import photographs, scene_of, sure_of
from tests.support.hard_light import HARD
from tests.support.pad_scenes import DATA, load_camera

SUREST = {
    41000: (1, 61, 85, 88), 41001: (2, 5, 14, 25, 65, 84), 41002: (9, 32, 36, 60, 65, 83, 86, 93), 41003: (0, 15, 60, 64),
    41004: (49, 60, 30, 72, 2, 25, 70, 78, 76, 42, *range(0, 100, 20)),
    41005: (12, 20, 85, 94), 41006: (31, 88, 99), 41007: (1, 6, 40, 60), 41008: (46, 66, 70, 94), 41009: (9, 12, 52, 53, 96),
}  # fmt: skip
"""The frames of a thousand in which the search is surest of something, 0.0002 to 0.08, and some others: a green disc with the
pad's ring, and glare where the H would be (41004)."""
RINGS = (3, 55, 64, 85, 44, 41, 40, 46, 74, 65, 35, 32, 52, 34, 61, 10, *range(0, 100, 20))
"""The same of a hundred with rings, 0.002 to 0.37; one of them was the pad, with 0.98, by a ring and a disc's edge alone."""


@pytest.mark.hazard("H2")
@pytest.mark.parametrize(
    ("rings", "frames"), [(False, [(k, i) for k, chosen in SUREST.items() for i in chosen]), (True, [(8, i) for i in RINGS])]
)
def test_no_rendered_frame_without_a_pad_shows_one(rings: bool, frames: list[tuple[int, int]]) -> None:
    for chunk, i in frames:
        scene = scene_of(chunk, i, rings)
        assert sure_of(scene.px, load_camera("sim"), HARD["plain"].pad, scene.R_level_body) < 0.5, f"chunk {chunk}, {i}"


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
        pytest.param(41776, 16, id="half of a raft in glare"),
    ],
)
def test_what_a_search_once_took_for_the_pad_is_none(chunk: int, i: int) -> None:
    scene = scene_of(chunk, i)
    assert sure_of(scene.px, load_camera("sim"), HARD["plain"].pad, scene.R_level_body) < 0.4


@pytest.mark.hazard("H2")
@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not here")
def test_no_photograph_without_a_pad_shows_one() -> None:
    seen = photographs(HARD["plain"], 1000)
    assert len(seen) > 200
    assert max(score for _, score in seen) < 0.5, max(seen, key=lambda one: one[1])
