"""The npm package ar-drone, written years before for the real drone, flies ours: navdata and H.264 through its own parsers.

The packages are installed outside the repository; DECKLANDER_NODE_MODULES names the folder. In CI they must be there.
"""

import asyncio
import json
import os
import shutil
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from sitl.emulators.ardrone import truth_log

ROOT = Path(__file__).parents[2]
SCRIPT = Path(__file__).parent / "ardrone_client" / "fly.js"
LIMIT_S = 40

ON_DECK = """
title = "On the pad of a ship in calm water"
[sea]
significant_height_m = 0.1
[wind]
speed_m_s = 0.5
gust_sigma_m_s = 0.0
[start]
where = "pad"
"""


def stranger() -> tuple[str, Path]:
    """Node and the folder of its packages; without them the test is skipped, in CI it fails."""
    node, named = shutil.which("node"), os.environ.get("DECKLANDER_NODE_MODULES")
    if node is not None and named and (Path(named) / "ar-drone" / "package.json").is_file():
        return node, Path(named)
    missing = "node is not installed" if node is None else f"DECKLANDER_NODE_MODULES ({named!r}) holds no package ar-drone"
    if os.environ.get("CI"):
        pytest.fail(f"{missing}, and in CI this test must run")
    pytest.skip(missing)


@asynccontextmanager
async def drone(scenario: Path, truth: Path) -> AsyncIterator[dict[str, int]]:
    """Yield the simulated drone in a process of its own; ends when its standard input closes."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "sitl.emulators.ardrone.serve", str(scenario), "--seed", "3", "--truth", str(truth),
        "--navdata-port", "0", "--video-port", "0", "--at-port", "0", "--control-port", "0",
        cwd=ROOT, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        async with asyncio.timeout(60):
            ready = json.loads(await process.stdout.readline())
        yield ready["ports"]
    finally:
        process.stdin.close()
        async with asyncio.timeout(60):
            ended = json.loads((await process.stdout.read()).splitlines()[-1])
            code = await process.wait()
    assert ended["event"] == "ended"
    assert code == 0


async def run_node(node: str, modules: Path, ports: dict[str, int], mode: str) -> dict[str, Any]:
    process = await asyncio.create_subprocess_exec(
        node, "--no-deprecation", str(SCRIPT), str(modules), "127.0.0.1",
        str(ports["at"]), str(ports["navdata"]), str(ports["video"]), mode, str(LIMIT_S),
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    out, err = await process.communicate()
    assert process.returncode == 0, err.decode()
    return dict(json.loads(out))


@pytest.mark.parametrize("mode", ["demo", "full"])
async def test_it_takes_off_sees_and_lands(mode: str, tmp_path: Path) -> None:
    node, modules = stranger()
    scenario, truth = tmp_path / "on_deck.toml", tmp_path / "truth.jsonl"
    scenario.write_text(ON_DECK)
    async with drone(scenario, truth) as ports:
        seen = await run_node(node, modules, ports, mode)

    assert seen["landed"]
    states = seen["controlStates"]
    assert states[0] == "CTRL_LANDED"
    assert states[-1] == "CTRL_LANDED"
    flown = [s for s in states if s != "CTRL_LANDED"]
    assert flown == ["CTRL_TRANS_TAKEOFF", "CTRL_HOVERING", "CTRL_FLYING", "CTRL_HOVERING", "CTRL_TRANS_LANDING"]
    assert seen["flyingBit"]
    assert 0.5 < seen["altitude"]["max"] < 2.0
    assert seen["tilt"]["pitch"] < -1.5, "nose down to fly ahead"
    assert seen["velocity"]["forward"] > 100
    assert 80 <= seen["battery"] <= 90

    received_at = seen["navdata"]
    rate_hz = 1000 * received_at["count"] / received_at["ms"]
    assert received_at["errors"] == []
    assert received_at["lostSequence"] <= received_at["count"] // 50
    # A machine that others keep busy sends less than the drone's 15 and 200 a second, and never more.
    if mode == "demo":
        assert 1 < rate_hz < 18
        assert received_at["full"] == 0
    else:
        assert 30 < rate_hz < 220, "many times what the demo mode sends"
        assert received_at["full"] > 0.9 * received_at["count"]
    assert seen["config"] == [["general:navdata_demo", "acknowledged"], ["video:video_channel", "acknowledged"]]

    video = seen["video"]
    # The client's patience of a second is shorter than some pauses of a busy machine; it connects again.
    assert [error for error in video["errors"] if error != "TcpVideoStream timeout after 1000 ms."] == []
    assert video["size"] == [640, 360, 640, 368]
    assert video["codec"] == 4
    assert video["badPayload"] == 0, "every payload is Annex-B"
    assert video["frames"] >= 15
    assert video["idr"] >= video["frames"] // 15
    assert video["gaps"] <= len(video["errors"])

    truths = truth_log.read(truth)
    assert {t.phase.name.lower() for t in truths} == {"landed", "taking_off", "hovering", "flying", "landing"}
    assert max(t.p_pad_ned[2] - t.p_body_ned[2] for t in truths) > 0.5
    touchdown = truths[-1].touchdown
    assert touchdown.surface in ("pad", "deck")
    assert 0.0 < touchdown.vertical_speed_m_s < 1.0
