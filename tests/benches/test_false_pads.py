"""No pad where there is none: a seeded thousand frames, and photographs of sea and other things."""

from __future__ import annotations

import numpy as np
import pytest

from benches.false_pads import best_scores, photographs
from tests.support.pad_scenes import DATA


@pytest.mark.parametrize("chunk", [*range(41000, 41010)])
def test_no_rendered_frame_without_a_pad_shows_one(chunk: int) -> None:
    """Chunk 41004 has a green disc with the pad's ring, and glare where the H would be."""
    scores = np.array(best_scores(chunk)[0])
    assert len(scores) == 100
    assert scores.max() < 0.5, f"frame {scores.argmax()}"


@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not here")
def test_no_photograph_without_a_pad_shows_one() -> None:
    seen = photographs("plain")
    assert len(seen) > 200
    assert max(score for _, score in seen) < 0.5, max(seen, key=lambda one: one[1])
