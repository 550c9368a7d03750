"""Debian's Chromium for tests: its marks, a window with the operator's page, and what axe-core says of it."""

import os
import re
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.support.page_service import TOKEN, PageService

CHROMIUM = shutil.which("chromium")
playwright = pytest.importorskip("playwright.async_api", reason="playwright is not installed (requirements/dev.txt)")
BUSY = os.getloadavg()[0] / (os.cpu_count() or 1)
BUSY_MAX = 4.0
"""Runnable processes a core beyond which a browser stands still for longer than the page may be silent."""
MARKS = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (apt install chromium)"),
    pytest.mark.skipif(BUSY > BUSY_MAX, reason=f"{BUSY:.0f} processes wait for each core: a browser is not in real time here"),
]
PHONE, LAPTOP = {"width": 390, "height": 844}, {"width": 1280, "height": 800}
SIDEWAYS = {"width": 844, "height": 390}
WAIT_MS = 60_000.0
TRIES = 5
"""A browser that a busy machine stops for half a second loses the hand, for some seconds the connection, as it must."""
CALM = {"picture_rate_hz": 4.0}
"""Chromium paints by the processor here."""


class Window:
    """A browser's window with the page, and what went wrong in it."""

    def __init__(self, page: Any) -> None:
        self.page = page
        self.faults: list[str] = []
        page.set_default_timeout(WAIT_MS)
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("console", lambda said: self.faults.append(said.text) if said.type == "error" else None)

    async def shows(self, name: str, pattern: str) -> str:
        """Wait until an element's text matches, and return it."""
        await playwright.expect(self.page.locator(f"#{name}")).to_have_text(re.compile(pattern), timeout=WAIT_MS)
        return str(await self.page.inner_text(f"#{name}"))

    async def press(self, order: str) -> str:
        """Press an order's button, also one that would be refused, and return the answer."""
        button = self.page.locator(f'[data-order="{order}"]')
        name = await button.inner_text()
        for _ in range(TRIES):
            await button.click(force=True)
            if await self.page.is_visible("#asks"):
                await self.slide("confirm")
            answer = await self.shows("answer", f"{name}: (accepted|refused|no answer|not sent)")
            if "no answer" not in answer and "not sent" not in answer:
                break
        return answer

    async def slide(self, name: str, way: float = 1.0) -> None:
        """Draw the knob of a slide so far."""
        knob = await self.page.locator(f"#{name} .knob").bounding_box()
        track = await self.page.locator(f"#{name}").bounding_box()
        x, y = knob["x"] + knob["width"] / 2, knob["y"] + knob["height"] / 2
        await self.page.mouse.move(x, y)
        await self.page.mouse.down()
        await self.page.mouse.move(x + way * track["width"], y, steps=8)
        await self.page.mouse.up()


@asynccontextmanager
async def chromium() -> AsyncIterator[Any]:
    # As root, which a container's tests are, Chromium runs only without its sandbox; it opens nothing but our own page.
    options = ["--disable-gpu", *(["--no-sandbox"] if os.getuid() == 0 else [])]
    async with playwright.async_playwright() as driver:
        browser = await driver.chromium.launch(executable_path=CHROMIUM, args=options, timeout=120_000)
        yield browser
        await browser.close()


@asynccontextmanager
async def window(browser: Any, service: PageService, token: str = TOKEN, **options: Any) -> AsyncIterator[Window]:
    context = await browser.new_context(viewport=LAPTOP, **options)
    opened = Window(await context.new_page())
    await opened.page.goto(f"{service.address}/" + (f"#token={token}" if token else ""))
    yield opened
    await context.close()


async def violations(one: Window) -> list[str]:
    """Return the rules of axe-core that the page breaks in its present state, each with the elements, in both colour schemes."""
    axe = pytest.importorskip("axe_playwright_python", reason="axe-core is not installed (requirements/dev.txt)")
    found = []
    for scheme in ("light", "dark"):
        await one.page.emulate_media(color_scheme=scheme)
        await one.page.evaluate("typeof axe === 'object' || " + Path(axe.__file__).with_name("axe.min.js").read_text())
        result = await one.page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        found += [f"{scheme}: {v['id']}: {[n['target'] for n in v['nodes']]}" for v in result["violations"]]
    return found
