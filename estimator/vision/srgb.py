"""Linear light from sRGB. Source: IEC 61966-2-1."""

import numpy as np
from numpy.typing import ArrayLike

from estimator.contracts.geometry import F64

LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear red, green, blue in luminance. Source: ITU-R BT.709."""
LUMA.setflags(write=False)


def linear_light(values: ArrayLike) -> F64:
    """Return the linear light, 0..1, of sRGB values 0..255 of any shape."""
    v = np.asarray(values) / 255.0
    return np.asarray(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4))


LINEAR_LIGHT = linear_light(np.arange(256))
"""(256,) linear light 0..1 of each value of a pixel."""
LINEAR_LIGHT.setflags(write=False)


def light_of_tone(tone: float) -> F64:
    """Return the light, (256,) 0..1, of each value of a pixel by a tone curve: 1 sRGB, 0 linear, between and beyond by powers."""
    values = np.arange(256) / 255.0
    light = np.zeros(256)
    light[1:] = values[1:] ** (1.0 - tone) * LINEAR_LIGHT[1:] ** tone
    return light
