"""The exposure of an open camera, and the law that drives it: from the metered light to exposure time and gain.

The light of a picture is proportional to exposure time times gain, so the law works in stops (doublings) of that product. It is
given as a time as far as the limits on time allow, because light costs less noise than gain does, and as gain beyond that.

A camera shows a change only some frames later. Whoever calls the law waits for that many before it gives it a picture again. It
then cannot swing, though neither the camera's tone curve nor its gain is known: both make the measured error wrong by a factor,
and a step is `_DAMPING` of it.

While no pad is tracked nobody knows which part of the picture to meter, so two exposures take turns. The first keeps the
brightest parts of the picture from clipping, as a lit pad on a dark sea needs it. The second shows what is in its darkest
parts, as a pad in the shade beside the mirrored sun needs it; where the first shows that too, there is no second.

`ExposureDrive` holds the requested setting of a camera, its present one, and the first frame that shows it.
"""

import math
from functools import lru_cache

import cv2
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera.options import ExposureOptions
from estimator.contracts.samples import Frame

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
_NO_LIGHT = 2.0**-13
"""Light below which eight bits carry no information."""
_LENGTHEN = 1.9
"""The time is made longer at the gain's cost only where the limit has grown by this factor: each change costs pictures."""
_RUNGS = 2.0
"""Limits on the time in an octave: a limit that follows each sway would change the exposure with every picture."""
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
        return math.log2(self.target / max(self.level, _NO_LIGHT))


class LawMemory(Struct, frozen=True):
    """Memory of the exposure law from frame to frame."""

    correcting: bool = False
    short_of_ev: float = 0.0
    """Stops that are missing (or too many, below 0) where the limits do not allow more; 0 where they do."""


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


_PIXELS = 10_000
"""About how many pixels are looked at."""
_FEWEST = 30
"""An outline with fewer pixels is not used."""
_CLIPPED = 250
"""Grey value from which a channel counts as clipped."""
_BRIGHT = 0.97
"""Share of a pad's pixels that are no brighter than its level: every pad has more than 3 % of bright paint."""
_BRIGHTEST = 0.995
"""Share of a whole picture's pixels that are no brighter than its level: a pad in it may be small."""
_DARKEST, _SHADOWS = 0.02, 0.03
"""Share of a whole picture's pixels that are its darkest parts, and the light from which these show what is in them: a grey
value of 48. By day the sea is about as bright when white paint is rightly exposed."""
_CUT = 0.5
"""Share of the outline's area in the frame below which the pad is cut."""


def meter_whole(px: NDArray[np.uint8]) -> tuple[Metered, Metered]:
    """Return the light of a whole picture, (H, W, 3) BGR: of its brightest parts, and of its darkest."""
    h, w = px.shape[:2]
    every = max(1, round((h * w / _PIXELS) ** 0.5))
    pixels = px[::every, ::every].reshape(-1, 3)
    return _meter(pixels, _BRIGHTEST, TARGET), _meter(pixels, _DARKEST, _SHADOWS)


def meter_inside(px: NDArray[np.uint8], outline_px: NDArray[np.float64]) -> Metered | None:
    """Return the light of the bright paint inside an outline; None if it holds too few pixels.

    Args:
        px: (H, W, 3) BGR.
        outline_px: (N, 2) corners of a convex outline, which may lie outside the frame.
    """
    h, w = px.shape[:2]
    low = np.clip(np.floor(outline_px.min(axis=0)), 0, (w, h)).astype(int)
    high = np.clip(np.ceil(outline_px.max(axis=0)) + 1, 0, (w, h)).astype(int)
    (x0, y0), (x1, y1) = low.tolist(), high.tolist()
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    every = max(1, round(((x1 - x0) * (y1 - y0) / _PIXELS) ** 0.5))
    part = px[y0:y1:every, x0:x1:every]
    mask = np.zeros(part.shape[:2], np.uint8)
    inside = ((outline_px - (x0, y0)) / every).clip(-1e4, 1e4)
    cv2.fillConvexPoly(mask, np.round(inside).astype(np.int32), 1)
    chosen = part[mask.astype(bool)]
    if len(chosen) < _FEWEST:
        return None
    whole = cv2.contourArea(outline_px.astype(np.float32))
    return _meter(chosen, _BRIGHT, TARGET, cut=len(chosen) * every**2 < _CUT * whole)


def _meter(pixels: NDArray[np.uint8], share: float, target: float, *, cut: bool = False) -> Metered:
    # The brightest channel: once it is clipped the colour is wrong, whatever the sum of the three is.
    counts = np.bincount(pixels.max(axis=1), minlength=256)
    below = np.cumsum(counts) / len(pixels)
    code = int(np.searchsorted(below, share))
    saturated = float(counts[_CLIPPED:].sum() / len(pixels))
    return Metered(float(_linear()[code]), saturated, code >= _CLIPPED, target, cut)


@lru_cache(maxsize=1)
def _linear() -> NDArray[np.float64]:
    """Return the light of each grey value, (256,). Source: IEC 61966-2-1."""
    v = np.arange(256) / 255.0
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


_DWELL = 8
"""Pictures with one exposure before the other's turn: a quarter of a second at 30 Hz, enough for several looks of the search."""
_APART_EV = 1.0
"""Stops between the two from which they take turns."""
_FARTHEST_EV = 3.0


class BracketMemory(Struct, frozen=True):
    """Memory of the exposure search from frame to frame."""

    law: LawMemory = LawMemory()
    pictures: int = 0
    """Number of pictures with this exposure."""
    back_to_s: float | None = None
    """Product of time and gain of the first exposure while it is the second's turn, s."""


def search_step(
    memory: BracketMemory, held: ExposureSetting, can: ExposureRange, limit_s: float, brightest: Metered, darkest: Metered
) -> tuple[BracketMemory, ExposureSetting | None]:
    """Return the exposure that the camera is to take; None to leave it. The arguments are those of `step`."""
    pictures = memory.pictures + 1
    if memory.back_to_s is not None:
        if pictures < _DWELL:
            return BracketMemory(memory.law, pictures, memory.back_to_s), step(memory.law, held, can, limit_s, None)[1]
        return BracketMemory(), can.split(memory.back_to_s, limit_s)
    law, wanted = step(memory.law, held, can, limit_s, brightest)
    if wanted is not None or pictures < _DWELL:
        return BracketMemory(law, 0 if wanted is not None else pictures), wanted
    apart_ev = darkest.error_ev
    second = can.split(held.product_s * 2.0 ** min(apart_ev, _FARTHEST_EV), limit_s)
    if apart_ev < _APART_EV or second.product_s < 1.4 * held.product_s:
        return BracketMemory(law), None
    return BracketMemory(law, 0, held.product_s), second


class ExposureGovernor:
    """Drives one camera."""

    def __init__(self, options: ExposureOptions, drive: ExposureDrive) -> None:
        self._o, self._drive = options, drive
        self._law, self._search = LawMemory(), BracketMemory()

    @property
    def short_of_ev(self) -> float:
        """Stops that are missing on the pad where the limits do not allow more, below 0 that are too many; 0 where they do."""
        return self._law.short_of_ev

    def on_frame(self, frame: Frame, outline_px: NDArray[np.float64] | None, speed_px_s: float) -> None:
        """Take the next frame.

        Args:
            outline_px: (N, 2) convex outline of the pad, where it is tracked; None while it is looked for.
            speed_px_s: how fast the picture moves over the sensor.
        """
        can, held, due = self._drive.can, self._drive.held, self._drive.due
        if can is None or held is None or due is None:
            return
        # The longest exposure during which a picture that moves at this speed is smeared by no more than `blur_px`. It is
        # `longest_s` or one of a few times below, half an octave apart.
        octaves = math.log2(max(1.0, speed_px_s * self._o.longest_s / self._o.blur_px))
        limit_s = self._o.longest_s * math.exp2(-math.ceil(_RUNGS * octaves) / _RUNGS)
        if not self._drive.settled(frame.seq):
            if due.exposure_s > limit_s and due.exposure_s > can.shortest_s:
                self._drive.ask(can.split(due.product_s, limit_s))
            return
        metered = None if outline_px is None else meter_inside(frame.px, outline_px)
        if outline_px is None:
            self._law = LawMemory()
            self._search, wanted = search_step(self._search, held, can, limit_s, *meter_whole(frame.px))
        else:
            self._search = BracketMemory()
            self._law, wanted = step(self._law, held, can, limit_s, metered)
        if wanted is not None and wanted != held:
            self._drive.ask(wanted)
