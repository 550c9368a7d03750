"""The filter's state as tests read and write it: `Belief` for the core's `dl_belief` with its covariance and bank.

`process_event` puts one event into a filter that holds a belief, and `holding` makes such a filter.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from estimator.contracts.estimates import Verdict
from estimator.contracts.fusion import COMPONENTS
from estimator.contracts.geometry import F64
from estimator.contracts.motion import G_M_S2
from estimator.core.abi import DL_DIRECTIONS, DL_MEMBERS
from estimator.core.library import CORE
from estimator.ekf import EkfOptions, Event, Filter
from estimator.ekf.deck_motion_bank import packed_members
from estimator.ekf.params import FilterParams
from estimator.ekf.state import (
    ATT_AXES,
    ATT_BIAS,
    BARO_OFFSET,
    DECK_DISP,
    DECK_RATE,
    DECK_TRIM,
    PAD_YAW,
    POS_AXES,
    POS_DOWN,
    RANGE_OFFSET,
    VEL_AXES,
    VEL_SCALE,
    VESSEL_VEL,
    WAVES,
    N,
)
from tests.support.core_parts import PARTS, PARTS_DOOR, part

Vec3 = tuple[float, float, float]
G_NED = np.array([0.0, 0.0, G_M_S2])
HORIZONS_S = np.array([1.0, 2.0, 3.0])
COLUMNS_MAX, EXCESSES_MAX, EXCESS_NUMBERS = 12, 24, 6
MEMBER_STATES, MEMBER_PAIRS = 7, 28

ATTITUDE, VELOCITY, RANGE, HEIGHT = range(4)
"""Kinds of aiding that are averaged before they are fused."""
SAMPLE_COLUMNS = (
    [*ATT_AXES, *ATT_BIAS],
    [*ATT_AXES, *VEL_AXES, *range(N)[VESSEL_VEL], *DECK_RATE[:3], VEL_SCALE],
    [*ATT_AXES, *POS_AXES, DECK_DISP[3], DECK_TRIM[0], DECK_DISP[4], DECK_TRIM[1], PAD_YAW, RANGE_OFFSET],
    [POS_DOWN, DECK_DISP[2], BARO_OFFSET],
)
"""The states on which each kind of aiding depends, in the order of the core's Jacobians."""


NO_VEC3: Vec3 = (0.0, 0.0, 0.0)


_PAIRS = np.triu_indices(MEMBER_STATES)
_PAIR_AT = np.zeros((MEMBER_STATES, MEMBER_STATES), dtype=int)
_PAIR_AT[_PAIRS] = _PAIR_AT[_PAIRS[::-1]] = np.arange(MEMBER_PAIRS)
"""(7, 7) where the upper triangle in rows has the entries of a symmetric matrix."""


def stationary(w_rad_s: F64, zeta: F64) -> F64:
    """Return the stationary covariance of the states for sigma = 1, (..., 4, 4), for parameters of any one shape (...).

    It is the closed-form solution of the Lyapunov equation; see docs/estimator.md, section "Waves".
    """
    w, delta = np.asarray(w_rad_s), np.asarray(zeta * w_rad_s)
    w2, force = w * w, 8.0 * delta * delta
    P = np.zeros((*w.shape, 4, 4))
    P[..., 0, 0] = 1.0
    P[..., 1, 1] = w2
    P[..., 2, 2] = force
    P[..., 3, 3] = force * w2
    P[..., 0, 2] = P[..., 2, 0] = 2.0 * delta
    P[..., 1, 3] = P[..., 3, 1] = 2.0 * delta * w2
    return P


class IssuedForecast(NamedTuple):
    """The forecast that was made at one instant."""

    t: int
    """Instant of the forecast, ns."""
    waves: F64
    """(3, 5, 2) displacement and rate by horizon and direction (m, m/s; rad, rad/s for roll and pitch)."""


class Skill(NamedTuple):
    """The sums over past comparisons of forecast and observed waves, which fade with time.

    A sea with two wave systems is no single oscillator, so the member of the bank that fits the recent motion best may forecast
    the next seconds badly, with full amplitude. The regression slope of the observed on the forecast motion is the factor that
    minimises the squared error. What the scaled forecasts have missed nonetheless widens the bands of the next ones.
    """

    issued: tuple[IssuedForecast, ...]
    """The forecasts whose longest horizon has not passed yet, oldest first."""
    n: F64
    """(3,) faded number of comparisons by horizon."""
    product: F64
    """(3, 5, 2) faded sum of forecast times observed motion."""
    square: F64
    """(3, 5, 2) faded sum of the squared forecast motion."""
    came: F64
    """(3, 5, 2) faded sum of the squared motion that came."""


class DeckMotionBank(NamedTuple):
    """Learned state. `w_rad_s`, `zeta`, `sigma` are its summary: (5,), for north, east, down in m, roll, pitch in rad."""

    t: int
    """ns, of the newest look; -1 before the first."""
    log_weight: F64
    """(5, G)"""
    x: F64
    """(5, G, 7) each member's [displacement, rate, force, its rate, offset of the IMU's carrying on, its rate, acceleration]."""
    pairs: F64
    """(5, 28, G) the upper triangle of each member's covariance, in rows."""
    skill: Skill
    """The skill of the bank's past forecasts."""
    weight: F64
    """(5, G), sums to one."""
    w_rad_s: F64
    zeta: F64
    sigma: F64

    @property
    def P(self) -> F64:
        """(5, G, 7, 7) covariance of each member."""
        return self.pairs[:, _PAIR_AT].transpose(0, 3, 1, 2)

    @property
    def at_rest(self) -> F64:
        """(5, 4, 4) stationary covariance of the summary's oscillators for sigma = 1."""
        return stationary(self.w_rad_s, self.zeta)


class Gathered(NamedTuple):
    """The samples of one kind of aiding that wait to be fused together."""

    n: int
    since: int
    """Instant of the first sample, ns."""
    axes: tuple[int, ...]
    """The components of a velocity that were measured."""
    deck_weight: float
    """Weight of the hypothesis that the velocity is relative to the deck: 0 over the ground, 1 over the deck."""
    H: F64
    """(m, N) Jacobian at `since`."""
    ambiguity: F64
    """(m, m) covariance that the uncertainty of `deck_weight` adds to the noise."""
    spread: F64
    """(m, m) covariance of the prediction at `since`, including `ambiguity`."""
    innov: tuple[float, ...]
    """(m,) sum of the innovations."""
    R: F64
    """(m, m) sum of the samples' covariances."""


class Aid(NamedTuple):
    """The state of one kind of aiding."""

    gathered: Gathered | None = None
    fused: int = -1
    """Instant of the last fusion, ns; -1 if there was none."""
    refused: int = -1
    """Instant of the first sample in the current rejection streak, ns; -1 if there is none."""


class RejectionStreak(NamedTuple):
    """Consecutive rejected sightings that agree with one another."""

    n: int = 0
    since: int = 0
    last: int = 0
    offset_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pad position of the newest sighting minus the predicted one, m, in ned."""
    var_m2: float = 0.0


class InnovationExcesses(NamedTuple):
    """Excess of the newest sightings' squared innovations over their largest expected value, oldest first."""

    t: tuple[int, ...] = ()
    """Instants of the sightings, ns."""
    values: tuple[tuple[float, ...], ...] = ()
    """Excess of each sighting along north, east, down, m^2, and how likely the ship accelerates north, east and in heading
    (`estimator/core/filter/deck_jolt.h`)."""


class Belief(NamedTuple):
    """The state at `t`. Its values are never written to: each step makes a new one.

    `x` and `P` hold at `t_cov`. `dv`, `dp`, `turned` and `coast_s` accumulate the IMU samples since then and enter with the next
    `motion.propagate_covariance`.
    """

    t: int
    R: F64
    """(3, 3) R_ned_body at `t`."""
    x: F64
    """(N,) state."""
    P: F64
    """(N, N) covariance of the error state."""
    t_cov: int
    R_cov: F64
    """`R` at `t_cov`."""
    dv: Vec3
    """(3,) integral of the specific force in ned since `t_cov`, m/s."""
    dp: Vec3
    """(3,) second integral of the specific force in ned since `t_cov`, m."""
    turned: F64
    """(3, 3) integral of `R` since `t_cov`, s."""
    coast_s: float
    """Time since `t_cov` without an IMU, s."""
    t_imu: int
    """Instant of the newest IMU sample, ns; -1 if there is none."""
    w: Vec3
    """(3,) rate as the gyro measured it, rad/s."""
    w_smooth: Vec3
    """(3,) gyro rate after a first-order low-pass, rad/s: as far as the newest is from it, a stamp's error misses the rate."""
    f: Vec3
    """(3,) specific force as the accelerometer measured it, m/s^2."""
    levelled_by: F64 | None
    """(3, 3) R_ned_body of the vehicle's own attitude, propagated by the gyro; None before the first attitude sample."""
    cov_levelled_by: F64
    """(3, 3) covariance that the attitude sample reported, rad^2."""
    heading_is_given: bool
    """True if north comes from an attitude sample. If not, north is the direction in which the body first pointed."""
    ins_p: F64
    """(3,) position of the body by the IMU alone, m. The deck motion bank learns the sea from it."""
    ins_v: F64
    ins_var_m2_s2: float
    """Variance, (m/s)^2, that `ins_v` gained beyond the IMU's noise since the deck motion bank last received a sighting."""
    jolt_var_m2_s2: float
    """Variance since `t_cov`, (m/s)^2, from accelerometer samples beyond what the vehicle can do."""
    jolt_var_rad2: float
    """Variance since `t_cov`, rad^2, from gyro samples beyond what the vehicle can do."""
    aids: tuple[Aid, ...]
    """One entry for each kind of aiding."""
    over_pad: float
    """Log-odds that the velocity sensor sees the pad's deck and not the ground."""
    t_velocity: int
    """Instant of the newest velocity sample, ns; -1 if there is none."""
    sea: DeckMotionBank
    rejections: RejectionStreak
    sighted: int
    """Instant of measurement of the newest fused sighting, ns; -1 if there is none or it was forgotten."""
    agreed: int
    """Number of sightings fused since the belief was last initialized or reset."""
    nis_mean: float
    """Recent mean of the sightings' NIS over their degrees of freedom; rejected sightings count."""
    nis_claimed: float
    """The same by what sightings claim to the last tenth of a millimetre, for how much less than that they are off."""
    excesses: InnovationExcesses
    """Excess of the last sightings' errors over what the filter claimed."""
    heading_known: bool
    """True if a sighting or a vessel report has given the heading of the pad's arrow."""
    heading_held_s: float
    """Time for which sightings have agreed with the heading minus the time for which they have contradicted it, s."""
    heading_seen: int
    """Instant of the newest sighting that measured a heading, ns; -1 if there is none."""
    steered: int
    """Instant of the newest sighting that showed a manoeuvre of the ship, ns; -1 if there is none."""
    swung: int
    """Instant of the newest sighting that showed a hard turn of the ship, ns; -1 if there is none."""
    vessel_before: F64
    """The vessel's velocity before her newest manoeuvre in the frame of `ins_v`, (2,) m/s north and east."""

    def changed(self, **fields: Any) -> Belief:
        """Return the belief with these fields replaced."""
        return self._replace(**fields)


def waves_unknown(sea: DeckMotionBank) -> F64:
    """Return the (5, 4, 4) covariance of the oscillators while only their amplitude is known."""
    return np.asarray((sea.sigma**2)[:, None, None] * sea.at_rest)


class Outcome(Struct, frozen=True, eq=False):
    """Outcome of one event. It is small: re-propagation repeats many events, and discards their outcomes."""

    verdict: Verdict
    innovation: Sequence[float] | F64 | None = None
    """(m,) measured minus predicted, None where nothing was compared."""
    innovation_cov: F64 | None = None
    """(m, m) covariance of the innovation."""
    nis: float = math.nan
    nis_max: float = math.nan
    """The gate's limit of the NIS."""
    axes: tuple[int, ...] = ()
    """Indices of the m components among those of the event's source; by default the first m."""


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


def write_belief(b: Belief) -> NDArray[Any]:
    """Return the core's `dl_belief`."""
    values = {name: getattr(b, name) for name in (*_NUMBERS, *_FLAGS, *_TUPLES, *_VECTORS, *_MATRICES)}
    excesses = b.excesses
    return PARTS_DOOR.record(
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


def read_belief(record: NDArray[Any], P: F64, sea: DeckMotionBank) -> Belief:
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
        sea=sea,
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


def read_bank(record: NDArray[Any]) -> DeckMotionBank:
    record.setflags(write=False)
    known = record["skill"]
    waves = (3, DL_DIRECTIONS, 2)
    issued = known["issued"][: known["issued_n"].item()]
    product, square, came = (known[name].reshape(waves) for name in ("product", "square", "came"))
    return DeckMotionBank(
        record["t"].item(),
        record["log_weight"].reshape(DL_DIRECTIONS, DL_MEMBERS),
        record["x"].reshape(DL_DIRECTIONS, MEMBER_STATES, DL_MEMBERS).transpose(0, 2, 1),
        record["P"].reshape(DL_DIRECTIONS, MEMBER_PAIRS, DL_MEMBERS),
        Skill(
            tuple([IssuedForecast(one["t"].item(), one["waves"].reshape(waves)) for one in issued]),
            known["n"],
            product,
            square,
            came,
        ),
        record["weight"].reshape(DL_DIRECTIONS, DL_MEMBERS),
        *(record[name] for name in ("w_rad_s", "zeta", "sigma")),
    )


def write_bank(bank: DeckMotionBank) -> NDArray[Any]:
    known = bank.skill
    skill: dict[str, Any] = {name: getattr(known, name) for name in ("n", "product", "square", "came")}
    skill |= {"issued_n": len(known.issued), "issued": [one._asdict() for one in known.issued]}
    values = {name: getattr(bank, name) for name in ("t", "w_rad_s", "zeta", "sigma", "log_weight", "weight")}
    return PARTS_DOOR.record("dl_bank", **values, x=bank.x.transpose(0, 2, 1), P=bank.pairs, skill=skill)


@lru_cache(maxsize=1)
def unknown() -> DeckMotionBank:
    """Return a bank that has received no sighting."""
    made = PARTS_DOOR.record("dl_bank")
    part("bank_begin")(packed_members(), made)
    return read_bank(made)


def holding(b: Belief | None, params: FilterParams) -> Filter:
    """Return a filter that holds a belief and has received nothing since; None for one that knows nothing."""
    filter = Filter(params.options)
    if b is None:
        return filter
    parts = np.array([0, -1, -1, 0, 0, 2, 2], np.int64), write_belief(b), np.ascontiguousarray(b.P), write_bank(b.sea)
    return Filter(params.options, b"".join([each.tobytes() for each in parts]))


def belief_of(filter: Filter, t: int = 2**62) -> Belief | None:
    """Return the belief after the last event of a filter that is not later than an instant, ns."""
    pointer = part("filter_before")(PARTS.cast("dl_filter *", int(CORE.ffi.cast("intptr_t", filter._core))), t)
    if pointer == PARTS.NULL:
        return None
    dtype = PARTS_DOOR.dtype("dl_belief")
    numbers = np.frombuffer(bytes(PARTS.buffer(PARTS.addressof(pointer[0], "belief"))), dtype)[0, ...]
    P = np.frombuffer(bytes(PARTS.buffer(pointer.P.P))).reshape(N, N)
    sea = np.frombuffer(bytes(PARTS.buffer(PARTS.addressof(pointer.bank[0], "bank"))), PARTS_DOOR.dtype("dl_bank"))[0, ...]
    return read_belief(numbers, P, read_bank(sea))


def process_event(b: Belief | None, event: Event, params: FilterParams) -> tuple[Belief | None, Outcome]:
    """Return the belief after one event, which must not be older than the belief, and the event's outcome."""
    filter = holding(b, params)
    outcome = outcome_of(filter, event)
    return belief_of(filter), outcome


def follow(b: Belief, events: Sequence[Event], params: FilterParams) -> list[tuple[Belief, Outcome]]:
    """Return the belief after each of some events and its outcome, by one filter."""
    filter, made = holding(b, params), []
    for event in events:
        outcome = outcome_of(filter, event)
        after = belief_of(filter)
        assert after is not None
        made.append((after, outcome))
    return made


def outcome_of(filter: Filter, event: Event) -> Outcome:
    """Put an event into a filter; return its outcome."""
    (result,) = filter.put([event])
    axes: tuple[int, ...] = ()
    if result.innovation is not None and result.source in ("velocity", "vessel"):
        axes = tuple(COMPONENTS[result.source].index(name) for name in result.components)
    nis_max = result.nis / result.test_ratio if result.test_ratio > 0.0 else math.nan
    return Outcome(result.verdict, result.innovation, result.innovation_cov, result.nis, nis_max, axes)


def newest(filter: Filter) -> Belief:
    """Return the belief after the last event of a filter that has begun."""
    found = belief_of(filter)
    assert found is not None
    return found


def copied(filter: Filter) -> Filter:
    """Return a filter that remembers what this one does and goes its own way."""
    return Filter(filter.options, filter.save())


def initial(options: EkfOptions, t: int, R: F64, sigma_tilt_rad: float, sigma_heading_rad: float, sea: DeckMotionBank) -> Belief:
    """Return a belief that knows an attitude and nothing else."""
    x = np.zeros(N)
    x[VEL_SCALE] = options.velocity_scale
    P = np.diag(FilterParams(options).initial_var)
    down = R.T[:, 2]
    P[:3, :3] = sigma_tilt_rad**2 * (np.eye(3) - np.outer(down, down)) + sigma_heading_rad**2 * np.outer(down, down)
    P[WAVES[:, :, None], WAVES[:, None, :]] = waves_unknown(sea)
    z3 = np.zeros(3)
    return Belief(
        t=t, R=R, x=x, P=P, t_cov=t, R_cov=R, dv=NO_VEC3, dp=NO_VEC3, turned=np.zeros((3, 3)), coast_s=0.0,
        t_imu=-1, w=NO_VEC3, w_smooth=NO_VEC3, f=NO_VEC3, levelled_by=None, cov_levelled_by=np.zeros((3, 3)),
        heading_is_given=False, ins_p=z3, ins_v=z3, ins_var_m2_s2=0.0, jolt_var_m2_s2=0.0, jolt_var_rad2=0.0,
        aids=(Aid(),) * 4, over_pad=0.0, t_velocity=-1, sea=sea, rejections=RejectionStreak(),
        sighted=-1, agreed=0, nis_mean=1.0, nis_claimed=1.0, excesses=InnovationExcesses(), heading_known=False,
        heading_held_s=0.0, heading_seen=-1, steered=-1, swung=-1, vessel_before=np.zeros(2),
    )  # fmt: skip
