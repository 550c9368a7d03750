"""The tools of the page on the ground alone: the doctor over the links that the service has open, and a calibration."""

import asyncio
import errno
import re
import shutil
import socket
import subprocess
import sys
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from companion.cli.calibrate import block
from companion.parts.page import calibration_tool, doctor_tool
from companion.parts.page.access import own_names, refused_origin
from companion.parts.page.endpoint import picture_lines
from companion.parts.page.settings_tool import check, line_of, unmasked
from companion.settings import schema
from companion.settings.links import HttpSettings
from companion.settings.load import camera_model, load, pad_model
from companion.settings.model import Settings, in_file
from companion.settings.settings_file import SettingsFile
from companion.tools.calibrate.board import Board
from companion.tools.calibrate.guide import Guide
from companion.tools.doctor import rules_values
from companion.tools.doctor.diagnose import PARAMETERS
from companion.tools.report.overlay import camera_lean
from drivers.clock import SystemClock
from drivers.mavlink import samples
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Condition, Stack
from estimator.contracts.address import masked
from estimator.contracts.errors import BadInput
from estimator.contracts.estimates import FusionResult, RelativeState, Verdict
from estimator.contracts.geometry import Rotation
from estimator.contracts.samples import Attitude
from estimator.contracts.time import MonoNs
from estimator.vision.camera.camera import Camera
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.doctor.test_rules import ARDUPILOT, defaults
from tests.make import seen
from tests.support.calibration_images import Studio, good_round, lens
from tests.support.page_service import Browser, browsing, serving
from tests.support.waiting import until


def with_fault() -> dict[str, float]:
    good = {r.parameter: r.good for r in rules_values.RULES if r.stack == "ArduPilot"}
    own = {n: ARDUPILOT.parameters.get(n, good.get(n, 0.0)) for n in PARAMETERS["ArduPilot"]} | {"PLND_TYPE": 2.0}
    return defaults("ArduPilot") | own


@asynccontextmanager
async def flown_by(fake: MiniatureAutopilot) -> AsyncIterator[Autopilot]:
    """Open the autopilot as the service does, with none of its parameters known."""
    async with fake.talking_to("udpin://127.0.0.1:0"):
        await until(lambda: fake.links is not None and fake.links.all[0].local is not None)
        _, port = fake.links.all[0].local or ("", 0)
        options = AutopilotOptions(f"udpout://127.0.0.1:{port}", silence_s=1.0, command_period_s=0.01)
        async with open_autopilot(options, SystemClock()) as autopilot:
            await until(lambda: autopilot.connected)
            yield autopilot


def reads_of(fake: MiniatureAutopilot) -> int:
    """Return the parameters that were requested, beside those that the driver reads on each connect."""
    asked = [message.param_id for message in fake.messages if message.get_type() == "PARAM_REQUEST_READ"]
    return sum(name not in samples.SAMPLE_PARAMETERS[Stack.ARDUPILOT] for name in asked)


async def test_findings_come_from_the_open_links_and_only_on_the_ground(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor_tool, "LISTENING_S", 0.5)
    fake = MiniatureAutopilot(parameters=with_fault())
    async with (
        flown_by(fake) as autopilot,
        serving(tmp_path, autopilot=autopilot) as service,
        browsing(service) as browser,
        browsing(service) as other,
    ):
        await browser.send(kind="examine")
        assert "the vehicle flies" in (await browser.read("examined"))["text"]
        assert reads_of(fake) == 0, "in flight nothing is asked"
        await service.lands()
        await browser.send(kind="examine")
        assert (await browser.read("examined"))["busy"]
        await other.send(kind="examine")
        assert (await other.read("examined"))["busy"]
        found, same = await asyncio.gather(browser.read("examined"), other.read("examined"))
        rules = {finding["rule"]: finding for finding in found["findings"]}
        assert rules["plnd-type"]["severity"] == "error"
        assert "PLND_TYPE" in rules["plnd-type"]["fix"]
        assert f"{len(with_fault())} parameters" in found["text"]
        assert same["findings"] == found["findings"], "one examination serves both"
        asked = reads_of(fake)
        await browser.send(kind="examine")
        assert (await browser.read("examined"))["findings"] == found["findings"]
        assert reads_of(fake) == asked, "another one within seconds asks the autopilot nothing"
        assert autopilot._listeners == []


async def test_a_take_off_ends_an_examination(tmp_path: Path) -> None:
    fake = MiniatureAutopilot(parameters=with_fault())
    async with flown_by(fake) as autopilot, serving(tmp_path, autopilot=autopilot) as service, browsing(service) as browser:
        await service.lands()
        await browser.send(kind="examine")
        assert (await browser.read("examined"))["busy"]
        service.flying = True
        assert (await browser.read("examined"))["text"] == doctor_tool.EXAMINATION_ENDED
        assert autopilot.parameters.settled, "nothing more is asked"
        assert autopilot._listeners == []


async def test_a_service_without_an_autopilot_is_examined_too(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, browsing(service) as browser:
        (tmp_path / "token").unlink()
        await service.lands()
        await browser.send(kind="examine")
        await browser.read("examined")
        found = await browser.read("examined")
        assert [finding["rule"] for finding in found["findings"]] == ["settings-files"]
        assert found["text"].startswith("1 of ")


RIG = """# the rig
[vehicle]
kind = "ardrone"

[camera]
file = "sim"
source = "stream"
device = "rtsp://admin:hunter2@10.0.0.8/live?token=s3cret"

[pad]
file = "thesis"

[guidance]
start = "signal"

[expert.guidance]
rate_hz = 20.0
"""
FASTER = RIG.replace("rate_hz = 20.0", "rate_hz = 30.0")


def rig(folder: Path, text: str = RIG) -> Path:
    path = folder / "rig.toml"
    path.write_text(text)
    return path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


async def saved(browser: Browser, text: str, revision: str = "") -> dict[str, Any]:
    if not revision:
        await browser.send(kind="settings")
        revision = (await browser.read("settings"))["revision"]
    await browser.send(kind="save_settings", text=text, revision=revision)
    return await browser.read("saved")


def refused(text: str, folder: Path = Path(), before: str = RIG) -> str:
    """Return why a text is refused; empty if it is not."""
    try:
        check(text, before, SettingsFile(folder / "rig.toml"))
    except BadInput as why:
        return str(why)
    return ""


MOUNTED = """
import sys
from pathlib import Path
from companion.settings.settings_file import SettingsFile
file = SettingsFile(Path(sys.argv[1]))
text, revision = file.read()
print(file.refusal())
file.save(text.replace("20.0", "30.0"), revision)
"""


@pytest.mark.parametrize("options", ["rw", "ro"])
def test_a_settings_file_that_is_a_mount_is_written_in_place_or_refused_before(tmp_path: Path, options: str) -> None:
    """A container gets it so: one file over another, which no file can take the place of."""
    given, folder = rig(tmp_path), tmp_path / "etc"
    folder.mkdir()
    inside = folder / "rig.toml"
    inside.write_text("")
    mounts = 'mount --bind "$1" "$2" && mount -o "remount,bind,$3" "$2" && shift 3 && exec "$@"'
    command = ["unshare", "-rm", "sh", "-c", mounts, "sh", str(given), str(inside), options]
    if shutil.which("unshare") is None or subprocess.run([*command, "true"], capture_output=True).returncode:
        pytest.skip("no mount namespace may be made here")
    done = subprocess.run([*command, sys.executable, "-c", MOUNTED, str(inside)], capture_output=True, text=True)
    assert given.read_text() == (FASTER if options == "rw" else RIG)
    assert ("mounted read-only" in done.stdout) is (options == "ro"), done.stdout
    assert (done.returncode == 0) is (options == "rw"), done.stderr
    assert names(folder) == (["rig.toml", "rig.toml.before"] if options == "rw" else ["rig.toml"])


async def test_a_text_is_checked_and_saved_with_the_one_before_kept(tmp_path: Path) -> None:
    path = rig(tmp_path)
    path.chmod(0o640)
    async with serving(tmp_path, settings_file=path) as service, browsing(service) as browser:
        await service.lands()
        await browser.send(kind="settings")
        shown = await browser.read("settings")
        assert shown["text"] == masked(RIG)
        assert "rate_hz" in shown["in_force"]
        edited = shown["text"].replace("20.0", "30.0")
        answer = await saved(browser, edited, shown["revision"])
        assert answer["saved"], answer
        assert path.read_text() == FASTER, "secrets are as they were"
        assert (tmp_path / "rig.toml.before").read_text() == RIG
        assert path.stat().st_mode & 0o777 == 0o640
        assert "changed since" in (await saved(browser, masked(RIG), shown["revision"]))["text"], "the revision of before"
        assert (await saved(browser, masked(RIG), answer["revision"]))["saved"]
        path.write_text(RIG + "# edited over SSH\n")
        assert not (await saved(browser, edited, answer["revision"]))["saved"], "another operator's changes are not overwritten"
    assert names(tmp_path) == ["rig.toml", "rig.toml.before", "token"]


async def test_nothing_is_saved_in_flight_while_armed_or_without_the_token(tmp_path: Path) -> None:
    path = rig(tmp_path)
    autopilot: Any = SimpleNamespace(condition=Condition())
    async with serving(tmp_path, settings_file=path, autopilot=autopilot) as service, browsing(service) as browser:
        assert "flies" in (await saved(browser, FASTER))["text"]
        await service.lands()
        autopilot.condition = Condition(armed=True)
        assert "armed" in (await saved(browser, FASTER))["text"]
        async with browsing(service, "another-token-of-sixteen") as other:
            await other.send(kind="save_settings", text=FASTER, revision="")
            assert (await other.read("closed"))["code"] == 4401
            assert [message["kind"] for message in other.messages] == ["refused"]
        assert path.read_text() == RIG


async def test_where_the_service_may_not_write_it_reports_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = rig(tmp_path)

    def read_only(*_: Any, **__: Any) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    async with serving(tmp_path, settings_file=path) as service, browsing(service) as browser:
        await service.lands()
        monkeypatch.setattr(Path, "touch", read_only)
        answer = await saved(browser, masked(FASTER))
        assert not answer["saved"]
        assert "Read-only file system" in answer["text"]
        path.write_bytes(b"\xff\xff")
        await browser.send(kind="settings")
        assert "not UTF-8" in (await browser.read("settings"))["refusal"]
        assert "not UTF-8" in (await saved(browser, FASTER, "x"))["text"]
    async with serving(tmp_path) as service, browsing(service) as browser:
        await browser.send(kind="settings")
        assert "without a settings file" in (await browser.read("settings"))["refusal"]
    shipped = SettingsFile(Path(load.__globals__["SHIPPED"]) / "sim.toml")
    with pytest.raises(BadInput, match="belongs to the installation"):
        shipped.save("", "")


async def test_garbage_is_reported_and_what_is_no_message_ends_its_connection(tmp_path: Path) -> None:
    path = rig(tmp_path)
    async with serving(tmp_path, settings_file=path) as service, browsing(service) as other:
        await service.lands()
        assert (await saved(other, 'a = \n"'))["line"] == 1
        assert (await saved(other, masked(RIG).replace("20.0", "-1")))["line"] == 17
        for text in ("", "\0", "[" * 5000, "x = " + "9" * 9000, "vehicle = 1", "é" * 5_000):
            assert not (await saved(other, text))["saved"], text[:20]
        too_long = '{"kind":"report","name":"x","padding":"' + "y" * 2000 + '"}'
        for message in ('{"kind":"settings","x":1}', '{"kind":"save_settings"}', too_long):
            async with browsing(service) as browser:
                await browser.read("welcome")
                await browser.socket.send_str(message)
                assert (await browser.read("closed"))["code"] == 4400
        for frame in (b'{"kind":"settings\xff"}', b'{"kind":"save_settings","text":"' + b"x" * 70_000 + b'","revision":""}'):
            async with browsing(service) as browser:
                await browser.read("welcome")
                await browser.socket._writer.send_frame(frame, aiohttp.WSMsgType.TEXT)
                assert (await browser.read("closed"))["code"] in (1006, 1007, 1009)
        assert path.read_text() == RIG


def test_a_fault_is_refused_with_its_line() -> None:
    for becomes, line in (("[pad]\ncolour = 1", 11), ("[recorder]\nframe = 1\n[pad]", 11), ("[pad", 10)):
        text = RIG.replace("[pad]", becomes, 1)
        assert line_of(text, refused(text)) == line


@pytest.mark.parametrize(
    ("was", "becomes", "named"),
    [
        ('file = "sim"', 'file = "/etc/shadow"', "camera.file"),
        ('file = "sim"', 'file = "../secret.toml"', "camera.file"),
        ('file = "sim"', 'file = "out/secret.toml"', "camera.file"),
        ('file = "thesis"', 'file = "a/../../b.toml"', "pad.file"),
        ('device = "rtsp', 'device = "/srv/other/film.mp4"\n#', "camera.device"),
        ('device = "rtsp', 'device = "file:///srv/other/film.mp4"\n#', "camera.device"),
        ('source = "stream"\ndevice = "rtsp', 'source = "gstreamer"\ndevice = "fakesrc ! filesink"\n#', "camera.source"),
        ('source = "stream"', 'source = "gstreamer"', "camera.source"),
        ("[guidance]", '[operator]\ngamepad = "/srv/other/pad.toml"\n[guidance]', "operator.gamepad"),
        ("[guidance]", '[operator]\nsocket = "/tmp/socket"\n[guidance]', "operator.socket"),
        ("[guidance]", '[recorder]\nfolder = "/srv/other"\n[guidance]', "recorder.folder"),
        ("[guidance]", '[http]\nendpoint = "http"\ntoken_file = "/etc/hostname"\n[guidance]', "http."),
        ("[guidance]", '[mqtt]\ntransport = "tcp"\nhost = "evil.example"\n[guidance]', "mqtt."),
        ('device = "rtsp', 'device = "http://169.254.169.254/latest"\n#', "camera.device"),
        ('device = "rtsp', 'device = "concat:rig.toml"\n#', "camera.device"),
        ('kind = "ardrone"', 'kind = "ardrone"\nhost = "192.168.1.77"', "vehicle.host"),
        ('kind = "ardrone"', 'kind = "mavlink"\nlinks = "udpin://0.0.0.0:14550"', "vehicle.kind"),
        ("[guidance]", '[vessel]\nnmea = "0.0.0.0:10110"\n[guidance]', "vessel.nmea"),
        ("[guidance]", '[vessel]\nbus = "tcp://198.51.100.7:2597"\n[guidance]', "vessel.bus"),
        ("[guidance]", "[operator.switch]\nchannel = 7\n[guidance]", "operator.switch.channel"),
        ("[guidance]", '[operator.handover]\nafter = "return"\n[guidance]', "operator.handover.after"),
        ("[guidance]", "[expert.operator.handover]\nfailsafe = true\n[guidance]", "expert.operator.handover.failsafe"),
        ("[guidance]", '[video_stream]\nto = "198.51.100.7:5600"\n[guidance]', "video_stream.to"),
        ("[guidance]", "[limits]\nheight_max_m = 500.0\n[guidance]", "limits.height_max_m"),
        ('start = "signal"', 'start = "automatic"', "guidance.start"),
    ],
)
def test_a_browser_names_no_file_elsewhere_and_gives_no_rights(tmp_path: Path, was: str, becomes: str, named: str) -> None:
    (tmp_path / "rig").mkdir()
    (tmp_path / "secret.toml").write_text("x = 1")
    (tmp_path / "rig/out").symlink_to(tmp_path)
    why = refused(RIG.replace(was, becomes), tmp_path / "rig")
    assert why.startswith(named)
    assert "from a browser" in why, "nothing is read, so it is not told whether it exists"


MAVLINK = RIG.replace('kind = "ardrone"', 'kind = "mavlink"\nlinks = "udpin://127.0.0.1:14550"')


@pytest.mark.parametrize("more", ["vessel_id = 42", "system_id = 7", "disarm_on_contact = false", 'operators = "255"'])
def test_a_browser_gives_nobody_a_right_over_an_autopilot(tmp_path: Path, more: str) -> None:
    key = more.split()[0]
    assert refused(MAVLINK.replace("[camera]", f"{more}\n[camera]"), tmp_path, MAVLINK).startswith(
        f"vehicle.{key} is not changed"
    )
    expert = MAVLINK + "[expert.vehicle]\nmode_is_order = true\n"
    assert refused(expert, tmp_path, MAVLINK).startswith("expert.vehicle.mode_is_order is not changed")


def test_ordinary_tuning_is_saved_from_a_browser(tmp_path: Path) -> None:
    tuned = """
[recorder]
enabled = true
[video_stream]
rate_hz = 10.0
[guidance.limits]
error_m = 0.1
[expert.guidance.pid.horizontal]
kp = 1.1
[expert.estimator.ekf]
forget_s = 20.0
[vision]
colours = "outdoor"
[service]
log_level = "debug"
"""
    assert refused(RIG + tuned, tmp_path) == ""
    assert refused(RIG.replace('file = "thesis"', 'file = "printed"'), tmp_path) == ""


NAMES_OR_GRANTS = re.compile(
    r"\b(address|bus|certificate|channel|command|commands|component|device|disarm|failsafe|fence|folder|from|gamepad|handover|host|"
    r"hosts|ids?|keys?|links?|mmsi|mqtt|nmea|operators|origins|password|peers?|point|polygon|port|response|sensor|"
    r"signing|socket|source|spool|start|switch|time file|to|token|user)\b|\b(mode changes|mode is order|page)\b"
)
"""Words in the name of a key that name an address, a device, a path, a secret or an id, or give somebody a right."""
GRANTS = re.compile(r"\bwho (may|decides)|\bmay (command|set|begin|watch)|\btaken like|addresses?\b|password|secret|systemd")
"""The same in what a key means."""
TEXTS = {"camera.file", "pad.file", "camera.controls", "guidance.controller", "rtk.antenna_m", "rtk.ship_antenna_m"}
"""The texts among the keys of the page. What they name has no folder in it, so it is shipped or lies beside the settings."""


def grants(path: str, field: Any) -> bool:
    """Return whether a browser must not change a key, by its name, type, unit and meaning."""
    *_, last = path.split(".")
    meaning = (field.type.extra_json_schema or {}).get("description", "")
    named = NAMES_OR_GRANTS.search(last.replace("_", " ")) or GRANTS.search(meaning)
    texts = isinstance(field.type.type, msgspec.inspect.StrType) and path not in TEXTS
    return bool(named or texts or schema.unit_of(field.type) in ("port", "id"))


@pytest.mark.hazard("A6")
def test_no_key_of_the_page_names_an_address_a_path_a_secret_or_an_id_or_gives_a_right() -> None:
    found = {path for path, field in schema.walk(Settings) if grants(path, field)}
    for one in (
        "vehicle.host", "vehicle.vessel_id", "vehicle.mode_is_order", "vehicle.links", "camera.source", "camera.device",
        "guidance.start", "guidance.mode_changes", "guidance.tries.another_pad", "vessel.nmea", "vessel.bus", "http.token_file",
        "mqtt.port", "video_stream.to", "operator.handover.failsafe", "operator.switch.channel", "recorder.folder",
        "limits.fence",
    ):  # fmt: skip
        assert one in found, "the rule sees what it is for"
    assert found & schema.on_page() == set()
    for table in ("http", "mqtt", "bridge", "limits", "operator.switch", "operator.handover", "guidance.elsewhere"):
        assert not [path for path in schema.on_page() if path.startswith(f"{table}.")], table


@pytest.mark.hazard("A6")
@given(st.sampled_from(sorted(path for path, _ in schema.walk(Settings, "ardrone"))), st.data())
@settings(max_examples=60, deadline=None)
def test_a_key_is_changed_from_a_browser_if_it_is_declared_for_it_and_not_else(path: str, data: st.DataObject) -> None:
    field: Any = dict(schema.walk(Settings, "ardrone"))[path]
    kind = field.type.type
    if isinstance(kind, msgspec.inspect.LiteralType):
        value: Any = data.draw(st.sampled_from(list(kind.values)))
    elif isinstance(kind, msgspec.inspect.BoolType):
        value = data.draw(st.booleans())
    elif isinstance(kind, msgspec.inspect.StrType):
        value = "a"
    else:
        near = field.default * data.draw(st.floats(0.99, 1.01))
        value = round(near) if isinstance(kind, msgspec.inspect.IntType) else near
    table, _, last = in_file(path).rpartition(".")
    bare = "[camera]\nfile = 'sim'\n[pad]\nfile = 'thesis'\n[vehicle]\nkind = 'ardrone'\n"
    text = f"{table}.{last} = {schema.value_text(value)}\n" if table not in ("camera", "pad", "vehicle") else ""
    text = text + bare if text else bare.replace(f"[{table}]", f"[{table}]\n{last} = {schema.value_text(value)}")
    why = refused(text, Path(), bare)
    if path not in schema.on_page("ardrone") and value != field.default:
        assert why, text
    if "is not changed from a browser" in why:
        assert path not in schema.on_page("ardrone")


def test_an_address_that_was_changed_gets_no_secret_of_another() -> None:
    assert "hunter2" not in masked(RIG)
    assert "s3cret" not in masked(RIG)
    with pytest.raises(BadInput, match="again in place"):
        unmasked(masked(RIG).replace("10.0.0.8", "evil.example"), RIG)


@given(st.text(st.characters(exclude_categories=["Cs"]), max_size=60), st.text("ab:/@?=&*pw\"' token", max_size=60))
def test_hidden_secrets_come_back(before: str, address: str) -> None:
    text = f'{before}\ndevice = "rtsp://{address}"'
    assert unmasked(masked(text), text) == text or "***" in text


PIECES = st.sampled_from(
    ["[vehicle]", "[pad]", "kind = ", '"mavlink"', "file = ", '"x"', "\n", "[[a]]", "a.b = 1", "=", "nan", "{", "'"]
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(PIECES, max_size=12).map("".join) | st.text(max_size=60))
def test_every_text_is_good_or_refused(text: str) -> None:
    refused(RIG + text)
    assert refused(text)


NAMES = own_names(HttpSettings(hosts="Drone.lan, bridge.example.org.,"))
OWN = socket.gethostname().partition(".")[0].lower()


@pytest.mark.parametrize(
    ("origin", "host", "said"),
    [
        *((f"http://{host}", host, None) for host in (
            "127.0.0.1:8480", "[::1]:8480", "[fe80::1]", "LOCALHOST", f"{OWN}.local:8480", f"{OWN.upper()}.local", "drone.lan.",
            "bridge.example.org",
        )),
        *((f"http://{host}", host, "name it in [expert.http] hosts") for host in (
            "evil.example:8480", "localhost.evil.example", "drone.lan.evil", "1.2.3.4.nip.io",
        )),
        *((origin, host, "this connection belongs to another page") for origin, host in (
            (None, "127.0.0.1:8480"), ("http://127.0.0.1:8480", None), ("null", "127.0.0.1:8480"), ("", ""),
            ("http://127.0.0.1:8481", "127.0.0.1:8480"), ("file://127.0.0.1", "127.0.0.1"), ("http://[::1", "[::1"),
            ("https://evil.example", "127.0.0.1"),
        )),
    ],
)  # fmt: skip
def test_its_own_page_is_let_in_by_each_of_its_names_and_no_other(origin: str | None, host: str | None, said: str | None) -> None:
    why = refused_origin({name: text for name, text in (("Origin", origin), ("Host", host)) if text is not None}, NAMES)
    assert why is None if said is None else said in (why or "")


@pytest.mark.parametrize(
    ("origin", "headers", "said"),
    [
        ("https://drone.lan:8443", {"Host": "drone.lan"}, "Host $http_host"),
        ("https://drone.lan:8443", {"Host": "drone.lan:8443"}, None),
        ("https://drone.lan", {"Host": "drone.lan:443"}, None),
        ("https://drone.lan:8443", {"Host": "drone.lan", "X-Forwarded-Port": "8443"}, None),
        ("https://drone.lan:8443", {"Host": "127.0.0.1:8480", "X-Forwarded-Host": "drone.lan:8443"}, None),
        ("https://drone.lan:8443", {"Host": "a", "X-Forwarded-Host": "drone.lan, b", "X-Forwarded-Port": "8443"}, None),
        ("https://drone.lan", {"Host": "127.0.0.1:8480", "X-Forwarded-Host": "drone.lan"}, None),
        ("https://drone.lan", {"Host": "127.0.0.1:8480"}, "'https://drone.lan' and Host has '127.0.0.1:8480'"),
        ("https://evil.example", {"Host": "127.0.0.1:8480", "X-Forwarded-Host": "drone.lan"}, "another page"),
        ("https://evil.example", {"Host": "127.0.0.1", "X-Forwarded-Host": "evil.example"}, "[expert.http] hosts"),
        ("https://drone.lan:x", {"Host": "drone.lan:x"}, "another page"),
        ("https://", {"Host": ""}, "another page"),
    ],
)  # fmt: skip
def test_a_proxy_passes_the_browser_s_host_on_or_the_header_is_named(origin, headers, said):
    why = refused_origin({"Origin": origin, **headers}, NAMES)
    assert why is None if said is None else said in (why or "")


SETTINGS = load("sim")
CAMERA, PAD = camera_model(SETTINGS), pad_model(SETTINGS)
AT = MonoNs(5_000_000_000)
small = st.floats(-0.08, 0.08)


def believed(d: np.ndarray, yaw_rad: float | None = 0.3) -> RelativeState:
    return RelativeState(AT, "ekf", d, np.array([0.1, -0.2, 0.3]), yaw_rad, np.diag([0.04, 0.01, 0.09, 1, 1, 1, 0.01]), AT, True)


@given(st.tuples(small, small, small), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_the_outline_lies_where_the_filter_expects_the_pad_whatever_the_attitude_s_error(error, forward_m, right_m):
    """The vehicle reports an attitude that is wrong by `error`; the filter knows that, and its innovation is zero."""
    R_body_level = Rotation.from_rpy(0.05, -0.03, 0.0).inv
    d = np.array([forward_m, right_m, 3.0])
    in_body = R_body_level @ d
    reported = Rotation.from_rpy(0.05, -0.03, 0.0) @ Rotation.from_rotvec(np.array([error[0], error[1], 0.0]))
    frame = seen(AT, found=True)
    level = reported.without_heading()
    found = frame.detection
    assert found is not None
    assert found.selected is not None
    sighting = replace(found.selected, d_body_pad_level=level @ in_body)
    frame = replace(
        frame,
        attitude=Attitude(frame.frame.stamp, reported, np.eye(3) * 1e-4),
        detection=replace(found, selected=sighting),
        results=(FusionResult("ekf", "sighting", Verdict.FUSED, AT, AT, np.zeros(4), np.eye(4), 0.0, 0.0),),
    )
    lean = camera_lean(frame, believed(d))
    assert lean is not None
    lines = picture_lines(frame, believed(d), None, lean, CAMERA, PAD)
    disc = np.array(next(line.uv_px for line in lines if line.kind == "pad")).reshape(-1, 2)[:-1]
    centre = CAMERA.project((CAMERA.T_body_cam.inv @ in_body)[None, :])[0]
    assert disc.mean(axis=0) == pytest.approx(centre, abs=3.0)


def test_a_frame_that_was_not_compared_reports_nothing_of_the_mount() -> None:
    assert camera_lean(seen(AT, found=True), believed(np.array([0.0, 0.0, 3.0]))) is None
    assert camera_lean(seen(AT, found=False), believed(np.array([0.0, 0.0, 3.0]))) is None
    assert camera_lean(seen(AT, found=True), None) is None


@given(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0), st.floats(-2.0, 40.0), st.none() | st.floats(-3.1, 3.1))
def test_any_estimate_makes_lines_of_finite_points(forward: float, right: float, down: float, yaw: float | None) -> None:
    belief = believed(np.array([forward, right, down]), yaw)
    for line in picture_lines(seen(AT, found=False), belief, None, Rotation.identity(), CAMERA, PAD):
        uv = np.array(line.uv_px, dtype=float)
        assert uv.size >= 4
        assert np.abs(uv).max() < 4001.0


BOARD = Board()
TRUE = lens(640, 360, 420.0, (-0.1, 0.02, 0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def images() -> list[NDArray[np.uint8]]:
    taken = good_round(Studio(TRUE, BOARD), 0.48, (0.22, 0.3), 0.75)
    return [np.asarray(cv2.cvtColor(px, cv2.COLOR_GRAY2BGR), np.uint8) for px in taken]


async def asked(browser: Browser, action: str, **more: Any) -> dict[str, Any]:
    await browser.send(kind="calibration", action=action, **more)
    return await browser.read("calibration")


def test_a_guide_names_what_is_missing_until_nothing_is(images: list[NDArray[np.uint8]]) -> None:
    guide = Guide(BOARD)
    assert len(guide.state.lacks) == 6
    for px in images[:6]:
        guide.add("one", px)
        state = guide.add("still", px)
    assert (state.views, state.board_seen, state.complete) == (4, True, False)
    assert state.rms_px is not None
    assert any("corner" in lack for lack in state.lacks)
    shown = block(state)
    assert "#" in shown[0]
    assert "4 views, error 0." in shown[0]
    assert not guide.add("nothing", np.zeros_like(images[0])).board_seen
    for px in images[6:]:
        guide.add("one", px)
        state = guide.add("still", px)
    assert state.complete, state.lacks
    assert abs(guide.solution.camera.fx / TRUE.fx - 1) < 0.004


async def test_a_person_is_led_to_a_camera_file(tmp_path, images, monkeypatch):
    monkeypatch.setattr(calibration_tool, "_FRAME_S", 0.0)
    path = rig(tmp_path)
    async with serving(tmp_path, settings_file=path) as service, browsing(service) as browser, browsing(service) as other:
        assert "flies" in (await asked(browser, "begin"))["text"]
        await service.lands()
        assert "no finished calibration" in (await asked(browser, "save"))["text"]
        assert "more than the 250 markers" in (await asked(browser, "begin", columns=25, rows=25))["text"]
        assert (await asked(browser, "begin"))["active"]
        assert "under way already" in (await asked(other, "begin"))["text"]
        reported = await browser.read("calibration")
        assert not reported["board_seen"]
        for px in images:
            service.px, before = px, reported["images"]
            while reported["active"] and reported["images"] < before + 4:
                reported = await browser.read("calibration")
        assert (reported["text"], reported["grade"], reported["lacks"]) == ("complete", "good", [])
        assert (await asked(browser, "save"))["text"].startswith("saved beside the settings")
        found = Camera.from_mapping(tomllib.loads((tmp_path / calibration_tool.NAME).read_text()), "camera")
        assert abs(found.fx / TRUE.fx - 1) < 0.004
        assert np.allclose(found.T_body_cam.R.matrix, service.pilot.camera.T_body_cam.R.matrix, atol=1e-4), "the mount is kept"
        assert (await asked(browser, "save"))["text"].startswith("saved beside the settings")
        service.flying = True
        while "flies" not in (await asked(browser, "save"))["text"]:
            pass
    assert names(tmp_path) == [calibration_tool.NAME, f"{calibration_tool.NAME}.before", "rig.toml", "token"]


async def test_a_take_off_ends_a_calibration_and_garbage_its_connection(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, browsing(service) as browser:
        await service.lands()
        assert (await asked(browser, "begin"))["active"]
        service.flying = True
        reported = await browser.read("calibration")
        while reported["active"]:
            reported = await browser.read("calibration")
        assert (reported["text"], reported["file"]) == (calibration_tool.TOOK_OFF, "")
        for more in ({"columns": 1}, {"square_mm": 0}, {"board": "../x"}, {"action": "install"}, {"path": "/etc/x"}):
            async with browsing(service) as garbage:
                await garbage.read("welcome")
                await garbage.send(**({"kind": "calibration", "action": "begin"} | more))
                assert (await garbage.read("closed"))["code"] == 4400
