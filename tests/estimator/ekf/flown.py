"""The core's parts, called by themselves: what flies, where a test compares one part of it with its model or with the oracle."""

import math

import numpy as np

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.core.library import CORE
from estimator.ekf.event import packed
from estimator.ekf.params import FilterParams
from estimator.ekf.state import N
from tests.estimator.ekf.belief import (
    Belief,
    DeckMotionBank,
    Outcome,
    Vec3,
    process_event,
    read_bank,
    read_belief,
    write_bank,
    write_belief,
)
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
    numbers = write_belief(belief(R, x=x, w=turning, w_smooth=smooth, levelled_by=levelled_by))
    event = np.frombuffer(packed(s), CORE.dtype("dl_event"))[0, ...]
    seen = np.frombuffer(event["sample"]["sighting"].tobytes(), CORE.dtype("dl_sighting"))
    rows = PARTS.new("sighting_rows *")
    cov = np.ascontiguousarray(cov_levelled_by)
    part("sighting_model")(numbers, seen, cov, yaw_sigma, int(place_only), rows)
    m = rows.m
    innov, H, noise, by_rate = (
        np.frombuffer(PARTS.buffer(member)).copy() for member in (rows.innov, rows.H, rows.R, rows.by_rate)
    )
    return LinearizedMeasurement(innov[:m], H.reshape(6, N)[:m], noise[: m * m].reshape(m, m), by_rate.reshape(3, N))


def observe(
    bank: DeckMotionBank, t: int, y: F64, var: F64, params: FilterParams, reach_m: float, ins_var: float = 0.0
) -> DeckMotionBank:
    """Return the core's bank after one look."""
    before, after = write_bank(bank), write_bank(bank)
    options = PARTS.cast("dl_filter_params *", params.core)
    part("bank_observe")(options, t, y, var, ins_var, reach_m, before, after)
    return read_bank(after)


def settled(b: Belief, params: FilterParams) -> tuple[Belief, F64, F64]:
    """Return the belief with everything but `P` propagated from `t_cov` to `t`, and the (N, N) F and Q that propagate `P`."""
    numbers, F, Q = write_belief(b), np.empty((N, N)), np.empty((N, N))
    part("propagated_belief")(PARTS.cast("dl_filter_params *", params.core), numbers, F, Q)
    return read_belief(numbers, b.P, b.sea), F, Q
