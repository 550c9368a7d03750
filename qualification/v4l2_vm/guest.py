"""Program inside the machine: the driver on both cameras, one scene after the other, results as JSON lines.

It judges nothing; `test_vivid.py` and `test_webcam.py` do, outside.
"""

import asyncio
import json
import os
import sys
import time
import traceback
from collections.abc import Awaitable, Callable
from pathlib import Path

from qualification.v4l2_vm import scenes_vivid, scenes_webcam
from qualification.v4l2_vm.capture import Seen
from qualification.v4l2_vm.machine import MARK


async def scenes() -> None:
    for scene in (*scenes_vivid.SCENES, *scenes_webcam.SCENES):
        await report(scene)


async def report(scene: Callable[[], Awaitable[Seen]]) -> None:
    began, before = time.monotonic(), len(os.listdir("/proc/self/fd"))
    seen: Seen = {}
    for last in (False, True):
        try:
            seen = await scene()
        except Exception:
            seen = {"error": traceback.format_exc()}
        # The kernel drops a camera on its bus that a starved machine lets wait for seconds; that is no fault of the driver.
        if last or "no such camera" not in seen.get("error", ""):
            break
    seen |= {"name": scene.__name__, "took_s": round(time.monotonic() - began, 2)}
    seen["descriptors_left"] = len(os.listdir("/proc/self/fd")) - before
    say(seen)


def say(what: Seen) -> None:
    sys.stdout.write(f"\n{MARK}{json.dumps(what)}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    scenes_vivid.link()
    asyncio.run(scenes())
    say({"name": "end", "uptime_s": float(Path("/proc/uptime").read_text().split()[0])})
