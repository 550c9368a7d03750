"""Aiding by the vehicle's own sensors in numpy: samples are averaged over a short period and fused together."""

import math

import numpy as np

from estimator.contracts.estimates import Verdict
from estimator.contracts.geometry import F64
from estimator.contracts.samples import Baro, BodyVelocity, Range
from estimator.ekf.options import EkfOptions
from estimator.ekf.params import FilterParams
from estimator.ekf.params import nis_max as limit
from estimator.ekf.state import (
    ATT_BIAS,
    ATT_ERR,
    BARO_OFFSET,
    PAD_YAW,
    POS_DOWN,
    POS_EAST,
    POS_NORTH,
    POS_REL,
    VEL,
    VEL_EAST,
    VEL_NORTH,
    VEL_SCALE,
    VESSEL_EAST,
    VESSEL_NORTH,
    VESSEL_VEL,
    WAVES,
    N,
)
from tests.estimator.ekf.belief import ATTITUDE, HEIGHT, RANGE, VELOCITY, Aid, Belief, Gathered, Outcome
from tests.estimator.ekf.oracle import algebra, measure, motion
from tests.estimator.ekf.oracle.algebra import nis_of
from tests.estimator.ekf.oracle.pad_velocity import pad_velocity
from tests.estimator.ekf.oracle.propagate import corrected, propagated
from tests.estimator.ekf.oracle.sighting import LinearizedMeasurement

_STUCK_S = 1.0
"""Length of a rejection streak after which a kind of aiding is accepted again, with what it contradicts made uncertain."""
_OVER_MEMORY_S = 3.0
"""Time constant with which the evidence of velocity samples about the surface below decays."""
_OVER_EXPECTED = 3.0
"""Log-odds of measuring against the deck when the body is surely over it, and against the water when it surely is not."""
_UNSEEN_EXPECTED = -4.0
"""The same while the pad was never seen, and the least then."""
_KNOWN_VAR = 0.25
"""Variance of the vessel's velocity, (m/s)^2, below which her reports tell what a deck that was never seen does."""
_REFUTED = 6.0
"""NIS above which a hypothesis is refuted by its own covariance; one true sample in twenty exceeds it."""
_NO_AMBIGUITY = np.zeros(())
Innov = tuple[float, ...]
"""(m,) innovation."""
_CORRELATION = (
    "attitude_correlation_s", "velocity_correlation_s", "range_correlation_s", "baro_correlation_s",
)  # fmt: skip


def fuse_velocity(b: Belief, event: BodyVelocity, params: FilterParams) -> tuple[Belief, Outcome]:
    """Fuse a velocity over the ground or over the deck.

    If the options do not say which, the samples decide between the two hypotheses, and the remaining ambiguity widens the noise.
    """
    o = params.options
    b = propagated(b, event.stamp.measured_at, params)
    is_open = _surface_is_open(b, o)
    if is_open:
        b = _seen_below(b, event, o)
    deck_weight = _deck_weight(b, o, is_open)
    v, cov = event.v_level, event.cov_level
    axes = measure.measured_axes(cov)
    if not axes or (deck_weight == 1.0 and b.sighted < 0 and not is_open) or motion.is_swung(b, b.t):
        return b, Outcome(Verdict.GATED)
    over = motion.peek_velocity(b)
    if deck_weight > 0.0:
        (x, y, z), (north, east, down) = over, pad_velocity(b.x)
        over = x - deck_weight * north, y - deck_weight * east, z - deck_weight * down
    expected = measure.measured_velocity(over, b.R, b.x.item(VEL_SCALE))
    innov = tuple([v.item(i) - expected[i] for i in axes])
    cov = cov[_picked(axes)][:, _picked(axes)]
    begun = _begun(b, VELOCITY, innov, cov, params, axes, deck_weight)
    edge = _refused_at_an_edge(b, event, begun, innov, cov, o) if is_open and begun is not None else None
    return gather(b, VELOCITY, innov, cov, params, axes=axes, deck_weight=deck_weight) if edge is None else (b, edge)


def _surface_is_open(b: Belief, o: EkfOptions) -> bool:
    """Return whether samples can tell the deck from the water."""
    known = float(np.trace(b.P[VESSEL_VEL, VESSEL_VEL])) < _KNOWN_VAR
    return o.velocity_is_over in ("auto", "either") and (b.sighted >= 0 or known)


def _deck_weight(b: Belief, o: EkfOptions, is_open: bool) -> float:
    if not is_open:
        return 1.0 if o.velocity_is_over == "pad" else 0.0
    deck_weight = 1.0 / (1.0 + math.exp(-b.over_pad))
    return 0.0 if deck_weight < 0.03 else 1.0 if deck_weight > 0.97 else deck_weight


def _seen_below(b: Belief, event: BodyVelocity, o: EkfOptions) -> Belief:
    """Update the log-odds between the two hypotheses about a velocity. Correlated samples count as one."""
    since = 1.0 if b.t_velocity < 0 else (b.t - b.t_velocity) * 1e-9
    if since < 0.5 * o.velocity_correlation_s:
        return b
    x = motion.peek(b)
    away, spread = _foot(b, x)
    expected = 0.0
    if b.sighted < 0:
        expected = _UNSEEN_EXPECTED
    elif away + 2.0 * spread < o.deck_radius_m:
        expected = _OVER_EXPECTED
    elif away - 2.0 * spread > 4.0 * o.deck_radius_m:
        expected = -_OVER_EXPECTED
    odds = expected + (b.over_pad - expected) * math.exp(-since / _OVER_MEMORY_S)
    ground, deck = (measure.velocity(x, b.R, event.v_level, event.cov_level, deck_weight) for deck_weight in (0.0, 1.0))
    if ground is None or deck is None:
        return b
    evidence = _for_the_deck(ground, deck, b.P)
    odds += evidence * min(1.0, 0.5 * since / o.velocity_correlation_s)
    least = _UNSEEN_EXPECTED if b.sighted < 0 else -6.0
    return b._replace(over_pad=max(least, min(6.0, odds)), t_velocity=b.t)


def _refused_at_an_edge(b: Belief, event: BodyVelocity, begun: Gathered, innov: Innov, R: F64, o: EkfOptions) -> Outcome | None:
    """Return the outcome of a sample that contradicts the assumed surface and not the other one; None of others."""
    S = begun.spread + R
    nis = nis_of(innov, S)
    if nis is None or nis < _REFUTED:
        return None
    x = motion.peek(b)
    ground, deck = (measure.velocity(x, b.R, event.v_level, event.cov_level, deck_weight) for deck_weight in (0.0, 1.0))
    if ground is None or deck is None:
        return None
    if (1.0 if begun.deck_weight < 0.5 else -1.0) * _for_the_deck(ground, deck, b.P) <= 0.0:
        return None
    return Outcome(Verdict.GATED, innov, S, nis, limit(o.gate_probability, len(innov)), begun.axes)


def _for_the_deck(ground: LinearizedMeasurement, deck: LinearizedMeasurement, P: F64) -> float:
    """Return the log-odds, -3..3, by which one sample favours a velocity over the deck against one over the ground."""
    by_ground, by_deck = (row.H.dot(P).dot(row.H.T) + row.R for row in (ground, deck))
    misfit_ground, misfit_deck = nis_of(ground.innov, by_ground), nis_of(deck.innov, by_deck)
    least = _REFUTED
    if misfit_ground is not None and misfit_deck is not None and max(misfit_ground, misfit_deck) < _REFUTED:
        # Neither hypothesis is refuted. Both are tested with the sum of both covariances; otherwise the current hypothesis would
        # win because it has made itself certain.
        both, least = by_ground + by_deck - ground.R, 0.0
        misfit_ground, misfit_deck = nis_of(ground.innov, both), nis_of(deck.innov, both)
    if misfit_ground is None or misfit_deck is None:
        return 0.0
    return max(-3.0, min(3.0, 0.5 * (max(misfit_ground, least) - max(misfit_deck, least))))


def fuse_range(b: Belief, event: Range, params: FilterParams) -> tuple[Belief, Outcome]:
    """Fuse a distance along the body's down axis. It is refused before the first sighting and beyond the deck's edge."""
    b = propagated(b, event.stamp.measured_at, params)
    if b.sighted < 0:
        return b, Outcome(Verdict.GATED)
    x = motion.peek(b)
    # There is water beyond the deck's edge.
    away, spread = _foot(b, x)
    row = None if away + 2.0 * spread > params.options.deck_radius_m else measure.distance(x, b.R, event.range_m, event.sigma_m)
    if row is None:
        return b, Outcome(Verdict.GATED)
    return gather(b, RANGE, tuple(row.innov.tolist()), row.R, params)


def _foot(b: Belief, x: F64) -> tuple[float, float]:
    """Return the distance from the pad's centre at which the body's down axis meets the deck, and its sigma, metres."""
    c = b.R[:, 2]
    foot = x[POS_REL] - c * float(x[POS_DOWN] / max(c[2], 0.3))
    spread = math.sqrt(max(float(b.P[POS_NORTH, POS_NORTH] + b.P[POS_EAST, POS_EAST]) / 2.0, 0.0))
    return math.hypot(float(foot[0]), float(foot[1])), spread


def fuse_baro(b: Belief, event: Baro, params: FilterParams) -> tuple[Belief, Outcome]:
    """Fuse a barometric height. It is refused before the first sighting."""
    b = propagated(b, event.stamp.measured_at, params)
    if b.sighted < 0:
        return b, Outcome(Verdict.GATED)
    innov = event.height_m - (motion.peek_height(b) + b.x.item(BARO_OFFSET))
    return gather(b, HEIGHT, (innov,), np.array([[event.sigma_m * event.sigma_m]]), params)


def gather(
    b: Belief, kind: int, innov: Innov, R: F64, params: FilterParams, axes: tuple[int, ...] = (), deck_weight: float = 0.0
) -> tuple[Belief, Outcome]:
    """Add a sample to those that are fused at the end of the aiding period, unless the gate rejects it.

    The covariance of the prediction changes little within a period, so it is computed for the period's first sample only.

    Args:
        innov: (m,) innovation with its noise R (m, m).
        axes: components of a velocity that the innovation holds.
        deck_weight: 0 for a velocity over the ground, 1 for one over the pad's deck.
    """
    o = params.options
    aid = b.aids[kind]
    so_far = _begun(b, kind, innov, R, params, axes, deck_weight)
    if so_far is None:
        return b, Outcome(Verdict.GATED)
    S = so_far.spread + R
    nis = nis_of(innov, S)
    if nis is None:
        return b, Outcome(Verdict.SINGULAR, innov, S, axes=axes)
    nis_max = limit(o.gate_probability, len(innov))
    if nis > nis_max:
        since = aid.refused if aid.refused >= 0 else b.t
        if (b.t - since) * 1e-9 > _STUCK_S:
            b = _inflated(b, kind, np.array(innov))
            since = -1
        return _with_aid(b, kind, aid._replace(refused=since)), Outcome(Verdict.GATED, innov, S, nis, nis_max, axes)
    if kind == VELOCITY and aid.refused >= 0 and axes[:2] == (0, 1):
        b = b._replace(P=_drifting(b.P, np.array(innov)))
    n, since, _, _, H, ambiguity, spread, innov_sum, R_sum = so_far
    innov_sum = tuple([total + one for total, one in zip(innov_sum, innov, strict=True)])
    so_far = Gathered(n + 1, since, axes, deck_weight, H, ambiguity, spread, innov_sum, R_sum + R)
    b = _with_aid(b, kind, Aid(so_far, aid.fused))
    first = min([other.gathered.since for other in b.aids if other.gathered])
    if (b.t - first) * 1e-9 >= o.aiding_period_s or aid.fused < 0:
        b = aided(b, params)
    return b, Outcome(Verdict.FUSED, innov, S, nis, nis_max, axes)


def _begun(
    b: Belief, kind: int, innov: Innov, R: F64, params: FilterParams, axes: tuple[int, ...], deck_weight: float
) -> Gathered | None:
    """Return the samples so far of a kind, or a new period; None if nothing can be predicted."""
    so_far = b.aids[kind].gathered
    if (
        so_far is not None
        and (so_far.axes, so_far.deck_weight) == (axes, deck_weight)
        and not _stale(so_far, b.t, params.options)
    ):
        return so_far
    H, ambiguity = _predicted(b, kind, axes, deck_weight)
    if H is None:
        return None
    spread = H.dot(b.P).dot(H.T) + ambiguity
    return Gathered(0, b.t, axes, deck_weight, H, ambiguity, spread, (0.0,) * len(innov), np.zeros_like(R))


def _stale(gathered: Gathered, t: int, o: EkfOptions) -> bool:
    """Tell whether the samples are from before a pause, so that their innovations belong to a state long past."""
    return (t - gathered.since) * 1e-9 > 2.0 * o.aiding_period_s


def _with_aid(b: Belief, kind: int, aid: Aid) -> Belief:
    aids = list(b.aids)
    aids[kind] = aid
    return b.changed(aids=tuple(aids))


def _predicted(b: Belief, kind: int, axes: tuple[int, ...], deck_weight: float) -> tuple[F64 | None, F64]:
    """Return the (m, N) Jacobian of a kind of aiding and the (m, m) noise that an uncertain `deck_weight` adds."""
    if kind == ATTITUDE:
        return measure.BY_ATTITUDE, _NO_AMBIGUITY
    if kind == HEIGHT:
        return measure.BY_HEIGHT, _NO_AMBIGUITY
    x = motion.peek(b)
    if kind == RANGE:
        row = measure.distance(x, b.R, 0.0, 1.0)
        return None if row is None else row.H, _NO_AMBIGUITY
    H = measure.by_velocity(x, b.R, deck_weight)[_picked(axes)]
    ambiguity = deck_weight * (1.0 - deck_weight)
    if ambiguity == 0.0:
        return H, _NO_AMBIGUITY
    gap, slope = (part[_picked(axes)] for part in measure.by_deck_velocity(x, b.R))
    return H, ambiguity * (np.outer(gap, gap) + slope.dot(b.P).dot(slope.T) + 1e-9 * np.eye(gap.size))


def _picked(axes: tuple[int, ...]) -> slice | list[int]:
    """Return the index of some of three components; of the first ones as a slice, which numpy takes without a copy."""
    return slice(len(axes)) if axes == (0, 1, 2)[: len(axes)] else list(axes)


def aided(b: Belief, params: FilterParams) -> Belief:
    """Fuse the means of all gathered samples together.

    Gathered samples must be fused before any other correction; otherwise that correction would be applied twice.
    """
    o = params.options
    if not any(aid.gathered for aid in b.aids):
        return b
    b = motion.propagate_covariance(b, params, algebra.ALGEBRA)
    innov, H, R = [], [], []
    aids = list(b.aids)
    for kind, aid in enumerate(b.aids):
        some = aid.gathered
        if some is None or _stale(some, b.t, o):
            aids[kind] = Aid(None, aid.fused, aid.refused)
            continue
        # Errors with correlation time tau leave one independent sample in 2 tau, however many samples there are.
        window = (b.t - aid.fused) * 1e-9 if aid.fused >= 0 else math.inf
        inflation = max(1.0 / some.n, 2.0 * float(getattr(o, _CORRELATION[kind])) / max(window, 1e-3))
        innov.append(np.array(some.innov) / some.n)
        H.append(some.H)
        R.append((some.R / some.n + some.ambiguity) * inflation)
        aids[kind] = Aid(None, b.t, aid.refused)
    b = b.changed(aids=tuple(aids))
    if not innov:
        return b
    noise = np.zeros((sum(i.size for i in innov),) * 2)
    at = 0
    for block in R:
        noise[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    fix = algebra.ALGEBRA.correct(b.P, np.concatenate(innov), np.concatenate(H), noise)
    return b if fix is None else corrected(b, fix.dx, fix.P)


def _drifting(P: F64, innov: F64) -> F64:
    """Inflate the common velocity of body and vessel: they drift together."""
    g = np.zeros((N, 2))
    g[VEL_NORTH, 0] = g[VESSEL_NORTH, 0] = g[VEL_EAST, 1] = g[VESSEL_EAST, 1] = 1.0
    return np.asarray(P + g.dot(g.T) * float(innov[:2].dot(innov[:2])))


def _inflated(b: Belief, kind: int, innov: F64) -> Belief:
    """Inflate the covariance of what a rejected sensor contradicts, in directions that leave the pad's position certain."""
    P = b.P.copy()
    if kind == ATTITUDE:
        # All directions turn together about the vertical, as they do when the attitude source redefines north.
        g = np.zeros(N)
        g[ATT_ERR] = b.R.T[:, 2]
        g[PAD_YAW] = 1.0
        for part in (POS_REL, VEL, *WAVES[:3].T):
            x, y, _ = b.x[part]
            g[part] = (-y, x, 0.0)
        g[VESSEL_VEL] = (-b.x[VESSEL_EAST], b.x[VESSEL_NORTH])
        angle = float(innov.dot(b.R.T[:, 2]))
        P += np.outer(g, g) * angle**2
        size = min(float(innov.dot(innov)), 0.1)
        P[ATT_ERR, ATT_ERR] += np.eye(3) * (0.1 * size)
        P[ATT_BIAS, ATT_BIAS] += size
    elif kind == VELOCITY:
        P = _drifting(P, innov)
        P[VEL_SCALE, VEL_SCALE] += 0.01
    elif kind == HEIGHT:
        P[BARO_OFFSET, BARO_OFFSET] += float(innov[0]) ** 2
    return b._replace(P=P)
