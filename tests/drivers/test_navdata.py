import itertools
import json
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ardrone import navdata as nd
from drivers.ardrone.navdata_layout import LAYOUT_OF_CLASS, OptionLayout
from drivers.ardrone.navdata_readings import readings_of
from drivers.ardrone.refusal import Refusal
from drivers.ardrone.samples import NavdataSampler
from estimator.contracts.time import MonoNs, Stamp
from tests.drivers.captures import CAPTURES, needs_captures

STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "synced")

RENAMED = {
    "vbat_flying_percentage": "battery_percent", "altitude": "altitude_mm", "vx": "vx_mm_s", "vy": "vy_mm_s", "vz": "vz_mm_s",
    "vbat_raw_mV": "vbat_raw_mv", "alt_temp_raw": "alt_temp_raw_mm", "accs_temp": "accs_temp_c",
    "phys_gyros_dps": "phys_gyros_deg_s", "alim3V3": "alim3v3", "vrefEpson": "vref_epson", "vrefIDG": "vref_idg",
    "theta_a": "theta_a_mdeg", "phi_a": "phi_a_mdeg", "ref_theta_I": "ref_theta_i", "ref_phi_I": "ref_phi_i",
    "yaw_u_I": "yaw_u_i", "obs_accZ": "obs_acc_z", "theta_capture": "theta_capture_rad", "phi_capture": "phi_capture_rad",
    "psi_capture": "psi_capture_rad", "altitude_capture": "altitude_capture_mm", "time_capture": "time_capture_ms",
    "dist": "dist_cm", "orientation_angle": "orientation_deg", "atcmd_mean_ref_gap": "atcmd_mean_ref_gap_ms",
    "temperature_meas": "temperature_dc", "pression_meas": "pressure_pa", "magneto_raw": "magneto_raw_mg",
    "magneto_rectified": "magneto_rectified_mg", "magneto_offset": "magneto_offset_mg",
    "heading_unwrapped": "heading_unwrapped_deg", "heading_gyro_unwrapped": "heading_gyro_unwrapped_deg",
    "heading_fusion_unwrapped": "heading_fusion_unwrapped_deg", "wind_speed": "wind_speed_m_s", "wind_angle": "wind_angle_rad",
    "offset_pressure": "offset_pressure_pa", "est_bias_PWM": "est_bias_pwm", "est_biais_pression": "est_bias_pressure",
    "offset_US": "offset_us", "prediction_US": "prediction_us", "cov_PWM": "cov_pwm", "cov_vitesse": "cov_velocity",
    "bool_effet_sol": "ground_effect", "somme_inno": "sum_innovation", "flag_rejet_US": "rejected_us",
    "flag_multisinus_debut": "flag_multisinus_start", "usbkey_size_kB": "usbkey_size_kb",
    "usbkey_freespace_kB": "usbkey_freespace_kb", "lat": "lat_deg", "lon": "lon_deg", "elevation": "elevation_m",
    "lat0": "lat0_deg", "lon0": "lon0_deg", "lat_fused": "lat_fused_deg", "lon_fused": "lon_fused_deg", "X_traj": "x_traj",
    "X_ref": "x_ref", "Y_traj": "y_traj", "Y_ref": "y_ref",
}  # fmt: skip
"""Names in the capture's description to ours, where they differ."""


def told_apart(layout: OptionLayout) -> Any:
    """Return an option whose every number differs from every other."""
    numbers = itertools.count(1)
    arguments = []
    at = 0
    codes = layout.body.format[1:]
    for letter in _letters(codes, layout):
        values = [next(numbers) * (0.5 if c in "fd" else 1) for c in letter[1]]
        arguments.append(tuple(values) if letter[0] else values[0])
        at += len(values)
    return layout.cls(*arguments)


def _letters(codes: str, layout: OptionLayout) -> list[tuple[bool, str]]:
    out, count = [], ""
    for c in codes:
        if c.isdigit():
            count += c
        else:
            out.append((bool(count), c * int(count or 1)))
            count = ""
    assert len(out) == len(layout.names)
    return out


@needs_captures
def test_every_value_of_the_captured_datagram() -> None:
    expected = json.loads((CAPTURES / "navdata_full_gps.expected.json").read_text())
    navdata = nd.decode((CAPTURES / "navdata_full_gps.bin").read_bytes())
    assert isinstance(navdata, nd.Navdata)
    assert (navdata.state, navdata.sequence, navdata.vision_defined, navdata.skipped) == (
        expected["state"], expected["sequence"], expected["vision_defined"], ())  # fmt: skip
    assert len(navdata.options) == len(expected["options"]) - 1 == 28
    compared = 0
    for label, values in expected["options"].items():
        tag = int(label.split(":")[0])
        if tag == nd.CHECKSUM_TAG:
            continue
        option = navdata.options[tag]
        layout = LAYOUT_OF_CLASS[type(option)]
        assert layout.size == values["_size"]
        if "raw" in values:  # described as all zero bytes only
            assert not any(layout.pack(option)[4:])
            continue
        named = {RENAMED.get(k, k): v for k, v in values.items() if not k.startswith("_")}
        assert tuple(named) == layout.names, label
        for name, value in named.items():
            ours = getattr(option, name)
            assert (list(ours) if isinstance(ours, tuple) else ours) == value, (label, name)
            compared += 1
    assert compared > 190


@needs_captures
def test_the_captured_datagram_encodes_to_its_own_bytes() -> None:
    datagram = (CAPTURES / "navdata_full_gps.bin").read_bytes()
    navdata = nd.decode(datagram)
    assert isinstance(navdata, nd.Navdata)
    assert nd.encode(navdata) == datagram


@needs_captures
def test_a_captured_datagram_cut_or_changed_anywhere_is_refused() -> None:
    datagram = (CAPTURES / "navdata_full_gps.bin").read_bytes()
    for at in range(len(datagram)):
        assert isinstance(nd.decode(datagram[:at]), Refusal)
        changed = bytearray(datagram)
        changed[at] ^= 0x10
        assert isinstance(nd.decode(bytes(changed)), Refusal)


@needs_captures
def test_time_capture_is_milliseconds_just_before_the_datagram() -> None:
    navdata = nd.decode((CAPTURES / "navdata_full_gps.bin").read_bytes())
    assert isinstance(navdata, nd.Navdata)
    time, vision = navdata.get(nd.NavdataTime), navdata.get(nd.Vision)
    assert time is not None
    assert vision is not None
    assert 0 < time.time_us / 1000 - vision.time_capture_ms < 50


@pytest.mark.parametrize("layout", LAYOUT_OF_CLASS.values(), ids=lambda layout: layout.cls.__name__)
def test_no_two_fields_are_swapped(layout: OptionLayout) -> None:
    option = told_apart(layout)
    datagram = nd.encode(nd.Navdata.of(7, 9, (option,)))
    decoded = nd.decode(datagram)
    assert decoded == nd.Navdata(7, 9, 1, {layout.tag: option})
    assert len(datagram) == 16 + layout.size + 8


def test_sizes_on_the_wire() -> None:
    sizes = {layout.tag: layout.size for layout in LAYOUT_OF_CLASS.values() if layout.cls is not nd.Zimmu3000}
    assert [sizes[tag] for tag in range(28)] == [
        148, 8, 52, 46, 16, 12, 88, 16, 24, 76, 56, 16, 44, 92, 108, 364, 328, 8, 40, 65, 12, 18, 75, 56, 72, 32, 8, 216,
    ]  # fmt: skip


def test_old_firmware_has_another_option_27() -> None:
    decoded = nd.decode(nd.encode(nd.Navdata.of(0, 1, (nd.Zimmu3000(3, 4.0),))))
    assert isinstance(decoded, nd.Navdata)
    assert decoded.get(nd.Zimmu3000) == nd.Zimmu3000(3, 4.0)
    assert decoded.get(nd.Gps) is None


def test_unknown_short_repeated_and_long_options_cost_nothing_else() -> None:
    wifi = LAYOUT_OF_CLASS[nd.Wifi].pack(nd.Wifi(5))
    games = LAYOUT_OF_CLASS[nd.Games].pack(nd.Games(1, 2))
    longer = struct.pack("<HH", 20, len(games) + 3) + games[4:] + b"new"
    body = struct.pack("<HH", 99, 7) + b"abc" + struct.pack("<HH", 9, 6) + b"xy" + wifi + longer + wifi
    head = struct.pack("<IIII", nd.MAGIC, 1, 2, 0)
    datagram = head + body
    decoded = nd.decode(datagram + struct.pack("<HHI", nd.CHECKSUM_TAG, 8, sum(datagram)))
    assert isinstance(decoded, nd.Navdata)
    assert decoded.options == {26: nd.Wifi(5), 20: nd.Games(1, 2)}
    assert decoded.skipped == (99, 9, 26)


def test_reasons_of_refusal() -> None:
    good = nd.encode(nd.Navdata.of(0, 1, (nd.Wifi(5),)))
    assert nd.decode(b"") is Refusal.TOO_SHORT
    assert nd.decode(b"x" + good[1:]) is Refusal.BAD_MAGIC
    assert nd.decode(good[:-1]) is Refusal.TORN
    assert nd.decode(good + b"\0") is Refusal.TORN
    assert nd.decode(good[:-1] + b"\x7f") is Refusal.BAD_CHECKSUM


def test_time_wraps_and_control_state() -> None:
    assert nd.NavdataTime.of_us(2049_000_001).time_us == 1_000_001
    flying = nd.Demo(nd.ControlState.LANDING.word | 3, 0, 0.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0)
    assert nd.Navdata.of(0, 1, (flying,)).control_state is nd.ControlState.LANDING
    strange = nd.Demo(77 << 16, 0, 0.0, 0.0, 0.0, 0, 0.0, 0.0, 0.0)
    assert nd.Navdata.of(0, 1, (strange,)).control_state is None
    assert nd.Navdata.of(0, 1).control_state is None


@settings(max_examples=300)
@given(st.binary(max_size=400))
def test_any_bytes_end_in_a_result(data: bytes) -> None:
    assert isinstance(nd.decode(data), nd.Navdata | Refusal)


@settings(max_examples=300)
@given(st.lists(st.tuples(st.integers(0, 30), st.binary(max_size=230)), max_size=8), st.integers(0, 2**32 - 1))
def test_any_bodies_under_a_good_checksum_become_samples_or_nothing(bodies: list[tuple[int, bytes]], state: int) -> None:
    data = struct.pack("<IIII", nd.MAGIC, state, 1, 1)
    data += b"".join(struct.pack("<HH", tag, len(body) + 4) + body for tag, body in bodies)
    navdata = nd.decode(data + struct.pack("<HHI", nd.CHECKSUM_TAG, 8, sum(data) & 0xFFFFFFFF))
    assert isinstance(navdata, nd.Navdata)
    assert len(navdata.options) + len(navdata.skipped) == len(bodies)
    sampler = NavdataSampler()
    assert len(sampler.samples(navdata, STAMP)) >= len(sampler.samples(navdata, STAMP))


def outcome(decoded: nd.Navdata | Refusal) -> object:
    if isinstance(decoded, Refusal):
        return decoded
    options = list(decoded.options.items())
    assert repr(decoded.readings) == repr(readings_of(dict(options))), "read at once and from the options one by one"
    return repr((decoded.state, decoded.sequence, decoded.vision_defined, decoded.skipped, options))


@settings(max_examples=300)
@given(
    st.lists(st.tuples(st.sampled_from([0, 1, 2, 3, 9, 10, 21, 27, 77]), st.binary(max_size=230)), max_size=6),
    st.lists(st.tuples(st.integers(0, 2000), st.integers(1, 255)), max_size=3),
)
def test_a_datagram_of_a_known_outline_is_decoded_as_option_by_option(bodies, damage):
    """The second of two datagrams of one size may be as the first, be damaged anywhere, or have other headers."""
    raw = b"".join(struct.pack("<HH", tag, len(body) + 4) + body for tag, body in bodies)
    head = struct.pack("<IIII", nd.MAGIC, 5, 7, 1) + raw
    good = head + struct.pack("<HHI", nd.CHECKSUM_TAG, 8, sum(head))
    damaged = bytearray(good)
    for place, bits in damage:
        damaged[place % len(damaged)] ^= bits
    summed = bytes(damaged[:-8]) + struct.pack("<HHI", nd.CHECKSUM_TAG, 8, sum(damaged[:-8]))
    expected = [outcome(nd._walked(one, len(one))) for one in (bytes(damaged), summed)]
    nd._outlines.clear()
    first = outcome(nd.decode(good))
    assert list(nd._outlines) == [len(good)]
    assert outcome(nd.decode(good)) == first
    for one, as_walked in zip((bytes(damaged), summed), expected, strict=True):
        nd.decode(good)
        assert outcome(nd.decode(one)) == as_walked


def test_no_more_outlines_are_kept_than_a_drone_has() -> None:
    for size in range(100):
        head = struct.pack("<IIIIHH", nd.MAGIC, 0, 1, 1, 999, 4 + size) + bytes(size)
        assert isinstance(nd.decode(head + struct.pack("<HHI", nd.CHECKSUM_TAG, 8, sum(head))), nd.Navdata)
    assert len(nd._outlines) <= nd._OUTLINES_MOST
