"""The interface between camera drivers and readers of frames: the open camera, its counters, its stamps and the lost camera."""

import logging
import math
from collections import Counter
from dataclasses import dataclass, field, fields

from drivers.camera.exposure import ExposureDrive
from drivers.camera.options import CameraOptions
from drivers.mailbox import Latest
from estimator.contracts.errors import Recoverable
from estimator.contracts.samples import Frame
from estimator.contracts.time import MonoNs, Stamp, after, seconds_between

_DAMAGE_OVER_S = 5.0  # the time over which damaged frames are counted before they are reported
_DAMAGE_AGAIN_S = 60.0  # the time after which damaged frames are reported again
_DAMAGE_SHARE = 0.02
"""The share of damaged frames from which they are reported."""
_OLDEST_S = 2.0
"""A frame whose stamp is older than this was not stamped by this host's monotonic clock."""
_AHEAD_S = 0.005
"""A driver that stamps by the kernel's tick may be ahead by one tick; a stamp further ahead is refused."""


@dataclass(slots=True)
class CameraCounters:
    """Running totals since the camera was opened. Every buffer is counted as given out, overtaken, damaged or waiting."""

    buffers: int = 0
    """Buffers received from the device or the stream."""
    frames: int = 0
    """Frames that were given out."""
    frames_overtaken: int = 0
    """Frames that were skipped because a newer one had already arrived."""
    frames_damaged: int = 0
    """Frames marked bad by the kernel, torn, of another size than was agreed, or refused by the decoder."""
    frames_wrong_size: int = 0
    """Frames that claimed another size than was agreed and were not decoded: a part of `frames_damaged`."""
    frames_waiting: int = 0
    """Frames dropped until the next IDR (H.264)."""
    frames_lost: int = 0
    """Frames missing in the device's own count; they were never received and are not among `buffers`."""
    frames_replaced: int = 0
    """Frames that were given out and replaced by a newer one before anyone read them: a part of `frames`."""
    stamps_refused: int = 0
    """Kernel time stamps that were impossible; the arrival was used instead."""
    restarts: Counter[str] = field(default_factory=Counter)
    """Restarts by reason: unplugged, silent, absent, failed."""

    def as_dict(self) -> dict[str, int]:
        """Return the counters as a flat dict for records and telemetry; restarts have keys like `restarts.unplugged`."""
        out: dict[str, int] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, Counter):
                out.update({f"{f.name}.{key}": n for key, n in sorted(value.items())})
            else:
                out[f.name] = value
        return out


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


def stamp_of(
    stamped: MonoNs | None,
    to_middle_s: float,
    received_at: MonoNs,
    options: CameraOptions,
    exposure_s: float,
    error_s: float = 0.0,
) -> tuple[Stamp, bool]:
    """Return the stamp of mid-exposure, and whether the given stamp had to be refused (future, or older than 2 s).

    If the exposure is not known, half a frame's time is added to the variance.

    Args:
        stamped: by CLOCK_MONOTONIC; None if nothing or another clock stamped the frame, whose arrival is used then.
        to_middle_s: from the stamped instant to mid-exposure, s; `latency_s` is subtracted besides.
        exposure_s: exposure time, 0 if unknown.
        error_s: largest error of `to_middle_s`.
    """
    unknown_s = 0.5 / options.rate_hz / math.sqrt(3.0) if exposure_s == 0.0 else 0.0
    sigma_s = math.hypot(options.latency_sigma_s, unknown_s, error_s / math.sqrt(3.0))
    if stamped is not None:
        measured_at = after(stamped, to_middle_s - options.latency_s)
        possible = (
            -_AHEAD_S <= seconds_between(stamped, received_at) <= _OLDEST_S
            and seconds_between(received_at, measured_at) <= 5.0 * sigma_s
        )
        if possible:
            return Stamp(measured_at, received_at, sigma_s, "kernel"), False
    measured_at = after(received_at, -0.5 * exposure_s - max(0.0, options.latency_s))
    return Stamp(measured_at, received_at, math.hypot(sigma_s, options.arrival_sigma_s), "arrival"), stamped is not None
