"""The vehicle's samples are silent while its camera films on: which pad do they come back to (own truth: the pictures)?"""

import asyncio
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.guidance import GuidanceOptions
from companion.settings.service import RestartOptions
from estimator.contracts.commands import Command
from estimator.contracts.estimates import Verdict
from estimator.options import EstimatorOptions
from estimator.vision.tracker import drawn
from tests.companion.test_daemon import EYES
from tests.companion.virtual_flight import TICK_S, FakeFlight, VirtualClock, fly
from tests.fly import ObservedCalls

NEAR_M, HIGH_M = 5.0 * EYES.pad.disc_radius_m, 4.4
"""Heights over the pad: that of the drawn one, and one from which much of the deck is in the picture."""
PAD = drawn(EYES.camera, EYES.pad)[40:320, 180:460]
SILENT_S, ENDS_S = (1.2, 2.4), 2.8
"""Times between which no sample comes, and the end. It comes sooner than a pad elsewhere is adopted."""
BEFORE_M, AFTER_M = 0.0, 0.85
"""The pad is in the picture so far aside before and after. It is farther than two pads may lie apart."""


Places = list[tuple[float, float]]
"""Places of pads in the picture, m to the right of its centre and below it."""


class Filmed(FakeFlight):
    """A vehicle that holds still by its sensors; its pictures show pads by the time."""

    def __init__(self, clock: VirtualClock, pads: Callable[[float], Places], height_m: float) -> None:
        super().__init__(clock)
        self._pads, self._height_m = pads, height_m

    def command(self, command: Command) -> None:
        """Hold still by itself, whatever is ordered."""

    def sense(self, n: int) -> None:
        if not SILENT_S[0] <= n * TICK_S < SILENT_S[1]:
            super().sense(n)

    def picture(self, n: int) -> NDArray[np.uint8]:
        px_m = EYES.camera.fx / self._height_m
        small = cv2.resize(PAD, None, fx=NEAR_M / self._height_m, fy=NEAR_M / self._height_m, interpolation=cv2.INTER_AREA)
        px = np.empty((EYES.camera.height, EYES.camera.width, 3), np.uint8)
        px[:] = PAD[0, 0]
        for right_m, below_m in self._pads(n * TICK_S):
            u = round(EYES.camera.cx + px_m * right_m - 0.5 * len(small))
            v = round(EYES.camera.cy + px_m * below_m - 0.5 * len(small))
            shows = px[max(0, v) : max(0, v + len(small)), max(0, u) : max(0, u + len(small))]
            shows[:] = small[max(0, -v) :, max(0, -u) :][: shows.shape[0], : shows.shape[1]]
        return px + super().picture(n)


def slides(t: float) -> Places:
    """Return the pad's place while the vehicle drifts over it during the silence."""
    return [(float(np.interp(t, SILENT_S, (BEFORE_M, AFTER_M))), 0.0)]


def leaves(t: float) -> Places:
    """Return the place of a pad that leaves the picture, and of one that comes into it at another place."""
    return [] if 1.6 <= t < 1.8 else [(BEFORE_M if t < 1.7 else AFTER_M, 0.0)]


def jumps(t: float) -> Places:
    """Return the place of one pad, and from one picture to the next that of another."""
    return [(BEFORE_M if t < 1.8 else AFTER_M, 0.0)]


def swings(t: float) -> Places:
    """Return the place of a pad that swings out of the picture for half a second and back, while the vehicle drifts over it."""
    return [(0.3, float(np.interp(t, (1.4, 1.6, 1.9, 2.1, 2.4), (-1.2, -3.0, -3.0, -1.3, -0.35))))]


def swings_on(t: float) -> Places:
    """Return a pad that swings out of the picture, and another one that swings near to its place; it was covered at first."""
    below_m = float(np.interp(t, (1.4, 1.6, 1.9, 2.1), (-1.2, -3.0, -3.0, -2.6)))
    return [(0.3, below_m), *([(1.1, below_m + 1.3)] if t > 0.9 else [])]


@pytest.mark.parametrize(
    ("pads", "height_m", "same"),
    [(slides, NEAR_M, True), (leaves, NEAR_M, False), (jumps, NEAR_M, False), (swings, HIGH_M, True), (swings_on, HIGH_M, False)],
)
def test_a_pad_is_known_again_after_a_silence_in_which_no_other_one_can_have_come(pads, height_m, same):
    clock, diary = VirtualClock(), ObservedCalls()
    vehicle = Filmed(clock, pads, height_m)
    pilot = Pilot(EYES, EstimatorOptions(), GuidanceOptions())
    daemon = Daemon(vehicle.open, pilot, clock, DaemonSetup(RestartOptions(), 50.0), observers=[diary])
    asyncio.run(fly(daemon, vehicle, clock, ENDS_S))
    verdicts = [(f.frame.stamp.measured_at * 1e-9, f.verdict) for f in diary.frames]
    before, silent, after = ([v for t, v in verdicts if a < t < b] for a, b in ((0.5, 1.2), (1.3, 2.38), (2.45, ENDS_S)))
    assert set(before) == {Verdict.FUSED}
    assert set(silent) == {Verdict.NO_ATTITUDE}, "nothing is fused by an attitude that nobody knows"
    assert set(after) == ({Verdict.FUSED} if same else {Verdict.ELSEWHERE})
    assert pilot.estimator.guard.tracks.number == 1
