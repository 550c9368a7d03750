"""Set a device's exposure on a thread of its own, so that a slow bus never holds up frames."""

from __future__ import annotations

import asyncio
import logging
from concurrent.futures import ThreadPoolExecutor

from drivers.camera.exposure_drive import ExposureDrive
from drivers.camera.exposure_law import ExposureSetting
from drivers.camera.v4l2_device import Device

log = logging.getLogger(__name__)


class ExposureSetter:
    """Sets what is asked of `drive`, one setting at a time, from the device's opening to its closing.

    Args:
        drive: None for a camera that is not driven.
    """

    def __init__(self, device: Device, drive: ExposureDrive | None) -> None:
        self._driven, self._drive = device.driven, drive
        self._setting: asyncio.Future[ExposureSetting] | None = None
        self._asked_at = 0
        self._pool: ThreadPoolExecutor | None = None
        if self._driven is not None and drive is not None:
            self._pool = ThreadPoolExecutor(1, "v4l2-exposure")
            drive.opened(self._driven.can, self._driven.held)

    def tend(self, newest: int) -> None:
        """Take the result of a setting, and begin the next one; call it with each frame's number."""
        if self._driven is None or self._drive is None or self._pool is None:
            return
        if self._setting is not None:
            if not self._setting.done():
                return
            done, self._setting = self._setting, None
            if (why := done.exception()) is None:
                self._drive.changed(done.result(), self._asked_at, newest)
            elif isinstance(why, OSError):
                if self._drive.why_refused is None:
                    log.warning("the camera refuses an exposure: %s", why.strerror or why)
                self._drive.refuse(why.strerror or str(why))
            else:
                raise why
        wanted = self._drive.take()
        if wanted is not None:
            self._asked_at = newest
            self._setting = asyncio.get_running_loop().run_in_executor(self._pool, self._driven.set, wanted)

    def of(self, number: int) -> tuple[ExposureSetting, float] | None:
        """Return the setting with which a frame was taken, and the largest error of its exposure time, s; None if not driven."""
        return None if self._drive is None else self._drive.of(number)

    async def close(self) -> None:
        """Wait for a setting that is under way; the device may be closed then."""
        if self._setting is not None:
            await asyncio.gather(self._setting, return_exceptions=True)
            self._setting = None
        if self._pool is not None:
            self._pool.shutdown()
        if self._drive is not None:
            self._drive.closed()
