"""Compare other heights with the camera's: a range sensor over the pad, and the change of the barometric height.

A range counts if the sighting puts the deck around the pad below the body; beyond the edge there is water, and a longer range
means nothing. A shorter one counts there too, near the pad: nothing stands above the deck, so the camera sees it too far away (a
smaller pad, a wrong focal length).
"""

import math

from msgspec import Struct
from msgspec.structs import replace

from estimator.contracts.estimates import Sighting
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Baro, Range
from estimator.integrity.options import IntegrityOptions

_FRESH_S = 0.3
_NEAREST_M = 0.35
"""Smallest height for the comparison: an ultrasonic sensor measures nothing nearer than 0.2 m."""
_UPRIGHT = 0.85
_EDGE_M = 0.1
_FASTEST = 3.0
"""A difference of several times what is allowed counts this many times as fast."""
_CLEAR = 0.35
"""Radius around the pad, as a part of the height, without anything above the deck: the vehicle descends there."""
_PAUSE_S = 0.3
"""Longest time between two ranges that counts."""
_SPAN_S = 12.0
"""Time over which barometer and camera are compared: a swell of 12 s has brought a deck to where it is now."""
_BACK_S = 6.0
"""The newest time that is not compared: a deck that rises for so long is no deck on waves."""
_SHORT_S = 4.0
"""The least of the compared time that shows a wave's crest and trough; of a shorter one twice the difference is allowed."""
_AGREES_S = 2.0
_BARO_LAG = 0.1
"""Weight of a new difference in the mean: a barometer's noise is half a metre."""


class HeightWatch(Struct, frozen=True):
    """The comparison of the other heights with the camera's so far."""

    seen_at: int = 0
    """Instant of the newest sighting, ns; 0 if none."""
    d_level: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the pad in that sighting, m."""
    down_level: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """The body's down axis at that instant."""
    range_at: int = 0
    ranged_at: int = 0
    """Instant of the newest range that was compared with the camera, ns."""
    against_s: float = 0.0
    """Time for which ranges have contradicted the camera, s; agreement reduces it."""
    contradicted: bool = False
    agreed_at: int = -1
    """Instant when a range last agreed, ns; -1 if never."""
    rise: tuple[tuple[int, float], ...] = ()
    """Instants (ns) and smoothed barometric height minus camera height, m; one entry per second."""
    rise_now: float = math.nan
    seen_height: tuple[tuple[int, float], ...] = ()
    weighed_at: int = 0
    """Instant of the newest barometric height that was compared with the camera, ns."""
    baro_contradicted: bool = False

    def confirmed(self, now: int) -> bool:
        """Return whether a range has agreed lately."""
        return self.agreed_at >= 0 and 0 <= now - self.agreed_at <= _AGREES_S * 1e9


def sighted(state: HeightWatch, sighting: Sighting, R_ned_body: Rotation) -> HeightWatch:
    """Record a sighting that the estimator fused."""
    x, y, z = sighting.d_body_pad_level.tolist()
    cx, cy, cz = R_ned_body.without_heading().matrix[:, 2].tolist()
    return replace(state, seen_at=sighting.stamp.measured_at, d_level=(x, y, z), down_level=(cx, cy, cz))


def ranged(state: HeightWatch, event: Range, o: IntegrityOptions) -> HeightWatch:
    """Compare a range with the newest sighting if that is fresh and has the pad below."""
    t = event.stamp.measured_at
    if state.seen_at == 0 or abs(t - state.seen_at) > _FRESH_S * 1e9:
        return replace(state, range_at=t)
    x, y, z = state.d_level
    cx, cy, cz = state.down_level
    if cz < _UPRIGHT or z < _NEAREST_M or event.range_m < 0.5 * _NEAREST_M:
        return replace(state, range_at=t)
    along = z / cz
    foot = math.hypot(x - cx * along, y - cy * along)
    tolerance = o.range_tolerance_m + o.range_tolerance_fraction * z
    # A cone measures the nearest surface, which lies between the axis and the perpendicular.
    beyond, short, allowed = event.range_m - along, z - event.range_m, tolerance + 2.0 * event.sigma_m
    if foot > o.deck_radius_m - _EDGE_M and (foot > _CLEAR * z or short <= allowed):
        # The beam is not certainly over the deck, so the previous result holds until it is.
        return replace(state, range_at=t)
    off = max(beyond, short, 0.0)
    dt = min(max(0.0, (t - state.range_at) * 1e-9), _PAUSE_S)
    agrees = off <= allowed
    step = -dt if agrees else dt * min(off / allowed, _FASTEST)
    against = min(max(0.0, state.against_s + step), 1.5 * o.range_disagree_s)
    contradicted = against >= o.range_disagree_s or (state.contradicted and against > 0.0)
    agreed_at = t if agrees else state.agreed_at
    return replace(state, range_at=t, ranged_at=t, against_s=against, contradicted=contradicted, agreed_at=agreed_at)


def weighed(state: HeightWatch, event: Baro, o: IntegrityOptions) -> HeightWatch:
    """Compare a barometric height with the camera's: the difference must not drift while the pad is visible.

    A deck on waves takes the difference up and down with it, by metres. So it may be wherever it has been `_BACK_S` to `_SPAN_S`
    ago; what drifts on is beyond that.
    """
    t = event.stamp.measured_at
    if state.seen_at == 0 or abs(t - state.seen_at) > _FRESH_S * 1e9:
        return state
    height = state.d_level[2]
    off = event.height_m - height
    now = off if math.isnan(state.rise_now) else state.rise_now + _BARO_LAG * (off - state.rise_now)
    rise, seen = state.rise, state.seen_height
    if not rise or t - rise[-1][0] >= 1e9:
        rise = (*(r for r in rise if t - r[0] <= _SPAN_S * 1e9), (t, now))
        seen = (*(s for s in seen if t - s[0] <= _SPAN_S * 1e9), (t, height))
    allowed_m = o.height_tolerance_m + _farthest(height, seen) / 3.0
    if t - rise[0][0] < (_BACK_S + _SHORT_S) * 1e9:
        allowed_m *= 2.0
    against = _beyond(now, [each for at, each in rise if t - at >= _BACK_S * 1e9]) > allowed_m
    return replace(state, rise=rise, rise_now=now, seen_height=seen, weighed_at=t, baro_contradicted=against)


def _beyond(value: float, range_of: list[float]) -> float:
    """Return how far a value lies outside the range of others; 0 if there are none."""
    return max(value - max(range_of), min(range_of) - value) if range_of else 0.0


def _farthest(value: float, course: tuple[tuple[int, float], ...]) -> float:
    """Return the largest difference of a value from those of a course; 0 from an empty one."""
    if not course:
        return 0.0
    values = [each for _, each in course]
    return max(abs(value - min(values)), abs(value - max(values)))
