"""The tools of the page on the ground alone: the doctor over the links that the service has open, and a calibration."""

import asyncio
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.cli.calibrate import block
from companion.parts.page import calibration_tool, doctor_tool
from companion.tools.calibrate.board import Board
from companion.tools.calibrate.guide import Guide
from companion.tools.doctor import rules_values
from companion.tools.doctor.diagnose import PARAMETERS
from drivers.clock import SystemClock
from drivers.mavlink import samples
from drivers.mavlink.autopilot import Autopilot, open_autopilot
from drivers.mavlink.options import AutopilotOptions
from drivers.mavlink.vehicle import Stack
from estimator.vision.camera.camera import Camera
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.doctor.test_rules import ARDUPILOT, defaults
from tests.companion.page.test_settings_tool import names, rig
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
