"""A camera beside the vehicle: settings to options, and one link of vehicle and camera."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import av
import numpy as np
import pytest

from companion.service.vehicle_parts import with_camera
from companion.settings.load import from_mapping, load
from drivers.camera.options import CameraOptions
from drivers.clock import SystemClock
from drivers.mailbox import Latest, Line
from estimator.contracts.commands import Command, Hover
from estimator.contracts.errors import BadInput
from estimator.contracts.samples import Frame, Range, Sample
from estimator.contracts.time import MonoNs, Stamp

RIG = {"vehicle": {"kind": "ardrone"}, "camera": {"file": "sim"}, "pad": {"file": "thesis"}}


def with_keys(**keys: object) -> dict[str, object]:
    return RIG | {"camera": {"file": "sim"} | keys}


def test_the_table_is_what_the_driver_takes() -> None:
    camera = from_mapping(with_keys(source="v4l2", device="usb-Cam", controls="gain=3, auto_exposure=Manual Mode"), "x").camera
    assert isinstance(camera, CameraOptions)
    assert camera.control_values() == {"gain": 3, "auto_exposure": "Manual Mode"}
    assert not camera.is_live
    assert from_mapping(with_keys(source="stream", device="rtsp://cam/1"), "x").camera.is_live


def test_controls_are_numbers_truth_values_or_labels() -> None:
    text = " a=1 , b = true,c=false, d=-5, e=60 Hz "
    assert CameraOptions(controls=text).control_values() == {"a": 1, "b": True, "c": False, "d": -5, "e": "60 Hz"}
    assert CameraOptions().control_values() == {}
    for wrong in ("gain", "gain=", "=3", "gain=1,gain=2", "a=1,,b=2"):
        with pytest.raises(BadInput, match=r"x: camera: controls: '.*' is not name=value"):
            from_mapping(with_keys(controls=wrong), "x")


def test_keys_that_do_not_go_together_are_refused_when_the_file_is_read(tmp_path: Path) -> None:
    for keys, words in (('source = "v4l2"', "device must be given"), ('device = "usb"', "source must be")):
        file = tmp_path / "rig.toml"
        file.write_text(f'[vehicle]\nkind = "ardrone"\n[camera]\nfile = "sim"\n{keys}\n[pad]\nfile = "thesis"\n')
        with pytest.raises(BadInput, match=words):
            load(file)


class Vehicle:
    def __init__(self) -> None:
        self.frames: Latest[Frame] = Latest()
        self.samples: Line[Sample] = Line(8)
        self.commands: list[Command] = []
        self.released = False

    def command(self, command: Command) -> None:
        self.commands.append(command)

    def release(self) -> None:
        self.released = True


async def test_frames_are_the_cameras_and_the_rest_is_the_vehicles(tmp_path: Path) -> None:
    path = tmp_path / "deck.mp4"
    with av.open(str(path), "w") as out:
        stream = out.add_stream("libx264", rate=50)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(10):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(np.full((48, 64, 3), 90, np.uint8), format="bgr24")))
        out.mux(stream.encode(None))
    vehicle, closed = Vehicle(), []

    @asynccontextmanager
    async def open_vehicle() -> AsyncIterator[Vehicle]:
        try:
            yield vehicle
        finally:
            closed.append(True)

    film = CameraOptions(source="stream", device=str(path))
    async with asyncio.timeout(60), with_camera(open_vehicle, film, (64, 48), SystemClock())() as link:
        frame = await link.frames.get()
        assert frame.px.shape == (48, 64, 3)
        vehicle.samples.offer(Range(Stamp(MonoNs(1), MonoNs(1), 0.0, "sim"), 2.0, 0.1))
        sample = await link.samples.get()
        assert isinstance(sample, Range)
        link.command(Hover())
    assert vehicle.commands == [Hover()]
    assert closed == [True]
