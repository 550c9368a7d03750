"""Program inside the machine: the driver on both cameras, one scene after the other; how each ended as a line of JSON."""

import asyncio
import json
import os
import sys
import time
import traceback
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from qualification.v4l2_vm import scenes_vivid, scenes_webcam
from qualification.v4l2_vm.machine import MARK

SCENES = (*scenes_vivid.SCENES, *scenes_webcam.SCENES)


async def play(scene: Callable[[], Awaitable[None]]) -> None:
    """Play a scene and report its error, or the empty text; descriptors that it leaves open are one."""
    began, before, error = time.monotonic(), len(os.listdir("/proc/self/fd")), ""
    for last in (False, True):
        try:
            await scene()
            error = ""
        except Exception:
            error = traceback.format_exc()
        # The kernel drops a camera on its bus that a starved machine lets wait for seconds; that is no fault of the driver.
        if last or "no such camera" not in error:
            break
    left = len(os.listdir("/proc/self/fd")) - before
    error = error or (f"{left} descriptors are left open" if left else "")
    say({"name": scene.__name__, "error": error, "took_s": round(time.monotonic() - began, 2)})


async def play_all() -> None:
    for scene in SCENES:
        await play(scene)


def say(what: dict[str, Any]) -> None:
    sys.stdout.write(f"\n{MARK}{json.dumps(what)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    scenes_vivid.link()
    asyncio.run(play_all())
    say({"name": "end", "uptime_s": float(Path("/proc/uptime").read_text().split()[0])})
