"""Collect views from images, from a video, or from a live camera while a person moves the board."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path

import av
import numpy as np

from companion.tools.calibrate.guide import Guide, GuideState
from companion.tools.calibrate.views import Collection
from drivers.camera import images
from drivers.camera.options import CameraOptions, Size
from drivers.camera.video_source import open_camera
from drivers.camera.videos import open_video
from drivers.clock import SystemClock
from estimator.contracts.errors import BadInput, Recoverable

PICTURES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm"}

Report = Callable[[Collection], None]


def image_files(paths: Sequence[Path]) -> list[Path]:
    """Return the images and videos that the paths name; a folder gives all images in it.

    Raises:
        BadInput: a path does not exist, or a folder holds no images.
    """
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in PICTURES)
            if not inside:
                raise BadInput(f"{path}: no image in this folder")
            files += inside
        elif path.is_file():
            files.append(path)
        else:
            raise BadInput(f"{path}: no such file or folder")
    return files


def add_file(file: Path, collection: Collection, tell: Report) -> None:
    """Add an image, or every frame of a video.

    Raises:
        BadInput: the file is neither, or its size differs from those before it.
    """
    if file.suffix.lower() in PICTURES:
        try:
            px = images.decode(images.load(file), turned=True)
        except OSError as why:
            raise BadInput(f"{file}: {why.strerror or why}") from why
        except images.ImageRefused as why:
            raise BadInput(f"{file}: not an image that can be read ({why})") from why
        collection.add(file.name, px)
        tell(collection)
        return
    try:
        with open_video(str(file), collection.size) as container:
            for i, frame in enumerate(container.decode(video=0)):
                collection.add(f"{file.name}#{i}", np.asarray(frame.to_ndarray(format="bgr24"), np.uint8))
                tell(collection)
    except images.ImageRefused as why:
        raise BadInput(f"{file}: {why}") from why
    except (av.FFmpegError, OSError, IndexError) as why:
        raise BadInput(f"{file}: neither an image nor a video that can be read") from why


async def watch(
    options: CameraOptions,
    size: Size | None,
    guide: Guide,
    tell: Callable[[GuideState], None],
    timeout_s: float,
    first_s: float = 10.0,
) -> None:
    """Add frames of a live camera until nothing is missing, or until `timeout_s`.

    Args:
        size: the width and height of the camera's frames, px; None where a stream decides.

    Raises:
        Recoverable: no image came within `first_s`; the text says why.
        BadInput, SetupImpossible: `open_camera` raised it.
    """
    loop = asyncio.get_running_loop()
    async with open_camera(options, size, SystemClock()) as camera:
        try:
            async with asyncio.timeout(first_s):
                frame = await camera.frames.get()
        except TimeoutError as why:
            raise Recoverable(camera.down or f"no image within {first_s:g} s") from why
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    state = await loop.run_in_executor(None, guide.add, f"frame {frame.seq}", frame.px)
                    tell(state)
                    if state.complete:
                        return
                    frame = await camera.frames.get()
        except TimeoutError:
            return
