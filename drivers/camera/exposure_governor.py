"""Decide on a driven camera's exposure, frame by frame: meter, wait until a change shows, and ask for the next one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.camera.exposure_drive import ExposureDrive
from drivers.camera.exposure_law import LawMemory, limit_of, step
from drivers.camera.exposure_options import ExposureOptions
from drivers.camera.exposure_search import BracketMemory, search_step
from drivers.camera.metering import meter_inside, meter_whole
from estimator.contracts.samples import Frame


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
        can, held = self._drive.can, self._drive.held
        if can is None or held is None:
            return
        limit_s = limit_of(self._o.blur_px, speed_px_s, self._o.longest_s)
        if not self._drive.settled(frame.seq):
            if held.exposure_s > limit_s and held.exposure_s > can.shortest_s:
                self._drive.ask(can.split(held.product_s, limit_s))
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
