"""Which half of a frame of the disc is believed first."""

from __future__ import annotations

import math

import numpy as np

from estimator.vision.detect.template import paints_at
from estimator.vision.pad import Pad
from tests.estimator.vision.oracle.coverage import uncovered

PAINTS = np.array([[0.9, 0.9, 0.9], [0.1, 0.4, 0.9], [0.05, 0.4, 0.05], [0.4, 0.4, 0.4]], np.float32)


def test_the_half_that_is_covered_counts_little(pad: Pad) -> None:
    xy = np.random.default_rng(3).uniform(-0.43, 0.43, (2000, 2)).astype(np.float32)
    h_marking, ring, arrow, disc = paints_at(xy, pad)
    share = np.stack([h_marking, ring | arrow, disc, ~(h_marking | ring | arrow | disc)], axis=1).astype(np.float32)
    light = share @ PAINTS + np.random.default_rng(4).normal(0.0, 0.01, (2000, 3)).astype(np.float32)
    assert np.all(uncovered(light, share, xy) == 1.0)
    for k in range(8):
        a = (k + 0.3) * math.tau / 8
        over = xy @ np.array([math.cos(a), math.sin(a)], np.float32)
        hidden = over > 0.05
        seen = np.where(hidden[:, None], np.array([0.5, 0.1, 0.3], np.float32), light)
        weight = uncovered(seen, share, xy)
        assert weight[~hidden].mean() > 0.8
        assert weight[hidden].mean() < 0.3
