"""The operator page in Debian's Chromium in every size of window and unit, and a flight's report that opens from it."""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from companion.base.mission import Reason, ReasonCause
from companion.guidance.mission.land_here import Touch
from tests.companion.page.test_browser import BELIEVED
from tests.fly import record_to
from tests.support.browser import CALM, LAPTOP, MARKS, PHONE, SIDEWAYS, WAIT_MS, chromium, playwright, window
from tests.support.page_service import serving

pytestmark = MARKS
ORDER_BUTTONS = [f'[data-order="{order}"]' for order in ("takeoff", "begin", "hold", "land", "abort")]
SIZES = ((LAPTOP, 44), (PHONE, 44), (SIDEWAYS, 40), ({"width": 320, "height": 568}, 44), ({"width": 768, "height": 1024}, 44))
TEXTS = [Reason(cause, 2.5, 1.25, "left").text for cause in ReasonCause] + [Touch(1.5, 0.15, 6.0, "known to 0.6 m").text]
IN_FEET = "async (texts) => (await import('/units.js')).inUnits({ kind: 'event', texts }).texts"
FIGURES = "async (values) => { const { figure } = await import('/units.js'); return values.map((v) => figure('length', v)); }"
EVENT = "async () => (await import('/telling.js')).event({ kind: 'event', at_s: 0, level: 'info', text: '2.50 m off' })"


@pytest.mark.timeout(500)
async def test_every_order_is_in_sight_and_stays_in_its_place_by_day_in_metres_and_by_night_in_feet(tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, chromium() as browser, window(browser, service, has_touch=True) as one:
        service.believed = BELIEVED
        places: dict[str, Any] = {}
        for night, (size, least_px) in [(night, one) for night in (False, True) for one in SIZES]:
            if night and size == LAPTOP:
                await one.page.evaluate(EVENT)
                await one.page.select_option("#units", "feet")
                await one.shows("events", "8.2 ft off")
                for button in ("#alarms", "#theme"):  # on and off; dark and night
                    await one.page.click(button, click_count=2)
                await one.page.reload()
                assert await one.page.is_hidden("#alarms-ask"), "asked once"
            await one.page.set_viewport_size(size)
            await one.shows("height", "^6.6ft$" if night else "^2.00m$")
            assert await one.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
            for grow in (False, True):
                if grow:
                    await one.page.click('[data-order="land"]')
                    await playwright.expect(one.page.locator("#asks")).to_be_visible(timeout=WAIT_MS)
                    await one.page.evaluate("[answer, reason, worst].forEach((e) => (e.textContent = 'over a line '.repeat(8)))")
                asks = [] if night or grow else ["#alarms-ask [value=on]"]
                for name in (*ORDER_BUTTONS, "#emergency", *asks):
                    box = await one.page.locator(name).bounding_box()
                    assert least_px <= box["height"] <= box["y"] + box["height"] <= size["height"]
                    assert places.setdefault(f"{name} {size}", box) == box, "no button moves under a thumb or pointer"
                hand = await one.page.locator("#by-hand").bounding_box()
                assert places.setdefault(f"by hand {size}", hand) == hand
            shot = cv2.imdecode(np.frombuffer(await one.page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
            assert (shot[..., :2].max() == 0) == night, "by night nothing but red"
            await one.page.keyboard.press("Escape")
        metres = np.geomspace(0.01, 300.0, 40)
        for value, (text, unit) in zip(metres, await one.page.evaluate(FIGURES, metres.tolist()), strict=True):
            assert float(text) * {"ft": 0.3048, "in": 0.0254}[unit] == pytest.approx(value, rel=0.05, abs=0.002)
        for before, after in zip(TEXTS, await one.page.evaluate(IN_FEET, TEXTS), strict=True):
            assert not re.search(r"[\d.]+ c?m\b(?!/s\^)", after) or re.search(r"_m\b", before), after
        await one.shows("worst", "no status from the vehicle yet")
        assert await one.page.locator("#link").get_attribute("data-level") == "fault", "no green over what is missing"
        assert await one.page.locator('[data-order="begin"].primary').count() == 0
        await one.page.set_viewport_size(SIDEWAYS)
        await one.page.click("#by-hand")
        await playwright.expect(one.page.locator("#sticks")).to_be_visible(timeout=WAIT_MS)
        await playwright.expect(one.page.locator("#flown")).to_be_in_viewport(timeout=WAIT_MS)
        await one.shows("flown", "^height 6.6 ft, climb 0 ft/min$")
        stick = await one.page.locator(".stick").first.bounding_box()
        middle = (stick["x"] + stick["width"] / 2, stick["y"] + stick["height"] / 2)
        await one.page.mouse.move(*middle)
        await one.page.mouse.down()
        await one.page.evaluate("lost.hidden = false, (lost.textContent = 'out of touch '.repeat(30))")
        await one.page.mouse.move(middle[0] + 1, middle[1])
        moved = await one.page.locator(".stick span").first.evaluate("e => e.style.transform")
        assert re.fullmatch(r"translate\([0-4]\.?\d*%, -?0%\)", moved), "a still thumb commands nothing when the page moves"
        await one.page.mouse.up()
        for name in ("#sticks", '[data-order="hold"]', "#answer", "#emergency"):
            box = await one.page.locator(name).bounding_box()
            assert 0 <= box["y"] <= box["y"] + box["height"] <= 390, f"{name} is in sight of who holds the phone sideways"
        picture, orders = [await one.page.locator(name).bounding_box() for name in ("#picture", "#orders")]
        assert picture["x"] + picture["width"] <= orders["x"]


@pytest.mark.timeout(500)
async def test_a_flight_s_report_opens_from_the_page_and_reaches_nothing_of_it(tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    record_to(tmp_path / "recordings/decklander-1.mcap")
    async with serving(tmp_path, **CALM) as service, chromium() as browser, window(browser, service) as one:
        service.flying = False
        await one.shows("link", "live")
        await one.page.click("#list-recordings")
        await one.page.click('[aria-label="Report decklander-1.mcap"]')
        ready = one.page.locator("#recordings-note")  # a busy machine leaves little to a process of the least priority
        await playwright.expect(ready).to_have_text(re.compile("the report is ready"), timeout=5 * WAIT_MS)
        async with one.page.expect_popup() as opened:
            await one.page.click('[aria-label="Open the report of decklander-1.mcap"]')
        report = await opened.value
        faults: list[str] = []
        report.on("pageerror", lambda error: faults.append(str(error)))
        await report.wait_for_load_state()
        await report.wait_for_function("document.querySelector('video').readyState >= 2")
        assert await report.evaluate("origin") == "null"
        assert faults == one.faults == []
