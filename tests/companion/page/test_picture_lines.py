"""The lines over the page's picture lie where the filter expects the pad."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.parts.page.endpoint import picture_lines
from companion.settings.load import camera_model, load, pad_model
from companion.tools.report.overlay import camera_lean
from estimator.contracts.estimates import FusionResult, RelativeState, Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs
from tests.make import seen

SETTINGS = load("sim")
CAMERA, PAD = camera_model(SETTINGS), pad_model(SETTINGS)
AT = MonoNs(5_000_000_000)
small = st.floats(-0.08, 0.08)


def believed(d: np.ndarray, yaw_rad: float | None = 0.3) -> RelativeState:
    return RelativeState(AT, "ekf", d, np.array([0.1, -0.2, 0.3]), yaw_rad, np.diag([0.04, 0.01, 0.09, 1, 1, 1, 0.01]), AT, True)


@given(st.tuples(small, small, small), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_the_outline_lies_where_the_filter_expects_the_pad_whatever_the_attitude_s_error(error, forward_m, right_m):
    """The vehicle reports an attitude that is wrong by `error`; the filter knows that, and its innovation is zero."""
    R_body_level = Rotation.from_rpy(0.05, -0.03, 0.0).inv
    d = np.array([forward_m, right_m, 3.0])
    in_body = R_body_level @ d
    reported = Rotation.from_rpy(0.05, -0.03, 0.0) @ Rotation.from_rotvec(np.array([error[0], error[1], 0.0]))
    frame = seen(AT, found=True)
    level = reported.without_heading()
    found = frame.detection
    assert found is not None
    assert found.selected is not None
    sighting = replace(found.selected, d_body_pad_level=level @ in_body)
    frame = replace(
        frame,
        attitude=Attitude(frame.frame.stamp, reported, np.eye(3) * 1e-4),
        detection=replace(found, selected=sighting),
        results=(FusionResult("ekf", "sighting", Verdict.FUSED, AT, AT, np.zeros(4), np.eye(4), 0.0, 0.0),),
    )
    lean = camera_lean(frame, believed(d))
    assert lean is not None
    lines = picture_lines(frame, believed(d), None, lean, CAMERA, PAD)
    disc = np.array(next(line.uv_px for line in lines if line.kind == "pad")).reshape(-1, 2)[:-1]
    centre = CAMERA.project((CAMERA.T_body_cam.inv @ in_body)[None, :])[0]
    assert disc.mean(axis=0) == pytest.approx(centre, abs=3.0)


def test_a_frame_that_was_not_compared_reports_nothing_of_the_mount() -> None:
    assert camera_lean(seen(AT, found=True), believed(np.array([0.0, 0.0, 3.0]))) is None
    assert camera_lean(seen(AT, found=False), believed(np.array([0.0, 0.0, 3.0]))) is None
    assert camera_lean(seen(AT, found=True), None) is None


@given(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0), st.floats(-2.0, 40.0), st.none() | st.floats(-3.1, 3.1))
def test_any_estimate_makes_lines_of_finite_points(forward: float, right: float, down: float, yaw: float | None) -> None:
    belief = believed(np.array([forward, right, down]), yaw)
    for line in picture_lines(seen(AT, found=False), belief, None, Rotation.identity(), CAMERA, PAD):
        uv = np.array(line.uv_px, dtype=float)
        assert uv.size >= 4
        assert np.abs(uv).max() < 4001.0
