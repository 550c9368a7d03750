"""Parts from settings: no key without an effect, and defaults that are the parts' own."""

import dataclasses
import math
from typing import Any

import msgspec
import numpy as np
import pytest
from msgspec import inspect

from companion.cli.main import main
from companion.guidance.make_pilot import estimator_options, tracker
from companion.parts.mavlink.signed_links import signed_links
from companion.settings.load import Settings, from_mapping
from companion.settings.mavlink import BridgeOptions
from companion.settings.model import ardrone_options
from companion.settings.refusal import walk
from drivers.mavlink.options import AutopilotOptions
from estimator.contracts.errors import BadInput
from estimator.ekf import EkfOptions

READ_BY_THE_SERVICE_ITSELF = {
    "vehicle.kind", "vision.threads", "guidance.start", "guidance.rate_hz",
}  # fmt: skip
TAKEN_WHOLE = (
    "mqtt.", "http.", "video_stream.", "recorder.", "service.", "camera.", "vehicle.", "landing_target.",
    "bridge.", "operator.", "limits.", "vessel.",
)  # fmt: skip
"""Sections that a part takes as they are."""
MINIMAL = {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}}
MINIMALS = {"ardrone": MINIMAL, "mavlink": MINIMAL | {"vehicle": {"kind": "mavlink", "links": "tcp://127.0.0.1:5760"}}}


def parts(settings: Settings) -> list[object]:
    return [
        plain(part)
        for part in (
            tracker(settings), estimator_options(settings), settings.guidance,
            settings.guidance, settings.camera.file,
        )
    ]  # fmt: skip


def plain(value: Any) -> Any:
    """Options as nested tuples that compare by value."""
    if isinstance(value, msgspec.Struct):
        return tuple((name, plain(getattr(value, name))) for name in value.__struct_fields__)
    if dataclasses.is_dataclass(value):
        return tuple((f.name, plain(getattr(value, f.name))) for f in dataclasses.fields(value))
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return tuple(value.items())
    return tuple(map(plain, value)) if isinstance(value, tuple) else value


def other(field: inspect.Field, path: str, present: object) -> object:
    """Return a good value that is not the present one."""
    bare = field.type.type if isinstance(field.type, inspect.Metadata) else field.type
    if path == "estimator.ekf.gate_probability":
        return 1e-3
    if path == "estimator.ekf.velocity_is_over":
        return "pad"
    if path == "guidance.refused":
        return "hold" if present == "return" else "return"
    if path == "camera.file":
        return "photos"
    if path == "pad.file":
        return "printed"
    match bare:
        case inspect.LiteralType(values=values):
            return next(v for v in values if v != present)
        case inspect.FloatType(le=high) | inspect.IntType(le=high):
            step = field.default * 1.01 if isinstance(bare, inspect.FloatType) else field.default + 1
            assert high is not None
            if field.default == high:
                return type(high)(high / 2)
            return min(step, high) if field.default else high / 2 if isinstance(bare, inspect.FloatType) else high // 2
        case inspect.BoolType():
            return not field.default
    return "elsewhere"


@pytest.mark.parametrize("kind", MINIMALS)
def test_every_key_reaches_a_part(kind: str) -> None:
    before = parts(from_mapping(MINIMALS[kind], "default"))
    for path, field in walk(Settings, kind):
        if path in READ_BY_THE_SERVICE_ITSELF or path.startswith(TAKEN_WHOLE):
            continue
        table = data = msgspec.to_builtins(from_mapping(MINIMALS[kind], "default"))
        *tables, last = path.split(".")
        for name in tables:
            table = table[name]
        table[last] = other(field, path, table[last])
        assert parts(from_mapping(data, "changed")) != before, path


def test_degrees_in_the_file_are_radians_inside() -> None:
    data = msgspec.to_builtins(from_mapping(MINIMAL, "default"))
    data["vehicle"].update(euler_angle_max_deg=18.0, yaw_rate_max_deg_s=90.0)
    data["guidance"]["pid"]["turn_max_deg_s"] = 45.0
    settings = from_mapping(data, "degrees")
    assert math.isclose(ardrone_options(settings).euler_angle_max_rad, math.pi / 10)
    assert math.isclose(ardrone_options(settings).yaw_rate_max_rad_s, math.pi / 2)
    assert math.isclose(settings.guidance.pid.turn_max_rad_s, math.pi / 4)


@pytest.mark.parametrize("minimal", [MINIMAL, MINIMALS["mavlink"]])
@pytest.mark.parametrize("sigma_rad", [0.03, EkfOptions().sigma_attitude_bias_rad])
def test_where_an_autopilot_flies_what_the_file_says_wins_and_silence_is_an_autopilot_s(minimal, sigma_rad):
    """WHY: a key that a file set to an AR.Drone's default was taken for silence, and replaced."""
    of_autopilot = from_mapping(MINIMALS["mavlink"], "default")
    output = {"guidance": {"tries": {"heading": "keep"}}, "estimator": {"ekf": {"sigma_attitude_bias_rad": sigma_rad}}}
    given = from_mapping({**minimal, **output}, "given", by_autopilot=True)
    assert given.guidance.tries.heading == "keep"
    assert given.estimator.ekf == msgspec.structs.replace(of_autopilot.estimator.ekf, sigma_attitude_bias_rad=sigma_rad)
    silent = from_mapping(minimal, "silent", by_autopilot=True)
    assert (silent.guidance, silent.estimator) == (of_autopilot.guidance, of_autopilot.estimator)


@pytest.mark.parametrize("kind", [AutopilotOptions, BridgeOptions])
def test_links_are_signed_with_one_key_and_ids_of_their_own(tmp_path, kind):
    key, time = tmp_path / "link.key", tmp_path / "time"
    key.write_bytes(bytes(range(32)))
    key.chmod(0o600)
    urls = "tcp://127.0.0.1:1, tcp://127.0.0.1:2"
    first, second = signed_links(kind(links=urls, signing_key_file=str(key), signing_time_file=str(time)))
    assert first.signing is not None
    assert second.signing is not None
    assert first.signing.key.secret == bytes(range(32))
    assert (first.signing.link_id, second.signing.link_id) == (0, 1)
    assert first.signing.times is second.signing.times
    first.signing.times.next()
    first.signing.times.close()
    assert time.exists()
    credential = kind(links=urls, signing_key_file="credential:link.key")
    environment = {"CREDENTIALS_DIRECTORY": str(tmp_path), "STATE_DIRECTORY": str(tmp_path / "state")}
    signing = signed_links(credential, environment)[0].signing
    assert signing is not None
    signing.times.next()
    signing.times.close()
    assert (tmp_path / "state/mavlink-signing-time").exists()
    with pytest.raises(BadInput, match="signing key"):
        signed_links(kind(links=urls, signing_key_file=str(tmp_path / "none")))
    assert signed_links(BridgeOptions()) == ()


CAMERA = '[camera]\nfile = "sim"\nsource = "stream"\ndevice = "rtsp://127.0.0.1/cam"\n'


@pytest.mark.parametrize(
    ("links", "level"), [("udpin://0.0.0.0:14550", "WARNING"), ("serial:///dev/ttyAMA0:57600, tcp://127.0.0.1:5760", "INFO")]
)
def test_links_that_are_not_signed_are_reported_with_the_cure(links, level, caplog, capsys, tmp_path):
    caplog.set_level("INFO")
    signed_links(AutopilotOptions(links))
    assert [r.levelname for r in caplog.records if "decklander keys make" in r.getMessage()] == [level]
    file = tmp_path / "build.toml"
    file.write_text(f'[vehicle]\nkind = "mavlink"\nlinks = "{links}"\n{CAMERA}[pad]\nfile = "thesis"\n')
    assert main(["run", "--config", str(file), "--check"]) == 0
    output = capsys.readouterr().out
    assert "not signed: decklander keys make" in output
    assert "commands from the autopilot's own link" in output
