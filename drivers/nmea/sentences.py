"""Sentences of NMEA 0183 (RMC, GGA, VTG, HDT) and AIS (VDM, VDO of one ship) to samples.

pynmea2 and pyais take the sentences apart. Every sentence needs its checksum, every number is checked before it is used, and
what is not taken is counted by its reason. Nothing on the wire raises.

They arrive by UDP, TCP or a serial port. By UDP an address counts and not a port: several programs of one computer may send, each
line from a port of its own (a shell loop). Sentences that are cut between datagrams are put together for each port alone, so that
programs do not mix.

Source: NMEA 0183 version 4.11; ITU-R M.1371-5, annex 8, tables 48 and 70 (position reports of classes A and B).
"""

import datetime
import ipaddress
import logging
import math
import re
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

import numpy as np
import pyais
import pynmea2

from drivers.clock_map import ClockMap, ClockMapOptions
from drivers.endpoint import Address, Endpoint
from drivers.wires import Wire, open_wire
from estimator.contracts.errors import Recoverable
from estimator.contracts.geodesy import GeoPoint
from estimator.contracts.samples import UNKNOWN_VAR, GeoFix, VesselReport
from estimator.contracts.time import NS_PER_S, Clock, MonoNs, Stamp, seconds_between

KNOT_M_S = 1852.0 / 3600.0
DATAGRAM_MAX = 65_535
LINES_MAX = 800
_LINE_MAX = 1024
_DAY_NS, _MINUTE_NS = 86_400 * NS_PER_S, 60 * NS_PER_S
_ARRIVAL_SIGMA_S = 0.2
"""Standard deviation of the instant of a sentence without a time."""
_FIX_SIGMA_M = 2.5
"""Standard deviation of a place at a dilution of precision of 1."""
_DILUTION = 2.0
"""The dilution of precision of a sentence without it."""
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
_AIS_SIGMA_M = {True: 5.0, False: 10.0}
"""Standard deviation of a position by the flag of AIS, m: the flag shows only whether it is better than 10 m."""
HEADING_SIGMA_RAD = math.radians(2.0)
"""Standard deviation of a ship's compass."""
COV_SPEED = np.diag([0.2**2, 0.2**2, UNKNOWN_VAR])
"""(3, 3) (m/s)^2 covariance of a ship's velocity by her GNSS receiver, which has no vertical one."""
COV_SPEED.setflags(write=False)
_SPEED_MAX_KN = 102.0
_COURSE_FROM_M_S = 0.3
"""Speed below which a receiver may leave the course out."""
_AIS_NO_PLACE, _AIS_RECKONED = {61: "typed_in", 63: "no_fix"}, 62
"""Seconds of the minute above 60, which say how the transponder has its place."""
_AIS_REPORTS = (1, 2, 3, 18, 19)

REFUSED_FOR = {
    "no_fix": "the receiver has no fix",
    "no_heading": "the compass has no heading yet",
    "typed_in": "her place was typed in by hand",
    "simulated": "it says that it is simulated; for a rehearsal set expert.vessel.nmea_simulated",
    "reckoned": "its velocity is reckoned from an old place",
    "impossible": "it holds a number that no ship has",
}
"""Meanings of reasons whose names alone are not clear."""

Samples = list[GeoFix | VesselReport]


class NmeaReader:
    """Reads the sentences of one ship.

    Args:
        mmsi: whose AIS reports are taken; 0 for nobody's.
        simulated: whether what says that it is simulated is worth what a fix is: a rehearsal.
    """

    def __init__(self, mmsi: int = 0, simulated: bool = False) -> None:
        self._mmsi = mmsi
        self._simulated = simulated
        # The window is long, so that a link that becomes slow is reported as late reports and not as another clock.
        self._day = ClockMap(_options(_DAY_NS, 0.01))
        self._minute = ClockMap(_options(_MINUTE_NS, 1.0))
        self.taken: Counter[str] = Counter()
        """The number of sentences that gave a sample, by kind."""
        self.refused: Counter[str] = Counter()
        """The number of sentences that were not taken, by reason."""
        self._table: dict[str, Callable[[Any, MonoNs], Samples]] = {
            "RMC": self._rmc, "GGA": self._gga, "VTG": self._vtg, "HDT": self._hdt,
        }  # fmt: skip

    def samples(self, datagram: bytes, received_at: MonoNs) -> Samples:
        """Return every sample in one datagram."""
        out: Samples = []
        for line in self._lines(datagram):
            try:
                out += self._sentence(line, received_at)
            except _Refused as why:
                self.refused[str(why)] += 1
            except Exception:  # the libraries raise many kinds on damaged fields, and none of it may end the part
                self.refused["malformed"] += 1
        return out

    def _lines(self, datagram: bytes) -> Iterator[str]:
        if len(datagram) > DATAGRAM_MAX:
            self.refused["too_long"] += 1
            return
        lines = [line for line in datagram.decode("ascii", "replace").splitlines() if line.strip()]
        short = [line for line in lines[:LINES_MAX] if len(line) <= _LINE_MAX]
        if len(lines) > len(short):
            self.refused["too_long"] += len(lines) - len(short)
        yield from short

    def _sentence(self, line: str, received_at: MonoNs) -> Samples:
        line = line.strip()
        if line.startswith("\\"):  # a TAG block of NMEA 4 before the sentence
            line = line[1:].partition("\\")[2]
        if not checked(line):
            raise _Refused("checksum")
        if line.startswith("!"):
            return self._counted("AIS", self._ais(line, received_at))
        kind = line[3:6]
        if kind not in self._table or line[1] == "P":  # a vendor's own, as Garmin's PGRMC, is none of these
            self.refused["other_sentence"] += 1
            return []
        return self._counted(kind, self._table[kind](pynmea2.parse(line, check=True), received_at))

    def _counted(self, kind: str, made: Samples) -> Samples:
        self.taken[kind] += 1
        return made

    def _rmc(self, m: Any, received_at: MonoNs) -> Samples:
        if m.status != "A":
            raise _Refused("no_fix")
        sigma_m = self._worth(_OF_MODE, _field(m, 11))
        place, v = _place(m), None if m.spd_over_grnd is None else _velocity(m.spd_over_grnd, m.true_course)
        v = v if sigma_m < _RECKONED_SIGMA_M else None
        stamp = self._day.stamp(_time_ns(m.timestamp), received_at)
        return [GeoFix(stamp, "vessel", place, sigma_m, v), *_moving(stamp, v)]

    def _gga(self, m: Any, received_at: MonoNs) -> Samples:
        sigma_m = self._worth(_OF_QUALITY, int(_number(m.gps_qual)))
        dilution = _DILUTION if m.horizontal_dil in (None, "") else _number(m.horizontal_dil)
        place = _place(m, None if m.altitude is None else _number(m.altitude))
        return [GeoFix(self._day.stamp(_time_ns(m.timestamp), received_at), "vessel", place, sigma_m * max(1.0, dilution))]

    def _vtg(self, m: Any, received_at: MonoNs) -> Samples:
        if self._worth(_OF_MODE, _field(m, 8)) >= _RECKONED_SIGMA_M:
            raise _Refused("reckoned")
        if m.spd_over_grnd_kts is None:
            raise _Refused("no_fix")
        return _moving(_arrival(received_at), _velocity(m.spd_over_grnd_kts, m.true_track))

    def _hdt(self, m: Any, received_at: MonoNs) -> Samples:
        if not m.heading:
            raise _Refused("no_heading")
        heading_deg = _number(m.heading)
        if m.hdg_true != "T" or not 0.0 <= heading_deg <= 360.0:
            raise _Refused("impossible")
        return [VesselReport(_arrival(received_at), None, None, math.radians(heading_deg), HEADING_SIGMA_RAD)]

    def _worth(self, table: Mapping[Any, float | str], said: object) -> float:
        """Return the standard deviation of a place by what its sentence says of it, m.

        Raises:
            _Refused: it is none to fly by, or says what no receiver does.
        """
        worth = table.get(said, "impossible")
        if worth == "simulated" and self._simulated:
            return _FIX_SIGMA_M
        if isinstance(worth, str):
            raise _Refused(worth)
        return worth

    def _ais(self, line: str, received_at: MonoNs) -> Samples:
        if line.split(",")[1] != "1":
            raise _Refused("other_sentence")  # position reports are never longer than one sentence
        m: Any = pyais.decode(line.encode("ascii"), error_if_checksum_invalid=True)
        if m.msg_type not in _AIS_REPORTS:
            raise _Refused("other_sentence")
        if self._mmsi == 0 or int(m.mmsi) != self._mmsi:
            raise _Refused("other_ship")
        try:
            place = GeoPoint.of_degrees(_number(m.lat), _number(m.lon))
        except ValueError:  # 91 and 181 say that there is no fix
            raise _Refused("no_fix") from None
        v = _velocity(m.speed, m.course if _number(m.course) < 360.0 else None) if _number(m.speed) <= _SPEED_MAX_KN else None
        second, sigma_m = int(_number(m.second)), _AIS_SIGMA_M[bool(m.accuracy)]
        if second in _AIS_NO_PLACE:
            raise _Refused(_AIS_NO_PLACE[second])
        if second == _AIS_RECKONED:
            sigma_m, v = _RECKONED_SIGMA_M, None
        stamp = self._minute.stamp(second * NS_PER_S, received_at) if second < 60 else _arrival(received_at)
        out: Samples = [GeoFix(stamp, "vessel", place, sigma_m, v), *_moving(stamp, v)]
        if 0 <= _number(m.heading) < 360:
            out.append(VesselReport(stamp, None, None, math.radians(_number(m.heading)), HEADING_SIGMA_RAD))
        return out


class _Refused(Exception):
    """A sentence is not taken; the text is the name of the counter."""


def checked(sentence: str) -> bool:
    """Return whether a sentence begins as one and ends with the exclusive-or of what lies between."""
    body, star, digits = sentence[1:].rpartition("*")
    if sentence[:1] not in ("$", "!") or not star or len(digits) != 2:
        return False
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"{check:02X}" == digits.upper()


class ShipMotion(NamedTuple):
    """The attitude of a ship, and the heave of the place where her motion sensor is."""

    roll_rad: float
    """Starboard down positive."""
    pitch_rad: float
    """Bow up positive."""
    heading_rad: float
    heave_down_m: float


def ship_motion(sentence: str) -> ShipMotion | None:
    """Return what a motion sensor's `$PSXN,23` says; None for another sentence, or one with a fault.

    The sign of the heave is that of recorded sentences, beside the heights in the GGA of the same receiver.
    """
    cells = sentence.partition("*")[0].split(",")
    if cells[:2] != ["$PSXN", "23"] or not checked(sentence):
        return None
    try:
        roll, pitch, heading, heave_down_m = (_number(cell) for cell in cells[2:])
    except (_Refused, ValueError):
        return None
    return ShipMotion(math.radians(roll), math.radians(pitch), math.radians(heading), heave_down_m)


def _options(wrap_ns: int, resolution_s: float) -> ClockMapOptions:
    return ClockMapOptions(
        wrap_ns=wrap_ns, resolution_s=resolution_s, floor_sigma_s=0.1, window_s=600.0, jump_s=5.0, name="the ship's receiver"
    )


def _arrival(received_at: MonoNs) -> Stamp:
    return Stamp(received_at, received_at, _ARRIVAL_SIGMA_S, "arrival")


def _number(value: object) -> float:
    """Return a field as a finite number.

    Raises:
        _Refused: it is none, or left out.
    """
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise _Refused("malformed") from None
    if not math.isfinite(number):
        raise _Refused("impossible")
    return number


def _field(m: Any, index: int) -> str:
    """Return a field that older versions of the standard do not have, empty where it is not there."""
    return str(m.data[index]).strip() if len(m.data) > index else ""


def _time_ns(value: object) -> int:
    """Return the time of day, nanoseconds.

    Raises:
        _Refused: it is left out or none.
    """
    if not isinstance(value, datetime.time):
        raise _Refused("malformed")
    return (value.hour * 3600 + value.minute * 60 + value.second) * NS_PER_S + value.microsecond * 1000


def _place(m: Any, height_m: float | None = None) -> GeoPoint:
    """Return the place of a sentence.

    Raises:
        _Refused: there is no such place, or a part of it is left out.
    """
    for text in (m.lat, m.lon):
        if text and _number(text) % 100.0 >= 60.0:
            raise _Refused("impossible")  # minutes of arc
    if m.lat_dir not in ("N", "S") or m.lon_dir not in ("E", "W") or not m.lat or not m.lon:
        raise _Refused("malformed")
    try:
        return GeoPoint.of_degrees(float(m.latitude), float(m.longitude), height_m)
    except ValueError:
        raise _Refused("impossible") from None


def _velocity(speed_kn: object, course_deg: object) -> np.ndarray[tuple[int], np.dtype[np.float64]] | None:
    """Return the velocity over the ground, (3,) m/s in ned; None if a ship that moves reports no course.

    Raises:
        _Refused: the speed is left out, or no ship's.
    """
    speed = KNOT_M_S * _number(speed_kn)
    if not 0.0 <= speed <= KNOT_M_S * _SPEED_MAX_KN:
        raise _Refused("impossible")
    if course_deg in (None, ""):
        return np.zeros(3) if speed < _COURSE_FROM_M_S else None
    course = math.radians(_number(course_deg))
    if not 0.0 <= course <= 2.0 * math.pi:
        raise _Refused("impossible")
    return np.array([speed * math.cos(course), speed * math.sin(course), 0.0])


def _moving(stamp: Stamp, v: np.ndarray[tuple[int], np.dtype[np.float64]] | None) -> Samples:
    if v is None:
        return []
    return [VesselReport(stamp, v, COV_SPEED, None, None)]


_log = logging.getLogger(__name__)

HELD_S = 30.0
"""Silence after which another sender is listened to, unless the settings name one."""
_CUT_S = 2.0
"""Age at which the begin of a sentence waits no longer for its end."""
_CUT_MAX = 512
"""Bytes of a sentence without its end; NMEA 0183 allows 82, and a TAG block before them."""
_SENDERS_MAX = 16
_BEGINS = (b"$", b"!", b"\\")
_TAG = re.compile(rb"\\[^\\]+\\")
_ENDS = re.compile(rb"(\\[^\\]*\\)?[^\\]*\*[0-9A-Fa-f]{2}\s*")
"""A sentence that needs no line end behind it: after its TAG block, if it has one, it ends with its checksum."""


class SentenceJoiner:
    """Returns the whole lines of what arrives in pieces, for each sender alone."""

    def __init__(self) -> None:
        self._begun: dict[Address | None, tuple[MonoNs, bytes]] = {}
        self.cut = 0
        """The number of sentences whose end or begin never came."""

    def lines(self, data: bytes, sender: Address | None, now: MonoNs) -> list[bytes]:
        """Return the lines that are complete now; a whole sentence needs no line end behind it."""
        at, begun = self._begun.pop(sender, (now, b""))
        another = data.startswith((b"$", b"!")) and not _TAG.fullmatch(begun)
        if begun and (another or seconds_between(at, now) > _CUT_S):
            self.cut += 1
            begun = b""
        *lines, rest = (begun + data).replace(b"\r", b"\n").split(b"\n")
        if _ENDS.fullmatch(rest):
            lines.append(rest)
        elif rest:
            self._keep(rest, sender, now)
        whole = [line for line in lines if line.strip()]
        if whole and not begun and not whole[0].startswith(_BEGINS) and _ENDS.fullmatch(whole[0]):
            self.cut += 1  # the end of a sentence whose begin was not received
            del whole[0]
        return whole

    def _keep(self, rest: bytes, sender: Address | None, now: MonoNs) -> None:
        if len(rest) > _CUT_MAX or not rest.startswith(_BEGINS):
            self.cut += 1
            return
        self._begun[sender] = now, rest
        if len(self._begun) > _SENDERS_MAX:
            del self._begun[next(iter(self._begun))]
            self.cut += 1


class SentenceSource:
    """Passes whole lines of the ship's sender on, with the instant at which they arrived.

    Args:
        sender: the address that datagrams must come from; empty for the first that is received.
        received: takes lines, with line feeds between, at most as many as a reader takes at once.
    """

    def __init__(self, sender: str, received: Callable[[bytes, MonoNs], None]) -> None:
        self._sender = sender
        self._received = received
        self._held: tuple[str, MonoNs] | None = None
        self._joiner = SentenceJoiner()
        self._refused: Counter[str] = Counter()

    @property
    def refused(self) -> Counter[str]:
        """The number of datagrams of other senders or too long, and of sentences that were cut for good."""
        return self._refused + Counter(cut=self._joiner.cut)

    def take(self, data: bytes, now: MonoNs, sender: Address | None) -> None:
        """Take what arrived; `sender` is None where there is only one."""
        if sender is not None and not self._listens_to(sender, now):
            return
        if sender is not None and len(data) > DATAGRAM_MAX:
            self._refused["too_long"] += 1
            return
        lines = self._joiner.lines(data, sender, now)
        for first in range(0, len(lines), LINES_MAX):
            self._received(b"\n".join(lines[first : first + LINES_MAX]), now)

    def _listens_to(self, sender: Address, now: MonoNs) -> bool:
        address = _plain(sender[0])
        listened_to = self._sender
        if not listened_to and self._held is not None and seconds_between(self._held[1], now) <= HELD_S:
            listened_to = self._held[0]
        if listened_to and address != _plain(listened_to):
            if not self._refused["wrong_sender"]:
                _log.warning(
                    "sentences from %s are refused, those from %s are taken (vessel.nmea_from chooses); the next ones are "
                    "counted only",
                    address,
                    listened_to,
                )
            self._refused["wrong_sender"] += 1
            return False
        self._held = address, now
        return True


def _plain(address: str) -> str:
    """Return an address in one form: a socket for IPv6 writes those of IPv4 in its own."""
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        return address
    return str(getattr(found, "ipv4_mapped", None) or found)


@asynccontextmanager
async def sentences_from(endpoint: Endpoint, source: SentenceSource, clock: Clock) -> AsyncIterator[Wire]:
    """Open the way by which sentences arrive, and close it on leaving.

    Raises:
        Recoverable: it cannot be opened: the address is not of this computer, another program has it, nobody listens there, or
            there is no such device.
    """
    try:
        async with open_wire(endpoint, clock, source.take) as wire:
            yield wire
    except Recoverable as why:
        raise Recoverable(f"vessel.nmea {endpoint}: {why}") from why
