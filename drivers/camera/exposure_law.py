"""Drive the exposure of a camera: from the metered light to exposure time and gain.

The light of a picture is proportional to exposure time times gain, so the law works in stops (doublings) of that product. It is
given as a time as far as the limits on time allow, because light costs less noise than gain does, and as gain beyond that.

A camera shows a change only some frames later. The law gets no picture before that. It then cannot swing, though neither the
camera's tone curve nor its gain is known: both make the measured error wrong by a factor, and a step is `_DAMPING` of it.

While no pad is tracked the part of the picture to meter is unknown, so two exposures take turns. The first keeps the
brightest parts of the picture from clipping, as a lit pad on a dark sea needs it. The second shows what is in its darkest
parts, as a pad in the shade beside the mirrored sun needs it; where the first shows that too, there is no second.
"""

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from drivers.camera.exposure import ExposureDrive, ExposureRange, ExposureSetting
from drivers.camera.metering import Metered, meter_inside, meter_whole
from drivers.camera.options import ExposureOptions
from estimator.contracts.samples import Frame

_DAMPING = 0.6
"""Part of the measured error that one step corrects."""
_ENTER_EV = 0.4  # error, stops, from which the law corrects
_LEAVE_EV = 0.15  # error, stops, below which the law stops correcting
_CUT_EV = 1.5
"""Error, stops, from which the law corrects while the frame's edge cuts the pad.

The visible part changes with every frame, and each change of the exposure would cost frames in the very last part.
"""
_STEP_EV = 3.0
"""Largest step, stops."""
_LENGTHEN = 1.9
"""The time is made longer at the gain's cost only where the limit has grown by this factor: each change costs pictures."""
_RUNGS = 2.0
"""Limits on the time in an octave: a limit that follows each sway would change the exposure with every picture."""
_DWELL = 8
"""Pictures with one exposure before the other's turn: a quarter of a second at 30 Hz, enough for several looks of the search."""
_APART_EV = 1.0
"""Stops between the two from which they take turns."""
_FARTHEST_EV = 3.0  # stops between the two at most


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
