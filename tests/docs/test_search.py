"""Twenty questions, as users ask them, find the right page first in the built site: opened from the disk, and over HTTP.

`make docs` builds the site and runs this; elsewhere it is skipped where there is no site.
"""

import functools
import http.server
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.browser import LAPTOP, MARKS, WAIT_MS, chromium, playwright

expect = playwright.expect
SITE = Path(__file__).parents[2] / "site"
pytestmark = [*MARKS, pytest.mark.skipif(not (SITE / "index.html").is_file(), reason="there is no site: make docs")]
QUESTIONS: dict[str, list[str]] = tomllib.loads(Path(__file__).with_name("questions.toml").read_text())
"""Questions of users, and the pages that answer each."""


@pytest.fixture
def served() -> Iterator[str]:
    """Yield the site's address over HTTP."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(SITE))
    handler.log_message = lambda *_: None  # type: ignore[attr-defined]
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}/index.html"
        server.shutdown()


async def first_results(address: str, questions: list[str]) -> dict[str, str]:
    """Return the page that is found first for each question."""
    found = {}
    async with chromium() as browser:
        page = await browser.new_page(viewport=LAPTOP)
        await page.goto(address)
        field, results = page.locator(".md-search__input"), page.locator(".md-search-result__link")
        await field.click()
        for question in questions:
            await field.fill("x")  # the page searches by keys
            await field.press("Backspace")
            await expect(results).to_have_count(0, timeout=WAIT_MS)
            await field.fill(question[:-1])
            await field.press(question[-1])
            await results.first.wait_for(state="attached", timeout=WAIT_MS)
            link = await results.first.get_attribute("href")
            found[question] = Path((link or "").partition("?")[0].partition("#")[0]).stem
    return found


@pytest.mark.parametrize("over", ["disk", "http"])
async def test_twenty_of_twenty_questions_find_their_page_first(over: str, served: str) -> None:
    questions = list(QUESTIONS) if over == "disk" else list(QUESTIONS)[:5]
    found = await first_results((SITE / "index.html").as_uri() if over == "disk" else served, questions)
    assert {question: page for question, page in found.items() if page not in QUESTIONS[question]} == {}
