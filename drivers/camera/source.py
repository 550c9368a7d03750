"""The interface between camera drivers and readers of frames: the open camera, and the error of a lost one."""

import logging

from drivers.camera.counters import CameraCounters
from drivers.camera.exposure import ExposureDrive
from drivers.mailbox import Latest
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, seconds_between

_DAMAGE_OVER_S, _DAMAGE_AGAIN_S = 5.0, 60.0
"""The time over which damaged frames are counted before they are reported, and that until they are reported again."""
_DAMAGE_SHARE = 0.02
"""The share of damaged frames from which they are reported."""

log = logging.getLogger(__name__)


class CameraLost(Recoverable):
    """The camera was unplugged, fell silent or is absent; `reason` is one word for counting.

    A channel raises it with the reason `ended` when a file is over, and that file is not opened again.
    """

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class VideoSource:
    """An open camera. It may be absent at the moment: see `down`.

    Args:
        exposure: connects who drives the exposure with the driver; None where the camera does that itself.
    """

    def __init__(self, exposure: ExposureDrive | None = None) -> None:
        self.exposure = exposure
        """The exposure that we drive; None where the camera does."""
        self.frames: Latest[Frame] = Latest()
        """The newest frame. The end of a video file ends it with `CameraLost`."""
        self.counters = CameraCounters()
        self.down: str | None = "not yet opened"
        """The reason why no frames arrive, None while they do."""
        self.damage: str | None = None
        """Share of damaged frames, in words, and the cure; None while hardly any are."""
        self._counted_at: tuple[MonoNs, int, int] | None = None
        self._reported_at: MonoNs | None = None

    def count_damage(self, name: str, now: MonoNs) -> None:
        """Compare the counters with those of some seconds ago, and log a share of damaged frames that matters."""
        c = self.counters
        since, buffers, damaged = self._counted_at = self._counted_at or (now, c.buffers, c.frames_damaged)
        took_s = seconds_between(since, now)
        if took_s < _DAMAGE_OVER_S:
            return
        came, bad = c.buffers - buffers, c.frames_damaged - damaged
        self._counted_at = (now, c.buffers, c.frames_damaged)
        if bad <= _DAMAGE_SHARE * came:
            self.damage = None
            return
        self.damage = (
            f"{name}: {bad / took_s:.1f} of {came / took_s:.1f} frames a second are damaged and not used: "
            "look at the cable, the hub and the bandwidth"
        )
        if self._reported_at is None or seconds_between(self._reported_at, now) >= _DAMAGE_AGAIN_S:
            self._reported_at = now
            log.warning("%s", self.damage)
