"""Beliefs as the native core holds them, and the calls of the core that make one of another.

A packed belief is one in the layout of `estimator/core/decklander.h`: its numbers, its covariance and its deck motion bank, each
in an array that later beliefs share until an event changes it. It becomes a `Belief` when one asks.
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
from estimator.core.abi import COLUMNS_MAX, EXCESSES_MAX
from estimator.core.library import CORE
from estimator.ekf.deck_motion_bank import PackedSea
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_event import PackedEvent
from estimator.ekf.params import FilterParams
from estimator.ekf.state import SAMPLE_COLUMNS, Aid, Belief, Gathered, InnovationExcesses, N, RejectionStreak
from estimator.late import Late

_VERDICTS = {getattr(abi, f"DL_{v.name}"): v for v in (Verdict.FUSED, Verdict.GATED, Verdict.SINGULAR, Verdict.LOW_CONFIDENCE)}
_BELIEF, _BANK, _STEP = (CORE.dtype(name) for name in ("dl_belief", "dl_bank", "dl_filter_step"))
_NUMBERS = (
    "t", "t_cov", "t_imu", "t_velocity", "sighted", "agreed", "heading_seen", "ins_var_m2_s2", "jolt_var_m2_s2", "jolt_var_rad2",
    "over_pad", "coast_s", "nis_mean", "heading_held_s",
)  # fmt: skip
_FLAGS = ("heading_is_given", "heading_known")
_MATRICES = ("R", "R_cov", "turned", "cov_levelled_by")
_VECTORS = ("x", "ins_p", "ins_v")
_TUPLES = ("dv", "dp", "w", "w_smooth", "f")
_AXES = tuple(tuple([i for i in range(4) if mask >> i & 1]) for mask in range(16))
"""The axes of a velocity and of a vessel's report, by the bits of the core's mask."""
_UNCOMPARED = {number: Outcome(verdict) for number, verdict in _VERDICTS.items()}
"""The outcomes of measurements that were compared with nothing, by the core's number of the verdict."""


class PackedBelief:
    """A belief in the core's layout. It is immutable, as a belief is.

    Attributes:
        numbers: the core's `dl_belief`.
        P: its covariance, (N, N).
        sea: its deck motion bank.
    """

    __slots__ = ("P", "_belief", "_whole", "numbers", "sea")

    def __init__(self, numbers: NDArray[Any], P: F64, sea: PackedSea) -> None:
        self.numbers, self.P, self.sea = numbers, P, sea
        self._belief: Belief | None = None
        self._whole: Any = None

    @classmethod
    def of(cls, b: Belief) -> PackedBelief:
        """Return a belief as the core holds it."""
        made = cls(_written(b), np.ascontiguousarray(b.P), PackedSea.of(b.sea))
        made._belief = b
        return made

    @property
    def t(self) -> int:
        """The belief's instant, ns."""
        return int(self.numbers["t"])

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
            self._whole = CORE.ffi.new(
                "dl_whole_belief *",
                (
                    CORE.array("dl_belief", self.numbers, 1),
                    CORE.array("double", self.P, N * N),
                    CORE.array("dl_bank", self.sea.record, 1),
                ),
            )
        return self._whole

    def follow(self, params: FilterParams, events: Sequence[PackedEvent]) -> Followed:
        """Return the beliefs after each of the events, which are in order.

        They are fewer than the events where the next one is not the core's to process.
        """
        n = len(events)
        seen = [one.seen for one in events if one.seen]
        steps, covariances, seas = np.empty(n, _STEP), np.empty((n, N, N)), np.empty(len(seen), _BANK)
        row = CORE.ffi.new(
            "dl_filter_row *",
            (CORE.array("dl_filter_step", steps), CORE.array("double", covariances), CORE.array("dl_bank", seas)),
        )
        done = CORE.lib.dl_filter_run(
            params.core,
            n,
            CORE.ffi.from_buffer("dl_event[]", b"".join([one.record for one in events])),
            len(seen),
            CORE.ffi.from_buffer("dl_sighting[]", b"".join(seen)),
            self.whole,
            row,
        )
        return Followed(self, steps, done, covariances, seas)

    def propagated(self, t: int, params: FilterParams, how_far: int) -> PackedBelief:
        """Return the belief at instant `t`, ns; `how_far` is `DL_WITH_COVARIANCE` or `DL_WITH_AIDING` of the core."""
        numbers, P = np.empty((), _BELIEF), np.empty((N, N))
        CORE.lib.dl_filter_propagate(
            params.core, how_far, t, self.whole, CORE.array("dl_belief", numbers, 1), CORE.array("double", P, N * N)
        )
        return PackedBelief(numbers, P, self.sea)


class Followed(Sequence[PackedBelief]):
    """The beliefs after a row of events. Each is made when one asks: of most of them nobody ever does.

    Args:
        before: the belief before the first event.
        steps: the core's `dl_filter_step` of each event.
        done: how many events were processed.
        covariances, seas: what the core wrote, and room for more.
    """

    __slots__ = ("_before", "_made", "_numbers", "_outcomes", "_places", "_seas", "_written")

    def __init__(self, before: PackedBelief, steps: NDArray[Any], done: int, covariances: F64, seas: NDArray[Any]) -> None:
        self._before = before.P, before.sea
        self._made: list[PackedBelief | None] = [None] * done
        self._places = [steps[name][:done].tolist() for name in ("P_index", "bank_index")]
        used = [places[-1] + 1 if done else 0 for places in self._places]
        steps.setflags(write=False)
        self._numbers, self._outcomes = steps["after"], steps["outcome"]
        self._written = _kept(covariances, used[0])
        self._seas = [PackedSea(record) for record in _each(_kept(seas, used[1]))]

    def __len__(self) -> int:
        return len(self._made)

    def __getitem__(self, i: Any) -> Any:
        made = self._made[i]
        if made is None:
            made = self._made[i] = self._belief(i % len(self._made))
        return made

    def outcomes(self, n: int) -> Sequence[Outcome]:
        """Return what became of the first events."""
        return Late(n, partial(_outcomes, self._outcomes[:n].copy()))

    def first(self, n: int) -> tuple[PackedBelief, ...]:
        """Return the first beliefs in memory of their own, so that the rest of the row can be freed."""
        P, sea = self._before
        covariances, seas = {-1: P}, {-1: sea}
        out = []
        for i, slot, sea_slot in zip(range(n), *self._places, strict=False):
            if slot not in covariances:
                covariances[slot] = self._written[slot].copy()
            if sea_slot not in seas:
                seas[sea_slot] = self._seas[sea_slot].apart()
            out.append(PackedBelief(self._numbers[i, ...].copy(), covariances[slot], seas[sea_slot]))
        return tuple(out)

    def _belief(self, i: int) -> PackedBelief:
        P, sea = self._before
        slot, sea_slot = self._places[0][i], self._places[1][i]
        return PackedBelief(
            self._numbers[i, ...], P if slot < 0 else self._written[slot], sea if sea_slot < 0 else self._seas[sea_slot]
        )


def _kept(block: NDArray[Any], used: int) -> NDArray[Any]:
    """Return what the core has used, not to be written to; the history keeps no room for more."""
    kept = block if used == len(block) else block[:used].copy()
    kept.setflags(write=False)
    return kept


def _each(records: NDArray[Any]) -> list[NDArray[Any]]:
    return [records[i, ...] for i in range(len(records))]


def _outcomes(rows: NDArray[Any]) -> list[Outcome]:
    """Return the core's `dl_outcome`s."""
    rows.setflags(write=False)
    heads = zip(*(rows[name].tolist() for name in ("verdict", "m", "axes", "has_S", "nis", "nis_max")), strict=True)
    innov, S = rows["innov"], rows["S"]
    return [
        Outcome(_VERDICTS[verdict], innov[i, :m], S[i, : m * m].reshape(m, m) if has_S else None, nis, nis_max, _AXES[axes])
        if m
        else _UNCOMPARED[verdict]
        for i, (verdict, m, axes, has_S, nis, nis_max) in enumerate(heads)
    ]


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
            tuple(excesses["t"][:n].tolist()), tuple(map(tuple, excesses["values"].reshape(-1, 3)[:n].tolist()))
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
