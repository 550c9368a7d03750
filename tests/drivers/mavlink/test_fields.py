"""The table of fields against the dialect's definitions, against what the sampler reads, and against what placeholders become."""

import math
from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.mavlink.boot_clock import BootClock
from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import Message, mav
from drivers.mavlink.failsafe import event_id
from drivers.mavlink.fields import FIELDS, Read
from drivers.mavlink.gimbal_reports import GimbalSampler
from drivers.mavlink.options import GimbalOptions
from drivers.mavlink.samples import MavlinkSampler
from drivers.mavlink.timesync import TimeSync
from drivers.mavlink.vehicle import Stack
from estimator.contracts.samples import Attitude, BodyVelocity, GeoFix, Imu, Range, Sample, VesselReport
from estimator.contracts.time import MonoNs

NOW, S = MonoNs(9_000_000_000), 1_000_000_000
CLASSES: dict[str, Any] = {of.msgname: of for of in mav.mavlink_map.values()}
PLACE = {"lat": 543_210_000, "lon": 102_030_000}
GOOD: dict[str, dict[str, Any]] = {
    "HEARTBEAT": {"type": 2, "autopilot": 3, "base_mode": 0x81, "custom_mode": 4, "system_status": 4},
    "EXTENDED_SYS_STATE": {"landed_state": 2},
    "SYS_STATUS": {"voltage_battery": 12_000, "battery_remaining": 61},
    "ATTITUDE_QUATERNION": {"q1": 1.0},
    "ATTITUDE": {"yaw": 0.3},
    "LOCAL_POSITION_NED": {"x": 1.0, "y": 2.0, "z": -3.0, "vx": 0.1, "vy": 0.2, "vz": 0.3},
    "GLOBAL_POSITION_INT": {**PLACE, "alt": 12_500, "vx": 150, "vy": -250, "vz": 50, "hdg": 12_345},
    "RAW_IMU": {"xacc": 10, "yacc": 20, "zacc": -1000, "xgyro": 1, "ygyro": 2, "zgyro": 3},
    "HIGHRES_IMU": {"zacc": -9.8, "xgyro": 0.1, "abs_pressure": 1013.0, "fields_updated": 0x23F},
    "FENCE_STATUS": {},
    "EVENT": {"id": event_id("commander_failsafe_enter")},
    "DISTANCE_SENSOR": {"min_distance": 20, "max_distance": 4000, "current_distance": 345, "orientation": 25, "covariance": 4},
    "SCALED_PRESSURE": {"press_abs": 1013.0},
    "FOLLOW_TARGET": {**PLACE, "est_capabilities": 3, "alt": 12.5, "vel": [1.5, -2.5, 0.5], "position_cov": [6.0, 9.0, 0.0]},
    "GIMBAL_DEVICE_ATTITUDE_STATUS": {"flags": 64, "q": [1.0, 0.0, 0.0, 0.0], "delta_yaw": 0.2},
    "MOUNT_ORIENTATION": {"yaw": math.nan},
    "MOUNT_STATUS": {},
}
BY_DEFAULT = {("DISTANCE_SENSOR", "covariance"), ("FOLLOW_TARGET", "position_cov"), ("SYS_STATUS", "voltage_battery")}
BY_DEFAULT |= {("HEARTBEAT", "system_status"), ("EXTENDED_SYS_STATE", "landed_state")}
BY_DEFAULT |= {("GIMBAL_DEVICE_ATTITUDE_STATUS", "delta_yaw")}
"""Fields without which something else stands for the value."""


def message_of(name: str, **changed: Any) -> Message:
    of = CLASSES[name]
    lengths = dict(zip(of.ordered_fieldnames, of.array_lengths, strict=True))
    stamps = {"time_boot_ms": 4000, "time_usec": 4_000_000, "timestamp": 4000}
    kinds = zip(of.fieldnames, of.fieldtypes, strict=True)
    empty = {field: b"" if kind == "char" else [0] * lengths[field] if lengths[field] else 0 for field, kind in kinds}
    return of(**{**empty, **{k: v for k, v in stamps.items() if k in empty}, **GOOD.get(name, {}), **changed})


def sampler(stack: Stack = Stack.ARDUPILOT, **options: Any) -> MavlinkSampler:
    return MavlinkSampler(stack, BootClock(TimeSync()), **options)


def both(s: MavlinkSampler, m: Message, at: int = NOW) -> list[Sample]:
    return [*s.samples(m, MonoNs(at)), *s.vessel(m, MonoNs(at))]


class Spied:
    """A message that notes which of its fields are read."""

    def __init__(self, of: Message) -> None:
        self._of, self.read = of, set[str]()

    def __getattr__(self, name: str) -> Any:
        if name in self._of.fieldnames:
            self.read.add(name)
        return getattr(self._of, name)


@pytest.mark.parametrize("name", FIELDS)
def test_every_field_of_the_definition_has_its_row(name: str) -> None:
    assert list(FIELDS[name].keys() ^ set(CLASSES[name].fieldnames)) == []
    assert all(row for row in FIELDS[name].values() if not isinstance(row, Read)), "a reason"


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_what_is_read_of_a_message_is_what_the_table_says(name: str) -> None:
    spied, s = Spied(message_of(name)), sampler()
    s.samples(message_of("ATTITUDE_QUATERNION"), MonoNs(NOW - 9 * S))
    both(s, spied)
    for report in ("auto", "mount_status"):
        GimbalSampler(GimbalOptions(154, report=report)).sample(spied, NOW, None)
    said = {field for field, row in FIELDS.get(name, {}).items() if isinstance(row, Read)}
    order = {"id", "time_boot_ms", "time_usec", "gimbal_device_id"}
    assert spied.read - order == (said - order if name in FIELDS else set())


def numbers_in(s: MavlinkSampler, out: list[Sample]) -> int:
    """Return how many numbers have come of a message."""
    parts = [msgspec.structs.asdict(one) for one in out if not isinstance(one, Attitude)]
    values = [value for part in parts for key, value in part.items() if key != "stamp"]
    heights = [value.height_m for value in values if hasattr(value, "height_m")]
    charges = [s.status(NOW, link_ok=True).battery_fraction]
    return sum(value is not None for value in (*values, *heights, *charges))


PLACEHOLDERS = [
    (name, field, value)
    for name, rows in FIELDS.items()
    for field, row in rows.items()
    if isinstance(row, Read) and (name, field) not in BY_DEFAULT
    for value in row.absent
]


@pytest.mark.parametrize(("name", "field", "value"), PLACEHOLDERS)
def test_a_placeholder_is_no_measurement_and_costs_no_other_one(name: str, field: str, value: float) -> None:
    good, bad = sampler(), sampler()
    whole = numbers_in(good, both(good, message_of(name)))
    rest = numbers_in(bad, both(bad, message_of(name, **{field: value})))
    assert rest < whole
    assert rest > 0 or len(GOOD[name]) < 7 or name == "RAW_IMU"
    assert bad.refused == {}


@pytest.mark.parametrize(
    ("volts", "percent", "charge"),
    [
        *((0, 0, None), (65535, 0, None), (12_000, -1, None), (11_165, -106, None)),
        *((10_500, 0, 0.0), (65535, 80, 0.8), (12_000, 120, 1.0)),
    ],
)
def test_the_charge_of_an_autopilot_with_and_without_a_battery_monitor(volts: int, percent: int, charge: float | None) -> None:
    s = sampler()
    s.samples(message_of("SYS_STATUS", voltage_battery=volts, battery_remaining=percent), NOW)
    assert s.status(NOW, link_ok=True).battery_fraction == charge


BAD_PARTS: list[tuple[str, dict[str, Any], set[type]]] = [
    ("GLOBAL_POSITION_INT", {"hdg": 40_000}, {GeoFix, VesselReport}),
    ("GLOBAL_POSITION_INT", {"vx": 20_000}, {GeoFix, VesselReport}),
    ("GLOBAL_POSITION_INT", {"lat": 910_000_000}, {VesselReport}),
    ("GLOBAL_POSITION_INT", {"alt": 2_000_000_000}, {GeoFix, VesselReport}),
    ("FOLLOW_TARGET", {"alt": math.nan}, {GeoFix, VesselReport}),
    ("FOLLOW_TARGET", {"vel": [math.inf, 0.0, 0.0]}, {GeoFix}),
    ("FOLLOW_TARGET", {"lat": 910_000_000}, {VesselReport}),
    ("LOCAL_POSITION_NED", {"z": math.nan}, {BodyVelocity}),
    ("HIGHRES_IMU", {"abs_pressure": 5000.0}, {Imu}),
]


@pytest.mark.parametrize(("name", "bad", "left"), BAD_PARTS)
def test_one_bad_field_costs_its_own_part_alone(name: str, bad: dict[str, Any], left: set[type]) -> None:
    s = sampler(Stack.PX4)
    s.samples(message_of("ATTITUDE_QUATERNION"), NOW)
    assert {type(one) for one in both(s, message_of(name, **bad))} == left
    assert s.refused.total() == ("alt" not in bad) * (2 if name[0] == "G" and "hdg" not in bad else 1)


def test_a_place_that_counts_on_beyond_180_degrees() -> None:
    (fix,) = sampler().samples(message_of("GLOBAL_POSITION_INT", lon=1_800_005_000), NOW)
    assert math.degrees(fix.place.longitude_rad) == pytest.approx(-179.9995)


def test_a_yaw_that_counts_turns() -> None:
    (sample,) = sampler().samples(message_of("ATTITUDE", yaw=0.3 + 6 * math.tau), NOW)
    assert np.allclose(sample.R_ned_body.rpy_rad, (0.0, 0.0, 0.3), atol=1e-6)


def mixed(
    s: MavlinkSampler, name: str, second: dict[str, Any], begin_s: float, end_s: float, *, first: bool = True
) -> list[Sample]:
    """Return what comes of two sensors that report by turns, the first one only if it is not silent."""
    out: list[Sample] = []
    for k in range(round(20 * begin_s), round(20 * end_s)):
        stamp = {key: 4_000_000 + k * 50_000 if key == "time_usec" else 4000 + k * 50 for key in ("time_usec", "time_boot_ms")}
        at = {key: value for key, value in stamp.items() if key in CLASSES[name].fieldnames}
        if first:
            out += both(s, message_of(name, **at), NOW + k * S // 20)
        out += both(s, message_of(name, **at, **second), NOW + k * S // 20)
    return out


@pytest.mark.parametrize(
    ("name", "second", "kind", "of"),
    [
        ("DISTANCE_SENSOR", {"id": 1, "current_distance": 750}, Range, lambda one: one.range_m == pytest.approx(7.5)),
        ("HIGHRES_IMU", {"id": 1, "xgyro": 0.7}, Imu, lambda one: one.w_body[0] == pytest.approx(0.7)),
        ("RAW_IMU", {"id": 2, "xgyro": 700}, Imu, lambda one: one.w_body[0] == pytest.approx(0.7)),
    ],
)
def test_of_two_sensors_in_one_message_one_is_used_and_the_other_one_reported(name, second, kind, of):
    told: list[str] = []
    s = sampler(tell=told.append)
    seen = [of(one) for one in mixed(s, name, second, 0.0, 5.0) if type(one) is kind]
    assert seen == [False] * 100
    assert len([line for line in told if "not used" in line and str(second["id"]) in line]) >= 1
    told.clear()
    later = [of(one) for one in mixed(s, name, second, 5.0, 10.0, first=False) if type(one) is kind]
    assert any(later), "the first one is silent"
    assert later == sorted(later)
    assert any("from now on" in line for line in told)


def test_zeros_of_an_inertial_sensor_that_is_not_there() -> None:
    none = dict.fromkeys(("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro"), 0)
    assert sampler().samples(message_of("RAW_IMU", **none), NOW) == []
    assert [type(s).__name__ for s in sampler(Stack.PX4).samples(message_of("HIGHRES_IMU", **none), NOW)] == ["Baro"]


def test_angles_are_used_again_where_quaternions_end() -> None:
    s = sampler()
    s.samples(message_of("ATTITUDE_QUATERNION"), NOW)
    assert s.samples(message_of("ATTITUDE"), NOW) == []
    (sample,) = s.samples(message_of("ATTITUDE", time_boot_ms=9000), MonoNs(NOW + 5 * S))
    assert np.allclose(sample.R_ned_body.rpy_rad, (0.0, 0.0, 0.3))


def of_component(m: Message, component: int, seconds: float) -> Message:
    sent = Codec(8, component).pack(m.__class__(**{**{f: getattr(m, f) for f in m.fieldnames}, **stamped(m, seconds)}))
    return Codec(1, 1).feed(sent)[0]


def stamped(m: Message, seconds: float) -> dict[str, int]:
    return {"time_boot_ms" if "time_boot_ms" in m.fieldnames else "timestamp": 4000 + round(1000 * seconds)}


def test_of_two_components_of_the_ship_one_that_knows_the_place_is_used() -> None:
    told: list[str] = []
    s, speeds = sampler(tell=told.append), []
    for k in range(100):
        at = MonoNs(NOW + k * S // 10)
        nowhere = message_of("GLOBAL_POSITION_INT", lat=0, lon=0, vx=900, hdg=9000)
        for m in (of_component(nowhere, 1, 0.1 * k), of_component(message_of("FOLLOW_TARGET"), 2, 0.1 * k)):
            speeds += [(k, one.v_vessel_ned[0]) for one in s.vessel(m, at) if getattr(one, "v_vessel_ned", None) is not None]
    assert {round(float(v), 1) for k, v in speeds if k > 40} == {1.5}
    assert any("FOLLOW_TARGET of component 2 from now on" in line for line in told)
    standing = message_of("GLOBAL_POSITION_INT", lat=0, lon=0, vx=0, vy=0, vz=0, hdg=65535)
    assert sampler().vessel(standing, NOW) == [], "a receiver without a fix does not know that it stands"
