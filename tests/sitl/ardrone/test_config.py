"""The configuration table: who may write what, and the sets of the multi-configuration."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.ardrone import control
from sitl.ardrone.config import KEYS, Answer, Configuration, Ids, tilting
from tests.drivers.captures import CAPTURES, needs_captures
from tests.sitl.test_vehicle_files import shipped_vehicle

MINE = Ids("ca0000d1", "ca0000d3", "ca0000d2")


def chosen() -> Configuration:
    config = Configuration()
    assert config.set("custom:session_id", MINE.session) is Answer.SET
    assert config.set("custom:profile_id", MINE.user) is Answer.SET
    assert config.set("custom:application_id", MINE.application) is Answer.SET
    assert config.ids == MINE
    return config


@pytest.mark.parametrize(
    ("name", "value", "answer", "kept"),
    [
        ("general:navdata_demo", "TRUE", Answer.SET, "TRUE"),
        ("GENERAL:navdata_demo", " true ", Answer.SET, "TRUE"),
        ("general:navdata_demo", "maybe", Answer.BAD_VALUE, "FALSE"),
        ("general:num_version_soft", "9", Answer.READ_ONLY, "2.4.8"),
        ("control:euler_angle_max", "0.3", Answer.SET, "0.3"),
        ("control:euler_angle_max", "2.0", Answer.BAD_VALUE, "0.20943952"),
        ("control:euler_angle_max", "nan", Answer.BAD_VALUE, "0.20943952"),
        ("video:video_channel", "1", Answer.SET, "1"),
        ("video:video_channel", "7", Answer.BAD_VALUE, "0"),
        ("general:ardrone_name", "a\nb", Answer.BAD_VALUE, "Decklander"),
    ],
)
def test_set_answers_and_keeps(name: str, value: str, answer: Answer, kept: str) -> None:
    config = Configuration()
    assert config.set(name, value) is answer
    assert config[name.lower()] == kept


@pytest.mark.parametrize(("vehicle", "takes"), [("ardrone2", False), ("hexa_7kg", False), ("quad_1_5kg", True)])
def test_a_larger_vehicle_takes_the_tilt_of_its_own_loops_and_an_ardrone_its_firmwares(vehicle: str, takes: bool) -> None:
    limits = shipped_vehicle(vehicle).stick_limits()
    config = Configuration(keys=tilting(KEYS, limits.euler_angle_most_rad))
    assert config.set("control:euler_angle_max", "0.52") is Answer.SET
    assert (config.set("control:euler_angle_max", "0.61") is Answer.SET) is takes
    assert config.set("control:euler_angle_max", "0.62") is Answer.BAD_VALUE
    loops_rad = math.radians(shipped_vehicle(vehicle).loops.tilt_max_deg)
    assert config.set("control:euler_angle_max", f"{loops_rad:.6f}") is Answer.SET


def test_outdoor_brings_its_own_limits_and_keeps_the_indoor_ones() -> None:
    config = Configuration()
    config.set("control:control_vz_max", "900")
    assert config["control:indoor_control_vz_max"] == "900.0"
    config.set("control:outdoor", "TRUE")
    assert config["control:control_vz_max"] == "1000"
    config.set("control:outdoor_control_vz_max", "1500")
    assert config["control:control_vz_max"] == "1500.0"
    config.set("control:outdoor", "FALSE")
    assert config["control:control_vz_max"] == "900.0"


def test_a_session_keeps_its_keys_from_others() -> None:
    config = chosen()
    assert config.set("video:video_channel", "1") is Answer.WRONG_IDS
    assert config.set("video:video_channel", "1", Ids("ca0000d1", "ffffffff", "ffffffff")) is Answer.SET
    assert config.set("control:euler_angle_max", "0.3", Ids("ca0000d1", "ffffffff", "ca0000d2")) is Answer.WRONG_IDS
    assert config.set("control:altitude_max", "5000") is Answer.SET, "a common key needs no ids"
    config.set("custom:session_id", "00000000")
    assert config["video:video_channel"] == "0"
    assert config.ids == Ids()
    config.set("custom:session_id", MINE.session)
    assert config["video:video_channel"] == "1"
    assert config.ids == MINE, "a session brings its user and application back"


def test_custom_ids_list_is_in_the_form_the_sdk_reads() -> None:
    config = chosen()
    assert config.set("custom:profile_desc", "deck pilot", MINE) is Answer.SET
    text = config.custom_ids()
    assert text.endswith(b"\r\0")
    lines = text[:-1].decode().split("\r")
    assert [line for line in lines if line.startswith("[")] == ["[applis]", "[profiles]", "[sessions]"]
    assert "ca0000d3,deck pilot" in lines[lines.index("[profiles]") : lines.index("[sessions]")]


@settings(max_examples=200)
@given(st.lists(st.tuples(st.sampled_from([*KEYS, "custom:session_id", "nope"]), st.text(max_size=12)), max_size=8))
def test_no_value_breaks_the_table(writes: list[tuple[str, str]]) -> None:
    config = Configuration()
    for name, value in writes:
        config.set(name, value, MINE)
    read = config.dump()
    assert list(read) == list(KEYS)
    assert control.parse(control.render(read) + b"general:late = 1\n") == read, "what follows the NUL is not of this text"
    assert 0.0 <= config.number("control:euler_angle_max") <= 0.52
    assert config.number("general:com_watchdog") >= 1


@needs_captures
def test_a_real_configuration() -> None:
    text = (CAPTURES / "config_port5559_ardrone1.txt").read_bytes()
    reported = control.parse(text)
    assert len(reported) == len([line for line in text.splitlines() if b"=" in line])
    assert reported["general:navdata_options"] == "65537"
    assert reported["general:soft_build_date"] == "2011-07-13 09:52"
    assert reported["network:passkey"] == ""
    assert reported["network:owner_mac"] == "00:00:00:00:00:00"
    assert control.boolean(reported["general:navdata_demo"]) is True
    assert control.vector(reported["control:accs_offset"]) == (-2235.3198, 1924.7540, 2084.4270)
    assert control.number(reported["control:euler_angle_max"]) == pytest.approx(0.15)
    assert control.render(reported).rstrip(b"\0").split() == text.split()


@given(st.binary(max_size=300))
def test_garbage_never_raises_and_costs_no_line(garbage: bytes) -> None:
    control.parse(garbage)
    reported = control.parse(garbage.replace(b"\0", b"") + b"\ngeneral:a = 1\n")
    assert reported["general:a"] == "1"
