"""A camera of its own, beside the vehicle: V4L2 device, network camera or video file behind one door.

async with open_camera(V4l2Options("/dev/v4l/by-id/usb-...", 640, 480), clock) as camera:
    async for frame in camera.frames: ...
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from drivers.camera.video_source_options import CameraCounters, CameraOptions, SourceTimeouts, V4l2Options
from drivers.mailbox import Latest
from estimator.contracts.errors import Recoverable
from estimator.contracts.ports import Clock
from estimator.contracts.samples import Frame
from estimator.contracts.time import seconds_between

_log = logging.getLogger(__name__)


class CameraLost(Recoverable):
    """The camera went away or fell silent; `reason` is one word for counting.

    Raised by a camera's `run`; `ended` with a file that is over, which is not opened again.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class VideoSource:
    """An open camera. It may be away at the moment: see `down`."""

    def __init__(self) -> None:
        self.frames: Latest[Frame] = Latest()
        """Newest only. A video file that is over ends it with `CameraLost`."""
        self.counters = CameraCounters()
        self.down: str | None = "not yet opened"
        """Why no frames come; None while they do."""


@asynccontextmanager
async def open_camera(options: CameraOptions, clock: Clock) -> AsyncIterator[VideoSource]:
    """Open the camera and keep it open; it does not wait for the first frame.

    A camera that is unplugged, silent or not there yet is tried again with growing rests and counted; the reader of `frames`
    just waits. What trying again cannot cure comes out of the `async with` block.

    Raises:
        BadInput: the device cannot do what the options ask (size, format, control).
        SetupImpossible: no permission, or not a camera.
    """
    camera = VideoSource()
    if isinstance(options, V4l2Options):
        from drivers.camera.v4l2 import V4l2Channel

        body = V4l2Channel(options, clock, camera).run
    else:
        from drivers.camera.video_source_stream import StreamChannel

        body = StreamChannel(options, clock, camera).run
    failed: Exception | None = None
    name = options.device if isinstance(options, V4l2Options) else options.source
    try:
        async with asyncio.TaskGroup() as group:
            task = group.create_task(_reconnect(name, body, camera, clock, options.timeouts), name="camera")
            try:
                yield camera
            except Exception as why:  # the caller's own error must not come out wrapped in a group
                failed = why
            finally:
                camera.frames.fail(Recoverable("the camera is closed"))
                task.cancel()
    except BaseExceptionGroup as errors:
        if len(errors.exceptions) == 1:
            raise errors.exceptions[0] from None
        raise
    if failed is not None:
        raise failed


async def _reconnect(
    name: str, body: Callable[[], Awaitable[None]], camera: VideoSource, clock: Clock, timeouts: SourceTimeouts
) -> None:
    wait_s = timeouts.first_s
    said: str | None = None
    while True:
        began = clock.now()
        try:
            await body()
            why: Exception = CameraLost("ended", f"{name} ended by itself")
        except (Recoverable, OSError) as failed:
            why = failed
        reason = why.reason if isinstance(why, CameraLost) else "failed"
        camera.down = str(why) or type(why).__name__
        if reason == "ended":
            camera.frames.fail(why)
            return
        camera.counters.restarts[reason] += 1
        if seconds_between(began, clock.now()) > timeouts.most_s:
            wait_s, said = timeouts.first_s, None
        # An absent camera is tried for hours: once is enough.
        _log.log(logging.DEBUG if said == camera.down else logging.WARNING, "camera %s; again in %.1f s", camera.down, wait_s)
        said = camera.down
        await clock.sleep(wait_s)
        wait_s = min(2.0 * wait_s, timeouts.most_s)
