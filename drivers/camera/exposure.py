"""Hold the exposure of an open camera: its limits, its setting, and the first frame that shows a change."""

from msgspec import Struct

FRAME_PART = 0.8
"""Largest part of a frame's time that is exposed: read-out takes the rest, and a longer time would slow the camera down."""


class ExposureSetting(Struct, frozen=True):
    """Exposure values of a camera, present or wanted."""

    exposure_s: float
    gain: float
    """Amplification, 1 is the least."""

    @property
    def product_s(self) -> float:
        """Exposure time that would give the same light without gain, s."""
        return self.exposure_s * self.gain


class ExposureRange(Struct, frozen=True):
    """Exposure limits of a camera."""

    shortest_s: float
    longest_s: float
    gain_most: float = 1.0

    def split(self, product_s: float, limit_s: float) -> ExposureSetting:
        """Return the setting for a product of time and gain; the time is at most `limit_s` where the camera can be that short."""
        longest_s = max(min(self.longest_s, limit_s), self.shortest_s)
        exposure_s = min(max(product_s, self.shortest_s), longest_s)
        return ExposureSetting(exposure_s, min(max(product_s / exposure_s, 1.0), self.gain_most))


class ExposureDrive:
    """Connects who decides on the exposure with the driver, which sets it beside the frames.

    Args:
        settle_frames: frames after a change that may still show the exposure before it.
    """

    def __init__(self, settle_frames: int) -> None:
        self._settle = settle_frames
        self.can: ExposureRange | None = None
        """Limits of the camera; None while it is not open."""
        self.held: ExposureSetting | None = None
        """Present setting of the camera; None while it is not open."""
        self.changes = self.refused = 0
        """Numbers of changes, and of settings that the camera refused, since the start."""
        self.why_refused: str | None = None
        """Reason for which it refused the newest setting; None if it took it."""
        self._before: ExposureSetting | None = None
        self._wanted: ExposureSetting | None = None
        self._under_way: ExposureSetting | None = None
        self._old_until = self._new_from = 0

    def opened(self, can: ExposureRange, held: ExposureSetting) -> None:
        """Note that the camera is open, and counts its frames from 0 on."""
        self.can, self.held, self._before, self._wanted = can, held, None, None
        self._old_until, self._new_from, self._under_way = -1, 0, None

    def closed(self) -> None:
        """Note that the camera is gone."""
        self.can = self.held = self._wanted = None

    def ask(self, wanted: ExposureSetting) -> None:
        """Ask for a setting; it replaces one that was not set yet."""
        self._wanted = wanted

    def take(self) -> ExposureSetting | None:
        """Return the setting that is to be set now; `changed` or `refuse` follows."""
        self._under_way, self._wanted = self._wanted, None
        return self._under_way

    def changed(self, held: ExposureSetting, asked_at: int, done_at: int) -> None:
        """Note what the camera holds after a setting.

        Args:
            asked_at: number of the newest frame before the setting.
            done_at: number of the newest frame after it.
        """
        self.why_refused, self._under_way = None, None
        if held == self.held:
            return
        self.changes += 1
        self._before, self.held = self.held, held
        self._old_until, self._new_from = asked_at, done_at + self._settle + 1

    def refuse(self, why: str) -> None:
        """Note that the camera refused a setting."""
        self.refused += 1
        self.why_refused, self._under_way = why, None

    @property
    def due(self) -> ExposureSetting | None:
        """The setting that the camera will hold once what is requested is set; None while it is not open."""
        return self._wanted or self._under_way or self.held

    def settled(self, number: int) -> bool:
        """Return whether the frame of this number shows the camera's setting, and no other is requested."""
        return self._wanted is None and self._under_way is None and number >= self._new_from

    def of(self, number: int) -> tuple[ExposureSetting, float] | None:
        """Return the setting with which a frame was taken, and the largest error of its exposure time, s; None if not known."""
        if self.held is None or self._before is None or number >= self._new_from:
            return None if self.held is None else (self.held, 0.0)
        if number <= self._old_until:
            return self._before, 0.0
        middle_s = 0.5 * (self._before.exposure_s + self.held.exposure_s)
        return ExposureSetting(middle_s, self.held.gain), abs(self.held.exposure_s - middle_s)
