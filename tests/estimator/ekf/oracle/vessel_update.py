"""Fuse what a ship reports of itself, in numpy."""

import numpy as np

from estimator.contracts.estimates import Verdict
from estimator.contracts.samples import VesselReport
from estimator.ekf.params import FilterParams
from estimator.ekf.params import nis_max as limit
from tests.estimator.ekf.belief import Belief, Outcome
from tests.estimator.ekf.oracle import algebra, sighting
from tests.estimator.ekf.oracle.propagate import corrected, ready_to_fuse


def fuse_vessel(b: Belief, event: VesselReport, params: FilterParams) -> tuple[Belief, Outcome]:
    """Fuse a vessel's report: its velocity, its heading, or both."""
    o = params.options
    b = ready_to_fuse(b, event.stamp.measured_at, params)
    rows = []
    axes: tuple[int, ...] = ()
    if event.v_vessel_ned is not None and event.cov_v_ned is not None:
        axes += (0, 1, 2)
        rows.append(sighting.vessel_velocity(b.x, event.v_vessel_ned, event.cov_v_ned))
    if event.heading_rad is not None and event.sigma_heading_rad is not None:
        axes += (3,)
        rows.append(sighting.vessel_heading(b.x, event.heading_rad + o.pad_yaw_in_vessel_rad, event.sigma_heading_rad))
    if not rows:
        return b, Outcome(Verdict.GATED)
    n = sum(r.innov.size for r in rows)
    R = np.zeros((n, n))
    at = 0
    for r in rows:
        R[at : at + len(r.R), at : at + len(r.R)] = r.R
        at += len(r.R)
    innov = np.concatenate([r.innov for r in rows])
    fix = algebra.ALGEBRA.correct(b.P, innov, np.concatenate([r.H for r in rows]), R)
    if fix is None:
        return b, Outcome(Verdict.SINGULAR, innov, axes=axes)
    nis_max = limit(o.gate_probability, n)
    if fix.nis > nis_max:
        return b, Outcome(Verdict.GATED, innov, fix.S, fix.nis, nis_max, axes)
    b = corrected(b, fix.dx, fix.P)
    b = b._replace(heading_known=b.heading_known or event.heading_rad is not None)
    return b, Outcome(Verdict.FUSED, innov, fix.S, fix.nis, nis_max, axes)
