"""Make samples of one ship from the messages of her sensors, whatever network carries them.

NMEA 2000 and Signal K name the same quantities in SI units; each is one kind here. Every number is checked before it is used, and
what is not taken is counted by its reason and kind. Nothing that arrives raises.

Signs (canboat's database; Signal K 1.7): starboard down, bow up, turning to starboard and heaving upward are positive.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from drivers.nmea.fields import COURSE_FROM_M_S, KNOT_M_S, SPEED_MAX_KN, Refused
from drivers.nmea.motion import HEAVE_MAX_M, TILT_MAX_DEG, TURN_MAX_DEG_S, WIND_MAX_M_S, over_ground
from drivers.nmea.sentences import WIND_RANK, SourceCount
from drivers.one_source import SourceChoice
from drivers.ship_reports import COV_SPEED, HEADING_SIGMA_RAD
from estimator.contracts.geometry import F64, GeoPoint
from estimator.contracts.samples import GeoFix, VesselMotion, VesselReport, VesselWind
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, seconds_between

Samples = list[GeoFix | VesselReport | VesselMotion | VesselWind]
Values = Mapping[str, Any]

_SOURCES_MAX = 256  # kinds times sources that are kept apart; an NMEA 2000 network has fewer
_FORGET_S = 0.05
"""Least time between two that are forgotten for new ones, so that invented names push none out that reports each ten seconds."""
_STEP_TILT_RAD = 1e-4 / math.sqrt(12.0)  # standard deviation that the resolution of PGN 127257 leaves
_STEP_HEAVE_M = 0.01 / math.sqrt(12.0)  # standard deviation that the resolution of PGN 127252 leaves
_SIGMA_TURN_RAD_S = 0.005
"""Standard deviation of a rate of turn; the noise of two sets on a small boat was 0.0003 and 0.004 rad/s."""
_SIGMA_PLACE_M = 5.0
"""Standard deviation of a place whose receiver does not say how it has it."""
_NOWHERE_DEG = 1e-6
"""A place so near to 0 N 0 E is all zeros or all ones, which a receiver without a fix sends."""
_TILT_MAX_RAD = math.radians(TILT_MAX_DEG)  # roll or pitch beyond this is of no ship
_TURN_MAX_RAD_S = math.radians(TURN_MAX_DEG_S)  # rate of turn beyond this is of no ship
_WAY_S = 2.0  # age beyond which her heading and way do not make a wind true
_QUALITY_S = 5.0  # age beyond which the quality of a fix says nothing
_OF_METHOD: Mapping[str, float | str] = {
    "gnss fix": 2.5, "dgnss fix": 2.5, "precise gnss": 2.5, "rtk fixed integer": 0.5, "rtk float": 1.0,
    "estimated (dr) mode": 50.0, "no gnss": "no_fix", "no gps": "no_fix", "error": "no_fix",
    "manual input": "typed_in", "simulate mode": "simulated", "simulator mode": "simulated",
}  # fmt: skip
"""Standard deviation of a place at a dilution of 1 by the method of PGN 129029 and Signal K, m, or why it is refused."""
_NEVER_NS = 3600 * NS_PER_S  # time before the host's start at which what has not come yet is put, so that it is old
_OVER_GROUND = ("true (ground referenced to north)", "magnetic (ground referenced to magnetic north)")


class ShipSensors:
    """Makes samples of one ship from the messages of her network.

    Places, headings, velocities, rates of turn and winds come from one source each, until it is silent. Motion sensors are kept
    apart by their names.

    Args:
        simulated: whether a place that is simulated is worth what a fix is: a rehearsal.
        choice: chooses one of several sources; shared by all that report of one ship.
    """

    def __init__(self, simulated: bool = False, choice: SourceChoice | None = None) -> None:
        self._simulated = simulated
        self._choice = choice or SourceChoice()
        self._gap_s = 1.0
        """Mean time between two messages of the kind and source that is being read."""
        self._variation_rad: float | None = None
        self._bow: tuple[MonoNs, float] = MonoNs(-_NEVER_NS), 0.0
        self._way: tuple[MonoNs, F64] = MonoNs(-_NEVER_NS), np.zeros(3)
        self._quality: dict[str, tuple[MonoNs, float | str]] = {}
        self.taken: Counter[str] = Counter()
        """The number of messages that were used, by kind."""
        self.refused: Counter[str] = Counter()
        """The number of messages that were not, by reason."""
        self.sources: dict[str, SourceCount] = {}
        """Both numbers by source and kind, as `src 27 heave`; the source that was received last stands last."""
        self._forgot_at = MonoNs(-_NEVER_NS)
        self._table: dict[str, Callable[[str, Values, Stamp], Samples]] = {
            "attitude": self._attitude, "heave": self._heave, "turn": self._turn, "heading": self._heading,
            "variation": self._keep_variation, "position": self._position, "gnss": self._gnss, "course": self._course,
            "wind": self._wind,
        }  # fmt: skip

    def samples(self, kind: str, source: str, values: Values, stamp: Stamp) -> Samples:
        """Return the samples of one message.

        Args:
            kind: the quantity: attitude, heave, turn, heading, variation, position, gnss, course or wind.
            source: the sensor's name in the network.
            values: its fields in SI units, degrees for places, by canboat's ids in lower case; None for one without a value.
        """
        now = stamp.received_at
        count = self._counted(f"{source} {kind}", now)
        if count is None:
            self.refused["too_many_sources"] += 1
            return []
        in_time = count.on_sentence(now)
        try:
            if not in_time:
                raise Refused("too_many")
            self._gap_s = count.gap_s or 1.0
            made = self._table[kind](source, values, stamp)
        except (Refused, ValueError) as why:
            reason = str(why) if isinstance(why, Refused) else "impossible"
            self.refused[reason] += 1
            count.refused[reason] += 1
            return []
        self.taken[kind] += 1
        count.used += 1
        return made

    def _counted(self, name: str, now: MonoNs) -> SourceCount | None:
        """Return the count of a source, now the last in their order; None for a new one while there are too many."""
        count = self.sources.pop(name, None)
        if count is None and len(self.sources) >= _SOURCES_MAX:
            if seconds_between(self._forgot_at, now) < _FORGET_S:
                return None
            self._forgot_at = now
            del self.sources[next(iter(self.sources))]  # the one that was silent for longest
        self.sources[name] = count = count or SourceCount()
        return count

    def _chosen(self, quantity: str, source: str, sigma: float, stamp: Stamp) -> None:
        if not self._choice.takes(quantity, source, sigma, stamp.received_at):
            raise Refused("other_receiver")

    def _attitude(self, source: str, values: Values, stamp: Stamp) -> Samples:
        roll, pitch = (_number(values, name, _TILT_MAX_RAD) for name in ("roll", "pitch"))
        if roll is None and pitch is None:
            raise Refused("no_value")
        return [VesselMotion(stamp, source, roll, pitch, _STEP_TILT_RAD)]

    def _heave(self, source: str, values: Values, stamp: Stamp) -> Samples:
        return [VesselMotion(stamp, source, heave_down_m=-_needed(values, "heave", HEAVE_MAX_M), sigma_heave_m=_STEP_HEAVE_M)]

    def _turn(self, source: str, values: Values, stamp: Stamp) -> Samples:
        rate = _needed(values, "rate", _TURN_MAX_RAD_S)
        # A set that reports half as often filters for longer: of two on a boat the slower one was 1.5 s late.
        self._chosen("turn", source, _SIGMA_TURN_RAD_S * max(self._gap_s, 0.02) / 0.1, stamp)
        return [VesselReport(stamp, None, None, None, None, rate, _SIGMA_TURN_RAD_S)]

    def _heading(self, source: str, values: Values, stamp: Stamp) -> Samples:
        heading = _angle(values, "heading") + (_number(values, "deviation", math.pi) or 0.0)
        variation = _number(values, "variation", math.pi)
        sigma = HEADING_SIGMA_RAD
        if values.get("reference") != "True":
            heading, sigma = heading + self._north(values.get("reference"), variation), 2.0 * sigma
        self._chosen("heading", source, sigma, stamp)
        heading %= 2.0 * math.pi
        self._bow = stamp.received_at, heading
        return [VesselReport(stamp, None, None, heading, sigma)]

    def _keep_variation(self, source: str, values: Values, stamp: Stamp) -> Samples:
        variation = _needed(values, "variation", math.pi)
        self._chosen("variation", source, 1.0, stamp)
        self._variation_rad = variation
        return []

    def _north(self, reference: object, variation: float | None = None) -> float:
        """Return what is added to an angle from magnetic north for one from true north, rad.

        Raises:
            Refused: it has another reference, or nothing says the variation.
        """
        if reference != "Magnetic":
            raise Refused("no_reference")
        if variation is None and self._variation_rad is None:
            raise Refused("no_variation")
        return variation if variation is not None else self._variation_rad or 0.0

    def _position(self, source: str, values: Values, stamp: Stamp) -> Samples:
        at, sigma_m = self._quality.get(source, (MonoNs(0), _SIGMA_PLACE_M))
        if seconds_between(at, stamp.received_at) > _QUALITY_S:
            sigma_m = _SIGMA_PLACE_M
        if isinstance(sigma_m, str):
            raise Refused(sigma_m)
        lat, lon = _needed(values, "latitude", 90.0), _needed(values, "longitude", 360.0)
        if max(abs(lat), abs(lon)) < _NOWHERE_DEG:
            raise Refused("no_fix")
        height_m = _number(values, "altitude", 10_000.0)
        self._chosen("place", source, sigma_m, stamp)
        return [GeoFix(stamp, "vessel", GeoPoint.of_degrees(lat, lon, height_m), sigma_m)]

    def _gnss(self, source: str, values: Values, stamp: Stamp) -> Samples:
        """Take how a receiver has its place, and the place if it is there."""
        worth = _OF_METHOD.get(str(values.get("method")).lower(), "no_fix")
        if worth == "simulated" and self._simulated:
            worth = 2.5
        if not isinstance(worth, str):
            worth *= max(1.0, _number(values, "hdop", 1000.0) or 1.0)
        self._quality.pop(source, None)
        self._quality[source] = stamp.received_at, worth
        if len(self._quality) > _SOURCES_MAX:
            del self._quality[next(iter(self._quality))]
        return [] if values.get("latitude") is None and not isinstance(worth, str) else self._position(source, values, stamp)

    def _course(self, source: str, values: Values, stamp: Stamp) -> Samples:
        speed, course = _needed(values, "sog", KNOT_M_S * SPEED_MAX_KN), 0.0
        if values.get("cog") is not None or speed >= COURSE_FROM_M_S:
            course = _angle(values, "cog")
            if values.get("cogreference") != "True":
                course += self._north(values.get("cogreference"))
        self._chosen("velocity", source, float(COV_SPEED[0, 0]), stamp)
        v = np.array([speed * math.cos(course), speed * math.sin(course), 0.0])
        self._way = stamp.received_at, v
        return [VesselReport(stamp, v, COV_SPEED, None, None)]

    def _wind(self, source: str, values: Values, stamp: Stamp) -> Samples:
        speed, from_rad = _needed(values, "windspeed", WIND_MAX_M_S), _number(values, "windangle", 2.0 * math.pi)
        reference = str(values.get("reference")).lower()
        if from_rad is None:
            raise Refused("no_value")
        if reference == "apparent":
            (bow_at, bow), (way_at, way) = self._bow, self._way
            if max(seconds_between(at, stamp.received_at) for at in (bow_at, way_at)) > _WAY_S:
                raise Refused("no_way")
            from_rad, speed = over_ground(bow + from_rad, speed, way)
        elif reference == _OVER_GROUND[1]:
            from_rad += self._north("Magnetic")
        elif reference != _OVER_GROUND[0]:
            raise Refused("not_over_ground")  # through the water, whose current is not known
        self._chosen("wind", source, WIND_RANK["R" if reference == "apparent" else "N"], stamp)
        return [VesselWind(stamp, source, from_rad % (2.0 * math.pi), speed)]


def _number(values: Values, name: str, most: float) -> float | None:
    """Return a field; None if it has no value.

    Raises:
        Refused: it is no number, or one that no ship has.
    """
    value = values.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Refused("malformed")
    if not abs(value) <= most:
        raise Refused("impossible")
    return float(value)


def _needed(values: Values, name: str, most: float) -> float:
    number = _number(values, name, most)
    if number is None:
        raise Refused("no_value")
    if name in ("sog", "windspeed") and number < 0.0:
        raise Refused("impossible")
    return number


def _angle(values: Values, name: str) -> float:
    """Return a direction, 0 to a turn; one that is negative is refused."""
    found = _needed(values, name, 2.0 * math.pi + 1e-4)
    if found < 0.0:
        raise Refused("impossible")
    return found
