"""Drive the exposure of one open V4L2 device: its controls are found and taken over once, and then set.

Source: Linux media documentation, Camera Control Reference (exposure time in units of 100 us) and User Controls.
"""

import errno
import math

from drivers.camera import v4l2_kernel as kernel
from drivers.camera.exposure import FRAME_PART, ExposureRange, ExposureSetting
from drivers.camera.options import ExposureOptions
from estimator.contracts.errors import BadInput

EXPOSURE_MODE = 0x009A0901
"""V4L2_CID_EXPOSURE_AUTO."""
_MANUAL = 1  # its value V4L2_EXPOSURE_MANUAL
EXPOSURE_TIME = 0x009A0902
"""V4L2_CID_EXPOSURE_ABSOLUTE."""
EXPOSURE_UNIT_S = 100e-6
"""Its unit."""
_PRIORITY = 0x009A0903  # V4L2_CID_EXPOSURE_AUTO_PRIORITY: whether the camera may lower its frame rate for a longer exposure
_AUTOGAIN = 0x00980912  # V4L2_CID_AUTOGAIN
_GAINS = (0x00980913, 0x009E0903)
"""V4L2_CID_GAIN and V4L2_CID_ANALOGUE_GAIN; a device has one of them."""
_AUTO_WHITE_BALANCE = 0x0098090C  # V4L2_CID_AUTO_WHITE_BALANCE
_TEMPERATURE = 0x0098091A  # V4L2_CID_WHITE_BALANCE_TEMPERATURE, kelvin


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
        if EXPOSURE_TIME not in there:
            raise BadInput(f'camera {path}: it has no exposure time that can be set; let camera.exposure.mode be "camera"')
        self._time = there[EXPOSURE_TIME]
        self._gain = next((there[number] for number in _GAINS if number in there), None) if options.gain_ratio > 1.0 else None
        if self._gain is not None and self._gain.maximum <= self._gain.minimum:
            self._gain = None
        self._ratio = options.gain_ratio
        for number, value in ((EXPOSURE_MODE, _MANUAL), (_PRIORITY, 0), (_AUTOGAIN, 0), (_AUTO_WHITE_BALANCE, 0)):
            if number in there:
                self._fix(there[number], value)
        if _TEMPERATURE in there:
            balance = there[_TEMPERATURE]
            nearest = min(max(options.white_balance_k, balance.minimum), balance.maximum)
            step = max(1, int(balance.step))
            self._fix(balance, balance.minimum + (nearest - balance.minimum) // step * step)
        longest_s = min(EXPOSURE_UNIT_S * self._time.maximum, FRAME_PART / rate_hz)
        shortest_s = EXPOSURE_UNIT_S * max(1, self._time.minimum)
        self.can = ExposureRange(shortest_s, max(longest_s, shortest_s), self._ratio if self._gain is not None else 1.0)
        try:
            self.held = self.set(self.can.split(self._time_s() * self._amplification(), self.can.longest_s))
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
        units = math.floor(wanted.exposure_s / EXPOSURE_UNIT_S + 1e-6)
        step = max(1, int(self._time.step))
        low, high = int(self._time.minimum), int(self._time.maximum)
        units = min(max(low + (units - low) // step * step, low, 1), high)
        kernel.set_control(self._fd, EXPOSURE_TIME, units, self._time.type)
        held_s = self._time_s()
        if self._gain is None:
            return ExposureSetting(held_s, 1.0)
        gain = min(max(wanted.product_s / held_s, 1.0), self._ratio)
        low, high = int(self._gain.minimum), int(self._gain.maximum)
        value = low + round((gain - 1.0) / (self._ratio - 1.0) * (high - low))
        kernel.set_control(self._fd, self._gain.id, value, self._gain.type)
        return ExposureSetting(held_s, self._amplification())

    def _time_s(self) -> float:
        return EXPOSURE_UNIT_S * kernel.control_value(self._fd, EXPOSURE_TIME, self._time.type)

    def _amplification(self) -> float:
        if self._gain is None:
            return 1.0
        value = kernel.control_value(self._fd, self._gain.id, self._gain.type)
        low, high = int(self._gain.minimum), int(self._gain.maximum)
        return 1.0 + (self._ratio - 1.0) * (value - low) / (high - low)

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
