"""Fuzz the readers of foreign logs and captures that `replay` and `detect` accept."""

import struct
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from drivers.ardrone import capture
from drivers.file_kinds import ULOG_MAGIC
from drivers.imports import dataflash, px4_ulog, tlog
from drivers.mavlink.dialect import mav
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Sample
from fuzz import ardrone
from fuzz.target import SHARED_MEMORY, Target, refused


def reader(name: str, *reads: Callable[[Path], Iterable[object]]) -> Callable[[bytes], None]:
    """Return a target for readers of files: refused in one line, or samples in order of time with stamps of zero or later."""

    def run(data: bytes) -> None:
        with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as folder:
            path = Path(folder) / name
            path.write_bytes(data)
            for read in reads:
                try:
                    found = list(read(path))
                except BadInput as why:
                    refused(why)
                    continue
                samples = [item for item in found if isinstance(item, Sample)]
                received_at = [sample.stamp.received_at for sample in samples]
                assert received_at == sorted(received_at)

    return run


_FORMATS = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "IMU": (131, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (132, "Qccccc", "TimeUS,DesRoll,Roll,DesPitch,Pitch,Yaw"),
    "XKF1": (133, "QBfff", "TimeUS,C,VN,VE,VD"),
    "BARO": (134, "QBf", "TimeUS,I,Alt"),
    "RFND": (135, "QBfBB", "TimeUS,Instance,Dist,Stat,Orient"),
    "EV": (136, "QB", "TimeUS,Id"),
    "PARM": (137, "QNf", "TimeUS,Name,Value"),
    "ERR": (138, "QBB", "TimeUS,Subsys,ECode"),
    "VIBE": (139, "QBfffI", "TimeUS,IMU,VibeX,VibeY,VibeZ,Clip"),
    "XKF4": (140, "QBcccc", "TimeUS,C,SV,SP,SH,SM"),
    "PL": (141, "QBB", "TimeUS,Heal,TAcq"),
}
_CODES = {"Q": "Q", "B": "B", "f": "f", "c": "h", "n": "4s", "N": "16s", "Z": "64s", "I": "I"}


def _row(name: str, *values: object) -> bytes:
    number, form, _ = _FORMATS[name]
    return b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(_CODES[c] for c in form), *values)


def dataflash_seeds() -> Iterator[bytes]:
    """Yield a log of one moment: its formats, then one message of each type that is read."""
    log = b""
    for name, (number, form, columns) in _FORMATS.items():
        length = 3 + struct.calcsize("<" + "".join(_CODES[c] for c in form))
        log += _row("FMT", number, length, name.encode(), form.encode(), columns.encode())
    log += _row("IMU", 1000, 0, 0.0, 0.0, 0.1, 0.0, 0.0, -9.8) + _row("ATT", 1100, 0, 100, 0, -100, 9000)
    log += _row("XKF1", 1200, 0, 1.0, 2.0, 3.0) + _row("BARO", 1300, 0, 10.0) + _row("RFND", 1400, 0, 2.0, 4, 25)
    log += _row("EV", 1500, 28) + _row("IMU", 900, 0, np.nan, 0.0, 0.1, 0.0, 0.0, -9.8) + _row("EV", 1500, 18)
    log += _row("PARM", 1600, b"PLND_ENABLED", 1.0) + _row("ERR", 1700, 16, 2) + _row("VIBE", 1800, 0, 40.0, 1.0, 1.0, 200)
    log += _row("XKF4", 1900, 0, 120, 30, 30, 30) + _row("PL", 2000, 1, 1) + _row("PL", 2100, 1, 0)
    yield log
    yield log[: len(log) * 2 // 3]


def _ulog(kind: str, data: bytes) -> bytes:
    return struct.pack("<HB", len(data), ord(kind)) + data


def ulog_seeds() -> Iterator[bytes]:
    """Yield a log with one message of each topic that is read, with and without other topics."""
    topics = {
        "sensor_combined": ("float[3] gyro_rad;float[3] accelerometer_m_s2", struct.pack("<6f", 0, 0, 0.1, 0, 0, -9.8)),
        "vehicle_attitude": ("float[4] q", struct.pack("<4f", 1, 0, 0, 0)),
        "vehicle_local_position": (
            "float vx;float vy;float vz;float evh;float evv;bool v_xy_valid;bool v_z_valid",
            struct.pack("<5fBB", 1, 2, 3, 0.1, 0.1, 1, 1),
        ),
        "distance_sensor": (
            "float min_distance;float max_distance;float current_distance;float variance", struct.pack("<4f", 0.1, 20, 3, 0.01)
        ),
        "vehicle_air_data": ("float baro_alt_meter", struct.pack("<f", 12)),
        "vehicle_land_detected": ("bool landed", struct.pack("<B", 1)),
        "vehicle_status": ("uint8_t arming_state;bool failsafe", struct.pack("<BB", 2, 1)),
        "failsafe_flags": ("bool gcs_connection_lost", struct.pack("<B", 1)),
        "estimator_status": ("float vel_test_ratio;float mag_test_ratio", struct.pack("<2f", 2, 0.1)),
        "vehicle_imu_status": ("uint32_t[3] accel_clipping;float accel_vibration_metric", struct.pack("<3If", 1, 2, 3, 12)),
        "event": ("uint32_t id", struct.pack("<I", 17)),
    }  # fmt: skip
    head = ULOG_MAGIC + b"\x01" + struct.pack("<Q", 1000)
    formats = b"".join(_ulog("F", f"{name}:uint64_t timestamp;{fields};".encode()) for name, (fields, _) in topics.items())
    adds = b"".join(_ulog("A", struct.pack("<BH", 0, i) + name.encode()) for i, name in enumerate(topics))
    rows = b"".join(
        _ulog("D", struct.pack("<HQ", i, 1000 * t + i) + values) for t in (1, 2) for i, (_, values) in enumerate(topics.values())
    )
    flags = _ulog("B", bytes(40))
    around = (
        _ulog("I", b"\x0dchar[3] ver_abc")
        + _ulog("P", b"\x0bint32_t SYS" + struct.pack("<i", 1))
        + _ulog("P", b"\x0cchar[4] TEXTword")
        + _ulog("L", b"6" + bytes(8) + b"hello")
    )
    yield head + formats + adds + rows
    yield head + flags + around + formats + adds + rows + _ulog("O", struct.pack("<H", 10)) + rows[:60]


def capture_seeds() -> Iterator[bytes]:
    """Yield consecutive navdata with garbage between them, and encoded video."""
    datagrams = [seed[3:] for seed in ardrone.navdata_seeds() if seed[0] == 0]
    yield b"\x00\x01".join(datagrams)
    yield datagrams[0][:200] + datagrams[-1]
    yield from ardrone.video_seeds()


def tlog_seeds() -> Iterator[bytes]:
    """Yield a telemetry log: a heartbeat, a parameter, attitudes and ranges, each after its instant."""
    link, out = mav.MAVLink(None, srcSystem=1, srcComponent=1), b""
    down = mav.MAV_SENSOR_ROTATION_PITCH_270
    for n in range(6):
        messages = [
            mav.MAVLink_heartbeat_message(mav.MAV_TYPE_QUADROTOR, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 209, 4, 4, 3),
            mav.MAVLink_param_value_message(b"GUID_TIMEOUT", 0.2, mav.MAV_PARAM_TYPE_REAL32, 1, 0),
            mav.MAVLink_attitude_message(1000 + 50 * n, 0.02, -0.01, 1.5, 0.0, 0.0, 0.0),
            mav.MAVLink_distance_sensor_message(1000 + 50 * n, 5, 4000, 500 - 4 * n, 0, 0, down, 0),
        ]
        stamp = struct.pack(">Q", 1_764_072_000_000_000 + 50_000 * n)
        out += b"".join(stamp + bytes(message.pack(link)) for message in messages)
    yield out
    yield out[:150] + out[200:]


TARGETS = {
    "dataflash": Target(reader("log.bin", dataflash.read, lambda path: [dataflash.read_history(path)]), dataflash_seeds),
    "ulog": Target(reader("log.ulg", px4_ulog.read, lambda path: [px4_ulog.read_history(path)]), ulog_seeds),
    "tlog": Target(reader("x.tlog", tlog.read, lambda path: [tlog.read_history(path)]), tlog_seeds),
    "ardrone_capture": Target(reader("x", capture.samples, capture.frames), capture_seeds, 8192),
}
