"""The native core processes sightings and vessel reports, and learns the sea, as the numpy oracle does."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from estimator.contracts.estimates import Pose6, Sighting, Verdict
from estimator.contracts.geometry import F64, Rotation
from estimator.contracts.samples import VesselReport
from estimator.ekf import Event, deck_motion_bank
from estimator.ekf.params import FilterParams
from estimator.ekf.state import CAMERA_DELAY, CAMERA_MOUNT, PAD_YAW, POS_REL
from tests.estimator.ekf import flown
from tests.estimator.ekf.belief import Belief, DeckMotionBank, InnovationExcesses, RejectionStreak, process_event, unknown
from tests.estimator.ekf.hand import MS, TOOLS, T, params, stamp
from tests.estimator.ekf.oracle import bank as oracle_bank
from tests.estimator.ekf.oracle import sighting as models
from tests.estimator.ekf.oracle import so3
from tests.estimator.ekf.oracle.bank import pairs_of
from tests.estimator.ekf.oracle.samples import Sample, process_sample
from tests.estimator.ekf.oracle.sighting import deck, levelling
from tests.estimator.ekf.oracle.so3 import about_down, heading
from tests.estimator.ekf.oracle.vessel_update import fuse_vessel
from tests.estimator.ekf.oracle.vision_update import fuse_sighting
from tests.estimator.ekf.test_core import beginning, close, same, same_outcome, same_sea
from tests.support.estimator_truth import Setting, TruthFlight, events

EXACT = params(sighting_has_attitude_error=False, min_confidence=0.5)
EASILY_RESET = params(reopen_count=2, reopen_s=0.01, gate_probability=0.01, heading_memory_s=0.3)
TURNED_PAD = params(pad_yaw_in_vessel_rad=1.2)
ALL = (TOOLS, EXACT, EASILY_RESET, TURNED_PAD)


def learned_sea(seed: int, looks: int, t: int) -> DeckMotionBank:
    """Return a bank after some looks at some sea, the newest a while before `t`."""
    rng = np.random.default_rng(seed)
    sea = unknown()
    t -= int(rng.integers(0, 400)) * MS
    for k in range(looks):
        y = rng.normal(size=5) * [0.3, 0.3, 0.5, 0.05, 0.05]
        var = np.where(rng.random(5) < 0.2, 1e6, 1e-4 * rng.uniform(0.5, 5.0, 5))
        sea = flown.observe(sea, t - (looks - k) * 210 * MS, y, var, TOOLS, 2.0)
    return sea


def sighted_belief(seed: int) -> Belief:
    """Return a belief about a pad with a history of any kind."""
    rng = np.random.default_rng(seed + 7)
    b = beginning(seed)
    n = int(rng.integers(0, 7))
    excesses = InnovationExcesses(
        tuple(T - (n - k) * 60 * MS for k in range(n)),
        tuple((*(rng.uniform(-2.5, 6.5, 3) * 1e-3).tolist(), *rng.normal(0.0, 6.0, 3).tolist()) for _ in range(n)),
    )
    streak = RejectionStreak(int(rng.integers(0, 6)), T - 800 * MS, T - 60 * MS, (*rng.normal(size=3).tolist(),), 1e-4)
    sea = learned_sea(seed, int(rng.integers(0, 4)), T)
    return b._replace(
        sea=sea, excesses=excesses, rejections=streak if streak.n else RejectionStreak(), agreed=int(rng.integers(0, 8)),
        heading_known=bool(rng.random() < 0.8), heading_held_s=float(rng.uniform(-0.1, 0.4)),
        nis_mean=float(rng.uniform(0.5, 3.0)), nis_claimed=float(rng.uniform(0.1, 1.2)),
        heading_seen=int(rng.choice([-1, T - 100 * MS])),
        steered=int(rng.choice([-1, T - 300 * MS, T - 600 * MS])),
        swung=int(rng.choice([-1, T - 300 * MS, T - 1600 * MS])), vessel_before=rng.normal(size=2),
        ins_var_m2_s2=float(rng.choice([0.0, 0.05])),
        levelled_by=None if rng.random() < 0.1 else b.R @ so3.exp(0.02 * rng.normal(size=3)),
        cov_levelled_by=np.diag(rng.choice([0.0, 1e-5, 1e-3, 0.1]) * rng.uniform(0.5, 2.0, 3)),
        ins_p=rng.normal(size=3), ins_v=rng.normal(size=3),
    )  # fmt: skip


def look(rng: np.random.Generator, b: Belief, t: int) -> Sighting:
    """Return a sighting of any kind: of about where the pad is believed, beside it, or with its heading turned round."""
    A = levelling(b.R, b.levelled_by)
    d = A @ so3.exp(-b.x[CAMERA_MOUNT]) @ b.R.T @ b.x[POS_REL] + rng.choice([0.005, 0.3, 3.0], p=[0.6, 0.2, 0.2]) * rng.normal(
        size=3
    )
    M = A @ so3.exp(-b.x[CAMERA_MOUNT]) @ b.R.T @ deck(b.x).R
    turned = about_down(rng.choice([0.0, math.pi, 2.0], p=[0.6, 0.3, 0.1])) @ so3.exp(0.02 * rng.normal(size=3))
    seen = M @ turned
    spread = rng.normal(size=(6, 6)) * 0.3 + np.eye(6)
    cov6 = spread @ np.diag(rng.choice([1e-4, 1e-3]) * rng.uniform(0.5, 2.0, 6)) @ spread.T
    cov = cov6[:4, :4].copy()
    yaw = None if rng.random() < 0.2 else -heading(seen)
    if yaw is None:
        cov[3] = cov[:, 3] = 0.0
        cov[3, 3] = math.pi**2 / 3.0
    whole = Pose6(d, Rotation(seen), cov6) if rng.random() < 0.4 else None
    confidence = float(rng.choice([1.0, 0.3, 0.01], p=[0.8, 0.15, 0.05]))
    at = replace(stamp(t), sigma_s=float(rng.choice([0.0, 0.01])))
    return Sighting(at, int(t % 1000), "selected", d, yaw, bool(rng.random() < 0.3), cov, confidence, whole)


def expected(b: Belief, event: Event, chosen: FilterParams) -> tuple[Belief, Any]:
    if isinstance(event, Sighting):
        return fuse_sighting(b, event, chosen)
    if isinstance(event, VesselReport):
        return fuse_vessel(b, event, chosen)
    return process_sample(b, event, chosen)


def agrees(b: Belief, event: Event, chosen: FilterParams) -> tuple[Belief, Verdict]:
    """Process an event in both ways; return the oracle's belief."""
    ours, outcome = process_event(b, event, chosen)
    assert ours is not None
    oracle, oracle_outcome = expected(b, event, chosen)
    same_outcome(outcome, oracle_outcome)
    same(ours, oracle)
    return oracle, outcome.verdict


@given(st.integers(0, 2**31), st.sampled_from(ALL))
@settings(max_examples=30)
def test_each_sighting_has_the_oracle_s_outcome_and_belief(seed: int, chosen: FilterParams) -> None:
    rng = np.random.default_rng(seed)
    b, t = sighted_belief(seed), T
    for _ in range(4):
        t += int(rng.choice([0, 33, 200])) * MS
        b, _ = agrees(b, look(rng, b, t), chosen)


def test_the_sightings_above_are_fused_refused_reset_to_and_weighed_by_their_headings() -> None:
    fused = refused = reset = placed = jolted = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        b = sighted_belief(seed)
        seen = look(rng, b, T)
        after, outcome = flown.fuse_sighting(b, seen, TOOLS)
        fused += outcome.verdict is Verdict.FUSED
        refused += outcome.verdict is Verdict.GATED
        reset += outcome.verdict is Verdict.FUSED and b.sighted >= 0 and after.agreed == 1
        placed += outcome.innovation is not None and len(outcome.innovation) == 3 and seen.pose6 is not None
        jolted += len(b.excesses.t) >= 3 and not after.excesses.t
    assert min(fused, refused, reset, placed, jolted) >= 2, (fused, refused, reset, placed, jolted)


@given(st.integers(0, 2**31), st.sampled_from(ALL))
@settings(max_examples=20, deadline=None)
def test_a_pad_that_has_moved_is_accepted_when_the_oracle_does(seed: int, chosen: FilterParams) -> None:
    rng = np.random.default_rng(seed)
    b = sighted_belief(seed)._replace(sighted=T - 20 * MS, agreed=int(rng.integers(0, 9)), rejections=RejectionStreak())
    moved, verdicts = look(rng, b, T), []
    moved = replace(moved, d_body_pad_level=moved.d_body_pad_level + 9.0, pose6=None, confidence=1.0)
    for k in range(8):
        at = replace(stamp(T + 120 * k * MS), sigma_s=0.0)
        b, verdict = agrees(b, replace(moved, stamp=at), chosen)
        verdicts.append(verdict)
    assert Verdict.FUSED in verdicts
    assert b.sighted > T - 20 * MS


def report(rng: np.random.Generator, t: int) -> VesselReport:
    v, cov = (None, None) if rng.random() < 0.3 else (rng.normal(size=3), np.diag(rng.uniform(1e-3, 1e-1, 3)))
    heading, sigma = (None, None) if rng.random() < 0.3 else (float(rng.uniform(-3.0, 6.0)), 0.05)
    return VesselReport(stamp(t), v, cov, heading, sigma)


@given(st.integers(0, 2**31), st.sampled_from(ALL))
@settings(max_examples=40)
def test_each_report_of_a_vessel_has_the_oracle_s_outcome_and_belief(seed: int, chosen: FilterParams) -> None:
    rng = np.random.default_rng(seed)
    b = sighted_belief(seed)
    for k in range(3):
        b, _ = agrees(b, report(rng, T + k * 40 * MS), chosen)


@given(st.integers(0, 2**31), st.sampled_from([1e-6, 1e-4, 1e-2, 1.0]), st.booleans())
@settings(max_examples=60)
def test_the_model_of_a_sighting_is_the_oracle_s(seed: int, attitude_var: float, place_only: bool) -> None:
    """Whatever part of its covariance comes from the attitude: all of it, some of it in some direction, or more than there is."""
    rng = np.random.default_rng(seed)
    b = sighted_belief(seed)
    seen = look(rng, b, T)
    cov = attitude_var * np.diag(rng.uniform(0.1, 2.0, 3))
    arguments = b.x, b.R, b.w, seen, b.levelled_by, cov, float(rng.uniform(0.1, 1.0))
    more = {"place_only": place_only, "rate_var": float(rng.uniform(0.0, 1.0))}
    ours, oracle = (model(*arguments, **more) for model in (flown.sighting, models.sighting))
    for name in ("innov", "H", "R", "G"):
        close(getattr(ours, name), getattr(oracle, name), name)


@pytest.mark.parametrize("seed", range(6))
def test_the_bank_learns_what_the_oracle_s_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ours, oracle = unknown(), oracle_bank.unknown()
    same_sea(ours, oracle)
    t, noise = T, TOOLS
    w, by = rng.uniform(0.5, 2.0, 5), noise.carrying
    for k in range(40):
        t += int(rng.choice([0, 180, 200, 350, 3000], p=[0.05, 0.3, 0.4, 0.2, 0.05])) * MS
        y = np.sin(w * (t - T) * 1e-9) * [0.3, 0.2, 0.6, 0.1, 0.05] + 0.01 * rng.normal(size=5) + [3.0, -2.0, 5.0, 0.0, 0.0]
        var = np.where(rng.random(5) < (0.0, 0.3)[seed % 2], 1e6, 1e-4)
        ins_var = float(rng.choice([0.0, 0.01])) if 0 <= ours.t < t else 0.0
        widened = by
        if ins_var > 0.0:
            psd = ins_var / ((t - ours.t) * 1e-9)
            widened = by._replace(asd_accel=np.sqrt(by.asd_accel**2 + psd * deck_motion_bank.CARRIED))
        ours = flown.observe(ours, t, y, var, noise, 2.5, ins_var)
        oracle = oracle_bank.observe(oracle, t, y, var, widened, 2.5)
        if k % 8 == 7:
            same_sea(ours, oracle)


def test_the_sightings_of_a_flight_over_a_rough_sea() -> None:
    b: Belief | None = None
    sightings = samples = 0
    flight = TruthFlight(Setting(seed=4, sea=4, duration_s=3.0, pose6=True, range_hz=20.0, imu_hz=100.0, outliers=0.05))
    for event in sorted(events(flight), key=lambda one: one.stamp.measured_at):
        if b is not None and isinstance(event, Sighting):
            b, _ = agrees(b, event, TOOLS)
            sightings += 1
        else:
            b, _ = process_event(b, event, TOOLS)
            samples += isinstance(event, Sample)
    assert sightings > 50
    assert samples > 300
    assert b is not None
    assert abs(float(b.x[PAD_YAW])) < 4.0
    assert abs(float(b.x[CAMERA_DELAY])) < 0.1
    assert b.sea.t > 0


def test_the_triangles_of_the_members_covariances_are_whole_again() -> None:
    rng = np.random.default_rng(0)
    P: F64 = rng.normal(size=(5, 136, 7, 7))
    P = P + P.transpose(0, 1, 3, 2)
    bank = unknown()._replace(pairs=pairs_of(P))
    np.testing.assert_array_equal(bank.P, P)
