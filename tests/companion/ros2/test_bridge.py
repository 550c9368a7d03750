"""A simulated flight in ROS 2 while it is flown: the command line beside the live port, with a stand-in for ROS' own library."""

import asyncio
import json
import os
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.companion.live.test_live import TOKEN, serve_live
from tests.support.waiting import until

pytest.importorskip("rosbags", reason="needs the extra ros2")
STAND_IN = Path(__file__).parents[2] / "support/stand_in_ros"
WORDS = [sys.executable, "-m", "companion.cli.main", "ros2"]


def published(path: Path) -> dict[str, list[Any]]:
    """Read what was published, by the library that ROS users read messages with."""
    from rosbags.typesys import Stores, get_typestore

    store, out = get_typestore(Stores.ROS2_JAZZY), defaultdict(list)
    for line in path.read_text().splitlines():
        output = json.loads(line)
        assert (output["durability"] == "TRANSIENT_LOCAL") is (output["topic"] == "/tf_static")
        out[output["topic"]].append(store.deserialize_cdr(bytes.fromhex(output["cdr"]), output["kind"]))
    return out


@contextmanager
def started(address: str, file: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONPATH": f"{STAND_IN}:{Path.cwd()}", "STAND_IN_ROS": str(file)}
    with subprocess.Popen([*WORDS, address, *words], stderr=subprocess.PIPE, text=True, env=environment) as bridge:
        try:
            yield bridge
        finally:
            bridge.kill()


async def test_a_flight_is_published_while_it_is_flown_and_again_after_the_service_was_gone(tmp_path: Path) -> None:
    file, token = tmp_path / "published", tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    with ExitStack() as stack:
        async with serve_live(token_file=str(token)) as service:
            bridge = stack.enter_context(started(service.address, file, "--token-file", str(token), "--config", "sim"))
            await until(lambda: service.counted("viewers") == 1)
            await service.fly(4.0)
            await until(lambda: file.exists() and b"/rosout" in file.read_bytes())
            port = service.server.port
        before = file.read_bytes().count(b"/tf_static")
        async with serve_live(token_file=str(token), port=port) as again:
            await until(lambda: again.counted("viewers") == 1)
            await again.fly(0.5)
            await until(lambda: file.read_bytes().count(b"/tf_static") > before)
        bridge.terminate()
        _, output = await asyncio.to_thread(bridge.communicate, timeout=30)
    assert bridge.returncode == 143
    assert "connected to 'drone'" in output
    assert "trying again" in output
    assert "this ROS has no diagnostic_msgs/msg/DiagnosticArray; the topic is left out" in output
    assert re.search(r"[1-9]\d+ messages on \d+ topics; 0 of the service not understood", output)
    topics = published(file)
    wanted = {"/imu/data", "/tf", "/tf_static", "/velocity", "/range", "/camera/image_raw/compressed", "/camera/camera_info"}
    assert wanted | {"/detection/pad_pose", "/dead_reckoning/pad_pose", "/cmd_vel", "/phase"} <= set(topics)
    assert {t.child_frame_id for t in topics["/tf_static"][0].transforms} == {"camera_optical_frame", "range_down"}
    gravity = topics["/imu/data_raw"][0].linear_acceleration
    assert gravity.z == pytest.approx(9.81, abs=1.5)
    pose = topics["/dead_reckoning/pad_pose"][-1]
    assert pose.header.frame_id == "base_stabilized"
    assert pose.pose.pose.position.z < -0.5, "the pad is below, and z is up"
    assert np.isfinite(pose.pose.covariance).all()


async def test_a_wrong_token_ends_it_and_nobody_there_is_waited_for(tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    async with serve_live(token_file=str(token)) as service:
        address = service.address
        with started(address, tmp_path / "published") as bridge:
            _, output = await asyncio.to_thread(bridge.communicate, timeout=60)
        assert (bridge.returncode, "the token is missing or wrong (--token-file)" in output) == (2, True)
    with started(address, tmp_path / "published", "--seconds", "2.5") as bridge:
        _, output = await asyncio.to_thread(bridge.communicate, timeout=60)
    assert bridge.returncode == 1
    assert output.count("trying again") == 1, "said once"
