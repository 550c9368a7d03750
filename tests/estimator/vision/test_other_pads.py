"""Pads of other shapes than the thesis': each is registered from a rough pose, near and far, and verified there."""

import math

import numpy as np
import pytest

from estimator.contracts.estimates import RelativeState
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude, Frame
from estimator.vision import by_paint
from estimator.vision.detect.pyramid import FrameView, Pyramid
from estimator.vision.detect.verification import confidence
from estimator.vision.drawing import EdgeKind
from estimator.vision.options import TrackerOptions
from estimator.vision.pad_information import alike_headings, confusable_turns
from estimator.vision.pad_pose import PadPose
from estimator.vision.pose import Orientation
from estimator.vision.register.registration import RegistrationOptions, look, register
from estimator.vision.tracker import TrackerConfig, TrackerMemory, track
from estimator.vision.verified import heading_z_scores, verify
from sitl.camera.camera import Renderer
from tests.sitl.images import PLAIN, pad_pose, shot
from tests.support.pad_images import STAMP
from tests.support.shipped import shipped_pad

NAMES = ("h", "helideck", "hospital", "icao", "x")


@pytest.mark.parametrize("name", [*NAMES, "faa_triangle"])
@pytest.mark.parametrize("height_m", [0.6, 2.0, 6.0, 10.0])
def test_a_pad_of_any_shape_is_registered_and_verified(name: str, height_m: float) -> None:
    pad, camera, exposure = shipped_pad(name), PLAIN, shot(height_m, (0.05, -0.05))
    px = Renderer(camera, pad).render(exposure, np.random.default_rng(1))
    truth = pad_pose(exposure, camera)
    off = np.array([0.5, -0.5, 0.0]) * height_m / camera.fx + np.array([0.0, 0.0, 0.002 * height_m])
    start = PadPose(truth.R_cam_pad @ Rotation.from_rpy(0.01, 0.01, 0.02), truth.t_cam_pad + off)
    found = register(px, camera, pad, start, None, RegistrationOptions(coarse=False))
    assert found is not None
    error, sigma = found.pose.t_cam_pad - truth.t_cam_pad, np.sqrt(np.diag(found.cov)[:3])
    assert np.all(np.abs(error) < 4.0 * sigma + 1e-5)
    assert abs(error[2]) < 0.005 * height_m
    assert found.yaw_ambiguous == (name != "faa_triangle"), "no other has an arrowhead or a triangle"
    lacking = [
        kind
        for kind, has in ((EdgeKind.DISC, pad.markings.field_radius_m), (EdgeKind.RING, pad.markings.ring_outer_m))
        if not has
    ]
    assert all(found.edges[kind].in_view == 0.0 for kind in lacking)
    seen = look(FrameView(Pyramid(px), camera, pad), found.pose, Orientation.of(None), RegistrationOptions(coarse=False))
    assert seen is not None
    assert confidence(seen.log_odds) > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_a_pad_of_several_headings_is_followed_without_a_search(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The filter takes no ambiguous heading, so the tracker goes by that of the last frame."""
    pad, exposure = shipped_pad(name), shot(2.0, (0.02, 0.03), (0.08, -0.05, 0.3))
    px = Renderer(PLAIN, pad).render(exposure, np.random.default_rng(3))
    config = TrackerConfig(PLAIN, pad, TrackerOptions(method="registration"))
    attitude = Attitude(STAMP, exposure.R_ned_body, 1e-6 * np.eye(3))
    seen, memory = track(config, TrackerMemory(), Frame(STAMP, 0, px), attitude)
    assert seen.selected is not None
    assert seen.selected.yaw_ambiguous
    d, cov = seen.selected.d_body_pad_level, np.diag([1e-4] * 6 + [3.0])
    belief = RelativeState(STAMP.measured_at, "ekf", d, np.zeros(3), None, cov, STAMP.measured_at, True)
    monkeypatch.setattr(by_paint, "search", None)
    again = track(config, memory, Frame(STAMP, 0, px), attitude, belief)[0].selected
    assert again is not None
    assert again.yaw_rad == pytest.approx(seen.selected.yaw_rad, abs=0.01)
    assert again.confidence > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_a_pad_is_not_seen_in_another_one(name: str) -> None:
    """The thesis' pad, registered as if it were another, is doubted."""
    pad, exposure = shipped_pad(name), shot(2.0)
    px = Renderer(PLAIN, shipped_pad("thesis")).render(exposure, np.random.default_rng(2))
    options = RegistrationOptions(coarse=False)
    found = look(FrameView(Pyramid(px), PLAIN, pad), pad_pose(exposure, PLAIN), Orientation.of(None), options)
    sure = 0.0 if found is None else confidence(found.log_odds)
    # The plain H is the thesis' H: on a green disc it is the same marking.
    assert sure < 0.5 or name == "h"


@pytest.mark.parametrize(("name", "turns_deg"), [("hospital", [90]), ("faa_triangle", [-120, 120]), ("icao", []), ("thesis", [])])
@pytest.mark.parametrize("height_m", [0.9, 3.0, 9.0])
def test_a_heading_that_the_drawing_hardly_shows_is_put_right(name: str, turns_deg: list[int], height_m: float) -> None:
    """A cross looks the same after a quarter turn, a triangle after a third: the H within them tells."""
    pad, exposure = shipped_pad(name), shot(height_m, (0.02, 0.03), (0.05, -0.02, 0.0))
    assert sorted(round(math.degrees(turn)) for turn in confusable_turns(pad)) == turns_deg
    px = Renderer(PLAIN, pad).render(exposure, np.random.default_rng(5))
    truth, orientation = pad_pose(exposure, PLAIN), Orientation.of(Attitude(STAMP, exposure.R_ned_body, 1e-4 * np.eye(3)))
    for turn in confusable_turns(pad):
        assert heading_z_scores(px, PLAIN, pad, truth, [turn])[turn] > 4.0
        assert heading_z_scores(px, PLAIN, pad, truth.turned(turn), [-turn])[-turn] < -4.0
        seen = verify(FrameView(Pyramid(px), PLAIN, pad), truth.turned(turn), orientation)
        assert seen is not None
        assert seen.confidence > 0.5
        off = abs((truth.R_cam_pad.inv @ seen.found.pose.R_cam_pad).rpy_rad[2])
        assert min(off, math.pi - off if seen.found.yaw_ambiguous else off) < 0.02


@pytest.mark.parametrize(
    ("name", "count"),
    [("thesis", 1), ("printed", 1), ("icao", 2), ("helideck", 2), ("h", 2), ("x", 4), ("hospital", 2), ("faa_triangle", 1)],
)
def test_headings_that_look_alike_are_counted(name: str, count: int) -> None:
    assert alike_headings(shipped_pad(name)) == count
