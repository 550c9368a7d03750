"""Image of the disc's own colour: its excess at each place over other places. It is searched too, if there is colour.

The measure is the logarithm of the disc's dominant channel minus that of the stronger of the other two. A change of brightness,
colour temperature or white balance shifts it by the same amount all over the frame.
"""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.vision.pad.pad import Pad
from estimator.vision.srgb import LINEAR_LIGHT

U8 = NDArray[np.uint8]

_FLOOR = 0.01
"""Light, as a fraction of full scale, below which there is only noise (12 of 8000 electrons read noise, twice averaged, is a
sixth of it).
"""
_MIDDLE = 80  # Value where the channels are equal
_NAT = 255.0 / float(np.log1p(1.0 / _FLOOR))  # Steps for a factor e
_COLOURED, _HAZY = 0.25 * _NAT, 0.06 * _NAT
"""Measure from which a disc's paint is no shade of grey, and range of the measure in a frame below which the frame has no
colour: 99 of 100 discs stand out by 0.56 in any light, and by a seventh of that in haze.
"""
_LOG = np.rint(np.log1p(LINEAR_LIGHT / _FLOOR) * _NAT).astype(np.uint8)


def disc_colour(px: U8, pad: Pad) -> U8:
    """Return the measure, (h, w), of a BGR frame."""
    main = 2 - int(np.argmax(pad.markings.colours.disc))
    channels = cv2.split(px)
    own, others, more = channels[main], channels[(main + 1) % 3], channels[(main + 2) % 3]
    # Each step writes over an image that is no longer needed: the system takes longer to give memory than a step takes.
    cv2.LUT(cv2.max(others, more, others), _LOG, others)
    cv2.subtract(cv2.LUT(own, _LOG, own), others, more)
    cv2.subtract(others, own, others)
    return np.asarray(cv2.subtract(cv2.convertScaleAbs(more, more, 1.0, _MIDDLE), others, more), np.uint8)


def is_coloured(measure: U8) -> bool:
    """Return whether the measure of a frame, at reduced size, varies more than a frame's without colour."""
    low, high, _, _ = cv2.minMaxLoc(measure)
    return high - low > _HAZY


@lru_cache(maxsize=8)
def in_grey(pad: Pad) -> Pad:
    """Return a pad as a grey camera sees it: each paint by its luminance."""
    rgb = np.array([[paint for _, paint in pad.paints]], np.uint8)
    shades = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)[0].tolist()
    return replace(pad, paints=tuple((name, (shade,) * 3) for (name, _), shade in zip(pad.paints, shades, strict=True)))


@lru_cache(maxsize=8)
def disc_has_colour(pad: Pad) -> bool:
    """Return whether there is a disc whose paint is no shade of grey."""
    if not pad.markings.field_radius_m:
        return False
    nominal = np.array([[pad.markings.colours.disc[::-1]]], np.uint8)
    return int(disc_colour(nominal, pad)[0, 0]) - _MIDDLE > _COLOURED
