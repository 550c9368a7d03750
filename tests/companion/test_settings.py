"""Settings: what is refused and how that reads, what comes back unchanged, what has no effect, and the pages of the model."""

import json
import math
import os
import time
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import settings as runs
from hypothesis import strategies as st
from msgspec import inspect

from companion.cli import main as cli
from companion.guidance.pilot import make_pilot
from companion.parts.mavlink.bridge.options import BridgeOptions
from companion.parts.mavlink.signed_links import signed_links
from companion.settings import schema
from companion.settings.load import (
    camera_model,
    complete,
    from_file,
    from_mapping,
    load,
    pad_model,
    pad_of_file,
    shipped,
    toml_of,
)
from companion.settings.model import Settings, in_file
from companion.settings.remarks import remarks, without_effect
from companion.settings.schema import unit_of, walk
from companion.settings.sound import SOUND, Sound, beyond_sound, rim_m
from decklander.place import SHIPPED
from drivers.mavlink.options import AutopilotOptions, autopilot_of
from estimator.contracts.address import masked, raw
from estimator.contracts.errors import BadInput
from estimator.ekf import EkfOptions

ROOT = Path(__file__).parents[2]
MINIMAL = '[vehicle]\nkind = "ardrone"\n[camera]\nfile = "sim"\n[pad]\nfile = "thesis"\n'
AUTOPILOT = MINIMAL.replace('"ardrone"', '"mavlink"\nlinks = "serial:///dev/ttyAMA0:921600"').replace(
    'file = "sim"', 'file = "sim"\nsource = "v4l2"\ndevice = "Test camera"'
)
MINIMALS = {"ardrone": MINIMAL, "mavlink": AUTOPILOT}
CASES = tomllib.loads(Path(__file__).with_name("refused_settings.toml").read_text())
KEYS = dict(walk(Settings))
KIND_OF = {path: kind for kind in MINIMALS for path, _ in walk(Settings, kind)}
"""A kind of vehicle that has this key."""


def minimal(kind: str = "ardrone", **changes: Any) -> dict[str, Any]:
    """Return the smallest good file with keys set by dotted path (`__` for a dot)."""
    data: dict[str, Any] = tomllib.loads(MINIMALS[kind])
    for path, value in changes.items():
        *tables, last = path.split("__")
        table = data
        for name in tables:
            table = table.setdefault(name, {})
        table[last] = value
    return data


def refusal(data: dict[str, Any]) -> str:
    with pytest.raises(BadInput) as caught:
        from_mapping(data, "rig.toml")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("rig", shipped())
def test_shipped_rigs_are_good_and_name_real_cameras_and_pads(rig: str) -> None:
    settings = load(rig)
    assert camera_model(settings).width == (176 if rig == "ardrone1" else 640)
    assert pad_model(settings).disc_radius_m == pytest.approx(0.39, abs=0.02)
    assert without_effect(settings) == ()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"guidance__rate_hz": 10**400}, f"guidance.rate_hz must be a number from 5 to 200 Hz, found 1{'0' * 56}..."),
        *((case["changes"], case["said"]) for case in CASES["case"]),
    ],
)
def test_a_refusal_names_file_key_unit_range_and_what_was_found(changes: dict[str, Any], text: str) -> None:
    output = refusal(minimal(**changes))
    assert output.startswith("rig.toml: ")
    assert text in output


def test_a_missing_table_says_what_it_needs() -> None:
    data = {"vehicle": {"kind": "ardrone"}, "pad": {"file": "thesis"}}
    assert refusal(data) == "rig.toml: the table [camera] is missing; it needs file"


def test_every_key_is_explained_and_every_number_refuses_what_lies_outside_its_range() -> None:
    for path, field in KEYS.items():
        assert isinstance(field.type, inspect.Metadata), path
        assert len((field.type.extra_json_schema or {})["description"]) > 8, path
        kind = field.type.type
        if not isinstance(kind, inspect.FloatType | inspect.IntType):
            continue
        assert unit_of(field.type), path
        assert kind.ge is not None, path
        assert kind.le is not None, path
        assert field.required or kind.ge <= field.default <= kind.le, path
        for bad in (math.nan, math.inf, -math.inf, kind.ge - 1, kind.le + 1, "1", True):
            assert path in refusal(minimal(KIND_OF[path], **{path.replace(".", "__"): bad})), (path, bad)


def test_a_number_out_of_range_is_refused_in_code_as_in_a_file() -> None:
    with pytest.raises(ValueError, match=r"EkfOptions\.forget_s must lie in 0.1 to 600, got nan"):
        EkfOptions(forget_s=float("nan"))
    with pytest.raises(ValueError, match=r"EkfOptions\.velocity_is_over must be one of"):
        EkfOptions(velocity_is_over="water")  # type: ignore[arg-type]


def values(field: inspect.Field) -> st.SearchStrategy[Any]:
    match field.type.type if isinstance(field.type, inspect.Metadata) else field.type:
        case inspect.FloatType(ge=low, le=high):
            return st.floats(low, high)
        case inspect.IntType(ge=low, le=high):
            return st.integers(low, high)
        case inspect.BoolType():
            return st.booleans()
        case inspect.LiteralType(values=words):
            return st.sampled_from(words)
        case inspect.StrType(pattern=str(pattern)):
            return st.from_regex(pattern, fullmatch=True)
    return st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=40)


@given(st.data(), st.sampled_from(sorted(MINIMALS)))
@runs(max_examples=60)
def test_what_show_prints_reads_back_as_the_same_settings(data: st.DataObject, kind: str) -> None:
    fields = dict(walk(Settings, kind))
    paths = data.draw(st.lists(st.sampled_from(sorted(fields)), max_size=8))
    changes = {path.replace(".", "__"): data.draw(values(fields[path])) for path in paths}
    try:
        drawn = from_mapping(minimal(kind, **changes), "drawn")
    except BadInput:
        reject()  # keys that contradict each other
    assert from_file(tomllib.loads(schema.toml(drawn)), "shown") == drawn


@pytest.mark.parametrize(
    "address",
    [
        "rtsp://deck:Kiel-7@127.0.0.1/h264", "http://127.0.0.1/video?user=deck&password=Kiel-7", "deck:Kiel-7@broker.ship",
        "rtspsrc location=rtsp://h/x user-id=deck user-pw=Kiel-7 ! decodebin", "tcp://deck:Kiel-7@ship/a:5760, udpin://0.0.0.0:1",
        "rtsp://deck:it's Kiel-7@127.0.0.1/h264",
    ],
)  # fmt: skip
@pytest.mark.parametrize("kind", sorted(MINIMALS))
def test_no_text_of_the_settings_prints_the_password_in_its_address(kind: str, address: str) -> None:
    held, refusals = 0, [""]
    for path, field in walk(Settings, kind):
        if not isinstance(field.type, inspect.Metadata) or not isinstance(field.type.type, inspect.StrType):
            continue
        try:
            settings = from_mapping(minimal(kind, **{path.replace(".", "__"): address}), "rig.toml")
        except BadInput as why:
            refusals.append(masked(str(why)))
            continue
        value: Any = settings
        for part in path.split("."):
            value = getattr(value, part)
        for shown in (f"{value}", f"{value:.200}", f"{value!r}", "%s" % value, repr(settings), schema.toml(settings)):  # noqa: UP031
            assert "Kiel" not in shown, path
        assert raw(value) == address, "and whoever opens it has all of it"
        held += 1
    assert held > 20
    assert "Kiel" not in "\n".join(refusals)


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from([*"abc", *{n for p in KEYS for n in p.split(".")}]), inner)
    ),
    max_leaves=12,
)


@given(st.dictionaries(st.sampled_from(["vehicle", "camera", "pad", "vision", "guidance", "x"]), junk))
@runs(max_examples=100)
def test_any_mapping_is_either_settings_or_one_line(data: dict[str, Any]) -> None:
    try:
        from_mapping({**minimal(), **data}, "rig.toml")
    except BadInput as why:
        output = str(why)
    else:
        return
    assert output.startswith("rig.toml: ")
    assert "\n" not in output


@given(st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
@runs(max_examples=100)
def test_any_bytes_in_a_file_are_either_settings_or_one_line(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    file = tmp_path_factory.getbasetemp() / "any.toml"
    file.write_bytes(content)
    with pytest.raises(BadInput) as caught:
        load(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ('source = "v4l2"\ndevice = "Test camera"', ""),
            "camera.source must be one of v4l2, libcamera, gstreamer, stream, ros2: an autopilot has no frames",
        ),
        (
            ('source = "v4l2"\ndevice = "Test camera"', 'source = "stream"\ndevice = "a.mp4"\n[camera.exposure]\nmode = "pad"'),
            'camera.exposure.mode must be "camera" with camera.source "stream": only that of a camera with one of v4l2',
        ),
        (
            ('device = "Test camera"', 'device = "a"\ncontrols = "gain=4"\n[camera.exposure]\nmode = "pad"'),
            'camera: controls: exposure.mode "pad" sets \'gain\': leave it out, or let exposure.mode be "camera"',
        ),
        (("[camera]", '[bridge]\nlinks = "udpin://0.0.0.0:14550"\n[camera]'), "bridge.links must be empty"),
        (("[camera]", '[guidance]\nstart = "automatic"\n[camera]'), 'guidance.start must be "signal"'),
    ],
)
def test_what_an_autopilot_does_not_go_with(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(AUTOPILOT)
    assert not [*load(file).faults()]
    file.write_text(AUTOPILOT.replace(*change))
    with pytest.raises(BadInput, match=f"^{file}: {said}"):
        load(file)


def test_paths_are_relative_to_the_settings_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = tmp_path / "rigs" / "mine.toml"
    rig.parent.mkdir()
    rig.write_text(AUTOPILOT.replace('"sim"', '"../lens.toml"').replace("[camera]", 'signing_key_file = "link.key"\n[camera]'))
    (tmp_path / "lens.toml").write_text((ROOT / "configs/cameras/sim.toml").read_text().replace("width = 640", "width = 800"))
    monkeypatch.chdir(ROOT)
    settings = load(rig)
    assert camera_model(settings).width == 800
    assert settings.pad.file == "thesis"
    assert autopilot_of(settings.vehicle).signing_key_file == str(tmp_path / "rigs/link.key")


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ('"sin"', "camera.file: there is no file 'sin' and no shipped one of that name (did you mean 'sim'?)"),
        ('"lens.toml"', "lens.toml: key 'fx' is missing"),
        ('"."', "Is a directory"),
        ('"a\\u0000b"', "camera.file: there is no file 'a\\x00b'"),
        ('"' + "a" * 4000 + '"', "camera.file: not a usable file name"),
    ],
)
def test_a_camera_file_that_cannot_be_used_is_refused(tmp_path, monkeypatch, camera, said):
    monkeypatch.chdir(tmp_path)
    Path("lens.toml").write_text("width = 640\nheight = 360\nfy = 1.0\ncx = 1.0\ncy = 1.0\n")
    Path("rig.toml").write_text(MINIMAL.replace('"sim"', camera))
    with pytest.raises(BadInput, match=r"^[^\n]*$") as caught:
        load("rig.toml")
    assert said in str(caught.value)


def test_broken_toml_is_refused_with_its_place(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(MINIMAL + "[vision\n")
    with pytest.raises(BadInput, match=r"rig\.toml: not valid TOML: .*line 7"):
        load(file)
    file.write_text("a = " + "[" * 100_000)
    with pytest.raises(BadInput, match="not valid TOML"):
        load(file)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "[guidance]\nrate_hz = 25.0\n[guidance.cone]\nslope = 0.4",
            "guidance.rate_hz belongs in [expert.guidance]; guidance.cone.slope belongs in [expert.guidance.cone]",
        ),
        ('[expert.guidance]\nstart = "signal"', "expert.guidance.start belongs in [guidance]"),
        ("[expert.guidance.cone]\nslope = 9", "expert.guidance.cone.slope must be a number from"),
        ("[expert.guidance.cone]\nslop = 9", "slop is not a known key; did you mean guidance.cone.slope?"),
    ],
)
def test_keys_on_the_wrong_side_of_expert_are_each_named_with_their_place(text: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(f"{MINIMAL}\n{text}\n")
    with pytest.raises(BadInput, match=r"^[^\n]*$") as caught:
        load(file)
    assert said in str(caught.value)


def test_the_schema_and_the_reference_page_are_what_the_model_says() -> None:
    whole = json.loads(schema.schema())
    assert whole["$defs"]["ConeOptions"]["properties"]["descent_rate_m_s"]["x-unit"] == "m/s"
    assert whole["$defs"]["ConeOptions"]["additionalProperties"] is False
    assert whole["$defs"]["Settings"]["required"] == ["vehicle", "camera", "pad"]
    page = (ROOT / "docs/configuration.md").read_text()
    assert page == schema.reference(), "run: decklander config reference > docs/configuration.md"


def test_a_pad_is_read_once_and_again_when_its_file_has_changed(tmp_path: Path) -> None:
    file = tmp_path / "pad.toml"
    text = (SHIPPED / "pads" / "thesis.toml").read_text(encoding="utf-8")
    file.write_text(text, encoding="utf-8")
    first = pad_of_file(file)
    assert pad_of_file(file) is first
    file.write_text(text.replace(f'name = "{first.name}"', 'name = "another"'), encoding="utf-8")
    assert pad_of_file(file).name == "another"
    file.unlink()
    with pytest.raises(BadInput, match=r"pad\.toml"):
        pad_of_file(file)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "a device or a pipe"),
        (MINIMAL.replace('"sim"', '"/dev/zero"'), "a device or a pipe"),
        (MINIMAL + '[http]\nendpoint = "http"\ntoken_file = "/dev/zero"\n', "a device or a pipe"),
        ("a" + ".a" * 50_000 + " = 1\n", "a key of more than 50 parts"),
        ("a" + ".'a'" * 200 + " = 1\n", "a key of more than 50 parts"),
        ("# " + "x" * 1_000_000, "such a file has at most 1000000"),
    ],
)
def test_no_file_that_settings_name_is_endless_large_or_slow(text, said, tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    if text:
        rig.write_text(text)
    else:
        os.mkfifo(rig)
    began_s = time.process_time()
    assert cli.main(["config", "check", str(rig)]) == 2
    assert time.process_time() - began_s < 2.0
    assert said in capsys.readouterr().err


def test_long_rows_of_numbers_and_texts_with_dots_are_no_deep_keys() -> None:
    text = f"x = [{', '.join(['0.125'] * 400)}]\ny = \"{'a.b ' * 400}\"\nz = '''\n{'One. Two. ' * 20}\n'''\n"
    assert toml_of(text, Path("x"))["x"][-1] == 0.125


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (minimal() | {"mqtt": {"transport": "tls", "host": "broker"}}, ()),
        (
            minimal() | {"mqtt": {"host": "broker", "drone": "deck"}},
            ('mqtt.drone, mqtt.host: without effect, as mqtt.transport is "off"',),
        ),
        (minimal() | {"bridge": {"system_id": 7}}, ("bridge.system_id: without effect, as bridge.links is empty",)),
        (minimal() | {"guidance": {"pid": {"climb_max_m_s": 0.7}}, "estimator": {"path": "median_mean"}}, ()),
        (
            minimal() | {"vessel": {"jump_m": 20.0}},
            ("expert.vessel.jump_m: without effect, as no source of the ship's place is set",),
        ),
        (
            minimal() | {"guidance": {"rendezvous": {"range_m": 9.0}}, "vessel": {"nmea": "127.0.0.1:10110", "mmsi": 7}},
            ("guidance.rendezvous.range_m: without effect, as guidance.rendezvous.enabled is false",),
        ),
        (
            minimal("mavlink") | {"landing_target": {"ranges": "off", "range_rate_hz": 5.0}},
            ('expert.landing_target.range_rate_hz: without effect, as landing_target.ranges is "off"',),
        ),
    ],
)
def test_a_key_without_effect_is_reported_with_the_cause(data: dict[str, Any], said: tuple[str, ...]) -> None:
    assert without_effect(from_mapping(data, "x")) == said


def widened(key: str, value: float) -> Settings:
    """Return the smallest settings with one key; keys that contradict it are as wide."""
    *tables, last = key.split(".")
    inner: dict[str, Any] = {last: value}
    if key == "guidance.tries.climb_after_s":
        inner["give_up_after_s"] = 600.0
    if key in ("guidance.cone.gate_height_m", "guidance.cone.commit_rate_m_s"):
        inner["commit_s"] = 30.0
    for table in reversed(tables):
        inner = {table: inner}
    return from_mapping(minimal() | inner, "x")


@pytest.mark.parametrize("sound", SOUND, ids=lambda sound: sound.key)
def test_a_limit_that_is_wider_than_its_meaning_is_named_with_the_reason(sound: Sound) -> None:
    field = dict(schema.walk(Settings, "ardrone"))[sound.key]
    assert isinstance(field.type, msgspec.inspect.Metadata)
    kind = field.type.type
    assert isinstance(kind, msgspec.inspect.FloatType | msgspec.inspect.IntType)
    assert kind.le is not None
    settings = widened(sound.key, int(kind.le) if isinstance(kind, msgspec.inspect.IntType) else float(kind.le))
    (line,) = [line for line in remarks(settings) if sound.key in line]
    assert line.startswith(f"{in_file(sound.key)} is {kind.le:g}, beyond ")
    assert sound.beyond in line
    assert f"{in_file(sound.key)} is" not in "".join(beyond_sound(widened(sound.key, field.default))), "the default is sound"


@pytest.mark.parametrize(("aside_m", "named"), [(0.13, False), (0.20, True)])
def test_feet_that_nearly_fill_the_pad_are_named_and_bound_the_landing(aside_m: float, *, named: bool) -> None:
    settings = widened("guidance.cone.feet_aside_m", aside_m)
    assert any("nearly fill this pad" in line for line in remarks(settings)) == named
    corners = aside_m * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
    aside = corners + rim_m(settings) * np.array([1, 1]) / math.sqrt(2.0)
    assert np.hypot(*aside.T).max() == pytest.approx(pad_model(settings).disc_radius_m), "the worst heading reaches the rim"
    assert make_pilot(settings).landing._rim_m == rim_m(settings)


@pytest.mark.parametrize(
    ("link", "bus", "named"),
    [
        ("ttyUSB0", "ttyUSB1", True),
        ("ttyACM0", "ttyUSB0", True),
        ("ttyAMA0", "ttyUSB0", False),
        ("serial/by-id/a", "ttyUSB0", False),
    ],
)
def test_two_serial_adapters_named_by_numbers_may_change_places(link: str, bus: str, named: bool) -> None:
    rig = minimal("mavlink", vehicle__links=f"serial:///dev/{link}:57600", vessel__bus=f"serial:///dev/{bus}:115200")
    assert any("may change places" in line for line in remarks(from_mapping(rig, "x"))) == named


def test_an_autopilots_vehicle_on_an_ardrones_feet_is_named() -> None:
    def said(profile: Any, feet_m: float) -> str:
        guidance = {"guidance": {"cone": {"feet_below_m": feet_m}}}
        return "".join(remarks(from_mapping(minimal(profile) | guidance, "x")))

    assert "guidance.cone.feet_below_m is 0.045 m, an AR.Drone's" in said("mavlink", 0.045)
    assert "feet_below_m" not in said("mavlink", 0.1) + said("ardrone", 0.045)


@pytest.mark.parametrize(
    ("height_m", "pad_up_m", "said"),
    [
        (0.0, 0.0, "set latitude_deg, longitude_deg and height_m"), (7.0, 0.0, "15 m over the sea"),
        (18.0, 14.0, "20 m over the sea"), (20.0, 14.0, ""), (15.0, 0.0, ""),
    ],
)  # fmt: skip
def test_a_drone_that_flies_elsewhere_flies_over_the_masts(height_m: float, pad_up_m: float, said: str) -> None:
    there = {"latitude_deg": 54.1, "longitude_deg": 10.2, "height_m": height_m}
    data = minimal("mavlink") | {"guidance": {"refused": "land elsewhere", "elsewhere": there}, "vessel": {"pad_up_m": pad_up_m}}
    if said:
        with pytest.raises(BadInput, match=said):
            complete(from_mapping(data, "x"), Path("rig.toml"))
    else:
        assert complete(from_mapping(data, "x"), Path("rig.toml")).guidance.elsewhere.height_m == height_m


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("guidance.rendezvous.enabled = true", "where the ship is: set a source (vessel.nmea, vessel.bus, vessel.mqtt)"),
        ('vessel.nmea = "127.0.0.1:10110"', "vessel.nmea: the ship's velocity and heading are used, her place is not"),
        (
            'vessel.nmea = "127.0.0.1:10110"\nvessel.mmsi = 211234560\nguidance.rendezvous.enabled = true',
            "expert.vessel.age_max_s is 5 s, but AIS reports of a ship under way come every 10 s",
        ),
        ('vessel.nmea = "127.0.0.1:10110"\nguidance.rendezvous.enabled = true', None),
    ],
)
def test_what_does_not_go_together_is_reported(lines, said, tmp_path, capsys):
    file = tmp_path / "own.toml"
    file.write_text(f'vehicle.kind = "ardrone"\ncamera.file = "sim"\npad.file = "thesis"\n{lines}\n')
    assert cli.main(["config", "check", str(file)]) == 0
    reported = capsys.readouterr().out.splitlines()[1:]
    assert [line for line in reported if said is not None and said in line] == reported
    assert len(reported) == (0 if said is None else 1)


@pytest.mark.parametrize("sigma_rad", [0.03, EkfOptions().sigma_attitude_bias_rad])
def test_where_an_autopilot_flies_what_the_file_says_wins_and_silence_is_an_autopilot_s(sigma_rad):
    """WHY: a key that a file set to an AR.Drone's default was taken for silence, and replaced."""
    of_autopilot = from_mapping(minimal("mavlink"), "default")
    output = {"guidance": {"tries": {"heading": "keep"}}, "estimator": {"ekf": {"sigma_attitude_bias_rad": sigma_rad}}}
    given = from_mapping({**minimal("mavlink"), **output}, "given")
    assert given.guidance.tries.heading == "keep"
    assert given.estimator.ekf == msgspec.structs.replace(of_autopilot.estimator.ekf, sigma_attitude_bias_rad=sigma_rad)


@pytest.mark.parametrize("kind", [AutopilotOptions, BridgeOptions])
def test_links_are_signed_with_one_key_and_ids_of_their_own(tmp_path, kind):
    key, time = tmp_path / "link.key", tmp_path / "time"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    urls = "tcp://127.0.0.1:1, tcp://127.0.0.1:2"
    first, second = signed_links(kind(links=urls, signing_key_file=str(key), signing_time_file=str(time)))
    assert first.signing.key().secret == bytes(range(32))
    assert (first.signing.link_id, second.signing.link_id) == (0, 1)
    assert first.signing.times is second.signing.times
    first.signing.times.next()
    first.signing.times.close()
    assert time.exists()
    credential = kind(links=urls, signing_key_file="credential:link.key")
    environment = {"CREDENTIALS_DIRECTORY": str(tmp_path), "STATE_DIRECTORY": str(tmp_path / "state")}
    signing = signed_links(credential, environment)[0].signing
    signing.times.next()
    signing.times.close()
    assert (tmp_path / "state/mavlink-signing-time").exists()
    with pytest.raises(BadInput, match="signing key"):
        signed_links(kind(links=urls, signing_key_file=str(tmp_path / "none")))
    assert signed_links(BridgeOptions()) == ()


@pytest.mark.parametrize(
    ("links", "level"), [("udpin://0.0.0.0:14550", "WARNING"), ("serial:///dev/ttyAMA0:57600, tcp://127.0.0.1:5760", "INFO")]
)
def test_links_that_are_not_signed_are_reported_with_the_cure(links, level, caplog, capsys, tmp_path):
    caplog.set_level("INFO")
    signed_links(AutopilotOptions(links))
    assert [r.levelname for r in caplog.records if "decklander keys make" in r.getMessage()] == [level]
    file = tmp_path / "build.toml"
    begins = '[operator.switch]\nchannel = 7\n[operator.handover]\nafter = "mission"\n'
    file.write_text(AUTOPILOT.replace("serial:///dev/ttyAMA0:921600", links) + begins)
    assert cli.main(["run", "--config", str(file), "--check"]) == 0
    output = capsys.readouterr().out
    assert "not signed: decklander keys make" in output
    assert "commands from the autopilot's own link" in output
    assert "; switch of channel 7 (low hold, middle stay, high begin); by itself after the autopilot's own mission\n" in output


def test_a_key_is_looked_up_by_a_part_of_it(capsys) -> None:
    assert cli.main(["config", "reference", "cone.gate_height"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("guidance.cone.gate_height_m = 0.25    (0.1 to 3 m)\n    height of the feet"), out
    assert out.count("\n") == 2
    assert cli.main(["config", "reference", "no_such_key"]) == 2


def test_all_faults_of_a_file_are_named_in_one_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rig.toml"
    text = MINIMAL.replace('"sim"', '"nosuch"', 1) + '\n[recorder]\nfolder = 3\nnosuch = 1\n[http]\naddress = "127.0.0.1:99999"\n'
    path.write_text(text)
    assert cli.main(["config", "check", str(path)]) == 2
    named = capsys.readouterr().err
    for key in ("camera.file", "recorder.folder", "recorder.nosuch", "http.address"):
        assert named.count(f"rig.toml: {key}") == 1, named
