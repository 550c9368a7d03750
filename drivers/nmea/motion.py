"""Read motion sensors and anemometers of a ship: roll, pitch, heave and wind, each with the signs of its own format.

Everything is returned in one sense: roll with starboard down, pitch with the bow up, heave downward.

Sources of the signs: PSXN, Seapath's documentation as pynmea2 has it, and recorded sentences beside the heights in the GGA of the
same receiver; TSS1, PASHR and PRDID, the manuals of Teledyne TSS, Applanix POS MV and NovAtel SPAN (port up, bow up, heave up);
XDR, NMEA 0183 with the names of Airmar; EM3000, Kongsberg's "EM Attitude 3000" (port up, bow up, heave up).
"""

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from drivers.nmea.fields import KNOT_M_S, Refused, checked, heading_deg, number, rounding, text, within
from estimator.contracts.geometry import F64

TILT_MAX_DEG = 60.0
"""Roll or pitch beyond this is of no ship."""
HEAVE_MAX_M = 20.0
"""Heave beyond this is of no ship."""
WIND_MAX_M_S = 100.0
"""Wind beyond this is of no ship."""
TURN_MAX_DEG_S = 60.0
"""Rate of turn beyond this is of no ship."""
_ANGLE, _HEAVE = re.compile(r"(?:(ROLL|HEEL)|(?:PITCH|PTCH)).*"), re.compile(r"HEAVE?\b.*")
_TSS1 = re.compile(r":([0-9A-F]{2})[0-9A-F]{4} ([ -]\d{4})([UGHF])([ -]\d{4}) ([ -]\d{4})", re.ASCII | re.IGNORECASE)
_TSS1_M_S2 = 0.03835
"""Last digit of its horizontal acceleration, m/s^2: 9.8 m/s^2 by two hexadecimal digits."""
_EM_SIZE = 10  # length of a record of EM3000, bytes
EM_SYNC = 0x90
"""Second byte of such a record."""
_EM_VALID = (0x00, *range(0x90, 0x9A))
"""First bytes of a record of EM1000, and of EM3000 at full or reduced accuracy."""
_EM_STATES = (*_EM_VALID, *range(0x9A, 0xB0))
_SPEED_UNITS = {"N": KNOT_M_S, "K": 1.0 / 3.6, "M": 1.0, "S": 0.44704}


class ShipMotion(NamedTuple):
    """The attitude of a ship, and the heave of the place where her motion sensor is; None for a part that is left out."""

    roll_rad: float | None
    """Starboard down positive."""
    pitch_rad: float | None
    """Bow up positive."""
    sigma_tilt_rad: float
    """Standard deviation that the digits leave; those of the heave and of the heading follow."""
    heave_down_m: float | None
    sigma_heave_m: float
    acceleration_m_s2: float | None
    """Horizontal, without a direction."""
    heading_rad: float | None
    sigma_heading_rad: float


def motion(roll: str, pitch: str, heave: str = "", heading: str = "", down: float = 1.0) -> ShipMotion:
    """Return what the cells of a sentence say, degrees and metres; `down` is -1 where its heave is upward.

    Raises:
        Refused: all of roll, pitch and heave are empty, or one is no number or none of a ship.
    """
    tilts = [within(cell, -TILT_MAX_DEG, TILT_MAX_DEG) for cell in (roll, pitch)]
    heave_m = within(heave, -HEAVE_MAX_M, HEAVE_MAX_M)
    bow = math.radians(heading_deg(heading)) if heading else None
    if tilts == [None, None] and heave_m is None:
        raise Refused("no_motion")
    roll_rad, pitch_rad = (None if tilt is None else math.radians(tilt) for tilt in tilts)
    sigma_tilt_rad = max((rounding(cell, math.radians(1.0)) for cell in (roll, pitch) if cell), default=0.0)
    sigma_heading_rad = rounding(heading, math.radians(1.0)) if heading else 0.0
    heave_down_m, sigma_heave_m = (None, 0.0) if heave_m is None else (down * heave_m, rounding(heave))
    return ShipMotion(roll_rad, pitch_rad, sigma_tilt_rad, heave_down_m, sigma_heave_m, None, bow, sigma_heading_rad)


def ship_motion(sentence: str) -> ShipMotion | None:
    """Return what a motion sensor's whole `$PSXN,23` says; None for another sentence, or one with a fault."""
    cells = sentence.partition("*")[0].split(",")
    if cells[:2] != ["$PSXN", "23"] or not checked(sentence) or not all(cells[2:6]) or len(cells) != 6:
        return None
    try:
        return motion(cells[2], cells[3], cells[5], cells[4])
    except Refused:
        return None


def pashr(m: Any) -> ShipMotion:
    """Return what a PASHR with a time says.

    Raises:
        Refused: it is another message of that name, its inertial unit is not aligned, or as in `motion`.
    """
    if not text(m, 1)[:1].isdigit():
        raise Refused("other_sentence")  # a receiver's answers ($PASHR,POS) begin with a word
    if text(m, 11) == "0":
        raise Refused("bad_quality")
    found = motion(text(m, 4), text(m, 5), text(m, 6), text(m, 2) if text(m, 3) == "T" else "", -1.0)
    sigma_deg = max((within(text(m, index), 0.0, 90.0) or 0.0 for index in (7, 8)), default=0.0)
    return found._replace(sigma_tilt_rad=max(found.sigma_tilt_rad, math.radians(sigma_deg)))


def xdr(cells: Sequence[str]) -> list[tuple[str, ShipMotion]]:
    """Return the motions in the quadruples of an XDR (type, value, unit, name), each with the number behind its names.

    Raises:
        Refused: none of them is of motion, or as in `motion`.
    """
    found: dict[str, dict[str, str]] = {}
    for at in range(0, len(cells) - 3, 4):
        kind, value, unit, name = (cell.strip() for cell in cells[at : at + 4])
        part = _xdr_part(kind, unit, name)
        if part and value:
            found.setdefault("".join(filter(str.isdigit, name)), {})[part] = value
    if not found:
        raise Refused("other_sentence")
    return [
        (number, motion(parts.get("roll", ""), parts.get("pitch", ""), parts.get("heave", ""), down=-1.0))
        for number, parts in found.items()
    ]


def _xdr_part(kind: str, unit: str, name: str) -> str:
    """Return which part of the motion a transducer measures; empty for another."""
    if (kind, unit) == ("A", "D") and (angle := _ANGLE.fullmatch(name)):
        return "roll" if angle[1] else "pitch"
    return "heave" if (kind, unit) == ("D", "M") and _HEAVE.fullmatch(name) else ""


def tss1(line: str) -> ShipMotion:
    """Return what a record of TSS1 says: fixed columns without a checksum, cm and hundredths of a degree.

    Raises:
        Refused: it is another line, the sensor has not settled, or a number is none of a ship.
    """
    found = _TSS1.fullmatch(line)
    if found is None:
        raise Refused("malformed")
    aside, heave, status, roll, pitch = (cell.replace(" ", "") for cell in found.groups())
    if status.islower():
        raise Refused("bad_quality")
    of = motion(f"{roll}E-2", f"{pitch}E-2", f"{heave}E-2", down=-1.0)
    return of._replace(acceleration_m_s2=_TSS1_M_S2 * int(aside, 16))


def is_em3000(data: bytes, at: int = 0) -> bool:
    """Return whether a record of Kongsberg's EM3000 or EM1000 begins at a byte, as far as the bytes go."""
    return data[at : at + 1] != b"" and data[at] in _EM_STATES and data[at + 1 : at + 2] in (b"", bytes([EM_SYNC]))


def em3000_records(data: bytes) -> tuple[list[bytes], bytes]:
    """Return the whole records in bytes of a stream, and what may be the begin of the next one.

    They have no checksum: a record counts where the next one begins behind it, or nothing does.
    """
    records, at = list[bytes](), 0
    while at < len(data):
        end = at + _EM_SIZE
        if not is_em3000(data, at) or (len(data) > end and not is_em3000(data, end)):
            at += 1
        elif len(data) < end:
            break
        else:
            records.append(data[at:end])
            at = end
    return records, data[at:]


def em3000(record: bytes) -> ShipMotion:
    """Return what a record of 10 bytes says: status, 90h, roll, pitch, heave and heading, little-endian, of 0.01 degree or m.

    Raises:
        Refused: the sensor says that it is not valid, or a number is none of a ship.
    """
    if record[0] not in _EM_VALID:
        raise Refused("bad_quality")
    roll, pitch, heave = (f"{int.from_bytes(record[i : i + 2], 'little', signed=True)}E-2" for i in (2, 4, 6))
    return motion(roll, pitch, heave, f"{int.from_bytes(record[8:], 'little')}E-2", -1.0)


def turn(cell: str, per_s: float) -> tuple[float, float]:
    """Return a rate of turn to starboard and the standard deviation of its digits, rad/s; `per_s` is a unit of the cell in deg/s.

    Raises:
        Refused: it is empty, no number, or none of a ship.
    """
    rate = within(cell, -TURN_MAX_DEG_S / per_s, TURN_MAX_DEG_S / per_s)
    if rate is None:
        raise Refused("no_turn")
    return math.radians(per_s * rate), rounding(cell, math.radians(per_s))


class Wind(NamedTuple):
    """A wind as a sentence has it."""

    from_rad: float
    """Direction that it blows from, clockwise from the bow or from north."""
    speed_m_s: float
    reference: str
    """R: apparent, from the bow; T: true, from the bow; N: true, from north."""


def mwv(m: Any) -> Wind:
    """Return the wind of an MWV.

    Raises:
        Refused: it is not valid, or a part is left out or none of a wind.
    """
    if text(m, "status") not in ("", "A"):
        raise Refused("not_valid")
    unit = _SPEED_UNITS.get(text(m, "wind_speed_units"))
    reference = text(m, "reference")
    if unit is None or reference not in ("R", "T"):
        raise Refused("malformed")
    return _wind(text(m, "wind_angle"), text(m, "wind_speed"), unit, reference)


def mwd(m: Any) -> Wind:
    """Return the wind of an MWD, from its true direction.

    Raises:
        Refused: a part is left out or none of a wind.
    """
    metres = text(m, "wind_speed_meters")
    return _wind(text(m, "direction_true"), metres or text(m, "wind_speed_knots"), 1.0 if metres else KNOT_M_S, "N")


def _wind(angle: str, speed: str, unit: float, reference: str) -> Wind:
    from_deg, fast = within(angle, 0.0, 360.0), within(speed, 0.0, WIND_MAX_M_S / unit)
    if from_deg is None or fast is None:
        raise Refused("no_wind")
    return Wind(math.radians(from_deg), unit * fast, reference)


def over_ground(from_rad: float, speed_m_s: float, v_ship: F64) -> tuple[float, float]:
    """Return direction (rad from north) and speed (m/s) over the ground of a wind felt so on a ship of v_ship, (3,) m/s."""
    north, east = (v_ship[:2] - speed_m_s * np.array([math.cos(from_rad), math.sin(from_rad)])).tolist()
    return math.atan2(-east, -north), math.hypot(north, east)


def quality(m: Any) -> tuple[int, int, int]:
    """Return the qualities of heave, heading, and roll and pitch in a PSXN,20: 0 normal, 1 reduced, 2 not valid.

    Raises:
        Refused: one of them is none of these.
    """
    heave, heading, tilt = (int(number(text(m, index))) for index in (3, 4, 5))
    if not {heave, heading, tilt} <= {0, 1, 2}:
        raise Refused("impossible")
    return heave, heading, tilt
