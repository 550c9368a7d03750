"""Settings from a browser: who may save a text when, which line is refused, and what a browser may not change or read."""

import errno
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.parts.page.settings_tool import check, line_of, masked, unmasked
from companion.settings.load import load
from companion.settings.settings_file import SettingsFile
from drivers.mavlink.vehicle import Condition
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

    def read_only(**_: Any) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    async with serving(tmp_path, settings_file=path) as service, browsing(service) as browser:
        await service.lands()
        monkeypatch.setattr(tempfile, "mkstemp", read_only)
        answer = await saved(browser, masked(FASTER))
        assert not answer["saved"]
        assert "Read-only file system" in answer["text"]
        path.write_bytes(b"\xff\xfe")
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


@pytest.mark.parametrize(
    ("was", "becomes", "line"),
    [
        ("20.0", "-1", 17),
        ("[pad]", "[pad]\ncolour = 1", 11),
        ('"ardrone"', '"ardrone"\nmodel = "9"', 4),
        ("[guidance]", "[recorder]\nframe = 1\n[guidance]", 14),
        ("[pad]", "[pad", 10),
    ],
)
def test_a_fault_is_refused_with_its_line(was: str, becomes: str, line: int) -> None:
    text = RIG.replace(was, becomes, 1)
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
        (
            'source = "stream"\ndevice = "rtsp',
            'source = "gstreamer"\ndevice = "fakesrc ! filesink location=x"\n#',
            "camera.device",
        ),
        ('source = "stream"', 'source = "gstreamer"', "camera.device"),
        ("[guidance]", '[operator]\ngamepad = "/srv/other/pad.toml"\n[guidance]', "operator.gamepad"),
        ("[guidance]", '[operator]\nsocket = "/tmp/socket"\n[guidance]', "operator.socket"),
        ("[guidance]", '[recorder]\nfolder = "/srv/other"\n[guidance]', "recorder.folder"),
        ("[guidance]", '[http]\nendpoint = "http"\ntoken_file = "/etc/hostname"\n[guidance]', "http."),
        ("[guidance]", '[mqtt]\ntransport = "tcp"\nhost = "evil.example"\n[guidance]', "mqtt."),
    ],
)
def test_a_browser_names_no_file_elsewhere_and_gives_no_rights(tmp_path: Path, was: str, becomes: str, named: str) -> None:
    (tmp_path / "rig").mkdir()
    (tmp_path / "secret.toml").write_text("x = 1")
    (tmp_path / "rig/out").symlink_to(tmp_path)
    why = refused(RIG.replace(was, becomes), tmp_path / "rig")
    assert why.startswith(named)
    assert "from a browser" in why, "nothing is read, so it is not told whether it exists"


def test_a_name_that_was_allowed_for_one_kind_of_camera_is_not_for_another(tmp_path: Path) -> None:
    words = 'source = "stream"\ndevice = "rtsp://admin:hunter2@10.0.0.8/live?token=s3cret"'
    for device, source in (("../film.mp4", "stream"), ("fakesrc ! filesink location=x", "gstreamer")):
        before, after = (RIG.replace(words, f'source = "{kind}"\ndevice = "{device}"') for kind in ("v4l2", source))
        assert refused(after, tmp_path, before).startswith("camera.device")


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
