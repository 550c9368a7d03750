import json
import math
import struct
from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ardrone import at
from drivers.ardrone import navdata as nd
from drivers.ardrone.counters import Counters, Refusal
from drivers.ardrone.navdata_channel import AS_REPORTED, NavdataChannel, NavdataSampler
from drivers.ardrone.options import ArDroneOptions
from drivers.clock import SystemClock
from estimator.contracts.geometry import height_of_pressure_m, pressure_of_height_pa
from estimator.contracts.samples import UNKNOWN_VAR, Attitude, Baro, BodyVelocity, GeoFix, Imu, Range, Sample, VehicleStatus
from estimator.contracts.time import MonoNs, Stamp
from tests.drivers.captures import CAPTURES, needs_captures

STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "synced")
DEMO: dict[str, Any] = {
    "ctrl_state": nd.ControlState.FLYING.word, "battery_percent": 42, "theta_mdeg": 2000.0, "phi_mdeg": -3000.0,
    "psi_mdeg": 90000.0, "altitude_mm": 1500, "vx_mm_s": 410.0, "vy_mm_s": -230.0,
}  # fmt: skip
IMU = {"ax_mg": 100.0, "ay_mg": 200.0, "az_mg": -1000.0, "wx_deg_s": 10.0, "wy_deg_s": -20.0, "wz_deg_s": 30.0}
FLYING = nd.NavdataState.FLYING
S = TypeVar("S")


def the(kind: type[S], samples: list[Sample]) -> S:
    (found,) = [s for s in samples if isinstance(s, kind)]
    return found


def samples_of(state: int = 0, options: ArDroneOptions = AS_REPORTED, **fields: Any) -> list[Sample]:
    return NavdataSampler(options).samples(nd.Navdata.of(state, 1, **fields), STAMP)


def datagram(*bodies: tuple[int, bytes], state: int = 1) -> bytes:
    """Return a datagram of any option bodies with its checksum."""
    data = struct.pack("<IIII", nd.MAGIC, state, 2, 1)
    data += b"".join(struct.pack("<HH", tag, len(body) + 4) + body for tag, body in bodies)
    return data + struct.pack("<HHI", nd.CHECKSUM_TAG, 8, sum(data) & 0xFFFFFFFF)


def numbers(value: Any) -> Iterator[Any]:
    if isinstance(value, list):
        yield from value
    else:
        yield value


@needs_captures
def test_the_layouts_are_those_of_a_captured_datagram() -> None:
    data = (CAPTURES / "navdata_full_gps.bin").read_bytes()
    expected = json.loads((CAPTURES / "navdata_full_gps.expected.json").read_text())
    navdata = nd.decode(data)
    assert (navdata.state, navdata.sequence, navdata.skipped) == (expected["state"], expected["sequence"], ())
    assert navdata.options == tuple(range(28))
    for label, values in expected["options"].items():
        tag, body = int(label.split(":")[0]), values["_offset"] + 4
        if tag == nd.CHECKSUM_TAG:
            continue
        layout = nd.LAYOUTS[tag]
        assert layout.body.size == values["_size"] - 4
        wanted = iter([n for name, value in values.items() if name[0] != "_" for n in numbers(value)])
        for name, (offset, letter) in layout.fields.items():
            (ours,) = struct.unpack_from("<" + letter, data, body + offset)
            assert ours in wanted, (label, name)  # this takes the numbers before it too: the order is that of the wire


@needs_captures
def test_a_captured_datagram_cut_or_changed_anywhere_is_refused() -> None:
    data = (CAPTURES / "navdata_full_gps.bin").read_bytes()
    for place in range(len(data)):
        assert isinstance(nd.decode(data[:place]), Refusal)
        changed = bytearray(data)
        changed[place] ^= 0x10
        assert isinstance(nd.decode(bytes(changed)), Refusal)


@given(st.sets(st.sampled_from(list(nd.LAYOUTS))), st.randoms(use_true_random=False))
def test_what_is_read_comes_back_whatever_options_there_are(tags, rng):
    read = [name for tag in tags for name in nd.LAYOUTS[tag].fields if name in nd.Navdata.__struct_fields__]
    values = {name: n for n, name in enumerate(rng.sample(read, len(read)), 1)}
    navdata = nd.Navdata(7, 9, tuple(sorted(tags)), **values)
    assert nd.decode(nd.encode(navdata)) == navdata


def test_unknown_short_repeated_and_long_options_cost_nothing_else() -> None:
    pressure = struct.pack("<ihii", 1, 2, 3, 4)
    old_gps = (27, bytes(8))
    decoded = nd.decode(datagram((99, b"abc"), (9, b"xy"), (21, pressure), (1, bytes(4) + b"new"), old_gps, (21, pressure)))
    assert (decoded.options, decoded.skipped, decoded.pressure_pa, decoded.clock) == ((21, 1), (99, 9, 21), 4, 0)


def test_reasons_of_refusal() -> None:
    good = datagram((17, bytes(4)))
    assert nd.decode(b"") is Refusal.TOO_SHORT
    assert nd.decode(b"x" + good[1:]) is Refusal.BAD_MAGIC
    assert nd.decode(good[:-1]) is Refusal.TORN
    assert nd.decode(good + b"\0") is Refusal.TORN
    assert nd.decode(good[:-1] + b"\x7f") is Refusal.BAD_CHECKSUM


def test_time_wraps_and_an_unknown_control_state_is_none() -> None:
    assert nd.Navdata.of(0, 1, clock=nd.clock_of_us(2049_000_001)).time_us == 1_000_001
    assert nd.Navdata.of(0, 1, ctrl_state=nd.ControlState.LANDING.word | 3).control_state is nd.ControlState.LANDING
    assert nd.Navdata.of(0, 1, ctrl_state=77 << 16).control_state is None


@settings(max_examples=300)
@given(st.lists(st.tuples(st.integers(0, 30), st.binary(max_size=230)), max_size=8), st.integers(0, 2**32 - 1), st.binary())
def test_any_bytes_end_in_a_result_and_any_bodies_become_samples_or_nothing(bodies, state, garbage):
    assert isinstance(nd.decode(garbage), nd.Navdata | Refusal)
    navdata = nd.decode(datagram(*bodies, state=state))
    assert isinstance(navdata, nd.Navdata)
    sampler = NavdataSampler()
    assert len(sampler.samples(navdata, STAMP)) >= len(sampler.samples(navdata, STAMP))


@settings(max_examples=300)
@given(
    st.lists(st.tuples(st.sampled_from([0, 1, 2, 3, 9, 10, 21, 27, 77]), st.binary(max_size=230)), max_size=6),
    st.lists(st.tuples(st.integers(0, 2000), st.integers(1, 255)), max_size=3),
)
def test_a_datagram_of_a_known_outline_is_decoded_as_one_of_a_new_one(bodies, damage):
    """The second of two datagrams of one size may be as the first, be damaged anywhere, or have other headers."""
    good = datagram(*bodies)
    damaged = bytearray(good)
    for place, bits in damage:
        damaged[place % len(damaged)] ^= bits
    for one in (good, bytes(damaged), bytes(damaged[:-8]) + struct.pack("<HHI", nd.CHECKSUM_TAG, 8, sum(damaged[:-8]))):
        nd._outlines.clear()
        as_new = repr(nd.decode(one))
        nd._outlines.clear()
        nd.decode(good)
        assert list(nd._outlines) == [len(good)]
        assert repr(nd.decode(one)) == as_new


@needs_captures
def test_the_captured_drone_stands_with_its_nose_up() -> None:
    navdata = nd.decode((CAPTURES / "navdata_full_gps.bin").read_bytes())
    assert isinstance(navdata, nd.Navdata)
    samples = NavdataSampler().samples(navdata, STAMP)
    assert [type(s) for s in samples] == [Imu, Attitude, BodyVelocity, Range, Baro, GeoFix, VehicleStatus]
    imu, attitude = the(Imu, samples), the(Attitude, samples)
    np.testing.assert_allclose(imu.f_body, np.array([80.297, -33.3186, -942.528]) * 9.80665e-3, rtol=1e-4)
    np.testing.assert_allclose(imu.w_body, np.radians([-0.112365, 0.0687213, 0.0620099]), rtol=1e-4)
    assert np.degrees(attitude.R_ned_body.rpy_rad) == pytest.approx((0.550, 2.974, 1.933), abs=1e-3)
    # What the accelerometer says of roll and pitch has the same signs as the attitude: both are forward-right-down.
    assert math.degrees(math.asin(imu.f_body[0] / 9.3)) == pytest.approx(4.866, abs=0.1)
    assert math.degrees(math.asin(-imu.f_body[1] / 9.3)) == pytest.approx(2.024, abs=0.1)
    assert the(Range, samples).range_m == pytest.approx(0.243)
    fix, status = the(GeoFix, samples), the(VehicleStatus, samples)
    assert (fix.whose, fix.sigma_m) == ("vehicle", 2.5)
    assert np.degrees([fix.place.latitude_rad, fix.place.longitude_rad]) == pytest.approx([34.0905, -118.2767], abs=1e-4)
    assert fix.place.height_m == pytest.approx(122.64)
    assert (status.flying, status.mode, status.battery_fraction) == (False, "landed", 0.5)
    assert (status.emergency, status.link_ok) == (False, False)
    assert navdata.time_us == 362_979_125


def test_units_and_signs_of_everything_in_flight() -> None:
    samples = samples_of(FLYING, **DEMO, **IMU, altitude_raw_mm=1400, pressure_pa=101325)
    np.testing.assert_allclose(the(Imu, samples).f_body, [0.980665, 1.96133, -9.80665])
    np.testing.assert_allclose(the(Imu, samples).w_body, np.radians([10.0, -20.0, 30.0]))
    np.testing.assert_allclose(the(Attitude, samples).R_ned_body.rpy_rad, np.radians([-3.0, 2.0, 90.0]), atol=1e-9)
    velocity = the(BodyVelocity, samples)
    np.testing.assert_allclose(velocity.v_level, [0.41, -0.23, 0.0])
    assert velocity.cov_level[2, 2] == UNKNOWN_VAR
    assert math.sqrt(velocity.cov_level[0, 0]) >= 0.2 * math.hypot(0.41, 0.23), "an under-reading of a fifth is within a sigma"
    scaled = the(BodyVelocity, samples_of(options=ArDroneOptions(velocity_scale=0.8), **DEMO))
    np.testing.assert_allclose(scaled.v_level[:2], velocity.v_level[:2] / 0.8)
    assert scaled.cov_level[0, 0] < velocity.cov_level[0, 0]
    assert the(Range, samples).range_m == pytest.approx(1.4)
    assert the(Baro, samples).height_m == pytest.approx(0.0, abs=1e-6)
    status = the(VehicleStatus, samples)
    assert (status.flying, status.mode, status.battery_fraction, status.link_ok) == (True, "flying", 0.42, True)
    assert all(s.stamp is STAMP for s in samples)
    faults = the(VehicleStatus, samples_of(nd.NavdataState.EMERGENCY | nd.NavdataState.COM_WATCHDOG))
    assert (faults.emergency, faults.link_ok, faults.mode, faults.battery_fraction) == (True, False, "unknown", None)


def test_demo_mode_has_no_imu_and_its_range_is_along_the_body() -> None:
    samples = samples_of(**DEMO | {"theta_mdeg": 20000.0, "phi_mdeg": 0.0, "altitude_mm": 1000})
    assert not [s for s in samples if isinstance(s, Imu)]
    assert the(Range, samples).range_m == pytest.approx(1.0 / math.cos(math.radians(20.0)))


GPS: dict[str, Any] = {
    "lat_deg": 54.4, "lon_deg": 10.2, "elevation_m": 5.0, "hdop": 2.0, "data_available": 1, "nb_satellites": 7, "gps_plugged": 1
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "known", "wrong", "state"),
    [
        (Range, DEMO | {"altitude_raw_mm": 900}, {"altitude_raw_mm": 0}, 0),
        (Range, DEMO | {"altitude_raw_mm": 900}, {}, nd.NavdataState.ULTRASOUND_DEAF),
        (Range, DEMO, {"altitude_mm": 0}, 0),
        (Attitude, DEMO, {"psi_mdeg": math.nan}, 0),
        (BodyVelocity, DEMO, {"vy_mm_s": math.inf}, 0),
        (Imu, IMU, {"ay_mg": math.nan}, 0),
        (Baro, {"pressure_pa": 100}, {"pressure_pa": 0}, 0),
        (GeoFix, GPS, {"gps_plugged": 0}, 0),
        (GeoFix, GPS, {"data_available": 0}, 0),
        (GeoFix, GPS, {"nb_satellites": 4}, 0),
        (GeoFix, GPS, {"lat_deg": math.nan}, 0),
        (GeoFix, GPS, {"lat_deg": 95.0}, 0),
        (GeoFix, GPS, {"hdop": 0.0}, 0),
        (GeoFix, GPS, {"lat_deg": 0.0, "lon_deg": 0.0}, 0),
    ],
)
def test_what_is_not_known_is_left_out(kind: type[Any], known: dict[str, Any], wrong: dict[str, Any], state: int) -> None:
    assert [s for s in samples_of(**known) if isinstance(s, kind)]
    assert not [s for s in samples_of(state, **known | wrong) if isinstance(s, kind)]


def test_a_place_whose_height_cannot_be_is_one_without_a_height() -> None:
    assert the(GeoFix, samples_of(**GPS | {"elevation_m": math.inf})).place.height_m is None


def test_repeats_of_slow_sensors_are_left_out() -> None:
    sampler = NavdataSampler(repeat_s=0.1)
    given: dict[type[Any], list[int]] = {Range: [], Baro: [], VehicleStatus: [], Imu: []}
    for k in range(40):  # 200 Hz; ultrasound again every 40 ms, barometer every 10 ms
        state = FLYING | (nd.NavdataState.COMMAND_ACK if k % 2 else 0)
        slow = {"nb_echo": k // 8, "sum_echo": 0, "altitude_raw_mm": 900, "up": k // 2, "pressure_pa": 100000}
        at = MonoNs(5_000_000 * k)
        for sample in sampler.samples(nd.Navdata.of(state, 1, **DEMO, **IMU, **slow), Stamp(at, at, 0.001, "synced")):
            if type(sample) in given:
                given[type(sample)].append(k)
    assert given[Range] == [0, 8, 16, 24, 32]
    assert given[Baro] == list(range(0, 40, 2))
    assert given[VehicleStatus] == [0, 20]
    assert len(given[Imu]) == 40


@pytest.mark.parametrize("height_m", [-300.0, 0.0, 12.5, 3000.0])
def test_pressure_and_height_are_inverses(height_m: float) -> None:
    assert height_of_pressure_m(pressure_of_height_pa(height_m)) == pytest.approx(height_m, abs=1e-6)
    assert height_of_pressure_m(100129.0) == pytest.approx(100.0, abs=0.5)  # ISO 2533: 1001.29 hPa at 100 m


class Ear:
    """A channel without a socket: datagrams go in by hand."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.sequences: list[int] = []
        self.restarts = 0
        self.counters = Counters()
        self.channel = NavdataChannel(ArDroneOptions(), SystemClock(), self.counters, self._received, self._restarted)

    def _received(self, navdata: nd.Navdata, samples: list[Sample], received_at: MonoNs) -> None:
        self.sequences.append(navdata.sequence)
        self.samples += samples

    def _restarted(self) -> None:
        self.restarts += 1

    def hears(self, sequence: int, drone_ms: int | None, heard_ms: int) -> None:
        clock = {} if drone_ms is None else {"clock": nd.clock_of_us(drone_ms * 1000)}
        self.channel.take(nd.encode(nd.Navdata.of(0, sequence, **DEMO, **clock)), MonoNs(heard_ms * 1_000_000))


def test_overtaken_and_doubled_datagrams_are_refused() -> None:
    ear = Ear()
    for k, sequence in enumerate([10, 11, 14, 12, 14, 13, 15]):
        ear.hears(sequence, 5 * sequence, 1000 + 5 * k)
    assert ear.sequences == [10, 11, 14, 15]
    assert ear.restarts == 0


@pytest.mark.parametrize(("last", "again"), [(500, 1), (500, 3), (20, 1)])
def test_a_sequence_that_begins_again_is_a_restart(last: int, again: int) -> None:
    ear = Ear()
    ear.hears(last, 60_000, 100_000)
    ear.hears(again, 59_800, 100_100)  # a small step back of the clock: no restart to be seen in the clock alone
    assert ear.sequences == [last, again]
    assert (ear.counters.navdata_restarts, ear.restarts) == (1, 1)
    stamp = ear.samples[-1].stamp
    assert stamp.received_at - stamp.measured_at < 5_000_000, "the new clock is not read by the old map"


def test_stamps_without_a_clock_and_a_bootstrap_without_samples() -> None:
    ear = Ear()
    ear.channel.take(nd.encode(nd.Navdata(nd.NavdataState.NAVDATA_BOOTSTRAP, 1)), MonoNs(5))
    assert (ear.sequences, ear.samples, ear.channel.received_at) == ([1], [], 5)
    ear.hears(2, None, 1000)
    stamp = ear.samples[0].stamp
    assert (stamp.source, stamp.sigma_s) == ("arrival", ArDroneOptions().arrival_sigma_s)
    assert stamp.measured_at < stamp.received_at


f32 = st.floats(allow_nan=False, allow_infinity=False, width=32)
i32 = st.integers(-(2**31), 2**32 - 1)
text = st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters='"'), max_size=30)
commands = st.one_of(
    st.builds(at.Ref, i32), st.builds(at.Pcmd, i32, f32, f32, f32, f32), st.builds(at.PcmdMag, i32, f32, f32, f32, f32, f32, f32),
    st.just(at.Ftrim()), st.builds(at.Calib, i32), st.builds(at.Config, text, text), st.builds(at.ConfigIds, text, text, text),
    st.builds(at.Ctrl, i32, st.none() | i32), st.just(at.ComWdg()), st.builds(at.Led, i32, f32, i32),
    st.builds(at.Pmode, i32), st.builds(at.Misc, i32, i32, i32, i32), st.builds(at.Anim, i32, i32),
)  # fmt: skip
sequences = st.integers(0, 2**32 - 1)


@needs_captures
def test_a_real_session_parses_and_encodes_to_its_own_bytes() -> None:
    log = (CAPTURES / "at_commands_takeoff_land_ardrone1.txt").read_bytes()
    results = at.decode(log)
    assert len(results) == 609
    assert [r for r in results if isinstance(r, Refusal)] == []
    encoded = b"".join(at.encode(*r) for r in results if not isinstance(r, Refusal))
    assert encoded.replace(b"\r", b"\n") == log
    refs = [c for r in results if not isinstance(r, Refusal) for c in r[1:] if isinstance(c, at.Ref)]
    assert any(c.take_off for c in refs)
    assert not refs[0].take_off


@pytest.mark.parametrize(
    ("command", "line"),
    [
        (at.Ref(at.REF_BASE), b"AT*REF=7,290717696\r"),
        (at.Ref(at.REF_BASE | at.REF_TAKE_OFF), b"AT*REF=7,290718208\r"),
        (at.Ref(at.REF_BASE | at.REF_EMERGENCY), b"AT*REF=7,290717952\r"),
        (at.Pcmd(1, -0.8, 0.05, 0.0, -0.0), b"AT*PCMD=7,1,-1085485875,1028443341,0,-2147483648\r"),
        (at.PcmdMag(5, 0.5, 0.25, 1.0, -1.0, 0.125, 2.0),
         b"AT*PCMD_MAG=7,5,1056964608,1048576000,1065353216,-1082130432,1040187392,1073741824\r"),
        (at.Config("general:navdata_demo", "FALSE"), b'AT*CONFIG=7,"general:navdata_demo","FALSE"\r'),
        (at.Config("leds:leds_anim", "3,1073741824,2"), b'AT*CONFIG=7,"leds:leds_anim","3,1073741824,2"\r'),
        (at.ConfigIds("a", "b", "c"), b'AT*CONFIG_IDS=7,"a","b","c"\r'),
        (at.Ctrl(5), b"AT*CTRL=7,5,0\r"),
        (at.Ctrl(0, None), b"AT*CTRL=7,0\r"),
        (at.ComWdg(), b"AT*COMWDG=7\r"),
        (at.Ftrim(), b"AT*FTRIM=7\r"),
        (at.Calib(0), b"AT*CALIB=7,0\r"),
        (at.Led(3, 2.0, 5), b"AT*LED=7,3,1073741824,5\r"),
        (at.Anim(16, 15), b"AT*ANIM=7,16,15\r"),
        (at.Pmode(2), b"AT*PMODE=7,2\r"),
        (at.Misc(), b"AT*MISC=7,2,20,2000,3000\r"),
    ],
)  # fmt: skip
def test_bytes_of_each_command(command: at.AtCommand, line: bytes) -> None:
    assert at.encode(7, command) == line
    (back,) = at.decode(line)
    assert not isinstance(back, Refusal)
    assert at.encode(*back) == line


@settings(max_examples=300)
@given(st.lists(st.tuples(sequences, commands), max_size=6))
def test_what_is_encoded_decodes(told: list[tuple[int, at.AtCommand]]) -> None:
    assert at.decode(b"".join(at.encode(*t) for t in told)) == told


@settings(max_examples=300)
@given(st.binary(max_size=200), st.binary(max_size=50))
def test_garbage_never_raises_and_never_costs_the_next_command(garbage: bytes, behind: bytes) -> None:
    good = at.encode(9, at.Config("a:b", "c"))
    assert (9, at.Config("a:b", "c")) in at.decode(garbage + good + behind)
    assert (9, at.Config("a:b", "c")) in at.decode(garbage + b"\r" + good + behind)


def test_a_datagram_cut_at_every_byte_keeps_its_whole_commands() -> None:
    reported: list[tuple[int, Any]] = [
        (1, at.Ref(at.REF_BASE)),
        (2, at.Config("video:video_channel", "1")),
        (3, at.Pcmd(1, 0.5, 0.25, -0.125, 1.0)),
    ]
    lines = [at.encode(*t) for t in reported]
    data = b"".join(lines)
    for cut in range(len(data) + 1):
        whole = sum(len(b"".join(lines[: k + 1])) <= cut for k in range(3))
        results = at.decode(data[:cut])
        assert results[:whole] == reported[:whole]
        assert results[whole:] == ([Refusal.TORN] if cut > len(b"".join(lines[:whole])) else [])
        tail = at.decode(data[cut:])
        starts = [len(b"".join(lines[:k])) for k in range(3)]
        assert [r for r in tail if not isinstance(r, Refusal)] == [t for t, s in zip(reported, starts, strict=True) if s >= cut]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"hello\r", Refusal.BAD_MAGIC), (b"AT*NOSUCH=1,2\r", Refusal.UNKNOWN_COMMAND), (b"AT*REF=1\r", Refusal.BAD_ARGUMENTS),
        (b"AT*REF=1,2,3\r", Refusal.BAD_ARGUMENTS), (b"AT*REF=1,x\r", Refusal.BAD_ARGUMENTS),
        (b"AT*REF=x,1\r", Refusal.BAD_ARGUMENTS),
        (b"AT*REF=1,99999999999\r", Refusal.BAD_ARGUMENTS), (b"AT*REF=1,5000000000\r", Refusal.BAD_ARGUMENTS),
        (b"AT*REF=9999999999,1\r", Refusal.BAD_ARGUMENTS), (b"AT*FTRIM=1,\r", Refusal.BAD_ARGUMENTS),
        (b"AT*PCMD=1,1,0,0,0,2139095040\r", Refusal.BAD_ARGUMENTS), (b'AT*CONFIG=1,"a"x,"b"\r', Refusal.BAD_ARGUMENTS),
        (b'AT*CONFIG=1,a,"b"\r', Refusal.BAD_ARGUMENTS), (b'AT*CONFIG=1,"a","\xff"\r', Refusal.BAD_ARGUMENTS),
        (b"AT*COMWDG=1", Refusal.TORN),
    ],
)  # fmt: skip
def test_reasons_of_refusal_of_a_command(line: bytes, why: Refusal) -> None:
    assert at.decode(line) == [why]


@pytest.mark.parametrize(
    "command",
    [
        at.Pcmd(1, math.nan, 0.0, 0.0, 0.0), at.Pcmd(1, 1e39, 0.0, 0.0, 0.0), at.Config('a"b', "c"), at.Config("a", "b\r"),
        at.Config("é", ""), at.Ref(2**32),
    ],
)  # fmt: skip
def test_what_cannot_travel_is_our_mistake(command: at.AtCommand) -> None:
    with pytest.raises(ValueError, match=type(command).__name__.upper()[:3] + "|float"):
        at.encode(1, command)


def test_sequence_rule_of_the_receiver() -> None:
    gate = at.SequenceGate()
    assert [gate.accepts(n) for n in (1, 2, 5, 5, 4, 6, 1, 2, 2)] == [True, True, True, False, False, True, True, True, False]
    gate.accepts(100)
    gate.reset()
    assert gate.accepts(3)
