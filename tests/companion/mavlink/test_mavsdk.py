"""A stranger at the other end: MAVSDK discovers the component, receives its targets, commands it and sets its parameters."""

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from companion.parts.mavlink.camera_component import CameraComponent, Send, showing
from companion.parts.mavlink.commands import LandingProgress
from companion.parts.mavlink.metadata import metadata_files
from companion.parts.mavlink.parameters import NAMES
from companion.settings.links import VideoStreamOptions
from companion.settings.load import camera_model, load
from drivers.clock import SystemClock
from sitl.emulators.autopilots.stand_in.base import MiniatureAutopilot
from tests.companion.mavlink.stage import HOST, PAD_NED, Stage, fetched_metadata, staged
from tests.support.waiting import free_port

mavsdk = pytest.importorskip("mavsdk.asyncio", reason="MAVSDK is not installed")


@asynccontextmanager
async def met() -> AsyncIterator[tuple[Stage, Any]]:
    """Yield a stage, and MAVSDK's view of its system."""
    from mavsdk import ComponentType, Configuration

    port = free_port()
    async with (
        staged(MiniatureAutopilot(parameters={"PLND_LAG": 0.02}), f"udpout://{HOST}:{port}", operators="245") as stage,
        mavsdk.Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as station,
    ):
        await station.add_any_connection(f"udpin://{HOST}:{port}")
        async with asyncio.timeout(60):
            while not (systems := await station.get_systems()):  # noqa: ASYNC110 - the other side has its own threads
                await asyncio.sleep(0.05)
            while 191 not in await systems[0].component_ids():  # noqa: ASYNC110
                await asyncio.sleep(0.05)
            while not await systems[0].is_connected():  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        yield stage, systems[0]


async def command(direct: Any, number: int, **params: float) -> dict[str, Any]:
    from mavsdk.plugins.mavlink_direct import MavlinkMessage

    fields = {"target_system": 7, "target_component": 191, "command": number, "confirmation": 0}
    fields |= {f"param{n}": params.get(f"param{n}", 0) for n in range(1, 8)}
    message = MavlinkMessage("COMMAND_LONG", 245, 190, 7, 191, json.dumps(fields))
    return dict(json.loads((await direct.send_command(message)).fields_json))


async def test_mavsdk_discovers_receives_and_commands_us() -> None:
    from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync

    async with met() as (stage, system):
        assert await system.get_system_id() == 7
        direct = MavlinkDirectAsync(system)
        targets = []
        async with asyncio.timeout(60):
            async for message in direct.subscribe_message("LANDING_TARGET"):
                targets.append((message.system_id, message.component_id, json.loads(message.fields_json)))
                if len(targets) == 10:
                    break
        system_id, component_id, fields = targets[-1]
        assert (system_id, component_id) == (7, 191)
        assert (fields["frame"], fields["position_valid"], fields["type"]) == (12, 1, 3)
        expected = PAD_NED - stage.fake.p_ned
        assert (fields["x"], fields["y"], fields["z"]) == pytest.approx(tuple(expected), abs=0.01)

        assert (await command(direct, 193, param1=0))["result"] == 0
        assert (await command(direct, 400, param1=1))["result"] == 3
        assert stage.tower.done == ["hold"]


async def test_a_landing_commanded_by_mavsdk_is_answered_when_it_is_over() -> None:
    from mavsdk.asyncio.plugins.mavlink_direct import MavlinkDirectAsync

    async with met() as (stage, system):
        stage.tower.state = LandingProgress(10)
        landing = asyncio.ensure_future(command(MavlinkDirectAsync(system), 21))
        try:
            await asyncio.sleep(1.5)
            assert not landing.done()
            assert stage.tower.done == ["begin"]
            stage.tower.state = LandingProgress(100, landed=True)
            async with asyncio.timeout(60):
                assert (await landing)["result"] == 0
        finally:
            landing.cancel()


async def test_mavsdk_reads_and_sets_our_parameters() -> None:
    from mavsdk.asyncio.plugins.param import ParamAsync
    from mavsdk.plugins.param import ParamError, ProtocolVersion

    async with met() as (stage, system):
        param = ParamAsync(system)
        with suppress(ParamError):  # its C binding answers "unknown" and selects the component all the same
            await param.select_component(191, ProtocolVersion.V1)
        before = await param.get_param_float("PID_H_KP")
        await param.set_param_float("PID_H_KP", before + 0.25)
        assert await param.get_param_float("PID_H_KP") == pytest.approx(before + 0.25)
        assert stage.applied[-1].guidance.pid.horizontal.kp == pytest.approx(before + 0.25)
        everything = await param.get_all_params()
        assert {p.name for p in everything.float_params} == set(NAMES)


@pytest.fixture
def no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let MAVSDK fetch metadata that it had before: it keeps them by their checksum."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))


async def test_mavsdk_fetches_what_our_parameters_mean(no_cache) -> None:
    async with met() as (stage, system):
        assert (await fetched_metadata(system, 191)).encode() == metadata_files(191)["parameters.json"]
        assert not stage.component.files.refused.keys() - {"EOF"}


async def test_mavsdk_finds_the_camera_and_where_its_stream_goes() -> None:
    from mavsdk.asyncio.plugins.camera import CameraAsync

    options = VideoStreamOptions(to=f"{HOST}:5600", rate_hz=15.0)

    def show(send: Send) -> CameraComponent:
        return CameraComponent(send, camera_model(load("sim")), options, (640, 418), lambda: True)

    async with met() as (stage, system), showing(show, stage.autopilot, SystemClock()):
        camera = CameraAsync(system)
        async with asyncio.timeout(60):
            while not (found := (await camera.camera_list()).cameras):  # noqa: ASYNC110
                await asyncio.sleep(0.05)
            while not (stream := (await camera.get_video_stream_info(100)).settings).uri:  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        assert [(c.component_id, c.vendor_name, c.horizontal_resolution_px) for c in found] == [(100, "Decklander", 640)]
        assert (stream.uri, stream.frame_rate_hz, stream.vertical_resolution_pix) == ("5600", 15.0, 418)
