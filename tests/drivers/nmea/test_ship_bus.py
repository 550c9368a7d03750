"""The ship's network: what canboat's own encoder says, a recorded boat, damage, and each way by which it arrives."""

import asyncio
import json
import math
import os
import tty
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from aiohttp import web
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.parts.ship.options import RtkOptions
from companion.parts.ship.part import BusPart
from companion.settings.load import load
from companion.settings.referenced_files import check_installed
from drivers.clock import SystemClock
from drivers.endpoint import parse_bus
from drivers.mailbox import Line
from drivers.nmea.ship_bus import BusReader
from drivers.nmea.ship_sensors import Samples, ShipSensors
from drivers.one_source import SourceChoice
from estimator.contracts.errors import BadInput, Recoverable
from estimator.contracts.samples import GeoFix, Sample, VesselMotion, VesselReport, VesselWind
from estimator.contracts.time import MonoNs
from tests.companion.test_ship_sensors import begun, imported
from tests.support.waiting import answering, free_port, until

pytest.importorskip("nmea2000", reason="the extra ship is not installed")
import can
from nmea2000 import backend, create_encoder
from nmea2000.ioclient import bdtp_wrap
from nmea2000.message import NMEA2000Message

NOW = MonoNs(50_000_000_000)
BOAT = Path(__file__).parents[4] / "shared/data/boat_nmea2000"
PGNS = {
    "attitude": 127257, "heave": 127252, "rateOfTurn": 127251, "vesselHeading": 127250, "magneticVariation": 127258,
    "positionRapidUpdate": 129025, "gnssPositionData": 129029, "cogSogRapidUpdate": 129026, "windData": 130306,
}  # fmt: skip
FIX = {"latitude": 54.4, "longitude": 10.2, "altitude": 12.5, "method": 1, "hdop": 1.2}
NORTHWARD = {"sog": 5.0, "cog": 0.0, "cogReference": "True"}


def later(s: float) -> MonoNs:
    return MonoNs(NOW + round(s * 1e9))


def payload(name: str, **fields: Any) -> bytes:
    """Return the payload as canboat's database encodes it."""
    return bytes(backend.DATABASE.encode(name, fields))


def decoded(name: str, source: int = 7, **fields: Any) -> NMEA2000Message:
    """Return the message for the encoders of the gateways' formats."""
    made = backend.decode(PGNS[name], payload(name, **fields), source, 255, 3, "si")
    made.add_data(source, 255, 3, datetime(2026, 8, 3, 4, 27, 20, 588000), None, False, b"")
    return made


def reader(simulated: bool = False) -> BusReader:
    return BusReader(ShipSensors(simulated))


def received(to: BusReader, name: str, at_s: float = 0.0, source: int = 7, **fields: Any) -> Samples:
    """Return the samples of one message that arrives as CAN frames."""
    data = payload(name, **fields)
    frames = backend.canboat.fast_packet_fragment(0, data) if backend.is_fast_pgn(PGNS[name]) else [data]
    can_id = backend.canboat.can_id_compose(3, PGNS[name], source, 255)
    return [sample for frame in frames for sample in to.arrived(can_id, frame, later(at_s))]


def test_each_message_gives_its_sample_with_its_sign() -> None:
    r = reader()
    [motion] = received(r, "attitude", roll=0.1, pitch=-0.02)
    assert (motion.sensor, motion.roll_rad, motion.pitch_rad) == ("src 7", pytest.approx(0.1), pytest.approx(-0.02))
    [heave] = received(r, "heave", heave=0.5)
    assert heave.heave_down_m == -0.5, "NMEA 2000 counts heave upward"
    [turn] = received(r, "rateOfTurn", rate=0.03)
    assert turn.turn_rad_s == pytest.approx(0.03)
    [way] = received(r, "cogSogRapidUpdate", sog=4.0, cog=math.pi / 2, cogReference="True")
    assert way.v_vessel_ned == pytest.approx([0.0, 4.0, 0.0], abs=1e-3)
    [fix] = received(r, "gnssPositionData", **FIX)
    assert fix.place.height_m == pytest.approx(12.5)
    assert math.degrees(fix.place.latitude_rad) == pytest.approx(54.4)
    assert fix.sigma_m == pytest.approx(3.0)
    [rapid] = received(r, "positionRapidUpdate", latitude=-54.4, longitude=-10.2)
    assert math.degrees(rapid.place.longitude_rad) == pytest.approx(-10.2)
    assert rapid.sigma_m == fix.sigma_m, "the same receiver has said how good its fix is"
    assert not r.refused


def test_a_magnetic_heading_waits_for_the_variation() -> None:
    r = reader()
    assert not received(r, "vesselHeading", heading=1.0, reference="Magnetic")
    assert r.refused == {"no_variation": 1}
    assert not received(r, "magneticVariation", variation=-0.2)
    [by_table] = received(r, "vesselHeading", heading=0.1, reference="Magnetic", deviation=0.02)
    assert by_table.heading_rad == pytest.approx(2.0 * math.pi - 0.08)
    [own] = received(r, "vesselHeading", heading=1.0, reference="Magnetic", variation=0.05)
    assert own.heading_rad == pytest.approx(1.05)
    [true] = received(r, "vesselHeading", heading=1.0, reference="True", variation=0.05)
    assert true.heading_rad == pytest.approx(1.0)
    assert true.sigma_heading_rad < own.sigma_heading_rad


def test_wind_is_over_the_ground_whatever_way_she_makes() -> None:
    r = reader()
    apparent = {"windSpeed": 5.0, "windAngle": 0.0, "reference": "Apparent"}
    assert not received(r, "windData", **apparent)
    received(r, "cogSogRapidUpdate", **NORTHWARD)
    received(r, "vesselHeading", heading=0.0, reference="True")
    [calm] = received(r, "windData", **apparent)
    assert calm.speed_m_s == pytest.approx(0.0, abs=1e-6), "what she makes herself"
    [abeam] = received(r, "windData", windSpeed=math.hypot(5.0, 3.0), windAngle=math.atan2(3.0, 5.0), reference="Apparent")
    assert (abeam.from_rad, abeam.speed_m_s) == (pytest.approx(math.pi / 2, abs=3e-3), pytest.approx(3.0, abs=2e-2))
    assert not received(r, "windData", at_s=3.0, **apparent), "her heading and way are old"
    [true] = received(r, "windData", windSpeed=7.0, windAngle=4.0, reference="True (ground referenced to North)")
    assert (true.from_rad, true.speed_m_s) == (pytest.approx(4.0), pytest.approx(7.0))
    assert not received(r, "windData", windSpeed=7.0, windAngle=4.0, reference="True (water referenced)")
    assert r.refused == {"no_way": 2, "not_over_ground": 1}


@pytest.mark.parametrize(
    ("name", "fields", "why"),
    [
        ("attitude", {}, "no_value"),
        ("heave", {}, "no_value"),
        ("heave", {"heave": 25.0}, "impossible"),
        ("attitude", {"roll": 1.2, "pitch": 0.0}, "impossible"),
        ("rateOfTurn", {"rate": 1.5}, "impossible"),
        ("vesselHeading", {"reference": "True"}, "no_value"),
        ("vesselHeading", {"heading": 1.0}, "no_reference"),
        ("cogSogRapidUpdate", {"sog": 60.0, "cog": 1.0, "cogReference": "True"}, "impossible"),
        ("cogSogRapidUpdate", {"sog": 5.0, "cogReference": "True"}, "no_value"),
        ("positionRapidUpdate", {"latitude": backend.canboat.Raw(950000000), "longitude": 1.0}, "impossible"),
        ("positionRapidUpdate", {"latitude": 5.0}, "no_value"),
        ("gnssPositionData", {**FIX, "method": 0}, "no_fix"),
        ("gnssPositionData", {**FIX, "method": 7}, "typed_in"),
        ("gnssPositionData", {**FIX, "method": 8}, "simulated"),
        ("windData", {"windSpeed": 5.0, "reference": "Apparent"}, "no_value"),
    ],
)  # fmt: skip
def test_what_has_no_value_or_none_of_a_ship_is_refused_by_name(name: str, fields: dict[str, Any], why: str) -> None:
    r = reader()
    assert not received(r, name, **fields)
    assert r.refused == {why: 1}


def test_a_receiver_without_a_fix_gives_no_rapid_place_either_and_a_rehearsal_takes_a_simulated_one() -> None:
    r = reader()
    received(r, "gnssPositionData", **{**FIX, "method": 0})
    assert not received(r, "positionRapidUpdate", at_s=1.0, latitude=54.4, longitude=10.2)
    assert received(r, "positionRapidUpdate", at_s=1.0, source=8, latitude=54.4, longitude=10.2), "another receiver has one"
    assert received(reader(simulated=True), "gnssPositionData", **{**FIX, "method": 8})


def test_two_sensors_are_two_and_two_receivers_are_not_mixed() -> None:
    r = reader()
    assert [received(r, "attitude", source=s, roll=0.1, pitch=0.0)[0].sensor for s in (27, 52)] == ["src 27", "src 52"]
    assert received(r, "positionRapidUpdate", source=3, latitude=54.4, longitude=10.2)
    assert not received(r, "positionRapidUpdate", source=4, latitude=54.5, longitude=10.2)
    assert received(r, "positionRapidUpdate", at_s=60.0, source=4, latitude=54.5, longitude=10.2), "the first one is silent"
    assert r.refused == {"other_receiver": 1}


def test_a_source_that_takes_another_s_place_is_said() -> None:
    said: list[str] = []
    to = BusReader(ShipSensors(choice=SourceChoice(said.append)))
    for k in range(40):
        label = "n2k.27" if k < 20 else "can0.27"
        to.line(json.dumps(delta(label, navigation__headingTrue=1.0)).encode(), later(0.5 * k))
    assert said == ["the ship's heading comes from can0.27 from now on: n2k.27 is silent"]


def claim(to: BusReader, name: int, source: int, at_s: float) -> None:
    assert to.arrived(backend.canboat.can_id_compose(6, 60928, source, 255), name.to_bytes(8, "little"), later(at_s)) == []


@pytest.mark.parametrize(("heard_s", "called"), [(None, "name"), (1.0, "name"), (60.0, "src")])
def test_devices_that_exchange_their_addresses_keep_their_names_and_it_is_said(heard_s, called, caplog) -> None:
    caplog.set_level("INFO")
    to, names = reader(), (0xC032820000A00001, 0xC08C8C0000B00002)

    def sensors(at_s: float, *sources: int) -> list[str]:
        return [received(to, "heave", at_s, source=source, heave=0.5)[0].sensor for source in sources]

    if heard_s is not None:
        assert sensors(0.0, 27, 35) == ["src 27", "src 35"]
    began = (heard_s or 0.0) + 0.1
    for name, source in zip(names, (27, 35), strict=True):
        claim(to, name, source, began)
    first = sensors(began + 0.1, 27, 35)
    assert first == ([f"{name:016x}" for name in names] if called == "name" else ["src 27", "src 35"])
    assert not any("moved" in text for text in caplog.messages)
    claim(to, names[0], 35, began + 1.0)
    assert sensors(began + 1.0, 27)[0] not in first, "who has her old address is not known yet"
    claim(to, names[1], 27, began + 1.1)
    claim(to, names[1], 254, began + 1.1)
    assert sensors(began + 1.2, 35, 27) == first
    assert [text for text in caplog.messages if "moved from address 27 to 35" in text and first[0] in text]
    claim(to, names[1], 40, began + 2.0)
    assert sensors(began + 2.1, 40) == first[1:]


def test_canboat_and_signal_k_say_who_a_device_is() -> None:
    to, said = reader(), {"Manufacturer Code": "Maretron", "Unique Number": 1234}
    sent = [{"pgn": 60928, "src": 27, "fields": said}, {"pgn": 127252, "src": 27, "fields": {"Heave": 0.5}}]
    assert [one.sensor for text in sent for one in to.line(json.dumps(text).encode(), NOW)] == ["Maretron 1234"]
    motions = []
    for label in ("n2k.27", "can0.35"):
        named = delta(label, environment__heave=0.5)
        named["updates"][0] |= {"source": {"canName": "c032820000a00001"}}
        motions += to.line(json.dumps(named).encode(), NOW)
    assert [one.sensor for one in motions] == ["c032820000a00001"] * 2


def test_of_two_rates_of_turn_the_one_that_comes_more_often_is_used() -> None:
    r, used = reader(), Counter[float]()
    for k in range(400):
        slow = received(r, "rateOfTurn", at_s=0.05 * k, source=52, rate=0.01) if k % 2 == 0 else []
        fast = received(r, "rateOfTurn", at_s=0.05 * k, source=27, rate=0.02)
        used.update(round(one.turn_rad_s, 3) for one in slow + fast)
    assert used[0.01] < 40, "the slow one was first"
    assert used[0.02] > 300


def test_a_cut_message_and_a_flood_are_refused() -> None:
    r = reader()
    can_id = backend.canboat.can_id_compose(3, 127257, 7, 255)
    whole = payload("attitude", roll=0.1, pitch=0.1)
    for end in range(7):
        assert not r.arrived(can_id, whole[:end], NOW), "the decoder alone reads a cut number as a small one"
    assert r.refused == {"too_short": 7}
    assert sum(len(received(r, "attitude", at_s=k / 1000.0, roll=0.1, pitch=0.0)) for k in range(1000)) < 700, "250 Hz, a burst"


def test_invented_sources_bar_no_real_one_and_push_none_out_that_reports_seldom() -> None:
    def heading(source: str, at_s: float) -> Samples:
        values = '[{"path":"navigation.headingTrue","value":1.0},{"path":"navigation.attitude","value":{"roll":0.1,"pitch":0.1}}]'
        return to.feed(f'{{"updates":[{{"$source":"{source}","values":{values}}}]}}\n'.encode(), later(at_s))

    sensors = ShipSensors()
    to = BusReader(sensors)
    assert heading("real.1", 0.0)
    for n in range(3000):  # ten seconds of invented names
        heading(f"junk.{n}", 0.003 * n)
    assert len(sensors.sources) <= 256
    assert to.refused["too_many_sources"] > 4000
    assert heading("real.1", 9.1), "it reports each nine seconds"
    assert [type(s) for s in heading("real.2", 10.0)] == [VesselMotion], "another one that begins"


def test_long_messages_come_together_whatever_is_lost_between() -> None:
    frames = [
        backend.canboat.fast_packet_fragment(3, payload("gnssPositionData", **{**FIX, "latitude": lat})) for lat in (10, 20)
    ]
    can_id = backend.canboat.can_id_compose(3, 129029, 7, 255)

    def latitudes(*come: tuple[float, bytes]) -> tuple[list[int], Counter[str]]:
        r = reader()
        made = [fix for at, frame in come for fix in r.arrived(can_id, frame, later(at))]
        return [round(math.degrees(fix.place.latitude_rad)) for fix in made], r.refused

    first, second = frames
    assert latitudes(*((0.01 * i, f) for i, f in enumerate(first))) == ([10], {})
    for lost in range(len(first)):
        come = [(0.01 * i, f) for i, f in enumerate(first) if i != lost] + [(1 + 0.01 * i, f) for i, f in enumerate(second)]
        found, refused = latitudes(*come)
        assert found == [20], f"without frame {lost}"
        assert sum(refused.values()) == (1 if lost else 0) or refused == {"torn": 1}
    mixed, refused = latitudes(
        *((0.01 * i, f) for i, f in enumerate(first[:3])), *((8 + 0.01 * i, f) for i, f in enumerate(second[1:]))
    )
    assert mixed == [], "a message of eight later has the same number"
    assert refused["torn"] >= 1


@pytest.mark.parametrize("form", ["n2k_ascii", "basic_string", "can_frame_ascii_raw", "candump2", "candump3", "pcdin", "pdgy"])
def test_the_lines_of_every_gateway_are_recognized(form: str) -> None:
    r = reader()
    encode = create_encoder(form, units="si").encode
    for message, kind in (
        (decoded("attitude", roll=0.1, pitch=-0.02), VesselMotion),
        (decoded("gnssPositionData", **FIX), GeoFix),
    ):
        lines = encode(message)
        made = r.feed("".join(f"{line}\r\n" for line in ([lines] if isinstance(lines, str) else lines)).encode(), NOW)
        assert [type(sample) for sample in made] == [kind]
    assert not r.refused


def ngt(name: str, **fields: Any) -> bytes:
    """Return a message as an NGT-1 sends it: priority, PGN, destination, source, time, length, payload."""
    data = payload(name, **fields)
    body = bytes([3, *PGNS[name].to_bytes(3, "little"), 255, 27, 0, 0, 0, 0, len(data)]) + data
    message = bytes([0x93, len(body)]) + body
    return bytes(bdtp_wrap(message + bytes([-sum(message) & 0xFF])))


@pytest.mark.parametrize("size", [1, 7, 500])
def test_the_binary_messages_of_an_ngt_are_recognized_in_any_pieces(size: int) -> None:
    r, data = reader(), b"end of one\x10\x03" + ngt("attitude", roll=0.1) + ngt("gnssPositionData", **FIX)
    made = [sample for at in range(0, len(data), size) for sample in r.feed(data[at : at + size], NOW)]
    assert [type(sample) for sample in made] == [VesselMotion, GeoFix]
    assert made[0].sensor == "src 27"


def canboat_json(units: str | None, heading: float, **fields: Any) -> Iterator[bytes]:
    if units:
        yield json.dumps({"version": "8.0.0", "units": units, "showLookupValues": True}).encode()
    reference = {"value": 0, "name": "True"}
    for _ in range(6):
        yield json.dumps(
            {
                "timestamp": "2026-08-03T04:27:20.588Z",
                "src": 7,
                "pgn": 127250,
                "fields": {"Heading": heading, "Reference": reference},
            }
        ).encode()
    yield json.dumps({"timestamp": "2026-08-03T04:27:20.588Z", "src": 7, "pgn": 127257, "fields": fields}).encode()


@pytest.mark.parametrize(
    ("units", "heading", "roll"),
    [("si", 0.1, 0.1), ("std", 5.7, 5.7), (None, 345.9, 5.7), (None, 1.2345, 0.1)],
)  # fmt: skip
def test_canboats_json_is_read_in_its_units(units: str | None, heading: float, roll: float) -> None:
    r = reader()
    made = [sample for line in canboat_json(units, heading, Roll=roll, Pitch=None) for sample in r.line(line, NOW)]
    assert made[-1].roll_rad == pytest.approx(0.1, abs=1e-3)


def test_canboats_json_whose_units_nothing_shows_is_refused() -> None:
    r = reader()
    assert not [sample for line in canboat_json(None, 0.5, Roll=0.4) for sample in r.line(line, NOW)]
    assert r.refused == {"no_units": 7}


def test_a_server_whose_sources_have_clocks_of_their_own_is_stamped_by_each() -> None:
    r, late = reader(), {"can0.27": 0.0, "gps": 41.0}
    for k in range(100):
        for n, (source, by_s) in enumerate(late.items()):
            clock = (datetime(2026, 8, 3, 4, 27) + timedelta(seconds=0.1 * k - by_s)).isoformat(timespec="milliseconds") + "Z"
            values = [{"path": "navigation.attitude", "value": {"roll": 0.1, "pitch": 0.0}}]
            one = {"updates": [{"$source": source, "timestamp": clock, "values": values}]}
            [motion] = r.line(json.dumps(one).encode(), later(0.1 * k + 0.01 * n))
            assert abs(motion.stamp.measured_at - later(0.1 * k)) < 0.1e9, source


def test_times_of_the_gateway_take_the_jitter_of_a_radio_link_away() -> None:
    r, encode = reader(), create_encoder("can_frame_ascii_raw", units="si").encode
    rng, errors = np.random.default_rng(11), []
    for k in range(200):
        message = decoded("attitude", roll=0.1)
        message.timestamp += timedelta(seconds=0.1 * k)
        [motion] = r.line(encode(message).encode(), later(0.1 * k + float(rng.exponential(0.04))))
        errors.append((motion.stamp.measured_at - later(0.1 * k)) / 1e9)
    assert np.std(errors[50:]) < 0.01


@given(st.lists(st.one_of(st.binary(max_size=80), st.text(max_size=80).map(str.encode)), max_size=20), st.booleans())
def test_garbage_is_counted_and_never_raises(pieces: list[bytes], binary: bool) -> None:
    r = reader()
    r.feed(b"\x10\x02" if binary else b"\n", NOW)
    for n, piece in enumerate(pieces):
        assert all(isinstance(s, VesselMotion | VesselReport | GeoFix | VesselWind) for s in r.feed(piece, later(n)))
        r.line(piece, later(n))
    for n, piece in enumerate(pieces):
        for pgn in (127250, 129029, 130306, int.from_bytes(piece[:3], "little") & 0x3FFFF):
            r.arrived(backend.canboat.can_id_compose(3, pgn, 5, 255), piece, later(n))


@given(st.recursive(st.none() | st.floats() | st.text(max_size=8), lambda x: st.lists(x, max_size=3) | st.dictionaries(
    st.sampled_from(["roll", "pitch", "latitude", "longitude", "path", "value", "values", "source", "src", "fields", "Roll"]), x,
    max_size=4)))  # fmt: skip
def test_json_of_any_shape_is_counted_and_never_raises(value: Any) -> None:
    r = reader()
    paths = [{"path": path, "value": value} for path in ("navigation.attitude", "navigation.position")]
    for outer in (
        {"updates": value},
        {"updates": [{"values": value}]},
        {"updates": [{"$source": "x", "values": paths}]},
        {"pgn": value, "fields": value},
        {"pgn": 127257, "src": 1, "fields": value},
    ):
        r.line(json.dumps(outer).encode(), NOW)


@pytest.mark.skipif(not BOAT.is_dir(), reason="the recorded boat is not here")
@pytest.mark.parametrize(
    ("name", "n", "roll_27", "heave_27"), [("furuno-130842", 2408, 0.0445, 0.714), ("furuno-130842-accel", 3379, 0.0258, 0.718)]
)  # fmt: skip
def test_a_recorded_boat_is_read_whole(name: str, n: int, roll_27: float, heave_27: float) -> None:
    r, found = reader(), dict[tuple[str, str], list[float]]()
    for k, line in enumerate((BOAT / f"{name}.raw").read_bytes().splitlines()):
        for sample in r.line(line, later(k / 79.0)):
            for part in ("roll_rad", "heave_down_m") if isinstance(sample, VesselMotion) else ():
                if (number := getattr(sample, part)) is not None:
                    found.setdefault((sample.sensor, part), []).append(number)
    assert {key: len(numbers) for key, numbers in found.items() if "27" in key[0]} == dict.fromkeys(
        (("src 27", "roll_rad"), ("src 27", "heave_down_m")), n
    )
    assert np.std(found["src 27", "roll_rad"]) == pytest.approx(roll_27, abs=1e-3)
    assert np.std(found["src 27", "heave_down_m"]) == pytest.approx(heave_27, abs=1e-3)
    assert np.std(found["src 52", "roll_rad"]) < 0.5 * roll_27 + 1e-3, "the two sets do not agree"
    assert ("src 52", "heave_down_m") not in found
    assert not [why for why in r.refused if not why.startswith("other_")]


@pytest.mark.skipif(not BOAT.is_dir(), reason="the recorded boat is not here")
@pytest.mark.parametrize("name", ["furuno-130842", "furuno-130842-accel"])
def test_a_replay_of_the_boat_names_the_heave_that_is_none(name: str, tmp_path, capsys) -> None:
    found = imported(tmp_path, begun(tmp_path, BOAT / f"{name}.raw"), capsys=capsys)
    assert "its heave wanders" in found["src 27"]["fault"]
    assert found["src 52"]["fault"] is None
    assert found["src 27"]["rate_hz"] == pytest.approx(10.0, rel=0.01)
    assert found["rate of turn"]["rate_hz"] == pytest.approx(20.0, rel=0.01)


@pytest.mark.parametrize("form", ["basic_string", "can_frame_ascii_raw", "candump3"])
def test_a_log_of_each_kind_is_imported(form: str, tmp_path, capsys) -> None:
    encode, rows = create_encoder(form, units="si").encode, ["# a note", "noise"]
    for k in range(60):
        message = decoded("attitude", roll=0.1 + 0.01 * (k % 3))
        message.timestamp += timedelta(seconds=0.1 * k)
        rows.append(encode(message))
        place = decoded("positionRapidUpdate", latitude=54.4, longitude=10.2 + 1e-5 * k)
        place.timestamp = message.timestamp
        rows.append(encode(place))
    log = tmp_path / "boat.log"
    log.write_text("\n".join(rows))
    found = imported(tmp_path, log, capsys=capsys)
    for sensor in ("src 7", "place"):
        assert (found[sensor]["count"], found[sensor]["rate_hz"]) == (60, pytest.approx(10.0, rel=0.02))
        assert found[sensor]["fault"] is None


def test_two_logs_of_one_network_keep_the_time_between_them(tmp_path, capsys) -> None:
    lines = [f"2026-11-03T10:00:{second:02d}.000Z,3,127257,27,255,8,00,ff,7f,{second:02x},00,91,00,ff" for second in range(60)]
    logs = [tmp_path / "early.raw", tmp_path / "late.raw"]
    for log, part in zip(logs, (lines[:20], lines[40:]), strict=True):
        log.write_text("\n".join(part))
    found = imported(tmp_path, *reversed(logs), capsys=capsys)
    assert (found["src 27"]["count"], found["src 27"]["longest_gap_s"]) == (40, pytest.approx(21.0, abs=0.1))


class Ship:
    """A part that listens, and what came."""

    def __init__(self, bus: str) -> None:
        self.reports: Line[Sample] = Line(64)
        self.part = BusPart(bus, False, SourceChoice(), self.reports, SystemClock())
        self.failure: Exception | None = None

    async def run(self) -> None:
        try:
            await self.part.run()
        except Recoverable as why:
            self.failure = why

    def took(self, kind: str) -> Callable[[], bool]:
        return lambda: self.part.counted().get(f"taken_{kind}", 0) > 0


@asynccontextmanager
async def bus_read(bus: str) -> AsyncIterator[Ship]:
    ship = Ship(bus)
    task = asyncio.get_running_loop().create_task(ship.run())
    try:
        yield ship
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_a_gateway_is_read_by_tcp_until_it_closes() -> None:
    line = create_encoder("can_frame_ascii_raw", units="si").encode(decoded("attitude", roll=0.1)).encode() + b"\r\n"
    close = asyncio.Event()

    async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(line[:9])
        await writer.drain()
        writer.write(line[9:] + b"noise\r\n")
        await close.wait()
        writer.close()

    async with answering(serve) as port, bus_read(f"tcp://127.0.0.1:{port}") as ship:
        await until(ship.took("attitude"))
        await until(lambda: ship.part.counted().get("refused_malformed") == 1)
        assert ship.part.counted()["used src 7 attitude"] == 1
        close.set()
        await until(lambda: ship.failure)
        assert str(ship.failure).startswith(f"vessel.bus tcp://127.0.0.1:{port}: the other side closed")


async def test_an_ngt_at_a_serial_port_is_asked_for_its_messages_and_read() -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    asked = bytearray()

    def is_asked() -> bool:
        with suppress(BlockingIOError):
            asked.extend(os.read(ours, 64))
        return asked.endswith(b"\x10\x03")

    try:
        async with bus_read(f"serial://{os.ttyname(theirs)}:115200") as ship:
            await until(is_asked)
            os.write(ours, ngt("attitude", roll=0.1))
            await until(ship.took("attitude"))
    finally:
        os.close(ours)
        os.close(theirs)


no_vcan = pytest.mark.skipif(not Path("/sys/class/net/vcan0").exists(), reason="there is no vcan0 (ip link add vcan0 type vcan)")


@pytest.mark.parametrize(
    ("interface", "channel"), [("virtual", "ship"), pytest.param("socketcan", "vcan0", marks=no_vcan)], ids=["virtual", "kernel"]
)
async def test_frames_of_a_can_interface_are_read(interface: str, channel: str) -> None:
    asked = list[can.Message]()
    with can.Bus(interface=interface, channel=channel) as bus:
        async with bus_read(f"can://{interface}:{channel}") as ship:

            def send() -> bool:
                asked.extend(iter(lambda: bus.recv(0.0), None))
                for message in create_encoder("python_can", units="si").encode(decoded("gnssPositionData", **FIX)):
                    bus.send(message)
                bus.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"12345678"))
                return ship.took("gnss")()

            await until(send)
        [fix, *_] = [await ship.reports.get()]
    assert isinstance(fix, GeoFix)
    asking = [(*backend.canboat.can_id_decompose(m.arbitration_id)[1:], bytes(m.data)) for m in asked if m.is_extended_id]
    assert asking.count((59904, 254, 255, b"\x00\xee\x00")) == len(asking) == 1, "for the NAMEs, once, and nothing else is sent"


async def test_an_interface_that_is_not_there_is_one_line_that_says_so(caplog: pytest.LogCaptureFixture) -> None:
    async with bus_read("can://can97") as ship:
        await until(lambda: ship.failure)
    assert not caplog.records, "the service logs an outage, and a library must not log each attempt"
    assert str(ship.failure).startswith("vessel.bus can://can97: ")
    assert "\n" not in str(ship.failure)


def delta(source: str, context: str = "vessels.self", **values: Any) -> dict[str, Any]:
    paths = [{"path": path.replace("__", "."), "value": value} for path, value in values.items()]
    return {"context": context, "updates": [{"$source": source, "timestamp": "2026-08-03T04:27:20.588Z", "values": paths}]}


async def test_a_signal_k_server_is_read_by_websocket() -> None:
    own, place = "urn:mrn:imo:mmsi:211234560", {"latitude": 54.4, "longitude": 10.2}
    deltas = [
        {"name": "signalk-server", "version": "2.8.0", "self": f"vessels.{own}", "roles": ["main"]},
        delta("can0.27", navigation__attitude={"roll": 0.1, "pitch": -0.02, "yaw": None}, environment__heave=0.4),
        delta("gps", f"vessels.{own}", navigation__position=place, navigation__gnss__methodQuality="RTK fixed integer"),
        delta("gps", navigation__courseOverGroundTrue=math.pi / 2),
        delta("gps", navigation__speedOverGround=4.0),
        delta("compass", navigation__headingTrue=1.5, navigation__rateOfTurn=0.02),
        delta("wind", environment__wind__speedOverGround=6.0, environment__wind__directionTrue=2.0),
        delta("ais", "vessels.urn:mrn:imo:mmsi:999", navigation__position=place),
    ]

    async def stream(request: web.Request) -> web.WebSocketResponse:
        assert request.query["subscribe"] == "self"
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        for one in deltas:
            await socket.send_json(one)
        await asyncio.sleep(30.0)
        return socket

    app, port = web.Application(), free_port()
    app.router.add_get("/signalk/v1/stream", stream)
    runner = web.AppRunner(app, shutdown_timeout=0.1)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", port).start()
    try:
        async with bus_read(f"signalk://127.0.0.1:{port}") as ship:
            await until(lambda: ship.part.counted().get("refused_other_ship") == 1)
            got = [await ship.reports.get() for _ in range(7)]
    finally:
        await runner.cleanup()
    roll, heave, fix, way, turn, heading, wind = got
    assert (roll.sensor, roll.roll_rad, heave.heave_down_m) == ("can0.27", 0.1, -0.4)
    assert fix.sigma_m < 1.0
    assert way.v_vessel_ned == pytest.approx([0.0, 4.0, 0.0], abs=1e-9)
    assert (turn.turn_rad_s, heading.heading_rad, wind.speed_m_s) == (0.02, 1.5, 6.0)


async def test_a_signal_k_server_that_is_not_there_is_a_fault_of_the_outside() -> None:
    async with bus_read(f"signalk://127.0.0.1:{free_port()}") as ship:
        await until(lambda: ship.failure)
    assert "vessel.bus signalk://127.0.0.1" in str(ship.failure)


def test_without_the_extra_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.extras.find_spec", lambda name: None if name in ("nmea2000", "can", "pyubx2") else name)
    sim = load("sim")
    over = {bus: replace(sim, vessel=replace(sim.vessel, bus=bus)) for bus in ("can://can0", "signalk://127.0.0.1:3000")}
    with pytest.raises(BadInput, match=r"can0 needs nmea2000, which is not installed: install the extra decklander\[ship\]"):
        check_installed(over["can://can0"])
    check_installed(over["signalk://127.0.0.1:3000"])
    with pytest.raises(BadInput, match=r"rtk\.source 127\.0\.0\.1:5000 needs pyubx2, which is not installed"):
        check_installed(replace(sim, rtk=replace(sim.of(RtkOptions), source="127.0.0.1:5000")))


@pytest.mark.parametrize("url", ["can0", "can://", "udp://1.2.3.4:5", "tcp://host", "signalk://host:99999", "serial:///dev/x:1"])
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match="bus must be can://"):
        parse_bus(url)
