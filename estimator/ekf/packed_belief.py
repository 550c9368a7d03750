"""Beliefs as the native core holds them, and the calls of the core that make one of another.

A packed belief is one in the layout of the core's header: its numbers, its covariance and its deck motion bank, each in
a block that later beliefs share until an event changes it. It becomes a `Belief` when one asks.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import Struct

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64
from estimator.core import abi
from estimator.core.abi import COLUMNS_MAX, EXCESSES_MAX, KINDS
from estimator.core.interface import places_of, size_of
from estimator.core.library import CORE, address, start_of
from estimator.ekf.deck_motion_bank import SEA_SIZE, PackedSea
from estimator.ekf.outcome import Outcome
from estimator.ekf.packed_event import PackedEvent
from estimator.ekf.state import SAMPLE_COLUMNS, Aid, Belief, Gathered, InnovationExcesses, N, RejectionStreak
from estimator.late import Late

if TYPE_CHECKING:
    from estimator.ekf.motion import ProcessNoise

_RUN, _PROPAGATE, _SETTLE = (CORE.function(name) for name in ("filter_run", "filter_propagate", "filter_settle"))
_VERDICTS = {getattr(abi, v.name): v for v in (Verdict.FUSED, Verdict.GATED, Verdict.SINGULAR, Verdict.LOW_CONFIDENCE)}


_BELIEF, _AID, _OUTCOME = places_of("belief"), places_of("aid"), places_of("outcome")
_SIZE, _AID_SIZE, _OUTCOME_SIZE = size_of("belief"), size_of("aid"), size_of("outcome")
_P_SIZE = N * N
_PLAIN = (
    "ins_var_m2_s2", "jolt_var_m2_s2", "jolt_var_rad2", "over_pad", "coast_s", "nis_mean", "heading_held_s",
)  # fmt: skip
_INTEGERS = ("t", "t_cov", "t_imu", "t_velocity", "sighted", "agreed", "heading_seen")
_FLAGS = ("heading_is_given", "heading_known")
_MATRICES = ("R", "R_cov", "turned", "cov_levelled_by")
_VECTORS = ("x", "ins_p", "ins_v")
_TUPLES = ("dv", "dp", "w", "w_smooth", "f")
_AID_INTEGERS = ("fused", "refused", "n", "since", "m", "axes")
_AIDS = _BELIEF["aids"].start + _AID_SIZE * np.arange(KINDS)[:, None] + [_AID[name].start for name in _AID_INTEGERS]
"""(KINDS, 6) places of the integers of every kind of aiding."""
_AXES = tuple(tuple([i for i in range(4) if mask >> i & 1]) for mask in range(16))
"""The axes of a velocity and of a vessel's report, by the bits of the core's mask."""
_NONE_GATHERED = (0, 0, 0, 0)
_HEAD = 4
"""Number of integers with which the core's `outcome` begins."""
_INNOV_AT, _COV_AT, _NIS_AT = (_OUTCOME[name].start for name in ("innov", "S", "nis"))
_EXCESSES = places_of("innovation_excesses")
_UNCOMPARED = {number: Outcome(verdict) for number, verdict in _VERDICTS.items()}
"""The outcomes of measurements that were compared with nothing, by the core's number of the verdict."""


class Words(Struct, frozen=True, eq=False):
    """Words at a place in a block of words of eight bytes."""

    block: F64
    at: int
    """Index of its first word in the block."""
    address: int
    """Address of its first word."""

    def part(self, at: int) -> Words:
        """Return the words that begin so many words later."""
        return Words(self.block, self.at + at, self.address + 8 * at)

    def read(self, size: int) -> F64:
        """Return so many words."""
        found = self.block[self.at : self.at + size]
        found.setflags(write=False)
        return found


class PackedBelief:
    """A belief in the core's layout. It is immutable, as a belief is.

    Attributes:
        numbers: the core's `belief`.
        P: its covariance.
        sea: its deck motion bank.
    """

    __slots__ = ("P", "_belief", "numbers", "sea")

    def __init__(self, numbers: Words, P: Words, sea: PackedSea) -> None:
        self.numbers, self.P, self.sea = numbers, P, sea
        self._belief: Belief | None = None

    @classmethod
    def of(cls, b: Belief) -> PackedBelief:
        """Return a belief as the core holds it."""
        words = np.zeros(_SIZE)
        P = np.ascontiguousarray(b.P)
        _write(words, b)
        made = cls(Words(words, 0, start_of(words)), Words(P.reshape(-1), 0, address(P)), PackedSea.of(b.sea))
        made._belief = b
        return made

    @property
    def t(self) -> int:
        """The belief's instant, ns."""
        return int(self.numbers.read(_SIZE)[_BELIEF["t"]].view(np.int64).item())

    @property
    def belief(self) -> Belief:
        """The belief."""
        if self._belief is None:
            self._belief = _read(self.numbers.read(_SIZE), self.P.read(_P_SIZE).reshape(N, N), self.sea)
        return self._belief

    def follow(self, noise: ProcessNoise, events: Sequence[PackedEvent]) -> Followed:
        """Return the beliefs after each of the events, which are in order.

        They are fewer than the events where the next one is not the core's to process.
        """
        n = len(events)
        seen = [one.seen for one in events if one.seen]
        block, covariances = np.empty(n * (_OUTCOME_SIZE + 2 + _SIZE)), np.empty(n * _P_SIZE)
        start, P_start, seas, sea_start = start_of(block), start_of(covariances), None, 0
        if seen:
            seas = np.empty(len(seen) * SEA_SIZE)
            sea_start = start_of(seas)
        at = n * _OUTCOME_SIZE
        index = start + 8 * at
        done = _RUN(
            noise.packed_address, n, b"".join([one.record for one in events]), b"".join(seen),
            self.numbers.address, self.P.address, self.sea.address, index + 16 * n, P_start, sea_start,
            index, index + 8 * n, start,
        )  # fmt: skip
        slots = block[at : at + 2 * n].view(np.int64).tolist()
        P = sea = None
        if done and slots[done - 1] >= 0:
            P = _kept(covariances, (slots[done - 1] + 1) * _P_SIZE)
        if done and seas is not None and slots[n + done - 1] >= 0:
            sea = _kept(seas, (slots[n + done - 1] + 1) * SEA_SIZE)
        return Followed(self, done, slots, Words(block, at + 2 * n, index + 16 * n), P, sea)

    def propagated(self, t: int, noise: ProcessNoise, how_far: int) -> PackedBelief:
        """Return the belief at instant `t`, ns; `how_far` is one of `STATE_ALONE`, `WITH_COVARIANCE`, `WITH_AIDING`."""
        block = np.empty(_SIZE + _P_SIZE)
        start = start_of(block)
        P = Words(block, _SIZE, start + 8 * _SIZE)
        changed = _PROPAGATE(noise.packed_address, how_far, t, self.numbers.address, self.P.address, start, P.address)
        return PackedBelief(Words(block, 0, start), P if changed else self.P, self.sea)

    def settled(self, noise: ProcessNoise) -> tuple[Belief, F64, F64]:
        """Return the belief with everything but `P` propagated from `t_cov` to `t`, and the (N, N) F and Q that propagate `P`."""
        block, F, Q = np.empty(_SIZE), np.empty((N, N)), np.empty((N, N))
        start = start_of(block)
        _SETTLE(noise.packed_address, self.numbers.address, start, start_of(F), start_of(Q))
        return PackedBelief(Words(block, 0, start), self.P, self.sea).belief, F, Q


def _kept(block: F64, used: int) -> Words:
    """Return the words that the core has used; the history keeps no room for more."""
    kept = block if used == block.size else block[:used].copy()
    return Words(kept, 0, start_of(kept))


def _own(words: Words, size: int) -> Words:
    block = words.read(size).copy()
    return Words(block, 0, start_of(block))


class Followed(Sequence[PackedBelief]):
    """The beliefs after a row of events. Each is made when one asks: of most of them nobody ever does."""

    __slots__ = ("_P", "_before", "_made", "_numbers", "_seas", "_seas_made", "_slots")

    def __init__(
        self, before: PackedBelief, done: int, slots: list[int], numbers: Words, P: Words | None, seas: Words | None
    ) -> None:
        self._before, self._slots, self._numbers, self._P, self._seas = (before.P, before.sea), slots, numbers, P, seas
        self._made: list[PackedBelief | None] = [None] * done
        self._seas_made: dict[int, PackedSea] = {}

    def __len__(self) -> int:
        return len(self._made)

    def __getitem__(self, i: Any) -> Any:
        made = self._made[i]
        if made is None:
            made = self._made[i] = self._belief(i % len(self._made))
        return made

    def outcomes(self, n: int) -> Sequence[Outcome]:
        """Return what became of the first events."""
        rows = self._numbers.block[: n * _OUTCOME_SIZE].copy()
        rows.setflags(write=False)
        return Late(n, partial(_outcomes, rows, n))

    def first(self, n: int) -> tuple[PackedBelief, ...]:
        """Return the first beliefs in memory of their own, so that the rest of the row can be freed."""
        P, sea = self._before
        covariances, seas = {P.address: P}, {sea.address: sea}
        out = []
        for b in map(self._belief, range(n)):
            if b.P.address not in covariances:
                covariances[b.P.address] = _own(b.P, _P_SIZE)
            if b.sea.address not in seas:
                seas[b.sea.address] = b.sea.apart()
            out.append(PackedBelief(_own(b.numbers, _SIZE), covariances[b.P.address], seas[b.sea.address]))
        return tuple(out)

    def _belief(self, i: int) -> PackedBelief:
        P, sea = self._before
        slot, sea_slot = self._slots[i], self._slots[len(self._slots) // 2 + i]
        if self._P is not None and slot >= 0:
            P = self._P.part(slot * _P_SIZE)
        if self._seas is not None and sea_slot >= 0:
            sea = self._sea(sea_slot, self._seas)
        return PackedBelief(self._numbers.part(i * _SIZE), P, sea)

    def _sea(self, slot: int, seas: Words) -> PackedSea:
        if slot not in self._seas_made:
            part = seas.part(slot * SEA_SIZE)
            self._seas_made[slot] = PackedSea(part.block, part.at, part.address)
        return self._seas_made[slot]


def _outcomes(rows: F64, n: int) -> list[Outcome]:
    """Return the core's `outcome`s of so many events."""
    table = rows.reshape(n, _OUTCOME_SIZE)
    heads, compared = table[:, :_HEAD].view(np.int64).tolist(), table[:, _NIS_AT : _NIS_AT + 2].tolist()
    return [
        _outcome(rows, _OUTCOME_SIZE * i, head, *compared[i]) if head[1] else _UNCOMPARED[head[0]] for i, head in enumerate(heads)
    ]


def _outcome(rows: F64, first: int, head: list[int], nis: float, nis_max: float) -> Outcome:
    """Return the core's `outcome` that begins at a word with these integers, of a measurement that was compared."""
    verdict, m, axes, has_S = head
    innov, S = first + _INNOV_AT, first + _COV_AT
    cov = rows[S : S + m * m].reshape(m, m) if has_S else None
    return Outcome(_VERDICTS[verdict], rows[innov : innov + m], cov, nis, nis_max, _AXES[axes])


def _write(words: F64, b: Belief) -> None:
    """Write the core's `belief`."""
    integers = words.view(np.int64)
    for name in _INTEGERS:
        integers[_BELIEF[name]] = getattr(b, name)
    for name in _FLAGS:
        integers[_BELIEF[name]] = getattr(b, name)
    streak = b.rejections
    for name, value in (("rejected_n", streak.n), ("rejected_since", streak.since), ("rejected_last", streak.last)):
        integers[_BELIEF[name]] = value
    words[_BELIEF["rejected_offset_ned"]], words[_BELIEF["rejected_var_m2"]] = streak.offset_ned, streak.var_m2
    for name in (*_PLAIN, *_TUPLES, *_VECTORS):
        words[_BELIEF[name]] = getattr(b, name)
    for name in _MATRICES:
        words[_BELIEF[name]] = getattr(b, name).ravel()
    if b.levelled_by is not None:
        integers[_BELIEF["is_levelled"]] = 1
        words[_BELIEF["levelled_by"]] = b.levelled_by.ravel()
    words[_BELIEF["wave_w"]], words[_BELIEF["wave_zeta"]], words[_BELIEF["wave_sigma"]] = b.sea.w_rad_s, b.sea.zeta, b.sea.sigma
    integers[_AIDS] = [(aid.fused, aid.refused, *_gathered_integers(aid.gathered)) for aid in b.aids]
    for kind, aid in enumerate(b.aids):
        if aid.gathered is not None:
            at = _BELIEF["aids"].start + kind * _AID_SIZE
            _write_gathered(words[at : at + _AID_SIZE], kind, aid.gathered)
    _write_excesses(words[_BELIEF["excesses"]], b.excesses)


def _gathered_integers(some: Gathered | None) -> tuple[int, int, int, int]:
    if some is None:
        return _NONE_GATHERED
    return some.n, some.since, len(some.innov), sum(1 << axis for axis in some.axes)


def _write_gathered(words: F64, kind: int, some: Gathered) -> None:
    m = len(some.innov)
    words[_AID["deck_weight"]] = some.deck_weight
    words[_AID["innov"]][:m] = some.innov
    for name, matrix in (("R", some.R), ("ambiguity", some.ambiguity), ("spread", some.spread)):
        words[_AID[name]][: m * m] = np.broadcast_to(matrix, (m, m)).ravel()
    columns = SAMPLE_COLUMNS[kind]
    words[_AID["H"]].reshape(3, COLUMNS_MAX)[:m, : len(columns)] = some.H[:, columns]


def _write_excesses(words: F64, excesses: InnovationExcesses) -> None:
    n = min(len(excesses.t), EXCESSES_MAX)
    words.view(np.int64)[_EXCESSES["n"]] = n
    words[_EXCESSES["t"]].view(np.int64)[:n] = excesses.t[len(excesses.t) - n :]
    words[_EXCESSES["values"]].reshape(-1, 3)[:n] = np.reshape(excesses.values[len(excesses.t) - n :], (-1, 3))


def _read(words: F64, P: F64, sea: PackedSea) -> Belief:
    """Return the core's `belief` with its covariance and bank."""
    integers = words.view(np.int64)
    fields: dict[str, Any] = {name: integers.item(_BELIEF[name].start) for name in _INTEGERS}
    fields |= {name: words.item(_BELIEF[name].start) for name in _PLAIN}
    fields |= {name: tuple(words[_BELIEF[name]].tolist()) for name in _TUPLES}
    fields |= {name: words[_BELIEF[name]] for name in _VECTORS}
    fields |= {name: words[_BELIEF[name]].reshape(3, 3) for name in _MATRICES}
    fields |= {name: bool(integers.item(_BELIEF[name].start)) for name in _FLAGS}
    n, since, last = (integers.item(_BELIEF[f"rejected_{name}"].start) for name in ("n", "since", "last"))
    x, y, z = words[_BELIEF["rejected_offset_ned"]].tolist()
    start = _BELIEF["aids"].start
    return Belief(
        **fields,
        P=P,
        levelled_by=words[_BELIEF["levelled_by"]].reshape(3, 3) if integers.item(_BELIEF["is_levelled"].start) else None,
        sea=sea.bank,
        rejections=RejectionStreak(n, since, last, (x, y, z), words.item(_BELIEF["rejected_var_m2"].start)),
        excesses=_read_excesses(words[_BELIEF["excesses"]]),
        aids=tuple(
            [
                Aid(_read_gathered(words[start + k * _AID_SIZE :], k, *gathered) if gathered[0] else None, fused, refused)
                for k, (fused, refused, *gathered) in enumerate(integers[_AIDS].tolist())
            ]
        ),
    )


def _read_excesses(words: F64) -> InnovationExcesses:
    n = words[_EXCESSES["n"]].view(np.int64).item()
    values = words[_EXCESSES["values"]].reshape(-1, 3)[:n].tolist()
    return InnovationExcesses(tuple(words[_EXCESSES["t"]].view(np.int64)[:n].tolist()), tuple([(x, y, z) for x, y, z in values]))


def _read_gathered(words: F64, kind: int, n: int, since: int, m: int, axes: int) -> Gathered:
    H = np.zeros((m, N))
    columns = SAMPLE_COLUMNS[kind]
    H[:, columns] = words[_AID["H"]].reshape(3, COLUMNS_MAX)[:m, : len(columns)]
    R, ambiguity, spread = (words[_AID[name]][: m * m].reshape(m, m) for name in ("R", "ambiguity", "spread"))
    innov = tuple(words[_AID["innov"]][:m].tolist())
    return Gathered(n, since, _AXES[axes], words.item(_AID["deck_weight"].start), H, ambiguity, spread, innov, R)
