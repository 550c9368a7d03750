"""The ship's reports from a broker: any bytes are samples or a counted refusal; copies, old ones and strangers' are refused."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.parts.mqtt.messages import ShipReport, Topics
from companion.parts.mqtt.part import REPORT_MAX_BYTES, ShipReportReader, signed
from estimator.contracts.samples import GeoFix, VesselReport
from estimator.contracts.time import MonoNs
from tests.support.mqtt_service import RUN

KEY = bytes(range(32))
NOW = MonoNs(5_000_000_000)
TOPICS = Topics("deck")


def ship_report(**changes: object) -> bytes:
    fields = {"run": RUN, "at_ns": NOW - 300_000_000, "latitude_deg": 54.4, "longitude_deg": 10.2, **changes}
    return json.dumps({key: value for key, value in fields.items() if value is not ...}).encode()


def test_each_field_goes_where_it_belongs_and_none_is_made_up() -> None:
    whole = ship_report(height_m=6.5, sigma_m=2.5, speed_m_s=2.0, course_deg=30.0, heading_deg=20.0)
    fix, moving = ShipReportReader(TOPICS, RUN).samples(whole, NOW)
    assert isinstance(moving, VesselReport)
    assert (fix.whose, fix.sigma_m, fix.place.height_m) == ("vessel", 2.5, 6.5)
    assert (math.degrees(fix.place.latitude_rad), math.degrees(fix.place.longitude_rad)) == pytest.approx((54.4, 10.2))
    assert fix.stamp == moving.stamp
    assert (fix.stamp.measured_at, fix.stamp.received_at) == (NOW - 300_000_000, NOW)
    assert moving.v_vessel_ned == pytest.approx(np.array([2.0 * math.cos(math.pi / 6), 1.0, 0.0]))
    assert fix.v_ned == pytest.approx(moving.v_vessel_ned)
    assert moving.heading_rad == pytest.approx(math.radians(20.0))
    (alone,) = ShipReportReader(TOPICS, RUN).samples(ship_report(), NOW)
    assert (alone.v_ned, alone.place.height_m) == (None, None)
    _, bow = ShipReportReader(TOPICS, RUN).samples(ship_report(heading_deg=0.0), NOW)
    assert (bow.v_vessel_ned, bow.heading_rad) == (None, 0.0)


@pytest.mark.parametrize(
    ("payload", "retained", "reason"),
    [
        (b"$GPRMC,081836", False, "malformed"),
        (ship_report(latitude_deg=90.1), False, "malformed"),
        (ship_report(longitude_deg=math.nan), False, "malformed"),
        (ship_report(longitude_deg=361.0), False, "malformed"),
        (ship_report(speed_m_s=2.0), False, "malformed"),
        (ship_report(knots=2.0), False, "malformed"),
        (ship_report() + b" " * REPORT_MAX_BYTES, False, "too_long"),
        (ship_report(), True, "retained"),
        (ship_report(run="another"), False, "other_run"),
        (ship_report(at_ns=NOW + 1), False, "ahead"),
    ],
)
def test_a_refusal_is_counted_by_its_reason(payload: bytes, retained: bool, reason: str) -> None:
    reader = ShipReportReader(TOPICS, RUN)
    assert reader.samples(payload, NOW, retained=retained) == []
    assert reader.counts == {reason: 1}


def test_a_copy_and_an_overtaken_report_are_refused() -> None:
    reader = ShipReportReader(TOPICS, RUN)
    assert reader.samples(ship_report(), NOW)
    assert reader.samples(ship_report(), NOW) == []
    assert reader.samples(ship_report(at_ns=NOW - 400_000_000), NOW) == []
    assert reader.samples(ship_report(at_ns=NOW), NOW)
    assert reader.counts == {"taken": 2, "not_newer": 2}


def test_with_a_key_the_signature_must_be_of_this_topic() -> None:
    reader = ShipReportReader(TOPICS, RUN, lambda: KEY)
    assert reader.samples(ship_report(), NOW) == []
    assert reader.samples(signed(KEY, TOPICS.of("command"), ship_report()), NOW) == []
    assert reader.samples(signed(bytes(32), TOPICS.of("vessel"), ship_report()), NOW) == []
    assert reader.samples(signed(KEY, TOPICS.of("vessel"), ship_report()), NOW)
    assert reader.counts == {"unsigned": 1, "bad_signature": 2, "taken": 1}
    assert KEY.hex() not in repr(reader)


FIELDS = st.fixed_dictionaries(
    {},
    optional={
        name: st.one_of(st.none(), st.floats(allow_nan=False), st.integers(), st.text(max_size=4), st.floats(-200.0, 200.0))
        for name in ShipReport.__struct_fields__
    },
)


@given(st.one_of(st.binary(max_size=60), FIELDS.map(lambda changes: ship_report(**changes))))
def test_any_bytes_are_a_place_on_the_earth_or_one_counted_refusal(payload: bytes) -> None:
    reader = ShipReportReader(TOPICS, RUN)
    for sample in reader.samples(payload, NOW):
        assert sample.stamp.measured_at <= NOW
        if isinstance(sample, GeoFix):
            assert abs(sample.place.latitude_rad) <= 0.5 * math.pi
            assert sample.v_ned is None or np.all(np.isfinite(sample.v_ned))
    assert sum(reader.counts.values()) == 1
