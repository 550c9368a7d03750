import itertools
import json
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ardrone import navdata as nd
from drivers.ardrone.navdata_options import LAYOUT_OF_CLASS, UNREAD_BYTES, OptionLayout
from drivers.ardrone.navdata_readings import readings_of
from drivers.ardrone.refusal import Refusal
from drivers.ardrone.samples import NavdataSampler
from estimator.contracts.time import MonoNs, Stamp
from tests.drivers.captures import CAPTURES, needs_captures

STAMP = Stamp(MonoNs(0), MonoNs(0), 0.001, "synced")

RENAMED = {
    "vbat_flying_percentage": "battery_percent", "altitude": "altitude_mm", "vx": "vx_mm_s", "vy": "vy_mm_s", "vz": "vz_mm_s",
    "vbat_raw_mV": "vbat_raw_mv", "alt_temp_raw": "alt_temp_raw_mm", "accs_temp": "accs_temp_c",
    "phys_gyros_dps": "phys_gyros_deg_s", "theta_a": "theta_a_mdeg", "phi_a": "phi_a_mdeg",
    "theta_capture": "theta_capture_rad", "phi_capture": "phi_capture_rad", "psi_capture": "psi_capture_rad",
    "altitude_capture": "altitude_capture_mm", "time_capture": "time_capture_ms",
    "temperature_meas": "temperature_dc", "pression_meas": "pressure_pa", "magneto_raw": "magneto_raw_mg",
    "magneto_rectified": "magneto_rectified_mg", "heading_unwrapped": "heading_unwrapped_deg",
    "heading_gyro_unwrapped": "heading_gyro_unwrapped_deg", "heading_fusion_unwrapped": "heading_fusion_unwrapped_deg",
    "offset_pressure": "offset_pressure_pa", "lat": "lat_deg", "lon": "lon_deg", "elevation": "elevation_m",
}  # fmt: skip
"""Names in the capture's description to ours, where they differ."""


def of_distinct_numbers(layout: OptionLayout) -> Any:
    """Return an option whose every number differs from every other."""
    numbers = itertools.count(1)
    blank = layout.unpack(bytes(layout.size), 0)

    def distinct(value: Any) -> Any:
        return tuple(map(distinct, value)) if isinstance(value, tuple) else type(value)(next(numbers) * 0.5 + 0.5)

    return layout.cls(*(distinct(getattr(blank, name)) for name in layout.names))


@needs_captures
def test_every_value_of_the_captured_datagram() -> None:
    expected = json.loads((CAPTURES / "navdata_full_gps.expected.json").read_text())
    navdata = nd.decode((CAPTURES / "navdata_full_gps.bin").read_bytes())
    assert isinstance(navdata, nd.Navdata)
    assert (navdata.state, navdata.sequence, navdata.vision_defined, navdata.skipped) == (
        expected["state"], expected["sequence"], expected["vision_defined"], ())  # fmt: skip
    compared = 0
    for label, values in expected["options"].items():
        tag = int(label.split(":")[0])
        option = navdata.options.get(tag)
        if option is None:
            assert tag == nd.CHECKSUM_TAG or values["_size"] == UNREAD_BYTES[tag] + 4
            continue
        layout = LAYOUT_OF_CLASS[type(option)]
        assert layout.size == values["_size"]
        named = {RENAMED.get(k, k): v for k, v in values.items()}
        for name in layout.names if "raw" not in values else ():
            ours = getattr(option, name)
            assert (list(ours) if isinstance(ours, tuple) else ours) == named[name], (label, name)
            compared += 1
    assert compared == 73


@needs_captures
def test_a_captured_datagram_cut_or_changed_anywhere_is_refused() -> None:
    datagram = (CAPTURES / "navdata_full_gps.bin").read_bytes()
    for at in range(len(datagram)):
        assert isinstance(nd.decode(datagram[:at]), Refusal)
        changed = bytearray(datagram)
        changed[at] ^= 0x10
        assert isinstance(nd.decode(bytes(changed)), Refusal)


@pytest.mark.parametrize("layout", LAYOUT_OF_CLASS.values(), ids=lambda layout: layout.cls.__name__)
def test_no_two_fields_are_swapped(layout: OptionLayout) -> None:
    option = of_distinct_numbers(layout)
    datagram = nd.encode(nd.Navdata.of(7, 9, (option,)))
    decoded = nd.decode(datagram)
    assert decoded == nd.Navdata(7, 9, 1, {layout.tag: option})
    assert len(datagram) == 16 + layout.size + 8


def test_unknown_short_repeated_and_long_options_cost_nothing_else() -> None:
    watchdog = LAYOUT_OF_CLASS[nd.Watchdog].pack(nd.Watchdog(5))
    time = LAYOUT_OF_CLASS[nd.NavdataTime].pack(nd.NavdataTime(1))
    longer = struct.pack("<HH", 1, len(time) + 3) + time[4:] + b"new"
    unread = struct.pack("<HH8x", 27, 12)
    body = struct.pack("<HH", 99, 7) + b"abc" + struct.pack("<HH", 9, 6) + b"xy" + watchdog + longer + unread + watchdog
    head = struct.pack("<IIII", nd.MAGIC, 1, 2, 0)
    datagram = head + body
    decoded = nd.decode(datagram + struct.pack("<HHI", nd.CHECKSUM_TAG, 8, sum(datagram)))
    assert isinstance(decoded, nd.Navdata)
    assert decoded.options == {17: nd.Watchdog(5), 1: nd.NavdataTime(1)}
    assert decoded.skipped == (99, 9, 17)


def test_reasons_of_refusal() -> None:
    good = nd.encode(nd.Navdata.of(0, 1, (nd.Watchdog(5),)))
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
    unread = sum(len(body) >= UNREAD_BYTES.get(tag, 1 << 16) for tag, body in bodies)
    assert len(bodies) - unread <= len(navdata.options) + len(navdata.skipped) <= len(bodies)
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
    expected = [outcome(nd._walk(one, len(one))) for one in (bytes(damaged), summed)]
    nd._outlines.clear()
    first = outcome(nd.decode(good))
    assert list(nd._outlines) == [len(good)]
    assert outcome(nd.decode(good)) == first
    for one, as_walked in zip((bytes(damaged), summed), expected, strict=True):
        nd.decode(good)
        assert outcome(nd.decode(one)) == as_walked
