"""The filter's state as tests read and write it: the members of the core's `dl_belief`, its covariance and its bank."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import UNKNOWN_YAW_VAR, FusionResult, Pose6, Sighting
from estimator.contracts.geometry import F64, rpy_matrix
from estimator.contracts.samples import Attitude
from estimator.core.abi import DL_DIRECTIONS, DL_MEMBERS
from estimator.core.library import CORE
from estimator.ekf import Event, Filter
from estimator.ekf.event import packed
from estimator.ekf.params import (
    ATT_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    DECK_DISP,
    DECK_RATE,
    DECK_TRIM,
    PAD_YAW,
    POS_AXES,
    POS_DOWN,
    POS_REL,
    RANGE_OFFSET,
    VEL_AXES,
    VEL_SCALE,
    VESSEL_VEL,
    FilterParams,
    N,
)
from tests.make import attitude, stamp_at
from tests.support.core_parts import PARTS, PARTS_DOOR, part

MS, S = 1_000_000, 1_000_000_000
T = 500 * S
"""Instant of states that are made by hand, ns."""
TILTED = rpy_matrix(0.1, -0.15, 0.8)
COLUMNS_MAX, EXCESS_NUMBERS, MEMBER_STATES, MEMBER_PAIRS = 12, 6, 7, 28
SAMPLE_COLUMNS = (
    [*range(N)[ATT_ERR], *ATT_BIAS],
    [*range(N)[ATT_ERR], *VEL_AXES, *range(N)[VESSEL_VEL], *DECK_RATE[:3], VEL_SCALE],
    [*range(N)[ATT_ERR], *POS_AXES, DECK_DISP[3], DECK_TRIM[0], DECK_DISP[4], DECK_TRIM[1], PAD_YAW, RANGE_OFFSET],
    [POS_DOWN, DECK_DISP[2], BARO_OFFSET],
)
"""The states on which each kind of aiding depends, in the order of the core's Jacobians."""
_PAIRS = np.triu_indices(MEMBER_STATES)
_PAIR_AT = np.zeros((MEMBER_STATES, MEMBER_STATES), dtype=int)
_PAIR_AT[_PAIRS] = _PAIR_AT[_PAIRS[::-1]] = np.arange(MEMBER_PAIRS)
"""(7, 7) the place of each entry of a symmetric matrix in the rows of its upper triangle."""
_MATRICES = ("R", "R_cov", "turned", "levelled_by", "cov_levelled_by")
_SKILL = ("product", "square", "came")


class State(SimpleNamespace):
    """The members of `dl_belief` by name, `P` (N, N) and `bank`.

    Matrices have two axes. `aids` holds for each kind `fused`, `refused` and `gathered`, which is None if no sample waits;
    `excesses` holds pairs of an instant and six numbers. Members of the bank lie along the second axis of `x` (5, G, 7) and
    `P` (5, G, 7, 7).
    """

    def copy(self, **changed: Any) -> State:
        """Return a copy in which some members are others. Arrays are shared, so nobody writes into one."""
        made = State(**(vars(self) | changed))
        if "aids" not in changed:
            made.aids = [SimpleNamespace(**vars(aid)) for aid in self.aids]
        return made


def _members(record: NDArray[Any]) -> dict[str, Any]:
    """Return the members of a structure: plain numbers, arrays, and structures as they are."""
    found = {name: record[name] for name in record.dtype.names or ()}
    return {name: value.item() if value.ndim == 0 and value.dtype.names is None else value for name, value in found.items()}


def _read_aid(kind: int, record: NDArray[Any]) -> SimpleNamespace:
    aid = SimpleNamespace(**_members(record))
    if aid.n == 0:
        return SimpleNamespace(fused=aid.fused, refused=aid.refused, first=aid.first, gathered=None)
    m, columns = aid.m, SAMPLE_COLUMNS[kind]
    H = np.zeros((m, N))
    H[:, columns] = aid.H.reshape(3, COLUMNS_MAX)[:m, : len(columns)]
    squares = {name: getattr(aid, name)[: m * m].reshape(m, m) for name in ("R", "ambiguity", "spread")}
    axes = tuple(i for i in range(3) if aid.axes >> i & 1)
    gathered = SimpleNamespace(
        n=aid.n, since=aid.since, axes=axes, deck_weight=aid.deck_weight, innov=aid.innov[:m], H=H, **squares
    )
    return SimpleNamespace(fused=aid.fused, refused=aid.refused, first=aid.first, gathered=gathered)


@lru_cache(maxsize=4)  # few events change it
def _read_bank(data: bytes) -> SimpleNamespace:
    record = np.frombuffer(data, PARTS_DOOR.dtype("dl_bank"))[0, ...]
    bank, known = SimpleNamespace(**_members(record)), SimpleNamespace(**_members(record["skill"]))
    bank.log_weight, bank.weight = (a.reshape(DL_DIRECTIONS, DL_MEMBERS) for a in (bank.log_weight, bank.weight))
    bank.x = bank.x.reshape(DL_DIRECTIONS, MEMBER_STATES, DL_MEMBERS).transpose(0, 2, 1)
    bank.P = bank.P.reshape(DL_DIRECTIONS, MEMBER_PAIRS, DL_MEMBERS)[:, _PAIR_AT].transpose(0, 3, 1, 2)
    issued = known.issued[: known.issued_n]
    sums = {name: getattr(known, name).reshape(3, DL_DIRECTIONS, 2) for name in _SKILL}
    forecasts = [(one["t"].item(), one["waves"].reshape(3, DL_DIRECTIONS, 2)) for one in issued]
    bank.skill = SimpleNamespace(issued=forecasts, n=known.n, **sums)
    return bank


def _read(numbers: NDArray[Any], P: F64, bank: SimpleNamespace) -> State:
    made = State(**_members(numbers), P=P, bank=bank)
    for name in _MATRICES:
        setattr(made, name, getattr(made, name).reshape(3, 3))
    made.rejections = SimpleNamespace(**_members(made.rejections))
    made.aids = [_read_aid(kind, aid) for kind, aid in enumerate(made.aids)]
    counted, values = made.excesses, made.excesses["values"].reshape(-1, EXCESS_NUMBERS)
    made.excesses = [(counted["t"][k].item(), values[k]) for k in range(int(counted["n"]))]
    return made


def state_of(filter: Filter, t: int = 2**62) -> State | None:
    """Return the state after the last event of a filter that is not later than an instant, ns; None before its first attitude."""
    pointer = part("filter_before")(PARTS.cast("dl_filter *", int(CORE.ffi.cast("intptr_t", filter._core))), t)
    if pointer == PARTS.NULL:
        return None
    numbers, bank = (
        bytes(PARTS.buffer(PARTS.addressof(holder[0], name))) for holder, name in ((pointer, "belief"), (pointer.bank, "bank"))
    )
    P = np.frombuffer(bytes(PARTS.buffer(pointer.P.P))).reshape(N, N)
    return _read(np.frombuffer(numbers, PARTS_DOOR.dtype("dl_belief"))[0, ...], P, _read_bank(bank))


def newest(filter: Filter) -> State:
    """Return the state after the last event of a filter that has begun."""
    found = state_of(filter)
    assert found is not None
    return found


def written(b: State) -> NDArray[Any]:
    """Return the core's `dl_belief` of a state whose aiding has gathered nothing."""
    values = {name: value for name, value in vars(b).items() if name not in ("P", "bank", "aids", "excesses", "rejections")}
    return PARTS_DOOR.record(
        "dl_belief",
        **values,
        rejections=vars(b.rejections),
        aids=[{"fused": aid.fused, "refused": aid.refused, "first": aid.first} for aid in b.aids],
        excesses={
            "n": len(b.excesses),
            "t": np.array([t for t, _ in b.excesses], dtype=np.int64),
            "values": np.ravel([values for _, values in b.excesses]),
        },
    )


def _written_bank(bank: SimpleNamespace) -> NDArray[Any]:
    known, rows, columns = bank.skill, *_PAIRS
    skill: dict[str, Any] = {name: getattr(known, name) for name in ("n", *_SKILL)}
    skill |= {"issued_n": len(known.issued), "issued": [{"t": t, "waves": waves} for t, waves in known.issued]}
    values = {name: getattr(bank, name) for name in ("t", "sighted", "w_rad_s", "zeta", "sigma", "log_weight", "weight")}
    pairs = bank.P[:, :, rows, columns].transpose(0, 2, 1)
    return PARTS_DOOR.record("dl_bank", **values, x=bank.x.transpose(0, 2, 1), P=pairs, skill=skill)


def holding(b: State, params: FilterParams) -> Filter:
    """Return a filter that holds a state, whose aiding has gathered nothing, and has received no event since."""
    head = np.array([0, -1, -1, 0, 0, 2, 2], np.int64)
    parts = head, written(b), np.ascontiguousarray(b.P), _written_bank(b.bank)
    return Filter(params.options, b"".join([each.tobytes() for each in parts]))


def put(filter: Filter, event: Event) -> FusionResult:
    """Put one event into a filter; return its result."""
    (result,) = filter.put([event])
    return result


def copied(filter: Filter) -> Filter:
    """Return a filter that remembers what this one does and goes its own way."""
    return Filter(filter.options, filter.save())


def core_answer(filter: Filter, t: int) -> dict[str, Any]:
    """Return the members of the core's `dl_answer` at an instant, ns."""
    made, pointer = CORE.room("dl_answer", 1)
    assert CORE.lib.dl_filter_answer(filter._core, t, pointer)
    return _members(made[0, ...])


def observe(
    bank: SimpleNamespace, t: int, y: F64, var: F64, params: FilterParams, *, reach_m: float = 2.0, ins_var: float = 0.0
) -> SimpleNamespace:
    """Return the core's bank after one sighting of the deck's motion by direction, (5,) with its variance."""
    before, after = _written_bank(bank), _written_bank(bank)
    look = PARTS_DOOR.record("bank_look", y=y, var=var, ins_var=ins_var, reach_m=reach_m)
    part("bank_observe")(PARTS.cast("dl_filter_params *", params.core), t, look, before, after)
    return _read_bank(after.tobytes())


def sighting_rows(b: State, s: Sighting, *, yaw_sigma: float = 0.1, place_only: bool = False) -> SimpleNamespace:
    """Return the core's linearised sighting: `innov` (m,), `H` (m, N), `R` (m, m) and the rate's Jacobian `by_rate` (3, N)."""
    event = np.frombuffer(packed(s), CORE.dtype("dl_event"))[0, ...]
    seen = np.frombuffer(event["sample"]["sighting"].tobytes(), CORE.dtype("dl_sighting"))
    rows = PARTS.new("sighting_rows *")
    part("sighting_model")(written(b), seen, np.ascontiguousarray(b.cov_levelled_by), yaw_sigma, int(place_only), rows)
    m = rows.m
    innov, H, R, by_rate = (np.frombuffer(PARTS.buffer(member)).copy() for member in (rows.innov, rows.H, rows.R, rows.by_rate))
    return SimpleNamespace(innov=innov[:m], H=H.reshape(6, N)[:m], R=R[: m * m].reshape(m, m), by_rate=by_rate.reshape(3, N))


# States and sightings that are made by hand or drawn


def begun(params: FilterParams, event: Attitude | None = None) -> State:
    """Return the state after a first attitude, by default level and north at `T`."""
    filter = Filter(params.options)
    put(filter, event or attitude(stamp_at(T)))
    return newest(filter)


def correlated(seed: int = 1, size: float = 1.0) -> F64:
    """Return a covariance (N, N) in which everything is correlated, of about the size of a filter's after a minute."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(N, N)) / np.sqrt(N) + np.eye(N)
    sigma = size * rng.uniform(0.005, 0.02, N)
    P = A @ A.T * sigma[:, None] * sigma
    return np.asarray(0.5 * (P + P.T))


def drawn_x(seed: int = 2, size: float = 1.0) -> F64:
    """Return a state (N,) of which no two numbers are alike, of a pad about 2 m below."""
    x = size * np.random.default_rng(seed).uniform(-0.3, 0.3, N)
    x[:3] = 0.0
    x[POS_REL] += 0.1, -0.1, 2.0
    x[VEL_SCALE] += 0.8
    return x


def known(params: FilterParams, R: F64 = TILTED, **changed: Any) -> State:
    """Return a state at `T` that was sighted 20 ms ago and whose headings are known; nothing is gathered or refused."""
    usual: Mapping[str, Any] = {
        "R": R, "R_cov": R, "levelled_by": R, "cov_levelled_by": np.zeros((3, 3)), "x": drawn_x(), "P": correlated(),
        "sighted": T - 20 * MS, "agreed": 10, "heading_known": 1, "heading_held_s": 5.0, "heading_seen": T,
    }  # fmt: skip
    return begun(params).copy(**(usual | changed))


def seen(
    d: F64, yaw: float | None = None, *, t: int = T, var: float = 1e-4, yaw_var: float = 1e-3, pose6: Pose6 | None = None,
    ambiguous: bool = False, confidence: float = 1.0, sigma_s: float = 0.0,
) -> Sighting:  # fmt: skip
    """Return a sighting of the pad at `d`, (3,) m in level, and of its heading, rad."""
    cov = np.diag([var] * 3 + [UNKNOWN_YAW_VAR if yaw is None else yaw_var])
    return Sighting(stamp_at(t, sigma_s=sigma_s), t // MS % 1000, "selected", d, yaw, ambiguous, cov, confidence, pose6)


def heading(R: F64) -> float:
    """Return the heading of a rotation (3, 3), rad."""
    return math.atan2(float(R[1, 0]), float(R[0, 0]))
