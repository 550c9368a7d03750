"""Open a camera that is not part of the vehicle: a V4L2 device, a network camera or a video file.

async with open_camera(V4l2Options("/dev/v4l/by-id/usb-...", 640, 480), clock) as camera:
    async for frame in camera.frames: ...
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from drivers.beside import running_beside
from drivers.camera.source import CameraLost, VideoSource
from drivers.camera.video_source_options import CameraOptions, V4l2Options
from drivers.reconnect import BackOff, reconnect
from estimator.contracts.errors import Recoverable, in_words
from estimator.contracts.ports import Clock


@asynccontextmanager
async def open_camera(options: CameraOptions, clock: Clock) -> AsyncIterator[VideoSource]:
    """Open the camera and keep it open; it does not wait for the first frame.

    A camera that is unplugged, silent or absent is opened again with back-off, and counted; the reader of `frames` just waits.
    The `async with` block raises the errors that another attempt cannot fix.

    Raises:
        BadInput: the device cannot do what the options ask (size, format, control).
        SetupImpossible: permission is missing, or the device is not a camera.
    """
    camera = VideoSource()
    # Each kind loads its own library (linuxpy, PyAV) only when it is used.
    if isinstance(options, V4l2Options):
        from drivers.camera.v4l2 import V4l2Channel

        body = V4l2Channel(options, clock, camera).run
    else:
        from drivers.camera.video_source_stream import StreamChannel

        body = StreamChannel(options, clock, camera).run
    name = options.device if isinstance(options, V4l2Options) else options.source
    timeouts = options.timeouts
    back_off = BackOff(timeouts.first_s, timeouts.most_s, healthy_after_s=timeouts.most_s)

    async def attempt() -> None:
        try:
            await body()
            raise CameraLost("ended", f"{name} ended by itself")
        except CameraLost as why:
            if why.reason != "ended":
                raise
            camera.down = in_words(why)
            camera.frames.fail(why)

    def on_failure(why: BaseException) -> None:
        camera.down = in_words(why)
        camera.counters.restarts[_reason(why)] += 1

    try:
        async with running_beside([("camera", reconnect(f"camera {name}", attempt, back_off, clock, on_failure))]):
            try:
                yield camera
            finally:
                camera.frames.fail(Recoverable("the camera is closed"))
    except BaseExceptionGroup as errors:
        if len(errors.exceptions) == 1:
            raise errors.exceptions[0] from None
        raise


def _reason(why: BaseException) -> str:
    while isinstance(why, BaseExceptionGroup):
        why = why.exceptions[0]
    return why.reason if isinstance(why, CameraLost) else "failed"
