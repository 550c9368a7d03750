"""Settings from a browser: what is told of a text, who may save it when, and what a browser may not change or read."""

import errno
import tempfile
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import aiohttp
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.settings.draft import Draft, check_draft, masked, unmasked
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


async def checked(browser: Browser, text: str) -> dict[str, Any]:
    await browser.send(kind="check_settings", number=1, text=text)
    return await browser.read("checked")


async def saved(browser: Browser, text: str, revision: str = "") -> dict[str, Any]:
    if not revision:
        await browser.send(kind="settings")
        revision = (await browser.read("settings"))["revision"]
    await browser.send(kind="save_settings", number=2, text=text, revision=revision)
    return await browser.read("saved")


def draft(text: str, folder: Path = Path()) -> Draft:
    return check_draft(text, folder / "rig.toml", tomllib.loads(RIG), load("sim"))


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
        reported = await checked(browser, edited)
        assert reported["faults"] == []
        assert {"path": "guidance.rate_hz", "before": "50.0", "after": "30.0"} in reported["changes"]
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


async def test_nothing_is_checked_in_flight_or_saved_while_armed_or_without_the_token(tmp_path: Path) -> None:
    path = rig(tmp_path)
    autopilot: Any = SimpleNamespace(condition=Condition())
    async with serving(tmp_path, settings_file=path, autopilot=autopilot) as service, browsing(service) as browser:
        assert "flies" in (await checked(browser, FASTER))["text"]
        assert "flies" in (await saved(browser, FASTER))["text"]
        await service.lands()
        autopilot.condition = Condition(armed=True)
        assert "armed" in (await saved(browser, FASTER))["text"]
        async with browsing(service, "another-token-of-sixteen") as other:
            await other.send(kind="save_settings", number=1, text=FASTER, revision="")
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
        shown = await browser.read("settings")
        assert "not UTF-8" in shown["refusal"]
        assert "not UTF-8" in (await checked(browser, FASTER))["faults"][0]["text"]
    async with serving(tmp_path) as service, browsing(service) as browser:
        await browser.send(kind="settings")
        assert "without a settings file" in (await browser.read("settings"))["refusal"]
    shipped = SettingsFile(Path(load.__globals__["SHIPPED"]) / "sim.toml")
    assert "belongs to the installation" in shipped.refusal()
    with pytest.raises(BadInput, match="belongs to the installation"):
        shipped.save("", "")


async def test_garbage_is_reported_and_what_is_no_message_ends_its_connection(tmp_path: Path) -> None:
    path = rig(tmp_path)
    async with serving(tmp_path, settings_file=path) as service, browsing(service) as other:
        await service.lands()
        reported = await checked(other, 'a = \n"')
        assert (reported["faults"][0]["path"], reported["faults"][0]["line"]) == ("", 1)
        for text in ("", "\0", "[" * 5000, "x = " + "9" * 9000, "vehicle = 1", "é" * 5_000):
            assert (await checked(other, text))["faults"], text[:20]
        for message in (
            '{"kind":"check_settings","number":1,"text":"\\ud800"}',
            '{"kind":"settings","x":1}',
            '{"kind":"save_settings"}',
        ):
            async with browsing(service) as browser:
                await browser.read("welcome")
                await browser.socket.send_str(message)
                assert (await browser.read("closed"))["code"] == 4400
        async with browsing(service) as browser:
            await browser.read("welcome")
            await browser.send(kind="report", name="x", padding="y" * 2000)
            assert (await browser.read("closed"))["code"] == 4400
        async with browsing(service) as browser:
            await browser.read("welcome")
            await browser.send(kind="check_settings", number=1, text="x" * 70_000)
            assert (await browser.read("closed"))["code"] in (1006, 1009)
        async with browsing(service) as browser:
            await browser.read("welcome")
            await browser.socket._writer.send_frame(b'{"kind":"settings\xff"}', aiohttp.WSMsgType.TEXT)
            assert (await browser.read("closed"))["code"] in (1006, 1007)
        assert path.read_text() == RIG


def test_every_fault_is_reported_with_its_line() -> None:
    text = RIG.replace("20.0", "-1").replace("[pad]", "[pad]\ncolour = 1").replace('"ardrone"', '"ardrone"\nmodel = "9"')
    found = draft(text + "[recorder]\nframe = 1\n").faults
    assert [(fault.path, fault.line) for fault in found] == [
        ("vehicle.model", 4),
        ("pad.colour", 12),
        ("expert.guidance.rate_hz", 19),
        ("recorder.frame", 21),
    ]
    assert "did you mean recorder.frames?" in found[3].text


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
        ("[guidance]", '[page]\nendpoint = "http"\ntoken_file = "/etc/hostname"\n[guidance]', "page."),
        ("[guidance]", '[mqtt]\ntransport = "tcp"\nhost = "evil.example"\n[guidance]', "mqtt."),
        ("[guidance]", '[metrics]\nendpoint = "http"\n[guidance]', "metrics.endpoint"),
        ("[guidance]", '[foxglove]\nendpoint = "websocket"\n[guidance]', "foxglove.endpoint"),
    ],
)
def test_a_browser_names_no_file_elsewhere_and_gives_no_rights(tmp_path: Path, was: str, becomes: str, named: str) -> None:
    (tmp_path / "rig").mkdir()
    (tmp_path / "secret.toml").write_text("x = 1")
    (tmp_path / "rig/out").symlink_to(tmp_path)
    found = draft(RIG.replace(was, becomes), tmp_path / "rig").faults
    assert found
    assert all(fault.path.startswith(named) for fault in found), found
    assert "from a browser" in found[0].text, "nothing is read, so it is not told whether it exists"


def test_a_name_that_was_allowed_for_one_kind_of_camera_is_not_for_another(tmp_path: Path) -> None:
    words = 'source = "stream"\ndevice = "rtsp://admin:hunter2@10.0.0.8/live?token=s3cret"'
    for device, source in (("../film.mp4", "stream"), ("fakesrc ! filesink location=x", "gstreamer")):
        before, after = (RIG.replace(words, f'source = "{kind}"\ndevice = "{device}"') for kind in ("v4l2", source))
        found = check_draft(after, tmp_path / "rig.toml", tomllib.loads(before), load("sim")).faults
        assert [fault.path for fault in found] == ["camera.device"]


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
def test_no_text_makes_the_check_raise(text: str) -> None:
    assert draft(RIG + text).faults is not None
    assert draft(text).faults
