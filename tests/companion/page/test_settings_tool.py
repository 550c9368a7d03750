"""The settings file from the page: checked, saved in whole, and without rights, addresses or paths from a browser."""

import errno
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.parts.page.settings_tool import check, line_of, unmasked
from companion.settings import schema
from companion.settings.load import load
from companion.settings.model import Settings, in_file
from companion.settings.settings_file import SettingsFile
from drivers.mavlink.vehicle import Condition
from estimator.contracts.address import masked
from estimator.contracts.errors import BadInput
from tests.support.page_service import Browser, browsing, serving

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
        ("[guidance]", '[mqtt]\ntransport = "tcp"\nhost = "evil.example"\n[guidance]', "mqtt"),
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
    assert why.lstrip("[").startswith(named)
    assert "from a browser" in why, "nothing is read, so whether it exists is not reported"


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
