"""Turn the sentences of one ship into samples: NMEA 0183 of her receivers, compasses, motion sensors and anemometer, and AIS.

pynmea2 and pyais take the sentences apart. Every sentence needs its checksum (TSS1 and EM3000 have none), every number is checked
before it is used, and what is not taken is counted by its reason. Nothing on the wire raises.

Two receivers in one stream are two sources, kept apart by their talkers: place, velocity, heading, rate of turn and wind are each
of one of them. Motion sensors are all passed on under their names.

Source: NMEA 0183 version 4.11; ITU-R M.1371-5, annex 8, tables 48 and 70 (position reports of classes A and B).
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np
import pyais
import pynmea2
from msgspec import Struct, field
from msgspec.structs import replace

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.nmea import motion as say
from drivers.nmea.definitions import SENTENCE_KINDS
from drivers.nmea.fields import (
    KNOT_M_S,
    SPEED_MAX_KN,
    Refused,
    checked,
    heading_deg,
    number,
    place,
    rounding,
    text,
    time_ns,
    velocity,
)
from drivers.nmea.motion import ShipMotion, Wind
from drivers.nmea.transport import DATAGRAM_MAX, LINES_MAX
from drivers.one_source import SourceChoice
from drivers.ship_reports import COV_SPEED, HEADING_SIGMA_RAD, RATE_MAX, SOURCE_MAX
from estimator.contracts.geometry import F64, GeoPoint, ned_between
from estimator.contracts.samples import GeoFix, VesselMotion, VesselReport, VesselWind
from estimator.contracts.time import NS_PER_S, MonoNs, Stamp, after, seconds_between

_LINE_MAX = 1024  # longest sentence that is read, characters; the standard permits 82
_BURST_MAX = 2.0 * LINES_MAX  # sentences that are read at once
_NAMES_MAX = 64  # sources that are counted apart
_TALKERS_MAX = 16  # receivers that are kept
_DAY_NS = 86_400 * NS_PER_S  # period of a time of day
_MINUTE_NS = 60 * NS_PER_S  # period of the seconds of a minute in AIS
_ARRIVAL_SIGMA_S = 0.2
"""Standard deviation of the instant of a sentence without a time."""
_BURST_S = 0.5  # time after the sentence with a time in which others belong to its instant
_BURST_SHARE = 0.5  # the same as a share of the time between two
_FIX_SIGMA_M = 2.5
"""Standard deviation of a place at a dilution of precision of 1."""
_DILUTION = 2.0
"""The dilution of precision of a sentence without it."""
_APART_S = 10.0
"""Time for which places of one talker's two receivers are known as badly as they differed. Her velocity joins two places that lie
no further apart in time."""
_ROUNDED = 2.0 * math.sqrt(12.0)
"""Standard deviations of its rounding by which a place may lie apart from the one before."""
_RECKONED_SIGMA_M = 50.0
"""Standard deviation of a place that the receiver reckons from an old one."""
_OF_MODE: Mapping[str, float | str] = {
    "": 5.0, "A": 5.0, "D": 2.5, "P": 2.5, "F": 1.0, "R": 0.5, "E": _RECKONED_SIGMA_M,
    "M": "typed_in", "S": "simulated", "N": "no_fix",
}  # fmt: skip
"""Standard deviation of a position by the mode of RMC, m, or the reason why it is refused. Old receivers send no mode."""
_OF_QUALITY: Mapping[int, float | str] = {
    1: _FIX_SIGMA_M, 2: _FIX_SIGMA_M, 3: _FIX_SIGMA_M, 4: 0.5, 5: 1.0, 6: _RECKONED_SIGMA_M,
    0: "no_fix", 7: "typed_in", 8: "simulated",
}  # fmt: skip
"""Standard deviation of a position by the quality of GGA, at a dilution of 1, m, or the reason why it is refused."""
_GNS_MODES = "NADPRFEMS"
"""Letters of GNS, one for each system of satellites, at the index that is the same quality in GGA."""
_REPEATS: Mapping[str, tuple[str, ...]] = {"GNS": ("GGA",), "GLL": ("GGA", "GNS", "RMC")}
"""Sentences of the same receiver that say a place with more about it."""
_UNSAFE = "U"
"""Navigational status of version 4.11 that is none to sail by; V says only that the receiver does not judge it."""
_AIS_SIGMA_M = {True: 5.0, False: 10.0}
"""Standard deviation of a position by the flag of AIS, m: the flag shows only whether it is better than 10 m."""
_SIGMA_TURN_RAD_S = math.radians(0.1)
"""Standard deviation of a rate of turn."""
_AIS_NO_PLACE = {61: "typed_in", 63: "no_fix"}
"""Seconds of the minute that stand for a place that was typed in, or for none."""
_AIS_RECKONED = 62  # seconds of the minute that stand for a place by dead reckoning
_AIS_REPORTS = (1, 2, 3, 18, 19)

_INDIRECT = 2.0
"""Factor on the sigma of a heading from a sentence that is not its compass's own, when a source is chosen."""
WIND_RANK = {"R": 0.4, "N": 0.7, "T": 1.0}
"""Order of winds: made here of the apparent one and her way, by her own from north, by her own from the bow (over the water)."""
_WAY_S = 5.0
"""Age up to which her heading and velocity make a wind over the ground of an apparent one, and her velocity joins places."""
_OWNS = 0.25  # share of the motions whose heading is a talker's own from which they are of its device
_MOTIONS = 60.0  # number of motions after which old ones count half
_QUALITY_S = 3.0  # age beyond which the quality of a motion no longer counts
_NOT_VALID = 2  # quality of a value that is not valid

Samples = list[GeoFix | VesselReport | VesselMotion | VesselWind]


class SourceCount(Struct):
    """The sentences of one kind by one talker."""

    used: int = 0
    """The number of those that gave a sample, or hold no more than a state."""
    refused: Counter[str] = field(default_factory=Counter)
    last: MonoNs | None = None
    gap_s: float = 0.0
    """Mean time between two, over the last ten or so."""
    allowance: float = SOURCE_MAX * _BURST_MAX
    """The number of them that may be read at once now."""

    def on_sentence(self, now: MonoNs) -> bool:
        """Count the time since the one before; return whether there is time to read it."""
        since_s = 0.0
        if self.last is not None:
            since_s = seconds_between(self.last, now)
            self.gap_s += (since_s - self.gap_s) / min(10, self.used + self.refused.total())
        self.last = now
        self.allowance = min(SOURCE_MAX * _BURST_MAX, self.allowance + SOURCE_MAX * RATE_MAX * max(0.0, since_s))
        in_time = self.allowance >= 1.0
        self.allowance -= in_time
        return in_time

    def rate_hz(self, now: MonoNs) -> float:
        """Return how many arrive each second; of one that fell silent it sinks."""
        silent_s = 0.0 if self.last is None else seconds_between(self.last, now)
        return 0.0 if self.gap_s <= 0.0 else 1.0 / max(self.gap_s, silent_s)


def by_source(sources: Mapping[str, SourceCount], now: MonoNs) -> dict[str, float]:
    """Return for health the numbers of sentences used, and of those refused by reason, and the rate, by talker and kind."""
    out: dict[str, float] = {}
    for name, count in sources.items():
        out |= {f"used {name}": float(count.used), f"rate_hz {name}": round(count.rate_hz(now), 3)}
        out |= {f"unused {name} {why}": float(n) for why, n in count.refused.items()}
    return out


class _Receiver:
    """The clock of one talker, and the burst of sentences that it sends for one instant.

    A receiver sends what it knows of one instant together, and the time of that in some of its sentences alone. Roll, pitch and
    heave of two recorded Seapaths agree as of the time in the burst, and are a third of a second old on arrival.
    """

    def __init__(self, name: str) -> None:
        # The window is long, so that a link that becomes slow is reported as late reports and not as another clock.
        self._day = ClockMap(_options(_DAY_NS, 0.01))
        self.name = name
        self.heading: tuple[MonoNs, float] | None = None
        """Arrival and degrees of the newest heading."""
        self.matches = 0.0
        """The number of motions that had the heading of this talker to the digit, the old ones less."""
        self.moved_at = MonoNs(0)
        """Arrival of the newest motion of this talker's device."""
        self._places: dict[str, tuple[int, GeoPoint]] = {}
        """The time of day and the place of the newest sentence of each kind."""
        self.placed_at: dict[str, MonoNs] = {}
        """Arrival of the newest place of each kind of sentence."""
        self._apart = MonoNs(0), 0.0
        """Arrival of the place that contradicted the one of its kind before it most, and by how much, m."""
        self._time_ns = -1
        self._burst: Stamp | None = None
        self._period_s = 0.0
        self._before, self._in_burst = Counter[str](), Counter[str]()
        self._late_s: dict[str, float] = {}

    def apart_m(self, kind: str, time_of_day_ns: int, where: GeoPoint, v: F64 | None, rounded_m: float, now: MonoNs) -> float:
        """Return how far two places lie apart beyond the ship's way between them, m: two receivers may have one talker.

        Each moves the ship, and where one of their clocks is wrong, she also moves by her way in that time.
        """
        at_ns, place_then = self._places.get(kind, (time_of_day_ns, where))
        self._places[kind] = time_of_day_ns, where
        since_s = ((time_of_day_ns - at_ns + _DAY_NS // 2) % _DAY_NS - _DAY_NS // 2) / NS_PER_S
        apart_m = 0.0
        if since_s == 0.0 or (v is not None and abs(since_s) <= _APART_S):
            way_m = since_s * (np.zeros(2) if v is None else v[:2])
            apart_m = float(np.hypot(*(ned_between(place_then, where)[:2] - way_m)))
            apart_m *= apart_m > _ROUNDED * rounded_m
        if apart_m >= self._apart[1] or seconds_between(self._apart[0], now) > _APART_S:
            self._apart = now, apart_m
        return self._apart[1]

    def timed(self, time_of_day_ns: int, received_at: MonoNs) -> Stamp:
        """Return the stamp of a sentence with a time of day."""
        stamp = self._day.stamp(time_of_day_ns, received_at)
        if time_of_day_ns != self._time_ns:
            self._period_s = 0.0 if self._burst is None else seconds_between(self._burst.received_at, received_at)
            self._time_ns, self._burst = time_of_day_ns, stamp
            self._before, self._in_burst = self._in_burst, Counter()
        return stamp

    def untimed(self, kind: str, received_at: MonoNs) -> Stamp:
        """Return the stamp of a sentence without a time: that of its burst if it is one of a kind there, else its arrival.

        Where the sentence with the time was lost, it is as late as those of its kind before.
        """
        self._in_burst[kind] += 1
        one, longest_s = self._in_burst[kind] == 1 and self._before[kind] <= 1, min(_BURST_S, _BURST_SHARE * self._period_s)
        if one and self._burst is not None and 0.0 <= seconds_between(self._burst.received_at, received_at) <= longest_s:
            self._late_s[kind] = seconds_between(self._burst.measured_at, received_at)
            return replace(self._burst, received_at=received_at)
        stamp = _arrival(received_at)
        return replace(stamp, measured_at=after(received_at, -self._late_s.get(kind, 0.0)))


class NmeaReader:
    """Reads the sentences of one ship.

    Args:
        mmsi: whose AIS reports are taken; 0 for none.
        simulated: whether what says that it is simulated is worth what a fix is: a rehearsal.
        choice: chooses one of several sources; shared by all that report of one ship.
        name: prefix of the names of sources and sensors, where several streams of one ship are read.
    """

    def __init__(self, mmsi: int = 0, simulated: bool = False, choice: SourceChoice | None = None, name: str = "") -> None:
        self._mmsi = mmsi
        self._simulated = simulated
        self._choice = choice or SourceChoice()
        self._prefix = f"{name} " if name else ""
        self._minute = ClockMap(_options(_MINUTE_NS, 1.0))
        self._receivers: dict[str, _Receiver] = {}
        self._tokens, self._tokens_at = _BURST_MAX, MonoNs(0)
        self._quality: tuple[MonoNs, tuple[int, int, int]] | None = None
        self._motions = 0.0
        self._heading: VesselReport | None = None
        self._velocity: VesselReport | None = None
        self.taken: Counter[str] = Counter()
        """The number of sentences that gave a sample, by kind."""
        self.refused: Counter[str] = Counter()
        """The number of sentences that were not taken, by reason."""
        self.sources: dict[str, SourceCount] = {}
        """The same by talker and kind, as `INGGA`; sentences without a right checksum have neither."""
        self._table: dict[str, Callable[[Any, _Receiver, MonoNs], Samples]] = {
            "RMC": self._rmc, "GGA": self._gga, "GNS": self._gns, "GLL": self._gll, "VTG": self._vtg, "HDT": self._hdt,
            "THS": self._ths, "VHW": self._vhw, "ROT": self._rot, "XDR": self._xdr, "MWV": self._wind, "MWD": self._wind,
            "PSXN": self._psxn, "PASHR": self._pashr, "PRDID": self._prdid,
        }  # fmt: skip

    def samples(self, datagram: bytes, received_at: MonoNs) -> Samples:
        """Return every sample in one datagram."""
        if len(datagram) > 1 and say.is_em3000(datagram):
            records, _ = say.em3000_records(datagram)
            return [one for record in records for one in self._em3000(record, received_at)]
        return [one for line in self._lines(datagram) for one in self._line(line.strip(), received_at)]

    def by_source(self, now: MonoNs) -> dict[str, float]:
        """Return what `by_source` does of these sources."""
        return by_source(self.sources, now)

    def _lines(self, datagram: bytes) -> Iterator[str]:
        if len(datagram) > DATAGRAM_MAX:
            self.refused["too_long"] += 1
            return
        lines = [line for line in datagram.decode("ascii", "replace").splitlines() if line.strip()]
        short = [line for line in lines[:LINES_MAX] if len(line) <= _LINE_MAX]
        if len(lines) > len(short):
            self.refused["too_long"] += len(lines) - len(short)
        yield from short

    def _line(self, line: str, received_at: MonoNs) -> Samples:
        if line.startswith("\\"):  # a TAG block of NMEA 4 before the sentence
            line = line[1:].partition("\\")[2]
        if line.startswith(":"):
            return self._counted("TSS1", "TSS1", lambda: self._tss1(line, received_at), received_at)
        if not checked(line):
            self.refused["checksum"] += 1
            return []
        if line.startswith("!"):
            return self._counted(line[1:6].upper(), "AIS", lambda: self._ais(line, received_at), received_at)
        line = line.upper()
        begin, _, rest = line[1:].partition(",")
        if begin.startswith("P"):
            kind, talker = begin, ""
            begin += "," + rest.partition(",")[0] if begin == "PSXN" else ""
        else:
            kind, talker = begin[2:], begin[:2]
        return self._counted(begin, kind, lambda: self._sentence(kind, talker, line, received_at), received_at)

    def _sentence(self, kind: str, talker: str, line: str, received_at: MonoNs) -> Samples:
        if kind not in SENTENCE_KINDS:  # a vendor's own, as Garmin's PGRMC, is none of these
            raise Refused("other_sentence")
        body = line.rpartition("*")[0]
        m = _Ths(talker, kind, body.split(",")[1:]) if kind == "THS" else pynmea2.parse(body)
        return self._table[kind](m, self._receiver(talker), received_at)

    def _counted(self, source: str, kind: str, read: Callable[[], Samples], now: MonoNs) -> Samples:
        """Return the samples of one sentence, and count it."""
        name = self._prefix + source
        count = self.sources.setdefault(
            name if name in self.sources or len(self.sources) < _NAMES_MAX else "others", SourceCount()
        )
        try:
            if not self._admits(count, now):
                raise Refused("too_many")
            made = read()
        except Refused as why:
            reason = str(why)
        except Exception:  # the libraries raise many kinds on damaged fields, and none of it may end the part
            reason = "malformed"
        else:
            self.taken[kind] += 1
            count.used += 1
            return made
        self.refused[reason] += 1
        count.refused[reason] += 1
        return []

    def _admits(self, count: SourceCount, now: MonoNs) -> bool:
        """Return whether there is time to read one more sentence of a source, and count it among those that came."""
        passed_s = max(0.0, seconds_between(self._tokens_at, now))
        self._tokens, self._tokens_at = min(_BURST_MAX, self._tokens + RATE_MAX * passed_s), now
        if not count.on_sentence(now) or self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True

    def _receiver(self, talker: str) -> _Receiver:
        found = self._receivers[talker] = self._receivers.pop(talker) if talker in self._receivers else _Receiver(talker)
        if len(self._receivers) > _TALKERS_MAX:
            del self._receivers[next(iter(self._receivers))]  # the one that was silent for longest
        return found

    def _chosen(self, source: str, made: Samples, now: MonoNs, inflation: float = 1.0) -> Samples:
        """Return those of the samples whose source is the chosen one of its quantity.

        Raises:
            Refused: none is.
        """
        kept = [one for one in made if self._choice.takes(*_quantity(one, inflation, self._prefix + source), now)]
        if made and not kept:
            raise Refused("other_receiver")
        for one in kept:
            if isinstance(one, VesselReport):
                self._heading = one if one.heading_rad is not None else self._heading
                self._velocity = one if one.v_vessel_ned is not None else self._velocity
        return kept

    def _rmc(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        if m.status != "A":
            raise Refused("no_fix")
        if text(m, 12) == _UNSAFE:
            raise Refused("not_valid")
        sigma_m = self._worth(_OF_MODE, text(m, 11))
        where, rounded_m = place(m)
        v = None if m.spd_over_grnd is None else velocity(m.spd_over_grnd, m.true_course)
        v = v if sigma_m < _RECKONED_SIGMA_M else None
        fix = self._fix(m, of, where, sigma_m, rounded_m, v, received_at)
        return self._chosen(of.name, [fix, *_moving(fix.stamp, v, text(m, "spd_over_grnd"))], received_at)

    def _gga(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        sigma_m = self._worth(_OF_QUALITY, int(number(m.gps_qual)))
        dilution = _DILUTION if m.horizontal_dil in (None, "") else number(m.horizontal_dil)
        where, rounded_m = place(m, None if m.altitude is None else number(m.altitude))
        fix = self._fix(m, of, where, sigma_m * max(1.0, dilution), rounded_m, None, received_at)
        return self._chosen(of.name, [fix], received_at)

    def _gns(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        modes = text(m, "mode_indicator").replace("N", "") or "N"
        if any(mode not in _GNS_MODES for mode in modes):
            raise Refused("impossible")
        if text(m, 12) == _UNSAFE:
            raise Refused("not_valid")
        # The place is made of all systems in use: it is as good as the worst of them.
        sigma_m = max(self._worth(_OF_QUALITY, _GNS_MODES.index(mode)) for mode in modes)
        dilution, height = text(m, "hdop"), text(m, "altitude")
        where, rounded_m = place(m, number(height) if height else None)
        sigma_m *= max(1.0, number(dilution) if dilution else _DILUTION)
        return self._chosen(of.name, [self._fix(m, of, where, sigma_m, rounded_m, None, received_at)], received_at)

    def _gll(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        if m.status != "A":
            raise Refused("no_fix")
        where, rounded_m = place(m)
        sigma_m = self._worth(_OF_MODE, text(m, "faa_mode"))
        return self._chosen(of.name, [self._fix(m, of, where, sigma_m, rounded_m, None, received_at)], received_at)

    def _fix(
        self, m: Any, of: _Receiver, where: GeoPoint, sigma_m: float, rounded_m: float, v: F64 | None, now: MonoNs
    ) -> GeoFix:
        kind = m.sentence_type
        if any(seconds_between(of.placed_at[more], now) <= _WAY_S for more in _REPEATS.get(kind, ()) if more in of.placed_at):
            raise Refused("repeated")
        of.placed_at[kind] = now
        if kind == "GLL" and not text(m, "timestamp"):  # the first versions of the standard have none in it
            return GeoFix(of.untimed(kind, now), "vessel", where, math.hypot(sigma_m, rounded_m), v)
        time_of_day_ns, known = time_ns(m.timestamp), _recent(self._velocity, now)
        way = known.v_vessel_ned if v is None and known is not None else v
        apart_m = of.apart_m(kind, time_of_day_ns, replace(where, height_m=None), way, rounded_m, now)
        return GeoFix(of.timed(time_of_day_ns, now), "vessel", where, math.hypot(sigma_m, apart_m, rounded_m), v)

    def _vtg(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        if self._worth(_OF_MODE, text(m, 8)) >= _RECKONED_SIGMA_M:
            raise Refused("reckoned")
        if m.spd_over_grnd_kts is None:
            raise Refused("no_fix")
        v = velocity(m.spd_over_grnd_kts, m.true_track)
        return self._chosen(of.name, _moving(of.untimed("VTG", received_at), v, text(m, "spd_over_grnd_kts")), received_at)

    def _hdt(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        return self._compass(text(m, "heading"), text(m, "hdg_true"), of, "HDT", received_at)

    def _ths(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        mode = text(m, 1)
        if mode not in ("", "A", "E", *("S",) * self._simulated):
            raise Refused({"M": "typed_in", "S": "simulated", "V": "not_valid"}.get(mode, "impossible"))
        return self._compass(text(m, 0), "T", of, "THS", received_at)

    def _vhw(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        return self._compass(text(m, "heading_true"), text(m, "true") or "T", of, "VHW", received_at)

    def _compass(self, cell: str, reference: str, of: _Receiver, kind: str, received_at: MonoNs) -> Samples:
        bow_deg = heading_deg(cell, reference)
        stamp, own = of.untimed(kind, received_at), kind != "VHW"
        if own:
            of.heading = received_at, bow_deg
        report = _pointing(stamp, math.radians(bow_deg), rounding(cell, math.radians(1.0)))
        return self._chosen(of.name if own else f"{of.name} {kind}", [report], received_at, 1.0 if own else _INDIRECT)

    def _rot(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        if text(m, "status") not in ("", "A"):
            raise Refused("not_valid")
        return self._turning(text(m, "rate_of_turn"), 1.0 / 60.0, of, "ROT", received_at)

    def _turning(self, cell: str, unit_deg_s: float, of: _Receiver, kind: str, received_at: MonoNs) -> Samples:
        rate, rounded = say.turn(cell, unit_deg_s)
        stamp, sigma = of.untimed(kind, received_at), math.hypot(_SIGMA_TURN_RAD_S, rounded)
        return self._chosen(f"{of.name} {kind}".strip(), [VesselReport(stamp, None, None, None, None, rate, sigma)], received_at)

    def _wind(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        kind = m.sentence_type
        wind = say.mwv(m) if kind == "MWV" else say.mwd(m)
        stamp = _arrival(received_at)
        from_rad, speed_m_s = (wind.from_rad, wind.speed_m_s) if wind.reference == "N" else self._over_ground(wind, received_at)
        sensor = f"{of.name} {kind}" + (wind.reference if kind == "MWV" else "")
        made = VesselWind(stamp, self._prefix + sensor, from_rad % (2.0 * math.pi), speed_m_s)
        return self._chosen(sensor, [made], received_at, WIND_RANK[wind.reference])

    def _over_ground(self, wind: Wind, now: MonoNs) -> tuple[float, float]:
        """Return from where the wind blows over the ground, rad from north, and its speed, m/s, of one from the bow.

        Raises:
            Refused: her heading is not known now, or her velocity where the wind is the apparent one.
        """
        bow, way = _recent(self._heading, now), _recent(self._velocity, now)
        if bow is None or bow.heading_rad is None:
            raise Refused("no_way")
        from_rad = bow.heading_rad + wind.from_rad
        if wind.reference == "T":
            return from_rad, wind.speed_m_s
        if way is None or way.v_vessel_ned is None:
            raise Refused("no_way")
        return say.over_ground(from_rad, wind.speed_m_s, way.v_vessel_ned)

    def _xdr(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        motions = say.xdr(m.data)
        stamp = of.untimed("XDR", received_at)
        return [self._moved(f"{of.name} XDR{number}", one, stamp) for number, one in motions]

    def _psxn(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        kind = text(m, 1)
        if kind == "20":
            self._quality = received_at, say.quality(m)
            return []
        if kind == "22":
            return []  # the calibration of its gyro, which its quality counts in
        if kind == "24":
            return self._turning(text(m, 4), 1.0, of, "PSXN", received_at)
        if kind != "23":
            raise Refused("other_sentence")
        found = say.motion(text(m, 2), text(m, 3), text(m, 5), text(m, 4))
        return self._of_sensor("PSXN", self._good(found, received_at), received_at)

    def _good(self, found: ShipMotion, now: MonoNs) -> ShipMotion:
        """Return the parts that the PSXN,20 before does not call invalid.

        Raises:
            Refused: none of the motion is left.
        """
        if self._quality is None or seconds_between(self._quality[0], now) > _QUALITY_S:
            return found
        heave, bow, tilt = (said == _NOT_VALID for said in self._quality[1])
        parts = ("heave_down_m", heave), ("heading_rad", bow), ("roll_rad", tilt), ("pitch_rad", tilt)
        invalid: dict[str, Any] = {part: None for part, bad in parts if bad}
        found = found._replace(**invalid)
        if found[:2] == (None, None) and found.heave_down_m is None:
            raise Refused("bad_quality")
        self.refused["bad_quality"] += bool(invalid)
        return found

    def _pashr(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        found = say.pashr(m)
        stamp = self._receiver("PASHR").timed(time_ns(pynmea2.nmea_utils.timestamp(text(m, 1))), received_at)
        return self._of_sensor("PASHR", found, received_at, stamp)

    def _prdid(self, m: Any, of: _Receiver, received_at: MonoNs) -> Samples:
        return self._of_sensor("PRDID", say.motion(text(m, 2), text(m, 1), "", text(m, 3)), received_at)

    def _tss1(self, line: str, received_at: MonoNs) -> Samples:
        return [self._moved("TSS1", say.tss1(line), _arrival(received_at))]

    def _em3000(self, record: bytes, received_at: MonoNs) -> Samples:
        return self._counted("EM3000", "EM3000", lambda: self._of_sensor("EM3000", say.em3000(record), received_at), received_at)

    def _of_sensor(self, kind: str, found: ShipMotion, received_at: MonoNs, stamp: Stamp | None = None) -> Samples:
        """Return the motion, and the heading in it, of a sentence that has no talker: it is one of whose heading it has."""
        owner = self._owner(found, received_at)
        stamp = stamp or (_arrival(received_at) if owner is None else owner.untimed(kind, received_at))
        sensor = kind if owner is None else f"{owner.name} {kind}"
        out: Samples = [self._moved(sensor, found, stamp)]
        if found.heading_rad is not None:
            with suppress(Refused):  # the heading of a compass's own sentence is used
                out += self._chosen(
                    sensor, [_pointing(stamp, found.heading_rad, found.sigma_heading_rad)], received_at, _INDIRECT
                )
        return out

    def _owner(self, found: ShipMotion, now: MonoNs) -> _Receiver | None:
        """Return the receiver whose newest heading is that of a motion, to the digit."""
        if found.heading_rad is None:
            return None
        same = math.degrees(found.heading_rad), 2.0 * math.degrees(found.sigma_heading_rad)
        alike = [
            of for of in self._receivers.values()
            if of.heading is not None and seconds_between(of.heading[0], now) <= 1.0 and abs(of.heading[1] - same[0]) < same[1]
        ]  # fmt: skip
        self._motions += 1.0
        for of in alike:
            of.matches += 1.0
        if self._motions > _MOTIONS:
            self._motions *= 0.5
            for of in self._receivers.values():
                of.matches *= 0.5
        # Another compass has the same heading by chance, now and then; the heading of an owner may be lost.
        owners = [of for of in self._receivers.values() if of.matches > 0.0 and of.matches >= _OWNS * self._motions]
        mine = [of for of in owners if of in alike]
        owner = max(mine, key=lambda of: of.matches) if mine else min(owners, key=lambda of: of.moved_at, default=None)
        if owner is not None:
            owner.moved_at = now
        return owner

    def _moved(self, sensor: str, found: ShipMotion, stamp: Stamp) -> VesselMotion:
        return VesselMotion(stamp, self._prefix + sensor, *found[:6])

    def _worth(self, table: Mapping[Any, float | str], said: object) -> float:
        """Return the standard deviation of a place by what its sentence says of it, m.

        Raises:
            Refused: it is none to fly by, or says what no receiver does.
        """
        worth = table.get(said, "impossible")
        if worth == "simulated" and self._simulated:
            return _FIX_SIGMA_M
        if isinstance(worth, str):
            raise Refused(worth)
        return worth

    def _ais(self, line: str, received_at: MonoNs) -> Samples:
        if line.split(",")[1] != "1":
            raise Refused("other_sentence")  # position reports are never longer than one sentence
        m: Any = pyais.decode(line.encode("ascii"), error_if_checksum_invalid=True)
        if m.msg_type not in _AIS_REPORTS:
            raise Refused("other_sentence")
        if self._mmsi == 0 or int(m.mmsi) != self._mmsi:
            raise Refused("other_ship")
        if abs(number(m.lat)) > 90.0 or abs(number(m.lon)) > 180.0:  # 91 and 181 say that there is no fix
            raise Refused("no_fix")
        where = GeoPoint.of_degrees(number(m.lat), number(m.lon))
        v = velocity(m.speed, m.course if number(m.course) < 360.0 else None) if number(m.speed) <= SPEED_MAX_KN else None
        second, sigma_m = int(number(m.second)), _AIS_SIGMA_M[bool(m.accuracy)]
        if second in _AIS_NO_PLACE:
            raise Refused(_AIS_NO_PLACE[second])
        if second == _AIS_RECKONED:
            sigma_m, v = _RECKONED_SIGMA_M, None
        stamp = self._minute.stamp(second * NS_PER_S, received_at) if second < 60 else _arrival(received_at)
        out: Samples = [GeoFix(stamp, "vessel", where, sigma_m, v), *_moving(stamp, v)]
        if 0 <= number(m.heading) < 360:
            out.append(VesselReport(stamp, None, None, math.radians(number(m.heading)), HEADING_SIGMA_RAD))
        return self._chosen("AIS", out, received_at)


class _Ths(pynmea2.TalkerSentence):  # type: ignore[misc]
    """True heading and status, which pynmea2 does not know."""

    fields = (("Heading", "heading"), ("Mode", "mode"))


def _options(wrap_ns: int, resolution_s: float) -> ClockMapOptions:
    return ClockMapOptions(
        wrap_ns=wrap_ns, resolution_s=resolution_s, floor_sigma_s=0.1, window_s=600.0, jump_s=5.0, name="the ship's receiver"
    )


def _arrival(received_at: MonoNs) -> Stamp:
    return Stamp(received_at, received_at, _ARRIVAL_SIGMA_S, "arrival")


def _recent(report: VesselReport | None, now: MonoNs) -> VesselReport | None:
    return None if report is None or seconds_between(report.stamp.received_at, now) > _WAY_S else report


def _pointing(stamp: Stamp, heading_rad: float, rounded_rad: float) -> VesselReport:
    return VesselReport(stamp, None, None, heading_rad, math.hypot(HEADING_SIGMA_RAD, rounded_rad))


def _moving(stamp: Stamp, v: F64 | None, speed_kn: str = "") -> Samples:
    if v is None:
        return []
    cov = COV_SPEED
    if speed_kn:
        cov = COV_SPEED + rounding(speed_kn, KNOT_M_S) ** 2 * np.diag([1.0, 1.0, 0.0])
    return [VesselReport(stamp, v, cov, None, None)]


def _quantity(sample: GeoFix | VesselReport | VesselMotion | VesselWind, inflation: float, source: str) -> tuple[str, str, float]:
    """Return what a sample reports, by which source, and how well, for the choice of one source."""
    match sample:
        case GeoFix():
            return "place", source, sample.sigma_m
        case VesselReport(cov_v_ned=cov) if cov is not None:
            return "velocity", source, math.sqrt(float(cov[0, 0]))
        case VesselReport(sigma_heading_rad=sigma) if sigma is not None:
            return "heading", source, inflation * sigma
        case VesselReport():
            return "turn", source, sample.sigma_turn_rad_s or 0.0
        case VesselWind():
            return "wind", source, inflation
    return "motion", source, 0.0
