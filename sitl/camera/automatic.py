"""The camera's automatics: exposure and white balance that follow the whole picture with a lag.

The meter is that of simple cameras: the mean of the picture's values. A bright sea makes the exposure shorter and the pad darker,
a dark deck makes it longer until white paint is clipped. White balance takes the picture for grey on the whole, between the
colours of lamps and of a blue sky.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64
from estimator.vision.srgb import linear_light
from sitl.camera.light import Light, Sensor, planck_rgb

U8 = NDArray[np.uint8]

_TARGET = 105.0
"""Mean value of a picture that is rightly exposed, 0 to 255."""
_GAIN_MOST = 16.0
_SHORTEST = 1.0 / 32.0
"""Shortest exposure against that of daylight."""
_MIRED = (100.0, 400.0)
"""Limits of the white balance: 10000 to 2500 K, in 1e6 / K."""
_STEPS_OF_GAIN = 2.0
"""Steps of amplification in a stop; each has tables of its noise."""


@dataclass(frozen=True, slots=True)
class Automatics:
    """The time constants of a camera's automatics, s; 0 where it has none."""

    exposure_lag_s: float = 0.0
    longest_s: float = 0.02
    """Longest exposure; with less light the camera amplifies."""
    balance_lag_s: float = 0.0

    @property
    def any(self) -> bool:
        """True if the camera has any automatic."""
        return self.exposure_lag_s > 0 or self.balance_lag_s > 0


@dataclass(frozen=True, slots=True)
class Adjusted:
    """Values that the camera's automatics have set, and when."""

    t_s: float
    ev: float = 0.0
    """Stops against the exposure of daylight."""
    mired: float = 1e6 / 6500.0
    """Colour of the light that is taken for white, 1e6 / K."""


def settings(light: Light, sensor: Sensor, automatics: Automatics, adjusted: Adjusted) -> tuple[Light, Sensor]:
    """Return light and sensor with what the automatics have set."""
    if automatics.balance_lag_s > 0:
        light = replace(light, balanced_for_k=1e6 / adjusted.mired)
    if automatics.exposure_lag_s > 0:
        wanted = 2.0**adjusted.ev
        longest = max(sensor.exposure_s, automatics.longest_s) / max(sensor.exposure_s, 1e-6)
        longer = min(max(wanted, _SHORTEST), longest)
        amplified = min(max(wanted / longer, 1.0), _GAIN_MOST)
        steps = 2.0 ** (round(_STEPS_OF_GAIN * math.log2(amplified)) / _STEPS_OF_GAIN)
        sensor = replace(sensor, exposure_s=sensor.exposure_s * longer, full_well_e=sensor.full_well_e / steps)
        light = replace(light, exposure_ev=light.exposure_ev + math.log2(longer * amplified))
    return light, sensor


def adjust(automatics: Automatics, adjusted: Adjusted, image: U8, t_s: float, *, at_once: bool = False) -> Adjusted:
    """Return what the automatics set after a frame.

    Args:
        image: the frame (H, W, 3) BGR that they meter.
        t_s: time of the frame.
        at_once: without lag, as when the camera has looked at the scene for long.
    """
    blue, green, red = cv2.mean(cv2.resize(image, (32, 18), interpolation=cv2.INTER_AREA))[:3]
    dt = max(0.0, t_s - adjusted.t_s)
    ev, mired = adjusted.ev, adjusted.mired
    if automatics.exposure_lag_s > 0:
        seen = linear_light(np.array([0.114 * blue + 0.587 * green + 0.299 * red, _TARGET]))
        off = math.log2(float(seen[1]) / max(float(seen[0]), 1e-4))
        ev += off * (1.0 if at_once else 1.0 - math.exp(-dt / automatics.exposure_lag_s))
        ev = min(max(ev, math.log2(_SHORTEST)), 12.0)
    if automatics.balance_lag_s > 0:
        b, r = linear_light(np.array([blue, red])).clip(1e-4)
        # The colour that would make the picture grey: what is redder than white now is redder light than was assumed.
        ratios, mireds = _locus()
        wanted = float(np.interp(math.log(r / b) + np.interp(mired, mireds, ratios), ratios, mireds))
        mired += (wanted - mired) * (1.0 if at_once else 1.0 - math.exp(-dt / automatics.balance_lag_s))
    return Adjusted(t_s, ev, mired)


@lru_cache(maxsize=1)
def _locus() -> tuple[F64, F64]:
    """Return log(red / blue) of black bodies, rising, and their colours in mired."""
    mireds = np.linspace(*_MIRED, 61)
    rgb = np.array([planck_rgb(1e6 / m) for m in mireds])
    return np.log(rgb[:, 0] / rgb[:, 2]), mireds
