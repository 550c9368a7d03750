"""Search the documentation as users ask, in Chromium: which page comes first? Needs `make docs`, chromium and playwright.

The site is opened from the disk and over HTTP. The second set of questions was written after the search words of mkdocs.yml.
"""

import asyncio
import functools
import http.server
import shutil
import sys
import threading
from pathlib import Path
from typing import Any

SITE = Path(__file__).parents[1] / "site"
TUNED = {
    "raspberry camera": "cameras",
    "my drone does not see the pad": "symptoms",
    "calibrate camera": "cameras",
    "print a pad": "pads",
    "own pad from photo": "pads",
    "install on raspberry pi": "installation",
    "update the service": "installation",
    "ardupilot parameters": "ardupilot",
    "px4 offboard": "px4",
    "ar.drone wifi": "ardrone",
    "take off by keyboard": "operator",
    "gamepad": "operator",
    "phone browser": "page",
    "record a flight": "recordings",
    "import ulog": "recordings",
    "rosbag": "ros2",
    "wind limit": "limits",
    "mqtt topics": "mqtt",
    "landing_target": "mavlink",
    "train a policy": "training",
}
FRESH = {
    "how do I land my own logo": "pads",
    "battery low": "symptoms",
    "drone keeps hovering": "symptoms",
    "log file format": "recordings",
    "wave height": "sea",
    "what wind can it take": "limits",
    "emergency stop": "operator",
    "set up pixhawk": "ardupilot",
    "gimbal camera": "cameras",
    "ship ais position": "rendezvous",
    "compare filters": "estimator",
    "pdf report": "report",
    "dask cluster": "campaigns",
    "reinforcement learning": "training",
    "heading axes": "conventions",
    "python library": "api",
    "token for the page": "page",
    "kalibr": "cameras",
    "raspberry pi too slow": "symptoms",
    "undo doctor": "doctor",
}


async def first_pages(page: Any, address: str, questions: dict[str, str]) -> dict[str, list[str]]:
    """Return the pages that the search lists for each question, in its order, by their names without suffix."""
    await page.goto(f"{address}/index.html")
    listed = {}
    for question in questions:
        await page.fill(".md-search__input", "")
        await page.click(".md-search__input")
        await page.keyboard.type(question)
        await page.wait_for_timeout(700)
        links = await page.eval_on_selector_all(".md-search-result__item > a", "found => found.map(link => link.pathname)")
        listed[question] = [Path(link).stem for link in links]
    return listed


async def ask(addresses: list[str]) -> None:
    """Print, for each address and set of questions, how often the right page comes first, and each miss."""
    from playwright.async_api import async_playwright

    async with async_playwright() as driver:
        options = ["--disable-gpu", "--no-sandbox"]
        browser = await driver.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        page = await browser.new_page()
        for address in addresses:
            for name, questions in (("tuned on", TUNED), ("fresh", FRESH)):
                listed = await first_pages(page, address, questions)
                missed = {q: listed[q][:3] for q, wanted in questions.items() if listed[q][:1] != [wanted]}
                scheme, right = address.split(":")[0], len(questions) - len(missed)
                print(f"{scheme}, {name}: the right page first for {right} of {len(questions)}")
                for question, pages in missed.items():
                    print(f"  {question}: {', '.join(pages) or 'nothing'}, and not {questions[question]}")
        await browser.close()


def main() -> None:
    if not (SITE / "search/search_index.js").is_file() or shutil.which("chromium") is None:
        sys.exit("needs the site (make docs) and chromium (apt install chromium)")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(SITE))
    handler.log_message = lambda *_: None  # type: ignore[attr-defined]
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    asyncio.run(ask([SITE.as_uri(), f"http://127.0.0.1:{server.server_port}"]))
    server.shutdown()


if __name__ == "__main__":
    main()
