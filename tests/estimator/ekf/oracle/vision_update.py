"""The vision update in numpy: gate a sighting, reset the filter after a streak of rejections, fuse, and feed the wave bank."""

import math

import numpy as np

from estimator.contracts.estimates import Sighting, Verdict
from estimator.contracts.geometry import F64, wrap_pi
from estimator.ekf.deck_motion_bank import CARRIED
from estimator.ekf.options import EkfOptions
from estimator.ekf.params import FilterParams, nis_max
from estimator.ekf.state import (
    CAMERA_DELAY,
    CAMERA_MOUNT,
    PAD_YAW,
    POS_AXES,
    POS_REL,
    TURN_RATE,
    VEL,
    VESSEL_VEL,
    WAVE_YAW,
    WAVES,
    YAW_RATE,
    N,
)
from tests.estimator.ekf.belief import Belief, InnovationExcesses, Outcome, RejectionStreak, waves_unknown
from tests.estimator.ekf.oracle import algebra, bank, deck_jolt, gate, sighting, so3
from tests.estimator.ekf.oracle.algebra import Correction
from tests.estimator.ekf.oracle.propagate import corrected, forgotten, partial, ready_to_fuse
from tests.estimator.ekf.oracle.so3 import heading

_WITHHELD_MOUNT = 0.95
"""Fraction of the correction of the camera's mounting that is withheld on a rough sea, and of the covariance's root with it."""
_WITHHELD_DELAY = 0.85
"""Fraction of the correction of the camera's delay that is withheld on a rough sea."""
_WITHHELD_DELAY_COV = 0.975
"""Fraction of the reduction of the covariance's root that is withheld.

On waves the errors of ten sightings in a row are alike.
"""
_ROUGH_M_S = 0.1
"""Heave rate of the deck, m/s, separating a rough sea from a calm one: far below it, no part of the correction is withheld."""
_RATE_KNOWN_VAR = 0.35**2
"""Variance of the rate of what a sighting measures, (m/s)^2, above which the camera's delay is not corrected."""


def fuse_sighting(b: Belief, event: Sighting, params: FilterParams) -> tuple[Belief, Outcome]:
    """Return the belief after one sighting, which must not be older than the belief, and the sighting's result."""
    o, t = params.options, event.stamp.measured_at
    if event.confidence < o.min_confidence:
        return b, Outcome(Verdict.LOW_CONFIDENCE)
    b = forgotten(ready_to_fuse(b, t, params), o)
    fresh = b.sighted < 0
    if fresh:
        b = _initialized(b, event, o, reset=False)
    row, fix = _compared(b, event, params)
    if fix is None:
        return b, Outcome(Verdict.SINGULAR, row.innov)
    if not fresh:
        b, row, fix = _jolted(b, event, row, fix, params)
    dof = row.innov.size
    nis = fix.nis
    turned_round = False
    if dof > 3 and b.heading_known and nis > nis_max(o.gate_probability, dof):
        place, by_place = _compared(b, event, params, place_only=True)
        if by_place is not None and by_place.nis <= nis_max(o.gate_probability, 3):
            turned_round = True
            row, fix, nis, dof = place, by_place, by_place.nis, 3
    if turned_round or (dof > 3 and nis <= nis_max(o.gate_probability, dof)):
        b = _heading_weighed(b, event, o, agrees=not turned_round)
        if turned_round and b.heading_held_s <= 0.0:
            b = _with_new_heading(b, event)
            row, fix = _compared(b, event, params)
            if fix is None:
                return b, Outcome(Verdict.SINGULAR, row.innov)
            nis, dof = fix.nis, row.innov.size
    if not fresh:
        b = b._replace(nis_mean=gate.mean_of(b.nis_mean, row.innov, fix.S))
    if nis > nis_max(o.gate_probability, dof):
        offset = b.R.dot(so3.exp(b.x[CAMERA_MOUNT]).dot(row.innov[:3]))
        streak = gate.extended(b.rejections, t, offset, float(np.trace(row.R[:3, :3])) / 3.0)
        b = b._replace(rejections=streak)
        if not gate.should_reset(streak, b.agreed, o):
            return b, Outcome(Verdict.GATED, row.innov, fix.S, nis, nis_max(o.gate_probability, dof))
        b = _initialized(b, event, o, reset=True)._replace(nis_mean=1.0)
        row, fix = _compared(b, event, params)
        if fix is None:
            return b, Outcome(Verdict.SINGULAR, row.innov)
        nis = fix.nis
    lost = gate.sigma_of(b.P[POS_REL, POS_REL]) > 0.3
    fix = partial(b.P, fix, *_withheld(b))
    b = corrected(b, fix.dx, fix.P)
    known = b.heading_known or (dof >= 4 and not event.yaw_ambiguous)
    b = b._replace(
        sighted=max(t, b.sighted), agreed=1 if fresh or lost else b.agreed + 1, rejections=RejectionStreak(), heading_known=known
    )
    if _moves_aside(b):
        b = b._replace(swung=b.t)
    limit = nis_max(o.gate_probability, row.innov.size)
    return _learned(b, event, row, params), Outcome(Verdict.FUSED, row.innov, fix.S, nis, limit)


def _moves_aside(b: Belief) -> bool:
    """Return whether a manoeuvre shown in the last half second moves the pad across the ship's way."""
    if b.steered < 0 or (b.t - b.steered) * 1e-9 > 0.5:
        return False
    was = b.x[VEL][:2] - b.ins_v[:2] + b.vessel_before
    change, speed = b.x[VESSEL_VEL] - was, float(np.linalg.norm(was))
    across = abs(float(change[0] * was[1] - change[1] * was[0]))
    return (across / speed if speed > 0.3 else float(np.linalg.norm(change))) > 0.5


def _jolted(
    b: Belief, event: Sighting, row: sighting.LinearizedMeasurement, fix: Correction, params: FilterParams
) -> tuple[Belief, sighting.LinearizedMeasurement, Correction]:
    """Compare again with a wider belief if the last sightings missed the deck by more than the filter claims."""
    back = b.R.dot(so3.exp(b.x[CAMERA_MOUNT]))
    cov_ned = back.dot(fix.S[:3, :3]).dot(back.T)
    shown, nis_claimed = deck_jolt.steering(row.innov, fix.S, row.H, b)
    b = b._replace(nis_claimed=nis_claimed)
    excesses = deck_jolt.extended(b.excesses, b.t, back.dot(row.innov[:3]), cov_ned, shown)
    missing, steered = deck_jolt.missing(excesses), deck_jolt.steered(excesses, b.t, shown)
    if missing is None and steered is None:
        return b._replace(excesses=excesses), row, fix
    P = b.P
    if missing is not None:
        horizontally = steered is not None and bool((steered[:2] > 0.0).any())
        P = deck_jolt.widened(P, missing * [0.0, 0.0, 1.0] if horizontally else missing)
    if steered is None:
        wider = b._replace(P=P, excesses=InnovationExcesses())
    else:
        anew = b.steered < 0 or (b.t - b.steered) * 1e-9 > 2.0
        before = b.x[VESSEL_VEL] - b.x[VEL][:2] + b.ins_v[:2] if anew else b.vessel_before
        swung = b.t if steered[2] > 0.012**2 else b.swung
        P = deck_jolt.loosened(P, b.x, steered)
        wider = b._replace(P=P, excesses=excesses, steered=b.t, swung=swung, vessel_before=before)
    row, again = _compared(wider, event, params)
    return (b._replace(excesses=excesses), row, fix) if again is None else (wider, row, again)


def _withheld(b: Belief) -> tuple[F64, F64]:
    """Return the fractions (N,) of a correction and of its covariance's root that are withheld, by state."""
    heave = float(b.sea.sigma[2] * b.sea.w_rad_s[2]) ** 2
    rough = heave / (heave + _ROUGH_M_S**2)
    withheld = np.zeros(N)
    withheld[CAMERA_MOUNT] = _WITHHELD_MOUNT * rough
    withheld_cov = withheld.copy()
    withheld[CAMERA_DELAY], withheld_cov[CAMERA_DELAY] = _WITHHELD_DELAY * rough, _WITHHELD_DELAY_COV * rough
    return withheld, withheld_cov


def _heading_weighed(b: Belief, event: Sighting, o: EkfOptions, *, agrees: bool) -> Belief:
    """Count the time for which sightings agreed with the heading, minus the time for which they contradicted it."""
    t = event.stamp.measured_at
    since = 0.0 if b.heading_seen < 0 else min((t - b.heading_seen) * 1e-9, 0.5)
    held = b.heading_held_s + since if agrees else b.heading_held_s - since
    return b._replace(heading_held_s=min(held, o.heading_memory_s), heading_seen=t)


def _with_new_heading(b: Belief, event: Sighting) -> Belief:
    """Set the pad's yaw from this sighting, with a uniform prior on it."""
    yaw = event.yaw_rad
    if event.pose6 is not None:
        yaw = -heading(event.pose6.R_level_pad.matrix)
    if yaw is None:
        return b
    P, x = b.P.copy(), b.x.copy()
    x[PAD_YAW] = wrap_pi(heading(b.R) - yaw)
    x[[YAW_RATE, WAVE_YAW]] = 0.0
    P[PAD_YAW, :] = P[:, PAD_YAW] = 0.0
    P[PAD_YAW, PAD_YAW] = math.pi**2 / 3.0
    return b._replace(x=x, P=P, heading_held_s=0.0)


def _compared(
    b: Belief, event: Sighting, params: FilterParams, *, place_only: bool = False
) -> tuple[sighting.LinearizedMeasurement, Correction | None]:
    yaw_sigma = math.sqrt(float(b.P[PAD_YAW, PAD_YAW])) if b.heading_known else math.inf
    cov = b.cov_levelled_by if params.options.sighting_has_attitude_error else np.zeros((3, 3))
    apart = np.subtract(b.w, b.w_smooth)
    row = sighting.sighting(
        b.x, b.R, b.w, event, b.levelled_by, cov, yaw_sigma, place_only=place_only, rate_var=float(apart.dot(apart))
    )
    # The part of an innovation that is due to the delay grows with the rate of the measured position. While that rate is
    # poorly known, the delay is not corrected and its effect counts as noise.
    cov_rate = row.G.dot(b.P).dot(row.G.T)
    if float(np.trace(cov_rate)) > _RATE_KNOWN_VAR:
        rate, var = row.H[:, CAMERA_DELAY], float(b.P[CAMERA_DELAY, CAMERA_DELAY])
        R, H = row.R + var * np.outer(rate, rate), row.H.copy()
        R[:3, :3] += var * cov_rate
        H[:, CAMERA_DELAY] = 0.0
        row = row._replace(H=H, R=R)
    return row, algebra.ALGEBRA.correct(b.P, row.innov, row.H, row.R)


def _initialized(b: Belief, event: Sighting, o: EkfOptions, *, reset: bool) -> Belief:
    """Initialize the pad's position from this sighting. With `reset`, drop the rest of the belief about the pad as well.

    The states of the body itself stay.
    """
    P, x = b.P.copy(), b.x.copy()
    seen = sighting.seen_from_body(event, sighting.levelling(b.R, b.levelled_by))
    x[POS_REL] = b.R.dot(so3.exp(x[CAMERA_MOUNT]).dot(seen))
    P[POS_REL, :] = P[:, POS_REL] = 0.0
    P[POS_AXES, POS_AXES] = 1e2 + float(seen.dot(seen))
    if reset:
        gone = np.r_[VESSEL_VEL, TURN_RATE, WAVES[:3].ravel()]
        P[gone, :] = P[:, gone] = 0.0
        P[VESSEL_VEL, VESSEL_VEL] = np.eye(2) * 4.0
        P[TURN_RATE, TURN_RATE] = o.sigma_turn_rate_rad_s**2
        x[TURN_RATE] = 0.0
        P[WAVES[:3, :, None], WAVES[:3, None, :]] = waves_unknown(b.sea)[:3]
        x[WAVES[:3]] = 0.0
    if (reset or not b.heading_known) and event.yaw_rad is not None and not event.yaw_ambiguous:
        x[PAD_YAW] = wrap_pi(heading(b.R) - event.yaw_rad)
        P[PAD_YAW, :] = P[:, PAD_YAW] = 0.0
        P[PAD_YAW, PAD_YAW] = math.pi**2 / 3.0
    return b._replace(x=x, P=P, rejections=RejectionStreak(), heading_held_s=0.0, swung=-1 if reset else b.swung)


def _learned(b: Belief, event: Sighting, row: sighting.LinearizedMeasurement, params: FilterParams) -> Belief:
    """Update the bank of wave oscillators with the pad's measured position and tilt."""
    if b.sea.t >= 0 and (b.t - b.sea.t) * 1e-9 < 0.9 * bank.PERIOD_S:
        return b
    A = sighting.levelling(b.R, b.levelled_by)
    back = b.R.dot(so3.exp(b.x[CAMERA_MOUNT]))
    seen = sighting.seen_from_body(event, A) - row.H[:3, CAMERA_DELAY] * b.x[CAMERA_DELAY]
    y, var = np.zeros(5), np.full(5, 1e6)
    y[:3] = back.dot(seen) + b.ins_p
    var[:3] = np.diag(back.dot(row.R[:3, :3]).dot(back.T))
    if row.innov.size == 6 and event.pose6 is not None:
        R_ned_pad = back.dot(A.T.dot(event.pose6.R_level_pad.matrix))
        y[3] = math.atan2(float(R_ned_pad[2, 1]), float(R_ned_pad[2, 2]))
        y[4] = math.asin(max(-1.0, min(1.0, -float(R_ned_pad[2, 0]))))
        into_pad = R_ned_pad.T.dot(back.dot(A.T))
        var[3:] = np.diag(into_pad.dot(row.R[3:, 3:]).dot(into_pad.T))[:2]
    by = params.carrying
    if b.ins_var_m2_s2 > 0.0 and b.sea.t >= 0:
        psd = b.ins_var_m2_s2 / ((b.t - b.sea.t) * 1e-9)
        by = by._replace(asd_accel=np.sqrt(by.asd_accel**2 + psd * CARRIED))
    learned = bank.observe(b.sea, b.t, y, var, by, float(np.linalg.norm(seen)))
    return b._replace(sea=learned, ins_var_m2_s2=0.0)
