"""The operator page in Debian's Chromium, over the service's own endpoint and the real pilot.

One browser serves all of them. Its layout in all sizes, and a report that opens from it, are in `make qualify`.
"""

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import pytest_asyncio
from msgspec import structs, to_builtins

from companion.facts import encode as facts
from estimator.contracts.address import masked
from estimator.contracts.commands import CutMotors, Hover, Velocity
from estimator.contracts.estimates import RelativeState
from estimator.contracts.time import MonoNs
from estimator.vision.detection import Detection, NearThing, PadCheck, PadThing
from tests.companion.page.test_settings_tool import FASTER, RIG, rig
from tests.support.browser import CALM, MARKS, PHONE, TRIES, WAIT_MS, chromium, playwright, violations, window
from tests.support.certificates import make_certificates
from tests.support.page_service import TOKEN, serving
from tests.support.waiting import free_port, until

pytestmark = [*MARKS, pytest.mark.asyncio(loop_scope="module")]
BELIEVED = RelativeState(MonoNs(0), "ekf", np.array([0.2, 0.3, 2.0]), np.zeros(3), 0.0, np.eye(7) / 1e4, MonoNs(0), True)
FELT = """() => {
    window.felt = [];
    navigator.vibrate = ([first_ms]) => felt.push(first_ms);
    const start = OscillatorNode.prototype.start;
    OscillatorNode.prototype.start = function (at_s) { felt.push(`${this.frequency.value} Hz`); start.call(this, at_s); };
}"""
STOPPED, LOST = 150, 400  # the first length of each alarm's vibration, ms


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def browser() -> AsyncIterator[Any]:
    async with chromium() as one:
        yield one


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
async def test_a_browser_that_cannot_decode_video_is_shown_jpeg(browser: Any, tmp_path: Path, script: str) -> None:
    async with serving(tmp_path, **CALM) as service, window(browser, service, token="") as one:
        await one.page.add_init_script(script)
        await one.page.goto("about:blank")
        await one.page.goto(f"{service.address}/#token={TOKEN}")
        await playwright.expect(one.page.locator("#picture")).to_have_attribute("data-codec", "jpeg", timeout=WAIT_MS)
        before = service.counted("page", "pictures")
        await until(lambda: service.counted("page", "pictures") > before + 6)
        assert service.page._viewers[0].encoder is None
        assert one.faults == []


@pytest.mark.timeout(500)
async def test_a_person_watches_takes_over_and_cuts_the_motors(browser: Any, tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, window(browser, service) as one:
        await one.shows("phase", "search")
        assert TOKEN not in one.page.url, "the token leaves the address"
        await playwright.expect(one.page.locator("#picture-note")).to_be_hidden(timeout=WAIT_MS)
        assert await one.page.evaluate("document.querySelector('#picture').width") > 300
        await one.shows("delay", "ms")
        service.believed = BELIEVED
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
            BELIEVED, d_body_pad_level=np.array([2.0, 0.0, 3.0]), v_pad_level=np.array([0.1, -0.2, 0.3]),
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
        await one.page.evaluate(FELT)
        assert (await one.press("takeoff")).endswith("refused: the vehicle flies already")
        assert await one.page.evaluate("felt") == [], "off until a person wants it"
        await one.page.click("#alarms-ask [value=on]")
        await one.page.wait_for_function("felt.includes('620 Hz')")
        async with window(browser, service) as two:
            await two.shows("phase", ".")
            assert "accepted" in await two.press("hold")
            await one.shows("phase", "paused")
            await one.shows("events", "another page .*: Hold: accepted")
            assert (await one.page.evaluate("felt"))[-4:] == [STOPPED, *["880 Hz"] * 3]
            await one.shows("reason", "ordered by another page")
            await two.page.click('[data-order="land"]')
            await two.shows("asks-says", "Lands 0.4 m beside the pad.*; the place of the pad is not sure: last seen .*; now over")
            await two.slide("confirm", 0.5)
            await two.page.click('[data-order="land"]')
            await playwright.expect(two.page.locator("#asks")).to_be_hidden(timeout=WAIT_MS)
            assert "land" not in [handled.order.value for handled in service.orders], "neither a tap nor half of the way lands"
            assert "accepted" in await two.press("land")
            await one.shows("reason", "ordered by another page")
            await two.shows("reason", "ordered by you")
            await one.shows("phase", "landing where it is")
            await until(lambda: isinstance(service.command, Velocity) and service.command.v_level.item(2) > 0.0)
            assert "accepted" in await one.press("hold"), "another person's landing too"
            await two.shows("answer", "^another page .* ordered: Hold$")
            await until(lambda: isinstance(service.command, Hover))
            assert "accepted" in await one.press("land")
            await two.shows("phase", "landing where it is")
            assert "accepted" in await one.press("begin"), "it lands on the pad instead"
            await until(lambda: not service.pilot.lands_here)
            assert "accepted" in await one.press("hold")
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
async def test_over_tls_a_lost_hand_and_a_silent_or_ended_service_are_shown_and_the_next_gets_the_stop(
    browser: Any, tmp_path: Path
) -> None:
    options = {"endpoint": "https", "port": free_port(), **make_certificates(tmp_path), **CALM}
    async with AsyncExitStack() as stack:
        async with serving(tmp_path, **options) as service:
            one = await stack.enter_async_context(window(browser, service, ignore_https_errors=True))
            await playwright.expect(one.page.locator("#picture")).to_have_attribute("data-codec", "h264", timeout=WAIT_MS)
            await one.page.evaluate(WITHOUT_STICKS)
            await one.page.evaluate(FELT)
            await one.page.click("#alarms-ask [value=on]")
            await one.page.click("#by-hand")
            await one.shows("answer", "Fly by hand: .*: nothing received from you for 0.5 s: it hovers")
            assert await one.page.evaluate(BEGUN_IN_SILENCE) == "Begin landing: not sent, the connection is silent"
            await one.shows("lost", "The service is silent.*not known here: a landing may go on, or .*left the drone to itself")
            await one.shows("answer", "^Hold: obeyed$")
            assert await one.page.is_hidden("#lost")
            assert [order.order.value for order in service.orders] == ["manual", "hold", "hold"], "what arrived is not sent again"
            assert "accepted" in await one.press("hold")
            await playwright.expect(one.page.locator(".stale #phase")).to_have_count(0, timeout=WAIT_MS)
        await until(lambda: one.faults)  # a try has failed
        await one.shows("lost", "The service has ended: the drone hovers, and lands where it is after 4 s if .*Trying again")
        assert "last known" in await one.page.evaluate(OLD)
        await one.shows("answer", "^$")  # what was accepted before is over
        felt = await one.page.evaluate("felt")
        assert 0 < felt.count(LOST) == felt.count("220 Hz") < 6, "once for each loss, however often it is tried again"
        assert await violations(one) == []
        for order, says in (("hold", "^Hold: will be"), ("abort", "^Abort: will be"), ("begin", "^Begin.*not sent.*Abort: will")):
            await one.page.click(f'[data-order="{order}"]', force=True)
            await one.shows("answer", says)
        async with serving(tmp_path, **options) as service:
            await one.shows("phase", "aborted")
            await one.shows("events", "the service started again")
            await playwright.expect(one.page.locator(".stale #phase")).to_have_count(0, timeout=WAIT_MS)
            assert await one.page.is_hidden("#lost")
            assert [order.order.value for order in service.orders] == ["abort"]


@pytest.mark.timeout(500)
async def test_a_wrong_token_is_refused_and_the_right_one_typed_in(browser: Any, tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, window(browser, service, "not-the-right-token") as one:
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


FOCUS = """(() => { const e = document.activeElement, s = getComputedStyle(e);
  return [e.dataset.order || e.id || e.className, e.matches(':focus-visible') && s.outlineStyle !== 'none']; })()"""


@pytest.mark.timeout(500)
async def test_the_keyboard_alone_reaches_and_gives_every_order(browser: Any, tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, window(browser, service) as one:
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
        await one.shows("by-hand", "Fly by hand")  # a change of the hand frees the slides
        await tab_to("emergency")
        await one.page.keyboard.press("ArrowRight")
        await one.page.keyboard.press("Escape")
        assert (await one.page.evaluate(FOCUS))[0] != "emergency", "emptied, and left"
        await one.page.focus("#emergency")
        for presses in range(10):
            assert "emergency" not in [order.order.value for order in service.orders], presses
            await one.page.keyboard.press("ArrowRight")
        await one.shows("answer", "Cut the motors: sent")


@pytest.mark.timeout(500)
async def test_a_person_flies_by_hand_by_keys_touch_and_gamepad(browser: Any, tmp_path: Path) -> None:
    async with serving(tmp_path, **CALM) as service, window(browser, service) as one:
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

        async def by_keys_past_clicks_and_slides() -> None:
            for clicked in ('[data-order="land"]', "#lines"):
                await one.page.keyboard.down("w")
                await flies(2, -1.0)
                await one.page.click(clicked)
                await hovers()
                await one.page.keyboard.down("w")  # it repeats
                await flies(2, -1.0)
                await one.page.keyboard.up("w")
                await hovers()
            await one.page.keyboard.down("w")
            await one.page.evaluate("dispatchEvent(new Event('blur'))")
            await hovers()
            for slide in ("confirm", "emergency"):
                await one.slide(slide, 0.3)
                await one.page.click(f"#{slide} .text")
                assert (await one.page.evaluate(FOCUS))[0] != slide
                await one.page.focus(f"#{slide}")
                for _ in range(11):
                    await one.page.keyboard.press("ArrowUp")
                assert await one.page.locator(f"#{slide}").get_attribute("aria-valuenow") == "0"
            assert not {"land", "emergency"} & {order.order.value for order in service.orders}
            await one.page.click("#show-settings")
            await one.page.click("#settings-text")
            await one.page.keyboard.type("www")
            await one.shows("keys-off", "The keys are off")
            assert "www" in await one.page.input_value("#settings-text")
            await one.page.click("#lines")
            await playwright.expect(one.page.locator("#keys-off")).to_be_hidden(timeout=3000)

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

        for way in (by_keys, by_keys_past_clicks_and_slides, by_touch, by_gamepad):
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
async def test_a_person_reads_findings_and_mends_the_settings(browser: Any, tmp_path: Path) -> None:
    path = rig(tmp_path)
    async with serving(tmp_path, settings_file=path, **CALM) as service, window(browser, service) as one:
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
