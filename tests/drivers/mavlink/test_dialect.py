"""Messages built from their definitions against those that pymavlink generated."""

import xml.etree.ElementTree as Xml
from pathlib import Path

import pymavlink
import pytest

from drivers.mavlink.codec import Codec
from drivers.mavlink.dialect import ComponentInformationBasic, Event, TargetRelative, TimeSyncV2, crc_extra_of, define, mav

DEFINITIONS = Path(pymavlink.__file__).parent / "dialects/v20"


def test_the_crc_seed_of_every_message_of_common_comes_out_as_generated() -> None:
    checked = 0
    for file in ("common.xml", "standard.xml", "minimal.xml"):
        for message in Xml.parse(DEFINITIONS / file).getroot().iter("message"):
            fields: list[tuple[str, str]] = []
            for child in message:
                if child.tag == "extensions":
                    break
                if child.tag == "field":
                    fields.append((child.attrib["type"].replace("_mavlink_version", ""), child.attrib["name"]))
            generated = mav.mavlink_map[int(message.attrib["id"])]
            assert crc_extra_of(message.attrib["name"], fields) == generated.crc_extra, message.attrib["name"]
            checked += 1
    assert checked > 200


def test_a_defined_message_crosses_the_wire_field_by_field() -> None:
    sent = TargetRelative(
        timestamp=2**40 + 5, id=3, frame=1, x=1.5, y=-2.25, z=3.125, pos_std=[0.25, 0.5, 0.75], yaw_std=0.125,
        q_target=[1.0, 2.0, 3.0, 4.0], q_sensor=[5.0, 6.0, 7.0, 8.0], type=3,
    )  # fmt: skip
    data = Codec(7, 191).pack(sent)
    (got,) = Codec(1, 1).feed(data)
    assert got.to_dict() == sent.to_dict()
    assert data[10:30].hex() == "0500000000010000" + "0000c03f" + "000010c0" + "00004840", "uint64 first, then the floats"


def test_timesync_has_targets_and_receives_those_without() -> None:
    assert TimeSyncV2.crc_extra == 34
    data = Codec(1, 1).pack(TimeSyncV2(5, -6, 7, 191))
    (got,) = Codec(1, 1).feed(data)
    assert (got.tc1, got.ts1, got.target_system, got.target_component) == (5, -6, 7, 191)
    (old,) = Codec(1, 1).feed(Codec(1, 1).pack(mav.MAVLink_timesync_message(5, 6)))
    assert (old.tc1, old.ts1, old.target_system, old.target_component) == (5, 6, 0, 0)


def test_text_fields_end_at_the_first_zero() -> None:
    sent = ComponentInformationBasic(1, 2**33, 0, "Decklander", "companion", "0.1.0", "", "")
    (got,) = Codec(1, 1).feed(Codec(7, 191).pack(sent))
    assert (got.vendor_name, got.model_name, got.hardware_version, got.capabilities) == ("Decklander", "companion", "", 2**33)


def test_a_taken_number_and_missing_fields_are_refused() -> None:
    with pytest.raises(ValueError, match="149"):
        define(149, "MINE", [("uint8_t", "a")])
    with pytest.raises(TypeError, match="takes destination_component"):
        Event(1, 2)
