"""The core's parts, called by themselves: what flies, where a test compares one part of it with its model or with the oracle."""

import math

import numpy as np

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.core.library import CORE
from estimator.ekf.deck_motion_bank import DeckMotionBank, PackedSea
from estimator.ekf.history import process_event
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.packed_event import packed_event
from estimator.ekf.params import FilterParams
from estimator.ekf.so3 import Vec3
from estimator.ekf.state import Belief, N
from tests.estimator.ekf.hand import belief
from tests.estimator.ekf.oracle.sighting import LinearizedMeasurement
from tests.support.core_parts import PARTS, part


def fuse_sighting(b: Belief, event: Sighting, params: FilterParams) -> tuple[Belief, Outcome]:
    """Return the belief after a sighting, and its outcome."""
    after, outcome = process_event(b, event, params)
    assert after is not None
    return after, outcome


def sighting(
    x: F64,
    R: F64,
    w: F64 | Vec3,
    s: Sighting,
    levelled_by: F64 | None,
    cov_levelled_by: F64,
    yaw_sigma: float,
    *,
    place_only: bool = False,
    rate_var: float = 0.0,
) -> LinearizedMeasurement:
    """Return the core's model of a sighting, with the arguments of the oracle's."""
    turning: Vec3 = tuple(np.asarray(w, dtype=float).tolist())  # type: ignore[assignment]
    smooth = (turning[0] - math.sqrt(rate_var), *turning[1:])
    packed = PackedBelief.of(belief(R, x=x, w=turning, w_smooth=smooth, levelled_by=levelled_by))
    seen = np.frombuffer(packed_event(s).seen, CORE.dtype("dl_sighting"))
    rows = PARTS.new("sighting_rows *")
    cov = np.ascontiguousarray(cov_levelled_by)
    part("sighting_model")(packed.numbers, seen, cov, yaw_sigma, int(place_only), rows)
    m = rows.m
    innov, H, noise, by_rate = (
        np.frombuffer(PARTS.buffer(member)).copy() for member in (rows.innov, rows.H, rows.R, rows.by_rate)
    )
    return LinearizedMeasurement(innov[:m], H.reshape(6, N)[:m], noise[: m * m].reshape(m, m), by_rate.reshape(3, N))


def observe(
    bank: DeckMotionBank, t: int, y: F64, var: F64, params: FilterParams, reach_m: float, ins_var: float = 0.0
) -> DeckMotionBank:
    """Return the core's bank after one look."""
    before, after = PackedSea.of(bank), PackedSea.of(bank).apart()
    options = PARTS.cast("dl_filter_params *", params.core)
    part("bank_observe")(options, t, y, var, ins_var, reach_m, before.record, after.record)
    return after.bank


def settled(b: Belief, params: FilterParams) -> tuple[Belief, F64, F64]:
    """Return the belief with everything but `P` propagated from `t_cov` to `t`, and the (N, N) F and Q that propagate `P`."""
    packed, F, Q = PackedBelief.of(b), np.empty((N, N)), np.empty((N, N))
    own = packed.apart(packed.P, packed.sea)
    part("propagated_belief")(PARTS.cast("dl_filter_params *", params.core), own.numbers, F, Q)
    return own.belief, F, Q
