"""Beliefs as the native core holds them, and the calls of the core that make one of another.

A packed belief is one in the layout of `estimator/core/decklander.h`: its numbers, its covariance and its deck motion bank, each
in an array that later beliefs share until an event changes it. It becomes a `Belief` on demand.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64
from estimator.core import abi
from estimator.core.abi import COLUMNS_MAX, EXCESS_NUMBERS, EXCESSES_MAX
from estimator.core.library import CORE
from estimator.ekf.deck_motion_bank import PackedSea
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_event import PackedEvent
from estimator.ekf.params import FilterParams
from estimator.ekf.state import SAMPLE_COLUMNS, Aid, Belief, Gathered, InnovationExcesses, N, RejectionStreak
from estimator.late import Late

_VERDICTS = {getattr(abi, f"DL_{v.name}"): v for v in (Verdict.FUSED, Verdict.GATED, Verdict.SINGULAR, Verdict.LOW_CONFIDENCE)}
_new, _lent, _member = CORE.ffi.new, CORE.ffi.from_buffer, CORE.ffi.addressof
_WHOLE, _ROW = (CORE.ffi.typeof(f"dl_{name} *") for name in ("whole_belief", "filter_row"))
_EVENTS, _SIGHTINGS, _HEADS = (CORE.ffi.typeof(f"dl_{name}[]") for name in ("event", "sighting", "outcome"))
_DOUBLES, _OUTCOME = CORE.ffi.typeof("double[]"), CORE.dtype("dl_outcome")
_BELIEF, _STEP = CORE.dtype("dl_belief"), CORE.dtype("dl_filter_step")
_STEP_BYTES, _OUTCOME_BYTES = _STEP.itemsize, _OUTCOME.itemsize
_AFTER_AT, _OUTCOME_AT = (CORE.ffi.offsetof("dl_filter_step", member) for member in ("after", "outcome"))
_NOTHING = CORE.ffi.new("dl_filter_step *", {"P_index": -1, "bank_index": -1})
"""The step before all events."""
_NO_BANKS = CORE.room("dl_bank", 0)
_NUMBERS = (
    "t", "t_cov", "t_imu", "t_velocity", "sighted", "agreed", "heading_seen", "steered", "swung", "ins_var_m2_s2",
    "jolt_var_m2_s2", "jolt_var_rad2", "over_pad", "coast_s", "nis_mean", "nis_claimed", "heading_held_s",
)  # fmt: skip
_FLAGS = ("heading_is_given", "heading_known")
_MATRICES = ("R", "R_cov", "turned", "cov_levelled_by")
_VECTORS = ("x", "ins_p", "ins_v", "vessel_before")
_TUPLES = ("dv", "dp", "w", "w_smooth", "f")
_AXES = tuple(tuple([i for i in range(4) if mask >> i & 1]) for mask in range(16))
"""The axes of a velocity and of a vessel's report, by the bits of the core's mask."""
_UNCOMPARED = {number: Outcome(verdict) for number, verdict in _VERDICTS.items()}
"""The outcomes of measurements that were compared with nothing, by the core's number of the verdict."""


class PackedBelief:
    """A belief in the core's layout. It is immutable, as a belief is.

    Args:
        block: the bytes that its numbers, the core's `dl_belief`, are among.
        at: where they begin.
        pointer: C's pointer to it.

    Attributes:
        P: its covariance, (N, N).
        sea: its deck motion bank.
    """

    __slots__ = ("P", "_at", "_belief", "_block", "_pointer", "_whole", "sea")

    def __init__(self, block: NDArray[Any], at: int, pointer: Any, P: F64, sea: PackedSea) -> None:
        self._block, self._at, self._pointer, self.P, self.sea = block, at, pointer, P, sea
        self._belief: Belief | None = None
        self._whole: Any = None

    @classmethod
    def of(cls, b: Belief) -> PackedBelief:
        """Return a belief as the core holds it."""
        numbers = _written(b).reshape(1)
        made = cls(numbers, 0, CORE.array("dl_belief", numbers, 1), np.ascontiguousarray(b.P), PackedSea.of(b.sea))
        made._belief = b
        return made

    @property
    def numbers(self) -> NDArray[Any]:
        """The core's `dl_belief`, an array without axes."""
        return np.ndarray((), _BELIEF, self._block, self._at)

    @property
    def t(self) -> int:
        """The belief's instant, ns."""
        return self._pointer[0].t  # type: ignore[no-any-return]

    @property
    def belief(self) -> Belief:
        """The belief."""
        if self._belief is None:
            self._belief = _read(self.numbers, self.P, self.sea)
        return self._belief

    @property
    def whole(self) -> Any:
        """The core's `dl_whole_belief`."""
        if self._whole is None:
            self._whole = _new(_WHOLE, (self._pointer, _lent(_DOUBLES, self.P), self.sea.pointer))
        return self._whole

    def apart(self, P: F64, sea: PackedSea) -> PackedBelief:
        """Return the same belief in memory of its own, with this covariance and bank."""
        copy, pointer = CORE.copied("dl_belief", self._pointer)
        return PackedBelief(copy, 0, pointer, P, sea)

    def follow(self, params: FilterParams, events: Sequence[PackedEvent]) -> Followed:
        """Return the beliefs after each of the events, which are in order.

        They are fewer than the events where the next one is not the core's to process.
        """
        n = len(events)
        seen = [one.seen for one in events if one.seen]
        steps, covariances = CORE.block("dl_filter_step", n), np.empty((n, N, N))
        banks = CORE.room("dl_bank", len(seen)) if seen else _NO_BANKS
        row = _new(_ROW, (steps[1], _lent(_DOUBLES, covariances), banks[1]))
        records = _lent(_EVENTS, b"".join([one.record for one in events]))
        sightings = _lent(_SIGHTINGS, b"".join(seen)) if seen else CORE.ffi.NULL
        done = CORE.lib.dl_filter_run(params.core, n, records, len(seen), sightings, self.whole, row)
        return Followed(self, done, steps, covariances, banks)

    def propagated(self, t: int, params: FilterParams, how_far: int) -> PackedBelief:
        """Return the belief at instant `t`, ns; `how_far` is `DL_WITH_COVARIANCE` or `DL_WITH_AIDING` of the core."""
        (block, pointer), P = CORE.block("dl_belief", 1), np.empty((N, N))
        CORE.lib.dl_filter_propagate(params.core, how_far, t, self.whole, pointer, CORE.array("double", P, N * N))
        return PackedBelief(block, 0, pointer, P, self.sea)


class Followed(Sequence[PackedBelief]):
    """The beliefs after a row of events. Each is made on demand: most are never needed.

    Args:
        before: the belief before the first event.
        done: how many events were processed.
        steps: the core's `dl_filter_step` of each event, as bytes and as C's.
        covariances, banks: what the core wrote, and room for more.
    """

    __slots__ = ("_P", "_banks", "_before", "_block", "_made", "_pointer")

    def __init__(
        self,
        before: PackedBelief,
        done: int,
        steps: tuple[NDArray[Any], Any],
        covariances: F64,
        banks: tuple[NDArray[Any], Any],
    ) -> None:
        self._before = before.P, before.sea
        self._made: list[PackedBelief | None] = [None] * done
        self._block, self._pointer = steps
        last = self._pointer[done - 1] if done else _NOTHING
        self._P = _kept(covariances, last.P_index + 1)
        self._banks = [PackedSea(banks[0][i, ...], banks[1] + i) for i in range(last.bank_index + 1)]

    def __len__(self) -> int:
        return len(self._made)

    def __getitem__(self, i: Any) -> Any:
        made = self._made[i]
        if made is None:
            made = self._made[i] = self._belief(i % len(self._made))
        return made

    def outcomes(self, n: int) -> Sequence[Outcome]:
        """Return what became of the first events."""
        each, ends = self._block.data, range(_OUTCOME_AT + _OUTCOME_BYTES, n * _STEP_BYTES + 1, _STEP_BYTES)
        rows = b"".join([each[end - _OUTCOME_BYTES : end] for end in ends])
        return Late(n, partial(_outcomes, rows))

    def first(self, n: int) -> tuple[PackedBelief, ...]:
        """Return the first beliefs in memory of their own, so that the rest of the row can be freed."""
        P, sea = self._before
        covariances, seas = {-1: P}, {id(sea): sea}
        out = []
        for i in range(n):
            b, slot = self._belief(i), self._pointer[i].P_index
            if slot not in covariances:
                covariances[slot] = b.P.copy()
            if id(b.sea) not in seas:
                seas[id(b.sea)] = b.sea.apart()
            out.append(b.apart(covariances[slot], seas[id(b.sea)]))
        return tuple(out)

    def _belief(self, i: int) -> PackedBelief:
        P, sea = self._before
        step = self._pointer[i]
        if self._P is not None and step.P_index >= 0:
            P = self._P[step.P_index]
        if step.bank_index >= 0:
            sea = self._banks[step.bank_index]
        return PackedBelief(self._block, i * _STEP_BYTES + _AFTER_AT, _member(step, "after"), P, sea)


def _kept(block: F64, used: int) -> F64 | None:
    """Return what the core has used, not to be written to; the history keeps no room for more."""
    if used == 0:
        return None
    kept = block if used == len(block) else block[:used].copy()
    kept.setflags(write=False)
    return kept


def _outcomes(rows: bytes) -> list[Outcome]:
    """Return the core's `dl_outcome`s."""
    heads = _lent(_HEADS, rows)
    table = np.ndarray((len(heads),), _OUTCOME, rows)
    innov, S = table["innov"], table["S"]
    return [_outcome(head, innov[i], S[i]) if head.m else _UNCOMPARED[head.verdict] for i, head in enumerate(heads)]


def _outcome(head: Any, innov: F64, S: F64) -> Outcome:
    """Return the core's `dl_outcome` of a measurement that was compared."""
    m = head.m
    cov = S[: m * m].reshape(m, m) if head.has_S else None
    return Outcome(_VERDICTS[head.verdict], innov[:m], cov, head.nis, head.nis_max, _AXES[head.axes])


def _written(b: Belief) -> NDArray[Any]:
    """Return the core's `dl_belief`."""
    values = {name: getattr(b, name) for name in (*_NUMBERS, *_FLAGS, *_TUPLES, *_VECTORS, *_MATRICES)}
    excesses = b.excesses
    return CORE.record(
        "dl_belief",
        **values,
        is_levelled=b.levelled_by is not None,
        levelled_by=() if b.levelled_by is None else b.levelled_by,
        wave_w=b.sea.w_rad_s,
        wave_zeta=b.sea.zeta,
        wave_sigma=b.sea.sigma,
        rejections=b.rejections._asdict(),
        aids=[_written_aid(kind, aid) for kind, aid in enumerate(b.aids)],
        excesses={
            "n": min(len(excesses.t), EXCESSES_MAX),
            "t": np.array(excesses.t[-EXCESSES_MAX:], dtype=np.int64),
            "values": np.ravel(excesses.values[-EXCESSES_MAX:]),
        },
    )


def _written_aid(kind: int, aid: Aid) -> dict[str, Any]:
    some = aid.gathered
    values: dict[str, Any] = {"fused": aid.fused, "refused": aid.refused}
    if some is None:
        return values
    m, columns = len(some.innov), SAMPLE_COLUMNS[kind]
    H = np.zeros((m, COLUMNS_MAX))
    H[:, : len(columns)] = some.H[:, columns]
    return values | {
        "n": some.n,
        "since": some.since,
        "m": m,
        "axes": sum(1 << axis for axis in some.axes),
        "deck_weight": some.deck_weight,
        "innov": some.innov,
        "H": H,
        **{name: np.broadcast_to(getattr(some, name), (m, m)) for name in ("R", "ambiguity", "spread")},
    }


def _read(record: NDArray[Any], P: F64, sea: PackedSea) -> Belief:
    """Return the core's `dl_belief` with its covariance and bank."""
    record.setflags(write=False)
    P.setflags(write=False)
    fields: dict[str, Any] = {name: record[name].item() for name in _NUMBERS}
    fields |= {name: tuple(record[name].tolist()) for name in _TUPLES}
    fields |= {name: record[name] for name in _VECTORS}
    fields |= {name: record[name].reshape(3, 3) for name in _MATRICES}
    fields |= {name: bool(record[name]) for name in _FLAGS}
    streak, excesses = record["rejections"], record["excesses"]
    n = excesses["n"].item()
    return Belief(
        **fields,
        P=P,
        levelled_by=record["levelled_by"].reshape(3, 3) if record["is_levelled"] else None,
        sea=sea.bank,
        rejections=RejectionStreak(**{name: _plain(streak[name]) for name in RejectionStreak._fields}),
        excesses=InnovationExcesses(
            tuple(excesses["t"][:n].tolist()), tuple(map(tuple, excesses["values"].reshape(-1, EXCESS_NUMBERS)[:n].tolist()))
        ),
        aids=tuple([_read_aid(kind, aid) for kind, aid in enumerate(record["aids"])]),
    )


def _plain(value: NDArray[Any]) -> Any:
    return tuple(value.tolist()) if value.ndim else value.item()


def _read_aid(kind: int, aid: Any) -> Aid:
    fused, refused, n, since, m, axes = (aid[name].item() for name in ("fused", "refused", "n", "since", "m", "axes"))
    if n == 0:
        return Aid(None, fused, refused)
    H = np.zeros((m, N))
    columns = SAMPLE_COLUMNS[kind]
    H[:, columns] = aid["H"].reshape(3, COLUMNS_MAX)[:m, : len(columns)]
    R, ambiguity, spread = (aid[name][: m * m].reshape(m, m) for name in ("R", "ambiguity", "spread"))
    innov = tuple(aid["innov"][:m].tolist())
    return Aid(Gathered(n, since, _AXES[axes], aid["deck_weight"].item(), H, ambiguity, spread, innov, R), fused, refused)
