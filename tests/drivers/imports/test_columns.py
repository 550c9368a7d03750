"""Choice of sensor, core and reading in a log, by the columns beside the values."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.imports import dataflash, px4_ulog
from drivers.imports.columns import DATAFLASH, ULOG, cell, unknown
from drivers.mavlink.fields import Read
from estimator.contracts.samples import Baro, BodyVelocity, Imu, Range, Sample
from tests.support import flight_logs as made

DATA = Path(__file__).parents[3] / "../shared/data"
TIMES = [20_000_000 + 100_000 * n for n in range(50)]
IMU, ATT = (0.0, 0.0, 0.0, 0.0, 0.0, -9.81), (0.0, 1.0, 0.0, -1.0, 90.0, 90.0)
Kinds = dict[str, tuple[int, str, str]]


def read_log(path: Path, kinds: Kinds, rows: Sequence[made.Row], kind: type) -> tuple[list[Any], str]:
    """Return the samples of one kind that a dataflash log of these rows gives, an IMU and an attitude beside them."""
    every = {**made.KINDS, **kinds}
    base: list[made.Row] = []
    for at in TIMES:
        base += [("IMU", (at, 0, *IMU))] if "IMU" not in kinds else []
        base += [("ATT", (at, *ATT))] if "ATT" not in kinds else []
        base += [row for row in rows if row[1][0] == at]
    told: list[str] = []
    log = path / "log.bin"
    log.write_bytes(made.dataflash(base, every))
    return [s for s in dataflash.read(log, told.append) if type(s) is kind], "; ".join(told)


def test_every_row_has_a_reason_and_no_column_is_read_without_its_row() -> None:
    rows = [row for table in (DATAFLASH, ULOG) for of in table.values() for row in of.values()]
    assert all(row for row in rows if not isinstance(row, Read))
    assert cell(ULOG["distance_sensor"], "signal_quality", 0) is None
    for name in ("h_fov", "a_new_one"):
        with pytest.raises(KeyError, match=name):
            cell(ULOG["distance_sensor"], name, 1)
    assert unknown(ULOG["sensor_combined"], ["gyro_rad[0]", "gyro_rad[1]", "which[0]"]) == ["which"]


@pytest.mark.skipif(not DATA.is_dir(), reason="the shared recordings are not here")
@pytest.mark.parametrize(
    ("reader", "name"), [(dataflash.read, "arducopter_flight.bin"), (px4_ulog.read, "px4_sample.ulg")]
)  # fmt: skip
def test_every_column_of_a_real_log_is_known(reader: Any, name: str) -> None:
    told: list[str] = []
    reader(DATA / "mavlink" / name, told.append)
    assert not [line for line in told if "not known" in line]


def test_a_column_that_is_not_known_is_named(tmp_path: Path) -> None:
    _, told = read_log(tmp_path, {"EV": (134, "QBB", "TimeUS,Id,Whose")}, [("EV", (TIMES[3], 28, 1))], Imu)
    assert "not known here are not read: EV.Whose" in told


@pytest.mark.parametrize(
    ("columns", "values"),
    [
        ("TimeUS,Dist1,Orient1,Dist2,Orient2", lambda cm: (8.0, 0, cm, 25)),
        ("TimeUS,Dist1,Stat1,Orient1,Dist2,Stat2,Orient2", lambda cm: (8.0, 4, 0, cm, 4, 25)),
        ("TimeUS,Dist1,Orient1,Dist2,Orient2", lambda cm: (cm, 25, 8.0, 0)),
        ("TimeUS,Dist1,Dist2", lambda cm: (cm, 8.0)),
    ],
)
def test_two_rangefinders_in_one_message_of_older_firmware(columns: str, values: Any, tmp_path: Path) -> None:
    form = "Q" + "".join("C" if name[:4] == "Dist" else "B" for name in columns.split(",")[1:])
    heights = [5.0 - 0.09 * n for n in range(50)]
    rows: list[made.Row] = [("RFND", (at, *values(height))) for at, height in zip(TIMES, heights, strict=True)]
    found, _ = read_log(tmp_path, {"RFND": (131, form, columns)}, rows, Range)
    assert [one.range_m for one in found] == pytest.approx(heights, abs=0.011)


@pytest.mark.parametrize(
    ("name", "form", "columns", "good", "bad", "kind"),
    [
        ("IMU", "QBffffffBB", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,GH,AH", (0, *IMU, 1, 1), (0, *IMU, 0, 1), Imu),
        ("IMU", "QBffffffBB", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,GH,AH", (0, *IMU, 1, 1), (0, *IMU, 1, 0), Imu),
        ("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", (0, *IMU), (0, *[0.0] * 6), Imu),
        ("BARO", "QBffB", "TimeUS,I,Alt,Press,H", (0, 7.0, 101_000.0, 1), (0, 7.0, 101_000.0, 0), Baro),
        ("BARO", "QBffB", "TimeUS,I,Alt,Press,Health", (0, 7.0, 101_000.0, 1), (0, 0.0, 0.0, 1), Baro),
        ("RFND", "QBCBBB", "TimeUS,Instance,Dist,Stat,Orient,Quality", (0, 3.0, 4, 25, 90), (0, 3.0, 4, 25, 0), Range),
        ("RFND", "QBCBB", "TimeUS,Instance,Dist,Stat,Orient", (0, 3.0, 4, 25), (0, 3.0, 1, 25), Range),
    ],
)
def test_what_a_sensor_calls_bad_is_left_out(name, form, columns, good, bad, kind, tmp_path):
    rows: list[made.Row] = [(name, (at, *(bad if 20 <= n < 30 else good))) for n, at in enumerate(TIMES)]
    found, _ = read_log(tmp_path, {name: (made.KINDS[name][0], form, columns)}, rows, kind)
    assert len(found) == 40


def test_the_second_barometer_is_read_where_the_first_is_not_there(tmp_path: Path) -> None:
    rows: list[made.Row] = [("BARO", (at, 1, 7.0, 1)) for at in TIMES]
    found, told = read_log(tmp_path, {}, rows, Baro)
    assert len(found) == 50
    assert "barometer is that of number 1" in told


def north(samples: Sequence[BodyVelocity]) -> list[float]:
    """The nose points east, so that north is to the left."""
    return [round(-float(one.v_level[1]), 3) for one in samples]


def test_the_velocity_is_that_of_the_core_and_of_the_estimator_that_flies(tmp_path: Path) -> None:
    kinds: Kinds = {"ATT": (130, "QfffB", "TimeUS,Roll,Pitch,Yaw,AEKF")}
    rows: list[made.Row] = []
    for n, at in enumerate(TIMES):
        rows += [("ATT", (at, 1.0, -1.0, 90.0, 3 if n < 40 else 2)), ("XKF4", (at, 0, 10, 10, 10, 10, int(n >= 20)))]
        rows += [("XKF1", (at, core, 1.0 + core, 0.0, 0.0)) for core in (0, 1)]
        rows += [("NKF1", (at, 0, 5.0, 0.0, 0.0))]
    found, told = read_log(tmp_path, kinds, rows, BodyVelocity)
    assert north(found) == [1.0] * 20 + [2.0] * 20 + [5.0] * 10
    assert "estimator core 1 flies" in told


@pytest.mark.parametrize("field", ["signal_quality", "accelerometer_timestamp_relative", "baro_pressure_pa", "imu"])
def test_what_a_px4_log_calls_bad_is_left_out(field: str, tmp_path: Path) -> None:
    log = made.ULogFile(0)
    log.topic("sensor_combined", "float[3] gyro_rad;float[3] accelerometer_m_s2;int32_t accelerometer_timestamp_relative;")
    log.topic("vehicle_air_data", "float baro_alt_meter;float baro_pressure_pa;")
    ranges = "float min_distance;float max_distance;float current_distance;int8_t signal_quality;uint8_t orientation;"
    log.topic("distance_sensor", ranges)
    log.begin()
    for n in range(50):
        at, off = 100_000 * (n + 1), 20 <= n < 30
        values = [0.0] * 6 if off and field == "imu" else IMU
        log.data("sensor_combined", "6fi", at, *values, 0x7FFFFFFF if off and field[:5] == "accel" else 0)
        log.data("vehicle_air_data", "2f", at, 7.0, 0.0 if off and field[:4] == "baro" else 101_000.0)
        log.data("distance_sensor", "3fbB", at, 0.2, 40.0, 5.0, 0 if off and field == "signal_quality" else -1, 25)
    path = tmp_path / "log.ulg"
    path.write_bytes(bytes(log.out))
    samples: list[Sample] = px4_ulog.read(path)
    counts = {kind: sum(type(s) is kind for s in samples) for kind in (Imu, Baro, Range)}
    kind = {"signal_quality": Range, "baro_pressure_pa": Baro}.get(field, Imu)
    assert counts == {Imu: 50, Baro: 50, Range: 50} | {kind: 40}


def test_of_two_instances_of_a_topic_the_first_is_read_whatever_their_order(tmp_path: Path) -> None:
    log = made.ULogFile(0)
    log.topic("sensor_combined", "float[3] gyro_rad;float[3] accelerometer_m_s2;", 2)
    log.message("A", struct.pack("<BH", 1, 1) + b"sensor_combined")
    log.message("A", struct.pack("<BH", 0, 0) + b"sensor_combined")
    for n in range(20):
        for instance in (1, 0):
            log.data("sensor_combined", "6f", 1000 * (n + 1), 0.5 * instance, *IMU[1:], instance=instance)
    path = tmp_path / "log.ulg"
    path.write_bytes(bytes(log.out))
    assert np.unique([s.w_body[0] for s in px4_ulog.read(path) if isinstance(s, Imu)]).tolist() == [0.0]
