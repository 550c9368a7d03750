"""The vehicle's samples are silent while its camera films on: which pad do they come back to (own truth: the pictures)?"""

import asyncio
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.base.observer import NullObserver, ProcessedFrame
from companion.guidance.pilot import Pilot
from companion.service.daemon import Daemon, DaemonSetup
from companion.settings.guidance import GuidanceOptions
from companion.settings.restart import RestartOptions
from estimator.contracts.commands import Command
from estimator.contracts.estimates import Verdict
from estimator.options import EstimatorOptions
from estimator.vision.tracker import drawn
from tests.companion.test_daemon import EYES
from tests.companion.virtual_flight import TICK_S, FakeFlight, VirtualClock, fly

PAD = drawn(EYES.camera, EYES.pad)
SEA = np.full_like(PAD, (90, 60, 20))
HEIGHT_M = 5.0 * EYES.pad.disc_radius_m
SILENT_S, ENDS_S = (1.2, 2.4), 2.8
"""Times between which no sample comes, and the end. It comes sooner than a pad elsewhere is adopted."""
BEFORE_M, AFTER_M = 0.0, 0.85
"""The pad is in the picture so far aside before and after. It is farther than two pads may lie apart."""


class Filmed(FakeFlight):
    """A vehicle that holds still by its sensors; its pictures are those of `aside_m`, by the time."""

    def __init__(self, clock: VirtualClock, aside_m: Callable[[float], float | None]) -> None:
        super().__init__(clock)
        self._aside_m = aside_m

    def command(self, command: Command) -> None:
        """Hold still by itself, whatever is ordered."""

    def sense(self, n: int) -> None:
        if not SILENT_S[0] <= n * TICK_S < SILENT_S[1]:
            super().sense(n)

    def picture(self, n: int) -> NDArray[np.uint8]:
        aside_m = self._aside_m(n * TICK_S)
        px = SEA if aside_m is None else np.roll(PAD, round(EYES.camera.fx / HEIGHT_M * aside_m), axis=1)
        return px + super().picture(n)


class Diary(NullObserver):
    def __init__(self) -> None:
        self.frames: list[ProcessedFrame] = []

    def on_frame(self, processed: ProcessedFrame) -> None:
        self.frames.append(processed)


def slides(t: float) -> float:
    """Return the pad's place while the vehicle drifts over it during the silence."""
    return float(np.interp(t, SILENT_S, (BEFORE_M, AFTER_M)))


def leaves(t: float) -> float | None:
    """Return the place of a pad that leaves the picture, and of one that comes into it at another place."""
    return None if 1.6 <= t < 1.8 else BEFORE_M if t < 1.7 else AFTER_M


def jumps(t: float) -> float:
    """Return the place of one pad, and from one picture to the next that of another."""
    return BEFORE_M if t < 1.8 else AFTER_M


@pytest.mark.parametrize(("aside_m", "same"), [(slides, True), (leaves, False), (jumps, False)])
def test_a_pad_that_never_left_the_picture_is_no_other_one_when_the_samples_come_back(aside_m, same):
    clock, diary = VirtualClock(), Diary()
    vehicle = Filmed(clock, aside_m)
    pilot = Pilot(EYES, EstimatorOptions(), GuidanceOptions())
    daemon = Daemon(vehicle.open, pilot, clock, DaemonSetup(RestartOptions(), 50.0), observers=[diary])
    asyncio.run(fly(daemon, vehicle, clock, ENDS_S))
    verdicts = [(f.frame.stamp.measured_at * 1e-9, f.verdict) for f in diary.frames]
    before, silent, after = ([v for t, v in verdicts if a < t < b] for a, b in ((0.5, 1.2), (1.3, 2.38), (2.45, ENDS_S)))
    assert set(before) == {Verdict.FUSED}
    assert set(silent) == {Verdict.NO_ATTITUDE}, "nothing is fused by an attitude that nobody knows"
    assert set(after) == ({Verdict.FUSED} if same else {Verdict.ELSEWHERE})
    assert pilot.estimation.memory.guard.tracks.number == 1
