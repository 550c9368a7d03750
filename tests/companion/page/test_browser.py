"""The operator page and the report in Debian's Chromium, over the service's own endpoint and the real pilot."""

import os
import re
import shutil
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from msgspec import structs, to_builtins
from msgspec.structs import replace

from companion.facts import encode as facts
from companion.tools.report.page import render_comparison, write_page, write_report
from companion.tools.report.video import film_of
from estimator.contracts.address import masked
from estimator.contracts.commands import CutMotors, Hover, Land, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import MonoNs
from estimator.vision.detection import Detection, NearThing, PadCheck, PadThing
from tests.companion.page.test_tools import FASTER, RIG, rig
from tests.companion.test_report import report_flight
from tests.fly import record_to
from tests.support.certificates import make_certificates
from tests.support.page_service import TOKEN, PageService, serving
from tests.support.waiting import free_port, until

CHROMIUM = shutil.which("chromium")
playwright = pytest.importorskip("playwright.async_api", reason="playwright is not installed (requirements/dev.txt)")
BUSY = os.getloadavg()[0] / (os.cpu_count() or 1)
BUSY_MAX = 4.0
"""Runnable processes a core beyond which a browser stands still for longer than the page may be silent."""
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium here (apt install chromium)"),
    pytest.mark.skipif(BUSY > BUSY_MAX, reason=f"{BUSY:.0f} processes wait for each core: a browser is not in real time here"),
]
PHONE, LAPTOP = {"width": 390, "height": 844}, {"width": 1280, "height": 800}
SIDEWAYS = {"width": 844, "height": 390}
ORDER_BUTTONS = [f'[data-order="{order}"]' for order in ("takeoff", "begin", "hold", "land", "abort")]
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


BROKEN_DECODER = """
globalThis.VideoDecoder = class {
  static async isConfigSupported() { return { supported: true }; }
  state = "configured";
  configure() {}
  close() { this.state = "closed"; }
  decode() { throw new Error("no picture of mine"); }
};
"""


@pytest.mark.timeout(300)
@pytest.mark.parametrize("script", ["delete globalThis.VideoDecoder", BROKEN_DECODER], ids=["none", "broken"])
async def test_a_browser_that_cannot_decode_video_is_shown_jpeg(tmp_path: Path, script: str) -> None:
    async with serving(tmp_path, **CALM) as service, chromium() as browser, window(browser, service, token="") as one:
        await one.page.add_init_script(script)
        await one.page.goto("about:blank")
        await one.page.goto(f"{service.address}/#token={TOKEN}")
        await playwright.expect(one.page.locator("#picture")).to_have_attribute("data-codec", "jpeg", timeout=WAIT_MS)
        before = service.counted("page", "pictures")
        await until(lambda: service.counted("page", "pictures") > before + 6)
        assert service.page._viewers[0].encoder is None
        assert one.faults == []


@pytest.mark.timeout(500)
async def test_a_person_watches_takes_over_and_cuts_the_motors(tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, chromium() as browser, window(browser, service) as one:
        await one.shows("phase", "search")
        assert TOKEN not in one.page.url, "the token leaves the address"
        await playwright.expect(one.page.locator("#picture-note")).to_be_hidden(timeout=WAIT_MS)
        assert await one.page.evaluate("document.querySelector('#picture').width") > 300
        await one.shows("delay", "ms")
        cov = np.diag([1e-4] * 6 + [1e-3])
        service.believed = RelativeState(MonoNs(0), "ekf", np.array([0.2, 0.3, 2.0]), np.zeros(3), 0.0, cov, MonoNs(0), True)
        seen = PadCheck(MonoNs(0), 1.0, PadThing(0.25, 0.1, -0.15), NearThing(-0.6, 0.7, 0.41))
        service.found = Detection(None, None, MappingProxyType({}), on_pad=seen)
        await playwright.expect(one.page.locator("#above .thing")).to_have_count(2, timeout=WAIT_MS)
        assert await one.page.locator("#above .thing-says").all_text_contents() == ["25 cm wide", "41 cm high"]
        x, y, radius = await one.page.evaluate(
            """() => {
                const of = document.querySelector("#above .thing").getBBox();
                return [of.x + of.width / 2, of.y + of.height / 2, document.querySelector("#above .disc").r.baseVal.value];
            }"""
        )
        scale = radius / service.pilot.pad.disc_radius_m
        # Nose 90 degrees clockwise of the arrow, the pad 2 m ahead of it: the drone is 2 m to port of the pad.
        across = structs.replace(
            service.believed, d_body_pad_level=np.array([2.0, 0.0, 3.0]), v_pad_level=np.array([0.1, -0.2, 0.3]),
            yaw_rad=np.pi / 2, cov=np.diag([0.04, 0.01, 0.09, 1.0, 1.0, 1.0, 0.01]),
        )  # fmt: skip
        state = {"belief": to_builtins(facts.belief(across)), "deck": None}
        place = await one.page.evaluate("async (state) => (await import('/place.js')).placeOf(state)", state)
        assert (place["x_m"], place["y_m"], place["z_m"]) == pytest.approx((0.0, -2.0, 3.0), abs=1e-6)
        assert place["v_m_s"] == pytest.approx((-0.2, -0.1, 0.3), abs=1e-6), "ahead of the nose is to starboard of the arrow"
        assert place["cov_m2"] == pytest.approx((0.01, 0.0, 0.04), abs=1e-9)
        assert (x / scale, y / scale) == pytest.approx((-0.15, -0.1), abs=0.01), "to port of the arrow, which points up"
        await playwright.expect(one.page.locator("#picture")).to_have_attribute("data-codec", "h264", timeout=WAIT_MS)
        assert "accepted" in await one.press("begin")
        assert (await one.press("takeoff")).endswith("refused: the vehicle flies already")
        async with window(browser, service) as two:
            await two.shows("phase", ".")
            assert "accepted" in await two.press("hold")
            await one.shows("phase", "paused")
            await one.shows("events", "another page .*: Hold: accepted")
            await one.shows("reason", "ordered by another page")
            await two.page.click('[data-order="land"]')
            await two.shows("asks-says", "Lands over the pad, 36 cm from its centre; the pad's place is not sure: last")
            await two.slide("confirm", 0.5)
            await two.page.click('[data-order="land"]')
            await playwright.expect(two.page.locator("#asks")).to_be_hidden(timeout=WAIT_MS)
            assert "land" not in [handled.order.value for handled in service.orders], "neither a tap nor half of the way lands"
            assert "accepted" in await two.press("land")
            await one.shows("reason", "ordered by another page")
            await two.shows("reason", "ordered by you")
            assert (await one.press("begin")).endswith('(127.0.0.1) ordered is under way: "Hold" or "Abort" stops it')
            assert (await two.press("begin")).endswith('that you ordered is under way: "Hold" or "Abort" stops it')
            await until(lambda: Land in service.commanded)
            assert "accepted" in await one.press("hold"), "another person's landing too"
            await two.shows("answer", "^$")
            await until(lambda: isinstance(service.command, Hover))
        for way, cut in ((0.5, False), (1.0, True)):
            await one.slide("emergency", way)
            await one.page.wait_for_timeout(500)  # the knob goes back
            orders = [order.order.value for order in service.orders]
            if cut:
                await one.shows("answer", "Cut the motors: sent until the vehicle reports it")
                await one.shows("phase", "cutting the motors: not confirmed yet")
                await one.shows("reason", "ordered by you: the vehicle does not report that its motors stand")
                assert CutMotors in service.commanded
                assert await one.page.is_visible("#emergency"), "it may be given again"
                assert '"Leave the emergency state" ends' in await one.press("takeoff")
                assert "accepted" in await one.press("reset")
                await one.shows("phase", "aborted, hovering")
                await service.lands()
                await one.shows("phase", "aborted, on the ground")
            else:
                assert "emergency" not in orders, "half of the way confirms nothing"
        assert one.faults == []


WITHOUT_STICKS = """() => {
    const send = WebSocket.prototype.send;
    WebSocket.prototype.send = function (text) { window.newest = this; if (!text.includes("sticks")) send.call(this, text); };
}"""
BEGUN_IN_SILENCE = """() => new Promise((done) => {
    newest.onmessage = null;
    const [quiet, answer] = [document.getElementById("quiet"), document.getElementById("answer")];
    const press = (order) => document.querySelector(`[data-order="${order}"]`).click();
    const give = () => quiet.hidden || (press("begin"), done(answer.textContent), press("hold"));
    new MutationObserver(give).observe(quiet, { attributes: true });
})"""


OLD = "getComputedStyle(document.getElementById('phase'), '::before').content"


@pytest.mark.timeout(500)
async def test_over_tls_a_lost_hand_a_silent_and_an_ended_service_are_reported_and_the_next_gets_the_stop(tmp_path: Path) -> None:
    options = {"endpoint": "https", "port": free_port(), **make_certificates(tmp_path), **CALM}
    async with chromium() as browser, AsyncExitStack() as stack:
        async with serving(tmp_path, **options) as service:
            one = await stack.enter_async_context(window(browser, service, ignore_https_errors=True))
            await playwright.expect(one.page.locator("#picture")).to_have_attribute("data-codec", "h264", timeout=WAIT_MS)
            await one.page.evaluate(WITHOUT_STICKS)
            await one.page.click("#by-hand")
            await one.shows("answer", "Fly by hand: .*: nothing received from you for 0.5 s: it hovers")
            assert await one.page.evaluate(BEGUN_IN_SILENCE) == "Begin landing: not sent, the connection is silent"
            await one.shows("lost", "The service is silent.*not known here: a landing may go on, or .*left the drone to itself")
            await one.shows("answer", "^Hold: obeyed$")
            assert await one.page.is_hidden("#lost")
            assert [order.order.value for order in service.orders] == ["manual", "hold", "hold"], "what arrived is not sent again"
            assert "accepted" in await one.press("hold")
            assert await one.page.evaluate(OLD) == "none"
        await until(lambda: one.faults)  # a try has failed
        await one.shows("lost", "The service has ended: the drone hovers, and lands where it is after 4 s if .*Trying again")
        assert "last known" in await one.page.evaluate(OLD)
        await one.shows("answer", "^$")  # what was accepted before is over
        assert await violations(one) == []
        for order, says in (("hold", "^Hold: will be"), ("abort", "^Abort: will be"), ("begin", "^Begin.*not sent.*Abort: will")):
            await one.page.click(f'[data-order="{order}"]', force=True)
            await one.shows("answer", says)
        async with serving(tmp_path, **options) as service:
            await one.shows("phase", "aborted")
            await one.shows("events", "the service started again")
            await one.page.wait_for_function(f"{OLD} === 'none'", timeout=WAIT_MS)
            assert await one.page.is_hidden("#lost")
            assert [order.order.value for order in service.orders] == ["abort"]


@pytest.mark.timeout(500)
async def test_a_wrong_token_is_refused_and_the_right_one_typed_in(tmp_path: Path) -> None:
    async with (
        serving(tmp_path, **CALM) as service,
        chromium() as browser,
        window(browser, service, "not-the-right-token") as one,
    ):
        await one.shows("login-error", "the token is wrong")
        assert await one.page.is_hidden("#flight")
        await one.page.fill("#token", TOKEN)
        await one.page.keyboard.press("Enter")
        await one.shows("link", "live")
        await one.page.reload()
        await one.shows("link", "live")
        assert await one.page.is_hidden("#login"), "a tab keeps its token over a reload"
        await one.page.goto(f"{service.address}/#token=of-another-run")
        await one.shows("login-error", "the token is wrong")


@pytest.mark.timeout(500)
async def test_every_order_is_in_sight_and_stays_in_its_place_on_a_phone_and_a_laptop(tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, chromium() as browser, window(browser, service, has_touch=True) as one:
        for size, least_px in ((LAPTOP, 44), (PHONE, 44), (SIDEWAYS, 40)):
            await one.page.set_viewport_size(size)
            await one.shows("link", "live")
            assert await one.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
            places: dict[str, Any] = {}
            for grow in (False, True):
                if grow:
                    await one.page.click('[data-order="land"]')
                    await playwright.expect(one.page.locator("#asks")).to_be_visible(timeout=WAIT_MS)
                    await one.page.evaluate(
                        "for (const e of [answer, reason, worst]) e.textContent = 'more than a line '.repeat(6)"
                    )
                for name in (
                    *(f'[data-order="{order}"]' for order in ("takeoff", "begin", "hold", "land", "abort")),
                    "#emergency",
                ):
                    box = await one.page.locator(name).bounding_box()
                    assert box["height"] >= least_px, "a thumb's size"
                    assert box["y"] + box["height"] <= size["height"]
                    assert places.setdefault(name, box) == box, "no button moves under a thumb or pointer"
            await one.page.keyboard.press("Escape")
            await one.page.evaluate("answer.textContent = ''")
        await one.page.set_viewport_size({"width": 320, "height": 568})
        assert await one.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        await one.shows("worst", "no status from the vehicle yet")
        assert await one.page.locator("#link").get_attribute("data-level") == "fault", "no green over what is missing"
        assert await one.page.locator('[data-order="begin"].primary').count() == 0
        await one.page.set_viewport_size(SIDEWAYS)
        await one.page.click("#by-hand")
        await playwright.expect(one.page.locator("#sticks")).to_be_visible(timeout=WAIT_MS)
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


FOCUS = """(() => { const e = document.activeElement, s = getComputedStyle(e);
  return [e.dataset.order || e.id || e.className, e.matches(':focus-visible') && s.outlineStyle !== 'none']; })()"""


@pytest.mark.timeout(500)
async def test_the_keyboard_alone_reaches_and_gives_every_order(tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, chromium() as browser, window(browser, service) as one:
        await one.shows("link", "live")

        async def tab_to(name: str) -> list[str]:
            """Press Tab until an element has the focus, which must be seen, and return those before it."""
            passed: list[str] = []
            while True:
                await one.page.keyboard.press("Tab")
                at, seen = await one.page.evaluate(FOCUS)
                assert seen, f"{at} shows no focus"
                if at == name:
                    return passed
                passed.append(at)
                assert len(passed) < 40, passed

        await tab_to("by-hand")
        await one.page.keyboard.press("Enter")
        await one.shows("answer", "Fly by hand: accepted")
        orders = [name for name in await tab_to("emergency") if name in ("takeoff", "begin", "hold", "land", "abort", "clear")]
        assert orders == ["takeoff", "begin", "hold", "land", "abort", "clear"]
        await one.page.keyboard.press("Shift+Tab")
        await one.page.keyboard.press("Enter")
        await one.shows("answer", "Ignore what is on the pad: (accepted|refused)")
        await one.page.focus('[data-order="hold"]')
        await one.page.keyboard.press("Enter")
        await one.shows("answer", "Hold: accepted")
        await until(lambda: isinstance(service.command, Hover))
        await tab_to("emergency")
        for presses in range(10):
            assert "emergency" not in [order.order.value for order in service.orders], presses
            await one.page.keyboard.press("ArrowRight")
        await one.shows("answer", "Cut the motors: sent")


@pytest.mark.timeout(500)
async def test_a_person_flies_by_hand_by_keys_touch_and_gamepad(tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, chromium() as browser, window(browser, service) as one:
        await one.shows("link", "live")

        async def flies(axis: int, sign: float) -> None:
            def commanded() -> bool:
                command = service.command
                return isinstance(command, Velocity) and float(command.v_level[axis]) * sign > 0.1

            await until(commanded, 3.0)

        async def hovers() -> None:
            await until(lambda: isinstance(service.command, Hover), 3.0)

        async def by_keys() -> None:
            for key, axis, sign in (("ArrowUp", 0, 1.0), ("ArrowLeft", 1, -1.0), ("w", 2, -1.0)):
                await one.page.keyboard.down(key)
                await flies(axis, sign)
                await one.page.keyboard.up(key)
                await hovers()

        async def by_touch() -> None:
            box = await one.page.locator(".stick >> nth=1").bounding_box(timeout=3000)
            x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
            await one.page.mouse.move(x, y)
            await one.page.mouse.down()
            await one.page.mouse.move(x, y + box["height"] * 0.4)
            await flies(0, -1.0)
            await one.page.mouse.up()
            await hovers()

        async def by_gamepad() -> None:
            pad = "{connected: true, mapping: 'standard', id: 'a pad', axes: [0, 0, 0.8, 0]}"
            await one.page.evaluate(f"navigator.getGamepads = () => [{pad}]")
            await flies(1, 1.0)
            await one.shows("hand-note", "a pad")

        for way in (by_keys, by_touch, by_gamepad):
            for tried in range(TRIES):
                if service.pilot.operator.hand is None:
                    await one.page.click("#by-hand")
                    await until(lambda: service.pilot.operator.hand is not None)
                try:
                    await way()
                    break
                except (TimeoutError, playwright.TimeoutError):
                    assert tried < TRIES - 1, way.__name__
                    await one.page.mouse.up()
        if service.pilot.operator.hand is not None:
            await one.shows("by-hand", "Give the hand back")
            await one.page.click("#by-hand")
            await one.shows("answer", "Give the hand back: (accepted|refused: nobody)")
        await hovers()
        assert one.faults == []


@pytest.mark.timeout(500)
async def test_a_person_reads_findings_and_mends_the_settings(tmp_path: Path) -> None:
    path = rig(tmp_path)
    async with serving(tmp_path, settings_file=path, **CALM) as service, chromium() as browser, window(browser, service) as one:
        await service.lands()
        (tmp_path / "token").unlink()
        await one.shows("link", "live")
        await one.page.click("#examine")
        await one.shows("findings", r"error.*http\.token_file.*Cure:")
        (tmp_path / "token").write_text("a-token-of-sixteen-and-more")
        await one.page.click("#show-settings")
        area = one.page.locator("#settings-text")
        await playwright.expect(area).to_have_value(masked(RIG))
        await area.fill(masked(RIG).replace("20.0", "-4"))
        await one.page.click("#save-settings")
        await one.shows(
            "settings-note", "Line 17: Not saved: expert.guidance.rate_hz must be a number from 5 to 200 Hz, found -4"
        )
        assert await area.evaluate("(a) => a.value.slice(a.selectionStart, a.selectionEnd)") == "rate_hz = -4"
        await area.fill(masked(FASTER))
        await one.page.click("#save-settings")
        await one.shows("settings-note", r"Saved; the one before is rig\.toml\.before")
        assert path.read_text() == FASTER
        await one.page.set_viewport_size(PHONE)
        assert await one.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert (await violations(one), one.faults) == ([], [])


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
