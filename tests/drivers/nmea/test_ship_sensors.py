"""Motion sensors, compasses and anemometers: recorded ones against one another, every format's signs, and what is not taken."""

import math
import struct
from collections import Counter
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.nmea.fields import KNOT_M_S
from drivers.nmea.sentences import NmeaReader
from drivers.nmea.transport import SentenceSource
from drivers.one_source import SourceChoice
from estimator.contracts.geometry import F64
from estimator.contracts.samples import GeoFix, Sample, VesselMotion, VesselReport, VesselWind
from estimator.contracts.time import MonoNs
from tests.drivers.nmea.test_sentences import NOW, line
from tests.make import ns

PALMER = Path(__file__).parents[3] / "../shared/data/ship_palmer"
needs_palmer = pytest.mark.skipif(not PALMER.is_dir(), reason="the recordings of the Nathaniel B. Palmer are not here")


def logged(*names: str) -> list[tuple[MonoNs, str]]:
    """Return what loggers wrote, in one stream: arrival and sentence."""
    rows = [row.split(" ", 1) for name in names for row in (PALMER / f"{name}.txt").read_text().splitlines()]
    at = sorted((datetime.fromisoformat(when).timestamp() % 86_400.0 + 100.0, said) for when, said in rows)
    return [(ns(when), said) for when, said in at]


def read(rows: Sequence[tuple[MonoNs, str]]) -> tuple[list[Sample], NmeaReader]:
    reader = NmeaReader()
    return [one for at, said in rows for one in reader.samples(said.encode(), at)], reader


def motions(samples: Sequence[Sample], sensor: str) -> F64:
    """Return (N, 4) of a sensor: s, roll, pitch, rad, and heave, m."""
    mine = [s for s in samples if isinstance(s, VesselMotion) and s.sensor == sensor]
    return np.array([(s.stamp.measured_at * 1e-9, s.roll_rad, s.pitch_rad, s.heave_down_m) for s in mine])


@needs_palmer
def test_two_seapaths_in_one_stream_agree_and_each_quantity_is_of_one_receiver() -> None:
    """Their bursts are a third and a quarter of a second long: only as of the bursts' times do pitches agree so well."""
    samples, reader = read(logged("s330", "seap", "gyr1"))
    a, b = motions(samples, "IN PSXN"), motions(samples, "GP PSXN")
    assert (len(a), len(b)) == (312, 357)
    common = b[(b[:, 0] > a[0, 0]) & (b[:, 0] < a[-1, 0])]
    apart = [common[:, k] - np.interp(common[:, 0], a[:, 0], a[:, k]) for k in (1, 2, 3)]
    assert np.degrees(np.std(apart[0])) < 0.1
    assert np.degrees(np.std(apart[1])) < 0.35
    assert np.std(apart[2]) < 0.1 < 1.0 < np.std(common[:, 3])
    fixes = [s for s in samples if isinstance(s, GeoFix)]
    north = np.diff([s.place.latitude_rad for s in fixes]) * 6.37e6
    assert np.sum(np.abs(north) > 6.0) == 1, "the antennas are 13 m apart: from one to the other, once"
    assert reader.sources["GPGGA"].refused["other_receiver"] > 300
    assert reader.sources["GPGGA"].used > 30, "the second takes over where the log of the first ends"


@needs_palmer
def test_a_motion_keeps_its_name_where_a_compass_agrees_by_chance_and_where_sentences_are_lost() -> None:
    samples, _ = read([(at, said) for at, said in logged("s330", "gyr1") if "PSXN" in said or "HEHDT" in said])
    assert len(motions(samples, "PSXN")) == 312
    rng = np.random.default_rng(3)
    rows = [(at, said) for at, said in logged("s330", "seap", "gyr1") if "PSXN,23" in said or rng.random() > 0.1]
    samples, _ = read(rows)
    assert (len(motions(samples, "IN PSXN")), len(motions(samples, "GP PSXN"))) == pytest.approx((312, 357), abs=4)
    assert {s.sensor for s in samples if isinstance(s, VesselMotion)} == {"IN PSXN", "GP PSXN"}


@needs_palmer
def test_heave_is_against_the_height_of_the_same_receiver_and_heading_turns_as_the_gyro() -> None:
    for name, talker in (("s330", "IN"), ("seap", "GP")):
        samples, _ = read(logged(name))
        heights = np.array(
            [(s.stamp.measured_at * 1e-9, s.place.height_m) for s in samples if isinstance(s, GeoFix) and s.place.height_m]
        )
        moved = motions(samples, f"{talker} PSXN")
        height = np.interp(moved[:, 0], heights[:, 0], heights[:, 1])
        assert np.corrcoef(moved[:, 3], height)[0, 1] < -0.97


@needs_palmer
def test_two_anemometers_of_a_ship_make_the_same_wind_over_the_ground() -> None:
    """The sonic heads on both sides of the mast, as MWV: 15 m/s apart on the deck from what they are over the ground."""
    found = {}
    for side in ("SUS", "PUS"):
        rows = logged("s330")
        for at, said in logged("mwx1"):
            cells = said.split(",")
            if cells[0] == side:
                rows.append((at, line(f"WIMWV,{cells[2]},R,{cells[3]},M,A").decode().strip()))
        samples, _ = read(sorted(rows))
        winds = [s for s in samples if isinstance(s, VesselWind)]
        assert len(winds) > 250
        found[side] = np.mean([(w.speed_m_s * math.cos(w.from_rad), w.speed_m_s * math.sin(w.from_rad)) for w in winds], axis=0)
    assert np.linalg.norm(found["SUS"] - found["PUS"]) < 2.5
    assert np.linalg.norm(found["SUS"]) < 8.0, "of 9.5 m/s on deck against 4.8 m/s of way"


def em3000(state: int, roll: float, pitch: float, heave: float, heading: float) -> bytes:
    return struct.pack("<BBhhhH", state, 0x90, *(round(100.0 * x) for x in (roll, pitch, heave, heading)))


MOTIONS = [
    (line("PSXN,23,2.50,-1.50,218.25,0.60"), "PSXN", 0.6),
    (line("psxn,23,+2.5000e+00,-1.5e0,218.25,6.0000e-01"), "PSXN", 0.6),
    (line("PSXN,23,2.50,-1.50,,"), "PSXN", None),
    (line("PASHR,163029.000,158.09,T,+2.50,-1.50,-0.60,0.029,0.029,0.059,1,1"), "PASHR", 0.6),
    (line("PASHR,163029,158.09,T,+02.50,-01.50,,,,,2"), "PASHR", None),
    (line("PRDID,-1.50,2.50,218.2"), "PRDID", None),
    (line("YXXDR,C,12.0,C,AIR,A,-1.5,D,PTCH,D,-0.6,M,HEAVE,A,2.5,D,ROLL"), "YX XDR", 0.6),
    (line("IIXDR,A,2.5,D,Heel,A,-1.5,D,PITCH#1,A,4.0,D,RUDDER"), "II XDR", None),
    (b":0AFFCA -0060F 0250 -0150\r\n", "TSS1", 0.6),
    (em3000(0x90, 2.5, -1.5, -0.6, 218.25), "EM3000", 0.6),
    (em3000(0x00, 2.5, -1.5, -0.6, 218.25), "EM3000", 0.6),
]  # fmt: skip


@pytest.mark.parametrize(("said", "sensor", "heave_down_m"), MOTIONS)
def test_every_format_has_its_own_signs(said: bytes, sensor: str, heave_down_m: float | None) -> None:
    """Starboard 2.5 degrees down, bow 1.5 degrees down, and 0.6 m below its mean."""
    got = [one for one in NmeaReader().samples(said, NOW) if isinstance(one, VesselMotion)]
    if sensor == "II XDR":
        parts = [p for one in got for p in (one.roll_rad, one.pitch_rad) if p is not None]
        assert sorted(map(math.degrees, parts)) == pytest.approx([-1.5, 2.5])
        return
    (one,) = got
    assert one.sensor == sensor
    assert (one.roll_rad, one.pitch_rad) == pytest.approx((math.radians(2.5), math.radians(-1.5)))
    assert one.heave_down_m == (None if heave_down_m is None else pytest.approx(heave_down_m))
    assert math.radians(0.002) < one.sigma_tilt_rad < math.radians(0.04)
    assert one.acceleration_m_s2 == (pytest.approx(9.81 * 10 / 255, rel=0.01) if sensor == "TSS1" else None)


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        (line("PSXN,23,,,,"), "no_motion"),
        (line("PSXN,23,1_0,2.0,3.0,1.0"), "malformed"),
        (line("PSXN,23,inf,2.0,3.0,1.0"), "impossible"),
        (line("PSXN,23,0.1,2.0,363.0,1.0"), "impossible"),
        (line("PSXN,23,99.99,2.0,3.0,1.0"), "impossible"),
        (line("PSXN,23,0.1,2.0,3.0,99.99"), "impossible"),
        (line("PSXN,20,0,0,0,7"), "impossible"),
        (line("PSXN,26,0,44.5,0.78,-0.9,NRP"), "other_sentence"),
        (line("PASHR,163029.000,158.09,T,-0.30,+0.31,+0.01,0.029,0.029,0.059,1,0"), "bad_quality"),
        (line("PASHR,POS,0,07,163029.00"), "other_sentence"),
        (line("PASHR,,,,,,,,,,0,0"), "other_sentence"),
        (line("YXXDR,C,12.0,C,AIR,P,1.01,B,BARO"), "other_sentence"),
        (line("YXXDR,A,,D,ROLL"), "other_sentence"),
        (line("YXXDR,A,180.0,D,ROLL"), "impossible"),
        (line("TIROT,3.0,V"), "not_valid"),
        (line("TIROT,,A"), "no_turn"),
        (line("TIROT,9999.9,A"), "impossible"),
        (line("HETHS,123.4,V"), "not_valid"),
        (line("HETHS,123.4,S"), "simulated"),
        (line("HETHS,,A"), "no_heading"),
        (line("HETHS,361.0,A"), "impossible"),
        (line("IIVHW,,T,120.0,M,5.0,N,9.3,K"), "no_heading"),
        (line("WIMWV,45.0,R,10.0,N,V"), "not_valid"),
        (line("WIMWV,45.0,R,10.0,N,A"), "no_way"),
        (line("WIMWV,45.0,R,10.0,X,A"), "malformed"),
        (line("WIMWV,400.0,T,10.0,N,A"), "impossible"),
        (line("WIMWD,,T,,M,,N,,M"), "no_wind"),
        (line("WIMWD,90.0,T,,M,-5.0,N,,M"), "impossible"),
        (b":00FFCA -0060f 0250 -0150\r\n", "bad_quality"),
        (b":00FFCA -00x0F 0250 -0150\r\n", "malformed"),
        (em3000(0x9C, 2.5, -1.5, 0.6, 218.0), "bad_quality"),
        (em3000(0xA0, 2.5, -1.5, 0.6, 218.0), "bad_quality"),
        (em3000(0x90, 2.5, -1.5, 0.6, 400.0), "impossible"),
    ],
)
def test_what_a_sensor_does_not_know_is_counted_by_its_reason(said: bytes, reason: str) -> None:
    reader = NmeaReader()
    assert reader.samples(said, NOW) == []
    assert reader.refused == {reason: 1}


def test_parts_of_bad_quality_are_left_out_until_they_are_good_again() -> None:
    reader = NmeaReader()
    motion = line("PSXN,23,2.50,-1.50,218.25,0.60")
    assert reader.samples(line("PSXN,20,2,2,0,0"), NOW) == []
    (moved, _) = reader.samples(motion, NOW)
    assert (moved.heave_down_m, moved.pitch_rad) == (None, pytest.approx(math.radians(-1.5)))
    assert reader.samples(line("PSXN,20,0,2,2,2") + motion, NOW) == []
    assert reader.refused == {"bad_quality": 2}
    assert len(reader.samples(line("PSXN,20,0,1,0,0") + motion, NOW)) == 2


def test_a_turn_and_a_heading_have_their_sense_and_their_digits() -> None:
    reader = NmeaReader()
    (turned,) = reader.samples(line("TIROT,-30.0,A"), NOW)
    assert turned.turn_rad_s == pytest.approx(math.radians(-0.5)), "to port"
    (fast,) = reader.samples(line("TIROT,60"), NOW)
    assert fast.turn_rad_s == pytest.approx(math.radians(1.0))
    assert fast.sigma_turn_rad_s > turned.sigma_turn_rad_s
    assert len(NmeaReader().samples(line("PSXN,24,0.10,0.20,1.50,0.10"), NOW)) == 1
    fine, coarse = (NmeaReader().samples(line(f"HETHS,{said},A"), NOW)[0] for said in ("120.0", "1E2"))
    assert fine.sigma_heading_rad < 0.1 < coarse.sigma_heading_rad
    (whole,) = NmeaReader().samples(line("GPVTG,180.0,T,,M,5,N,,K,A"), NOW)
    (tenths,) = NmeaReader().samples(line("GPVTG,180.0,T,,M,5.0,N,,K,A"), NOW)
    assert whole.cov_v_ned[0, 0] > tenths.cov_v_ned[0, 0] > 0.2**2


@pytest.mark.parametrize(("unit", "factor"), [("N", KNOT_M_S), ("K", 1.0 / 3.6), ("M", 1.0)])
def test_wind_is_made_over_the_ground_of_her_heading_and_way(unit: str, factor: float) -> None:
    reader = NmeaReader()
    # Heading east at 5 m/s, in a wind of 5 m/s from the north: on deck it comes from 45 degrees to port with 7.07 m/s.
    reader.samples(line("HEHDT,90.0,T") + line(f"GPVTG,90.0,T,,M,{5.0 / KNOT_M_S:.3f},N,,K,A"), NOW)
    apparent = line(f"WIMWV,315.0,R,{math.hypot(5.0, 5.0) / factor:.3f},{unit},A")
    (wind,) = reader.samples(apparent, NOW)
    assert (math.cos(wind.from_rad), wind.speed_m_s) == pytest.approx((1.0, 5.0), abs=0.02)
    (true,) = NmeaReader().samples(line("WIMWD,10.0,T,8.0,M,10.0,N,,M"), NOW)
    assert (true.from_rad, true.speed_m_s) == pytest.approx((math.radians(10.0), 10.0 * KNOT_M_S))
    assert reader.samples(apparent, ns(60.0)) == [], "her way of a minute ago is not her way"


def test_a_better_receiver_wins_after_a_while_and_the_other_one_where_it_falls_silent() -> None:
    def gga(talker: str, second: float, quality: int) -> bytes:
        return line(f"{talker}GGA,{120000.0 + second:09.2f},5424.01800,N,01012.06600,E,{quality},12,0.8,4.0,M,45.0,M,,")

    reader, used = NmeaReader(), []
    for second in range(40):
        rtk = 10 <= second < 20
        for talker, quality in (("GP", 1), ("GN", 4 if rtk else 1)):
            if talker == "GN" and second >= 30:
                continue
            used += [(second, talker) for _ in reader.samples(gga(talker, second, quality), ns(100.0 + second))]
    by_talker = {talker: [s for s, who in used if who == talker] for talker in ("GP", "GN")}
    assert by_talker["GN"] == list(range(by_talker["GN"][0], 30))
    assert 12 <= by_talker["GN"][0] <= 15
    assert by_talker["GP"][-1] == 39
    assert 2 <= min(s for s in by_talker["GP"] if s > 20) - 30 <= 4, "the better one is missed for no longer than three seconds"


@given(st.floats(0.2, 9.0), st.floats(0.1, 0.9))
def test_two_sources_that_report_seldom_do_not_take_turns(period_s: float, apart: float) -> None:
    choice = SourceChoice()
    used = [
        name
        for n in range(40)
        for name, at in (("a", n), ("b", n + apart))
        if choice.takes("place", name, 2.5, ns(10.0 + at * period_s))
    ]
    assert len(used) in (40, 41), "one of both, after the first few"
    assert len(set(used[2:])) == 1


def test_a_motion_has_the_instant_of_its_burst_also_where_the_sentence_with_the_time_was_lost() -> None:
    reader, delays_s = NmeaReader(), []
    for second in range(20):
        gga = line(f"INGGA,{120000 + second:06d}.00,5424.01800,N,01012.06600,E,1,12,0.8,4.0,M,45.0,M,,")
        if second not in (7, 13):
            reader.samples(gga, ns(100.1 + second))
        got = reader.samples(line("INHDT,90.00,T") + line("PSXN,23,1.0,2.0,90.00,0.5"), ns(100.4 + second))
        delays_s += [one.stamp.delay_s for one in got if isinstance(one, VesselMotion)]
    assert delays_s[2:] == pytest.approx([0.3] * 18, abs=0.01)
    ten_hz = [one for n in range(50) for one in reader.samples(line("HEHDT,90.0,T"), ns(130.0 + 0.1 * n))]
    assert all(one.stamp.delay_s == 0.0 for one in ten_hz)


def test_a_storm_of_sentences_is_dropped_and_counted_and_the_next_second_is_read() -> None:
    reader = NmeaReader()
    storm = b"".join(line("GPGSV,3,1,11,03,03,111,00") for _ in range(800))
    motions = 0
    for n in range(20):
        reader.samples(storm, ns(100.0 + 0.01 * n))
        motions += len(reader.samples(line("PSXN,23,1.0,2.0,,0.5"), ns(100.0 + 0.01 * n)))
    assert reader.refused["too_many"] > 13_000
    assert motions == 20, "another's storm takes nothing from her motion sensor"
    assert len(reader.samples(line("HEHDT,90.0,T"), ns(102.0))) == 1
    for n in range(2000):
        reader.samples(line(f"{n:05d},1") + line(f"{n % 90:02d}HDT,1.0,T"), ns(103.0 + n))
    assert len(reader.sources) <= 70
    assert reader.samples(line("INROT,5.0,A"), ns(3000.0)) != [], "ninety talkers before leave room for a new one"


def test_binary_records_arrive_in_datagrams_and_cut_anywhere_in_a_stream_and_text_beside_them() -> None:
    records = [em3000(0x90, 0.1 * n, -0.2 * n, 0.01 * n, 30.0) for n in range(20)]
    for size in (1, 3, 10, 17, 200):
        reader, got = NmeaReader(), list[Sample]()
        source = SentenceSource("", lambda data, at, reader=reader, got=got: got.extend(reader.samples(data, at)))
        stream = b"".join(records)
        for at in range(0, len(stream), size):
            source.take(stream[at : at + size], NOW, None)
        rolls = [math.degrees(s.roll_rad) for s in got if isinstance(s, VesselMotion)]
        assert rolls == pytest.approx([0.1 * n for n in range(20)], abs=1e-6)
        source.take(line("HEHDT,90.0,T"), NOW, None)
        assert isinstance(got[-1], VesselReport)
    source.take(records[3], NOW, ("127.0.0.1", 4000))
    assert isinstance(got[-2], VesselMotion)


BODIES = st.one_of(
    *(
        st.lists(st.text("0123456789.+-eENTRMDAVK ", max_size=9), max_size=13).map(
            lambda cells, kind=kind: ",".join((kind, *cells))
        )
        for kind in ("PSXN,20", "PSXN,23", "PSXN,24", "PASHR", "PRDID", "TIROT", "HETHS", "IIVHW", "WIMWV", "WIMWD")
    ),
    st.lists(st.sampled_from(["A", "D", "M", "ROLL", "PTCH", "HEAVE", "1.5", "-99", ""]), max_size=16).map(
        lambda cells: ",".join(("YXXDR", *cells))
    ),
)


@given(st.lists(st.one_of(BODIES.map(line), st.binary(max_size=30)), max_size=8))
def test_no_cells_make_a_motion_that_no_ship_has(said: list[bytes]) -> None:
    reader = NmeaReader()
    seen: Counter[str] = Counter()
    for n, one in enumerate(said):
        for sample in reader.samples(one, ns(10.0 + n)):
            seen[type(sample).__name__] += 1
            if isinstance(sample, VesselMotion):
                assert max(abs(sample.roll_rad or 0.0), abs(sample.pitch_rad or 0.0)) < 1.1
                assert abs(sample.heave_down_m or 0.0) <= 20.0
            if isinstance(sample, VesselReport) and sample.turn_rad_s is not None:
                assert abs(sample.turn_rad_s) <= math.radians(60.0)
    assert not seen or reader.taken.total() > 0
