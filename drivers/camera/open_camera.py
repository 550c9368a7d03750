"""Open a camera that is not part of the vehicle: of V4L2, libcamera, GStreamer or ROS 2, a network camera or a video file.

options = CameraOptions(source="v4l2", device="/dev/v4l/by-id/usb-...")
async with open_camera(options, (640, 480), clock) as camera:
    async for frame in camera.frames: ...
"""

from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from drivers.camera.exposure import ExposureDrive
from drivers.camera.options import CameraOptions, Lens, Size
from drivers.camera.source import CameraLost, VideoSource
from drivers.pyav import require_pyav
from drivers.reconnect import BackOff, reconnect, running_beside
from estimator.contracts.errors import Recoverable, in_words
from estimator.contracts.tables import imported
from estimator.contracts.time import Clock

_CHANNELS = {"stream": "drivers.camera.video_source:StreamChannel", "v4l2": "drivers.camera.v4l2:V4l2Channel"}
"""Readers of a source's frames, each loaded where it is used."""
_PROCESS = "drivers.camera.camera_process:ProcessChannel"
"""The reader of any other source, from a process that opens it; it takes the lens, too."""


@asynccontextmanager
async def open_camera(options: CameraOptions, size: Size | None, clock: Clock, lens: Lens = None) -> AsyncIterator[VideoSource]:
    """Open the camera and keep it open; it does not wait for the first frame.

    A camera that is unplugged, silent or absent is opened again with back-off, and counted; the reader of `frames` just waits.
    The `async with` block raises the errors that another attempt cannot fix.

    Args:
        size: the width and height of the camera's frames, px. A device needs it; frames of a stream that have more than four
            times as many pixels are not decoded, and with None any size is taken.
        lens: of the camera file; a topic whose camera_info has another one is refused.

    Raises:
        ValueError: the frames are the vehicle's, or the size of a device's frames is missing or out of range.
        BadInput: the device cannot do what the options request (size, format, control).
        SetupImpossible: permission is missing, or the device is not a camera.
    """
    # Each frame of libcamera says with which exposure it was taken: nothing has to settle.
    settle_frames = 0 if options.source == "libcamera" else options.exposure.settle_frames
    camera = VideoSource(ExposureDrive(settle_frames) if options.exposure.driven else None)
    if options.source == "vehicle":
        raise ValueError("the frames of this camera come with the vehicle")
    if options.source == "stream":
        require_pyav('camera.source = "stream"')
    elif size is None:
        raise ValueError("a device needs the size of its frames")
    channel = imported(_CHANNELS.get(options.source, _PROCESS))
    lens_of = () if options.source in _CHANNELS else (lens,)
    body: Callable[[], Awaitable[None]] = channel(options, size, clock, camera, *lens_of).run
    name, longest_s = options.device or options.source, options.reconnect_most_s
    back_off = BackOff(options.reconnect_first_s, longest_s, healthy_after_s=longest_s)

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
