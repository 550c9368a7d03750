"""The exposure of an open camera: what is asked of it, what it holds, and from which frame on it shows that."""

from __future__ import annotations

from drivers.camera.exposure_law import ExposureRange, ExposureSetting


class ExposureDrive:
    """Connects who decides on the exposure with the driver, which sets it beside the frames.

    Args:
        settle_frames: frames after a change that may still show the exposure before it.
    """

    def __init__(self, settle_frames: int) -> None:
        self._settle = settle_frames
        self.can: ExposureRange | None = None
        """What the camera can hold; None while it is not open."""
        self.held: ExposureSetting | None = None
        """What it holds; None while it is not open."""
        self.changes = self.refused = 0
        """Numbers of changes, and of settings that the camera refused, since the start."""
        self.why_refused: str | None = None
        """Why it refused the newest setting; None where it took it."""
        self._before: ExposureSetting | None = None
        self._wanted: ExposureSetting | None = None
        self._busy = False
        self._old_until = self._new_from = 0

    def opened(self, can: ExposureRange, held: ExposureSetting) -> None:
        """Note that the camera is open, and counts its frames from 0 on."""
        self.can, self.held, self._before, self._wanted = can, held, None, None
        self._old_until, self._new_from, self._busy = -1, 0, False

    def closed(self) -> None:
        """Note that the camera is gone."""
        self.can = self.held = self._wanted = None

    def ask(self, wanted: ExposureSetting) -> None:
        """Ask for a setting; it replaces one that was not set yet."""
        self._wanted = wanted

    def take(self) -> ExposureSetting | None:
        """Return the setting that is to be set now; `changed` or `refuse` follows."""
        wanted, self._wanted = self._wanted, None
        self._busy = wanted is not None
        return wanted

    def changed(self, held: ExposureSetting, asked_at: int, done_at: int) -> None:
        """Note what the camera holds after a setting.

        Args:
            asked_at: number of the newest frame before the setting.
            done_at: number of the newest frame after it.
        """
        self.why_refused, self._busy = None, False
        if held == self.held:
            return
        self.changes += 1
        self._before, self.held = self.held, held
        self._old_until, self._new_from = asked_at, done_at + self._settle + 1

    def refuse(self, why: str) -> None:
        """Note that the camera refused a setting."""
        self.refused += 1
        self.why_refused, self._busy = why, False

    def settled(self, number: int) -> bool:
        """Return whether the frame of this number shows what the camera holds, and nothing else is asked."""
        return self._wanted is None and not self._busy and number >= self._new_from

    def of(self, number: int) -> tuple[ExposureSetting, float] | None:
        """Return the setting with which a frame was taken, and the largest error of its exposure time, s; None if not known."""
        if self.held is None or self._before is None or number >= self._new_from:
            return None if self.held is None else (self.held, 0.0)
        if number <= self._old_until:
            return self._before, 0.0
        middle_s = 0.5 * (self._before.exposure_s + self.held.exposure_s)
        return ExposureSetting(middle_s, self.held.gain), abs(self.held.exposure_s - middle_s)
