"""The response of a hull to waves by a table: amplitude and phase per encounter frequency and heading."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.contracts.geometry import F64

MODES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_ODD = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""A wave from the other side mirrors sway, roll and yaw of a hull that is alike on both sides."""


@dataclass(frozen=True, slots=True, eq=False)
class ResponseTable:
    """Complex responses on a grid, as `sitl.vessel.seakeeping.responses` returns them."""

    encounter_rad_s: F64
    """(F,) ascending, positive."""
    heading_rad: F64
    """(D,) ascending from 0 (following sea) to pi (head sea); waves from port, those from starboard are their mirror."""
    grid: NDArray[np.complex128]
    """(6, D, F)."""

    @staticmethod
    def of(
        encounter_rad_s: list[float], heading_deg: list[float], modes: Mapping[str, tuple[list[list[float]], list[list[float]]]]
    ) -> ResponseTable:
        """Return the table of (amplitudes, phases in degrees) by mode, each with one row a heading; a missing mode is zero.

        Amplitudes are m/m for surge (forward), sway (to starboard) and heave (up), degrees/m for roll (starboard down), pitch
        (bow up) and yaw (to starboard). The phase is the motion's lead over the crest amidships.

        Raises:
            ValueError: axes that do not ascend or span 0 to 180 degrees, rows that do not match them, a negative amplitude.
        """
        w, heading = np.asarray(encounter_rad_s, dtype=float), np.asarray(heading_deg, dtype=float)
        if w.size < 2 or np.any(np.diff(w) <= 0) or w[0] <= 0:
            raise ValueError("encounter_rad_s must hold two or more ascending frequencies over 0")
        if heading.size < 2 or np.any(np.diff(heading) <= 0) or heading[0] != 0.0 or heading[-1] != 180.0:
            raise ValueError("heading_deg must ascend from 0 (following sea) to 180 (head sea)")
        grid = np.zeros((6, heading.size, w.size), dtype=complex)
        for i, mode in enumerate(MODES):
            if mode not in modes:
                continue
            for rows, what in zip(modes[mode], ("amplitude", "phase_deg"), strict=True):
                if len(rows) != heading.size or any(len(row) != w.size for row in rows):
                    raise ValueError(f"{mode}.{what} must hold {heading.size} rows (headings) of {w.size} numbers (frequencies)")
            amplitude, lead = (np.asarray(rows, dtype=float) for rows in modes[mode])
            if np.any(amplitude < 0):
                raise ValueError(f"{mode}.amplitude must be 0 or more: a negative one is a phase of 180 degrees")
            unit = (1.0, 1.0, -1.0, *(math.radians(1.0),) * 3)[i]  # heave is down inside
            # A wave is exp(i theta) with theta falling in time, so that a lead is a negative angle.
            grid[i] = unit * amplitude * np.exp(-1j * np.radians(lead))
        return ResponseTable(w, np.radians(heading), grid)

    def responses(self, encounter_rad_s: F64, beta_rad: F64) -> NDArray[np.complex128]:
        """Return (6, ...) responses for encounter frequencies and directions (...), bilinear between the table's points.

        Below the lowest frequency the lowest counts; above the highest the response falls with the fourth power of frequency.
        An overtaken wave (negative encounter frequency) runs backwards in time: its response is the conjugate.
        """
        we, beta = np.broadcast_arrays(np.asarray(encounter_rad_s, dtype=float), np.asarray(beta_rad, dtype=float))
        turned = (beta + math.pi) % math.tau - math.pi
        w = np.abs(we)
        i, x = _place(self.encounter_rad_s, np.clip(w, self.encounter_rad_s[0], self.encounter_rad_s[-1]))
        j, y = _place(self.heading_rad, np.clip(np.abs(turned), 0.0, math.pi))
        g = self.grid
        low = g[:, j, i] * (1.0 - x) + g[:, j, i + 1] * x
        high = g[:, j + 1, i] * (1.0 - x) + g[:, j + 1, i + 1] * x
        out = (low * (1.0 - y) + high * y) * (self.encounter_rad_s[-1] / np.maximum(w, self.encounter_rad_s[-1])) ** 4
        mirror = np.where(turned < 0, _ODD.reshape(6, *(1,) * w.ndim), 1.0)
        return np.asarray(mirror * np.where(we < 0, out.conj(), out))


def _place(axis: F64, value: F64) -> tuple[NDArray[np.intp], F64]:
    """Return the interval of each value on an ascending axis, and the share of the way through it."""
    i = np.clip(np.searchsorted(axis, value, side="right") - 1, 0, axis.size - 2)
    return i, (value - axis[i]) / (axis[i + 1] - axis[i])
