"""Sentences of a ship: what published examples say, what damaged ones do not, and whose are not taken."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyais import encode_dict

from drivers.nmea.sentences import KNOT_M_S, NmeaReader
from estimator.contracts.samples import GeoFix, VesselReport
from estimator.contracts.time import MonoNs

NOW = MonoNs(9_000_000_000)
MMSI = 211_234_560
# The sentences of the manuals of Trimble and NovAtel.
RMC = "$GPRMC,081836,A,3751.65,S,14507.36,E,005.5,045.0,130998,011.3,E*6E"
GGA = "$GPGGA,134658.00,5106.9792,N,11402.3003,W,2,09,1.6,1048.47,M,-16.27,M,08,AAAA*66"


def line(body: str) -> bytes:
    """Return the sentence with its checksum."""
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"${body}*{check:02X}\r\n".encode()


def ais(**changed: float) -> bytes:
    fields = {"type": 1, "mmsi": MMSI, "lat": 54.4, "lon": 10.2, "speed": 3.0, "course": 90.0, "heading": 100, "second": 12}
    return "".join(encode_dict({**fields, **changed}, talker_id="AI", sentence_type="VDM")).encode() + b"\r\n"


def degrees(fix: GeoFix) -> list[float]:
    return [math.degrees(fix.place.latitude_rad), math.degrees(fix.place.longitude_rad)]


def test_rmc_reports_place_and_velocity() -> None:
    body = RMC[1:].partition("*")[0]
    fix, report = NmeaReader().samples(line(body), NOW)
    assert isinstance(fix, GeoFix)
    assert degrees(fix) == pytest.approx([-37.860833, 145.122667], abs=1e-6)
    assert fix.place.height_m is None
    assert isinstance(report, VesselReport)
    speed = 5.5 * KNOT_M_S / math.sqrt(2.0)
    assert report.v_vessel_ned == pytest.approx([speed, speed, 0.0])
    assert report.cov_v_ned[2, 2] > 1e5, "nothing is said of the vertical"


def test_gga_reports_the_height_and_how_good_it_is() -> None:
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
    for class_b in (18, 19):
        assert [type(s) for s in reader.samples(ais(type=class_b, heading=511, speed=102.3), NOW)] == [GeoFix]
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
        (line("GPRMC,081836,A,3760.65,S,14507.36,E,005.5,360.0,130998,011.3,E"), "impossible"),
        (line("GPRMC,081836,A,3751.65,S,14575.36,E,005.5,360.0,130998,011.3,E"), "impossible"),
        (line("GPRMC,081836,A,3751.65,S,14507.36,E,005.5,540.0,130998,011.3,E"), "impossible"),
        (line("GPVTG,-90.0,T,,M,010.0,N,18.5,K,A"), "impossible"),
        (line("GPGGA,134658.00,5106.9,N,11402.3,W,12,09,1.0,10.0,M,-16.27,M,08,AAAA"), "impossible"),
        (line("GPRMC,,V,,,,,,,,,,N"), "no_fix"),
        (line("GPGGA,,,,,,0,,,,,,,,"), "no_fix"),
        (line("HEHDT,,T"), "no_heading"),
        (line("GPVTG,,T,,M,,N,,K"), "no_fix"),
        (line("GPVTG,,,,,,,,,N"), "no_fix"),
        (ais(second=61), "typed_in"),
        (ais(second=63), "no_fix"),
        (line("GPGSV,3,1,11,03,03,111,00"), "other_sentence"),
        (line("PGRMC,A,110.1,100,6378137.0,298.257,0.0,0.0,0.0,A,3,1,1,4,30"), "other_sentence"),
        (b"A" * 3000, "too_long"),
    ],
)
def test_what_is_wrong_is_counted_by_its_reason(sentence: bytes, reason: str) -> None:
    reader = NmeaReader(MMSI)
    assert reader.samples(sentence, NOW) == []
    assert reader.refused == {reason: 1}


PLACE = "3751.65,S,14507.36,E"
RTK_M, METRES_M, RECKONED_M = (0.1, 1.0), (2.0, 5.0), (20.0, 500.0)


@pytest.mark.parametrize(
    ("body", "worth"),
    [
        *((f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,{mode}", METRES_M) for mode in "ADP"),
        *((f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,{mode}", RTK_M) for mode in "FR"),
        (f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,", METRES_M),
        (f"GNRMC,081836,A,{PLACE},005.5,045.0,130998,,,A,V", METRES_M),
        (f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,E", RECKONED_M),
        (f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,M", "typed_in"),
        (f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,S", "simulated"),
        (f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,N", "no_fix"),
        *((f"GPGGA,081836,{PLACE},{quality},09,1.0,12.0,M,42.1,M,,", METRES_M) for quality in "123"),
        *((f"GPGGA,081836,{PLACE},{quality},09,1.0,12.0,M,42.1,M,,", RTK_M) for quality in "45"),
        (f"GPGGA,081836,{PLACE},6,09,1.0,12.0,M,42.1,M,,", RECKONED_M),
        (f"GPGGA,081836,{PLACE},7,09,1.0,12.0,M,42.1,M,,", "typed_in"),
        (f"GPGGA,081836,{PLACE},8,09,1.0,12.0,M,42.1,M,,", "simulated"),
        (f"GPGGA,081836,{PLACE},0,09,1.0,12.0,M,42.1,M,,", "no_fix"),
        (f"IIRMC,081836,A,{PLACE},,,130998,,,A", METRES_M),
        (f"IIGGA,081836,{PLACE},1,09,0.9,,M,,M,,", METRES_M),
        (f"IIGGA,081836,{PLACE},1,09,,12.0,M,,M,,", METRES_M),
        (f"IIGGA,081836,{PLACE},1,,,,,,,,", METRES_M),
    ],
)  # fmt: skip
def test_a_place_is_worth_what_its_sentence_says_of_it(body: str, worth: tuple[float, float] | str) -> None:
    reader = NmeaReader()
    made = reader.samples(line(body), NOW)
    if isinstance(worth, str):
        assert (made, dict(reader.refused)) == ([], {worth: 1})
        return
    fix = made[0]
    assert isinstance(fix, GeoFix)
    assert worth[0] <= fix.sigma_m <= worth[1]
    if worth is RECKONED_M:
        assert (fix.v_ned, len(made)) == (None, 1), "no velocity is taken of what is reckoned"


def test_a_rehearsal_takes_what_is_simulated_where_the_settings_say_so() -> None:
    for body in (f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,S", f"GPGGA,081836,{PLACE},8,09,1.0,12.0,M,42.1,M,,"):
        assert NmeaReader().samples(line(body), NOW) == []
        fix, *_ = NmeaReader(simulated=True).samples(line(body), NOW)
        assert fix.sigma_m <= 5.0
    assert NmeaReader(simulated=True).samples(line(f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,M"), NOW) == []


def test_the_second_of_ais_says_how_its_place_is_known() -> None:
    for second, low, high in ((30, 5.0, 10.0), (60, 5.0, 10.0), (62, 20.0, 500.0)):
        fix, *rest = NmeaReader(MMSI).samples(ais(second=second), NOW)
        assert low <= fix.sigma_m <= high
        assert any(s.v_vessel_ned is not None for s in rest) == (second != 62)


def test_a_receiver_that_puts_its_clock_back_is_followed_within_seconds() -> None:
    reader = NmeaReader()
    for n in range(120):
        at = 8 * 3600 + n - (3 if n >= 60 else 0)
        body = f"GPRMC,{at // 3600:02d}{at // 60 % 60:02d}{at % 60:02d}.00,A,{PLACE},005.4,000.0,211126,,,A"
        fix, *_ = reader.samples(line(body), MonoNs(NOW + n * 10**9))
        if n >= 66:
            assert fix.stamp.delay_s < 0.5


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
