"""Make the picture of README.md from one demo flight: the deck camera with its overlay, the page on a phone, the touchdown.

    python -m benches.readme_gif --write docs          # docs/landing.gif; needs requirements/dev.txt and chromium, and a minute

The flight is `decklander demo --page`, begun from the phone's page as a person would. The camera's frames are those of its report,
the touchdown is the report's own view, and all three stand at the same instant.
"""

import argparse
import asyncio
import base64
import io
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
from PIL import Image
from playwright.async_api import Browser, async_playwright
from playwright.async_api import Error as PageError

PHONE = {"width": 390, "height": 844}
CAMERA_PX, PHONE_PX, TOUCHDOWN_PX = (400, 225), (208, 450), (400, 225)
RATE_HZ, LAST_S, HOLD_S = 6.0, 9.0, 2.5
COLOURS = 56


async def fly(folder: Path, seed: int, browser: Browser) -> tuple[list[tuple[float, bytes]], float]:
    """Fly one demo from a phone's page; return its screenshots with their times, and the time at which the flight was ended."""
    words = ["demo", "--page", "8491", "--seed", str(seed), "--report", str(folder)]
    child = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "companion.cli.main", *words, stderr=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
    )
    assert child.stderr is not None
    address = ""
    while not address:
        found = re.search(rb"operator page: (\S+)", await child.stderr.readline())
        address = found[1].decode() if found else ""
    drain = asyncio.create_task(child.stderr.read())
    context = await browser.new_context(viewport=PHONE)  # type: ignore[arg-type]
    page = await context.new_page()
    while True:
        try:
            await page.goto(address)
            break
        except PageError:  # the service prints the address before it listens
            await asyncio.sleep(0.5)
    await page.locator("#picture-note").wait_for(state="hidden", timeout=60_000)
    await page.locator('[data-order="begin"]').click()
    shots: list[tuple[float, bytes]] = []
    end = time.monotonic() + 90.0
    landed: float | None = None
    while time.monotonic() < end and (landed is None or time.monotonic() < landed + 1.0):
        shots.append((time.monotonic(), await page.screenshot(type="jpeg", quality=85)))
        phase = (await page.inner_text("#phase")).lower()
        sys.stderr.write(f"\r{len(shots)} {phase:<40.40}")
        if phase.startswith(("paused", "waiting for the start")):  # a machine that stood still is a hold
            await page.locator('[data-order="begin"]').click(force=True)
        if landed is None and "landed" in phase:
            landed = time.monotonic()
    ended = time.monotonic()
    child.send_signal(signal.SIGINT)
    out, _ = await asyncio.gather(child.stdout.read() if child.stdout else asyncio.sleep(0, b""), drain)
    await child.wait()
    await context.close()
    sys.stderr.write(out.decode())
    return shots, ended


def camera_frames(report: str) -> list[tuple[float, Image.Image]]:
    """Return the frames of the report's video with their times from its beginning."""
    found = re.search(r'id="film-0"[^>]*>([^<]+)<', report)
    if found is None:
        raise SystemExit("the report has no video")
    text = found[1].strip()
    with av.open(io.BytesIO(base64.b64decode(text))) as film:
        return [(float(frame.time or 0.0), frame.to_image()) for frame in film.decode(video=0)]


async def touchdown(report: Path, browser: Browser) -> Image.Image:
    """Return the report's view of the way over the pad from above, at the end of the flight."""
    page = await (await browser.new_context(viewport={"width": 1100, "height": 900})).new_page()
    await page.goto(report.as_uri())
    view = page.locator("figure.view, .views figure, figure:has(canvas)").first
    await view.scroll_into_view_if_needed()
    await page.evaluate("clock.seek(clock.end)")
    await asyncio.sleep(1.0)
    return Image.open(io.BytesIO(await view.screenshot()))


def composed(shots: list[tuple[float, bytes]], ended: float, frames: list[tuple[float, Image.Image]], plot: Image.Image) -> Iterator[Image.Image]:
    """Yield the pictures of the animation: the last seconds of the flight, each part as it was at that instant."""
    last = frames[-1][0]
    fitted = plot.convert("RGB")
    fitted.thumbnail(TOUCHDOWN_PX)
    size = (CAMERA_PX[0] + PHONE_PX[0] + 12, PHONE_PX[1])
    for step in range(round(LAST_S * RATE_HZ)):
        at = last - LAST_S + step / RATE_HZ
        camera = min(frames, key=lambda one: abs(one[0] - at))[1]
        phone = min(shots, key=lambda one: abs(one[0] - ended + last - at))[1]
        sheet = Image.new("RGB", size, "white")
        sheet.paste(camera.resize(CAMERA_PX, Image.Resampling.LANCZOS), (0, 0))
        sheet.paste(Image.open(io.BytesIO(phone)).resize(PHONE_PX, Image.Resampling.LANCZOS), (CAMERA_PX[0] + 12, 0))
        sheet.paste(fitted, ((CAMERA_PX[0] - fitted.width) // 2, CAMERA_PX[1]))
        yield sheet


def still(pictures: list[Image.Image]) -> list[Image.Image]:
    """Return the pictures with few colours, where what changed by less than the camera's noise stays as it was."""
    palette = pictures[len(pictures) // 2].quantize(COLOURS, dither=Image.Dither.NONE)
    kept = np.asarray(pictures[0], np.int16)
    out = []
    for picture in pictures:
        new = np.asarray(picture, np.int16)
        kept = np.where(np.abs(new - kept).max(axis=2, keepdims=True) > 18, new, kept)
        out.append(Image.fromarray(kept.astype(np.uint8)).quantize(palette=palette, dither=Image.Dither.NONE))
    return out


async def _make(args: argparse.Namespace) -> int:
    options = ["--disable-gpu", "--no-sandbox"]
    async with async_playwright() as driver:
        browser = await driver.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        with tempfile.TemporaryDirectory() as folder:
            shots, ended = await fly(Path(folder), args.seed, browser)
            report = Path(folder) / "index.html"
            plot = await touchdown(report, browser)
            frames = camera_frames(report.read_text(encoding="utf-8"))
        await browser.close()
    pictures = still(list(composed(shots, ended, frames, plot)))
    path = args.write / "landing.gif"
    each_ms = [round(1000 / RATE_HZ)] * (len(pictures) - 1) + [round(1000 * HOLD_S)]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=each_ms, loop=0, optimize=True)
    print(f"{path}: {len(pictures)} pictures of {pictures[0].size}, {path.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, default=Path("docs"), help="folder for landing.gif")
    parser.add_argument("--seed", type=int, default=1)
    sys.exit(asyncio.run(_make(parser.parse_args())))
