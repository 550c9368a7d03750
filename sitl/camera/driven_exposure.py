"""The exposure of a simulated camera that the service drives: what it can hold, how late a change shows, and what it costs."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from drivers.camera.exposure_drive import ExposureDrive
from drivers.camera.exposure_law import ExposureRange, ExposureSetting
from sitl.camera.light import Light, Sensor

_LAG_FRAMES = 2
"""Exposures that begin before a new setting acts, as with most USB cameras."""
_GAIN_MOST = 16.0
_SHORTEST_S = 1e-4
_PART_OF_FRAME = 0.8
_STEPS_OF_GAIN = 2.0
"""Steps of amplification in a stop; each has tables of its noise."""


@dataclass(frozen=True, slots=True)
class Taken:
    """How one frame is taken."""

    setting: ExposureSetting | None = None
    """None where the camera sets it itself."""
    light_fraction: float = 1.0
    """Light on the scene against what the scenario says."""
    white_balance_k: float | None = None
    """Colour temperature that is taken for white; None where the camera sets it itself."""


class SimulatedExposure:
    """The camera's side of a driven exposure.

    Args:
        start: what it holds at first.
        arrived: returns the number of the newest frame that the service has.
    """

    def __init__(
        self, drive: ExposureDrive, start: ExposureSetting, period_s: float, white_balance_k: float, arrived: Callable[[], int]
    ) -> None:
        self._drive, self._arrived, self._white_balance_k = drive, arrived, white_balance_k
        can = ExposureRange(_SHORTEST_S, _PART_OF_FRAME * period_s, _GAIN_MOST)
        self._shown = can.split(start.product_s, can.longest_s)
        self._coming: deque[tuple[int, ExposureSetting]] = deque()
        self._exposures = 0
        drive.opened(can, self._shown)

    def expose(self) -> Taken:
        """Return how the next frame is taken; call it once for each, in order."""
        self._exposures += 1
        wanted = self._drive.take()
        if wanted is not None:
            newest = self._arrived()
            self._drive.changed(wanted, newest, newest)
            self._coming.append((self._exposures + _LAG_FRAMES, wanted))
        while self._coming and self._coming[0][0] <= self._exposures:
            self._shown = self._coming.popleft()[1]
        return Taken(self._shown, white_balance_k=self._white_balance_k)


def taken_with(light: Light, sensor: Sensor, taken: Taken) -> tuple[Light, Sensor]:
    """Return light and sensor of a frame: a longer exposure counts more light, a gain amplifies it with its noise."""
    ev = light.exposure_ev + math.log2(taken.light_fraction)
    if taken.setting is not None:
        gain = 2.0 ** (round(_STEPS_OF_GAIN * math.log2(taken.setting.gain)) / _STEPS_OF_GAIN)
        ev += math.log2(taken.setting.product_s / sensor.exposure_s)
        sensor = replace(sensor, exposure_s=taken.setting.exposure_s, full_well_e=sensor.full_well_e / gain)
    if taken.white_balance_k is not None:
        light = replace(light, balanced_for_k=taken.white_balance_k)
    return replace(light, exposure_ev=min(max(ev, -10.0), 10.0)), sensor
