"""Registration's state: its blur is a covariance, whatever is done to it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from estimator.contracts.geometry import Rotation
from estimator.vision.pad_pose import PadPose
from tests.estimator.vision.oracle.state import RegistrationState
from tests.support.shipped import shipped_camera

CHANGE = st.lists(st.floats(-60.0, 60.0), min_size=3, max_size=3)


@given(blur_px=st.floats(0.0, 3.0), there=st.integers(1, 8), back=st.integers(1, 8), change=CHANGE)
def test_the_blur_stays_a_covariance_no_smaller_than_a_pixel(blur_px: float, there: int, back: int, change: list[float]) -> None:
    pose = PadPose(Rotation.identity(), np.array([0.0, 0.0, 2.0]))
    state = RegistrationState.of(pose, shipped_camera("sim"), blur_px, 2.0).reduced(there, 0.5)
    # Found by a reduced frame, taken back to whole pixels, and asked again in pixels of another width.
    found = state.moved(np.concatenate([np.zeros(6), change])).restored(there, 0.5)
    for s in (found, found.reduced(back, 0.5)):
        xx, xy, yy = s.blur_px2.tolist()
        assert np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] > 0.08
