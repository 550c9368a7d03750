"""The core's parts, called by themselves: what flies, where a test compares one part of it with its model or with the oracle."""

from __future__ import annotations

import math

import numpy as np

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import F64
from estimator.core.library import CORE, address, start_of
from estimator.ekf.deck_motion_bank import SEA_SIZE, DeckMotionBank, PackedSea
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_belief import PackedBelief
from estimator.ekf.packed_event import packed_event
from estimator.ekf.params import FilterParams
from estimator.ekf.process_event import process_event
from estimator.ekf.so3 import Vec3
from estimator.ekf.state import Belief, N
from tests.estimator.ekf.hand import belief
from tests.estimator.ekf.oracle.sighting import LinearizedMeasurement

_MODEL, _OBSERVE = CORE.function("sighting_model"), CORE.function("bank_observe")


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
    newest = (turning[0] + math.sqrt(rate_var), *turning[1:])
    packed = PackedBelief.of(belief(R, x=x, w=newest, w_smooth=turning, levelled_by=levelled_by))
    innov, H, noise, by_rate = np.zeros(6), np.zeros((6, N)), np.zeros(36), np.zeros((3, N))
    cov = np.ascontiguousarray(cov_levelled_by)
    m = _MODEL(
        packed.numbers.address, packed_event(s).seen, address(cov), yaw_sigma, int(place_only),
        address(innov), address(H), address(noise), address(by_rate),
    )  # fmt: skip
    return LinearizedMeasurement(innov[:m], H[:m], noise[: m * m].reshape(m, m), by_rate)


def observe(
    bank: DeckMotionBank, t: int, y: F64, var: F64, params: FilterParams, reach_m: float, ins_var: float = 0.0
) -> DeckMotionBank:
    """Return the core's bank after one look."""
    before, block = PackedSea.of(bank), np.empty(SEA_SIZE)
    _OBSERVE(params.packed_address, t, address(y), address(var), ins_var, reach_m, before.address, start_of(block))
    return PackedSea(block, 0, address(block)).bank
