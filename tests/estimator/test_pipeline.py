"""One door: every sighting ends in one verdict a path, and a refused one changes nothing.

The path of constant velocity finds what moves steadily, knows how well, and refuses what its model excludes.
"""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from companion.cli import main as cli
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import UNKNOWN_YAW_VAR, FusionResult, IntegrityAlert, RelativeState, Sighting, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, BodyVelocity, Range
from estimator.contracts.time import MonoNs, Stamp, seconds_between
from estimator.options import DeadReckoningOptions, EstimatorOptions
from estimator.paths import Event
from estimator.pipeline import RelativeEstimator
from tests.make import attitude, imu, ns, sighting, stamp, velocity

STEERING = EstimatorOptions(path="dead_reckoning")


def seen_at(t_s: float, d: tuple[float, float, float], *, delay_s: float = 0.1, confidence: float = 0.9) -> Sighting:
    return sighting(stamp(t_s, delay_s), d, 0.3, var=(1e-4, 1e-4, 4e-4), yaw_var=1e-4, seq=round(t_s * 30), confidence=confidence)


def at_rest(t_s: float) -> list[Event]:
    return [attitude(t_s, 1e-6 * math.sin(500.0 * t_s), yaw=1.0, var=1e-5), imu(t_s), velocity(t_s)]


def feed(memory: RelativeEstimator, events: list[Event]) -> tuple[RelativeEstimator, list[FusionResult]]:
    outcomes: list[FusionResult] = []
    for event in events:
        (made,) = memory.put([event])
        outcomes.extend(made)
    return memory, outcomes


def hovering(until_s: float = 1.0) -> RelativeEstimator:
    memory = RelativeEstimator(STEERING, shadows=("median_mean",))
    for i in range(round(until_s * 200)):
        memory, _ = feed(memory, at_rest(i / 200))
        if i % 7 == 0 and i > 20:
            memory.put([seen_at(i / 200 - 0.1, (0.5, -0.2, 2.0))])
    return memory


def equal(a: RelativeState, b: RelativeState) -> bool:
    return bool(np.array_equal(a.d_body_pad_level, b.d_body_pad_level) and np.array_equal(a.cov, b.cov))


def test_every_path_estimates_the_pad_where_it_was_seen() -> None:
    memory = hovering()
    for belief in memory.all_at(MonoNs(10**9)):
        assert np.allclose(belief.d_body_pad_level, (0.5, -0.2, 2.0), atol=0.01)
        assert math.isclose(belief.yaw_rad, 0.3, abs_tol=1e-6)
    assert [b.path for b in memory.all_at(MonoNs(10**9))] == ["dead_reckoning", "median_mean"]


@settings(max_examples=30)
@given(delay_s=st.floats(0.0, 1.5), confidence=st.floats(0.0, 1.0))
def test_every_sighting_ends_in_one_verdict_a_path_and_a_refused_one_changes_nothing(delay_s: float, confidence: float) -> None:
    memory = hovering()
    before = memory.all_at(MonoNs(10**9))
    (outcomes,) = memory.put([seen_at(0.99, (3.0, 3.0, 3.0), delay_s=delay_s, confidence=confidence)])
    assert sorted(o.path for o in outcomes) == ["dead_reckoning", "median_mean"]
    if delay_s > STEERING.max_delay_s + 1e-6:
        assert {o.verdict for o in outcomes} == {Verdict.TOO_OLD}
    elif confidence < STEERING.min_confidence:
        assert {o.verdict for o in outcomes} == {Verdict.LOW_CONFIDENCE}
    if all(o.verdict is not Verdict.FUSED for o in outcomes):
        assert all(equal(a, b) for a, b in zip(before, memory.all_at(MonoNs(10**9)), strict=True))


def test_a_frame_that_no_attitude_covers_is_looked_at_for_a_second_where_the_pad_was() -> None:
    memory = hovering()
    assert [memory.assumed_at(stamp(t_s)) for t_s in (0.88, 1.89)] == [None, None], "the pad was seen 0.88 s after the beginning"
    assert RelativeEstimator(STEERING).assumed_at(stamp(1.0)) is None
    assumed = memory.assumed_at(stamp(1.87))
    assert assumed.R_ned_body.rpy_rad == pytest.approx((0.0, 0.0, 1.0), abs=1e-5)
    assert np.sqrt(assumed.cov_body.diagonal()) == pytest.approx([0.1] * 3)
    place = memory.place_to_look(assumed)
    assert (place.at, place.sighted, place.consistent) == (stamp(1.87).measured_at, stamp(0.88).measured_at, True)
    assert place.d_body_pad_level == pytest.approx((0.5, -0.2, 2.0), abs=1e-3)
    assert all(0.05 < sigma_m < 0.1 for sigma_m in np.sqrt(place.cov.diagonal()[:3]))


def test_an_old_sighting_is_a_wide_one_on_every_path() -> None:
    memory = hovering()
    for fresh, late in zip(memory.all_at(MonoNs(10**9)), memory.all_at(MonoNs(3 * 10**9)), strict=True):
        assert np.trace(late.cov[:3, :3]) > 4 * np.trace(fresh.cov[:3, :3])


NOW = MonoNs(10**9)


def test_the_chosen_path_steers_and_the_others_run_beside_it() -> None:
    memory = hovering()
    first, second = memory.all_at(NOW)
    steering = memory.at(NOW)
    assert (steering.path, equal(steering, first), second.path) == ("dead_reckoning", True, "median_mean")
    assert {"range_agrees", "heading_off_rad"} <= dict(steering.details).keys()


def test_a_sighting_of_another_place_is_refused_before_every_path_once_the_pad_was_fused() -> None:
    elsewhere = seen_at(0.95, (9.0, 0.0, 2.0))
    memory = hovering()
    before = memory.all_at(NOW)
    (outcomes,) = memory.put([elsewhere])
    assert [o.verdict for o in outcomes] == [Verdict.ELSEWHERE] * 2
    assert all(equal(a, b) for a, b in zip(before, memory.all_at(NOW), strict=True))
    fresh, _ = feed(RelativeEstimator(STEERING, shadows=("median_mean",)), [e for i in range(200) for e in at_rest(i / 200)])
    (outcomes,) = fresh.put([seen_at(0.9, (0.5, -0.2, 2.0), confidence=0.0)])
    assert Verdict.FUSED not in {o.verdict for o in outcomes}
    (outcomes,) = fresh.put([elsewhere])
    assert outcomes[0].verdict is Verdict.FUSED, "what was refused is no place of the pad"


def test_a_pad_that_is_clearer_elsewhere_is_remembered_and_the_tracked_one_fused() -> None:
    memory, here, there = hovering(), (0.5, -0.2, 2.0), (0.5, 0.9, 2.0)
    for i in range(4):
        t_s = 0.91 + 0.01 * i
        results = memory.put_seen(seen_at(t_s, here, confidence=0.4), seen_at(t_s, there))
        assert [r.verdict for r in results] == [Verdict.FUSED] * 2
    (candidate,) = memory.guard.tracks.candidates
    assert (candidate.n, candidate.n_alone) == (4, 1), "beside the tracked pad it is never alone, and not adopted"
    view = memory.guard.view.core
    assert sum(view.bearings[i].level[1] < 0.0 for i in range(view.n)) == view.n > 4, "the view watch follows the tracked pad"
    estimate = memory.at(NOW)
    assert IntegrityAlert.ELSEWHERE in estimate.alerts
    assert not estimate.consistent


def test_a_tracked_pad_that_is_unsure_does_not_count_beside_a_clearer_one() -> None:
    memory = hovering()
    before = memory.all_at(NOW)
    results = memory.put_seen(seen_at(0.95, (0.5, -0.2, 2.0), confidence=0.1), seen_at(0.95, (0.5, 0.9, 2.0)))
    assert results[0].verdict is Verdict.ELSEWHERE
    assert all(equal(a, b) for a, b in zip(before, memory.all_at(NOW), strict=True))
    memory, expected = hovering(), hovering()
    near, far = seen_at(0.95, (0.5, -0.17, 2.0)), seen_at(0.95, (0.5, -0.2, 2.0), confidence=0.4)
    results = memory.put_seen(far, near)
    assert results[0].verdict is Verdict.FUSED
    expected.put([near])
    assert equal(memory.all_at(NOW)[0], expected.all_at(NOW)[0]), "what the guard does not call another pad counts: it is clearer"


def test_a_range_agrees_with_sightings_that_the_steering_path_has_fused() -> None:
    def agrees(range_m: float) -> float:
        memory = RelativeEstimator(STEERING)
        for i in range(240):
            memory, _ = feed(memory, [*at_rest(i / 200), Range(stamp(i / 200), range_m + 1e-3 * (i % 3), 0.02)])
            if i % 7 == 0 and i > 20:
                memory.put([seen_at(i / 200 - 0.1, (0.05, 0.0, 2.0))])
        state = memory.at(MonoNs(1_195_000_000))
        return dict(state.details)["range_agrees"]

    assert (agrees(2.0), agrees(5.0)) == (1.0, 0.0)


def test_what_the_steering_path_refuses_is_no_place_of_the_pad_to_the_guard() -> None:
    memory = RelativeEstimator(EstimatorOptions(path="ekf"))
    (outcomes,) = memory.put([seen_at(0.5, (0.5, -0.2, 2.0))])
    assert [o.verdict for o in outcomes] == [Verdict.NO_ATTITUDE]
    assert memory.guard.tracks.n == 0


def test_motion_and_forecast_are_those_of_the_path_that_steers() -> None:
    for path, shadow in (("ekf", "median_mean"), ("median_mean", "ekf")):
        memory = RelativeEstimator(EstimatorOptions(path=path), shadows=(shadow,))
        for i in range(200):
            memory, _ = feed(memory, at_rest(i / 200))
            if i % 7 == 0 and i > 20:
                memory.put([seen_at(i / 200 - 0.1, (0.5, -0.2, 2.0))])
        knows = path == "ekf"
        assert (memory.motion(NOW)[1] is not None, memory.forecast(NOW, [1.0]) is not None) == (knows, knows)


def test_the_largest_delay_and_the_least_confidence_are_allowed_themselves() -> None:
    at_bounds = Stamp(MonoNs(900_000_000), MonoNs(1_400_000_000), 0.001, "sim")
    assert at_bounds.delay_s == STEERING.max_delay_s
    seen = structs.replace(seen_at(0.9, (0.5, -0.2, 2.0), confidence=STEERING.min_confidence), stamp=at_bounds)
    memory, _ = feed(RelativeEstimator(STEERING), [event for i in range(200) for event in at_rest(i / 200)])
    assert memory.put([seen])[0][0].verdict is Verdict.FUSED
    late = structs.replace(at_bounds, received_at=MonoNs(1_400_000_001))
    assert memory.put([structs.replace(seen, stamp=late)])[0][0].verdict is Verdict.TOO_OLD


def test_dead_reckoning_remembers_its_way_for_as_long_as_a_frame_may_be_late() -> None:
    """A vehicle that flies forward at 1 m/s sees the pad 1.2 s late; it has flown 1.2 m since."""
    options = structs.replace(STEERING, max_delay_s=1.4, dead_reckoning=DeadReckoningOptions(history_s=0.2))
    memory = RelativeEstimator(options)
    for i in range(400):
        t = stamp(i / 200)
        velocity = BodyVelocity(t, np.array([1.0, 1e-3 * (i % 3), 0.0]), np.diag([0.01, 0.01, UNKNOWN_VAR]))
        memory, _ = feed(memory, [Attitude(t, Rotation.from_rpy(0.0, 1e-4 * (i % 3), 1.0), 1e-5 * np.eye(3)), velocity])
    (outcomes,) = memory.put([seen_at(0.8, (3.0, 0.0, 2.0), delay_s=1.2)])
    assert outcomes[0].verdict is Verdict.FUSED
    state = memory.at(MonoNs(2 * 10**9))
    assert math.isclose(state.d_body_pad_level[0], 1.8, abs_tol=0.05)


if TYPE_CHECKING:
    from estimator.constant_velocity import ConstantVelocityPath

COV = np.diag([4e-4, 4e-4, 9e-4, 1e-4])


def new() -> ConstantVelocityPath:
    from estimator.constant_velocity import ConstantVelocityPath  # with filterpy, which takes a second

    return ConstantVelocityPath(EstimatorOptions())


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
