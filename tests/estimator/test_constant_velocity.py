"""The path of constant velocity: it finds what moves steadily, knows how well, and refuses what its model excludes."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.cli import main as cli
from estimator.attitude_history import AttitudeHistory
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs, seconds_between
from estimator.options import EstimatorOptions
from estimator.pipeline import RelativeEstimator
from tests.make import ns, stamp

if TYPE_CHECKING:
    from estimator.constant_velocity import ConstantVelocityPath

COV = np.diag([4e-4, 4e-4, 9e-4, 1e-4])


def new() -> ConstantVelocityPath:
    from estimator.constant_velocity import ConstantVelocityPath  # with filterpy, which takes a second

    return ConstantVelocityPath(AttitudeHistory(), 0.5)


def sighted(path: ConstantVelocityPath, t_s: float, d_ned: F64, heading_rad: float = 0.0) -> tuple[ConstantVelocityPath, Verdict]:
    """Give the path an attitude and a sighting of a pad whose arrow points north; return it with the sighting's verdict."""
    R_ned_level = Rotation.from_rpy(0.0, 0.0, heading_rad)
    path.put([Attitude(stamp(t_s), R_ned_level, 1e-6 * np.eye(3))])
    result = path.sight(
        Sighting(stamp(t_s, 0.1), round(t_s * 30), "selected", R_ned_level.inv @ d_ned, heading_rad, False, COV, 0.9)
    )
    return path, result.verdict


def after(path: ConstantVelocityPath, t_s: float) -> RelativeState:
    state = path.at(ns(t_s))
    assert state is not None
    return state


velocities = st.tuples(*[st.floats(-1.5, 1.5)] * 3).map(np.array)


@settings(max_examples=20)
@given(v=velocities, turning_rad_s=st.floats(-0.4, 0.4))
def test_it_converges_to_a_pad_of_constant_velocity_while_the_body_turns(v: F64, turning_rad_s: float) -> None:
    path, start = new(), np.array([0.5, -0.3, 4.0])
    for i in range(90):
        path, verdict = sighted(path, i / 30, start + v * i / 30, turning_rad_s * i / 30)
        assert verdict is Verdict.FUSED
    state, heading_rad = after(path, 89 / 30), turning_rad_s * 89 / 30
    to_level = Rotation.from_rpy(0.0, 0.0, heading_rad).inv
    assert np.allclose(state.d_body_pad_level, to_level @ (start + v * 89 / 30), atol=0.01)
    assert np.allclose(state.v_pad_level, to_level @ v, atol=0.05)
    assert state.yaw_rad == pytest.approx(heading_rad, abs=1e-9)
    assert state.consistent


def test_nees_lies_in_its_band_on_the_filters_own_model() -> None:
    rng, step_s, nees, density = np.random.default_rng(5), 1.0 / 30.0, [], 1.0
    for _ in range(30):
        path, d, v = new(), np.array([0.3, 0.2, 3.0]), rng.normal(0.0, 0.5, 3)
        for i in range(60):
            path, _ = sighted(path, i * step_s, d + rng.normal(0.0, np.sqrt(np.diag(COV)[:3])))
            if i >= 20 and i % 10 == 0:
                state = after(path, i * step_s)
                off = np.concatenate([state.d_body_pad_level - d, state.v_pad_level - v])
                nees.append(float(off @ np.linalg.solve(state.cov[:6, :6], off)))
            # The exact discretization of white acceleration over a step, one axis at a time.
            noise = np.linalg.cholesky(density * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]]))
            shock = noise @ rng.normal(size=(2, 3))
            d, v = d + v * step_s + shock[0], v + shock[1]
    n = 6 * len(nees)
    assert sum(nees) / n == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / n))


def test_the_gate_refuses_what_jumps_and_a_second_of_it_begins_again() -> None:
    path = new()
    for i in range(30):
        path, _ = sighted(path, i / 30, np.array([0.0, 0.0, 3.0]))
    before = after(path, 1.0)
    path, verdict = sighted(path, 1.0, np.array([1.5, 0.0, 3.0]))
    assert verdict is Verdict.GATED
    assert np.array_equal(after(path, 1.0).d_body_pad_level, before.d_body_pad_level)
    for i in range(31, 60):
        path, verdict = sighted(path, i / 30, np.array([1.5, 0.0, 3.0]))
    assert verdict is Verdict.FUSED
    assert after(path, 59 / 30).d_body_pad_level[0] == pytest.approx(1.5, abs=0.05)


def test_the_result_of_a_sighting_holds_its_innovation_in_the_bodys_axes() -> None:
    path, _ = sighted(new(), 0.0, np.array([0.0, 0.0, 3.0]), 1.2)
    path.put([Attitude(stamp(0.1), Rotation.from_rpy(0.0, 0.0, 1.2), 1e-6 * np.eye(3))])
    seen = Rotation.from_rpy(0.0, 0.0, 1.2).inv @ np.array([0.0, 0.0, 3.0]) + np.array([0.02, 0.0, 0.0])
    result = path.sight(Sighting(stamp(0.1, 0.1), 3, "selected", seen, None, False, COV, 0.9))
    assert result.components == ("x_m", "y_m", "z_m")
    assert result.innovation is not None
    assert np.allclose(result.innovation, [0.02, 0.0, 0.0], atol=1e-9)
    assert result.nis == pytest.approx(float(result.innovation @ np.linalg.solve(result.innovation_cov, result.innovation)))
    from estimator.constant_velocity import GATE_NIS

    assert result.test_ratio == result.nis / GATE_NIS


@given(age_s=st.floats(0.0, 0.4))
def test_a_late_frame_is_carried_on_to_the_instant_requested_and_widens_the_covariance(age_s: float) -> None:
    path, v = new(), np.array([0.6, -0.2, -0.4])
    for i in range(60):
        path, _ = sighted(path, i / 30, np.array([0.0, 0.0, 4.0]) + v * i / 30)
    last, now = after(path, 59 / 30), after(path, 59 / 30 + age_s)
    assert now.age_s(now.at) == pytest.approx(age_s, abs=1e-8)
    assert np.allclose(now.d_body_pad_level, last.d_body_pad_level + last.v_pad_level * seconds_between(last.at, now.at))
    assert bool(np.all(np.linalg.eigvalsh(now.cov[:6, :6] - last.cov[:6, :6])[-3:] >= -1e-12))


def test_a_frame_exposed_before_the_newest_fused_one_is_refused() -> None:
    path, _ = sighted(new(), 0.0, np.array([0.0, 0.0, 3.0]))
    path, _ = sighted(path, 0.1, np.array([0.0, 0.0, 3.0]))
    before = path.at(MonoNs(10**8))
    result = path.sight(Sighting(stamp(0.05, 0.1), 9, "selected", np.array([0.0, 0.0, 3.0]), None, False, COV, 0.9))
    assert result.verdict is Verdict.TOO_OLD
    assert str(path.at(MonoNs(10**8))) == str(before)


def test_without_an_attitude_a_sighting_is_refused_and_without_a_heading_the_yaw_is_unknown() -> None:
    seen = Sighting(stamp(0.0, 0.1), 0, "selected", np.array([0.0, 0.0, 3.0]), None, False, COV, 0.9)
    path = new()
    result = path.sight(seen)
    assert (result.verdict, path.at(MonoNs(0))) == (Verdict.NO_ATTITUDE, None)
    path.put([Attitude(stamp(0.0, 0.1), Rotation.from_rpy(0.0, 0.0, 0.0), 1e-6 * np.eye(3))])
    path.sight(seen)
    state = after(path, 0.0)
    assert (state.yaw_rad, state.cov[6, 6]) == (None, UNKNOWN_YAW_VAR)
    assert (path.motion(MonoNs(0)), path.forecast(MonoNs(0), [1.0])) == ((None, None), None)


def test_without_filterpy_one_line_names_the_extra(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "filterpy", None)
    with pytest.raises(BadInput, match=r"decklander\[compare\]"):
        RelativeEstimator(EstimatorOptions(), shadows=("constant_velocity",))
    for words in (["simulate"], ["campaign", "--runs", "1", "--json"]):
        arguments = [words[0], "calm", *words[1:], "--perception", "model", "--set", "estimator.path=constant_velocity"]
        assert cli.main(arguments) == 2
        output = capsys.readouterr().err
        assert output.count("\n") == 1
        assert "decklander[compare]" in output
