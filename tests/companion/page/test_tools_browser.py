"""The page's tools in Debian's Chromium: findings, settings with their faults, on a laptop and a phone."""

from pathlib import Path

import pytest

from companion.parts.page.settings_tool import masked
from tests.companion.page.test_browser import CALM, PHONE, chromium, playwright, window
from tests.companion.page.test_browser import pytestmark as of_a_browser
from tests.companion.page.test_tools import FASTER, RIG, rig
from tests.support.page_service import serving

pytestmark = of_a_browser


@pytest.mark.timeout(500)
async def test_a_person_reads_findings_and_mends_the_settings(tmp_path: Path) -> None:
    path = rig(tmp_path)
    async with (
        serving(tmp_path, settings_file=path, **CALM) as service,
        chromium() as browser,
        window(browser, service) as one,
    ):
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
        for scheme in ("light", "dark"):
            await one.page.emulate_media(color_scheme=scheme)
            await one.page.set_viewport_size(PHONE)
            assert await one.page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        names = await one.page.evaluate(
            "[...document.querySelectorAll('.tool button, .tool textarea, .tool input, .tool select')]"
            ".filter((e) => e.checkVisibility())"
            ".map((e) => e.getAttribute('aria-label') || e.labels?.[0]?.textContent.trim() || e.textContent.trim())"
        )
        assert len(names) >= 4
        assert all(names), "everything that can be used has a name for a screen reader"
        assert one.faults == []
