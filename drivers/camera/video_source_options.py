"""The options of a camera that is not part of the vehicle, and the counters of its frames."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, fields

FORMATS = ("YUYV", "NV12", "MJPG", "H264", "GREY")
"""The supported pixel formats of a V4L2 device, in the order in which `auto` prefers them: raw colour, compressed, grey."""


@dataclass(frozen=True, slots=True)
class SourceTimeouts:
    """The times after which a camera counts as gone and is opened again.

    Raises:
        ValueError: a time is not positive.
    """

    silence_s: float = 2.0
    """A camera without a frame for this long is opened again."""
    first_s: float = 0.2
    most_s: float = 2.0
    """The longest back-off between attempts: it doubles from the first to this, and starts again after a run longer than this."""

    def __post_init__(self) -> None:
        for f in fields(self):
            _seconds(f.name, getattr(self, f.name), least=1e-3, most=60.0)


@dataclass(frozen=True, slots=True)
class V4l2Options:
    """One V4L2 camera and its settings.

    Raises:
        ValueError: a number is out of range, or a format is not supported.
    """

    device: str
    """A path (/dev/v4l/by-id/..., /dev/video0), or a part of a stable name that only one camera has."""
    width: int
    height: int
    rate_hz: float = 30.0
    format: str = "auto"
    """One of `FORMATS`, or auto: the first of them that the camera offers in this size at this rate."""
    controls: Mapping[str, int | bool | str] = field(default_factory=dict)
    """The controls that are set, by name (exposure_time_absolute, gain, white_balance_automatic); all others are left alone."""
    latency_s: float = 0.0
    """The delay of the kernel's stamp beyond half an exposure after mid-exposure (before it, if the driver stamps the start)."""
    latency_sigma_s: float = 0.005
    arrival_sigma_s: float = 0.02
    """The standard deviation of the stamp of frames without a monotonic kernel stamp, for which the arrival is used."""
    exposure_s: float = 0.0
    """The exposure time, 0 if not known; a fixed exposure_time_absolute of the camera itself takes precedence."""
    buffers: int = 4
    timeouts: SourceTimeouts = field(default_factory=SourceTimeouts)

    def __post_init__(self) -> None:
        if not self.device:
            raise ValueError("device must name a camera")
        _size(self.width, self.height)
        if not 0.1 <= self.rate_hz <= 1000.0:
            raise ValueError(f"rate_hz must lie in 0.1..1000, got {self.rate_hz!r}")
        if self.format != "auto" and self.format not in FORMATS:
            raise ValueError(f"format must be auto or one of {', '.join(FORMATS)}, got {self.format!r}")
        if not 2 <= self.buffers <= 32:
            raise ValueError(f"buffers must lie in 2..32, got {self.buffers!r}")
        _seconds("latency_s", self.latency_s, least=-0.5, most=0.5)
        _seconds("latency_sigma_s", self.latency_sigma_s, least=0.0, most=0.5)
        _seconds("arrival_sigma_s", self.arrival_sigma_s, least=0.0, most=0.5)
        _seconds("exposure_s", self.exposure_s, least=0.0, most=1.0)


@dataclass(frozen=True, slots=True)
class StreamOptions:
    """A network camera or a video file.

    Raises:
        ValueError: a number is out of range.
    """

    source: str
    """An address (rtsp://..., udp://...) or the path of a file."""
    latency_s: float = 0.0
    """The delay from mid-exposure to the arrival of the frame's last byte; for a file it counts from the time in the file."""
    sigma_s: float = 0.02
    exposure_s: float = 0.0
    size: tuple[int, int] | None = None
    """The expected width and height, px: frames of more than four times as many pixels are not decoded."""
    repeat: bool = False
    """Whether a file starts again at its end."""
    timeouts: SourceTimeouts = field(default_factory=lambda: SourceTimeouts(silence_s=5.0))

    def __post_init__(self) -> None:
        if not self.source:
            raise ValueError("source must name a stream or a file")
        if self.size is not None:
            _size(*self.size)
        _seconds("latency_s", self.latency_s, least=0.0, most=5.0)
        _seconds("sigma_s", self.sigma_s, least=0.0, most=0.5)
        _seconds("exposure_s", self.exposure_s, least=0.0, most=1.0)

    @property
    def is_address(self) -> bool:
        """Whether the source is a live stream, as opposed to a file."""
        return "://" in self.source


CameraOptions = V4l2Options | StreamOptions


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


def _size(width: int, height: int) -> None:
    if not (16 <= width <= 8192 and 16 <= height <= 8192):
        raise ValueError(f"a frame of {width}x{height} px is out of range (16..8192)")


def _seconds(name: str, value: float, least: float, most: float) -> None:
    if not math.isfinite(value) or not least <= value <= most:
        raise ValueError(f"{name} must lie in {least:g}..{most:g} s, got {value!r}")
