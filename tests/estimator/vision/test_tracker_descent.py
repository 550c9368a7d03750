"""Down to the deck through the eyes of a flight: methods come and go with height, and the estimate takes no step."""

import math
from itertools import pairwise

import numpy as np
import pytest

from estimator.contracts.estimates import Method, Sighting
from estimator.contracts.geometry import F64
from estimator.vision.detection import fuse
from estimator.vision.tracker import TrackerMemory, track
from sitl.camera.light import Light
from sitl.camera.surroundings import Surroundings
from tests.estimator.vision.test_tracker import CAMERA, PAD, attitude, belief, tracker
from tests.support.pad_views import Stage

STEP_M = 0.03


@pytest.fixture(scope="module")
def descent() -> list[tuple[float, dict[Method, Sighting], Sighting, F64]]:
    """Height, what each method said, what they said together and the true vector, from 14 m to 0.2 m."""
    stage, memory, out = Stage(CAMERA, PAD, Surroundings(), Light(), seed=4), TrackerMemory(), []
    for height_m in np.geomspace(14.0, 0.2, 30):
        view = stage.view(float(height_m), lateral=0.05, tilt_rad=math.radians(3.0))
        seen, memory = track(tracker(), memory, view.frame(), attitude(view), belief(view, (0.01, -0.005, 0.01)))
        assert seen.selected is not None, f"nothing at {height_m:.2f} m"
        cues = {method: cue for method, cue in seen.methods.items() if cue is not None}
        out.append((float(height_m), cues, seen.selected, view.d_body_pad_level))
    return out


Descent = list[tuple[float, dict[Method, Sighting], Sighting, F64]]


def test_methods_come_and_go_on_the_way_down(descent: Descent) -> None:
    for method in ("ellipse", "arrow", "corners"):
        seen = [method in cues for _, cues, _, _ in descent]
        assert any(seen), method
        assert not all(seen), method
    assert all("registration" in cues for _, cues, _, _ in descent)


def test_no_step_where_the_set_of_methods_changes(descent: Descent) -> None:
    changes = 0
    for (_, cues, fused, true), (height_m, after, fused_after, true_after) in pairwise(descent):
        if set(cues) == set(after):
            continue
        changes += 1
        before = fused.d_body_pad_level - true
        assert np.linalg.norm(fused_after.d_body_pad_level - true_after - before) < STEP_M, f"at {height_m:.2f} m"
    assert changes >= 3


def test_no_step_when_any_one_cue_is_taken_away(descent: Descent) -> None:
    for height_m, cues, whole, _ in descent:
        for gone in cues:
            rest = fuse(cue for method, cue in cues.items() if method != gone)
            if rest is None:
                continue
            apart = float(np.linalg.norm(rest.sighting.d_body_pad_level - whole.d_body_pad_level))
            # Without registration the thesis' own methods speak, whose errors far away are larger than a step.
            assert apart < (STEP_M if gone != "registration" else max(STEP_M, 0.012 * height_m)), f"{gone} at {height_m:.2f} m"
