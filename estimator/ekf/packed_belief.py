"""Beliefs as the native core holds them, and the calls of the core that make one of another.

A packed belief is one in the layout of `estimator.core.interface`: the numbers that samples change, the covariance, and the
Python belief from which the rest (the deck motion bank, the heading's record) is taken. It becomes a `Belief` when one asks.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude, Baro, BodyVelocity, Imu, Range
from estimator.core.interface import COLUMNS_MAX, CONSTANTS, KINDS, ROWS_MAX, places_of, size_of
from estimator.core.library import CORE, address, start_of
from estimator.ekf import deck_motion_bank, gate
from estimator.ekf.outcome import Outcome
from estimator.ekf.state import ATTITUDE, HEIGHT, RANGE, SAMPLE_COLUMNS, VELOCITY, Aid, Belief, Gathered, N, RejectionStreak

if TYPE_CHECKING:
    from estimator.ekf.motion import ProcessNoise

Sample = Imu | Attitude | BodyVelocity | Range | Baro
"""What the core processes."""
STATE_ALONE, WITH_COVARIANCE, WITH_AIDING = (CONSTANTS[name] for name in ("STATE_ALONE", "WITH_COVARIANCE", "WITH_AIDING"))
"""How far `propagate` goes: the covariance as often as the options ask, to the instant, or with all gathered samples fused."""

_RUN, _PROPAGATE, _SETTLE = (CORE.function(name) for name in ("filter_run", "filter_propagate", "filter_settle"))
_VERDICTS = {CONSTANTS[v.name]: v for v in (Verdict.FUSED, Verdict.GATED, Verdict.SINGULAR)}


_BELIEF, _AID, _OUTCOME = places_of("belief"), places_of("aid"), places_of("outcome")
_SIZE, _AID_SIZE, _OUTCOME_SIZE = size_of("belief"), size_of("aid"), size_of("outcome")
_P_SIZE = N * N
_PLAIN = ("ins_var_m2_s2", "jolt_var_m2_s2", "jolt_var_rad2", "over_pad", "coast_s")
_INTEGERS = ("t", "t_cov", "t_imu", "t_velocity", "sighted", "agreed")
_MATRICES = ("R", "R_cov", "turned", "cov_levelled_by")
_VECTORS = ("x", "ins_p", "ins_v")
_TUPLES = ("dv", "dp", "w", "w_smooth", "f")
_AID_INTEGERS = ("fused", "refused", "n", "since", "m", "axes")
_AIDS = _BELIEF["aids"].start + _AID_SIZE * np.arange(KINDS)[:, None] + [_AID[name].start for name in _AID_INTEGERS]
"""(KINDS, 6) places of the integers of every kind of aiding."""
_AXES = tuple(tuple([i for i in range(3) if mask >> i & 1]) for mask in range(8))
"""The axes of a velocity, by the bits of the core's mask."""
_NONE_GATHERED = (0, 0, 0, 0)
_EVENT = struct.Struct("2q18d")
_NO_VALUES = (0.0,) * 18
_OUTCOME_WORDS = struct.Struct(f"3q{_OUTCOME_SIZE - 3}d")
_WITHOUT_COMPARISON = {verdict: Outcome(verdict) for verdict in _VERDICTS.values()}


class Words(NamedTuple):
    """Words at a place in a block of words of eight bytes."""

    block: F64
    at: int
    """Index of its first word in the block."""
    address: int
    """Address of its first word."""

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
    """

    __slots__ = ("P", "_belief", "_rest", "numbers")

    def __init__(self, numbers: Words, P: Words, rest: Belief) -> None:
        self.numbers, self.P, self._rest = numbers, P, rest
        self._belief: Belief | None = None

    @classmethod
    def of(cls, b: Belief) -> PackedBelief:
        """Return a belief as the core holds it."""
        words = np.zeros(_SIZE)
        P = np.ascontiguousarray(b.P)
        _write(words, b)
        made = cls(Words(words, 0, start_of(words)), Words(P.reshape(-1), 0, address(P)), b)
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
            P = self.P.read(_P_SIZE).reshape(N, N)
            self._belief = _read(self.numbers.read(_SIZE), P, self._rest)
        return self._belief

    def follow(self, noise: ProcessNoise, events: Sequence[bytes]) -> tuple[list[PackedBelief], Outcome]:
        """Return the beliefs after each of the events, which are in order, and the first one's outcome.

        They are fewer than the events where the next one is not the core's to process.
        """
        n = len(events)
        at = _OUTCOME_SIZE + n
        block, covariances = np.empty(at + n * _SIZE), np.empty(n * _P_SIZE)
        start, P_start = start_of(block), start_of(covariances)
        done = _RUN(
            noise.packed_address, n, b"".join(events), self.numbers.address, self.P.address,
            start + 8 * at, P_start, start + 8 * _OUTCOME_SIZE, start,
        )  # fmt: skip
        made = []
        P, slot_before = self.P, -1
        for i, slot in enumerate(block[_OUTCOME_SIZE : _OUTCOME_SIZE + done].view(np.int64).tolist()):
            if slot != slot_before:
                P, slot_before = Words(covariances, slot * _P_SIZE, P_start + 8 * slot * _P_SIZE), slot
            here = at + i * _SIZE
            made.append(PackedBelief(Words(block, here, start + 8 * here), P, self._rest))
        return made, _outcome(block) if made else _WITHOUT_COMPARISON[Verdict.GATED]

    def propagated(self, t: int, noise: ProcessNoise, how_far: int) -> PackedBelief:
        """Return the belief at instant `t`, ns; `how_far` is one of `STATE_ALONE`, `WITH_COVARIANCE`, `WITH_AIDING`."""
        block = np.empty(_SIZE + _P_SIZE)
        start = start_of(block)
        P = Words(block, _SIZE, start + 8 * _SIZE)
        changed = _PROPAGATE(noise.packed_address, how_far, t, self.numbers.address, self.P.address, start, P.address)
        return PackedBelief(Words(block, 0, start), P if changed else self.P, self._rest)

    def settled(self, noise: ProcessNoise) -> tuple[Belief, F64, F64]:
        """Return the belief with everything but `P` propagated from `t_cov` to `t`, and the (N, N) F and Q that propagate `P`."""
        block, F, Q = np.empty(_SIZE), np.empty((N, N)), np.empty((N, N))
        start = start_of(block)
        _SETTLE(noise.packed_address, self.numbers.address, start, start_of(F), start_of(Q))
        return PackedBelief(Words(block, 0, start), self.P, self._rest).belief, F, Q


def packed_params(noise: ProcessNoise) -> F64:
    """Return the core's `filter_params` for these options and noises."""
    o, places = noise.options, places_of("filter_params")
    words = np.zeros(size_of("filter_params"))
    integers = words.view(np.int64)
    surface = {"auto": "OVER_EITHER", "either": "OVER_EITHER", "pad": "OVER_PAD"}.get(o.velocity_is_over, "OVER_GROUND")
    integers[places["hold_ns"]] = round(o.hold_s * 1e9)
    integers[places["velocity_is_over"]] = CONSTANTS[surface]
    for name in (
        "tick_s",
        "forget_s",
        "aiding_period_s",
        "accel_step_m_s2",
        "gyro_step_rad_s",
        "deck_radius_m",
        "sigma_wave_yaw_rate_rad_s",
    ):
        words[places[name]] = getattr(o, name)
    for name in ("psd", "psd_accel", "psd_coast", "psd_coast_turn", "not_measured_var"):
        words[places[name]] = getattr(noise, name)
    words[places["correlation_s"]] = (
        o.attitude_correlation_s, o.velocity_correlation_s, o.range_correlation_s, o.baro_correlation_s,
    )  # fmt: skip
    words[places["nis_max"]] = [gate.nis_max(o.gate_probability, dof) for dof in range(1, ROWS_MAX + 1)]
    by = noise.carrying
    for name, asd in (("accel", by.asd_accel), ("drift", by.asd_drift), ("tilt", by.asd_tilt)):
        words[places[f"carrying_psd_{name}"]] = asd**2
    words[places["members"]] = deck_motion_bank.packed_members()
    words[places["wave_yaw_rad_s"]] = 2.0 * np.pi / o.wave_yaw_period_s
    words.setflags(write=False)
    return words


def packed_sample(sample: Sample) -> bytes:
    """Return a sample as the core's `event`."""
    t = sample.stamp.measured_at
    match sample:
        case Imu():
            kind, values = CONSTANTS["IMU"], (*sample.w_body.tolist(), *sample.f_body.tolist())
        case Attitude():
            kind, values = ATTITUDE, (*sample.R_ned_body.matrix.ravel().tolist(), *sample.cov_body.ravel().tolist())
        case BodyVelocity():
            kind, values = VELOCITY, (*sample.v_level.tolist(), *sample.cov_level.ravel().tolist())
        case Range():
            kind, values = RANGE, (sample.range_m, sample.sigma_m)
        case Baro():
            kind, values = HEIGHT, (sample.height_m, sample.sigma_m)
    return _EVENT.pack(kind, t, *values, *_NO_VALUES[len(values) :])


def _outcome(block: F64) -> Outcome:
    """Return the core's `outcome` at the beginning of a block."""
    verdict, m, axes, *numbers = _OUTCOME_WORDS.unpack_from(block.data)
    if m == 0:
        return _WITHOUT_COMPARISON[_VERDICTS[verdict]]
    innov, S, (nis, nis_max) = numbers[:m], numbers[3 : 3 + m * m], numbers[-2:]
    return Outcome(_VERDICTS[verdict], innov, np.array(S).reshape(m, m), nis, nis_max, _AXES[axes])


def _write(words: F64, b: Belief) -> None:
    """Write the core's `belief`."""
    integers = words.view(np.int64)
    for name in _INTEGERS:
        integers[_BELIEF[name]] = getattr(b, name)
    integers[_BELIEF["heading_is_given"]] = b.heading_is_given
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


def _read(words: F64, P: F64, rest: Belief) -> Belief:
    """Return the core's `belief`, with what it does not hold taken from `rest`."""
    integers = words.view(np.int64)
    fields: dict[str, object] = {name: integers.item(_BELIEF[name].start) for name in _INTEGERS}
    fields |= {name: words.item(_BELIEF[name].start) for name in _PLAIN}
    fields |= {name: tuple(words[_BELIEF[name]].tolist()) for name in _TUPLES}
    fields |= {name: words[_BELIEF[name]] for name in _VECTORS}
    fields |= {name: words[_BELIEF[name]].reshape(3, 3) for name in _MATRICES}
    n, since, last = (integers.item(_BELIEF[f"rejected_{name}"].start) for name in ("n", "since", "last"))
    x, y, z = words[_BELIEF["rejected_offset_ned"]].tolist()
    start = _BELIEF["aids"].start
    return rest.changed(
        **fields,
        P=P,
        heading_is_given=bool(integers.item(_BELIEF["heading_is_given"].start)),
        levelled_by=words[_BELIEF["levelled_by"]].reshape(3, 3) if integers.item(_BELIEF["is_levelled"].start) else None,
        rejections=RejectionStreak(n, since, last, (x, y, z), words.item(_BELIEF["rejected_var_m2"].start)),
        aids=tuple(
            [
                Aid(_read_gathered(words[start + k * _AID_SIZE :], k, *gathered) if gathered[0] else None, fused, refused)
                for k, (fused, refused, *gathered) in enumerate(integers[_AIDS].tolist())
            ]
        ),
    )


def _read_gathered(words: F64, kind: int, n: int, since: int, m: int, axes: int) -> Gathered:
    H = np.zeros((m, N))
    columns = SAMPLE_COLUMNS[kind]
    H[:, columns] = words[_AID["H"]].reshape(3, COLUMNS_MAX)[:m, : len(columns)]
    R, ambiguity, spread = (words[_AID[name]][: m * m].reshape(m, m) for name in ("R", "ambiguity", "spread"))
    innov = tuple(words[_AID["innov"]][:m].tolist())
    return Gathered(n, since, _AXES[axes], words.item(_AID["deck_weight"].start), H, ambiguity, spread, innov, R)
