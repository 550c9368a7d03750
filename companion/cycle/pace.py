"""Choose which frames are looked at: a machine too slow for every frame skips some, so that guidance is on time."""

import logging

from companion.base.health import Health
from estimator.contracts.estimates import Verdict
from estimator.contracts.time import MonoNs, after, seconds_between
from estimator.vision.camera.camera import Camera

_WEIGHT = 0.2
"""Weight of the newest look in the mean: five frames distinguish a slow machine from one slow look."""
_PAUSE_MAX_S = 0.2
"""Longest time without a look: a sighting at least each 0.2 s keeps an estimate fresh, whatever a look costs."""
_LATE_WEIGHT, _LATE_S, _ROOM_S, _BACK_S = 0.05, 0.01, 0.002, 0.0005
"""Weight of the newest guidance cycle in the mean lateness; the mean above which looks make room, s: half a cycle at 50 Hz; what
each cycle adds to the pause between looks then, s, and takes off it once the mean is below half of that."""
_WINDOW_S, _LEFT_OUT, _TOLD_LATE_S = 5.0, 0.4, 0.02
"""Time of one judgement, s; share of frames left out, and mean lateness, s, above which a computer is called too slow. It is
called so until both are below half of that."""

log = logging.getLogger(__name__)


class FramePace:
    """Decides which frames are looked at, and tells health whether the computer keeps up.

    Vision and event loop share the interpreter's lock, and a small computer's core. Vision that is never idle makes guidance late
    and each sighting older: half of the frames, seen in time, land a drone better than all of them, seen late.

    Args:
        core_fraction: the largest share of the time that looks may take, 0 to 1; at 1 no frame is skipped.
        camera: what takes the frames; where they are large, smaller ones are advised.
    """

    def __init__(self, core_fraction: float, camera: Camera, health: Health) -> None:
        self._core_fraction, self._health = core_fraction, health
        smaller = f"choose {camera.width // 2}x{camera.height // 2}"
        self._cure = smaller if camera.width >= 640 else "end other programs on it"
        self._mean_s: float | None = None
        self._late_s = self._pause_s = 0.0
        self._not_before = MonoNs(0)
        self._window: tuple[MonoNs, int, int] | None = None

    def admits(self, now: MonoNs) -> bool:
        """Return whether a frame that arrives now is to be looked at."""
        return self._core_fraction >= 1.0 or now >= self._not_before

    def looked(self, began: MonoNs, duration_s: float) -> None:
        """Take how long a look took, by the clock on the wall: what else keeps the core busy counts."""
        self._mean_s = duration_s if self._mean_s is None else self._mean_s + _WEIGHT * (duration_s - self._mean_s)
        wait_s = self._mean_s / self._core_fraction + self._pause_s
        self._not_before = after(began, min(wait_s, self._mean_s + _PAUSE_MAX_S))

    def cycle(self, now: MonoNs, late_s: float) -> None:
        """Take by how much a guidance cycle came late."""
        self._late_s += _LATE_WEIGHT * (late_s - self._late_s)
        if self._late_s > _LATE_S:
            self._pause_s = min(self._pause_s + _ROOM_S, _PAUSE_MAX_S)
        elif self._late_s < 0.5 * _LATE_S:
            self._pause_s = max(self._pause_s - _BACK_S, 0.0)
        frames = self._health.frames
        arrived, left_out = frames.total(), frames[Verdict.SKIPPED] + frames[Verdict.REPLACED]
        began, arrived_before, left_before = self._window = self._window or (now, arrived, left_out)
        if (took_s := seconds_between(began, now)) >= _WINDOW_S:
            self._window = now, arrived, left_out
            self._judge((arrived - arrived_before) / took_s, (left_out - left_before) / took_s)

    def _judge(self, rate_hz: float, left_out_hz: float) -> None:
        told = self._health.too_slow
        limit, slow = 1.0 if told is None else 0.5, None
        busy = self._pause_s > 0.0 or (self._mean_s or 0.0) * rate_hz > 0.5  # else frames wait for attitudes, not for looks
        if busy and left_out_hz > limit * _LEFT_OUT * rate_hz:
            slow = f"this computer manages {rate_hz - left_out_hz:.0f} of {rate_hz:.0f} frames a second: {self._cure}"
        elif self._late_s > limit * _TOLD_LATE_S:
            slow = f"this computer is too slow: guidance is {1e3 * self._late_s:.0f} ms late"
        self._health.too_slow = slow
        if (slow is None) != (told is None):
            log.warning("%s", slow or "this computer keeps up again")
