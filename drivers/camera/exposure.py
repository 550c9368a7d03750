"""The exposure of an open camera, and the law that drives it: from the metered light to exposure time and gain.

The light of a picture is proportional to exposure time times gain, so the law works in stops (doublings) of that product. It is
given as a time as far as the limits on time allow, because light costs less noise than gain does, and as gain beyond that.

A camera shows a change only some frames later. Whoever calls the law waits for that many before it gives it a picture again. It
then cannot swing, though neither the camera's tone curve nor its gain is known: both make the measured error wrong by a factor,
and a step is `_DAMPING` of it.

`ExposureDrive` holds the requested setting of a camera, its present one, and the first frame that shows it.
"""

import math

from msgspec import Struct

TARGET = 0.55
"""Light of the bright paint at which the law aims, full scale is 1: a grey value of 194 by the sRGB curve, over half a stop below
clipping."""
_DAMPING = 0.6
"""Part of the measured error that one step corrects."""
_ENTER_EV, _LEAVE_EV = 0.4, 0.15
"""Errors, stops, from which the law corrects, and below which it rests again."""
_CUT_EV = 1.5
"""Error, stops, from which the law corrects while the frame's edge cuts the pad.

The visible part changes with every frame, and each change of the exposure would cost frames in the very last part.
"""
_STEP_EV = 3.0
"""Largest step, stops."""
_DARKEST = 2.0**-13
"""Light below which eight bits carry no information."""
_LENGTHEN = 1.9
"""The time is made longer at the gain's cost only where the limit has grown by this factor: each change costs pictures."""
_RUNGS = 2.0
"""Limits on the time in an octave: a limit that follows each sway would change the exposure with every picture."""


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


class Metered(Struct, frozen=True):
    """The light in a part of a picture."""

    level: float
    """Light by the sRGB curve, full scale is 1."""
    saturated: float = 0.0
    """Share of its pixels with a clipped channel."""
    clipped: bool = False
    """True if the level itself is clipped: it is only known to be too bright."""
    target: float = TARGET
    """The level at which that part is rightly exposed."""
    cut: bool = False
    """True if the frame shows only a smaller part of what is metered."""

    @property
    def error_ev(self) -> float:
        """Stops by which the picture is too dark; negative where it is too bright."""
        if self.clipped:
            return -1.0 - 2.0 * self.saturated
        return math.log2(self.target / max(self.level, _DARKEST))


class LawMemory(Struct, frozen=True):
    """Memory of the exposure law from frame to frame."""

    correcting: bool = False
    short_of_ev: float = 0.0
    """Stops that are missing (or too many, below 0) where the limits do not allow more; 0 where they do."""


def limit_of(blur_px: float, speed_px_s: float, longest_s: float) -> float:
    """Return the longest exposure, s, during which a picture that moves at this speed is smeared by no more than `blur_px`.

    It is `longest_s` or one of a few times below, half an octave apart.
    """
    octaves = math.log2(max(1.0, speed_px_s * longest_s / blur_px))
    return longest_s * math.exp2(-math.ceil(_RUNGS * octaves) / _RUNGS)


def step(
    memory: LawMemory, held: ExposureSetting, can: ExposureRange, limit_s: float, metered: Metered | None
) -> tuple[LawMemory, ExposureSetting | None]:
    """Return the exposure that the camera is to take; None to leave it.

    Args:
        held: what the camera holds.
        limit_s: longest exposure time that the motion and the frame rate allow.
        metered: the light of a picture that was taken with `held`; None while none was.
    """
    product_s = held.product_s
    if metered is not None:
        memory, product_s = _corrected(memory, held, can, limit_s, metered)
    wanted = can.split(product_s, limit_s)
    changed = abs(math.log2(wanted.product_s / held.product_s)) > 0.02 or wanted.exposure_s < 0.999 * held.exposure_s
    # The way back to a longer time waits until it is worth a change, except where the light changes anyway.
    if changed or wanted.exposure_s > _LENGTHEN * held.exposure_s:
        return memory, wanted
    return memory, None


def _corrected(
    memory: LawMemory, held: ExposureSetting, can: ExposureRange, limit_s: float, metered: Metered
) -> tuple[LawMemory, float]:
    error_ev = metered.error_ev
    enter_ev = _CUT_EV if metered.cut else _ENTER_EV
    correcting = abs(error_ev) > (_LEAVE_EV if memory.correcting and not metered.cut else enter_ev)
    if not correcting:
        return LawMemory(), held.product_s
    damping = 1.0 if metered.clipped else _DAMPING
    by_ev = min(max(damping * error_ev, -_STEP_EV), _STEP_EV)
    product_s = held.product_s * 2.0**by_ev
    given_s = can.split(product_s, limit_s).product_s
    # A correction that the limits cut short is what the camera cannot give.
    short_ev = math.log2(product_s / given_s)
    return LawMemory(True, error_ev if abs(short_ev) > 0.02 else 0.0), given_s


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
        """Return whether the frame of this number shows the camera's setting, and no other is requested."""
        return self._wanted is None and not self._busy and number >= self._new_from

    def of(self, number: int) -> tuple[ExposureSetting, float] | None:
        """Return the setting with which a frame was taken, and the largest error of its exposure time, s; None if not known."""
        if self.held is None or self._before is None or number >= self._new_from:
            return None if self.held is None else (self.held, 0.0)
        if number <= self._old_until:
            return self._before, 0.0
        middle_s = 0.5 * (self._before.exposure_s + self.held.exposure_s)
        return ExposureSetting(middle_s, self.held.gain), abs(self.held.exposure_s - middle_s)
