"""Sentences of a ship: what published examples say, what damaged ones do not, and whose are not taken."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyais import encode_dict

from drivers.nmea.sentences import KNOT_M_S, NmeaReader, checked
from estimator.contracts.samples import GeoFix, VesselReport
from estimator.contracts.time import MonoNs

NOW = MonoNs(9_000_000_000)
MMSI = 211_234_560
# The sentences of the manuals of Trimble and NovAtel.
RMC = "$GPRMC,081836,A,3751.65,S,14507.36,E,005.5,045.0,130998,011.3,E*6E"
GGA = "$GPGGA,134658.00,5106.9792,N,11402.3003,W,2,09,1.6,1048.47,M,-16.27,M,08,AAAA*66"


def line(body: str) -> bytes:
    """The sentence with its checksum."""
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"${body}*{check:02X}\r\n".encode()


def ais(**changed: float) -> bytes:
    fields = {"type": 1, "mmsi": MMSI, "lat": 54.4, "lon": 10.2, "speed": 3.0, "course": 90.0, "heading": 100, "second": 12}
    return "".join(encode_dict({**fields, **changed}, talker_id="AI", sentence_type="VDM")).encode() + b"\r\n"


def degrees(fix: GeoFix) -> list[float]:
    return [math.degrees(fix.place.latitude_rad), math.degrees(fix.place.longitude_rad)]


def test_rmc_tells_place_and_velocity() -> None:
    body = RMC[1:].partition("*")[0]
    fix, report = NmeaReader().samples(line(body), NOW)
    assert isinstance(fix, GeoFix)
    assert degrees(fix) == pytest.approx([-37.860833, 145.122667], abs=1e-6)
    assert fix.place.height_m is None
    assert isinstance(report, VesselReport)
    speed = 5.5 * KNOT_M_S / math.sqrt(2.0)
    assert report.v_vessel_ned == pytest.approx([speed, speed, 0.0])
    assert report.cov_v_ned[2, 2] > 1e5, "nothing is said of the vertical"


def test_gga_tells_the_height_and_how_good_it_is() -> None:
    body = GGA[1:].partition("*")[0]
    (fix,) = NmeaReader().samples(line(body), NOW)
    assert degrees(fix) == pytest.approx([51.11632, -114.0383383], abs=1e-6)
    assert (fix.place.height_m, fix.sigma_m) == (1048.47, pytest.approx(4.0))


def test_vtg_and_hdt_tell_motion_and_heading_together_in_one_datagram() -> None:
    moving, pointing = NmeaReader().samples(line("GPVTG,180.0,T,,M,010.0,N,18.5,K") + line("HEHDT,123.4,T"), NOW)
    assert moving.v_vessel_ned == pytest.approx([-10.0 * KNOT_M_S, 0.0, 0.0], abs=1e-9)
    assert moving.heading_rad is None
    assert pointing.heading_rad == pytest.approx(math.radians(123.4))
    assert pointing.v_vessel_ned is None


def test_the_named_ship_s_ais_is_taken_and_no_other_s() -> None:
    reader = NmeaReader(MMSI)
    fix, moving, pointing = reader.samples(ais(), NOW)
    assert degrees(fix) == pytest.approx([54.4, 10.2], abs=1e-5)
    assert moving.v_vessel_ned == pytest.approx([0.0, 3.0 * KNOT_M_S, 0.0], abs=1e-6)
    assert pointing.heading_rad == pytest.approx(math.radians(100.0))
    assert [type(s) for s in reader.samples(ais(type=18, heading=511, speed=102.3), NOW)] == [GeoFix]
    assert reader.samples(ais(mmsi=MMSI + 1), NOW) == []
    assert reader.samples(ais(lat=91, lon=181), NOW) == []
    assert reader.refused == {"other_ship": 1, "no_fix": 1}
    assert NmeaReader().samples(ais(), NOW) == [], "without an MMSI nobody's"


@pytest.mark.parametrize(
    ("sentence", "reason"),
    [
        (b"$HEHDT,123.4,T*00\r\n", "checksum"),
        (b"$HEHDT,123.4,T\r\n", "checksum"),
        (b"\xff\xfe\x00garbage", "checksum"),
        (line("GPRMC,081836,V,3751.65,S,14507.36,E,005.5,360.0,130998,011.3,E"), "no_fix"),
        (line("GPGGA,134658.00,5106.9,N,11402.3,W,0,09,1.0,10.0,M,-16.27,M,08,AAAA"), "no_fix"),
        (line("GPRMC,081836,A,9951.65,S,14507.36,E,005.5,360.0,130998,011.3,E"), "impossible"),
        (line("GPRMC,081836,A,3751.65,S,14507.36,E,nan,360.0,130998,011.3,E"), "impossible"),
        (line("GPRMC,081836,A,3751.65,S,14507.36,E,905.5,360.0,130998,011.3,E"), "impossible"),
        (line("GPRMC,081836,A,,,,,,,130998,,"), "malformed"),
        (line("GPRMC,,A,3751.65,S,14507.36,E,005.5,360.0,130998,011.3,E"), "malformed"),
        (line("HEHDT,400.0,T"), "impossible"),
        (line("HEHDT,,T"), "malformed"),
        (line("GPVTG,,T,,M,,N,,K"), "malformed"),
        (line("GPGSV,3,1,11,03,03,111,00"), "other_sentence"),
        (b"A" * 3000, "too_long"),
    ],
)
def test_what_is_wrong_is_counted_by_its_reason(sentence: bytes, reason: str) -> None:
    reader = NmeaReader(MMSI)
    assert reader.samples(sentence, NOW) == []
    assert reader.refused == {reason: 1}


def test_reports_that_come_10_s_late_say_so() -> None:
    reader = NmeaReader(MMSI)

    def rmc(second: int) -> bytes:
        clock = f"{8 + second // 3600:02d}{second // 60 % 60:02d}{second % 60:02d}"
        return line(f"GPRMC,{clock},A,3751.65,S,14507.36,E,005.5,045.0,130998,011.3,E")

    for late_s, seconds in ((0, range(30)), (10, range(30, 60))):
        for second in seconds:
            received_at = MonoNs(NOW + (second + late_s) * 10**9)
            fix, *_ = reader.samples(rmc(second), received_at)
            assert fix.stamp.delay_s == pytest.approx(late_s, abs=0.05)
            fix, *_ = reader.samples(ais(second=second % 60), received_at)
            assert fix.stamp.delay_s == pytest.approx(late_s, abs=0.05)


ARMOUR = "0123456789:;<=>?@ABCDEFGHIJKLMNOPQRSTUVW`abcdefghijklmnopqrstuvw"
DATAGRAMS = st.one_of(
    st.binary(max_size=200),
    st.text(max_size=120).map(lambda text: line(f"GPRMC,{text}")),
    st.text(max_size=60).map(lambda text: line(f"GPGGA,{text}")),
    st.text(alphabet=ARMOUR, max_size=60).map(lambda text: b"!" + line(f"AIVDM,1,1,,A,{text},0")[1:]),
)


@given(DATAGRAMS)
def test_no_bytes_end_the_reader_and_every_place_exists(datagram: bytes) -> None:
    for sample in NmeaReader(MMSI).samples(datagram, NOW):
        if isinstance(sample, GeoFix):
            assert abs(degrees(sample)[0]) <= 90.0
        elif sample.v_vessel_ned is not None:
            assert np.isfinite(sample.v_vessel_ned).all()


def test_a_checksum() -> None:
    assert checked("$GPHDT,123.4,T*31")
    assert not checked("$GPHDT,123.5,T*31")
