"""The native core processes the vehicle's samples as the numpy oracle does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range
from estimator.ekf import state as names
from estimator.ekf.params import FilterParams
from estimator.ekf.state import PAD_YAW, POS_REL, N
from tests.estimator.ekf import flown
from tests.estimator.ekf.belief import Aid, Belief, DeckMotionBank, Outcome, process_event
from tests.estimator.ekf.hand import MS, TILTED, TOOLS, T, belief, correlated, learned, params, stamp, state
from tests.estimator.ekf.oracle import aiding, motion
from tests.estimator.ekf.oracle.algebra import ALGEBRA
from tests.estimator.ekf.oracle.propagate import propagated, ready_to_fuse
from tests.estimator.ekf.oracle.samples import Sample, process_sample
from tests.support.estimator_truth import Setting, TruthFlight, events

EITHER = params(velocity_is_over="either", deck_radius_m=3.0)
OVER_PAD = params(velocity_is_over="pad", aiding_period_s=0.02, hold_s=0.02)
FORGETFUL = params(velocity_is_over="ground", forget_s=0.5, accel_step_m_s2=1.0, gyro_step_rad_s=0.1)
ALL = (TOOLS, EITHER, OVER_PAD, FORGETFUL)


def close(ours: object, oracle: object, what: str, scale: float = 1.0) -> None:
    """Assert that two values agree to 1e-9 of the larger of their size and `scale`."""
    if oracle is None or ours is None:
        assert ours is oracle, what
        return
    a, b = np.asarray(ours, dtype=float), np.asarray(oracle, dtype=float)
    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * scale, err_msg=what)


def same(ours: Belief, oracle: Belief) -> None:
    for name in Belief._fields:
        one, two = getattr(ours, name), getattr(oracle, name)
        if name == "P":
            sigma = np.sqrt(np.maximum(np.abs(two.diagonal()), 1e-12))
            close(one / sigma / sigma[:, None], two / sigma / sigma[:, None], name)
        elif name == "aids":
            for kind in range(4):
                same_aid(one[kind], two[kind])
        elif name == "sea":
            same_sea(one, two)
        elif name == "rejections":
            assert one[:3] == two[:3]
            close((*one.offset_ned, one.var_m2), (*two.offset_ned, two.var_m2), name)
        elif name == "excesses":
            assert one.t == two.t
            close(one.values, two.values, name)
        else:
            close(one, two, name)


def same_sea(ours: DeckMotionBank, oracle: DeckMotionBank) -> None:
    if ours is oracle:
        return
    assert ours.t == oracle.t
    for name in ("log_weight", "x", "weight", "w_rad_s", "zeta", "sigma"):
        close(getattr(ours, name), getattr(oracle, name), name)
    spread = np.sqrt(np.abs(np.diagonal(oracle.P, axis1=2, axis2=3))) + 1e-12
    scale = spread[..., :, None] * spread[..., None, :]
    close(ours.P / scale, oracle.P / scale, "the members' P", scale=10.0)
    known, expected = ours.skill, oracle.skill
    assert [one.t for one in known.issued] == [one.t for one in expected.issued]
    for one, two in zip(known.issued, expected.issued, strict=True):
        close(one.waves, two.waves, "issued")
    for name in ("n", "product", "square", "came"):
        close(getattr(known, name), getattr(expected, name), name)


def same_aid(ours: Aid, oracle: Aid) -> None:
    assert (ours.fused, ours.refused) == (oracle.fused, oracle.refused)
    one, two = ours.gathered, oracle.gathered
    assert (one is None) is (two is None)
    if one is not None and two is not None:
        assert (one.n, one.since, one.axes) == (two.n, two.since, two.axes)
        for name in ("deck_weight", "H", "spread", "innov", "R"):
            close(getattr(one, name), getattr(two, name), name)
        close(one.ambiguity, np.broadcast_to(two.ambiguity, one.R.shape), "ambiguity")


def same_outcome(ours: Outcome, oracle: Outcome) -> None:
    assert (ours.verdict, ours.axes) == (oracle.verdict, oracle.axes)
    for name in ("innovation", "innovation_cov", "nis", "nis_max"):
        close(getattr(ours, name), getattr(oracle, name), name)


def sample(rng: np.random.Generator, t: int, wild: float) -> Sample:
    """Return a sample of any kind at an instant; the larger `wild`, the more of them no filter should believe."""
    far = rng.random() < wild
    kind = rng.integers(8)
    size = 30.0 if far else 1.0
    if kind < 3:
        return Imu(stamp(t), 0.1 * size * rng.normal(size=3), np.array([0.0, 0.0, -9.8]) + 0.3 * size * rng.normal(size=3))
    if kind == 3:
        turn = Rotation.from_rpy(*(np.array([0.1, -0.15, 0.8]) + 0.02 * size * rng.normal(size=3)))
        return Attitude(stamp(t), turn, np.diag(rng.uniform(1e-5, 1e-3, 3)))
    if kind < 6:
        var = rng.uniform(1e-4, 1e-2, 3)
        var[rng.random(3) < 0.3] = 1e6
        return BodyVelocity(stamp(t), 0.2 * size * rng.normal(size=3), np.diag(var))
    if kind == 6:
        return Range(stamp(t), abs(2.6 + 0.1 * size * rng.normal()), 0.05)
    return Baro(stamp(t), 2.6 + 0.1 * size * rng.normal(), 0.1)


def row(seed: int, n: int, wild: float, gap_ms: float) -> list[Sample]:
    rng = np.random.default_rng(seed)
    gaps = rng.exponential(gap_ms * 1e6, n) * (rng.random(n) < 0.9)
    instants = T + np.cumsum(gaps).astype(int)
    return [sample(rng, t, wild) for t in instants.tolist()]


def beginning(seed: int) -> Belief:
    rng = np.random.default_rng(seed)
    sighted = -1 if rng.random() < 0.2 else T - 20 * MS
    return belief(
        TILTED, x=0.3 * state(seed) + _over_the_pad(), P=correlated(seed, size=float(rng.uniform(0.1, 5.0))),
        sighted=sighted, over_pad=float(rng.uniform(-5.0, 5.0)), t_imu=int(rng.choice([-1, T - 5 * MS])),
        w=(0.01, 0.02, -0.03), w_smooth=(0.0, 0.01, 0.0), f=(0.1, -0.2, -9.7), agreed=5,
        sea=learned(heave_m_s=0.4),
    )  # fmt: skip


def _over_the_pad() -> F64:
    x = np.zeros(N)
    x[POS_REL] = 0.1, -0.1, 2.0
    x[names.VEL_SCALE] = 0.7
    return x


@given(st.integers(0, 2**31), st.sampled_from(ALL), st.sampled_from([0.0, 0.2, 1.0]), st.sampled_from([1.0, 5.0, 60.0]))
@settings(max_examples=40)
def test_each_sample_has_the_oracle_s_outcome_and_belief(seed: int, chosen: FilterParams, wild: float, gap_ms: float) -> None:
    oracle = beginning(seed)
    for one in row(seed, 20, wild, gap_ms):
        ours, outcome = process_event(oracle, one, chosen)
        assert ours is not None
        if isinstance(one, Attitude) and outcome.innovation is None:
            return
        oracle, expected = process_sample(oracle, one, chosen)
        same_outcome(outcome, expected)
        same(ours, oracle)


@pytest.mark.parametrize("kind", range(4))
def test_a_sensor_that_contradicts_for_a_second_is_accepted_at_the_price_of_what_it_contradicts(kind: int) -> None:
    rng = np.random.default_rng(kind)
    oracle = belief(TILTED, x=0.3 * state() + _over_the_pad())
    refused = 0
    for k in range(110):
        t = T + 20 * MS * k
        turn = Rotation.from_rpy(0.1, -0.15, 1.0)
        wrong: Sample = (
            Attitude(stamp(t), turn, 1e-6 * np.eye(3)),
            BodyVelocity(stamp(t), np.array([9.0, -8.0, 0.0]) + 0.01 * rng.normal(size=3), np.diag([1e-4, 1e-4, 1e6])),
            Range(stamp(t), 9.0, 0.01),
            Baro(stamp(t), -70.0, 0.01),
        )[kind]
        if k % 2 == 0:
            wrong = Imu(stamp(t), np.zeros(3), np.array([0.0, 0.0, -9.8]))
        after, outcome = process_event(oracle, wrong, TOOLS)
        assert after is not None
        oracle, expected = process_sample(oracle, wrong, TOOLS)
        same_outcome(outcome, expected)
        same(after, oracle)
        refused += outcome.verdict is Verdict.GATED
    assert refused >= 20


@given(st.integers(0, 2**31), st.integers(0, 200))
@settings(max_examples=30)
def test_what_is_gathered_is_fused_before_a_sighting_as_the_oracle_does(seed: int, wait_ms: int) -> None:
    b = beginning(seed)
    for one in row(seed, 8, 0.0, 2.0):
        b, _ = process_sample(b, one, EITHER)
    t = b.t + wait_ms * MS
    expected = aiding.aided(motion.propagate_covariance(propagated(b, t, EITHER), EITHER, ALGEBRA), EITHER)
    same(ready_to_fuse(b, t, EITHER), expected)


@given(st.integers(0, 2**31), st.integers(1, 400))
@settings(max_examples=30)
def test_transition_and_noise_are_the_oracle_s(seed: int, since_ms: int) -> None:
    b = beginning(seed)._replace(
        jolt_var_m2_s2=0.3, jolt_var_rad2=0.01, turned=np.eye(3) * 0.02, dv=(0.1, 0.2, 0.3), dp=(0.01, 0.0, 0.1)
    )
    b = b._replace(t=T + since_ms * MS, coast_s=0.01)
    after, F, Q = flown.settled(b, TOOLS)
    expected, F_oracle, Q_oracle = motion.moved(b, TOOLS)
    same(after, expected)
    close(F, F_oracle, "F")
    close(Q, Q_oracle, "Q", scale=1e-3)


def test_samples_of_a_flight_over_a_rough_sea() -> None:
    b: Belief | None = None
    compared = 0
    flight = TruthFlight(Setting(seed=4, sea=4, duration_s=2.5, range_hz=20.0, baro_hz=10.0, imu_hz=100.0))
    for event in sorted(events(flight), key=_instant):
        before = b
        b, outcome = process_event(b, event, TOOLS)
        if before is not None and b is not None and isinstance(event, Sample) and before.heading_is_given:
            expected, expected_outcome = process_sample(before, event, TOOLS)
            same_outcome(outcome, expected_outcome)
            same(b, expected)
            compared += 1
    assert compared > 300
    assert b is not None
    assert abs(float(b.x[PAD_YAW])) < 4.0


def _instant(event: object) -> int:
    return int(event.stamp.measured_at)  # type: ignore[attr-defined]
