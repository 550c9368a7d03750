"""A sighting against a belief made by hand: what is refused, believed, opened, overthrown and learned, each at its edge."""

import math
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import wrap_pi
from estimator.contracts.motion import G_M_S2
from estimator.core.abi import DL_WITH_COVARIANCE
from estimator.ekf.gate import nis_max
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.so3 import about_down
from estimator.ekf.state import (
    CAMERA_DELAY,
    CAMERA_MOUNT,
    PAD_YAW,
    POS_HORIZONTAL,
    POS_REL,
    TURN_RATE,
    VESSEL_VEL,
    WAVES,
    Belief,
    N,
    RejectionStreak,
    waves_unknown,
)  # fmt: skip
from tests.estimator.ekf.flown import fuse_sighting
from tests.estimator.ekf.hand import (
    MS,
    OPTIONS,
    TILTED,
    TOOLS,
    S,
    T,
    belief,
    correlated,
    diagonal,
    learned,
    sighting,
    state,
    under,
    whole,
)  # fmt: skip
from tests.estimator.ekf.oracle import gate, so3
from tests.estimator.ekf.oracle import sighting as models

# Refused or believed


def test_a_sighting_may_trust_itself_just_enough() -> None:
    b = belief(x=under(), P=diagonal(d=0.01))
    same, outcome = fuse_sighting(b, sighting((0.0, 0.0, 2.0), confidence=0.0499, t=T + MS), TOOLS)
    assert same.t == b.t
    np.testing.assert_array_equal(same.x, b.x)
    np.testing.assert_array_equal(same.P, b.P)
    assert outcome.verdict is Verdict.LOW_CONFIDENCE
    assert fuse_sighting(b, sighting((0.0, 0.0, 2.0), confidence=0.05), TOOLS)[1].verdict is Verdict.FUSED


def test_a_place_is_fused_by_how_sure_each_side_is() -> None:
    b = belief(x=under(), P=diagonal(d=0.03), agreed=10, nis_mean=1.2)
    after, outcome = fuse_sighting(b, sighting((0.1, -0.2, 2.1), var=0.01), TOOLS)
    assert outcome.verdict is Verdict.FUSED
    np.testing.assert_allclose(after.x[POS_REL], [0.075, -0.15, 2.075], atol=1e-5)
    np.testing.assert_allclose(after.P[POS_REL, POS_REL], np.eye(3) * 0.0075, atol=1e-5)
    assert outcome.nis == pytest.approx((0.01 + 0.04 + 0.01) / 0.04, rel=1e-4)
    assert outcome.innovation is not None
    assert outcome.innovation_cov is not None
    np.testing.assert_allclose(outcome.innovation, [0.1, -0.2, 0.1], atol=1e-9)
    np.testing.assert_allclose(outcome.innovation_cov, np.eye(3) * 0.04, atol=1e-5)
    assert (after.agreed, after.sighted) == (11, T)
    assert after.nis_mean == pytest.approx(gate.mean_of(1.2, outcome.innovation, outcome.innovation_cov))


@pytest.mark.parametrize(("var", "agreed"), [(0.0899, 11), (0.0901, 1)])
def test_a_belief_that_was_lost_begins_to_count_again(var: float, agreed: int) -> None:
    b = belief(x=under(), P=diagonal(d=var))
    assert fuse_sighting(b, sighting((0.1, 0.0, 2.0)), TOOLS)[0].agreed == agreed


def test_the_first_sighting_is_the_place_whatever_was_accepted() -> None:
    x = state()
    x[CAMERA_DELAY] = 0.0
    b = belief(TILTED, x=x, sighted=-1, agreed=0, heading_known=False, nis_mean=1.3, rejections=RejectionStreak(3, T, T))
    seen = np.array([1.5, 0.7, 3.0])
    after, outcome = fuse_sighting(b, sighting(seen, 0.3), TOOLS)
    assert outcome.verdict is Verdict.FUSED
    body = models.levelling(TILTED, TILTED).T @ seen
    np.testing.assert_allclose(after.x[POS_REL], TILTED @ so3.exp(b.x[CAMERA_MOUNT]) @ body, atol=0.02)
    assert (after.agreed, after.sighted, after.heading_known, after.rejections) == (1, T, True, RejectionStreak())
    assert after.nis_mean == 1.3, "it was compared with itself"
    assert after.P[VESSEL_VEL, VESSEL_VEL].max() < 0.01, "what a vessel told of itself before is kept"
    kept = [TURN_RATE, *WAVES[:3].ravel()]
    np.testing.assert_allclose(after.x[kept], x[kept], atol=0.05)


def test_a_sighting_that_is_off_along_the_deck_makes_no_heave() -> None:
    """A sway in phase with the heave once let the filter explain a wrong place along the deck by a rising one."""
    x, P, heave, t = under(), diagonal(d=0.01), WAVES[2], T + 50 * MS
    x[PAD_YAW + 1 :] = state()[PAD_YAW + 1 :]
    x[CAMERA_DELAY] = x[CAMERA_MOUNT] = 0.0
    P[np.ix_(heave, heave)] = waves_unknown(learned(heave_m_s=0.4))[2]
    b = belief(x=x, P=P, t_imu=T, f=(0.0, 0.0, -G_M_S2))
    ahead = PackedBelief.of(b).propagated(t, TOOLS, DL_WITH_COVARIANCE).belief
    after, outcome = fuse_sighting(b, sighting(ahead.x[POS_REL] + [0.1, -0.1, 0.0], t=t), TOOLS)
    assert outcome.verdict is Verdict.FUSED
    assert np.hypot(*(after.x - ahead.x)[POS_HORIZONTAL]) > 0.1
    np.testing.assert_allclose(after.x[heave], ahead.x[heave], atol=1e-4)


def test_a_pad_forgotten_for_half_a_minute_is_a_first_one_and_one_of_the_first_instant_is_not() -> None:
    far = sighting((3.0, 3.0, 4.0), t=T)
    for ago_s, first in ((29.9, False), (30.1, True)):
        after, outcome = fuse_sighting(belief(x=under(), P=diagonal(d=1e-4), sighted=T - round(ago_s * S)), far, TOOLS)
        assert (outcome.verdict is Verdict.FUSED) is first
        assert after.agreed == (1 if first else 10)
    t = 100 * MS
    b = belief(t=t, x=under(), P=diagonal(d=1e-4), sighted=0, sea=learned(t=t))
    assert fuse_sighting(b, sighting((3.0, 3.0, 4.0), t=t), TOOLS)[1].verdict is Verdict.GATED


def test_a_refused_one_is_remembered_by_where_it_showed_the_pad_and_how_well() -> None:
    x = state()
    x[CAMERA_DELAY] = 0.0
    b = belief(
        TILTED, x=x, P=1e-2 * correlated(), rejections=RejectionStreak(2, T - 200 * MS, T - 100 * MS, (9.0, 9.0, 9.0), 1e-4)
    )
    seen = replace(sighting((4.0, 1.0, 3.0)), cov=np.diag([0.01, 0.02, 0.06, 9.0]))
    after, outcome = fuse_sighting(b, seen, TOOLS)
    assert outcome.verdict is Verdict.GATED
    assert outcome.nis > nis_max(OPTIONS.gate_probability, 3)
    shown = TILTED @ so3.exp(x[CAMERA_MOUNT]) @ models.levelling(TILTED, TILTED).T @ seen.d_body_pad_level
    assert (after.rejections.n, after.rejections.since, after.rejections.last) == (1, T, T)
    np.testing.assert_allclose(after.rejections.offset_ned, shown - x[POS_REL], atol=1e-9)
    assert after.rejections.var_m2 == pytest.approx(0.03)
    assert (after.sighted, after.agreed) == (b.sighted, b.agreed)
    assert outcome.innovation is not None
    assert outcome.innovation_cov is not None
    assert outcome.nis == pytest.approx(float(outcome.innovation @ np.linalg.inv(outcome.innovation_cov) @ outcome.innovation))
    assert after.nis_mean == pytest.approx(gate.mean_of(b.nis_mean, outcome.innovation, outcome.innovation_cov))


def test_a_place_shown_often_enough_is_accepted_and_begins_with_a_clean_record() -> None:
    streak = RejectionStreak(4, T - 700 * MS, T - 50 * MS, (3.0, 0.0, 0.0), 1e-4)
    b = belief(x=under(), P=diagonal(d=0.01), rejections=streak, nis_mean=9.0)
    after, outcome = fuse_sighting(b, sighting((3.0, 0.0, 2.0)), TOOLS)
    assert outcome.verdict is Verdict.FUSED
    assert outcome.nis == pytest.approx(0.0, abs=1e-9)
    assert outcome.innovation_cov is not None
    assert outcome.innovation_cov[0, 0] > 100.0, "it is compared with a belief that knows nothing"
    np.testing.assert_allclose(
        np.diag(after.P[VESSEL_VEL, VESSEL_VEL]), 4.0, err_msg="another pad's vessel has a velocity of its own"
    )
    np.testing.assert_allclose(after.x[POS_REL], [3.0, 0.0, 2.0], atol=1e-6)
    assert (after.agreed, after.nis_mean, after.rejections, after.sighted) == (1, 1.0, RejectionStreak(), T)
    few = b._replace(rejections=streak._replace(n=3))
    assert fuse_sighting(few, sighting((3.0, 0.0, 2.0)), TOOLS)[1].verdict is Verdict.GATED


# How much of it corrects the camera


@pytest.mark.parametrize(("heave_m_s", "rough"), [(0.0, 0.0), (0.1, 0.5), (1.0, 1.0 / 1.01), (30.0, 1.0)])
def test_a_heaving_deck_teaches_the_camera_s_place_and_delay_by_a_share(heave_m_s: float, rough: float) -> None:
    P = correlated()
    P[CAMERA_DELAY, CAMERA_DELAY] += 1e-3
    x = state()
    seen = models.levelling(TILTED, TILTED) @ so3.exp(-x[CAMERA_MOUNT]) @ TILTED.T @ x[POS_REL] + np.array([0.02, -0.03, 0.01])
    full_after, after = (
        fuse_sighting(belief(TILTED, x=x, P=P, sea=learned(heave_m_s=rate)), sighting(seen), TOOLS)[0]
        for rate in (0.0, heave_m_s)
    )
    full, part = full_after.x - x, after.x - x
    assert np.linalg.norm(full[CAMERA_MOUNT]) > 1e-5
    assert abs(full[CAMERA_DELAY]) > 1e-5
    np.testing.assert_allclose(part[CAMERA_MOUNT], (1.0 - 0.95 * rough) * full[CAMERA_MOUNT], rtol=1e-3)
    assert part[CAMERA_DELAY] == pytest.approx((1.0 - 0.85 * rough) * full[CAMERA_DELAY], rel=1e-3)
    # The certainty that waves add is less than that of white noise: a correction by 0.15 would take 0.28 of the change.
    gained, whole = P[CAMERA_DELAY, CAMERA_DELAY] - np.array([p.P[CAMERA_DELAY, CAMERA_DELAY] for p in (after, full_after)])
    assert gained == pytest.approx((1.0 - (0.975 * rough) ** 2) * whole, rel=1e-3)
    assert np.linalg.eigvalsh(after.P).min() > -1e-9
    others = np.setdiff1d(np.arange(N), [CAMERA_DELAY, 43, 44, 45])
    np.testing.assert_allclose(part[others], full[others], atol=1e-12)


# The heading


def headed(wrong_by: float, **fields: Any) -> tuple[Belief, Belief, Outcome]:
    """Return a sighting with the right place and this error of heading; the state before, the truth, the result."""
    b = belief(x=under(), P=diagonal(d=0.01, head=0.01), **fields)
    return b, *fuse_sighting(b, sighting((0.1, 0.0, 2.0), wrong_by), TOOLS)


def test_a_heading_that_agrees_is_held_for_longer_by_the_time_since_the_last() -> None:
    for since_s, gained in ((0.1, 0.1), (0.5, 0.5), (2.0, 0.5)):
        b, after, outcome = headed(0.05, heading_held_s=3.0, heading_seen=T - round(since_s * S))
        assert outcome.verdict is Verdict.FUSED
        assert after.heading_held_s == pytest.approx(3.0 + gained)
        assert after.heading_seen == T
    assert headed(0.05, heading_held_s=3.0, heading_seen=-1)[1].heading_held_s == 3.0, "there was no last"
    assert headed(0.05, heading_held_s=9.9, heading_seen=T - 400 * MS)[1].heading_held_s == OPTIONS.heading_memory_s
    t = 300 * MS
    b = belief(t=t, x=under(), P=diagonal(d=0.01, head=0.01), heading_held_s=3.0, heading_seen=0, sea=learned(t=t))
    assert fuse_sighting(b, sighting((0.0, 0.0, 2.0), 0.0, t=t), TOOLS)[0].heading_held_s == pytest.approx(3.3)


def test_a_sighting_that_reports_no_heading_neither_agrees_with_it_nor_contradicts_it() -> None:
    b = belief(x=under(), P=diagonal(d=0.01, head=0.01), heading_held_s=3.0, heading_seen=T - 100 * MS)
    after, outcome = fuse_sighting(b, sighting((0.0, 0.0, 2.0)), TOOLS)
    assert outcome.verdict is Verdict.FUSED
    assert (after.heading_held_s, after.heading_seen) == (3.0, T - 100 * MS)


def test_a_heading_that_is_contradicted_is_held_as_long_as_it_was_agreed_with_and_the_place_is_fused() -> None:
    b, after, outcome = headed(3.0, heading_held_s=0.5, heading_seen=T - 100 * MS)
    assert outcome.verdict is Verdict.FUSED
    assert outcome.innovation is not None
    assert len(outcome.innovation) == 3, "of its place alone"
    assert after.heading_held_s == pytest.approx(0.4)
    assert after.x[PAD_YAW] == pytest.approx(0.0, abs=1e-6)
    assert after.P[PAD_YAW, PAD_YAW] == pytest.approx(b.P[PAD_YAW, PAD_YAW], rel=1e-3)
    assert after.nis_mean == pytest.approx(gate.mean_of(b.nis_mean, outcome.innovation, outcome.innovation_cov))
    assert outcome.nis == pytest.approx(0.01 / 0.0101, rel=1e-3)


@pytest.mark.parametrize("held_s", [0.05, 0.0])
def test_a_heading_contradicted_for_too_long_gives_way(held_s: float) -> None:
    seen_at = T - 100 * MS if held_s else -1
    b, after, outcome = headed(3.0, heading_held_s=held_s, heading_seen=seen_at)
    assert outcome.verdict is Verdict.FUSED
    assert outcome.innovation is not None
    assert len(outcome.innovation) == 4
    np.testing.assert_allclose(outcome.innovation, [0.1, 0.0, 0.0, 0.0], atol=1e-9)
    assert wrap_pi(float(after.x[PAD_YAW]) + 3.0) == pytest.approx(0.0, abs=1e-6)
    assert after.P[PAD_YAW, PAD_YAW] == pytest.approx(1e-3, rel=0.01)
    assert after.heading_held_s == 0.0
    assert after.nis_mean == pytest.approx(gate.mean_of(b.nis_mean, outcome.innovation, np.eye(4) * 0.0101), rel=1e-3)
    assert after.agreed == 11, "the place was never in doubt"


def test_a_place_that_does_not_fit_either_is_no_word_about_the_heading() -> None:
    b = belief(x=under(), P=diagonal(d=0.01, head=0.01), heading_held_s=3.0, heading_seen=T - 100 * MS)
    after, outcome = fuse_sighting(b, sighting((2.0, 0.0, 2.0), 3.0), TOOLS)
    assert outcome.verdict is Verdict.GATED
    assert outcome.innovation is not None
    assert len(outcome.innovation) == 4
    assert after.rejections.n == 1
    assert after.heading_held_s == pytest.approx(3.0)


def test_the_place_is_held_to_the_gate_of_three_numbers() -> None:
    """A place at 22: more than an honest one of three numbers may be, less than one of four."""
    b = belief(x=under(), P=diagonal(d=0.01, head=0.01), heading_held_s=3.0, heading_seen=T - 100 * MS)
    for nis, verdict in ((20.5, Verdict.FUSED), (22.0, Verdict.GATED)):
        off = math.sqrt(nis * (0.01 + 1e-4))
        assert fuse_sighting(b, sighting((off, 0.0, 2.0), 3.0), TOOLS)[1].verdict is verdict
        assert fuse_sighting(b, sighting((off, 0.0, 2.0)), TOOLS)[1].verdict is verdict
    after, _ = fuse_sighting(b, sighting((off, 0.0, 2.0), 3.0), TOOLS)
    assert after.heading_held_s == 3.0, "of a place not believed the heading says nothing"
    assert fuse_sighting(b, sighting((off, 0.0, 2.0), 0.0), TOOLS)[1].verdict is Verdict.FUSED


def test_a_heading_never_known_cannot_be_contradicted() -> None:
    b = belief(x=under(), P=diagonal(d=0.01, head=0.01), heading_known=False, heading_held_s=3.0)
    after, outcome = fuse_sighting(b, sighting((0.0, 0.0, 2.0), 3.0), TOOLS)
    assert outcome.verdict is Verdict.GATED
    assert outcome.innovation is not None
    assert len(outcome.innovation) == 4
    assert not after.heading_known


def test_a_heading_is_known_once_a_sighting_reports_it_without_an_either_or() -> None:
    turned = about_down(0.0)
    for seen, known in (
        (sighting((0.0, 0.0, 2.0), 0.0), True),
        (sighting((0.0, 0.0, 2.0)), False),
        (sighting((0.0, 0.0, 2.0), 0.0, ambiguous=True), False),
        (sighting((0.0, 0.0, 2.0), 0.0, pose6=whole((0.0, 0.0, 2.0), turned)), True),
        (sighting((0.0, 0.0, 2.0), 0.0, ambiguous=True, pose6=whole((0.0, 0.0, 2.0), turned)), False),
    ):
        b = belief(x=under(), P=diagonal(d=0.01, head=0.5), heading_known=False)
        after, outcome = fuse_sighting(b, seen, TOOLS)
        assert outcome.verdict is Verdict.FUSED
        assert after.heading_known is known
        assert fuse_sighting(b._replace(heading_known=True), seen, TOOLS)[0].heading_known


@pytest.mark.parametrize(("sigma", "used"), [(0.49, True), (0.51, False)])
def test_an_either_or_heading_is_of_use_where_the_heading_is_accepted_well_enough(sigma: float, used: bool) -> None:
    for known in (True, False):
        b = belief(x=under(), P=diagonal(d=0.01, head=sigma**2), heading_known=known)
        _, outcome = fuse_sighting(b, sighting((0.0, 0.0, 2.0), 0.1, ambiguous=True), TOOLS)
        assert outcome.innovation is not None
        assert len(outcome.innovation) == (4 if used and known else 3)
