"""A flight's report in Debian's Chromium, and the page in all its states as axe-core finds it."""

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from companion.tools.report.page import render_comparison, write_page, write_report
from companion.tools.report.video import film_of
from estimator.contracts.time import MonoNs
from tests.companion.test_report import report_flight
from tests.support.browser import CALM, LAPTOP, MARKS, PHONE, Window, chromium, playwright, violations, window
from tests.support.page_service import TOKEN, serving
from tests.support.waiting import until

pytestmark = MARKS


@pytest.mark.timeout(500)
async def test_axe_finds_nothing_in_any_state_of_the_page(tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, chromium() as browser, window(browser, service, token="") as one:
        found = {"login": await violations(one)}
        await one.page.fill("#token", TOKEN)
        await one.page.keyboard.press("Enter")
        await one.shows("link", "live")
        await service.lands()
        found["waiting"] = await violations(one)
        await one.page.emulate_media(color_scheme="light")
        service.health.too_slow = "this computer manages 7 of 30 frames a second: choose 320x180"
        slow = one.page.locator('#causes [data-level="fault"]', has_text=service.health.too_slow)
        await playwright.expect(slow).to_have_css("color", "rgb(179, 22, 27)")  # --fault of the light scheme
        service.flying = True
        await until(lambda: service.pilot.vehicle is not None and service.pilot.vehicle.flying is True)
        assert "accepted" in await one.press("begin")
        found["landing"] = await violations(one)
        await one.page.set_viewport_size(PHONE)
        assert "refused: the vehicle flies already" in await one.press("takeoff")
        found["refused"] = await violations(one)
        await one.press("hold")
        await one.page.click("#by-hand")
        await one.shows("by-hand", "Give the hand back")
        found["by hand"] = await violations(one)
        assert {state: broken for state, broken in found.items() if broken} == {}


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(report_flight(), tmp_path_factory.mktemp("report"))


@asynccontextmanager
async def opened(path: Path, **options: Any) -> AsyncIterator[tuple[Window, list[str]]]:
    """Open a page as a file, off line, and list what it requests."""
    asked: list[str] = []
    async with chromium() as browser:
        context = await browser.new_context(offline=True, **{"viewport": LAPTOP, **options})
        one = Window(await context.new_page())
        one.page.on("request", lambda request: asked.append(request.url))
        await one.page.goto(path.as_uri())
        await holds(one, "document.querySelectorAll('video').length === 0 || document.querySelector('video').readyState > 1")
        yield one, asked
        await context.close()


async def holds(one: Window, expression: str) -> None:
    """Wait until an expression is true; the page's policy forbids the browser to wait for it by itself."""
    for _ in range(600):
        if await one.page.evaluate(expression):
            return
        await one.page.wait_for_timeout(50)
    raise AssertionError(f"never: {expression}")


async def cursor_s(one: Window) -> float:
    return float(await one.page.input_value("#slider"))


async def video_at(one: Window, t_s: float) -> None:
    await holds(one, f"Math.abs(document.querySelector('video').currentTime - {t_s}) < 0.06")


async def axis(one: Window) -> list[float]:
    """Return the plot's box in the window: left, top, width, height of the canvas."""
    canvas = one.page.locator("figure.plot canvas").first
    await canvas.scroll_into_view_if_needed()
    box = await canvas.bounding_box()
    return [box["x"], box["y"], box["width"], box["height"]]


async def ticks_s(one: Window) -> list[float]:
    """Return the cursor's times at the left and right end of the first plot, which say what span is in sight."""
    x, y, width, height = await axis(one)
    found = []
    for at in (53, width - 9):
        await one.page.mouse.click(x + at, y + height / 2)
        found.append(await cursor_s(one))
        await one.page.wait_for_timeout(600)  # not a double click
    return found


@pytest.mark.timeout(300)
async def test_one_cursor_for_plots_events_keys_and_video(report: Path) -> None:
    async with opened(report) as (one, asked):
        assert await cursor_s(one) > 3.9, "it opens at the touchdown"
        x, y, width, height = await axis(one)
        await one.page.mouse.click(x + 52 + 0.5 * (width - 60), y + height / 2)
        assert await cursor_s(one) == pytest.approx(2.0, abs=0.05)
        await video_at(one, 2.0)
        await one.page.keyboard.press("ArrowRight")
        assert await cursor_s(one) == pytest.approx(2.0 + 1 / 30, abs=0.05)
        await one.page.locator("ol.events button", has_text="contact with the deck").click()
        assert await cursor_s(one) == pytest.approx(1.5, abs=0.01)
        await video_at(one, 1.5)
        assert await one.page.locator("dl.figures dd").first.inner_text() == "approach"
        assert await one.page.locator("ol.events button[aria-current]").count() == 1
        height_told = await one.page.locator("dl.figures div", has_text="height").first.inner_text()
        assert float(height_told.split()[1]) == pytest.approx(3.0 - 0.6 * 1.5 + 0.1, abs=0.1)
        await one.page.click("#play")
        await holds(one, "Number(document.querySelector('#slider').value) > 2.0")
        await one.page.click("#play")
        t = await cursor_s(one)
        assert await one.page.evaluate("document.querySelector('video').currentTime") == pytest.approx(t, abs=0.3)
        assert one.faults == []
        assert all(url.startswith(("file:", "blob:")) for url in asked)
        assert len([url for url in asked if url.startswith("file:")]) == 1, "nothing but the page itself"


@pytest.mark.timeout(300)
async def test_a_plot_zooms_by_drag_wheel_and_keys_and_all_plots_with_it(report: Path) -> None:
    async with opened(report) as (one, _):
        x, y, width, height = await axis(one)
        at = [x + 52 + share * (width - 60) for share in (0.25, 0.5)]
        await one.page.mouse.move(at[0], y + 40)
        await one.page.mouse.down()
        await one.page.mouse.move(at[1], y + 60, steps=5)
        assert await one.page.locator("figure.plot .selected").first.is_visible()
        await one.page.mouse.up()
        assert await ticks_s(one) == pytest.approx([1.0, 2.0], abs=0.05)
        await one.page.mouse.move(x + width / 2, y + height / 2)
        await one.page.mouse.wheel(0, -200)  # over a plot that was clicked
        await one.page.wait_for_timeout(300)
        closer = await ticks_s(one)
        assert closer[1] - closer[0] < 0.75
        await one.page.keyboard.press("0")
        assert await ticks_s(one) == pytest.approx([0.0, 4.0], abs=0.05)
        assert one.faults == []


@pytest.mark.timeout(300)
async def test_a_touch_moves_the_cursor_and_two_fingers_zoom(report: Path) -> None:
    async with opened(report, viewport=PHONE, has_touch=True, is_mobile=True) as (one, _):
        x, y, width, height = await axis(one)
        await one.page.touchscreen.tap(x + 52 + 0.5 * (width - 60), y + height / 2)
        assert await cursor_s(one) == pytest.approx(2.0, abs=0.1)
        pinch = """([left, right]) => {
          const canvas = document.querySelector("figure.plot canvas");
          const box = canvas.getBoundingClientRect();
          const send = (type, id, x) => canvas.dispatchEvent(new PointerEvent(type, {
            pointerId: id, pointerType: "touch", clientX: box.left + x, clientY: box.top + 50, bubbles: true, button: 0 }));
          canvas.setPointerCapture = () => {};
          const middle = 52 + (box.width - 60) / 2;
          send("pointerdown", 11, middle - 30); send("pointerdown", 12, middle + 30);
          send("pointermove", 11, middle - 90); send("pointermove", 12, middle + 90);
          send("pointerup", 11, middle - 90); send("pointerup", 12, middle + 90);
        }"""
        await one.page.evaluate(pinch, [0, 0])
        assert await one.page.evaluate("document.body.classList.contains('zoomed')")
        assert one.faults == []


@pytest.mark.timeout(300)
@pytest.mark.parametrize("scheme", ["light", "dark"])
async def test_nothing_overlaps_or_is_too_small_on_phone_and_laptop(report: Path, scheme: str) -> None:
    async with opened(report, color_scheme=scheme) as (one, _):
        for size in (PHONE, LAPTOP):
            await one.page.set_viewport_size(size)
            await one.page.wait_for_timeout(300)
            assert await one.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
            overlaps = await one.page.evaluate(
                """() => {
                  const boxes = [...document.querySelectorAll(
                    "video, dl.figures, ol.events, .transport, figure, .wide, h2, header, .cards, details")]
                    .map((e) => [e.tagName + "." + e.className, e.getBoundingClientRect()]);
                  const found = [];
                  boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {
                    const w = Math.min(p.right, q.right) - Math.max(p.left, q.left);
                    const h = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
                    if (w > 1 && h > 1) found.push(a + " and " + b);
                  }));
                  return found;
                }"""
            )
            assert overlaps == []
            small = await one.page.evaluate(
                """() => [...document.querySelectorAll("body *")].filter((e) => e.childNodes.length && [...e.childNodes]
                  .some((n) => n.nodeType === 3 && n.textContent.trim()) && !["SCRIPT", "STYLE", "NOSCRIPT"].includes(e.tagName)
                  && parseFloat(getComputedStyle(e).fontSize) < 11).map((e) => e.outerHTML.slice(0, 80))"""
            )
            assert small == []
            canvas = one.page.locator("figure.view canvas").first
            await canvas.scroll_into_view_if_needed()
            await one.page.wait_for_timeout(300)
            colours = "(c) => new Set(c.getContext('2d').getImageData(0, 0, c.width, c.height).data).size"
            assert await canvas.evaluate(colours) > 40, "the pad is drawn"
            await one.page.evaluate("scrollTo(0, 0)")
        assert one.faults == []


@pytest.mark.timeout(300)
async def test_a_printed_report_is_whole(report: Path) -> None:
    async with opened(report) as (one, _):
        await one.page.emulate_media(media="print")
        await one.page.locator("figure.view canvas").last.evaluate("(c) => (c.hidden = true)")
        await one.page.evaluate("dispatchEvent(new Event('beforeprint'))")
        cut = """() => [...document.querySelectorAll(".wide, pre, ol.events")]
          .map((e) => getComputedStyle(e).overflowY).filter((overflow) => overflow !== "visible")"""
        assert await one.page.evaluate(cut) == []
        shape = "(c) => (c.width * c.clientHeight) / (c.clientWidth * c.height)"
        assert await one.page.locator("figure.view canvas").first.evaluate(shape) == pytest.approx(1.0, abs=0.02), "to scale"
        assert await one.page.evaluate("document.querySelectorAll('details:not([open])').length") == 0
        pages = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", await one.page.pdf(prefer_css_page_size=True))
        assert {float(width) > float(height) for width, height in pages} == {True}, "landscape"
        assert one.faults == [], "a canvas without a pixel breaks nothing"


@pytest.mark.timeout(300)
async def test_two_films_go_together(tmp_path: Path) -> None:
    logs = [report_flight(), report_flight()]
    logs[1].transitions = [replace(change, at=MonoNs(change.at - 500_000_000)) for change in logs[1].transitions]
    page = write_page(tmp_path / "both.html", render_comparison(logs, [film_of(log) for log in logs]))
    async with opened(page) as (one, asked):
        await one.page.locator("ol.events").first.locator("button", has_text="0.38 m over the deck").click()
        assert await cursor_s(one) == pytest.approx(0.0, abs=0.01)
        for k, at in enumerate((2.0, 1.5)):
            await holds(one, f"Math.abs(document.querySelectorAll('video')[{k}].currentTime - {at}) < 0.06")
        await one.page.click("#play")
        await holds(one, "Number(document.querySelector('#slider').value) > 0.8")
        await one.page.click("#play")
        t = await cursor_s(one)
        for k, at in enumerate((2.0, 1.5)):
            await holds(one, f"Math.abs(document.querySelectorAll('video')[{k}].currentTime - {at + t}) < 0.06")
        assert await one.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert (await violations(one), one.faults) == ([], [])
        assert len([url for url in asked if url.startswith("file:")]) == 1
