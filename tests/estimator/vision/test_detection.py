"""A sighting that is hardly the pad claims no more than that."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs

from estimator.contracts.estimates import UNSURE
from estimator.vision.detection import covered
from tests.make import sighting


@given(st.floats(0.0, 1.0), st.floats(0.2, 60.0), st.floats(0.0, 6.28))
def test_the_covariance_of_an_unsure_sighting_covers_the_pad_elsewhere(confidence: float, away_m: float, turned: float) -> None:
    seen = structs.replace(sighting(0.0, (0.1, 0.2, away_m)), confidence=confidence)
    out = covered(seen)
    if confidence >= UNSURE:
        assert out is seen
        return
    true = np.array([np.cos(turned), np.sin(turned), 1.0])  # where the pad is after all
    off = true - seen.d_body_pad_level
    assert off @ np.linalg.solve(out.cov[:3, :3], off) < 3.0
    assert out.pose6 is None
    assert covered(None) is None
