"""A calibration from the page: guided by what is missing, on the ground alone, to a camera file that can be flown."""

import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.cli.calibrate import block
from companion.parts.page import make
from companion.tools.calibrate.board import Board
from companion.tools.calibrate.guide import Guide
from estimator.vision.camera import Camera
from tests.companion.page.test_tools import names, rig
from tests.support.calibration_images import Studio, good_round, lens
from tests.support.page_service import Browser, browsing, serving

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
    assert guide.solution is not None
    assert abs(guide.solution.camera.fx / TRUE.fx - 1) < 0.004


async def test_a_person_is_led_to_a_camera_file(tmp_path, images, monkeypatch):
    monkeypatch.setattr(make, "_FRAME_S", 0.0)
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
        found = Camera.from_mapping(tomllib.loads((tmp_path / make.NAME).read_text()), "camera")
        assert abs(found.fx / TRUE.fx - 1) < 0.004
        assert np.allclose(found.T_body_cam.R.matrix, service.pilot.camera.T_body_cam.R.matrix, atol=1e-4), "the mount is kept"
        assert (await asked(browser, "save"))["text"].startswith("saved beside the settings")
        service.flying = True
        while "flies" not in (await asked(browser, "save"))["text"]:
            pass
    assert names(tmp_path) == [make.NAME, f"{make.NAME}.before", "rig.toml", "token"]


async def test_a_take_off_ends_a_calibration_and_garbage_its_connection(tmp_path: Path) -> None:
    async with serving(tmp_path) as service, browsing(service) as browser:
        await service.lands()
        assert (await asked(browser, "begin"))["active"]
        service.flying = True
        reported = await browser.read("calibration")
        while reported["active"]:
            reported = await browser.read("calibration")
        assert (reported["text"], reported["file"]) == (make.TOOK_OFF, "")
        for more in ({"columns": 1}, {"square_mm": 0}, {"board": "../x"}, {"action": "install"}, {"path": "/etc/x"}):
            async with browsing(service) as garbage:
                await garbage.read("welcome")
                await garbage.send(**({"kind": "calibration", "action": "begin"} | more))
                assert (await garbage.read("closed"))["code"] == 4400
