"""Sentences of a ship: what published examples say, what damaged ones do not, whose are not taken, and how they arrive."""

import asyncio
import math
import os
import socket
import tty

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyais import encode_dict

from drivers.clock import SystemClock
from drivers.endpoint import Address, Endpoint, parse_endpoint
from drivers.nmea.fields import KNOT_M_S
from drivers.nmea.motion import ship_motion
from drivers.nmea.sentences import NmeaReader
from drivers.nmea.transport import HELD_S, SentenceJoiner, SentenceSource, sentences_from
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import GeoFix
from estimator.contracts.time import MonoNs
from tests.make import ns
from tests.support.waiting import answering, until

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
    assert degrees(fix) == pytest.approx([-37.860833, 145.122667], abs=1e-6)
    assert fix.place.height_m is None
    speed = 5.5 * KNOT_M_S / math.sqrt(2.0)
    assert report.v_vessel_ned == pytest.approx([speed, speed, 0.0])
    assert report.cov_v_ned[2, 2] > 1e5, "nothing is said of the vertical"


def test_a_motion_sensor_says_roll_pitch_heading_and_heave() -> None:
    moved = ship_motion(line("PSXN,23,0.40,-1.75,218.25,0.60").decode().strip())
    assert [*moved[:2], *moved[3::3]] == pytest.approx([math.radians(0.4), math.radians(-1.75), 0.6, math.radians(218.25)])
    for other in ("PSXN,20,1,0,0,0", "PSXN,23,0.4,-1.7,218.2", "PSXN,23,0.4,,218.2,0.6", "PSXN,23,nan,1,2,3", "HEHDT,218.2,T"):
        assert ship_motion(line(other).decode().strip()) is None, other
    assert ship_motion("$PSXN,23,0.40,-1.75,218.25,0.60*00") is None, "the checksum is another"


def test_gga_reports_the_height_and_how_good_it_is() -> None:
    body = GGA[1:].partition("*")[0]
    (fix,) = NmeaReader().samples(line(body), NOW)
    assert degrees(fix) == pytest.approx([51.11632, -114.0383383], abs=1e-6)
    assert (fix.place.height_m, fix.sigma_m) == (1048.47, pytest.approx(4.0, rel=0.01))


@pytest.mark.parametrize(
    ("beside_min", "ahead_s", "apart_m"),
    [(0.0, 0.0, 0.0), (0.02, 0.0, 21.6), (0.02, 0.1, 21.6), (0.0, 2.0, 10.3), (0.0, -0.5, 2.6)],
)
def test_two_receivers_with_one_talker_are_known_as_badly_as_they_differ(beside_min, ahead_s, apart_m):
    reader, sigmas = NmeaReader(), []
    for second in range(8):
        for beside, ahead in ((0.0, 0.0), (beside_min, ahead_s)):
            east = 3.0 + second * 5.144 / 1077.0 + beside
            body = f"GPGGA,12{3001.0 + second + ahead:07.2f},5430.0000,N,0100{east:.4f},E,1,12,0.8,4.0,M,45.0,M,,"
            for one in (body, "GPVTG,90.0,T,,M,010.0,N,18.5,K,A"):
                sigmas += [s.sigma_m for s in reader.samples(line(one), ns(1000.0 + second)) if isinstance(s, GeoFix)]
    assert len(sigmas) == 16
    assert all(0.9 * apart_m <= sigma_m < 1.1 * apart_m + 3.0 for sigma_m in sigmas[1:])


def test_vtg_and_hdt_tell_motion_and_heading_together_in_one_datagram() -> None:
    moving, pointing = NmeaReader().samples(line("GPVTG,180.0,T,,M,010.0,N,18.5,K") + line("HEHDT,123.4,T"), NOW)
    assert moving.v_vessel_ned == pytest.approx([-10.0 * KNOT_M_S, 0.0, 0.0], abs=1e-9)
    assert moving.heading_rad is None
    assert pointing.heading_rad == pytest.approx(math.radians(123.4))
    assert pointing.v_vessel_ned is None


def test_a_longitude_that_counts_on_beyond_180() -> None:
    (fix,) = NmeaReader().samples(line("GPGGA,120000.00,1700.0000,S,18000.0300,E,4,12,0.8,5.0,M,30.0,M,1.0,0001"), NOW)
    assert degrees(fix) == pytest.approx([-17.0, -179.9995])


def test_the_named_ship_s_ais_is_taken_and_no_other_s() -> None:
    reader = NmeaReader(MMSI)
    fix, moving, pointing = reader.samples(ais(), NOW)
    assert degrees(fix) == pytest.approx([54.4, 10.2], abs=1e-5)
    assert moving.v_vessel_ned == pytest.approx([0.0, 3.0 * KNOT_M_S, 0.0], abs=1e-6)
    assert pointing.heading_rad == pytest.approx(math.radians(100.0))
    for class_b in (18, 19):
        assert [type(s) for s in reader.samples(ais(type=class_b, heading=511, speed=102.3), NOW)] == [GeoFix]
    assert reader.samples(ais(mmsi=MMSI + 1), NOW) == []
    assert [reader.samples(ais(**place), NOW) for place in ({"lat": 91}, {"lon": 181}, {"lat": 91, "lon": 181})] == [[], [], []]
    assert reader.refused == {"other_ship": 1, "no_fix": 3}
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
        (line("GPRMC,081836,A,3751.65,S,14507.36,E,005.5,540.0,130998,011.3,E"), "impossible"),
        (line("GPVTG,-90.0,T,,M,010.0,N,18.5,K,A"), "impossible"),
        (line("GPGGA,134658.00,5106.9,N,11402.3,W,12,09,1.0,10.0,M,-16.27,M,08,AAAA"), "impossible"),
        (line("GPRMC,,V,,,,,,,,,,N"), "no_fix"),
        (line("GPGGA,,,,,,0,,,,,,,,"), "no_fix"),
        (line("HEHDT,,T"), "no_heading"),
        (line("GPVTG,,T,,M,,N,,K"), "no_fix"),
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


PLACE = "3751.6500,S,14507.3600,E"
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
        (f"GPRMC,081836,A,{PLACE},005.5,045.0,130998,,,A,U", "not_valid"),
        ("GPGGA,081836,0000.0000,N,00000.0000,E,1,09,1.0,12.0,M,42.1,M,,", "no_fix"),
        *((f"GNGNS,081836,{PLACE},{modes},09,1.0,12.0,42.1,,,V", METRES_M) for modes in ("A", "DN", "NNP", "AD")),
        *((f"GNGNS,081836,{PLACE},{modes},09,1.0,12.0,42.1,,", RTK_M) for modes in ("RR", "NF", "RFRN")),
        (f"GNGNS,081836,{PLACE},RA,09,1.0,12.0,42.1,,", METRES_M),
        (f"GNGNS,081836,{PLACE},AE,09,1.0,12.0,42.1,,", RECKONED_M),
        (f"GNGNS,081836,{PLACE},NNNN,00,99.9,,,,", "no_fix"),
        (f"GNGNS,081836,{PLACE},,00,99.9,,,,", "no_fix"),
        (f"GNGNS,081836,{PLACE},M,09,1.0,12.0,42.1,,", "typed_in"),
        (f"GNGNS,081836,{PLACE},AS,09,1.0,12.0,42.1,,", "simulated"),
        (f"GNGNS,081836,{PLACE},A7,09,1.0,12.0,42.1,,", "impossible"),
        (f"GNGNS,081836,{PLACE},AA,09,1.0,12.0,42.1,,,U", "not_valid"),
        (f"GPGLL,{PLACE},081836,A", METRES_M),
        (f"GPGLL,{PLACE},081836,A,E", RECKONED_M),
        (f"GPGLL,{PLACE},081836,A,N", "no_fix"),
        (f"GPGLL,{PLACE},081836,A,S", "simulated"),
        (f"GPGLL,{PLACE},081836,V,A", "no_fix"),
        (f"GPGLL,{PLACE},,A,A", METRES_M),
        (f"GPGLL,{PLACE}", "no_fix"),
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
    assert worth[0] <= fix.sigma_m <= 1.01 * worth[1]
    if worth is RECKONED_M:
        assert (fix.v_ned, len(made)) == (None, 1), "no velocity is taken of what is reckoned"


@pytest.mark.parametrize(
    ("kinds", "used"), [("GNS GLL", "GNS"), ("RMC GNS GLL", "RMC GNS"), ("GGA RMC GNS GLL", "GGA RMC"), ("GLL", "GLL")]
)
def test_a_receiver_s_place_is_not_taken_again_from_a_sentence_that_says_less(kinds: str, used: str) -> None:
    reader, bodies = NmeaReader(), {
        "GGA": "{t},{p},1,09,1.0,12.0,M,42.1,M,,", "RMC": "{t},A,{p},005.5,045.0,130998,,,A",
        "GNS": "{t},{p},AA,09,1.0,12.0,42.1,,", "GLL": "{p},{t},A,A",
    }  # fmt: skip
    for second in range(10):
        for kind in kinds.split():
            reader.samples(line(f"GN{kind}," + bodies[kind].format(t=f"0818{second:02d}", p=PLACE)), MonoNs(NOW + second * 10**9))
    assert reader.taken == dict.fromkeys(used.split(), 10)
    assert reader.refused.get("repeated", 0) == 10 * (len(kinds.split()) - len(used.split()))


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


def test_reports_that_come_10_s_late_say_so() -> None:
    reader = NmeaReader(MMSI)
    for late_s, seconds in ((0, range(30)), (10, range(30, 60))):
        for second in seconds:
            received_at = MonoNs(NOW + (second + late_s) * 10**9)
            body = f"GPRMC,0800{second:02d},A,3751.65,S,14507.36,E,005.5,045.0,130998,011.3,E"
            fix, *_ = reader.samples(line(body), received_at)
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


HOST = "127.0.0.1"
SHIP, OTHER = (HOST, 4000), ("192.0.2.7", 4000)


sentences = st.builds(
    lambda tag, body: (rb"\s:bridge*12" b"\\" if tag else b"") + line(body),
    st.booleans(),
    st.text("ABCGNPRS0123456789.,", min_size=1, max_size=70),
)


@given(st.lists(st.lists(sentences, min_size=1, max_size=5), min_size=1, max_size=3), st.data())
def test_sentences_of_several_programs_are_put_together_wherever_they_are_cut(programs, data):
    joiner, now = SentenceJoiner(), 0.0
    found: dict[int, list[bytes]] = {n: [] for n in range(len(programs))}
    streams = [b"".join(one) for one in programs]
    while any(streams):
        n = data.draw(st.sampled_from([n for n, rest in enumerate(streams) if rest]))
        size = data.draw(st.integers(1, len(streams[n])))
        piece, streams[n] = streams[n][:size], streams[n][size:]
        found[n] += joiner.lines(piece, (HOST, 5000 + n), ns(now))
        now += 0.01
    assert [found[n] for n in found] == [[whole.strip() for whole in one] for one in programs]
    assert joiner.cut == 0


@pytest.mark.parametrize(
    "pieces",
    [
        [(0.0, b"P,1,2*00\r\n")],  # the end alone
        [(0.0, b"$GPRMC,1"), (0.1, line("GPHDT,1,T"))],  # the begin alone, then another
        [(0.0, b"$GPRMC,1"), (9.0, b",2*00\r\n")],  # the end comes too late
        [(0.0, b"$" + 600 * b"G")],
        [(0.0, bytes(range(128, 200)))],
    ],
)
def test_half_a_sentence_is_counted_and_no_whole_one_is_lost(pieces: list[tuple[float, bytes]]) -> None:
    joiner = SentenceJoiner()
    lines = [whole for when, data in pieces for whole in joiner.lines(data, SHIP, ns(when))]
    assert joiner.cut >= 1
    assert [whole for whole in lines if b"GPHDT" in whole] == [d.strip() for _, d in pieces if b"GPHDT" in d]
    assert joiner.lines(line("GPHDT,2,T"), SHIP, ns(20.0)) == [line("GPHDT,2,T").strip()]


@given(st.lists(st.tuples(st.binary(max_size=80), st.integers(0, 40)), max_size=40))
def test_any_bytes_are_lines_or_counted_and_little_is_kept(pieces: list[tuple[bytes, int]]) -> None:
    joiner = SentenceJoiner()
    for data, port in pieces:
        for whole in joiner.lines(data, (HOST, port), ns(0.0)):
            assert b"\n" not in whole
    assert len(joiner._begun) <= 16


def taken(source_of: str, datagrams: list[tuple[float, Address, bytes]]) -> tuple[list[bytes], SentenceSource]:
    got: list[bytes] = []
    source = SentenceSource(source_of, lambda data, when: got.append(data))
    for when, sender, data in datagrams:
        source.take(data, ns(when), sender)
    return got, source


def test_an_address_counts_and_not_a_port() -> None:
    lines = [line(f"GPHDT,{n},T") for n in range(8)]
    for named in (HOST, ""):
        got, source = taken(named, [(float(n), (HOST, 4000 + n), whole) for n, whole in enumerate(lines)])
        assert got == [whole.strip() for whole in lines]
        assert not source.refused
    got, _ = taken(HOST, [(0.0, (f"::ffff:{HOST}", 4000), lines[0])])
    assert got == [lines[0].strip()], "a socket for IPv6 writes it so"


def test_another_address_is_refused_until_the_first_is_silent() -> None:
    lines = [line(f"GPHDT,{n},T") for n in range(4)]
    senders = [(0.0, SHIP), (1.0, OTHER), (2.0, SHIP), (2.0 + HELD_S + 0.1, OTHER)]
    got, source = taken("", [(when, sender, whole) for (when, sender), whole in zip(senders, lines, strict=True)])
    assert got == [whole.strip() for n, whole in enumerate(lines) if n != 1]
    assert source.refused == {"wrong_sender": 1}
    got, source = taken("192.0.2.9", [(when, sender, whole) for (when, sender), whole in zip(senders, lines, strict=True)])
    assert (got, source.refused) == ([], {"wrong_sender": 4})


async def test_sentences_arrive_by_udp_tcp_and_a_serial_port() -> None:
    got: list[bytes] = []
    source = SentenceSource("", lambda data, when: got.append(data))
    data = line("GPHDT,1,T") + line("GPHDT,2,T")

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        for piece in (data[:12], data[12:]):
            writer.write(piece)
            await writer.drain()
            await asyncio.sleep(0.01)
        writer.close()

    async with answering(serve) as port, sentences_from(parse_endpoint(f"tcp://{HOST}:{port}"), source, SystemClock()):
        await until(lambda: b"\n".join(got).count(b"GPHDT") == 2)
    far, near = os.openpty()
    tty.setraw(far)
    async with sentences_from(Endpoint("serial", os.ttyname(near), 4800), source, SystemClock()):
        os.write(far, data)
        await until(lambda: b"\n".join(got).count(b"GPHDT") == 4)
    os.close(far)
    os.close(near)
    async with sentences_from(Endpoint("udpin", HOST, 0), source, SystemClock()) as wire:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ship:
            ship.sendto(data, wire.local)
        await until(lambda: b"\n".join(got).count(b"GPHDT") == 6)
        with pytest.raises(Recoverable, match=r"vessel.nmea udpin://127.0.0.1:\d+: "):
            async with sentences_from(Endpoint("udpin", HOST, wire.local[1]), source, SystemClock()):
                pass
