"""The exposure controls of a V4L2 device whose exposure is driven: they are found and taken over once, and then set.

Source: Linux media documentation, Camera Control Reference (exposure time in units of 100 us) and User Controls.
"""

from __future__ import annotations

import errno
import math

from drivers.camera import v4l2_kernel as kernel
from drivers.camera.exposure_law import ExposureRange, ExposureSetting
from drivers.camera.exposure_options import ExposureOptions
from estimator.contracts.errors import BadInput

_MODE, _TIME, _PRIORITY = 0x009A0901, 0x009A0902, 0x009A0903
_AUTOGAIN, _GAINS = 0x00980912, (0x00980913, 0x009E0903)
_AUTO_WHITE_BALANCE, _TEMPERATURE = 0x0098090C, 0x0098091A
_MANUAL = 1
_UNIT_S = 100e-6
_PART_OF_FRAME = 0.8
"""Largest part of a frame's time that is exposed: read-out takes the rest, and a longer time would slow the camera down."""


class KernelExposure:
    """The exposure of one open device.

    Args:
        fd: the open device.
        path: its name in errors.

    Raises:
        OSError: the device is gone.
        BadInput: it has no exposure time that can be set, or keeps its automatics.
    """

    def __init__(self, fd: int, path: str, options: ExposureOptions, rate_hz: float) -> None:
        self._fd, self._path = fd, path
        there = {control.id: control for control in kernel.controls(fd)}
        if _TIME not in there:
            raise BadInput(f'camera {path}: it has no exposure time that can be set; let camera.exposure.mode be "camera"')
        self._time = there[_TIME]
        self._gain = next((there[number] for number in _GAINS if number in there), None) if options.gain_ratio > 1.0 else None
        if self._gain is not None and self._gain.maximum <= self._gain.minimum:
            self._gain = None
        self._ratio = options.gain_ratio
        for number, value in ((_MODE, _MANUAL), (_PRIORITY, 0), (_AUTOGAIN, 0), (_AUTO_WHITE_BALANCE, 0)):
            if number in there:
                self._fix(there[number], value)
        if _TEMPERATURE in there:
            balance = there[_TEMPERATURE]
            nearest = min(max(options.white_balance_k, balance.minimum), balance.maximum)
            step = max(1, int(balance.step))
            self._fix(balance, balance.minimum + (nearest - balance.minimum) // step * step)
        longest_s = min(_UNIT_S * self._time.maximum, _PART_OF_FRAME / rate_hz)
        shortest_s = _UNIT_S * max(1, self._time.minimum)
        self.can = ExposureRange(shortest_s, max(longest_s, shortest_s), self._ratio if self._gain is not None else 1.0)
        try:
            self.held = self.set(self._now())
        except OSError as why:
            if why.errno == errno.ENODEV:
                raise
            # A camera that is opened again in flight and refuses gives frames all the same.
            self.held = ExposureSetting(self._time_s(), self._amplification())

    def set(self, wanted: ExposureSetting) -> ExposureSetting:
        """Set the exposure, and return what the camera holds then. It may take as long as the device's bus does.

        Raises:
            OSError: the camera refuses it, or is gone.
        """
        # Downwards, because the time is a limit; the gain makes up for it.
        units = math.floor(wanted.exposure_s / _UNIT_S + 1e-6)
        step = max(1, int(self._time.step))
        low, high = int(self._time.minimum), int(self._time.maximum)
        units = min(max(low + (units - low) // step * step, low, 1), high)
        kernel.set_control(self._fd, _TIME, units, self._time.type)
        held_s = self._time_s()
        if self._gain is None:
            return ExposureSetting(held_s, 1.0)
        gain = min(max(wanted.product_s / held_s, 1.0), self._ratio)
        low, high = int(self._gain.minimum), int(self._gain.maximum)
        value = low + round((gain - 1.0) / (self._ratio - 1.0) * (high - low))
        kernel.set_control(self._fd, self._gain.id, value, self._gain.type)
        return ExposureSetting(held_s, self._amplification())

    def _time_s(self) -> float:
        return _UNIT_S * kernel.control_value(self._fd, _TIME, self._time.type)

    def _amplification(self) -> float:
        if self._gain is None:
            return 1.0
        value = kernel.control_value(self._fd, self._gain.id, self._gain.type)
        low, high = int(self._gain.minimum), int(self._gain.maximum)
        return 1.0 + (self._ratio - 1.0) * (value - low) / (high - low)

    def _now(self) -> ExposureSetting:
        return self.can.split(self._time_s() * self._amplification(), self.can.longest_s)

    def _fix(self, control: kernel.VideoControl, value: int) -> None:
        name = control.name.decode(errors="replace")
        try:
            kernel.set_control(self._fd, control.id, value, control.type)
            held = kernel.control_value(self._fd, control.id, control.type)
        except OSError as why:
            if why.errno == errno.ENODEV:
                raise
            raise BadInput(
                f'camera {self._path}: {name!r} cannot be set to {value} ({why.strerror}); let camera.exposure.mode be "camera"'
            ) from why
        if held != value:
            raise BadInput(
                f'camera {self._path}: {name!r} was set to {value} but holds {held}; let camera.exposure.mode be "camera"'
            )
