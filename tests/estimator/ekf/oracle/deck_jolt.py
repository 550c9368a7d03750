"""Widen the belief about the deck where sightings keep missing it by more than the filter claims.

The oscillators of the main filter have the size and period that the bank has learned. A wave that nothing announced, such as
another ship's wake after a calm, is neither, and until the bank has learned it the filter takes the deck's motion for its own.
The innovations say so at once. Along each axis of `ned` the filter keeps by how much the newest squared innovations exceed the
largest that their claimed variances let expect. If the median is positive, the wave along that axis has received an acceleration
that the model does not have, and the covariance gains the median (covariance matching: Mehra, Approaches to adaptive filtering,
IEEE Trans. Automatic Control 17(5), 1972). The median ignores single wrong sightings, and a sighting with little information on
an axis neither adds to it nor scales it.

A ship that brakes or turns hard shows sooner, by a matched filter for her acceleration (Willsky, Jones, 1976). A sighting that no
such acceleration explains is a wrong one.
"""

from typing import NamedTuple

import numpy as np

from estimator.contracts.geometry import F64
from estimator.ekf.state import PAD_YAW, POS_AXES, POS_EAST, POS_NORTH, TURN_RATE, VESSEL_EAST, VESSEL_NORTH, WAVES, N
from tests.estimator.ekf.belief import EXCESSES_MAX, Belief, InnovationExcesses

RATIO_MAX = 2.5
"""Squared innovation over its variance above which the covariance grows; the median of five honest ones is above this once in
seventy times."""
_RATIO_COUNTED, _COUNTED_M2 = 49.0, 0.18**2
"""A sighting farther off than both is not counted: it is another pad or none, and the gate decides about it."""
_MEMORY_NS = 350_000_000
"""Sightings older than this, against the newest, are not counted."""
_NEEDED, _SPAN_NS = 3, 120_000_000
"""The median is of at least this many sightings that span at least so long."""
_ACTED_S, _STEERED_S = 0.3, 0.15
"""Time for which an unknown acceleration is assumed to have acted, of a wave and of the ship, s."""
_TOGETHER_S, _DEVIATES_NEEDED, _DEVIATE_MOST = 0.16, 5.0, np.array([5.0, 5.0, 9.0])
"""Two or three sightings in that time make a manoeuvre where their sum is off by so many deviations, each of so many at most."""
_LEFT_MOST = 12.0
"""Chi-square that a manoeuvre may leave of an innovation."""
_LEFT_SHARE, _LEFT_SHARE_ON, _STEERS_S = 0.05, 0.25, 0.4
"""Share of an innovation that a hard one may leave, and one that goes on for so long after it was shown, s."""
_STEERED_MOST = 0.25
"""A place, m, or heading, rad, that is further off is not that of a ship that steers."""
_UNDER_WAY_M_S = 0.3


class Steering(NamedTuple):
    """The ship's accelerations along her way, across it and in heading as a sighting shows them."""

    deviate: tuple[float, ...]
    """The displacement by each in its standard deviations."""
    var: tuple[float, ...]
    """The variance, m^2 and rad^2, that each adds to the displacement."""


def _places(x: F64) -> F64:
    """Return (3, N) the directions of state by displacement along the way, across it and in heading."""
    v = x[[VESSEL_NORTH, VESSEL_EAST]]
    speed = float(np.hypot(*v))
    north, east = v / speed if speed > _UNDER_WAY_M_S else (1.0, 0.0)
    places = np.zeros((3, N))
    places[0, [POS_NORTH, POS_EAST]] = north, east
    places[1, [POS_NORTH, POS_EAST]] = -east, north
    places[2, PAD_YAW] = 1.0
    return places


def _rates(x: F64) -> F64:
    """Return (3, N) the directions of state by the rates of those displacements."""
    rates = np.zeros((3, N))
    rates[:, [VESSEL_NORTH, VESSEL_EAST, TURN_RATE]] = _places(x)[:, [POS_NORTH, POS_EAST, PAD_YAW]]
    return rates


def steering(innov: F64, S: F64, H: F64, b: Belief) -> tuple[Steering, float]:
    """Return how an innovation (m,) of covariance S and Jacobian H (m, N) shows accelerations of the ship, and the mean NIS."""
    by, usual = H @ (_places(b.x) + 2.0 / _STEERED_S * _rates(b.x)).T, min(1.0, max(0.2, b.nis_claimed))
    inverse = np.linalg.inv(S)
    information, along = by.T @ inverse @ by, by.T @ inverse @ innov
    nis = float(innov @ inverse @ innov)
    turn = np.ix_([1, 2], [1, 2])
    by_turn = float(along[1:] @ np.linalg.pinv(information[turn]) @ along[1:])
    by_all = float(along @ np.linalg.pinv(information, hermitian=True) @ along)
    shares = [float(along[k]) ** 2 / information[k, k] if information[k, k] > 0.0 else 0.0 for k in range(3)]
    steers = b.steered >= 0 and (b.t - b.steered) * 1e-9 < _STEERS_S
    wholly = nis - by_all < nis * (_LEFT_SHARE_ON if steers else _LEFT_SHARE) and max(shares[:2]) > shares[2]
    deviate, var = [0.0] * 3, [0.0] * 3
    for k, square in enumerate(np.diagonal(information).tolist()):
        if square <= 0.0 or abs(along[k]) >= _STEERED_MOST * square:
            continue
        if wholly or nis - (shares[0] if k == 0 else by_turn) < _LEFT_MOST:
            deviate[k] = float(along[k]) / (square * usual) ** 0.5
            var[k] = max(shares[k] - usual, 0.0) / square
    return Steering(tuple(deviate), tuple(var)), b.nis_claimed + 0.1 * (min(5.0, nis / innov.size) - b.nis_claimed)


def steered(excesses: InnovationExcesses, t: int, newest: Steering) -> F64 | None:
    """Return the (3,) variances of what the sighting at t shows together with those before it; None if that is nothing."""
    counted = [
        np.clip(v[3:], -_DEVIATE_MOST, _DEVIATE_MOST) for at, v in zip(*excesses, strict=True) if (t - at) * 1e-9 <= _TOGETHER_S
    ]
    if not excesses.t or excesses.t[-1] != t:
        return None
    shows = np.zeros(3, dtype=bool)
    for n in range(2, min(len(counted), 3) + 1):
        shows |= np.abs(sum(counted[-n:])) > _DEVIATES_NEEDED * n**0.5
    var = np.where(shows, newest.var, 0.0)
    return var if bool((var > 0.0).any()) else None


def loosened(P: F64, x: F64, var: F64) -> F64:
    """Return the (N, N) covariance after accelerations of the ship that add `var` (3,), m^2 and rad^2, to the displacement."""
    by = np.stack([_places(x), _rates(x)], axis=-1)
    noise = np.array([[1.0, 1.5 / _STEERED_S], [1.5 / _STEERED_S, 3.0 / _STEERED_S**2]])
    return np.asarray(P + sum(added * one @ noise @ one.T for one, added in zip(by, var.tolist(), strict=True)))


def extended(excesses: InnovationExcesses, t: int, innov_ned: F64, cov_ned: F64, shown: Steering) -> InnovationExcesses:
    """Return the excesses after one more sighting.

    Args:
        excesses: those of the sightings before it.
        t: its instant, ns.
        innov_ned: (3,) m.
        cov_ned: (3, 3) m^2, its covariance as the filter claims it.
        shown: the ship's accelerations by it.
    """
    squares, var = innov_ned * innov_ned, np.diagonal(cov_ned)
    if (squares > np.maximum(_RATIO_COUNTED * var, _COUNTED_M2)).any():
        return excesses
    north, east, down = (squares - RATIO_MAX * var).tolist()
    first = max(sum(one < t - _MEMORY_NS for one in excesses.t), len(excesses.t) + 1 - EXCESSES_MAX)
    return InnovationExcesses((*excesses.t[first:], t), (*excesses.values[first:], (north, east, down, *shown.deviate)))


def missing(excesses: InnovationExcesses) -> F64 | None:
    """Return the (3,) variance, m^2, by which the claimed one falls short along north, east, down; None if it does nowhere."""
    if len(excesses.t) < _NEEDED or excesses.t[-1] - excesses.t[0] < _SPAN_NS:
        return None
    excess = np.array([_median(axis) for axis in zip(*(values[:3] for values in excesses.values), strict=True)])
    return None if float(excess.max()) <= 0.0 else np.asarray(np.maximum(excess, 0.0))


def _median(values: tuple[float, ...]) -> float:
    """Return the median; numpy's takes ten times as long for the few values of a third of a second."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(values) % 2 else 0.5 * (ordered[half - 1] + ordered[half])


def widened(P: F64, var_ned: F64) -> F64:
    """Return the (N, N) covariance after unknown accelerations of the deck.

    Args:
        P: (N, N) covariance.
        var_ned: (3,) variance, m^2, that the pad's displacement along north, east, down gains.
    """
    P = P.copy()
    # White acceleration for T seconds: displacement T^3 / 3, rate T, both together T^2 / 2.
    across, rate = 1.5 / _ACTED_S, 3.0 / _ACTED_S**2
    noise = np.array([[1.0, across], [across, rate]])
    for axis, var in enumerate(var_ned.tolist()):
        if var <= 0.0:
            continue
        by = np.zeros((N, 2))
        by[POS_AXES[axis], 0] = by[WAVES[axis, 0], 0] = by[WAVES[axis, 1], 1] = 1.0
        P += var * (by @ noise @ by.T)
    return P
