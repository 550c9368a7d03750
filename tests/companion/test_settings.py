"""Settings: what is refused and how that reads, what comes back unchanged, and that the pages follow the model."""

import json
import math
import os
import re
import time
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import settings as runs
from hypothesis import strategies as st
from msgspec import inspect

from companion.cli import main as cli
from companion.settings import whole_file
from companion.settings.load import (
    SHIPPED,
    Settings,
    camera_model,
    from_file,
    from_mapping,
    load,
    pad_model,
    pad_of_file,
    shipped,
    toml_of,
)
from companion.settings.refusal import walk
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput

ROOT = Path(__file__).parents[2]
MINIMAL = '[vehicle]\nkind = "ardrone"\n[camera]\nfile = "sim"\n[pad]\nfile = "thesis"\n'
AUTOPILOT = MINIMAL.replace('"ardrone"', '"mavlink"\nlinks = "serial:///dev/ttyAMA0:921600"').replace(
    'file = "sim"', 'file = "sim"\nsource = "v4l2"\ndevice = "Test camera"'
)
MINIMALS = {"ardrone": MINIMAL, "mavlink": AUTOPILOT}
KEYS = dict(walk(Settings))


def numeric(field: inspect.Field) -> inspect.FloatType | inspect.IntType | None:
    bare = field.type.type if isinstance(field.type, inspect.Metadata) else field.type
    return bare if isinstance(bare, inspect.FloatType | inspect.IntType) else None


NUMBERS = {path: numeric(field) for path, field in KEYS.items() if numeric(field)}


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
    text = str(caught.value)
    assert "\n" not in text
    return text


@pytest.mark.parametrize("rig", shipped())
def test_shipped_rigs_are_good_and_name_real_cameras_and_pads(rig: str) -> None:
    settings = load(rig)
    assert camera_model(settings).width == (176 if rig == "ardrone1" else 640)
    assert pad_model(settings).disc_radius_m == pytest.approx(0.39, abs=0.02)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"guidance__pid__horizontal__kp": "fast"}, 'guidance.pid.horizontal.kp must be a number from 0 to 20 1/s, found "fast"'),
        ({"guidance__pid__turn_max_deg_s": 720}, "guidance.pid.turn_max_deg_s must be a number from 1 to 360 deg/s, found 720"),
        ({"guidance__thesis__speed_m_s": True}, "guidance.thesis.speed_m_s must be a number from 0.05 to 5 m/s, found true"),
        ({"guidance__rate_hz": 10**400}, f"guidance.rate_hz must be a number from 5 to 200 Hz, found 1{'0' * 56}..."),
        ({"vision__threads": 2.0}, "vision.threads must be a whole number from 1 to 64 threads, found 2.0"),
        ({"vehicle__at_port": 0}, "vehicle.at_port must be a whole number from 1 to 65535, found 0"),
        ({"vehicle__host": ""}, 'vehicle.host must be text of 1 to 253 characters, found ""'),
        ({"vision__learned": "on"}, 'vision.learned must be one of "off", "second_opinion", found "on"'),
        ({"vision__colours": "sim"}, 'vision.colours must be one of "indoor", "outdoor", "simulator", found "sim"'),
        ({"vehicle__kind": "balloon"}, 'vehicle.kind must be one of "ardrone", "mavlink", found "balloon"'),
        ({"vehicle__hots": "x"}, "vehicle.hots is not a known key; did you mean vehicle.host?"),
        ({"guidance__speed_m_s": 1.0}, "guidance.speed_m_s is not a known key here; did you mean guidance.thesis.speed_m_s?"),
        (
            {"a b": 1},
            '"a b" is not a known key; known here are vehicle, camera, pad, vision, estimator, guidance, service, recorder, '
            "mqtt, http, video_stream, landing_target, bridge, operator, limits, vessel",
        ),
        ({"line\nbreak ` - at `$.vehicle.host`": 1}, None),
        ({"vision": 3}, "vision must be a table of keys, found 3"),
        ({"guidance__pid": [1]}, "guidance.pid must be a table of keys, found a list"),
        ({"camera": {}}, "camera.file is missing: it must be text of 1 to 4096 characters"),
        (
            {"guidance__thesis__final_height_m": 2.5},
            "guidance.thesis: final_height_m (2.5 m) must be below approach_height_m (2 m)",
        ),
        ({"service__restart_first_s": 9}, "service: restart_cap_s (5 s) must not be shorter than restart_first_s (9 s)"),
    ],
)
def test_a_refusal_names_file_key_unit_range_and_what_was_found(changes: dict[str, Any], text: str | None) -> None:
    output = refusal(minimal(**changes))
    assert output.startswith("rig.toml: ")
    assert text in (None, output.removeprefix("rig.toml: "))


def test_a_missing_table_says_what_it_needs() -> None:
    assert refusal({"vehicle": {"kind": "ardrone"}, "pad": {"file": "thesis"}}) == (
        "rig.toml: the table [camera] is missing; it needs file"
    )


def test_every_number_refuses_nan_infinities_and_what_lies_outside_its_range() -> None:
    for path, kind in NUMBERS.items():
        assert kind is not None
        assert None not in (kind.ge, kind.le), path
        for bad in (math.nan, math.inf, -math.inf, kind.ge - 1, kind.le + 1, "1", True):
            assert path in refusal(minimal(KIND_OF[path], **{path.replace(".", "__"): bad})), (path, bad)


UNITS = {
    "s": "_s", "m": "_m", "m/s": "_m_s", "m/s^2": "_m_s2", "deg": "_deg", "deg/s": "_deg_s", "Hz": "_hz", "port": "_port",
    "1/s": "_1_s", "1/s^2": "_1_s2", "threads": "threads", "samples": ("_items", "_samples"),
    "rad": "_rad", "rad/s": "_rad_s", "rad/s/sqrt(Hz)": "_rad_s", "rad/s^2/sqrt(Hz)": "_rad_s2", "m/s^2/sqrt(Hz)": "_m_s2",
    "m/s^3/sqrt(Hz)": "_m_s3", "m/sqrt(s)": "_m", "s/sqrt(s)": "_s_sqrt_s", "rad/sqrt(s)": "_rad_sqrt_s", "1/sqrt(s)": "",
    "id": "_id", "ppm": "_ppm", "MB": "_mb", "KiB": "_kib", "records": "_records", "frames": "_frames", "kbit/s": "_kbit_s",
    "px": "_px", "K": "_k",
}  # fmt: skip
GAINS_AND_RATIOS = {
    "core_fraction", "slope", "gain_ratio", "battery", "mmsi", "return_charge", "take_off_charge_min", "last_charge", "kp",
    "ki", "kd", "normalized_nis", "velocity_scale", "velocity_lead", "slow_floor", "soft_least", "restart_factor",
    "restart_give_up_after", "request_tries", "peers_max", "viewers_max", "buffers", "sigma_velocity_scale",
    "sigma_velocity_fraction", "sigma_range_fraction", "gate_probability", "view_still_ratio", "place_step_fraction",
    "reopen_count", "leap_count", "min_confidence", "jpeg_quality", "frames_each", "range_tolerance_fraction", "losses_max",
    "go_arounds_max",
}  # fmt: skip


def test_every_key_is_explained_and_a_number_carries_its_unit_in_its_name() -> None:
    for path, key in KEYS.items():
        field = key.type
        assert isinstance(field, inspect.Metadata), f"{path} has neither meaning nor range"
        notes = field.extra_json_schema or {}
        assert len(notes["description"]) > 8, path
        if path in NUMBERS:
            name = path.rpartition(".")[2]
            assert name in {*GAINS_AND_RATIOS, notes["x-unit"]} or name.endswith(UNITS[notes["x-unit"]]), path


@st.composite
def good_settings(draw: st.DrawFn) -> Settings:
    kind = draw(st.sampled_from(sorted(MINIMALS)))
    data = minimal(kind)
    for path, field in walk(Settings, kind):
        if path.endswith(("links", "operators", "configuration_ids", "further_configuration")) or draw(st.booleans()):
            continue
        bare = field.type.type if isinstance(field.type, inspect.Metadata) else field.type
        match bare:
            case inspect.FloatType(ge=low, le=high):
                value: Any = draw(st.floats(low, high))
            case inspect.IntType(ge=low, le=high):
                value = draw(st.integers(low, high))
            case inspect.BoolType():
                value = draw(st.booleans())
            case inspect.LiteralType(values=values):
                value = draw(st.sampled_from(values))
            case inspect.StrType(pattern=str(pattern)):
                value = draw(st.from_regex(pattern, fullmatch=True))
            case _:
                value = draw(st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=40))
        *tables, last = path.split(".")
        table = data
        for name in tables:
            table = table.setdefault(name, {})
        table[last] = value
    estimator, service = data.setdefault("estimator", {}), data.setdefault("service", {})
    guidance = data.setdefault("guidance", {})
    estimator.update(max_delay_s=0.5, history_s=1.0)
    estimator.setdefault("ekf", {}).update(gate_probability=1e-3)
    service.update(restart_first_s=0.1, restart_cap_s=1.0)
    data.setdefault("recorder", {}).update(max_file_mb=1.0, max_total_mb=10.0, retry_s=0.1, retry_cap_s=1.0)
    data.setdefault("mqtt", {}).update(reconnect_first_s=0.1, reconnect_cap_s=1.0, user="a", certificate_file="", key_file="")
    data["mqtt"].update(commands="off", command_key_file="")
    data.setdefault("http", {}).update(endpoint="off")
    data.setdefault("video_stream", {}).update(to="")
    data["vehicle"].pop("vessel_id", None)
    for table in (data["vehicle"], data.setdefault("bridge", {})):
        if table is not data["vehicle"] or kind == "mavlink":
            table.update(restart_first_s=0.1, restart_most_s=1.0)
    data.setdefault("operator", {}).update(socket="auto")
    data.setdefault("limits", {}).update(fence_polygon="")
    data.setdefault("vessel", {}).update(age_max_s=5.0, forget_s=30.0, nmea="", nmea_from="", mmsi=0, mqtt=False)
    data["camera"].update(reconnect_first_s=0.1, reconnect_most_s=1.0, controls="", device="usb")
    data["camera"].setdefault("gimbal", {}).update(device_id=154)
    sources = [{"source": "v4l2"}, {"source": "gstreamer"}, {"source": "stream"}, {"source": "vehicle", "device": ""}]
    data["camera"].update(draw(st.sampled_from(sources)))
    if data["camera"]["source"] != "v4l2":
        data["camera"].setdefault("exposure", {}).update(mode="camera")
    if data["camera"]["source"] != "gstreamer":
        data["camera"].update(latency_s=abs(data["camera"].get("latency_s", 0.0)))
    guidance.setdefault("thesis", {}).update(final_height_m=0.2, approach_height_m=1.0)
    guidance.setdefault("rendezvous", {}).update(reached_m=1.0, range_m=8.0, spacing_m=2.0, extent_m=10.0)
    guidance.setdefault("tries", {}).update(climb_after_s=1.0, give_up_after_s=9.0)
    guidance.setdefault("elsewhere", {}).update(latitude_deg=54.0, longitude_deg=8.0, height_m=20.0)
    guidance.setdefault("cone", {}).update(gate_height_m=0.3, commit_rate_m_s=0.4, commit_s=3.0)
    return from_mapping(data, "drawn")


@given(good_settings())
@runs(max_examples=30)
def test_what_show_prints_reads_back_as_the_same_settings(drawn: Settings) -> None:
    assert from_file(tomllib.loads(whole_file.toml(drawn)), "shown") == drawn


junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from([*"abc", *{n for p in KEYS for n in p.split(".")}]), inner)
    ),
    max_leaves=12,
)


def test_the_kind_of_vehicle_decides_which_keys_there_are(tmp_path: Path) -> None:
    for kind, other_key in (("ardrone", "links"), ("mavlink", "host")):
        output = refusal(minimal(kind, **{f"vehicle__{other_key}": "tcp://127.0.0.1:5760"}))
        assert output.endswith(f"vehicle.{other_key} is not a known key of this kind of vehicle")
    assert refusal({**minimal(), "vehicle": {}}).endswith('vehicle.kind is missing: it must be one of "ardrone", "mavlink"')
    assert refusal({**minimal(), "vehicle": {"kind": "mavlink"}}).endswith(
        "vehicle.links is missing: it must be text of 1 to 4096 characters"
    )
    assert "'udp' should be" not in refusal(minimal("mavlink", vehicle__links="udp:14550"))
    assert "links: MAVLink link 'udp:14550': write udpin://" in refusal(minimal("mavlink", vehicle__links="udp:14550"))
    for text in ("0", "256", "255/0", "station"):
        assert "operators: operator" in refusal(minimal("mavlink", vehicle__links="udpin://0.0.0.0:1", vehicle__operators=text))
    assert "vessel_id must not be" in refusal(minimal("mavlink", vehicle__vessel_id=3, vehicle__system_id=3))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            ('source = "v4l2"\ndevice = "Test camera"', ""),
            'camera.source must be "v4l2", "gstreamer" or "stream": an autopilot has no frames',
        ),
        (
            ('source = "v4l2"\ndevice = "Test camera"', 'source = "stream"\ndevice = "a.mp4"\n[camera.exposure]\nmode = "pad"'),
            'camera.exposure.mode must be "camera" with camera.source "stream": only that of a camera with source "v4l2"',
        ),
        (
            ('device = "Test camera"', 'device = "a"\ncontrols = "gain=4"\n[camera.exposure]\nmode = "pad"'),
            'camera: controls: exposure.mode "pad" sets \'gain\': leave it out, or let exposure.mode be "camera"',
        ),
        (("[camera]", '[bridge]\nlinks = "udpin://0.0.0.0:14550"\n[camera]'), "bridge.links must be empty"),
    ],
)
def test_what_an_autopilot_does_not_go_with(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(AUTOPILOT)
    assert load(file).fault() is None
    file.write_text(AUTOPILOT.replace(*change))
    with pytest.raises(BadInput, match=f"^{file}: {said}"):
        load(file)


def test_keys_of_links_are_relative_to_the_settings_file(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    more = 'signing_key_file = "link.key"\n[camera]'
    file.write_text(AUTOPILOT.replace("[camera]", more))
    vehicle = load(file).vehicle
    assert isinstance(vehicle, AutopilotOptions)
    assert vehicle.signing_key_file == str(tmp_path / "link.key")


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


def test_camera_and_pad_paths_are_relative_to_the_settings_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = tmp_path / "rigs" / "mine.toml"
    rig.parent.mkdir()
    rig.write_text(MINIMAL.replace('"sim"', '"../lens.toml"'))
    (tmp_path / "lens.toml").write_text((ROOT / "configs/cameras/sim.toml").read_text().replace("width = 640", "width = 800"))
    monkeypatch.chdir(ROOT)
    settings = load(rig)
    assert camera_model(settings).width == 800
    assert settings.pad.file == "thesis"


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ('"sin"', "camera.file: there is no file 'sin' and no shipped one of that name (did you mean 'sim')"),
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


def test_a_recording_may_have_a_key_on_either_side_of_expert() -> None:
    for guidance in ({"guidance": {"rate_hz": 25.0}}, {"expert": {"guidance": {"rate_hz": 25.0}}}):
        assert from_mapping({**minimal(), **guidance}, "a recording", recorded=True).guidance.rate_hz == 25.0


def test_a_user_sees_at_most_130_keys() -> None:
    public = (ROOT / "docs/configuration.md").read_text().partition("## Expert keys")[0]
    assert len(re.findall(r"^\| `\w+` \|", public, re.MULTILINE)) <= 130


def test_the_schema_lists_every_key_with_its_unit() -> None:
    schema = json.loads(whole_file.schema())
    cone = schema["$defs"]["ConeOptions"]
    assert cone["properties"]["descent_rate_m_s"]["x-unit"] == "m/s"
    assert cone["additionalProperties"] is False
    assert schema["$defs"]["Settings"]["required"] == ["vehicle", "camera", "pad"]


def test_the_reference_page_is_what_the_model_says() -> None:
    page = (ROOT / "docs/configuration.md").read_text()
    assert page == whole_file.reference(), "run: decklander config reference > docs/configuration.md"


def test_settings_cannot_be_changed_after_loading() -> None:
    settings = from_mapping(minimal(), "rig.toml")
    with pytest.raises(AttributeError):
        settings.vision.threads = 4  # type: ignore[misc]
    assert msgspec.structs.replace(settings.vision, threads=4).threads == 4


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
        (MINIMAL.replace('"sim"', '"/dev/zero"'), "a device or a pipe"),
        (MINIMAL + '[http]\nendpoint = "http"\ntoken_file = "/dev/zero"\n', "a device or a pipe"),
        ("a" + ".a" * 50_000 + " = 1\n", "a key of more than 50 parts"),
        ("a" + ".'a'" * 200 + " = 1\n", "a key of more than 50 parts"),
        ("# " + "x" * 1_000_000, "such a file has at most 1000000"),
    ],
)
def test_no_file_that_settings_name_is_endless_large_or_slow(text, said, tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    rig.write_text(text)
    began_s = time.process_time()
    assert cli.main(["config", "check", str(rig)]) == 2
    assert time.process_time() - began_s < 2.0
    assert said in capsys.readouterr().err


def test_a_pipe_and_a_device_are_no_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    for name in (str(tmp_path / "pipe.toml"), "/dev/zero"):
        assert cli.main(["config", "check", name]) == 2
        output = capsys.readouterr().err
        assert len(output.splitlines()) == 1


def test_long_rows_of_numbers_and_texts_with_dots_are_no_deep_keys() -> None:
    text = f"x = [{', '.join(['0.125'] * 400)}]\ny = \"{'a.b ' * 400}\"\nz = '''\n{'One. Two. ' * 20}\n'''\n"
    assert toml_of(text, Path("x"))["x"][-1] == 0.125
