"""Associate a sighting with the tracked pad, or with another one.

A sighting belongs to the track if motion explains its position: it is where the belief expects the pad (this includes the IMU at
full rate), or close to the previous sighting. A pad that is followed from one frame to the next stays the tracked one also while
the estimator refuses it: the estimate is wrong then, and has its own way back. Anything else is a candidate with its own short
history. The track never moves to a candidate. After `adopt_s` with one candidate alone in view the track ends, and a new one with
a higher number begins; the consumers of the estimate see the number change. Where the pad was out of sight, a candidate that was
first seen so near to the expected position that no other pad can lie there is the tracked pad: the estimate was wrong, and the
track goes on. No other pad lies where frames have shown the deck around the tracked one without a second (`clear_m`): it could
only have come from beyond, by a drift of the estimate that is some times as large. A pad that was in sight cannot have come there
at once, however near it is: what did is not the tracked pad.

Without an attitude nothing is estimated, but the frames go on to show whether the pad has left the picture (`follow`).

Follow the pad by sightings alone, without the IMU: an arbiter beside the filter, which a lying sensor may have led away.

A Kalman filter of constant velocity for each axis, of a few numbers. It takes what the other checks let pass, in axes of fixed
heading. Where it and the steering estimate are five sigma apart for half a second, nobody steers down. After two seconds, or
where the filter has refused for as long all that the arbiter could follow, the filter is started again: by the same pad where the
arbiter could follow it all the time, and by another one where the picture leapt.
"""

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs

from estimator.contracts.geometry import F64
from estimator.contracts.samples import Attitude
from estimator.integrity.options import IntegrityOptions

_BESIDE_S = 0.1  # Largest age of a sighting whose neighbourhood may explain the next one
_SPEED_M_S = 1.0  # Allowed difference of two sightings of one pad per second between them, for the velocity over the deck
_ACCELERATION_M_S2 = 6.0  # The same for the tilt
_BELIEF_SIGMAS = 3.0  # Standard deviations of an uncertain belief that explain a distance
_BELIEF_MAX_M = 0.4  # The most of it that they explain sideways
_BELIEF_DOWN_MAX_M = 1.5  # The most in height, which has a check of its own
_SEEN_SIGMAS = 4.0  # Standard deviations of a sighting that explain a distance
_SEEN_MAX_M = 0.3  # The most of it that they explain
_TURN_RAD_S = 1.0  # Rate of turn that a vehicle exceeds only when its own hover begins, in a strong wind
_SUDDEN_S = 0.5
"""Time since the tracked pad was last seen within which no estimate has drifted off: a picture that shows it elsewhere leapt."""
_SURELY = 0.9  # Share of the distance to another pad that is left for the errors of two looks
_FARTHER = 2.0
"""Factor by which the estimate would have drifted farther if what came back were another pad than the only one ever seen."""
_CLEAR_SLOPE = 0.35  # Distance about the tracked pad over the height that a frame may show clear of a second one
_SWING_RAD_S = 4.0  # Largest rate of the body's turns while its own hover begins
_SWING_RAD = 0.35  # Largest angle of them
_ALONE_S = 0.2  # Time for which a look at one pad alone serves those after it
_DISC = np.array([(x, y) for x in np.linspace(-1, 1, 21) for y in np.linspace(-1, 1, 21) if math.hypot(x, y) < 1.05])
"""Places, (N, 2), on a disc of radius 1."""
_ALIVE_S = 1.0  # Time for which a candidate counts that is not seen again, at least
_LOOKS = 3.0  # The same as a multiple of the time between two sightings
_LATE = 0.3  # Weight of the newest time between two sightings in their mean
_MOST = 4  # Candidates that are kept
_SEEN_AT_LEAST = 3  # Sightings from which a candidate counts
_ESTABLISHED = 8  # Sightings from which a track is not left for another pad
_CHOSEN = 30
"""Number of sightings up to which a track may go on at another place that is seen more often: which pad came first was chance."""
_PSD = 4.0  # Density of the unknown acceleration of pad and vehicle, (m/s^2)^2/Hz: 2 m/s^2 that last for half a second
_SPEED_VAR = 4.0  # Variance of the velocity at the start, (m/s)^2
_FLOOR_M = 0.05  # Least standard deviation that no covariance contains: mount, level and frame delay
_FLOOR_FRACTION = 0.03  # The same by distance
_FLOOR_M_S = 0.4  # The same of the velocity
_SIGMAS = 5.0  # Standard deviations within which a sighting follows the last ones
_PAUSE_S = 0.5  # Time without a sighting after which the arbiter begins again
_FRESH_S = 0.3  # Age of the last sighting up to which it says where the pad is
_MISSES = 5  # Sightings in a row elsewhere after which the arbiter begins again
_FOLLOWED = 15  # Sightings from which the pad is followed
_APART_S = 0.5  # Time for which belief and pad are apart before one of them is wrong
_RESTART_S = 2.0  # Time after which the belief starts again


class Place(NamedTuple):
    """Position of a pad as seen from the body, in axes of fixed heading."""

    t: int
    """ns."""
    d: tuple[float, float, float]
    """Position, m; down is third."""
    sigma_m: float
    """Standard deviation of one horizontal component, m."""
    sigma_down_m: float


class TrackCandidate(NamedTuple):
    """Another position at which a pad is detected."""

    first: int
    """Its first sighting since the tracked pad was last seen, ns; one that was seen before that counts again from then on."""
    n: int
    """Number of sightings at this place."""
    last: Place
    sigmas_m: tuple[float, float] = (math.inf, math.inf)
    """Standard deviations of the estimate when the candidate was first seen, sideways and down. A candidate that the estimate did
    not explain then is not explained by a later, larger uncertainty."""
    n_alone: int = 1
    """Number of sightings at this place since the tracked pad was last seen."""
    sudden: bool = False
    """True if the tracked pad was seen just before."""
    apart_m: float = math.inf
    """Distance sideways from the pad's expected place when the candidate was first seen. The estimate, to which nothing is fused
    meanwhile, drifts away from both after that."""


class Tracks(NamedTuple):
    """The track and its rival candidates."""

    number: int = 0
    """Number of the track; 0 before the first sighting."""
    n: int = 0
    """Number of sightings of this track."""
    last: Place | None = None
    """Its newest sighting, whether or not the estimator fused it."""
    candidates: tuple[TrackCandidate, ...] = ()
    assumed: Attitude | None = None
    """The attitude that was assumed for the newest sighting, whose frame had none; None if it had one."""
    alone: tuple[Place, F64] | None = None
    """The pad's place when it was last whole and alone in the frame, and the corners, (4, 2) m, of what the frame showed."""
    clear_m: float = 0.0
    """Distance from the tracked pad within which frames have shown no second one, m; -inf once they have shown one."""
    each_s: float = 0.0
    """Mean time between two sightings of this track that were fused of late, s; 0 for those that follow within `_BESIDE_S`."""

    @property
    def alive_s(self) -> float:
        """Time for which a candidate counts that is not seen again: a few looks of a camera however slow, s."""
        return max(_ALIVE_S, _LOOKS * self.each_s)

    @property
    def leapt(self) -> bool:
        """True if the newest sighting goes on with a place to which the picture of the pad leapt."""
        return bool(self.candidates) and self.candidates[-1].sudden and self.candidates[-1].n > 1

    @property
    def disputed_at(self) -> int | None:
        """Instant at which a pad was last detected elsewhere, ns; None if that was not repeatedly."""
        return max((c.last.t for c in self.candidates if c.n >= _SEEN_AT_LEAST), default=None)


def associate(tracks: Tracks, seen: Place, expected: Place | None, o: IntegrityOptions) -> tuple[Tracks, bool]:
    """Process one sighting.

    Args:
        expected: the belief's position at that instant with its uncertainty; None without a belief.

    Returns:
        The new tracks, and whether the sighting belongs to the track. `add_fused` later reports that the estimator fused it.
    """
    last = tracks.last
    if last is None:
        return Tracks(1, 0, seen), True
    if tracks.n < _ESTABLISHED and seen.t - last.t >= _SUDDEN_S * 1e9:
        # After a few looks the belief hardly knows where the pad is by now. By how much, the filter's gate knows.
        return tracks, True
    alive = [c for c in tracks.candidates if abs(seen.t - c.last.t) <= tracks.alive_s * 1e9]
    known = next((c for c in alive if _beside(c.last, seen, o)), None)
    # What motion did not explain at first it does not explain later, when the pad may have moved further.
    nearer = known is None or _apart(last, seen)[0] <= _apart(known.last, seen)[0]
    if nearer and tracks.assumed is None and abs(seen.t - last.t) <= _BESIDE_S * 1e9 and _beside(last, seen, o):
        followed = seen.t > last.t and _apart(last, seen)[0] < 0.5 * o.pads_apart_m
        return (tracks._replace(last=seen) if followed else tracks), True
    if expected is not None:
        then = (math.inf, math.inf) if known is None else known.sigmas_m
        sigma_m, sigma_down_m = min(expected.sigma_m, then[0]), min(expected.sigma_down_m, then[1])
        if _as_expected(expected._replace(sigma_m=sigma_m, sigma_down_m=sigma_down_m), seen, o):
            return tracks, True
    candidates = _with(tracks, last, known, seen, expected)
    chosen = candidates[-1]
    # No one has flown by the track yet, so the candidate with more sightings becomes the pad.
    if tracks.n < _ESTABLISHED:
        if chosen.n > max(tracks.n, _SEEN_AT_LEAST):
            return Tracks(tracks.number, chosen.n, seen), True
    elif tracks.n < _CHOSEN and chosen.n_alone > tracks.n and _alone(chosen, candidates, tracks.alive_s):
        return Tracks(tracks.number, chosen.n, seen), True
    elif _adopted(chosen, candidates, tracks.alive_s, o):
        if chosen.sudden or chosen.apart_m >= max(0.5 * o.pads_apart_m, _surely_clear_m(tracks, chosen)):
            return Tracks(tracks.number + 1, chosen.n, seen, each_s=tracks.each_s), True
        return Tracks(tracks.number, chosen.n, seen, clear_m=tracks.clear_m, each_s=tracks.each_s), True
    return tracks._replace(candidates=candidates), False


def _surely_clear_m(tracks: Tracks, chosen: TrackCandidate) -> float:
    """Return the distance from its expected place up to which the only pad is known again, as far as the belief explains it."""
    return min(tracks.clear_m / (1.0 + _FARTHER), _BELIEF_SIGMAS * chosen.sigmas_m[0])


def asks_clear(tracks: Tracks, seen: Place) -> bool:
    """Return whether a look for a second pad beside the tracked one may show a larger part of the deck clear of any."""
    return tracks.n >= _ESTABLISHED and 0.0 <= tracks.clear_m < _CLEAR_SLOPE * seen.d[2]


def cleared(tracks: Tracks, seen: Place, alone_in: F64) -> Tracks:
    """Take what a look for a second pad has shown.

    Args:
        seen: the tracked pad in that frame.
        alone_in: as in `follow`, without a doubt.
    """
    if len(alone_in) == 0:
        return tracks._replace(clear_m=-math.inf)
    if not _inside(np.array([seen.d[:2]]), alone_in)[0]:
        return tracks
    along = np.roll(alone_in, -1, axis=0) - alone_in
    rel = np.array(seen.d[:2]) - alone_in
    edge_m = np.abs(along[:, 0] * rel[:, 1] - along[:, 1] * rel[:, 0]) / np.hypot(*along.T)
    return tracks._replace(clear_m=max(tracks.clear_m, float(edge_m.min())))


def follow(tracks: Tracks, seen: Place, assumed: Attitude, o: IntegrityOptions, alone_in: F64 | None = None) -> Tracks | None:
    """Process a place that was seen under an assumed attitude; return None if another pad can have come there unseen.

    The body's true turn moves the place, too. Another pad is seen no nearer to the last place than two pads lie apart, less what
    turn and speed can have moved between the two looks. Nor has another pad come if it would have shown beside the one or the
    other in a frame that showed one pad alone: so a pad is known again that swung out of the picture.

    Args:
        alone_in: corners, (4, 2) m in the axes of `seen`, of the deck that the frame shows with no second pad; empty if a second
            one is there, and None if that is in doubt or was not looked for.
    """
    last = tracks.last
    dt = 0.0 if last is None else (seen.t - last.t) * 1e-9
    if last is None or dt <= 0.0 or tracks.n < _ESTABLISHED:
        return None
    beside = alone_in is not None and len(alone_in) == 0
    now = None if alone_in is None or beside else (seen, alone_in)
    whole = now is not None and bool(_inside(np.array([seen.d[:2]]), now[1])[0])
    near = _near(last, seen, _SWING_RAD_S if beside else _TURN_RAD_S, o)
    if not near and (tracks.alone is None or now is None or not _no_other(tracks.alone, now, last, o)):
        return None
    return tracks._replace(last=seen, assumed=assumed, alone=now if beside or whole else tracks.alone)


def asks_alone(tracks: Tracks, seen: Place, o: IntegrityOptions) -> bool:
    """Return whether `follow` has to know if a second pad is in the frame."""
    if tracks.last is None or tracks.alone is None or seen.t - tracks.alone[0].t > _ALONE_S * 1e9:
        return True
    return not _near(tracks.last, seen, _TURN_RAD_S, o)


def _near(last: Place, seen: Place, turn_rad_s: float, o: IntegrityOptions) -> bool:
    unknown_m = (_SPEED_M_S + turn_rad_s * math.hypot(*seen.d)) * (seen.t - last.t) * 1e-9
    return unknown_m + _apart(last, seen)[0] < _SURELY * o.pads_apart_m


def _no_other(before: tuple[Place, F64], after: tuple[Place, F64], last: Place, o: IntegrityOptions) -> bool:
    """Return whether the tracked pad can have come there, and any other one would have shown beside it, before or after.

    Args:
        last: the tracked pad's newest place, maybe newer than `before`.
    """
    (was, showed), (seen, shows) = before, after
    dt = (seen.t - last.t) * 1e-9
    moved_m = _SPEED_M_S * dt + math.hypot(*seen.d) * min(_SWING_RAD_S * dt, _SWING_RAD)
    if _apart(last, seen)[0] > moved_m:
        return False
    apart_m = np.subtract(seen.d[:2], last.d[:2]) + moved_m * _DISC
    apart_m = apart_m[np.hypot(*apart_m.T) >= _SURELY * o.pads_apart_m]
    return bool(np.all(_inside(np.array(was.d[:2]) + apart_m, showed) | _inside(np.array(seen.d[:2]) - apart_m, shows)))


def _inside(p: F64, corners: F64) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return which of (N, 2) points lie within a convex quadrilateral, whose corners go clockwise or all the other way."""
    along = np.roll(corners, -1, axis=0) - corners
    rel = p[:, None, :] - corners
    side = along[:, 0] * rel[..., 1] - along[:, 1] * rel[..., 0]
    return np.asarray(np.all(side > 0.0, axis=1) | np.all(side < 0.0, axis=1))


def add_fused(tracks: Tracks, seen: Place) -> Tracks:
    """Record that the estimator fused the sighting: the next one is compared with it."""
    alive = tuple(c for c in tracks.candidates if seen.t - c.last.t <= 2.0 * tracks.alive_s * 1e9)
    if tracks.last is not None and tracks.last.t > seen.t:
        return tracks._replace(n=tracks.n + 1, candidates=alive)
    each_s = tracks.each_s
    if tracks.last is not None:
        each_s += _LATE * ((seen.t - tracks.last.t) * 1e-9 - each_s)
    return Tracks(tracks.number, tracks.n + 1, seen, alive, clear_m=tracks.clear_m, each_s=each_s)


def _adopted(chosen: TrackCandidate, candidates: tuple[TrackCandidate, ...], alive_s: float, o: IntegrityOptions) -> bool:
    lasts = chosen.n_alone >= _ESTABLISHED and chosen.last.t - chosen.first >= o.adopt_s * 1e9
    return lasts and _alone(chosen, candidates, alive_s)


def _alone(chosen: TrackCandidate, candidates: tuple[TrackCandidate, ...], alive_s: float) -> bool:
    return all(c is chosen or c.n < _SEEN_AT_LEAST or chosen.last.t - c.last.t > alive_s * 1e9 for c in candidates)


def _with(
    tracks: Tracks, last: Place, known: TrackCandidate | None, seen: Place, expected: Place | None
) -> tuple[TrackCandidate, ...]:
    """Return the candidates with one more sighting, which joins `known` or begins another candidate.

    Args:
        last: the newest sighting of the tracked pad.
    """
    sudden = abs(seen.t - last.t) <= _SUDDEN_S * 1e9
    if known is None and expected is not None:
        sigmas_m = expected.sigma_m, expected.sigma_down_m
        chosen = TrackCandidate(seen.t, 1, seen, sigmas_m, sudden=sudden, apart_m=_apart(expected, seen)[0])
    elif known is None:
        chosen = TrackCandidate(seen.t, 1, seen, sudden=sudden)
    else:
        chosen = known._replace(n=known.n + 1, last=seen, n_alone=known.n_alone + 1)
        if known.first <= last.t < seen.t:
            chosen = chosen._replace(first=seen.t, n_alone=1, sudden=sudden)
    others = [c for c in tracks.candidates if c is not known and seen.t - c.last.t <= 2.0 * tracks.alive_s * 1e9]
    return (*sorted(others, key=lambda c: c.last.t)[-(_MOST - 1) :], chosen)


def _base_m(seen: Place, o: IntegrityOptions) -> float:
    return o.place_step_m + o.place_step_fraction * abs(seen.d[2])


def _seen_m(*sigmas_m: float) -> float:
    return min(_SEEN_SIGMAS * math.hypot(*sigmas_m), _SEEN_MAX_M)


def _beside(last: Place, seen: Place, o: IntegrityOptions) -> bool:
    dt = abs(seen.t - last.t) * 1e-9
    moved = _SPEED_M_S * dt + 0.5 * _ACCELERATION_M_S2 * dt * dt
    base = _base_m(seen, o)
    side, down = _apart(last, seen)
    side_max = math.hypot(base, _seen_m(last.sigma_m, seen.sigma_m)) + moved
    return side <= side_max and down <= base + _seen_m(last.sigma_down_m, seen.sigma_down_m) + moved


def is_apart(expected: Place, seen: Place, o: IntegrityOptions) -> bool:
    """Return whether a sighting is not where the belief expects the pad, and so far from there that another pad can be there.

    Args:
        expected: the belief's position at the instant of the sighting.
    """
    return math.dist(expected.d, seen.d) >= 0.5 * o.pads_apart_m and not _as_expected(expected, seen, o)


def _as_expected(expected: Place, seen: Place, o: IntegrityOptions) -> bool:
    base = _base_m(seen, o)
    side, down = _apart(expected, seen)
    # Sideways they are independent of one another. Summed, they would reach another pad on the same deck from 10 m on.
    most_m = max(_BELIEF_MAX_M, 0.5 * o.pads_apart_m)
    side_max = math.hypot(base, min(_BELIEF_SIGMAS * expected.sigma_m, most_m), _seen_m(seen.sigma_m))
    down_max = base + min(_BELIEF_SIGMAS * expected.sigma_down_m, _BELIEF_DOWN_MAX_M) + _seen_m(seen.sigma_down_m)
    return side <= side_max and down <= down_max


def _apart(a: Place, b: Place) -> tuple[float, float]:
    """Return the distance of two positions sideways and down, m."""
    return math.dist(a.d[:2], b.d[:2]), abs(a.d[2] - b.d[2])


class FollowedAxis(NamedTuple):
    """Position, m, and velocity, m/s, along one axis with their covariance."""

    p: float
    v: float
    pp: float
    pv: float
    vv: float

    def ahead(self, dt: float) -> "FollowedAxis":
        """Return the axis after a time, s."""
        p, v, pp, pv, vv = self
        return FollowedAxis(
            p + v * dt,
            v,
            pp + dt * (2.0 * pv + dt * vv) + _PSD * dt * dt * dt / 3.0,
            pv + dt * vv + _PSD * dt * dt / 2.0,
            vv + _PSD * dt,
        )

    def measured(self, z: float, var: float) -> "FollowedAxis":
        """Return the axis after a measurement of the position."""
        p, v, pp, pv, vv = self
        k, g = pp / (pp + var), pv / (pp + var)
        return FollowedAxis(p + k * (z - p), v + g * (z - p), pp * (1.0 - k), pv * (1.0 - k), vv - g * pv)


class Arbiter(Struct, frozen=True):
    """The pad's place and velocity by sightings, and for how long the steering estimate has differed."""

    t: int = 0
    """Instant of the newest sighting, ns."""
    axes: tuple[FollowedAxis, ...] = ()
    n: int = 0
    """Number of sightings that it followed without a break."""
    misses: int = 0
    """Number of sightings in a row that it could not follow."""
    apart_since: int | None = None
    """Instant since which the estimate is apart, ns."""
    refused_since: int | None = None
    """Instant of the first of an unbroken series of sightings that it followed and the filter refused, ns."""
    leapt: bool = False
    """The pad leapt in the picture, and the filter has taken no sighting since."""

    def explains(self, seen: Place) -> bool:
        """Return whether a sighting is where the recent ones lead."""
        dt = (seen.t - self.t) * 1e-9
        return self.n >= _FOLLOWED and 0.0 < dt <= _FRESH_S and _follows(self.axes, dt, seen)

    @property
    def apart(self) -> bool:
        """True if the estimate has been apart for so long that nobody may steer down by it."""
        return self.apart_since is not None and self.t - self.apart_since > _APART_S * 1e9

    @property
    def overrules(self) -> bool:
        """True if the filter has to start again from the sightings."""
        if self.n < _FOLLOWED or self.misses:
            return False
        return any(at is not None and self.t - at >= _RESTART_S * 1e9 for at in (self.apart_since, self.refused_since))


def arbitrate(state: Arbiter, seen: Place) -> Arbiter:
    """Process a sighting that the other checks let pass."""
    dt = (seen.t - state.t) * 1e-9
    if not state.axes or dt > _PAUSE_S:
        return Arbiter(
            seen.t, tuple(FollowedAxis(p, 0.0, var, 0.0, _SPEED_VAR) for p, var in zip(seen.d, _vars(seen), strict=True)), 1
        )
    if dt <= 0.0:
        return state
    if not _follows(state.axes, dt, seen):
        missed = structs.replace(state, misses=state.misses + 1)
        if missed.misses < _MISSES:
            return missed
        return structs.replace(arbitrate(Arbiter(), seen), leapt=state.leapt or state.n >= _FOLLOWED)
    axes = tuple(a.ahead(dt).measured(p, var) for a, p, var in zip(state.axes, seen.d, _vars(seen), strict=True))
    return Arbiter(seen.t, axes, state.n + 1, 0, state.apart_since, state.refused_since, state.leapt)


def compare_estimate(state: Arbiter, d: tuple[float, ...], v: tuple[float, ...], variances: tuple[float, ...]) -> Arbiter:
    """Compare the steering estimate at the newest sighting with the arbiter's.

    Args:
        d: the estimate's position of the pad, m, in the arbiter's axes.
        v: its velocity, m/s.
        variances: of `d`, then of `v`.
    """
    floor = _FLOOR_M + _FLOOR_FRACTION * math.hypot(*d)
    off = 0.0
    for a, p, u, var_p, var_u in zip(state.axes, d, v, variances[:3], variances[3:], strict=True):
        off = max(off, (p - a.p) ** 2 / (var_p + a.pp + floor * floor), (u - a.v) ** 2 / (var_u + a.vv + _FLOOR_M_S**2))
    if off <= _SIGMAS**2 or state.n < _FOLLOWED:
        return state if state.apart_since is None else structs.replace(state, apart_since=None)
    return state if state.apart_since is not None else structs.replace(state, apart_since=state.t)


def record_fused(state: Arbiter, seen_at: int, fused: bool) -> Arbiter:
    """Take note of whether the filter fused the newest sighting."""
    if fused:
        known = state.refused_since is None and not state.leapt
        return state if known else structs.replace(state, refused_since=None, leapt=False)
    if seen_at != state.t or state.refused_since is not None:
        return state
    return structs.replace(state, refused_since=state.t)


def restarted(state: Arbiter) -> Arbiter:
    """Return the arbiter after it had the filter started again."""
    return structs.replace(state, apart_since=None, refused_since=None, leapt=False)


def _vars(seen: Place) -> tuple[float, float, float]:
    side, down = seen.sigma_m**2 + 1e-4, seen.sigma_down_m**2 + 1e-4
    return side, side, down


def _follows(axes: tuple[FollowedAxis, ...], dt: float, seen: Place) -> bool:
    floor = _FLOOR_M + _FLOOR_FRACTION * abs(seen.d[2])
    for a, z, var in zip(axes, seen.d, _vars(seen), strict=True):
        ahead = a.ahead(dt)
        if (z - ahead.p) ** 2 > _SIGMAS**2 * (ahead.pp + var) + floor * floor:
            return False
    return True
