"""Files of other programs, made message by message: dataflash (binary and text), ULog, telemetry logs, navdata."""

import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common

_CODES = {"Q": "Q", "B": "B", "f": "f", "C": "H", "c": "h", "I": "I", "N": "16s", "Z": "64s", "n": "4s"}
_ULOG_CODES = {"bool": "?", "uint8_t": "B", "uint32_t": "I", "float": "f"}
KINDS = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "IMU": (129, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (130, "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw"),
    "RFND": (131, "QBCBB", "TimeUS,Instance,Dist,Stat,Orient"),
    "PARM": (132, "QNf", "TimeUS,Name,Value"),
    "MSG": (133, "QZ", "TimeUS,Message"),
    "EV": (134, "QB", "TimeUS,Id"),
    "ERR": (135, "QBB", "TimeUS,Subsys,ECode"),
    "VIBE": (136, "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip"),
    "XKF4": (137, "QBccccB", "TimeUS,C,SV,SP,SH,SM,PI"),
    "PL": (138, "QBB", "TimeUS,Heal,TAcq"),
    "BARO": (139, "QBfB", "TimeUS,I,Alt,H"),
    "XKF1": (140, "QBfff", "TimeUS,C,VN,VE,VD"),
    "NKF1": (141, "QBfff", "TimeUS,C,VN,VE,VD"),
}
DEFAULTS = {"PARM": (132, "QNff", "TimeUS,Name,Value,Default")}
"""The parameters of a log that has their defaults beside them."""
Row = tuple[str, tuple[float | int | str, ...]]
TimedRow = tuple[float, str, Sequence[Any]]
"""Seconds, message or topic, and its values after the time."""


def flight(times_us: Sequence[int], heights_m: Sequence[float], *, forward_m: float | None = None) -> list[Row]:
    """IMU, attitude and a rangefinder that looks down, at each instant; with one before it that looks forward."""
    rows: list[Row] = [("MSG", (times_us[0], "ArduCopter V4.5.7 (0f3a5b1c)")), ("PARM", (times_us[0], "GUID_TIMEOUT", 0.2))]
    for at, height_m in zip(times_us, heights_m, strict=True):
        rows.append(("IMU", (at, 0, 0.0, 0.0, 0.0, 0.0, 0.0, -9.81)))
        rows.append(("ATT", (at, 0.0, 1.0, 0.0, -1.0, 90.0, 90.0)))
        if forward_m is not None:
            rows.append(("RFND", (at + 1000, 0, forward_m, 4, 0)))
        rows.append(("RFND", (at + 2000, 0 if forward_m is None else 1, height_m, 4, 25)))
    return rows


def described(name: str, form: str, columns: str) -> bytes:
    """Return the description of a message in a dataflash log."""
    size = 3 + struct.calcsize("<" + "".join(_CODES[c] for c in form))
    fields = KINDS[name][0], size, name.encode(), form.encode(), columns.encode()
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", *fields)


def message(name: str, form: str, values: Sequence[float | int | str]) -> bytes:
    """Return one message of a dataflash log."""
    packed = [v.encode() if isinstance(v, str) else round(v * 100) if c == "C" else v for c, v in zip(form, values, strict=True)]
    return b"\xa3\x95" + bytes([KINDS[name][0]]) + struct.pack("<" + "".join(_CODES[c] for c in form), *packed)


def dataflash(rows: Sequence[Row], kinds: Mapping[str, tuple[int, str, str]] = KINDS) -> bytes:
    """Return the binary log of an ArduPilot."""
    out = b"".join(described(name, form, columns) for name, (_, form, columns) in kinds.items())
    return out + b"".join(message(name, kinds[name][1], values) for name, values in rows)


def copter_log(path: Path, parameters: Mapping[str, float], rows: Sequence[TimedRow] = (), *, defaults: bool = False) -> Path:
    """Write a log of ArduCopter 4.5.7.

    Args:
        rows: in order of time.
        defaults: whether parameters have their defaults beside them; not a number for those of `parameters`.
    """
    unknown = (math.nan,) if defaults else ()
    all_rows: list[Row] = [("MSG", (0, "ArduCopter V4.5.7 (2a3dc4b7)"))]
    all_rows += [("PARM", (0, name, float(value), *unknown)) for name, value in parameters.items()]
    all_rows += [(name, (round(1e6 * at_s), *values)) for at_s, name, values in rows]
    path.write_bytes(dataflash(all_rows, KINDS | (DEFAULTS if defaults else {})))
    return path


def text_dataflash(rows: Sequence[Row]) -> bytes:
    """Return the same log as a ground station writes it in text."""
    lines = [f"FMT, {number}, 89, {name}, {form}, {columns}" for name, (number, form, columns) in KINDS.items()]
    lines += [", ".join([name, *(f"{v:g}" if isinstance(v, float) else str(v) for v in values)]) for name, values in rows]
    return ("\n".join(lines) + "\n").encode()


ULOG_GAP = struct.pack("<HBH", 2, ord("O"), 700)
"""The message of a PX4 log that 700 ms are lost."""


class ULogFile:
    """The log of a PX4, message by message."""

    def __init__(self, began_us: int) -> None:
        self.out = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", began_us))
        self._numbers: dict[tuple[str, int], int] = {}
        self.message("B", bytes(40))

    def message(self, kind: str, payload: bytes) -> None:
        self.out += struct.pack("<HB", len(payload), ord(kind)) + payload

    def topic(self, name: str, fields: str, instances: int = 1) -> None:
        self.message("F", f"{name}:uint64_t timestamp;{fields}".encode())
        for instance in range(instances):
            self._numbers[name, instance] = len(self._numbers)

    def parameter(self, name: str, value: float) -> None:
        kind, packing = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
        self.keyed("P", f"{kind} {name}", struct.pack(packing, value))

    def keyed(self, kind: str, key: str, value: bytes) -> None:
        self.message(kind, bytes([len(key)]) + key.encode() + value)

    def begin(self) -> None:
        for (name, instance), number in self._numbers.items():
            self.message("A", struct.pack("<BH", instance, number) + name.encode())

    def data(self, name: str, packing: str, *values: float | int, instance: int = 0) -> None:
        self.message("D", struct.pack("<H", self._numbers[name, instance]) + struct.pack("<Q" + packing, *values))


def px4_log(
    path: Path,
    parameters: Mapping[str, float],
    topics: Mapping[str, Mapping[str, str]],
    rows: Sequence[TimedRow] = (),
    texts: Sequence[tuple[float, str]] = (),
) -> Path:
    """Write a log of PX4 1.16.2.

    Args:
        parameters: integers are written as integers.
        topics: type by field, by topic; the time stamp is added.
        texts: (seconds, text).
    """
    log = ULogFile(0)
    log.keyed("I", "uint32_t ver_sw_release", struct.pack("<I", 0x011002FF))
    for name, fields in topics.items():
        log.topic(name, "".join(f"{kind} {field};" for field, kind in fields.items()))
    for name, value in parameters.items():
        log.parameter(name, value)
    log.begin()
    for at_s, name, values in sorted([*rows, *((at_s, "", text) for at_s, text in texts)], key=lambda row: row[0]):
        at_us = round(1e6 * at_s)
        if isinstance(values, str):
            log.message("L", b"4" + struct.pack("<Q", at_us) + values.encode())
        else:
            log.data(name, "".join(_ULOG_CODES[kind] for kind in topics[name].values()), at_us, *values)
    path.write_bytes(log.out)
    return path


def px4_flight(began_us: int, count: int = 50, *, retained_us: int | None = None, foreign: bytes = b"") -> bytes:
    """IMU, attitude, status and two rangefinders at 10 a second, the first of which looks forward at 8 m.

    Args:
        retained_us: the instant of a landed state that was published before.
        foreign: bytes that are put into the middle.
    """
    log = ULogFile(began_us)
    log.topic("sensor_combined", "float[3] gyro_rad;float[3] accelerometer_m_s2;")
    log.topic("vehicle_attitude", "float[4] q;")
    log.topic("vehicle_land_detected", "uint8_t landed;")
    log.topic(
        "distance_sensor", "float min_distance;float max_distance;float current_distance;float variance;uint8_t orientation;", 2
    )
    log.parameter("COM_DISARM_LAND", 9.0)
    log.begin()
    if retained_us is not None:
        log.data("vehicle_land_detected", "B", retained_us, 1)
    for n in range(count):
        at = began_us + 100_000 * n
        log.data("sensor_combined", "6f", at, 0.0, 0.0, 0.0, 0.0, 0.0, -9.81)
        log.data("vehicle_attitude", "4f", at, 1.0, 0.0, 0.0, 0.0)
        log.data("distance_sensor", "4fB", at, 0.2, 40.0, 8.0, 0.0025, 0, instance=0)
        log.data("distance_sensor", "4fB", at, 0.05, 40.0, 5.0 - 0.09 * n, 0.0025, 25, instance=1)
        if n == count // 2:
            log.out += foreign
    return bytes(log.out)


def telemetry_log(count: int = 50, began_us: int = 1_764_072_000_000_000) -> bytes:
    """Return a ground station's log of an ArduCopter that comes down at 20 messages of a kind a second."""
    link = common.MAVLink(None, srcSystem=7, srcComponent=1)
    out = bytearray()

    def put(at_s: float, message: common.MAVLink_message) -> None:
        out.extend(struct.pack(">Q", began_us + round(1e6 * at_s)) + message.pack(link))
        link.seq = (link.seq + 1) % 256

    put(0.0, common.MAVLink_param_value_message(b"GUID_TIMEOUT", 0.2, common.MAV_PARAM_TYPE_REAL32, 1, 0))
    for n in range(count):
        at_s, boot_ms = 0.05 * n, 40_000 + 50 * n
        if n % 20 == 0:
            kind, stack = common.MAV_TYPE_QUADROTOR, common.MAV_AUTOPILOT_ARDUPILOTMEGA
            put(at_s, common.MAVLink_heartbeat_message(kind, stack, 209, 4, common.MAV_STATE_ACTIVE, 3))
        put(at_s, common.MAVLink_attitude_message(boot_ms, 0.02, -0.01, 1.5, 0.0, 0.0, 0.0))
        down = common.MAV_SENSOR_ROTATION_PITCH_270
        put(
            at_s,
            common.MAVLink_distance_sensor_message(boot_ms, 5, 4000, 500 - 4 * n, common.MAV_DISTANCE_SENSOR_LASER, 0, down, 0),
        )
    return bytes(out)


def navdata(sequence: int, time_us: int, *, right_sum: bool = True) -> bytes:
    """Return a datagram of an AR.Drone with the options time and demo, flying level."""
    seconds, micros = divmod(time_us, 1_000_000)
    demo = struct.pack("<IIfffifff", 3 << 16, 80, 0.0, 0.0, 0.0, 1500, 0.0, 0.0, 0.0).ljust(144, b"\0")
    body = struct.pack("<IIII", 0x55667788, 0x0F8004B9, sequence, 0)
    body += struct.pack("<HH", 0, 148) + demo + struct.pack("<HHI", 1, 8, (seconds % 2048) << 21 | micros)
    return body + struct.pack("<HHI", 0xFFFF, 8, (sum(body) + (0 if right_sum else 7)) & 0xFFFFFFFF)


def sentence(body: str) -> str:
    """Return a sentence of NMEA 0183 with its checksum."""
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"${body}*{check:02X}\r\n"
