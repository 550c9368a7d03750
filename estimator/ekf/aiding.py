"""Aiding from the vehicle's own sensors: averaged over a short period, fused at once, let back in when refused for too long."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Baro, BodyVelocity, Range, VesselReport
from estimator.ekf import gate, measure, motion
from estimator.ekf.options import EkfOptions
from estimator.ekf.state import (
    ATTITUDE,
    BARO,
    HEAD,
    HEIGHT,
    RANGE,
    SCALE,
    TH,
    TILT,
    VELOCITY,
    WAVES,
    Aid,
    Belief,
    D,
    N,
    U,
)  # fmt: skip
from estimator.ekf.stride import Event, Outcome, Tools, carried, corrected, settled

_STUCK_S = 1.0
"""A kind of aiding refused for so long without a break is let back in with what it contradicts made uncertain."""
_OVER_MEMORY_S = 3.0
"""How soon what the velocity samples told of what is below is forgotten."""
_OVER_EXPECTED = 3.0
"""Log-odds of seeing the deck where the body is surely over it, of seeing the water where it surely is not."""
_CORRELATION = (
    "attitude_correlation_s", "velocity_correlation_s", "range_correlation_s", "baro_correlation_s",
)  # fmt: skip


def fuse_velocity(b: Belief, event: BodyVelocity, tools: Tools) -> tuple[Belief, Outcome]:
    """Over the ground, or over the deck: where that is not given, the samples themselves tell, and doubt widens the noise."""
    b = carried(b, event.stamp.taken, tools)
    x = motion.peek(b)
    v, cov = event.v_level, event.cov_level
    if tools.options.velocity_is_over == "either" and b.sighted >= 0:
        b = _seen_below(b, x, event, tools.options)
    share = _share_over_pad(b, tools.options)
    row = measure.velocity(x, b.R, v, cov, share)
    if row is None or (share == 1.0 and b.sighted < 0):
        return b, Outcome(event, Verdict.GATED)
    doubt = share * (1.0 - share)
    if doubt > 0.0:
        n = row.innov.size
        difference = measure.velocity(x, b.R, v, cov, 0.0)
        if difference is not None:
            gap = (row.innov - difference.innov) / share
            slope = (row.H - difference.H) / share
            row = row._replace(R=row.R + doubt * (np.outer(gap, gap) + slope.dot(b.P).dot(slope.T) + 1e-9 * np.eye(n)))
    return gather(b, VELOCITY, event, row, tools)


def _share_over_pad(b: Belief, o: EkfOptions) -> float:
    if o.velocity_is_over != "either":
        return 1.0 if o.velocity_is_over == "pad" else 0.0
    if b.sighted < 0:
        return 0.0
    share = 1.0 / (1.0 + math.exp(-b.over_pad))
    return 0.0 if share < 0.03 else 1.0 if share > 0.97 else share


def _seen_below(b: Belief, x: F64, event: BodyVelocity, o: EkfOptions) -> Belief:
    """Weigh the two readings of a velocity against each other. Samples alike for a time count as one."""
    since = 1.0 if b.t_velocity < 0 else (b.t - b.t_velocity) * 1e-9
    if since < 0.5 * o.velocity_correlation_s:
        return b
    away, spread = _foot(b, x)
    expected = 0.0
    if away + 2.0 * spread < o.deck_radius_m:
        expected = _OVER_EXPECTED
    elif away - 2.0 * spread > 4.0 * o.deck_radius_m:
        expected = -_OVER_EXPECTED
    odds = expected + (b.over_pad - expected) * math.exp(-since / _OVER_MEMORY_S)
    ground, deck = (measure.velocity(x, b.R, event.v_level, event.cov_level, share) for share in (0.0, 1.0))
    if ground is None or deck is None:
        return b
    # Both are held against the doubt of both: the reading that was believed so far would else win by having made itself certain.
    S = ground.H.dot(b.P).dot(ground.H.T) + deck.H.dot(b.P).dot(deck.H.T) + ground.R
    try:
        misfit = [float(row.innov.dot(np.linalg.solve(S, row.innov))) for row in (ground, deck)]
    except np.linalg.LinAlgError:
        return b
    evidence = max(-3.0, min(3.0, 0.5 * (misfit[0] - misfit[1])))
    odds += evidence * min(1.0, 0.5 * since / o.velocity_correlation_s)
    return b._replace(over_pad=max(-6.0, min(6.0, odds)), t_velocity=b.t)


def fuse_range(b: Belief, event: Range, tools: Tools) -> tuple[Belief, Outcome]:
    b = carried(b, event.stamp.taken, tools)
    x = motion.peek(b)
    if b.sighted < 0:
        return b, Outcome(event, Verdict.GATED)
    row = measure.distance(x, b.R, event.range_m, event.sigma_m)
    # Beyond the deck's edge there is water.
    away, spread = _foot(b, x)
    if row is None or away + 2.0 * spread > tools.options.deck_radius_m:
        return b, Outcome(event, Verdict.GATED)
    return gather(b, RANGE, event, row, tools)


def _foot(b: Belief, x: F64) -> tuple[float, float]:
    """How far from the pad's centre the body's down axis meets the deck, and how well that is known; m."""
    c = b.R[:, 2]
    foot = x[D] - c * float(x[5] / max(c[2], 0.3))
    spread = math.sqrt(max(float(b.P[3, 3] + b.P[4, 4]) / 2.0, 0.0))
    return math.hypot(float(foot[0]), float(foot[1])), spread


def fuse_baro(b: Belief, event: Baro, tools: Tools) -> tuple[Belief, Outcome]:
    b = carried(b, event.stamp.taken, tools)
    if b.sighted < 0:
        return b, Outcome(event, Verdict.GATED)
    return gather(b, HEIGHT, event, measure.height(motion.peek(b), event.height_m, event.sigma_m), tools)


def gather(b: Belief, kind: int, event: Event, row: measure.Row, tools: Tools) -> tuple[Belief, Outcome]:
    """Add to what is fused at the end of the aiding period, unless it is implausible."""
    o = tools.options
    S = row.H.dot(b.P).dot(row.H.T) + row.R
    try:
        nis = float(row.innov.dot(np.linalg.solve(S, row.innov)))
    except np.linalg.LinAlgError:
        return b, Outcome(event, Verdict.SINGULAR, row.innov, S)
    aid = b.aids[kind]
    if not nis >= 0.0:
        return b, Outcome(event, Verdict.SINGULAR, row.innov, S)
    if nis > gate.nis_max(o.gate_probability, row.innov.size):
        since = aid.refused if aid.refused >= 0 else b.t
        if (b.t - since) * 1e-9 > _STUCK_S:
            b = _loosened(b, kind, row)
            since = -1
        return _with_aid(b, kind, aid._replace(refused=since)), Outcome(event, Verdict.GATED, row.innov, S, nis)
    if _stale(aid, b.t, o) or aid.innov is None or aid.R is None or aid.innov.size != row.innov.size:
        aid = Aid(1, b.t, row.innov, row.R, aid.fused, -1)
    else:
        aid = Aid(aid.n + 1, aid.since, aid.innov + row.innov, aid.R + row.R, aid.fused, -1)
    b = _with_aid(b, kind, aid)
    if max((b.t - a.since) * 1e-9 for a in b.aids if a.n > 0) >= o.aiding_period_s or aid.fused < 0:
        b = aided(b, tools)
    return b, Outcome(event, Verdict.FUSED, row.innov, S, nis)


def _stale(aid: Aid, t: int, o: EkfOptions) -> bool:
    """Nothing gathered, or what was gathered before a pause: it was compared with a state long past."""
    return aid.n == 0 or (t - aid.since) * 1e-9 > 2.0 * o.aiding_period_s


def _with_aid(b: Belief, kind: int, aid: Aid) -> Belief:
    return b._replace(aids=(*b.aids[:kind], aid, *b.aids[kind + 1 :]))


def _jacobian(b: Belief, kind: int, size: int, share_pad: float) -> F64 | None:
    """Of what was gathered, at the instant it is fused."""
    if kind == ATTITUDE:
        return measure.attitude(b.x, b.R, b.R, np.eye(3)).H
    if kind == VELOCITY:
        cov = np.diag([0.0, 0.0, 0.0 if size == 3 else 1e9])
        row = measure.velocity(b.x, b.R, np.zeros(3), cov, share_pad)
    elif kind == RANGE:
        row = measure.distance(b.x, b.R, 0.0, 1.0)
    else:
        row = measure.height(b.x, 0.0, 1.0)
    return None if row is None or row.innov.size != size else row.H


def aided(b: Belief, tools: Tools) -> Belief:
    """Fuse the means of everything gathered, at once. Nothing gathered may outlive another correction: it would be made twice."""
    o = tools.options
    if not any(aid.n for aid in b.aids):
        return b
    b = motion.settle(b, o, tools.walk, tools.algebra)
    innov, H, R = [], [], []
    aids = list(b.aids)
    for kind, aid in enumerate(b.aids):
        if _stale(aid, b.t, o) or aid.innov is None or aid.R is None:
            aids[kind] = Aid(fused=aid.fused, refused=aid.refused)
            continue
        jacobian = _jacobian(b, kind, aid.innov.size, _share_over_pad(b, o))
        if jacobian is not None:
            # Errors alike over a time tau leave one independent look in 2 tau, however many samples there are.
            window = (b.t - aid.fused) * 1e-9 if aid.fused >= 0 else math.inf
            share = max(1.0 / aid.n, 2.0 * float(getattr(o, _CORRELATION[kind])) / max(window, 1e-3))
            innov.append(aid.innov / aid.n)
            H.append(jacobian)
            R.append(aid.R * (share / aid.n))
        aids[kind] = Aid(fused=b.t, refused=aid.refused)
    b = b._replace(aids=tuple(aids))
    if not innov:
        return b
    noise = np.zeros((sum(i.size for i in innov),) * 2)
    at = 0
    for block in R:
        noise[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    fix = tools.algebra.correct(b.P, np.concatenate(innov), np.concatenate(H), noise)
    return b if fix is None else corrected(b, fix.dx, fix.P)


def _loosened(b: Belief, kind: int, row: measure.Row) -> Belief:
    """Doubt what a stubborn sensor contradicts, in the directions in which the place of the pad does not suffer."""
    P = b.P.copy()
    if kind == ATTITUDE:
        # All directions turn together about the vertical: what an attitude with a new idea of north comes to.
        g = np.zeros(N)
        g[TH] = b.R.T[:, 2]
        g[HEAD] = 1.0
        for part in (np.arange(3, 6), np.arange(6, 9), *WAVES[:3].T):
            x, y, _ = b.x[part]
            g[part] = (-y, x, 0.0)
        g[U] = (-b.x[17], b.x[16])
        angle = float(row.innov.dot(b.R.T[:, 2]))
        P += np.outer(g, g) * angle**2
        size = min(float(row.innov.dot(row.innov)), 0.1)
        P[TH, TH] += np.eye(3) * (0.1 * size)
        P[TILT, TILT] += size
    elif kind == VELOCITY:
        # Body and vessel drift together.
        g = np.zeros((N, 2))
        g[6, 0] = g[16, 0] = g[7, 1] = g[17, 1] = 1.0
        P += g.dot(g.T) * float(row.innov[:2].dot(row.innov[:2]))
        P[SCALE, SCALE] += 0.01
    elif kind == HEIGHT:
        P[BARO, BARO] += float(row.innov[0]) ** 2
    return b._replace(P=P)


def fuse_vessel(b: Belief, event: VesselReport, tools: Tools) -> tuple[Belief, Outcome]:
    o = tools.options
    b = aided(settled(b, event.stamp.taken, tools), tools)
    rows = []
    if event.v_vessel_ned is not None and event.cov_v_ned is not None:
        rows.append(measure.vessel_velocity(b.x, event.v_vessel_ned, event.cov_v_ned))
    if event.heading_rad is not None and event.sigma_heading_rad is not None:
        rows.append(measure.vessel_heading(b.x, event.heading_rad + o.pad_yaw_in_vessel_rad, event.sigma_heading_rad))
    if not rows:
        return b, Outcome(event, Verdict.GATED)
    n = sum(r.innov.size for r in rows)
    R = np.zeros((n, n))
    at = 0
    for r in rows:
        R[at : at + len(r.R), at : at + len(r.R)] = r.R
        at += len(r.R)
    innov = np.concatenate([r.innov for r in rows])
    fix = tools.algebra.correct(b.P, innov, np.concatenate([r.H for r in rows]), R)
    if fix is None:
        return b, Outcome(event, Verdict.SINGULAR, innov)
    if fix.nis > gate.nis_max(o.gate_probability, n):
        return b, Outcome(event, Verdict.GATED, innov, fix.S, fix.nis)
    b = corrected(b, fix.dx, fix.P)
    b = b._replace(heading_known=b.heading_known or event.heading_rad is not None)
    return b, Outcome(event, Verdict.FUSED, innov, fix.S, fix.nis)
